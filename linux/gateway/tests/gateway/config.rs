//! The configuration: the example of the documentation, and mistakes.

use std::path::{Path, PathBuf};

use cosmic_core::can::TxNode;
use cosmic_core::protocol::Class;
use cosmic_gateway::config::Config;
use cosmic_gateway::keys::Name;
use cosmic_gateway::rules::Reach;

const DOCUMENTATION: &str = include_str!("../../../../docs/gateway.md");

fn example() -> String {
    let (_, behind) = DOCUMENTATION.split_once("```toml\n").unwrap();
    behind.split_once("```").unwrap().0.to_owned()
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../cosmic-plan/examples")
}

fn read(text: &str) -> Result<Config, String> {
    Config::parse("gateway.toml", text, &folder()).map_err(|problems| problems.to_string())
}

#[test]
fn the_example_of_the_documentation_is_right() {
    let config = read(&example()).unwrap();
    assert_eq!(config.network, Name::new("plant").unwrap());
    let [line, office] = &config.segments[..] else { panic!("two segments") };
    assert_eq!(config.page.map(|page| page.listen.port()), Some(8117));
    assert_eq!(line.tx_node, TxNode::new(90));
    assert!(line.broker.is_some() && office.plan.is_none());
    let [heat, alarm, ..] = &config.channels[..] else { panic!("channels") };
    assert_eq!((heat.class, &heat.from), (Class::Soft, &Reach::Only(vec![Name::new("line-1").unwrap()])));
    assert_eq!(alarm.to, Reach::All);
}

/// Replaces a line of a small configuration that is right.
fn with(line: &str, by: &str) -> String {
    let right = r#"network = "plant"
[ip]
listen = ["tcp/0.0.0.0:7447"]
[[segment]]
name = "line"
link = "can:can0"
uid = "0x6A7E0001"
tx-node = 90
[[channel]]
name = "heat"
subject = "0xC05A"
class = "soft"
deadline = "10 ms"
interval = "10 ms"
"#;
    assert!(read(right).is_ok());
    assert!(right.contains(line), "{line}");
    right.replace(line, by)
}

#[test]
fn each_mistake_is_told_with_its_line_and_a_remedy() {
    for (line, by, expected) in [
        (
            "network = \"plant\"",
            "network = \"The Plant\"",
            "gateway.toml:1:…network: \"The Plant\" is none; write 1 to 32 of a-z",
        ),
        (
            "tx-node = 90",
            "tx-node = 127",
            "gateway.toml:8:…tx-node: 127 is none; write a number from 0 to 126",
        ),
        ("uid = \"0x6A7E0001\"", "", "uid: is missing; write the 64-bit name"),
        ("can:can0", "log:a.log", "gateway.toml:6:…link: \"log:a.log\" is none; write sim:PATH"),
        ("can:can0", "usb", "gateway.toml:6:…link: \"usb\" is none; write sim:PATH"),
        ("class = \"soft\"", "class = \"firm\"", "write \"soft\", \"non-real-time\" or \"hard\""),
        ("deadline = \"10 ms\"", "", "deadline: is missing; write how long"),
        (
            "deadline = \"10 ms\"",
            "deadline = \"10\"",
            "gateway.toml:13:…deadline: \"10\" is none; write a number with its unit",
        ),
        (
            "deadline = \"10 ms\"",
            "deadline = \"10 ms\"\nvalidity = \"1 ms\"",
            "gateway.toml:14:…validity: an event must not expire before its deadline",
        ),
        ("interval = \"10 ms\"", "", "channel.heat.interval: is missing; write a number with its unit"),
        ("interval = \"10 ms\"", "interval = \"0 ms\"", "gateway.toml:14:…interval: \"0 ms\" is none"),
        ("interval = \"10 ms\"", "interval = \"10 ms\"\nburst = 0", "burst: 0 is none; write 1 to 255"),
        ("subject = \"0xC05A\"", "subject = \"0\"", "gateway.toml:11:…subject: \"0\" is none"),
        ("subject = \"0xC05A\"", "subject = \"C05A6A7E00000001\"", "none of the middleware's own"),
        (
            "tcp/0.0.0.0:7447",
            "udp/0.0.0.0:7447",
            "gateway.toml:3:…listen: \"udp/0.0.0.0:7447\" is none; write \"tcp/HOST:PORT\"",
        ),
        ("tcp/0.0.0.0:7447", "tls/0.0.0.0:7447", "needs certificates; add [ip.tls]"),
        (
            "tx-node = 90",
            "tx-nodes = 90",
            "gateway.toml:8:…segment.line.tx-nodes: is not a field that is known here; did you mean `tx-node`?",
        ),
        ("tx-node = 90", "broker = \"table\"", "broker: who hosts the broker needs a fixed id; add tx-node"),
        ("tx-node = 90", "etags = { cold = 5000 }", "etags: there is no channel \"cold\""),
        ("tx-node = 90", "etags = { heat = 100 }", "etags: 100 is none; write an etag from 1024 to 16383"),
        (
            "tx-node = 90",
            "ceiling = 0",
            "gateway.toml:8:…ceiling: 0 is none; write a share of the bus in percent",
        ),
        ("tx-node = 90", "plan = \"nowhere.toml\"", "gateway.toml:8:…plan: "),
        ("class = \"soft\"", "class = \"hard\"", "from: is missing; name the segments in whose calendars"),
        (
            "class = \"soft\"",
            "class = \"hard\"\nfrom = [\"line\"]",
            "the plan of this segment has no such hard real-time channel",
        ),
        (
            "interval = \"10 ms\"",
            "interval = \"10 ms\"\nto = []\nunasked = [\"line\"]",
            "gateway.toml:16:…unasked: the channel may not enter this segment",
        ),
        ("[ip]", "[ip]\nmode = \"star\"", "write \"router\", \"peer\" or \"client\""),
        ("[ip]", "metrics = \"9464\"\n[ip]", "metrics: \"9464\" is none; write an address"),
        (
            "[[segment]]",
            "[[ip.peer]]\ncertificate = \"a\"\nsegments = []\n[[segment]]",
            "peers are told apart by certificates",
        ),
    ] {
        let why = read(&with(line, by)).unwrap_err();
        let is_told = |told: &str| expected.split('…').all(|part| told.contains(part));
        assert!(why.lines().any(is_told), "{line} -> {by}:\n{why}");
        assert!(why.lines().all(|line| line.starts_with("gateway.toml:")), "{why}");
    }
}

