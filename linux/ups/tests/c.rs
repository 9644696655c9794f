//! A program in C, compiled against the header, exchanges events with a node in Rust on a simulated segment; and the
//! header says what the library has.

use std::fmt::Write as _;
use std::fs;
use std::mem::{align_of, offset_of, size_of};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use cosmic_bus::{Bus, FaultModel};
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::event_layer::{Channel, Depth, Policy, SoftAttributes};
use cosmic_core::{Subject, time};
use cosmic_linux::link::segment::{Options, SegmentLink, SimulatedSegment, serve};
use cosmic_linux::{Config, Node, Tap};
use cosmic_ups::layout::{self, MsgObj, UpsCounts, UpsQuality, UpsSettings};
use tokio::runtime::Runtime;

const NEEDED: &str = "a C compiler runs as `cc`: install Debian's `gcc` and `libc6-dev`";

/// In a folder of its own, which ends with the test.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn link(&self) -> String {
        format!("sim:{}", self.path("segment").display())
    }

    /// Compiles without a warning, and links with the library.
    fn compile(&self, source: &Path) -> PathBuf {
        let (program, library) = (self.path("program"), library());
        let mut cc = Command::new("cc");
        cc.args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-pthread", "-o"]);
        cc.arg(&program).arg(source).arg("-I").arg(manifest("include"));
        cc.arg("-L").arg(&library).args(["-lcosmic_ups"]).arg(format!("-Wl,-rpath,{}", library.display()));
        let output = cc.output().expect(NEEDED);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        program
    }

    /// Compiles the tests, and runs them with a segment and its peers.
    fn run(&self, arguments: &[&str]) {
        let program = self.compile(&manifest("tests/exchange.c"));
        let printed = self.printed(&program, arguments);
        assert!(printed.ends_with("all is well\n"), "{printed}");
    }

    /// Serves a segment and its peers while the program runs. Returns what it prints.
    fn printed(&self, program: &Path, arguments: &[&str]) -> String {
        let runtime = Runtime::new().unwrap();
        let path = self.path("segment");
        runtime.spawn(async move {
            let bus = Bus::new(BitRate::MAX, FaultModel::none());
            let Err(why) = serve(&path, SimulatedSegment::new(bus), Options::default()).await;
            panic!("{why}");
        });
        while !self.path("segment").exists() {
            std::thread::sleep(Duration::from_millis(1));
        }
        runtime.spawn(answer(self.path("segment")));
        runtime.spawn(drive(self.path("segment")));
        runtime.spawn(heat(self.path("segment")));
        // The link stands behind the mode, or alone.
        let (mode, rest) = arguments.split_at(arguments.len().min(1));
        let output = Command::new(program).args(mode).arg(self.link()).args(rest).output().unwrap();
        let (out, errors) =
            (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success(), "{out}{errors}");
        assert_eq!(errors, "", "nothing else is said");
        out.into_owned()
    }
}

