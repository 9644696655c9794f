//! What `cosmic record` writes as pcapng, shown by tshark with the dissector that `cosmic-plan export` makes of the
//! cluster file: named fields for every control message and every content. Needs both, which `cargo xtask test tools`
//! prepares; without them this says that it was not tried.

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use common::{CLUSTER, json, printed, root};

/// The dissector of the rover, or the test ends here.
fn dissector() -> Option<PathBuf> {
    let found = std::env::var_os("COSMIC_DISSECTOR").map(PathBuf::from);
    if found.is_none() {
        eprintln!("NOT TRIED: no dissector is given; `cargo xtask test tools` makes one");
    }
    found
}

/// Lines of tshark: these fields of each frame.
fn shown(dissector: &Path, file: &str, filter: &str, fields: &[&str]) -> Vec<String> {
    let mut command = Command::new("tshark");
    command.arg("-X").arg(format!("lua_script:{}", dissector.display()));
    command.args(["-r", file, "-Y", filter, "-T", "fields"]).current_dir(root());
    fields.iter().for_each(|field| {
        command.args(["-e", field]);
    });
    let output = command.output().expect("tshark starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !said.contains("Error"), "{said}");
    String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect()
}

#[test]
fn every_frame_of_a_record_has_a_name() {
    let Some(dissector) = dissector() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rover.pcapng").display().to_string();
    printed(&["record", &file, "-l", "log:docs/tasks/rover.log"]);
    let lines = shown(&dissector, &file, "can", &["cosmic.message", "cosmic.channel", "_ws.col.Info"]);
    let frames = std::fs::read_to_string(root().join("docs/tasks/rover.log")).unwrap().lines().count();
    assert_eq!(lines.len(), frames);
    let mut seen: BTreeMap<String, u32> = BTreeMap::new();
    for line in &lines {
        let mut columns = line.split('\t');
        let name = columns.by_ref().take(2).find(|name| !name.is_empty());
        *seen.entry(name.unwrap_or_else(|| panic!("no name: {line}")).to_owned()).or_default() += 1;
    }
    let messages = ["sync", "follow_up", "interest", "node_status", "node_identity"];
    let channels = json(&["channels", "-l", "log:docs/tasks/rover.log", "-c", CLUSTER, "--json"]);
    let channels: Vec<(&str, u64)> = channels
        .as_array()
        .unwrap()
        .iter()
        .map(|it| (it["name"].as_str().unwrap(), it["frames"].as_u64().unwrap()))
        .collect();
    for message in messages {
        assert!(seen.contains_key(message), "{message}: {seen:?}");
    }
    // As often as we count them ourselves.
    for (name, frames) in &channels {
        assert_eq!(seen.get(*name).copied().map(u64::from), Some(*frames), "{name}");
    }
    assert_eq!(seen.len(), messages.len() + channels.len(), "{seen:?}");
}

/// The last frame of a message has the fields of the whole; without one of its frames it says so, and a frame that was
/// repeated on the bus changes nothing.
#[test]
fn messages_longer_than_a_frame_are_put_together() {
    let Some(dissector) = dissector() else { return };
    let folder = tempfile::tempdir().unwrap();
    let log = std::fs::read_to_string(root().join("docs/tasks/rover.log")).unwrap();
    let lines: Vec<&str> = log.lines().collect();
    let decoded = printed(&["decode", "docs/tasks/rover.log", "-c", CLUSTER]);
    let frames: Vec<usize> =
        (0..).zip(decoded.lines()).filter(|it| it.1.contains(" journal ")).map(|it| it.0).collect();
    // Two messages of six frames each. The second frame comes twice, and one of the second message is missing.
    assert_eq!(frames.len(), 12, "{frames:?}");
    let faulty = (0..)
        .zip(&lines)
        .filter(|(at, _)| *at != frames[8])
        .flat_map(|(at, line)| std::iter::repeat_n(format!("{line}\n"), if at == frames[1] { 2 } else { 1 }));
    let (whole, faulty): (String, String) = (log.clone(), faulty.collect());
    for (name, text, expected) in [("whole", whole, [true, true]), ("faulty", faulty, [true, false])] {
        let (log, file) =
            (folder.path().join(format!("{name}.log")), folder.path().join(format!("{name}.pcapng")));
        std::fs::write(&log, text).unwrap();
        let file = file.display().to_string();
        printed(&["record", &file, "-l", &format!("log:{}", log.display())]);
        let fields = ["cosmic.journal.latitude", "cosmic.journal.cells_5", "_ws.expert.message"];
        let ends = shown(&dissector, &file, r#"cosmic.part contains "the last""#, &fields);
        assert_eq!(ends.len(), 2, "{ends:?}");
        for (end, expected) in ends.iter().zip(expected) {
            let is_whole = end.split('\t').take(2).all(|value| value == "0");
            assert_eq!(is_whole, expected, "{name}: {end}");
            assert_eq!(end.contains("frames of this message are missing"), !expected, "{name}: {end}");
        }
    }
}

/// The table of the manual, which a test of the core holds true, as a record.
#[test]
fn every_control_message_of_a_record_has_named_fields() {
    let Some(dissector) = dissector() else { return };
    let folder = tempfile::tempdir().unwrap();
    let manual = std::fs::read_to_string(root().join("docs/protocol.md")).unwrap();
    let rows: Vec<(&str, &str)> = manual
        .lines()
        .filter_map(|line| {
            let (says, frame) = line.strip_prefix("| ")?.split_once(" | `")?;
            Some((says, frame.strip_suffix("` |").filter(|frame| frame.contains('#'))?))
        })
        .collect();
    let log: String = rows
        .iter()
        .enumerate()
        .map(|(at, (_, frame))| format!("(1700000000.{at:06}) can0 {frame}\n"))
        .collect();
    let (log_file, file) = (folder.path().join("all.log"), folder.path().join("all.pcapng"));
    std::fs::write(&log_file, log).unwrap();
    let file = file.display().to_string();
    printed(&["record", &file, "-l", &format!("log:{}", log_file.display())]);
    let fields = fields_of(&dissector);
    let mut asked = vec!["cosmic.message"];
    asked.extend(fields.iter().map(String::as_str));
    let lines = shown(&dissector, &file, "cosmic", &asked);
    assert_eq!(lines.len(), rows.len());
    for ((says, frame), line) in rows.iter().zip(&lines) {
        let mut columns = line.split('\t');
        let message = columns.next().unwrap();
        assert!(!message.is_empty(), "{says}, {frame}: {line}");
        let mut of_it = fields
            .iter()
            .zip(columns)
            .filter(|(field, _)| field.starts_with(&format!("cosmic.{message}.")))
            .peekable();
        // A probe has no field.
        assert!(
            of_it.peek().is_none() || of_it.any(|(_, value)| !value.is_empty()),
            "{says}, {frame}: {line}"
        );
    }
}

/// The fields that the dissector knows of messages and contents.
fn fields_of(dissector: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(dissector).unwrap();
    let names = text.split('"').filter(|name| name.starts_with("cosmic.") && name.matches('.').count() == 2);
    let fields: Vec<String> = names.map(str::to_owned).collect();
    assert!(fields.len() > 40, "{fields:?}");
    fields
}

#[test]
fn the_page_about_records_shows_what_tshark_prints() {
    let Some(dissector) = dissector() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fault.pcapng").display().to_string();
    printed(&["record", &file, "-l", "log:docs/tasks/late.log"]);
    let fields = ["frame.time_relative", "cosmic.priority", "cosmic.publisher", "cosmic.attitude.yaw"];
    let filter = "cosmic.channel == attitude && cosmic.priority < 5";
    let lines = shown(&dissector, &file, filter, &fields);
    let page = std::fs::read_to_string(root().join("docs/tasks/record-and-replay-a-fault.md")).unwrap();
    let block = format!("```text\n{}\n```", lines[..3].join("\n"));
    assert!(page.contains(&block), "the page does not hold this:\n{block}");
    assert!(page.contains(filter), "the page does not hold the filter `{filter}`");
}
