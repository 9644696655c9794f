//! What tshark shows of frames by the exported dissector.

use crate::exported::file;
use crate::tools::{Program, find};
use crate::zoo::{Dice, events, folder, grown_zoo, hex, read};
use cosmic_plan::contents::Value;
use cosmic_plan::output::lua;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

/// A log as candump writes it, read by tshark with the dissector.
fn dissected(folder: &Path, tshark: &Path, frames: &[String], fields: &[&str]) -> Vec<String> {
    let mut log = String::new();
    for (at, frame) in frames.iter().enumerate() {
        writeln!(log, "(0000000001.{at:06}) can0 {frame}").unwrap();
    }
    file(folder, "candump.log", log);
    let mut command = Command::new(tshark);
    command.current_dir(folder).args(["-X", "lua_script:segment.lua", "-r", "candump.log", "-T", "fields"]);
    for field in fields {
        command.args(["-e", field]);
    }
    let output = command.output().expect("tshark starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !said.contains("Error"), "{said}");
    String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect()
}

#[test]
fn wireshark_names_every_control_message() {
    let Some(tshark) = find(&Program::Tshark) else { return };
    let folder = folder("control");
    let cluster = read(include_str!("../../examples/rover.toml"));
    file(&folder, "segment.lua", lua::render(&cluster, "rover.toml"));
    // The frames of the manual, which a test of the core holds true.
    let manual = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/protocol.md");
    let manual = std::fs::read_to_string(manual).expect("it is there");
    let rows: Vec<(&str, String)> = manual
        .lines()
        .filter_map(|line| {
            let (says, frame) = line.strip_prefix("| ")?.split_once(" | `")?;
            Some((says, frame.strip_suffix("` |").filter(|frame| frame.contains('#'))?.to_owned()))
        })
        .collect();
    assert!(rows.len() >= 27, "{}", rows.len());
    let frames: Vec<String> = rows.iter().map(|(_, frame)| frame.clone()).collect();
    let columns = dissected(&folder, &tshark, &frames, &["cosmic.message", "_ws.col.Info", "_ws.expert"]);
    for ((says, frame), columns) in rows.iter().zip(&columns) {
        let mut columns = columns.split('\t');
        let name = columns.next().unwrap_or("").replace('_', " ");
        let kind = says.split([',', ':']).next().unwrap_or("").to_lowercase();
        // `Admission request 3 again: ..` is one of several of its kind.
        let name = name.replace("follow up", "follow-up");
        let rest = kind.strip_prefix(&name).filter(|rest| rest.is_empty() || rest.starts_with(' '));
        assert!(rest.is_some() && !name.is_empty(), "{frame}: {says}, named {name}");
        let info = columns.next().unwrap_or("");
        assert!(!info.contains("instead of"), "{frame}: {info}");
    }
    let of = |name: &str| {
        rows.iter().position(|(says, _)| says.contains(name)).map(|at| columns[at].clone()).unwrap()
    };
    let status = of("HRT inhibited, TEC 128");
    for part in [
        "HRT inhibited (2)",
        "transmit_errors: 128",
        "receive_errors: 5",
        "sequence: 7",
        "exceptions: 258",
        "uptime: 3600 s",
    ] {
        assert!(status.contains(part), "{part} is not in {status}");
    }
    let interest = of("announces etag 0x3FFE, SRT, for 3.0 s");
    for part in ["announces (1)", "etag: 16382", "SRT (1)", "lease: 30 x 0.1 s", "deadbeef"] {
        assert!(interest.contains(part), "{part} is not in {interest}");
    }
    assert!(of("Follow-up").contains("sent_at: 1000000000 ns"), "{}", of("Follow-up"));
}

/// Its list of frames is made without looking into them.
#[test]
fn the_list_of_frames_has_the_fields() {
    let Some(tshark) = find(&Program::Tshark) else { return };
    let folder = folder("list");
    let cluster = read(include_str!("../../examples/rover.toml"));
    file(&folder, "segment.lua", lua::render(&cluster, "rover.toml"));
    file(&folder, "candump.log", "(1.000000) can0 02217FFD#020FA0\n");
    let mut command = Command::new(tshark);
    command.current_dir(&folder).args(["-X", "lua_script:segment.lua", "-r", "candump.log"]);
    let said = String::from_utf8_lossy(&command.output().expect("tshark starts").stdout).into_owned();
    assert!(said.trim_end().ends_with("gripper: state: holding (2), force: 12.5 N"), "{said}");
}

/// The fields of every content, whatever the priority and the sender.
#[test]
fn wireshark_shows_the_fields_that_the_host_reads() {
    let Some(tshark) = find(&Program::Tshark) else { return };
    let folder = folder("wireshark");
    let cluster = read(&grown_zoo(20));
    file(&folder, "segment.lua", lua::render(&cluster, "zoo.toml"));
    let mut dice = Dice(7);
    let (mut frames, mut expected) = (Vec::new(), Vec::new());
    for channel in &cluster.channels {
        let Some(layout) = cluster.layout_of(channel).filter(|layout| layout.len <= 8) else { continue };
        for event in events(layout, 6) {
            if event.len() > 8 {
                continue;
            }
            let id = (1 + dice.below(255)) << 21
                | (1 + dice.below(126)) << 14
                | u64::from(channel.etag.unwrap().get());
            frames.push(format!("{id:08X}#{}", hex(&event)));
            expected.push((channel.name.as_str(), layout, event));
        }
    }
    assert!(frames.len() > 100, "{}", frames.len());
    let columns =
        dissected(&folder, &tshark, &frames, &["cosmic.channel", "cosmic.malformed", "_ws.col.Info"]);
    assert_eq!(columns.len(), frames.len());
    for ((name, layout, event), line) in expected.iter().zip(&columns) {
        let mut columns = line.split('\t');
        assert_eq!(columns.next(), Some(*name), "{line}");
        let malformed = columns.next().is_some_and(|text| !text.is_empty());
        let info = columns.next().unwrap_or("");
        let Ok(fields) = layout.decode(event) else {
            assert!(malformed, "{} {}: {line}", layout.name, hex(event));
            continue;
        };
        assert!(!malformed, "{} {}: {line}", layout.name, hex(event));
        for field in fields.iter().filter(|field| !matches!(field.value, Value::List(_))) {
            let shown = info.split(", ").chain(info.split(": ").skip(1)).find_map(|part| {
                let (_, rest) = part.rsplit_once(&format!("{}: ", field.name))?;
                Some(rest.to_owned())
            });
            let shown = shown.unwrap_or_else(|| panic!("{} is not in {info}", field.name));
            assert_value(&field.value, &shown, info);
        }
    }
}

/// Wireshark shows floats with fewer digits, and names with their number.
fn assert_value(value: &Value, shown: &str, line: &str) {
    let shown = shown.split(' ').next().unwrap_or("");
    let number = match value {
        Value::Boolean(value) => return assert_eq!(shown.to_lowercase(), value.to_string(), "{line}"),
        Value::Label { name, .. } => return assert_eq!(shown, name, "{line}"),
        Value::Integer(raw) => return assert_eq!(shown, raw.to_string(), "{line}"),
        Value::Single(value) => f64::from(*value),
        Value::Double(value) => *value,
        Value::Scaled(value) => value.as_f64(),
        Value::List(_) => return,
    };
    let shown: f64 = shown.parse().unwrap_or(f64::NAN);
    let close = (number - shown).abs() <= 1e-5 * number.abs().max(1e-300) || number.is_nan();
    assert!(close, "{number} is shown as {shown}: {line}");
}