#[test]
fn all_mistakes_are_told_at_once() {
    // One of each kind: a field that is none, that is unknown, that is missing, of a wrong type, and what contradicts.
    let text = with("tx-node = 90", "tx-node = 127\nnode = 3\netags = { cold = 5000 }")
        .replace("\"soft\"", "\"firm\"")
        .replace("uid = \"0x6A7E0001\"\n", "")
        .replace("interval = \"10 ms\"", "interval = 10\nto = []\nunasked = [\"line\"]");
    let why = read(&text).unwrap_err();
    let fields: Vec<_> = why.lines().map(|line| line.split(": ").nth(1).unwrap()).collect();
    let expected = [
        "segment.line.uid",
        "segment.line.tx-node",
        "segment.line.node",
        "segment.line.etags",
        "channel.heat.class",
        "channel.heat.interval",
        "channel.heat.unasked",
    ];
    assert_eq!(fields, expected, "{why}");
}

#[test]
fn a_ceiling_is_what_the_plan_leaves_free_or_less() {
    let plan = cosmic_monitor::SegmentPlan::read(folder().join("vehicle.toml")).unwrap();
    let free = (plan.free_share() * 100.0) as u8;
    assert!(DOCUMENTATION.contains(&format!("(the vehicle of the example: {free} %)")), "{free}");
    let with_ceiling = |line: &str| read(&with("tx-node = 90", &format!("plan = \"vehicle.toml\"\n{line}")));
    assert_eq!(with_ceiling("").unwrap().segments[0].ceiling.get(), free);
    assert_eq!(with_ceiling("ceiling = 2").unwrap().segments[0].ceiling.get(), 2);
    let why = with_ceiling(&format!("ceiling = {}", free + 1)).unwrap_err();
    assert!(
        why.contains(&format!("the plan leaves {free} % of the bus free, less than {} %", free + 1)),
        "{why}"
    );
    assert_eq!(read(&with("tx-node = 90", "")).unwrap().segments[0].ceiling.get(), 20, "without a plan");
}

