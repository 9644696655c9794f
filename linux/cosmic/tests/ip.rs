//! The commands across IP, at a gateway on loopback.
#![cfg(feature = "ip")]

#[path = "../../gateway/tests/gateway/authority.rs"]
mod authority;
mod common;

use authority::Authority;
use common::gateway::{Gateway, port, publisher};
use common::terminal::Terminal;
use common::{CLUSTER, Running, Segment, run, text, until};
use cosmic_gateway::config::Tls;
use serde_json::Value;

/// A segment on which somebody publishes, behind a gateway.
struct West {
    segment: Segment,
    gateway: Gateway,
    _publisher: Running,
}

impl West {
    fn start() -> Self {
        let segment = Segment::start();
        let gateway = Gateway::start(&[("west", &segment)], "");
        let publisher = publisher(&segment);
        gateway.says("running: ");
        Self { segment, gateway, _publisher: publisher }
    }

    /// What a command prints across IP, line by line; nothing if it fails.
    fn lines(&self, arguments: &[&str]) -> Vec<Value> {
        let link = self.gateway.link("tcp");
        let output = run(&[arguments, &["--json", "-l", &link, "--network", "test"]].concat());
        let lines = text(&output.stdout);
        lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// The one value that a command prints, as soon as it is so.
    fn value(&self, arguments: &[&str], is_so: impl Fn(&Value) -> bool) -> Value {
        let link = self.gateway.link("tcp");
        let mut value = Value::Null;
        until(&format!("{arguments:?}"), || {
            let output = run(&[arguments, &["--json", "-l", &link, "--network", "test"]].concat());
            value = serde_json::from_slice(&output.stdout).unwrap_or_default();
            is_so(&value)
        });
        value
    }
}

#[test]
fn events_are_seen_as_they_cross() {
    let west = West::start();
    let events = west.lines(&["echo", "gripper", "-n", "5", "-c", CLUSTER]);
    assert_eq!(events.len(), 5);
    for pair in events.windows(2) {
        assert!(pair[1]["number"].as_u64() > pair[0]["number"].as_u64(), "{pair:?}");
    }
    let event = &events[4];
    assert_eq!((&event["segment"], &event["tx_node"]), (&"west".into(), &5.into()));
    assert_eq!((&event["class"], &event["channel"]), (&"SRT".into(), &"gripper".into()));
    assert_eq!((&event["fields"][0]["value"], &event["fields"][1]["value"]), (&"open".into(), &"3.5".into()));
    let left = event["left_ns"].as_i64().unwrap();
    assert!((1..10_000_000_000).contains(&left), "{left}");
    // Without the cluster's file by its subject, and as bytes.
    let [event] = &west.lines(&["echo", "B0A01C0000000006", "-n", "1"])[..] else { panic!("one event") };
    assert_eq!((&event["channel"], &event["fields"]), (&Value::Null, &serde_json::json!([])));
    assert!(event["data"].as_str().is_some_and(|data| !data.is_empty()));
    // In words.
    let link = west.gateway.link("tcp");
    let output = run(&["echo", "-n", "1", "-c", CLUSTER, "-l", &link, "--network", "test"]);
    let said = text(&output.stdout);
    assert!(said.contains("SRT  west/05") && said.contains("gripper #"), "{said}");
    assert!(said.contains(" left ") && said.trim_end().ends_with("state=open force=3.5 N"), "{said}");
}

#[test]
fn who_is_there_what_crosses_and_how_regularly() {
    let west = West::start();
    let heard = |value: &Value| value[0]["events"].as_u64().is_some_and(|events| events > 3);
    let nodes = west.value(&["nodes", "--for", "1s"], heard);
    assert_eq!((&nodes[0]["segment"], &nodes[0]["tx_node"]), (&"west".into(), &5.into()));
    assert_eq!(nodes[0]["spoken_for"], true);
    assert!(nodes[0]["uncertainty_ns"].is_number(), "{nodes}");
    let channels =
        west.value(&["channels", "--for", "1s", "-c", CLUSTER], |value| value[0]["rate"].is_number());
    assert_eq!(
        (&channels[0]["channel"], &channels[0]["publishers"][0]),
        (&"gripper".into(), &"west/05".into())
    );
    let rhythms = west.value(&["hz", "gripper", "--for", "1s", "-c", CLUSTER], heard);
    assert!(rhythms[0]["hz"].as_f64().is_some_and(|hz| hz < 60.0), "{rhythms}");
    let latencies = west.value(&["latency", "--for", "1s"], heard);
    let (left, oldest) = (latencies[0]["least_left_ns"].as_i64(), latencies[0]["oldest_ns"].as_u64());
    assert!(left.is_some_and(|left| left < 10_000_000_000) && oldest.is_some(), "{latencies}");
    assert_eq!((&latencies[0]["late"], &latencies[0]["unknown"]), (&0.into(), &0.into()));
}

#[test]
fn a_node_on_ip_subscribes_and_publishes() {
    let west = West::start();
    let events = west.lines(&["sub", "gripper", "-n", "2", "-c", CLUSTER, "--name", "desk"]);
    assert_eq!((events.len(), &events[1]["segment"]), (2, &"west".into()));
    assert_eq!(events[1]["fields"][1]["value"], "3.5");
    // Nobody on the segment may get what is published elsewhere: the channel leaves the west only.
    let east = Segment::start();
    let gateway = Gateway::start(&[("east", &east)], "");
    let mut subscriber = Running::start(&[
        "sub",
        "gripper",
        "-n",
        "1",
        "--tx-node",
        "1",
        "-l",
        &east.link(),
        "-c",
        CLUSTER,
        "--patience",
        "50s",
    ]);
    gateway.says("running: ");
    until("the subscriber is there", || {
        let output = run(&["channels", "-l", &east.link(), "-c", CLUSTER, "--for", "500ms", "--json"]);
        let channels: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        let is_it = |it: &Value| it["name"] == "gripper" && it["subscribers"][0]["lease_ns"].is_number();
        channels.as_array().is_some_and(|channels| channels.iter().any(is_it))
    });
    let link = gateway.link("tcp");
    let fields = ["state=slipped", "force=1.5"];
    let options = ["--deadline", "10s", "--validity", "20s", "-c", CLUSTER, "--network", "test", "-l", &link];
    // A gateway that begins to speak forwards nothing for a moment.
    until("an event arrives", || {
        let published = run(&[&["pub", "gripper"], &fields[..], &options[..]].concat());
        assert!(published.status.success(), "{}", text(&published.stderr));
        assert!(text(&published.stderr).contains("1 published, 1 sent"), "{}", text(&published.stderr));
        subscriber.0.try_wait().unwrap().is_some()
    });
    let got = text(&subscriber.wait().stdout);
    assert!(got.contains("node 5A") && got.trim_end().ends_with("state=slipped force=1.5 N"), "{got}");
}

#[test]
fn by_certificates_who_is_known_hears_and_nobody_else() {
    let (ours, others) = (Authority::new(), Authority::new());
    let Tls { authority, certificate, key } = ours.sign("plant");
    let tables = format!(
        r#"[ip]
listen = ["tls/127.0.0.1:@PORT"]
[ip.tls]
authority = {authority:?}
certificate = {certificate:?}
key = {key:?}
[[ip.peer]]
certificate = "desk"
segments = []"#
    );
    let segment = Segment::start();
    let gateway = Gateway::start(&[("west", &segment)], &tables);
    let _publisher = publisher(&segment);
    gateway.says("running: ");
    let link = gateway.link("tls");
    let call = |tls: &Tls, patience: &str| {
        let Tls { authority, certificate, key } = tls;
        let files = [("--authority", authority), ("--certificate", certificate), ("--key", key)];
        let files = files.map(|(option, file)| [option, file.to_str().unwrap()]).concat();
        let what = [
            "echo",
            "gripper",
            "-n",
            "2",
            "-c",
            CLUSTER,
            "-l",
            &link,
            "--network",
            "test",
            "--for",
            patience,
        ];
        run(&[&what[..], &files].concat())
    };
    let heard = call(&ours.sign("desk"), "50s");
    assert!(heard.status.success(), "{}", text(&heard.stderr));
    assert_eq!(text(&heard.stdout).matches("west/05").count(), 2);
    // Signed by somebody else.
    let refused = call(&others.sign("desk"), "2s");
    assert!(!refused.status.success() && refused.stdout.is_empty(), "{}", text(&refused.stderr));
    assert_eq!(text(&refused.stderr).lines().count(), 1, "{}", text(&refused.stderr));
}

#[test]
fn top_draws_what_crosses() {
    let west = West::start();
    let link = west.gateway.link("tcp");
    let mut top = Terminal::start(&["top", "-c", CLUSTER, "-l", &link, "--network", "test"], &[], (24, 120));
    top.shows("state=open force=3.5 N");
    let screen = top.shows("clock to");
    for wanted in ["who speaks: west", "gripper", "west/05", "SRT", "last events"] {
        assert!(screen.contains(wanted), "{wanted}\n{screen}");
    }
    top.press("q");
    assert_eq!(top.ends(), 0);
}

#[test]
fn what_needs_a_bus_is_refused_in_one_line() {
    let nobody = format!("zenoh:tcp/127.0.0.1:{}", port());
    let network = ["--network", "test"];
    let cases: [(&[&str], i32, &str); 15] = [
        (&["record", "a.log"], 2, "looks at the frames of a bus"),
        (&["replay", "docs/tasks/rover.log"], 2, "looks at the frames of a bus"),
        (&["doctor"], 2, "looks at the frames of a bus"),
        (&["broker"], 2, "looks at the frames of a bus"),
        (&["serve"], 2, "add [page] to the configuration of a gateway"),
        (&["top"], 2, "top draws on a terminal"),
        (&["echo", "--control"], 2, "leave out --control"),
        (&["echo", "16383"], 2, "etags do not leave their segment"),
        (&["echo", "--key", "a.key"], 2, "certificates are three files"),
        (&["pub", "B0A01C0000000006", "01", "--tx-node", "5"], 2, "leave out --uid and --tx-node"),
        (&["sub", "B0A01C0000000006", "--name", "Desk"], 2, "--name: \"Desk\" is none"),
        (&["pub", "B0A01C0000000006", "00112233445566778899"], 2, "the content has 10 bytes"),
        (
            &["pub", "00000000000000AA", "01", "--messages", "--deadline", "5ms"],
            2,
            "a message is non real-time: leave out --deadline",
        ),
        (&["echo"], 3, "nobody answers at tcp/127.0.0.1"),
        (&["sub", "B0A01C0000000006"], 3, "nobody answers at tcp/127.0.0.1"),
    ];
    for (arguments, code, why) in cases {
        let output = run(&[arguments, &["-l", &nobody], &network].concat());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(why) && said.lines().count() == 1, "{arguments:?}: {said}");
    }
    for (arguments, why) in [
        (["echo", "-l", &nobody], "which network?"),
        (["echo", "-l", "zenoh:tls/box:1"], "which network?"),
        (["echo", "-l", "zenoh:box"], "write zenoh:tcp/HOST:PORT"),
    ] {
        let output = run(&arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(text(&output.stderr).contains(why), "{}", text(&output.stderr));
    }
    let output = run(&["echo", "-l", "zenoh:tls/box:1", "--network", "test"]);
    assert!(text(&output.stderr).contains("\"tls/\" needs certificates"), "{}", text(&output.stderr));
    // What looks at no link does not mind.
    let output = run(&["decode", "docs/tasks/rover.log", "-l", &nobody]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}

#[test]
fn nobody_wants_what_no_one_has_subscribed_to() {
    let west = West::start();
    let link = west.gateway.link("tcp");
    let options = ["--patience", "500ms", "-l", &link, "--network", "test"];
    let output = run(&[&["pub", "00000000000000AA", "01"], &options[..]].concat());
    assert_eq!(output.status.code(), Some(3));
    assert!(
        text(&output.stderr).contains("nobody on this network has subscribed"),
        "{}",
        text(&output.stderr)
    );
    drop(west.segment);
}
