//! The command over recorded logs: what it prints, its exit codes, its errors.

mod common;

use std::io::{BufRead as _, BufReader};
use std::process::Stdio;

use cosmic_core::Subject;
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::protocol::{Answer, SupplyEtag};

use common::{CLUSTER, Running, cosmic, json, printed, run, text};

const ROVER: &str = "log:docs/tasks/rover.log";
const LATE: &str = "log:docs/tasks/late.log";

/// What is said on standard error: one line with a remedy; and the exit code.
fn refused(arguments: &[&str]) -> (i32, String) {
    let output = run(arguments);
    let said = text(&output.stderr);
    assert_eq!(said.lines().count(), 1, "{said}");
    assert!(said.starts_with("cosmic: "), "{said}");
    (output.status.code().unwrap(), said)
}

#[test]
fn nodes_have_names_by_the_cluster_file() {
    let nodes = json(&["nodes", "-l", ROVER, "-c", CLUSTER, "--json"]);
    let names: Vec<_> = nodes.as_array().unwrap().iter().map(|node| node["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["base", "left_motor", "right_motor", "imu", "arm", "power"]);
    assert_eq!((&nodes[0]["is_master"], &nodes[0]["state"]), (&true.into(), &"operational".into()));
    let without = json(&["nodes", "-l", ROVER, "--json"]);
    assert_eq!((&without[0]["name"], &without[0]["tx_node"]), (&serde_json::Value::Null, &1.into()));
}

#[test]
fn channels_are_there_without_a_cluster_file_too() {
    let channels = json(&["channels", "-l", ROVER, "--bit-rate", "500 kbit/s", "--json"]);
    let channels = channels.as_array().unwrap();
    let attitude = channels.iter().find(|channel| channel["etag"] == 16_383).unwrap();
    assert_eq!((&attitude["class"], &attitude["publishers"][0]["tx_node"]), (&"SRT".into(), &4.into()));
    assert_eq!(attitude["subscribers"][0]["tx_node"], 1);
    assert!(
        attitude["last"]["fields"].as_array().unwrap().is_empty() && attitude["last"]["data"].is_string()
    );
}

#[test]
fn events_are_printed_by_their_contents_or_in_hexadecimal_digits() {
    let with = printed(&["echo", "gripper", "-n", "1", "-l", ROVER, "-c", CLUSTER]);
    assert!(with.trim_end().ends_with("arm          gripper state=holding force=12.5 N"), "{with}");
    let without = printed(&["echo", "16381", "-n", "1", "-l", ROVER]);
    assert!(without.trim_end().ends_with("node 05      etag 16381 020FA0"), "{without}");
    let by_subject = printed(&["echo", "0xB0A01C0000000006", "-n", "1", "-l", ROVER, "-c", CLUSTER]);
    assert_eq!(by_subject, with);
    let line: serde_json::Value =
        serde_json::from_str(&printed(&["echo", "gripper", "-n", "1", "-l", ROVER, "-c", CLUSTER, "--json"]))
            .unwrap();
    assert_eq!((&line["channel"], &line["meaning"]["is"]), (&"gripper".into(), &"event".into()));
    assert_eq!(line["meaning"]["fields"][1]["unit"], "N");
    // Of several frames.
    let message = printed(&["echo", "journal", "-n", "1", "-l", ROVER, "-c", CLUSTER]);
    assert!(message.contains("base         journal at=0 s latitude=0 ° longitude=0 °"), "{message}");
    let control = printed(&["echo", "--control", "-l", ROVER, "-c", CLUSTER]);
    for name in [
        "sync sequence=",
        "follow-up ",
        "node status state=",
        "interest side=subscriber ",
        "node identity uid=",
    ] {
        assert!(control.contains(name), "{name}");
    }
}

#[test]
fn every_frame_of_a_log_is_decoded() {
    let lines = printed(&["decode", "docs/tasks/late.log", "-c", CLUSTER]);
    let frames = std::fs::read_to_string(common::root().join("docs/tasks/late.log")).unwrap().lines().count();
    assert_eq!(lines.lines().count(), frames);
    assert!(!lines.contains("malformed") && !lines.contains("no message"), "{lines}");
}

/// Where a broker gives the etags, events come before the binding that a log has of them.
#[test]
fn events_before_their_binding_are_decoded_too() {
    let (node, etag) = (TxNode::new(4).unwrap(), Etag::BOUND_FIRST);
    let attitude = Payload::new(&[156, 0, 78, 0, 74, 31, 0x19]).unwrap();
    let event = Frame::new(Id::new(Priority::new(20), node, etag), attitude);
    let subject = Subject::new(0xB0A0_1C00_0000_0004).unwrap();
    let binding = SupplyEtag::pair(TxNode::BROKER, node, subject, Answer::Bound(etag)).map(|it| it.encode());
    let log: String = [event, binding[0], binding[1], event]
        .iter()
        .enumerate()
        .map(|(at, frame)| format!("(1.00{at}) can0 {:08X}#{}\n", frame.id.raw(), frame.payload))
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("brokered.log");
    std::fs::write(&file, log).unwrap();
    let file = file.display().to_string();
    let lines = printed(&["decode", &file, "-c", CLUSTER]);
    let events = lines.lines().filter(|line| line.contains("attitude roll=1.56 °"));
    assert_eq!(events.count(), 2, "{lines}");
    let lines = printed(&["echo", "0xB0A01C0000000004", "-l", &format!("log:{file}")]);
    assert_eq!(lines.lines().count(), 2, "{lines}");
}

/// Nothing of a pipe is read before it is shown.
#[test]
fn a_log_is_read_from_a_pipe_with_a_name() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let reader = Running::start(&["decode", pipe.to_str().unwrap(), "-c", CLUSTER]);
    let log = std::fs::read(common::root().join("docs/tasks/rover.log")).unwrap();
    std::fs::write(&pipe, log).unwrap();
    let output = reader.wait();
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(text(&output.stdout), printed(&["decode", "docs/tasks/rover.log", "-c", CLUSTER]));
}

#[test]
fn rates_and_latencies_are_for_machines_too() {
    let rhythms = json(&["hz", "attitude", "-l", ROVER, "-c", CLUSTER, "--json"]);
    let hz = rhythms[0]["hz"].as_f64().unwrap();
    assert!((99.0..101.0).contains(&hz), "{hz}");
    let latencies = json(&["latency", "-l", LATE, "-c", CLUSTER, "--json"]);
    let attitude = latencies["soft"].as_array().unwrap().iter().find(|it| it["name"] == "attitude").unwrap();
    assert!(attitude["latency"]["least_left_ns"].as_i64().unwrap() < 0);
    assert_eq!(latencies["hard"].as_array().unwrap().len(), 3);
}

#[test]
fn the_doctor_says_by_its_exit_code_whether_there_is_an_error() {
    let healthy = run(&["doctor", "-l", ROVER, "-c", CLUSTER]);
    assert!(healthy.status.success() && text(&healthy.stdout).starts_with("nothing is wrong"));
    let warned = run(&["doctor", "-l", LATE, "-c", CLUSTER, "--json"]);
    let findings: serde_json::Value = serde_json::from_slice(&warned.stdout).unwrap();
    assert_eq!((warned.status.code(), &findings[0]["rule"]), (Some(0), &"unplanned-publisher".into()));
    assert_eq!(findings[0]["severity"], "warning");
    // The file of another cluster.
    let wrong = run(&["doctor", "-l", ROVER, "-c", "cosmic-plan/examples/vehicle.toml"]);
    assert_eq!(wrong.status.code(), Some(1));
    assert!(text(&wrong.stdout).contains("error: two calendars: time master"), "{}", text(&wrong.stdout));
}

#[test]
fn what_is_recorded_in_one_format_is_the_same_in_the_other() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    let (pcapng, candump) = (file("fault.pcapng"), file("fault.log"));
    printed(&["record", &pcapng, "-l", LATE]);
    printed(&["record", &candump, "-l", &format!("log:{pcapng}")]);
    let original = std::fs::read_to_string(common::root().join("docs/tasks/late.log")).unwrap();
    assert_eq!(std::fs::read_to_string(&candump).unwrap(), original);
    assert_eq!(printed(&["record", "-", "-n", "3", "-l", LATE]).lines().count(), 3);
}

