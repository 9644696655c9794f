//! The command on a simulated segment in real time, over its socket. No test depends on how fast anything is.

mod common;

use common::{CLUSTER, Running, Segment, json, printed, run, text, until};

#[test]
fn a_broker_a_publisher_and_a_subscriber_find_each_other() {
    let segment = Segment::start();
    let link = segment.link();
    let _broker = Running::start(&["broker", "-l", &link]);
    let subscriber =
        Running::start(&["sub", "C05A1C00000000AA", "-n", "2", "-l", &link, "--patience", "50s", "--json"]);
    // Until the subscriber's interest is known: events before it subscribes are not for it.
    until("somebody subscribes", || {
        let channels = run(&["channels", "-l", &link, "--for", "500ms", "--json"]);
        let channels: serde_json::Value = serde_json::from_slice(&channels.stdout).unwrap();
        channels.as_array().unwrap().iter().any(|channel| {
            channel["subject"] == "C05A1C00000000AA" && !channel["subscribers"].as_array().unwrap().is_empty()
        })
    });
    let published = run(&[
        "pub",
        "C05A1C00000000AA",
        "0102",
        "-n",
        "2",
        "--every",
        "20ms",
        "--deadline",
        "10s",
        "--validity",
        "20s",
        "-l",
        &link,
        "--patience",
        "50s",
    ]);
    assert!(published.status.success(), "{}", text(&published.stderr));
    assert!(
        text(&published.stderr).contains("2 published, 2 sent, 0 expired"),
        "{}",
        text(&published.stderr)
    );
    let got = subscriber.wait();
    assert!(got.status.success(), "{}", text(&got.stderr));
    for line in text(&got.stdout).lines() {
        let event: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(event["data"], "0102");
    }
    // Broker, and whoever else is there by now, are seen by those who only listen.
    let nodes = json(&["nodes", "-l", &link, "--for", "1s", "--json"]);
    assert!(nodes.as_array().unwrap().iter().any(|node| node["is_broker"] == true), "{nodes}");
}

/// As in docs/c.md.
#[test]
fn an_etag_is_fixed_where_nobody_gives_one() {
    let segment = Segment::start();
    let link = segment.link();
    let identity = |node| ["--tx-node", node, "--etag", "5000", "-l", &link, "--patience", "50s"];
    let subscriber = Running::start(&[&["sub", "0x2A", "-n", "1", "--json"][..], &identity("8")].concat());
    let words = ["pub", "0x2A", "0866", "--every", "20ms", "-n", "1000000"];
    let _publisher = Running::start(&[&words[..], &identity("9")].concat());
    let got = subscriber.wait();
    assert!(got.status.success(), "{}", text(&got.stderr));
    let event: serde_json::Value = serde_json::from_slice(&got.stdout).unwrap();
    assert_eq!((&event["data"], &event["publisher"]), (&"0866".into(), &9.into()));
    let refused = run(&["pub", "gripper", "00", "--etag", "5000", "-l", &link, "-c", CLUSTER]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("leave out --etag"), "{}", text(&refused.stderr));
}

/// The journal of the rover has more bytes than a frame; and so has a channel of which no file says so.
#[test]
fn messages_longer_than_a_frame_go_and_come_whole() {
    let segment = Segment::start();
    let link = segment.link();
    let identity = |node| ["--tx-node", node, "-l", &link, "--patience", "50s"];
    let journal = ["at=12", "latitude=47.5", "longitude=-8.25", "cells=1,2,3,4,5,6"];
    let long = "A5".repeat(1024);
    let plan = ["-c", CLUSTER];
    let words = ["--messages", "--etag", "5000"];
    for (channel, content, more, expected) in [
        ("journal", &journal[..], &plan[..], "journal at=12 s latitude=47.5 ° longitude=-8.25 °"),
        ("0x2A", &[long.as_str()], &words, long.as_str()),
    ] {
        let subscriber = Running::start(&[&["sub", channel, "-n", "1"][..], more, &identity("8")].concat());
        let repeated = ["-n", "1000000", "--every", "20ms"];
        let publisher = [&["pub", channel][..], content, &repeated, more, &identity("9")].concat();
        let publisher = Running::start(&publisher);
        let got = subscriber.wait();
        assert!(got.status.success(), "{}", text(&got.stderr));
        assert!(text(&got.stdout).contains(expected), "{}", text(&got.stdout));
        drop(publisher);
    }
    let one = run(&[&["pub", "0x2A", &long][..], &words, &identity("9")].concat());
    assert!(text(&one.stderr).contains("1 published, 1 sent, 0 expired"), "{}", text(&one.stderr));
    let refused = run(&[&["pub", "0x2A", &long, "--etag", "5000"][..], &identity("9")].concat());
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("--messages"), "{}", text(&refused.stderr));
}

