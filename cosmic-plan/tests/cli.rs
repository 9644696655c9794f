//! The program as its user meets it: exit codes, messages, files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_cosmic-plan")).args(arguments).output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn text_of(output: &Output) -> String {
    text(&output.stdout) + &text(&output.stderr)
}

fn json(output: &Output) -> serde_json::Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {}", text(&output.stdout)))
}

/// A folder of its own for each test.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("it can be made");
    folder
}

fn file(folder: &Path, name: &str, content: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, content).expect("it can be written");
    path.display().to_string()
}

const HEAD: &str = "[segment]\nname = 'test'\nbit_rate = '1 Mbit/s'\nclock_accuracy = '5 us'\nstamp_latency = '1 us'\n\
                    release_jitter = '5 us'\n\n[[node]]\nname = 'a'\nuid = 1\n";

fn hard(name: &str, subject: u32, period: &str, degree: u8) -> String {
    format!(
        "[[channel]]\nname = '{name}'\nsubject = {subject}\nclass = 'HRT'\nlength = 8\nperiod = '{period}'\n\
         omission_degree = {degree}\n"
    )
}

#[test]
fn the_example_passes_and_everything_is_written() {
    let folder = folder("example");
    let cluster = folder.join("vehicle.toml").display().to_string();
    assert!(run(&["new", &cluster]).status.success());
    assert_eq!(run(&["new", &cluster]).status.code(), Some(2), "it must not overwrite");
    let check = run(&["check", &cluster]);
    assert!(check.status.success(), "{}", text(&check.stdout));
    assert!(text(&check.stdout).contains("everything holds"));
    let out = folder.join("out").display().to_string();
    let build = run(&["build", &cluster, "--out", &out, "--json"]);
    assert!(build.status.success());
    assert_eq!(json(&build)["files"].as_array().map(Vec::len), Some(10));
    let read = |name: &str| std::fs::read_to_string(folder.join("out").join(name)).expect("it was written");
    assert!(read("timeline.svg").contains("</svg>"));
    // Its character set is not UTF-8.
    let dbc = std::fs::read(folder.join("out/vehicle.dbc")).expect("it was written");
    assert!(dbc.starts_with(b"VERSION"));
    let digest = json(&build)["calendar"]["digest"].as_str().expect("it has one").to_owned();
    assert!(read("calendar.rs").contains(&format!("DIGEST: u32 = 0x{digest}")));
    // The same again, to the byte: the firmware's digest depends on it.
    let before = read("calendar.rs");
    assert!(run(&["build", &cluster, "--out", &out]).status.success());
    assert_eq!(before, read("calendar.rs"));
    for line in read("report.txt").lines() {
        assert!(line.chars().count() <= 80, "{line}");
    }
}

#[test]
fn all_mistakes_are_named_at_once_with_their_lines() {
    let folder = folder("mistakes");
    let wrong = "[segment]\nname = 'test'\nbit_rate = '3 Mbit/s'\nclock_accuracy = 5\nrelease_jitter = '5 us'\n\
                 colour = 'red'\n[[node]]\nname = 'a'\nuid = 0\npublishes = ['sped']\n\
                 [[channel]]\nname = 'speed'\nsubject = 7\nclass = 'HRT'\nlength = 9\nperiod = '10 ms'\n\
                 [[channel]]\nname = 'heat'\nsubject = 7\nclass = 'SRT'\nlenght = 4\nperiod = '10 ms'\n";
    let cluster = file(&folder, "wrong.toml", wrong);
    let output = run(&["check", &cluster, "--json"]);
    assert_eq!(output.status.code(), Some(2));
    let report = json(&output);
    let problems: Vec<(u64, String)> = report["problems"]
        .as_array()
        .expect("there are problems")
        .iter()
        .map(|p| (p["line"].as_u64().unwrap_or(0), p["field"].as_str().unwrap_or("").to_owned()))
        .collect();
    let expected = [
        (3, "segment.bit_rate"),
        (4, "segment.clock_accuracy"),
        (6, "segment.colour"),
        (9, "node.a.uid"),
        (10, "node.a.publishes"),
        (12, "channel.speed"),
        (15, "channel.speed.length"),
        (17, "channel.heat.deadline"),
        (17, "channel.heat.length"),
        (19, "channel"),
        (21, "channel.heat.lenght"),
    ];
    for (line, field) in expected {
        assert!(problems.contains(&(line, field.to_owned())), "{line} {field} is not in {problems:?}");
    }
    let people = text(&run(&["check", &cluster]).stderr);
    assert!(people.contains("did you mean `length`?"), "{people}");
    assert!(people.contains("did you mean `speed`?"), "{people}");
    assert!(people.contains("write \"5 ms\" or \"5 us\""), "{people}");
}