#[test]
fn a_log_is_read_from_standard_input() {
    let log = std::fs::File::open(common::root().join("docs/tasks/rover.log")).unwrap();
    let output = cosmic(&["decode", "-", "-c", CLUSTER]).stdin(Stdio::from(log)).output().unwrap();
    assert_eq!(text(&output.stdout), printed(&["decode", "docs/tasks/rover.log", "-c", CLUSTER]));
}

#[test]
fn errors_are_one_line_with_a_remedy() {
    let (code, said) = refused(&["nodes"]);
    assert!(code == 2 && said.contains("say --link"), "{said}");
    let (code, said) = refused(&["echo", "speeed", "-l", ROVER, "-c", CLUSTER]);
    assert!(code == 2 && said.contains("\"speeed\"") && said.contains("cluster file"), "{said}");
    let (code, said) = refused(&["nodes", "-l", "log:nowhere.log"]);
    assert!(code == 2 && said.contains("nowhere.log cannot be opened"), "{said}");
    let (code, said) = refused(&["nodes", "-l", "log:README.md"]);
    assert!(code == 2 && said.contains("README.md line 1: this is no frame"), "{said}");
    let (code, said) = refused(&["nodes", "-l", ROVER, "-c", "nowhere.toml"]);
    assert!(code == 2 && said.contains("nowhere.toml cannot be read"), "{said}");
    let (code, said) = refused(&["nodes", "-l", "sim:/nowhere/segment"]);
    assert!(code == 3 && said.contains("no server answers") && said.contains("--link"), "{said}");
    let (code, said) = refused(&["nodes", "-l", "slcan:/nowhere"]);
    assert!(code == 3 && said.contains("slcan on /nowhere"), "{said}");
    let (code, said) = refused(&["pub", "attitude", "00", "-l", ROVER, "-c", CLUSTER]);
    assert!(code == 2 && said.contains("a log can only be listened to"), "{said}");
    let (code, said) = refused(&["pub", "gripper", "state=open", "-l", ROVER, "-c", CLUSTER]);
    assert!(code == 2 && said.contains("force is missing"), "{said}");
    let (code, said) = refused(&["top", "-l", ROVER]);
    assert!(code == 2 && said.contains("this is none"), "{said}");
    let (code, said) = refused(&["echo", "9999", "-l", ROVER]);
    assert!(code == 1 && said.contains("no event was heard"), "{said}");
    let options = run(&["nodes", "-l", "usb:1"]);
    assert_eq!(options.status.code(), Some(2));
    assert!(text(&options.stderr).contains("write sim:PATH"), "{}", text(&options.stderr));
}

