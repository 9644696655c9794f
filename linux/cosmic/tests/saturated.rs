//! A bus of 1 Mbit/s that is full: more than 8 000 frames a second are recorded, decoded and shown by `top`, none is lost.
//!
//! A server of socketcand sends them as such a bus would. What is asserted is what arrives; how much of a core that
//! takes is printed:
//!
//! ```sh
//! cargo test --release -p cosmic-cli --test saturated -- --nocapture
//! ```

mod common;

use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use common::terminal::Terminal;
use common::{CLUSTER, Running, printed, text};
use cosmic_bus::WireFrame;
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, Priority, TxNode};

const FRAMES: usize = 40_000;

/// The frames of a full bus, each with the instant of its end: events of all classes and of 40 nodes, some with contents
/// that the rover's file describes.
fn traffic() -> Vec<(Duration, Frame)> {
    let mut at = Duration::ZERO;
    let frames = (0..FRAMES as u64).map(|number| {
        // Every tenth is an attitude: 5 fields.
        let bytes = number.wrapping_mul(0x9E37_79B9_7F4A_7C15).to_be_bytes();
        let (etag, payload) = match number % 10 {
            0 => (16_383, Payload::new(&[0xC4, 0x00, 0x62, 0x00, 0xCE, 0x22, 0x19]).unwrap()),
            _ => (1_024 + number * 7 % 300, Payload::truncated(bytes, 6)),
        };
        let priority = if number % 3 == 0 { 252 } else { 1 + number % 200 };
        let node = TxNode::new((number % 40) as u8).unwrap();
        let id = Id::new(Priority::new(priority as u8), node, Etag::new(etag as u16).unwrap());
        let frame = Frame::new(id, payload);
        // With the space behind it.
        let bits = WireFrame::from(frame).bit_count() + 3;
        at += Duration::from_nanos(BitRate::MAX.bits(bits).as_ticks());
        (at, frame)
    });
    frames.collect()
}

/// Serves the traffic to each of so many clients, as time goes by. Returns the address.
fn socketcand(clients: usize, traffic: &[(Duration, Frame)]) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let lines: Vec<(Duration, String)> = traffic.iter().map(|(at, frame)| (*at, line(*at, frame))).collect();
    std::thread::spawn(move || {
        let streams: Vec<TcpStream> = (0..clients).map(|_| greeted(listener.accept().unwrap().0)).collect();
        let begun = Instant::now();
        let mut sent = 0;
        while sent < lines.len() {
            let due = lines[sent..].iter().take_while(|(at, _)| *at <= begun.elapsed()).count();
            let text: String = lines[sent..sent + due].iter().map(|(_, line)| line.as_str()).collect();
            for mut stream in &streams {
                stream.write_all(text.as_bytes()).unwrap();
            }
            sent += due;
            std::thread::sleep(Duration::from_millis(5));
        }
        // Those who still read may go on: the connection stays until they have left.
        for mut stream in &streams {
            let _ = stream.read(&mut [0]);
        }
    });
    address
}

fn line(at: Duration, frame: &Frame) -> String {
    let id = frame.id.raw();
    let mut line = format!("< frame {id:08X} {}.{:06} ", at.as_secs(), at.subsec_micros());
    frame.payload.as_slice().iter().for_each(|byte| write!(line, "{byte:02X}").unwrap());
    line + " >"
}

/// The beginning of the protocol.
fn greeted(mut stream: TcpStream) -> TcpStream {
    stream.write_all(b"< hi >").unwrap();
    for _ in ["open", "rawmode"] {
        let mut byte = [0];
        while byte[0] != b'>' {
            stream.read_exact(&mut byte).unwrap();
        }
        stream.write_all(b"< ok >").unwrap();
    }
    stream
}

/// The time that children of this process that have ended have used of the processors. proc(5): cutime and cstime.
fn used_by_children() -> Duration {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    let ticks: u64 = fields[13].parse::<u64>().unwrap() + fields[14].parse::<u64>().unwrap();
    // USER_HZ is 100 on all that Linux runs on today.
    Duration::from_millis(10 * ticks)
}

#[test]
fn a_full_bus_is_recorded_decoded_and_shown_without_loss() {
    let traffic = traffic();
    let length = traffic.last().unwrap().0;
    let per_second = FRAMES as f64 / length.as_secs_f64();
    assert!(per_second > 8_000.0, "{per_second}");
    let link = format!("socketcand:{}", socketcand(2, &traffic));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("full.pcapng").display().to_string();
    let rate = ["--bit-rate", "1 Mbit/s"];
    let count = FRAMES.to_string();
    let recorder = Running::start(&["record", &file, "-n", &count, "-l", &link, rate[0], rate[1]]);
    let mut top = Terminal::start(&["top", "-l", &link, rate[0], rate[1]], &[], (36, 120));
    let told = |what: &str, before: Duration| {
        let used = used_by_children() - before;
        let share = 100.0 * used.as_secs_f64() / length.as_secs_f64();
        println!("{what}: {FRAMES} frames, {per_second:.0} a second: {share:.1} % of one core");
    };

    let before = used_by_children();
    let recorded = recorder.wait();
    told("record", before);
    let said = text(&recorded.stderr);
    assert!(
        recorded.status.success() && said.contains(&format!("{FRAMES} frames recorded, 0 lost")),
        "{said}"
    );

    let screen = top.shows(&format!("{FRAMES} frames in"));
    assert!(screen.contains("lost 0") && screen.contains("40 nodes"), "{screen}");
    let before = used_by_children();
    top.press("q");
    assert_eq!(top.ends(), 0);
    told("top", before);

    let before = used_by_children();
    let decoded = printed(&["decode", &file, "-c", CLUSTER]);
    told("decode", before);
    assert_eq!(decoded.lines().count(), FRAMES);
    assert_eq!(decoded.lines().filter(|line| line.contains("attitude roll=")).count(), FRAMES / 10);
    // Frame by frame what was sent, in order.
    let log = printed(&["record", "-", "-l", &format!("log:{file}")]);
    let recorded = log.lines().map(|line| line.rsplit(' ').next().unwrap().to_owned());
    let sent = traffic.iter().map(|(_, frame)| {
        let bytes: String = frame.payload.as_slice().iter().map(|byte| format!("{byte:02X}")).collect();
        format!("{:08X}#{bytes}", frame.id.raw())
    });
    assert!(recorded.eq(sent));
}