#[test]
fn what_would_not_reach_the_image_is_refused() {
    let folder = folder("refused");
    let channel = "[[channel]]\nname = 'heat'\nsubject = 7\nclass = 'NRT'\nlength = 2\nperiod = '10 ms'\n";
    for (head, node, field, remedy) in [
        ("", "board = 'stm32f407'", "node.a.board", "leave it out"),
        ("", "rank = 16", "node.a.rank", "write 0 (the first) to 15 (the last), or \"never\""),
        ("priority_step = '18 ms'", "", "segment.priority_step", "write at most 17 ms"),
        ("sync_period = '1 ms'", "", "segment.sync_period", "write 5 ms to 10 s"),
        ("sync_period = '5 ms'\nstamp_latency = '1 ms'", "", "segment.sync_period", "a hundred times"),
        ("stamp_latency = '5 us'", "", "segment.clock_accuracy", "write more than 5.375 µs"),
    ] {
        // Lines of the same field stand once.
        let text: String = HEAD
            .split_inclusive('\n')
            .filter(|line| !head.lines().any(|own| own.split('=').next() == line.split('=').next()))
            .collect();
        let text = text.replace("[segment]", &format!("[segment]\n{head}"));
        let text = format!("{text}{node}\npublishes = ['heat']\n{channel}");
        let report = json(&run(&["check", &file(&folder, "wrong.toml", &text), "--json"]));
        assert_eq!(report["problems"].as_array().map(Vec::len), Some(1), "{report}");
        assert_eq!(report["problems"][0]["field"], field);
        assert!(report["problems"][0]["remedy"].as_str().is_some_and(|it| it.contains(remedy)), "{report}");
    }
}

#[test]
fn bursts_belong_to_sporadic_channels() {
    let folder = folder("bursts");
    let with = |replaced: &str, by: &str| {
        let text = include_str!("../examples/vehicle.toml").replacen(replaced, by, 1);
        let output = run(&["check", &file(&folder, "cluster.toml", &text)]);
        (output.status.code(), text_of(&output))
    };
    let sporadic = "min_interarrival = \"10 ms\"";
    assert_eq!(with(sporadic, &format!("{sporadic}\nburst = 2")).0, Some(0));
    let wrong = [
        (sporadic, "0", "no event at all"),
        ("period = \"20 ms\"", "2", "a periodic channel has one event in every period"),
        ("period = \"10 ms\"", "2", "a slot has one event"),
    ];
    for (field, burst, message) in wrong {
        let (code, said) = with(field, &format!("{field}\nburst = {burst}"));
        assert_eq!(code, Some(2));
        assert!(said.contains(message), "{said}");
    }
}

#[test]
fn a_sealed_cluster_fixes_all() {
    let folder = folder("sealed");
    let with = |segment: &str, binding: &str| {
        let text = include_str!("../examples/vehicle.toml")
            .replacen("[segment]", &format!("[segment]\n{segment}"), 1)
            .replacen("binding = \"static\"", binding, 1);
        let output = run(&["check", &file(&folder, "cluster.toml", &text)]);
        (output.status.code(), text_of(&output))
    };
    let fixed = "binding = \"static\"";
    assert_eq!(with("sealed = true\nbrokers = [\"sensor\"]", fixed).0, Some(0));
    let wrong = [
        ("sealed = true", "binding = \"broker\"", "the etags of a sealed cluster are fixed"),
        ("sealed = true\nbrokers = [\"sensors\"]", fixed, "did you mean `sensor`?"),
        ("brokers = [\"sensor\"]", fixed, "has no effect in an open cluster"),
    ];
    for (segment, binding, message) in wrong {
        let (code, said) = with(segment, binding);
        assert_eq!(code, Some(2));
        assert!(said.contains(message), "{said}");
    }
    let reserved =
        include_str!("../examples/vehicle.toml").replacen("0xC05A1C0000000002", "0xFFFFFFFFFFFFFFFF", 1);
    let said = text_of(&run(&["check", &file(&folder, "reserved.toml", &reserved)]));
    assert!(said.contains("is reserved for brokers"), "{said}");
}