#[test]
fn a_log_that_is_cut_off_is_read_to_where_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.pcapng");
    printed(&["record", path.to_str().unwrap(), "-n", "100", "-l", ROVER]);
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 10]).unwrap();
    let output = run(&["decode", path.to_str().unwrap()]);
    assert_eq!(text(&output.stdout).lines().count(), 99);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("is cut off"), "{}", text(&output.stderr));
}

/// The kernel refuses to let the file grow, as it does when the disk is full.
#[test]
fn a_record_for_which_there_is_no_room_is_whole_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["small.log", "small.pcapng"] {
        let path = folder.path().join(name);
        let mut command = std::process::Command::new("sh");
        command.args(["-c", r#"trap '' XFSZ; ulimit -f 16; exec "$0" "$@""#, env!("CARGO_BIN_EXE_cosmic")]);
        command.arg("record").arg(&path).args(["-l", ROVER]).current_dir(common::root());
        let output = command.output().unwrap();
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(said.contains("cannot be written: ") && said.contains("make room"), "{said}");
        let room = std::fs::metadata(&path).unwrap().len();
        assert!((8_000..=16 * 1024).contains(&room), "{room}");
        // Nothing of it is cut off, and it is the beginning of the whole.
        let all = printed(&["decode", "docs/tasks/rover.log"]);
        let begin = printed(&["decode", path.to_str().unwrap()]);
        assert!(begin.lines().count() > 100 && all.starts_with(&begin), "{name}");
    }
    let (code, said) = refused(&["record", "/dev/full", "-l", ROVER]);
    assert!(code == 2 && said.contains("make room"), "{said}");
}

#[test]
fn output_that_is_piped_has_no_colours() {
    for command in ["nodes", "channels", "doctor"] {
        let output = printed(&[command, "-l", ROVER, "-c", CLUSTER]);
        assert!(!output.contains('\x1b'), "{output}");
    }
}

#[test]
fn a_reader_that_closes_the_pipe_ends_the_command_quietly() {
    let mut command = cosmic(&["decode", "docs/tasks/rover.log"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut first = String::new();
    // Larger than the pipe is what is to come; the reader goes.
    BufReader::with_capacity(16, child.stdout.take().unwrap()).read_line(&mut first).unwrap();
    let ended = child.wait_with_output().unwrap();
    assert!(ended.status.success() && ended.stderr.is_empty(), "{}", text(&ended.stderr));
}

#[test]
fn there_are_completions_for_the_usual_shells() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        assert!(printed(&["completions", shell]).contains("doctor"), "{shell}");
    }
}

#[test]
fn the_readme_shows_what_is_printed() {
    let readme = std::fs::read_to_string(common::root().join("README.md")).unwrap();
    let command = ["--cluster", CLUSTER, "--link", LATE, "doctor"];
    let block = format!("$ cosmic {}\n{}```", command.join(" "), printed(&command));
    assert!(readme.contains(&block), "README.md does not hold this:\n{block}");
}