fn manifest(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// The folder of the shared library: cargo puts it beside the tests.
fn library() -> PathBuf {
    let beside = std::env::current_exe().unwrap().parent().unwrap().to_owned();
    assert!(beside.join("libcosmic_ups.so").exists(), "{}", beside.display());
    beside
}

const fn channel(subject: u64, etag: u16) -> Channel<Payload> {
    let quality =
        SoftAttributes { deadline: time::Duration::from_millis(50), validity: time::Duration::from_secs(60) };
    Channel::soft(Subject::new(subject).unwrap(), quality).with_etag(Etag::new(etag).unwrap())
}

/// Answers each command with its bytes in reverse; `[0xB0, n]` n times, with a number each.
async fn answer(path: PathBuf) {
    let config = Config::new(cosmic_linux::drawn_uid()).tx_node(TxNode::new(1).unwrap());
    let node = Node::start(config, SegmentLink::new(path)).unwrap();
    let answers = node.announce(&channel(0x52, 5002)).unwrap();
    let policy = Policy::Fifo(Depth::new(254).unwrap());
    let commands = node.subscribe(&channel(0x51, 5001), policy).unwrap();
    answers.bound().await;
    loop {
        let command = commands.next().await.content;
        if let [0xB0, times] = *command.as_slice() {
            for number in 0..times {
                answers.publish(Payload::new(&[number]).unwrap()).unwrap();
            }
            continue;
        }
        let reverse: Vec<u8> = command.as_slice().iter().rev().copied().collect();
        answers.publish(Payload::new(&reverse).unwrap()).unwrap();
    }
}

/// Sends what a publisher of the rover's channel `drive` sends. It is as any foreign frame to the other tests.
async fn drive(path: PathBuf) {
    let plan = cosmic_monitor::SegmentPlan::read(rover()).unwrap();
    let channel = plan.channel(plan.channel_named("drive").unwrap());
    let id = Id::new(Priority::HARD, TxNode::new(1).unwrap(), channel.etag.unwrap());
    let mut content = vec![0; channel.length.into()];
    content[..2].copy_from_slice(&[0x12, 0x34]);
    let mut tap = Tap::start(SegmentLink::new(path));
    loop {
        while tap.try_next().is_some() {}
        let _ = tap.send(Frame::new(id, Payload::new(&content).unwrap())).await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Publishes 21.50 degrees again and again, as node 9.
async fn heat(path: PathBuf) {
    let config = Config::new(cosmic_linux::drawn_uid()).tx_node(TxNode::new(9).unwrap());
    let node = Node::start(config, SegmentLink::new(path)).unwrap();
    let heat = node.announce(&channel(0x2A, 5000)).unwrap();
    heat.bound().await;
    loop {
        heat.publish(Payload::new(&[0x08, 0x66]).unwrap()).unwrap();
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

fn rover() -> PathBuf {
    manifest("../../cosmic-plan/examples/rover.toml")
}

#[test]
#[ignore = "needs a C compiler: cargo xtask test linux"]
fn c_exchanges_events_blocking_and_by_descriptor() {
    Bench::new().run(&["exchange"]);
}

#[test]
#[ignore = "needs a C compiler: cargo xtask test linux"]
fn c_exchanges_messages_longer_than_a_frame() {
    Bench::new().run(&["messages"]);
}

#[test]
#[ignore = "needs a C compiler: cargo xtask test linux"]
fn c_is_told_what_is_wrong_with_its_input() {
    Bench::new().run(&["inputs"]);
}

#[test]
#[ignore = "needs a C compiler: cargo xtask test linux"]
fn c_publishes_and_takes_in_many_threads() {
    Bench::new().run(&["threads"]);
}

#[test]
#[ignore = "needs a C compiler: cargo xtask test linux"]
fn c_uses_the_file_of_the_cluster() {
    Bench::new().run(&["planned", rover().to_str().unwrap()]);
}

/// The program of the documentation, and what it prints.
#[test]
#[ignore = "needs a C compiler: cargo xtask test linux"]
fn the_program_of_the_documentation_prints_what_it_says() {
    let page = fs::read_to_string(manifest("../../docs/c.md")).unwrap();
    let behind = |start: &str, mark: &str| {
        let rest = page.split_once(start).unwrap().1.split_once(mark).unwrap().1;
        rest.split_once("```\n").unwrap().0.to_owned()
    };
    let bench = Bench::new();
    fs::write(bench.path("heat.c"), behind("This is `heat.c`", "```c\n")).unwrap();
    let command = page.lines().find(|line| line.starts_with("cc ")).unwrap();
    let command = command.replace("linux/ups/include", &manifest("include").display().to_string());
    let command = command.replace("$PWD/target/release", "target/release");
    let command = command.replace("target/release", &library().display().to_string());
    let compiled = Command::new("sh").args(["-c", &command]).current_dir(bench.folder.path()).status();
    assert!(compiled.unwrap().success(), "{command}");
    assert_eq!(bench.printed(&bench.path("heat"), &[]), behind("prints:", "```\n"));
}

/// What C must find of a type: its size, alignment and the offset of each field.
macro_rules! facts {
    ($($type:ty = $name:literal { $($field:ident),* })*) => {{
        let mut facts = Vec::new();
        $(
            facts.push((format!("sizeof({})", $name), size_of::<$type>()));
            facts.push((format!("_Alignof({})", $name), align_of::<$type>()));
            $(facts.push((
                format!("offsetof({}, {})", $name, stringify!($field)),
                offset_of!($type, $field),
            ));)*
            // A field that is missing here would be a hole.
            facts.push((
                format!(concat!("0" $(, "+sizeof((({0}*)0)->", stringify!($field), ")")*), $name),
                size_of::<$type>(),
            ));
        )*
        facts
    }};
}

#[test]
#[ignore = "needs a C compiler: cargo xtask test linux"]
fn the_header_says_what_the_library_has() {
    let facts = facts! {
        MsgObj = "msg_obj" {
            subject, deadline_ns, validity_ns, received_at_ns, publisher, length, reserved, data
        }
        UpsSettings = "ups_settings" { cluster, uid, tx_node, bit_rate, patience_ms, reserved }
        UpsQuality = "ups_quality" { deadline_ns, validity_ns, etag, channel_class, importance, reserved }
        UpsCounts = "ups_counts" {
            published, refused, sent, expired, delivered, overflowed, replaced, malformed
        }
    };
    let constants: &[(&str, i64)] = &[
        ("UPS_OK", layout::OK.into()),
        ("UPS_ERR_ARGUMENT", layout::ERR_ARGUMENT.into()),
        ("UPS_ERR_HANDLE", layout::ERR_HANDLE.into()),
        ("UPS_ERR_LINK", layout::ERR_LINK.into()),
        ("UPS_ERR_NOT_BOUND", layout::ERR_NOT_BOUND.into()),
        ("UPS_ERR_REFUSED", layout::ERR_REFUSED.into()),
        ("UPS_ERR_TOO_LONG", layout::ERR_TOO_LONG.into()),
        ("UPS_ERR_DEADLINE", layout::ERR_DEADLINE.into()),
        ("UPS_ERR_QUEUE_FULL", layout::ERR_QUEUE_FULL.into()),
        ("UPS_ERR_TOO_FAST", layout::ERR_TOO_FAST.into()),
        ("UPS_ERR_TIMEOUT", layout::ERR_TIMEOUT.into()),
        ("UPS_ERR_CLOSED", layout::ERR_CLOSED.into()),
        ("UPS_ERR_INTERNAL", layout::ERR_INTERNAL.into()),
        ("UPS_SOFT", layout::SOFT.into()),
        ("UPS_NON_REAL_TIME", layout::NON_REAL_TIME.into()),
        ("UPS_MESSAGES", layout::MESSAGES.into()),
        ("UPS_EVENT_MAX", layout::EVENT_MAX as i64),
        ("UPS_DATA_MAX", layout::DATA_MAX as i64),
        ("UPS_TEXT_MAX", layout::TEXT_MAX as i64),
    ];
    let header = fs::read_to_string(manifest("include/ups.h")).unwrap();
    let defined = header.lines().filter(|line| line.starts_with("#define UPS_")).count();
    // The guard of the header and the initial settings are no numbers.
    assert_eq!(defined, constants.len() + 2, "a constant of the header is not compared");
    let mut source = String::from("#define UPS_NO_SHORT_NAMES\n#include \"ups.h\"\n");
    for (what, value) in &facts {
        writeln!(source, "_Static_assert({what} == {value}, \"{what}\");").unwrap();
    }
    for (what, value) in constants {
        writeln!(source, "_Static_assert({what} == ({value}), \"{what}\");").unwrap();
    }
    // Whoever leaves the short names out may use them.
    source += "int publish(void); int publish(void) { return ups_close(0); }\n";
    source += "int main(void) { return publish() == UPS_ERR_HANDLE ? 0 : 1; }\n";
    let bench = Bench::new();
    fs::write(bench.path("layout.c"), source).unwrap();
    let program = bench.compile(&bench.path("layout.c"));
    assert!(Command::new(program).status().unwrap().success());
}