#[test]
fn a_channel_carries_messages_as_the_plan_says() {
    let plan = cosmic_monitor::SegmentPlan::read(folder().join("rover.toml")).unwrap();
    let journal = plan.channel(plan.channel_named("journal").unwrap());
    let (subject, len) = (format!("{:X}", journal.subject), journal.length);
    let with_messages = |line: &str, subject: &str| {
        with_two_channels("plan = \"rover.toml\"", &format!("{subject}\"\n{line}#\""))
    };
    let longest = |len: u16| format!("longest-message = {len}\n");
    let why = with_messages("", &subject).unwrap_err();
    assert!(why.contains(&format!("add longest-message = {len} to the channel")), "{why}");
    let why = with_messages(&longest(len - 1), &subject).unwrap_err();
    assert!(why.contains(&format!("write longest-message = {len}")), "{why}");
    assert_eq!(with_messages(&longest(len), &subject).unwrap().channels[1].longest_message, Some(len.into()));
    for (len, expected) in [(8, "8 is none; write its bytes, 9 to 1024"), (1025, "1025 is none")] {
        let why = with_messages(&longest(len), "0xC05B").unwrap_err();
        assert!(why.contains(expected), "{why}");
    }
    let why = read(&with("interval = \"10 ms\"", "interval = \"10 ms\"\nlongest-message = 20")).unwrap_err();
    assert!(why.contains("only a non real-time channel carries messages"), "{why}");
}

#[test]
fn names_and_subjects_stand_once() {
    let channel =
        "[[channel]]\nname = \"heat\"\nsubject = \"0xC05A\"\nclass = \"non-real-time\"\ninterval = \"1 s\"\n";
    let why = read(&(with("tx-node = 90", "") + channel)).unwrap_err();
    assert!(
        why.contains("another channel has this name") && why.contains("another channel has this subject"),
        "{why}"
    );
}

/// The configuration with one more channel, and this line in the segment's table.
fn with_two_channels(line: &str, subject: &str) -> Result<Config, String> {
    let second = format!(
        "[[channel]]\nname = \"cold\"\nsubject = \"{subject}\"\nclass = \"non-real-time\"\ninterval = \"1 s\"\n"
    );
    read(&(with("tx-node = 90", line) + &second))
}

#[test]
fn a_subject_is_a_number_however_it_is_written() {
    for same in ["0xC05A", "C05A", "0xc05a", "0x000000000000C05A"] {
        let why = with_two_channels("", same).unwrap_err();
        assert!(why.contains("another channel has this subject"), "{same}: {why}");
    }
    assert!(with_two_channels("", "0xC05B").is_ok());
}

#[test]
fn an_etag_is_that_of_one_channel() {
    let with_etags = |etags: &str| with_two_channels(&format!("etags = {{ {etags} }}"), "0xC05B");
    for etags in ["heat = 5000, cold = 5000", "cold = 5000, gateways = 5000"] {
        let why = with_etags(etags).unwrap_err();
        assert!(why.contains("5000 is the etag of the subject"), "{why}");
        assert!(why.contains("each channel needs one of its own"), "{why}");
    }
    assert!(with_etags("heat = 5000, cold = 5001, gateways = 5002").is_ok());
}

#[test]
fn an_etag_of_the_plan_is_not_given_again() {
    let plan = cosmic_monitor::SegmentPlan::read(folder().join("vehicle.toml")).unwrap();
    let temperature = plan.channel(plan.channel_named("temperature").unwrap());
    let (subject, etag) = (format!("{:X}", temperature.subject), temperature.etag.unwrap().get());
    let with = |etags: &str, subject: &str| {
        with_two_channels(&format!("plan = \"vehicle.toml\"\netags = {{ {etags} }}"), subject)
    };
    let why = with(&format!("heat = {etag}"), "0xC05B").unwrap_err();
    assert!(
        why.contains(&format!("{etag} is the etag of the subject")),
        "another channel of the plan: {why}"
    );
    let why = with("cold = 9000", &subject).unwrap_err();
    assert!(why.contains(&format!("the plan gives this channel {etag}, not 9000; leave it out")), "{why}");
    assert!(with(&format!("cold = {etag}"), &subject).is_ok(), "the same once more is no contradiction");
}

#[test]
fn segments_share_neither_a_link_nor_a_table() {
    let first = with("tx-node = 90", "tx-node = 90\nbroker = \"table\"");
    let second =
        "[[segment]]\nname = \"two\"\nlink = \"can:can0\"\nuid = \"2\"\ntx-node = 9\nbroker = \"table\"\n";
    let why = read(&(first + second)).unwrap_err();
    assert!(
        why.contains("another segment has this link") && why.contains("keeps its table in this file"),
        "{why}"
    );
}
