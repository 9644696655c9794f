//! The program: killed at any instant, watched by systemd, asked for metrics, ended in order.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration as Span;

use crate::bed::{HEAT_TABLE, Running, Segment, Setup, port, until};
use cosmic_core::event_layer::{Channel, Importance, NonRealTimeAttributes};
use cosmic_core::{NodeUid, Subject};
use cosmic_gateway::table::Table;
use cosmic_linux::link::segment::SegmentLink;
use cosmic_linux::{Config, Node};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

fn program(config: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cosmic-gateway"));
    command.arg(config).stderr(Stdio::piped()).stdout(Stdio::piped());
    command
}

/// SIGTERM. Returns what it logged, if it ended in order.
fn terminate(mut program: Running) -> String {
    let id = program.0.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
    let mut log = String::new();
    // To the end, which is that of the program.
    std::io::Read::read_to_string(&mut program.0.stderr.take().unwrap(), &mut log).unwrap();
    let status = program.0.wait().unwrap();
    assert!(status.success(), "{status}: {log}");
    log
}

/// A channel without a fixed etag.
fn channel(number: u64) -> Channel<u8> {
    let quality = NonRealTimeAttributes { importance: Importance::LEAST, validity: None };
    Channel::non_real_time(Subject::new(0xC05A_0000_0001_0000 + number).unwrap(), quality)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_broker_that_is_killed_again_and_again_keeps_its_word() {
    let bus = Segment::start().await;
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("table");
    let more = format!("broker = {:?}", table.display().to_string());
    let (listen, connect, channels) = (port(), &[], HEAT_TABLE);
    let setup = Setup { segment: "plant", bus: &bus, tx_node: 100, listen, connect, more: &more, channels };
    let file = folder.path().join("gateway.toml");
    std::fs::write(&file, setup.text()).unwrap();
    // Nodes that know no id and no etag, and ask for ever more.
    let nodes: Vec<_> = (1..=4_u64)
        .map(|number| {
            Node::start(Config::new(NodeUid::new(0xAFFE_0000 + number).unwrap()), SegmentLink::new(&bus.path))
                .unwrap()
        })
        .collect();
    let mut publishers = Vec::new();
    let mut known = Vec::new();
    for round in 0..8_u64 {
        let mut child = Running::start(&mut program(&file));
        for (number, node) in nodes.iter().enumerate() {
            publishers.push(node.announce(&channel(100 * round + number as u64)).unwrap());
        }
        let at_least = publishers.len() - usize::from(round % 2 == 1) * 3;
        let bound = || publishers.iter().filter(|it| it.node().etag_of(it.subject()).is_some()).count();
        until("etags are handed out", || bound() >= at_least).await;
        // In the midst of writing, as often as not.
        tokio::time::sleep(Span::from_micros(3_000 * round)).await;
        child.kill();
        let text = std::fs::read_to_string(&table).unwrap();
        let stored = Table::open(&table).unwrap_or_else(|why| panic!("round {round}: {why}\n{text}"));
        // What stood there once still does.
        for entry in &known {
            assert!(stored.contents().subjects.contains(entry), "round {round}: {entry:?}");
        }
        known = stored.contents().subjects.clone();
    }
    let child = Running::start(&mut program(&file));
    let all = || publishers.iter().all(|it| it.node().etag_of(it.subject()).is_some());
    until("all have etags", all).await;
    until("the table has them all", || {
        let stored = std::fs::read_to_string(&table).unwrap();
        publishers.iter().all(|it| stored.contains(&it.subject().to_string()))
    })
    .await;
    tokio::task::block_in_place(|| terminate(child));
    let stored = Table::open(&table).unwrap();
    for publisher in &publishers {
        let entry = (publisher.subject(), publisher.node().etag_of(publisher.subject()).unwrap());
        assert!(stored.contents().subjects.contains(&entry), "{entry:?}");
    }
    for node in &nodes {
        assert!(stored.contents().nodes.iter().any(|(_, tx_node)| Some(*tx_node) == node.tx_node()));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn systemd_hears_that_it_runs_that_it_lives_and_that_it_ends() {
    let bus = Segment::start().await;
    let folder = tempfile::tempdir().unwrap();
    let metrics = port();
    let (listen, connect, more, channels) = (port(), &[], "", HEAT_TABLE);
    let setup = Setup { segment: "plant", bus: &bus, tx_node: 100, listen, connect, more, channels };
    let text = setup.text().replace("[ip]", &format!("metrics = \"127.0.0.1:{metrics}\"\n[ip]"));
    let file = folder.path().join("gateway.toml");
    std::fs::write(&file, text).unwrap();
    let socket = folder.path().join("notify");
    let systemd = UnixDatagram::bind(&socket).unwrap();
    systemd.set_read_timeout(Some(crate::bed::PATIENCE)).unwrap();
    let hear = || {
        let mut bytes = [0; 4096];
        let len = systemd.recv(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes[..len]).into_owned()
    };
    // As systemd starts it.
    let line = format!("WATCHDOG_PID=$$ exec {} {}", env!("CARGO_BIN_EXE_cosmic-gateway"), file.display());
    let mut command = Command::new("sh");
    command.args(["-c", &line]).stderr(Stdio::piped());
    let child = Running::start(command.env("NOTIFY_SOCKET", &socket).env("WATCHDOG_USEC", "300000"));
    let ready = tokio::task::block_in_place(hear);
    assert!(ready.contains("READY=1") && ready.contains("1 segments of network test"), "{ready}");
    for _ in 0..3 {
        assert_eq!(tokio::task::block_in_place(hear).trim(), "WATCHDOG=1");
    }
    let mut stream = TcpStream::connect(("127.0.0.1", metrics)).await.unwrap();
    stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n").await.unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    let line = "cosmic_gateway_events_total{segment=\"plant\",direction=\"In\",outcome=\"Expired\"} 0";
    assert!(answer.contains(line) && answer.trim_end().ends_with("# EOF"), "{answer}");
    let log = tokio::task::block_in_place(|| terminate(child));
    let told = std::iter::repeat_with(hear).take(50).any(|text| text.contains("STOPPING=1"));
    assert!(told);
    assert!(log.contains("ended in order"), "{log}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_wrong_is_told_in_one_line() {
    let bus = Segment::start().await;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("gateway.toml");
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    let (connect, channels) = (&[], HEAT_TABLE);
    let setup = |listen: u16, more: &'static str| {
        Setup { segment: "plant", bus: &bus, tx_node: 100, listen, connect, more, channels }.text()
    };
    let free = port();
    let with_metrics = setup(free, "").replace("[ip]", &format!("metrics = \"{address}\"\n[ip]"));
    let with_tls = setup(free, "").replace("tcp/", "tls/").replace(
        "[[segment]]",
        "[ip.tls]\nauthority = \"none.pem\"\ncertificate = \"none.pem\"\nkey = \"none.key\"\n[[segment]]",
    );
    for (text, code, expected) in [
        (
            setup(free, "colour = 1"),
            2,
            "segment.plant.colour: is not a field that is known here; the fields here are: name, link, uid",
        ),
        (setup(address.port(), ""), 3, "another program listens at"),
        (with_metrics, 3, "metrics cannot be served at"),
        (with_tls, 3, "none.pem cannot be read"),
        (setup(free, "broker = \"no/such/folder/table\""), 3, "its folder must exist and be writable"),
    ] {
        std::fs::write(&file, text).unwrap();
        let output = program(&file).env("RUST_LOG", "off").output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{told}");
        assert!(told.contains(expected) && told.trim_end().lines().count() == 1, "{told}");
    }
    let checked = program(&file).arg("--check").output().unwrap();
    assert!(checked.status.success());
    let missing = program(&folder.path().join("none.toml")).output().unwrap();
    assert_eq!(missing.status.code(), Some(2));
}
