//! The command as its users call it, in the folder of the repository.
#![allow(dead_code, reason = "no test uses all of it")]

#[path = "../../../monitor/tests/bed/mod.rs"]
pub(crate) mod bed;
pub(crate) mod gateway;
pub(crate) mod terminal;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use bed::Bed;
use cosmic_bus::trace::{Candump, TraceEvent, TraceKind};
use cosmic_bus::{VirtualInstant, WireFrame};

/// The folder of the repository.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

pub(crate) const CLUSTER: &str = "cosmic-plan/examples/rover.toml";

pub(crate) fn cosmic(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cosmic"));
    command.current_dir(root()).args(arguments).env_remove("COSMIC_LINK").env_remove("COSMIC_CLUSTER");
    command.env_remove("COSMIC_NETWORK");
    command.env_remove("NO_COLOR").stdin(Stdio::null());
    command
}

pub(crate) fn run(arguments: &[&str]) -> Output {
    cosmic(arguments).output().unwrap()
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// What it prints, if all is well.
pub(crate) fn printed(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

pub(crate) fn json(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_str(&printed(arguments)).unwrap()
}

/// A program that ends with the test.
pub(crate) struct Running(pub(crate) Child);

impl Running {
    pub(crate) fn start(arguments: &[&str]) -> Self {
        Self(cosmic(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
    }

    pub(crate) fn wait(mut self) -> Output {
        let (mut out, mut errors) = (self.0.stdout.take().unwrap(), self.0.stderr.take().unwrap());
        let read = |stream: &mut dyn std::io::Read| {
            let mut bytes = Vec::new();
            stream.read_to_end(&mut bytes).unwrap();
            bytes
        };
        let (stdout, stderr) = (read(&mut out), read(&mut errors));
        Output { status: self.0.wait().unwrap(), stdout, stderr }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A simulated segment in real time.
pub(crate) struct Segment {
    folder: tempfile::TempDir,
    _server: Running,
}

impl Segment {
    pub(crate) fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segment");
        let server = Running::start(&["segment", path.to_str().unwrap()]);
        let segment = Self { folder, _server: server };
        until("the segment is served", || path.exists());
        segment
    }

    pub(crate) fn link(&self) -> String {
        format!("sim:{}", self.folder.path().join("segment").display())
    }

    pub(crate) fn file(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }
}

/// Waits for what another program does.
pub(crate) fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !holds() {
        assert!(begun.elapsed() < Duration::from_secs(60), "in a minute not: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Frames as candump writes them, from an instant of the wall's clock on.
pub(crate) fn log_of(frames: &[(VirtualInstant, WireFrame)]) -> String {
    let mut candump = Candump::new(Vec::new());
    let mut bus = cosmic_bus::Bus::new(cosmic_core::can::BitRate::MAX, cosmic_bus::FaultModel::none());
    let station = bus.attach("any");
    for (number, (at, frame)) in frames.iter().enumerate() {
        let at = VirtualInstant::from_ticks(at.as_ticks() + STARTED_S * 1_000_000_000);
        let kind = TraceKind::FrameEnd { number: number as u64, station, frame: *frame, bits: 0 };
        candump.write(&TraceEvent { at, kind }).unwrap();
    }
    text(&candump.into_inner())
}

/// The first seconds of a healthy rover.
pub(crate) fn rover_log() -> String {
    let mut bed = Bed::rover().power_on();
    bed.run(2_400);
    log_of(&bed.log)
}

/// The same while a tool that nobody planned sends bursts of the most urgent soft real-time frames.
pub(crate) fn late_log() -> String {
    use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
    let mut bed = Bed::rover().power_on();
    // Now an event of `attitude` has just been published, and waits until it is as urgent as the burst.
    bed.run(808);
    let id = Id::new(Priority::SOFT_MOST_URGENT, TxNode::new(0x70).unwrap(), Etag::new(0x2000).unwrap());
    for tenth in 0..16_000 {
        // Twelve milliseconds of every half second.
        if tenth % 5_000 < 120 {
            bed.send(bed.stranger, Frame::new(id, Payload::full([0x5A; 8])));
        }
        bed.run_for_a_tenth();
    }
    log_of(&bed.log)
}

const STARTED_S: u64 = 1_700_000_000;
