//! The trace for Perfetto, checked against the Trace Event Format: what a reader needs is there, slices of a track lie in
//! each other or apart, arrows touch slices.
//!
//! `cargo xtask test emulated` builds the images and names their directory in `COSMIC_IMAGES`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;
use std::{env, fs};

use serde::Deserialize;
use serde_json::Value;

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct Document {
    display_time_unit: String,
    trace_events: Vec<Event>,
}

#[derive(Deserialize, Debug)]
#[serde(deny_unknown_fields)]
struct Event {
    name: String,
    cat: String,
    ph: String,
    ts: f64,
    dur: Option<f64>,
    pid: u32,
    tid: u32,
    id: Option<u64>,
    bp: Option<String>,
    s: Option<String>,
    args: Option<Value>,
}

impl Event {
    fn track(&self) -> (u32, u32) {
        (self.pid, self.tid)
    }

    /// In nanoseconds.
    fn span(&self) -> (u64, u64) {
        let from = (self.ts * 1e3).round() as u64;
        (from, from + (self.dur.unwrap_or(0.0) * 1e3).round() as u64)
    }
}

/// A second of the example, with its report.
fn run() -> (Document, Value) {
    let images = env::var_os("COSMIC_IMAGES");
    let images = images.expect("COSMIC_IMAGES names no directory of images: run `cargo xtask test emulated`");
    let scratch = env::temp_dir().join(format!("cosmic-demo-perfetto-{}", std::process::id()));
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../cosmic-plan/examples/vehicle.toml");
    let mut demo = Command::new(env!("CARGO_BIN_EXE_demo"));
    demo.arg("--cluster").arg(example).arg("--images").arg(images).arg("--out").arg(&scratch);
    demo.args(["--seconds", "1", "--errors", "0.3", "--trace"]).arg(scratch.join("trace.json"));
    fs::create_dir_all(&scratch).unwrap();
    let output = demo.arg("--json").arg(scratch.join("report.json")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    let read = |name| fs::read(scratch.join(name)).unwrap();
    let document = serde_json::from_slice(&read("trace.json")).unwrap();
    let report = serde_json::from_slice(&read("report.json")).unwrap();
    fs::remove_dir_all(scratch).unwrap();
    (document, report)
}

#[test]
fn a_reader_of_the_format_finds_tasks_frames_slots_and_the_way_of_each_event() {
    let (document, report) = run();
    assert_eq!(document.display_time_unit, "ns");
    let events = &document.trace_events;
    let kinds: BTreeSet<_> = events.iter().map(|event| event.ph.as_str()).collect();
    assert_eq!(kinds, ["M", "X", "f", "i", "s", "t"].into());
    let tracks = named_tracks(events);
    let has = |process: &str, thread: &str| {
        tracks.values().any(|(of, name)| of == process && name.starts_with(thread))
    };
    assert!(has("bus", "frames") && has("calendar", "slot of wheel_speed"));
    for node in ["sensor", "brake", "diagnostics"] {
        for thread in ["calendar task", "event half", "application", "timer", "published", "exceptions"] {
            assert!(has(node, thread), "{node} has no track {thread}: {tracks:?}");
        }
    }
    let slices = slices(events);
    arrows(events, &slices, &report);
    let destroyed = events.iter().filter(|event| event.cat == "destroyed").count();
    assert_eq!(Some(destroyed as u64), report["bus"]["failed_attempts"].as_u64());
    let instants: Vec<_> = events.iter().filter(|event| event.ph == "i").collect();
    assert!(instants.iter().all(|event| event.s.as_deref() == Some("t")));
    let told = report["exceptions"].as_array().unwrap().iter().map(|it| it["count"].as_u64().unwrap());
    assert_eq!(instants.len() as u64, told.sum::<u64>());
}

/// Each track that is used has a name, and its process has one.
fn named_tracks(events: &[Event]) -> BTreeMap<(u32, u32), (String, String)> {
    let name = |event: &Event| event.args.as_ref().unwrap()["name"].as_str().unwrap().to_owned();
    let with = |what: &'static str| events.iter().filter(move |event| event.ph == "M" && event.name == what);
    let processes: BTreeMap<_, _> = with("process_name").map(|event| (event.pid, name(event))).collect();
    let threads =
        with("thread_name").map(|event| (event.track(), (processes[&event.pid].clone(), name(event))));
    let threads: BTreeMap<_, _> = threads.collect();
    for event in events.iter().filter(|event| event.ph != "M") {
        assert!(threads.contains_key(&event.track()), "{event:?} stands on a track without a name");
    }
    let numbers: BTreeSet<_> = threads.keys().map(|(_, tid)| tid).collect();
    assert_eq!(numbers.len(), threads.len(), "two tracks have one number");
    threads
}

type Slices = BTreeMap<(u32, u32), Vec<(u64, u64)>>;

/// The slices by track, in the order of time. Those of one track lie in each other or apart.
fn slices(events: &[Event]) -> Slices {
    let mut tracks = Slices::new();
    for event in events.iter().filter(|event| event.ph == "X") {
        assert!(event.dur.is_some_and(|dur| dur >= 0.0), "{event:?}");
        tracks.entry(event.track()).or_default().push(event.span());
    }
    for (track, slices) in &mut tracks {
        slices.sort_by_key(|(from, until)| (*from, std::cmp::Reverse(*until)));
        let mut around: Vec<(u64, u64)> = Vec::new();
        for &(from, until) in slices.iter() {
            around.retain(|outer| outer.1 > from);
            let fits = around.iter().all(|outer| until <= outer.1);
            assert!(fits, "slices of {track:?} overlap at {from} ns: {around:?}, {until}");
            around.push((from, until));
        }
    }
    tracks
}

/// Each arrow begins at a publication, leads over a frame, and ends at a delivery; all deliveries have one.
fn arrows(events: &[Event], slices: &Slices, report: &Value) {
    let mut arrows: BTreeMap<u64, Vec<&Event>> = BTreeMap::new();
    for event in events.iter().filter(|event| matches!(event.ph.as_str(), "s" | "t" | "f")) {
        let at = event.span().0;
        let touched = slices[&event.track()].iter().any(|(from, until)| (*from..=*until).contains(&at));
        assert!(touched, "{event:?} touches no slice");
        assert_eq!(event.bp.as_deref() == Some("e"), event.ph == "f");
        arrows.entry(event.id.unwrap()).or_default().push(event);
    }
    for arrow in arrows.values() {
        let kinds: Vec<_> = arrow.iter().map(|event| event.ph.as_str()).collect();
        assert_eq!(kinds, ["s", "t", "f"], "{arrow:?}");
        assert!(arrow.is_sorted_by_key(|event| event.span().0), "{arrow:?}");
        assert!(arrow.iter().all(|event| event.name == arrow[0].name));
    }
    let of_channel = |channel: &Value| channel["subscribers"].as_array().unwrap().clone();
    let subscribers = report["channels"].as_array().unwrap().iter().flat_map(of_channel);
    let count = |it: Value| it["delivered"].as_u64().unwrap() + it["duplicates"].as_u64().unwrap();
    assert_eq!(arrows.len() as u64, subscribers.map(count).sum::<u64>());
}