#[test]
fn fields_of_a_planned_channel_go_and_come_in_words() {
    let segment = Segment::start();
    let link = segment.link();
    let subscriber = Running::start(&[
        "sub",
        "gripper",
        "-n",
        "1",
        "--tx-node",
        "1",
        "-l",
        &link,
        "-c",
        CLUSTER,
        "--patience",
        "50s",
    ]);
    until("somebody subscribes", || {
        let channels = json_of(&["channels", "-l", &link, "-c", CLUSTER, "--for", "500ms", "--json"]);
        channels.as_array().unwrap().iter().any(|channel| {
            channel["name"] == "gripper"
                && channel["subscribers"].as_array().unwrap().iter().any(|it| it["lease_ns"].is_number())
        })
    });
    let published = run(&[
        "pub",
        "gripper",
        "state=slipped",
        "force=3.5",
        "--tx-node",
        "5",
        "--deadline",
        "10s",
        "--validity",
        "20s",
        "-l",
        &link,
        "-c",
        CLUSTER,
        "--patience",
        "50s",
    ]);
    assert!(published.status.success(), "{}", text(&published.stderr));
    let got = text(&subscriber.wait().stdout);
    assert!(got.trim_end().ends_with("arm          gripper state=slipped force=3.5 N"), "{got}");
}

fn json_of(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_slice(&run(arguments).stdout).unwrap()
}

#[test]
fn without_a_broker_a_node_says_who_is_missing() {
    let segment = Segment::start();
    let output = run(&["pub", "C05A1C00000000AA", "01", "-l", &segment.link(), "--patience", "1s"]);
    assert_eq!(output.status.code(), Some(3));
    let said = text(&output.stderr);
    assert!(said.contains("no broker has answered within 1 s") && said.contains("cosmic broker"), "{said}");
}

#[test]
fn a_log_is_replayed_recorded_and_the_same_again() {
    let segment = Segment::start();
    let link = segment.link();
    let original = std::fs::read_to_string(common::root().join("docs/tasks/rover.log")).unwrap();
    let frames = original.lines().count();
    let recorded = segment.file("again.pcapng");
    let recorder = Running::start(&["record", &recorded, "-n", &frames.to_string(), "-l", &link]);
    // The recorder has the file when it listens.
    until("it records", || std::fs::metadata(&recorded).is_ok());
    let replayed = run(&["replay", "docs/tasks/rover.log", "--speed", "0", "-l", &link]);
    assert!(replayed.status.success(), "{}", text(&replayed.stderr));
    assert!(text(&replayed.stderr).contains(&format!("{frames} frames sent")), "{}", text(&replayed.stderr));
    let recorded_frames = recorder.wait();
    assert!(text(&recorded_frames.stderr).contains("0 lost"), "{}", text(&recorded_frames.stderr));
    let again = printed(&["record", "-", "-l", &format!("log:{recorded}")]);
    let frame = |line: &str| line.rsplit(' ').next().unwrap().to_owned();
    let (original, again): (Vec<_>, Vec<_>) =
        (original.lines().map(frame).collect(), again.lines().map(frame).collect());
    assert_eq!(again, original, "frame by frame, in order");
}

#[test]
fn the_doctor_sees_an_empty_segment() {
    let segment = Segment::start();
    let output = run(&["doctor", "-l", &segment.link(), "--for", "4s", "--json"]);
    let findings: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &findings[0]["rule"]), (Some(1), &"nothing-received".into()));
}

#[test]
fn a_segment_that_is_gone_is_told_and_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("segment");
    let path = path.to_str().unwrap();
    let link = format!("sim:{path}");
    let server = Running::start(&["segment", path]);
    until("the segment is served", || std::path::Path::new(path).exists());
    let listener = Running::start(&["echo", "-n", "1", "-l", &link]);
    // Whether it listens already does not matter: it finds the next server, too.
    drop(server);
    let _server = Running::start(&["segment", path]);
    until("an event arrives", || {
        let _ = run(&[
            "pub",
            "C05A1C00000000AA",
            "01",
            "--tx-node",
            "3",
            "--patience",
            "1s",
            "-l",
            &link,
            "-c",
            CLUSTER,
        ]);
        let _ = run(&[
            "pub",
            "gripper",
            "state=open",
            "force=0",
            "--tx-node",
            "5",
            "-l",
            &link,
            "-c",
            CLUSTER,
            "--patience",
            "5s",
        ]);
        is_over(&listener)
    });
}

fn is_over(running: &Running) -> bool {
    std::fs::read_to_string(format!("/proc/{}/stat", running.0.id())).is_ok_and(|stat| stat.contains(") Z "))
}