#[test]
fn an_impossible_set_is_explained_and_a_way_out_is_named() {
    let folder = folder("impossible");
    let channels = [hard("x", 1, "1 ms", 1), hard("y", 2, "1 ms", 1), hard("z", 3, "20 ms", 0)].concat();
    // By itself one omission less makes room for x and y, but then z does not fit.
    let together = file(&folder, "together.toml", &format!("{HEAD}publishes = ['x', 'y', 'z']\n{channels}"));
    let report = json(&run(&["check", &together, "--json"]));
    let change = &report["relaxations"][0]["change"];
    assert!(change.as_str().is_some_and(|c| c.contains("; ")), "{change}");
    let channels = [hard("x", 1, "1 ms", 1), hard("y", 2, "1 ms", 1), hard("z", 3, "20 ms", 0)].concat();
    let channels =
        channels.replace("subject = 3\nclass = 'HRT'", "subject = 3\nclass = 'SRT'\ndeadline = '10 ms'");
    let channels = channels.replace("omission_degree = 0", "");
    let cluster = file(&folder, "full.toml", &format!("{HEAD}publishes = ['x', 'y', 'z']\n{channels}"));
    let output = run(&["check", &cluster, "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let report = json(&output);
    assert_eq!(report["verdict"], "impossible");
    assert_eq!(report["channels"], serde_json::json!(["x", "y"]));
    let changes = report["relaxations"].as_array().expect("there are some");
    assert!(changes[0]["change"].as_str().is_some_and(|c| c.contains("omission_degree = 0 instead of 1")));
    // The cheapest change helps indeed.
    let relaxed = std::fs::read_to_string(&cluster).expect("it is there").replacen(
        "omission_degree = 1",
        "omission_degree = 0",
        1,
    );
    let relaxed = file(&folder, "relaxed.toml", &relaxed);
    assert!(run(&["check", &relaxed]).status.success());
    let diff = text(&run(&["diff", &relaxed, &relaxed]).stdout);
    assert_eq!(diff, "nothing changed\n");
}

#[test]
fn diff_and_explain_name_what_matters() {
    let folder = folder("diff");
    let with = |degree| {
        let channels = [hard("x", 1, "10 ms", degree), hard("y", 2, "20 ms", 1)].concat();
        file(&folder, &format!("k{degree}.toml"), &format!("{HEAD}publishes = ['x', 'y']\n{channels}"))
    };
    let (before, after) = (with(1), with(2));
    let diff = json(&run(&["diff", &before, &after, "--json"]));
    let bound =
        diff.as_array().expect("a list").iter().find(|c| c["who"] == "x of a" && c["what"] == "window");
    assert_eq!(
        bound.map(|c| (c["before"].clone(), c["after"].clone())),
        Some(("557 µs".into(), "748 µs".into()))
    );
    let explain = text(&run(&["explain", &before, "x"]).stdout);
    assert!(explain.contains("ΔT_wait") && explain.contains("gap: 2ε + release jitter"), "{explain}");
    let unknown = run(&["explain", &before, "xx"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(text(&unknown.stderr).contains("did you mean x?"));
}

#[test]
fn occurrences_are_placed_one_by_one_where_jitter_allows() {
    let folder = folder("jitter");
    // Windows of 366 µs every 1 ms and every 1.5 ms meet every 500 µs, and do not fit there.
    let channels = [hard("x", 1, "1 ms", 0), hard("y", 2, "1500 us", 0)].concat();
    let strict = format!("{HEAD}publishes = ['x', 'y']\n{channels}");
    let refused = run(&["check", &file(&folder, "strict.toml", &strict)]);
    assert_eq!(refused.status.code(), Some(1), "{}", text(&refused.stdout));
    let loose = file(&folder, "loose.toml", &format!("{strict}jitter = '400 us'\n"));
    let report = run(&["report", &loose, "--json"]);
    assert!(report.status.success(), "{}", text(&report.stdout));
    assert_eq!(json(&report)["calendar"]["method"], "occurrences");
}

#[test]
fn wrong_files_and_arguments_get_one_line_and_exit_code_2() {
    for arguments in
        [&["check", "/no/such/file"][..], &["report"], &["frobnicate"], &["analyse", "/dev/null"]]
    {
        assert_eq!(run(arguments).status.code(), Some(2), "{arguments:?}");
    }
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/vehicle.toml");
    let unwritable = run(&["build", example, "--out", "/proc/nothing"]);
    assert_eq!(unwritable.status.code(), Some(2));
    assert_eq!(text(&unwritable.stderr).lines().count(), 1);
}

#[test]
fn the_schema_knows_every_field() {
    let schema = json(&run(&["schema"]));
    let channel = &schema["$defs"]["ChannelTable"]["properties"];
    for field in
        ["name", "subject", "class", "length", "period", "deadline", "after", "importance", "etag", "content"]
    {
        assert!(channel[field].is_object(), "{field}");
    }
    assert_eq!(schema["$defs"]["ChannelTable"]["required"], serde_json::json!(["name", "subject", "class"]));
}

/// The promises on speed, with room for a slow machine that does other things beside.
#[test]
fn a_thousand_messages_and_two_thousand_slots() {
    let folder = folder("speed");
    let mut set = String::from("bit_rate = 1_000_000\n");
    for at in 0..1000 {
        let period = [100, 200, 400, 1000][at % 4];
        set +=
            &format!("[[message]]\nid = {}\nlength = {}\nperiod = '{period} ms'\n", 0x100_0000 + at, at % 9);
    }
    let set = file(&folder, "set.toml", &set);
    let started = Instant::now();
    let findings = json(&run(&["analyse", &set, "--json"]));
    assert_eq!(findings["messages"].as_array().map(Vec::len), Some(1000));
    assert!(started.elapsed() < Duration::from_secs(4), "{:?}", started.elapsed());

    let names: Vec<String> = (0..500).map(|at| format!("'c{at}'")).collect();
    let mut cluster = format!("{HEAD}publishes = [{}]\n", names.join(", "));
    for at in 0..500_u32 {
        cluster +=
            &hard(&format!("c{at}"), at + 1, ["100 ms", "200 ms", "400 ms", "800 ms"][at as usize % 4], 0);
    }
    let cluster = file(&folder, "cluster.toml", &cluster);
    let started = Instant::now();
    let report = json(&run(&["check", &cluster, "--json"]));
    assert_eq!(report["verdict"], "holds");
    // 125 channels of each period: 1000 + 500 + 250 + 125 slots a cycle.
    assert_eq!(report["calendar"]["slots"].as_array().map(Vec::len), Some(500));
    assert!(started.elapsed() < Duration::from_secs(40), "{:?}", started.elapsed());
}

#[test]
fn foreign_frames_come_from_a_list_or_a_dbc_file() {
    let folder = folder("foreign");
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/vehicle.toml");
    let plain = std::fs::read_to_string(example).expect("it is there");
    let bound =
        |report: &serde_json::Value| report["channels"][3]["bound_us"].as_f64().expect("there is one");
    let without = bound(&json(&run(&["check", example, "--json"])));

    let dbc = "VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: ecu\n\nBO_ 256 Engine: 8 ecu\n\nBO_ 512 Doors: 2 ecu\n\n\
               BA_DEF_ BO_ \"GenMsgCycleTime\" INT 0 10000;\nBA_DEF_DEF_ \"GenMsgCycleTime\" 0;\n\
               BA_ \"GenMsgCycleTime\" BO_ 256 10;\n";
    file(&folder, "car.dbc", dbc);
    let missing = file(&folder, "missing.toml", &format!("{plain}\n[[foreign]]\ndbc = 'car.dbc'\n"));
    let refused = run(&["check", &missing]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("Doors has no GenMsgCycleTime"), "{}", text(&refused.stderr));

    let with = format!("{plain}\n[[foreign]]\ndbc = 'car.dbc'\nperiod = '100 ms'\n");
    let report = json(&run(&["check", &file(&folder, "with.toml", &with), "--json"]));
    assert_eq!(report["foreign"].as_array().map(Vec::len), Some(2));
    // 135 and 75 bits more can be in front of the suspension.
    assert_eq!(bound(&report), without + 135.0 + 75.0);
    let list = "\n[[foreign]]\nname = 'Engine'\nid = 256\nlength = 8\nperiod = '10 ms'\n\
                [[foreign]]\nid = 512\nlength = 2\nperiod = '100 ms'\n";
    let listed = json(&run(&["check", &file(&folder, "list.toml", &format!("{plain}{list}")), "--json"]));
    assert_eq!(bound(&listed), bound(&report));

    let urgent = file(&folder, "urgent.toml", &format!("{plain}{}", list.replace("id = 512", "id = 7")));
    assert!(text(&run(&["check", &urgent]).stderr).contains("would win against hard real-time"));
}

/// Every `$ cosmic-plan ...` in the tutorial prints what the tutorial says. `UPDATE_DOCS=1` writes what they print
/// instead.
#[test]
fn the_tutorial_shows_what_is_printed() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let update = std::env::var_os("UPDATE_DOCS").is_some();
    let path = docs.join("tutorial.md");
    let tutorial = std::fs::read_to_string(&path).expect("it is there");
    let mut shown = 0;
    let mut updated = tutorial.clone();
    for block in tutorial.split("```console\n").skip(1) {
        let block = block.split("```").next().unwrap_or("");
        let Some((command, expected)) = block.strip_prefix("$ cosmic-plan ").and_then(|b| b.split_once('\n'))
        else {
            continue;
        };
        let output = Command::new(env!("CARGO_BIN_EXE_cosmic-plan"))
            .args(command.split_whitespace())
            .current_dir(docs.join("tutorial"))
            .output()
            .expect("the program starts");
        let printed = text(&output.stdout) + &text(&output.stderr);
        let lines = |text: &str| text.lines().map(|l| l.trim_end().to_owned()).collect::<Vec<_>>();
        if update {
            let printed = lines(&printed).join("\n");
            updated = updated.replace(block, &format!("$ cosmic-plan {command}\n{printed}\n"));
        } else {
            assert_eq!(lines(&printed), lines(expected), "cosmic-plan {command}");
        }
        shown += 1;
    }
    assert!(shown >= 6);
    if update {
        std::fs::write(&path, updated).expect("it can be written");
    }
    // And the pictures are those of the files.
    for name in ["first", "pooled"] {
        let kept = docs.join(format!("pictures/planner-{name}.svg"));
        let out = if update { kept.clone() } else { folder("tutorial").join("picture.svg") };
        let file = docs.join(format!("tutorial/{name}.toml")).display().to_string();
        assert!(run(&["render", &file, "--out", &out.display().to_string()]).status.success());
        assert_eq!(std::fs::read_to_string(out).ok(), std::fs::read_to_string(kept).ok(), "{name}");
    }
}

/// The robot that the tutorial plans is the robot that runs at its end, and its text shows all of the file.
#[test]
fn the_tutorial_is_of_the_robot() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let read = |name: &str| std::fs::read_to_string(root.join(name)).expect("it is there");
    let planned = read("docs/tutorial/first.toml");
    assert_eq!(planned, read("examples/robot/cluster.toml"));
    let tutorial = read("docs/tutorial.md");
    let shown = tutorial.split("```toml\n").skip(1).filter_map(|block| block.split("```").next());
    let shown: String = shown.filter(|block| !block.contains("[[pool]]")).collect();
    let lines = |text: &str| {
        text.lines()
            .filter(|line| !line.is_empty() && !line.starts_with('#'))
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    assert_eq!(lines(&shown), lines(&planned));
}
