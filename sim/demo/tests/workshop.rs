//! The workshop as it is flashed keeps what it promises, and its judge notices when it does not.
//!
//! `cargo xtask test emulated` builds the images and names their directory in `COSMIC_WORKSHOP_IMAGES`.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use cosmic_bus::VirtualInstant;
use cosmic_core::can::Priority;
use cosmic_core::protocol::{AdmissionVerdict, ControlMessage};
use cosmic_demo::cluster;
use cosmic_demo::workshop::{self, Line, Story, Summary};
use cosmic_plan::cluster::Cluster;

static WORKSHOP: LazyLock<Cluster> = LazyLock::new(|| {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/workshop/cluster.toml");
    cluster::description(&file).unwrap()
});

static STORY: LazyLock<Story> = LazyLock::new(|| {
    let images = std::env::var_os("COSMIC_WORKSHOP_IMAGES");
    let images: PathBuf =
        images.expect("COSMIC_WORKSHOP_IMAGES names no directory: `cargo xtask test emulated`").into();
    workshop::run(&WORKSHOP, &images).unwrap()
});

#[test]
fn it_keeps_what_it_promises() {
    let summary = Summary::of(&WORKSHOP, &STORY);
    assert!(summary.passed(), "{summary}");
    assert!(summary.to_string().ends_with("PASSED: all as promised.\n"), "{summary}");
}

/// Spoils the story, and expects one promise to be broken: the one that begins so.
#[track_caller]
fn breaks(promise: &str, spoil: impl FnOnce(&mut Story)) {
    let mut story = STORY.clone();
    spoil(&mut story);
    let summary = Summary::of(&WORKSHOP, &story);
    let broken: Vec<_> =
        summary.promises.iter().filter(|it| !it.is_kept).map(|it| it.text.as_str()).collect();
    assert!(matches!(broken.as_slice(), [one] if one.starts_with(promise)), "{promise}: {broken:#?}");
    assert!(!summary.passed() && summary.to_string().contains("FAILED: 1 promise not kept."), "{summary}");
}

fn position(story: &Story, node: &str, text: &str) -> usize {
    let is_it = |line: &Line| line.node == node && line.text.starts_with(text);
    story.lines.iter().position(is_it).unwrap_or_else(|| panic!("{node} never said `{text}`"))
}

fn later(at: VirtualInstant, nanoseconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(at.as_ticks() + nanoseconds)
}

#[test]
fn a_stop_that_does_not_come_is_noticed_and_one_that_comes_late() {
    breaks("Emergency stop", |story| {
        let at = position(story, "lamp", "Stop {");
        story.lines.remove(at);
    });
    breaks("Emergency stop", |story| {
        let at = position(story, "lamp", "Stop {");
        // Wherever it was between two slots.
        story.lines[at].at += 23;
    });
}

#[test]
fn a_hard_frame_beside_its_slot_is_noticed() {
    breaks("Its slot", |story| {
        let hard = story.frames.iter_mut().find(|it| it.frame.id.priority() == Priority::HARD).unwrap();
        hard.at = later(hard.at, 150_000);
    });
}

#[test]
fn a_node_without_an_id_and_two_with_one_are_noticed() {
    breaks("Ids", |story| {
        let at = position(story, "scout", "Configured(TxNode(124))");
        "Configured(TxNode(1))".clone_into(&mut story.lines[at].text);
        // Nothing of it is looked for under its old id.
        for sent in story.frames.iter_mut().filter(|it| it.frame.id.tx_node().get() == 124) {
            let id = sent.frame.id;
            sent.frame.id = cosmic_core::can::Id::new(
                id.priority(),
                cosmic_core::can::TxNode::new(1).unwrap(),
                id.etag(),
            );
        }
    });
    let mut story = STORY.clone();
    story.lines.retain(|line| line.node != "scout");
    let summary = Summary::of(&WORKSHOP, &story).to_string();
    assert!(summary.contains("BROKEN: Ids: 4 of 5"), "{summary}");
}

#[test]
fn a_reading_that_the_filter_excludes_is_noticed() {
    breaks("Filter", |story| {
        let (node, text) = ("lamp".to_owned(), "Reading { value: 25 } at Some(42)".to_owned());
        story.lines.push(Line { at: 3_000, node, text });
    });
}

#[test]
fn an_event_that_was_not_admitted_is_noticed_and_a_gap_between_admitted_ones() {
    breaks("Admission", |story| {
        let admitted = story.frames.iter().position(|it| match ControlMessage::decode(&it.frame) {
            Some(ControlMessage::AdmissionReply(reply)) => {
                matches!(reply.verdict, AdmissionVerdict::Admitted(_))
            }
            _ => false,
        });
        let admitted = admitted.expect("it was admitted");
        let first = story.frames.iter().position(|it| it.frame.id.etag().get() == 16_381).unwrap();
        let early = workshop::Sent { at: story.frames[admitted - 1].at, ..story.frames[first] };
        story.frames.insert(admitted, early);
        // The gap behind it is another matter.
        story.frames[first + 1].at = early.at;
    });
    breaks("Admission", |story| {
        let mut number = 0;
        story.frames.retain(|it| {
            number += u32::from(it.frame.id.etag().get() == 16_381);
            it.frame.id.etag().get() != 16_381 || number != 20
        });
    });
}

#[test]
fn a_message_that_is_lost_is_noticed() {
    breaks("Messages", |story| {
        let at = position(story, "desk", "node ");
        story.lines.remove(at);
    });
}

#[test]
fn a_spare_that_waits_is_noticed() {
    breaks("Fail-over", |story| {
        let at = position(story, "spare", "Became(Active)");
        story.lines[at].at += 1_000;
    });
    breaks("Fail-over", |story| {
        let at = position(story, "spare", "Became(Active)");
        story.lines.remove(at);
    });
}

#[test]
fn a_channel_that_is_not_announced_again_is_noticed() {
    breaks("Channels at run time", |story| story.lines.retain(|line| !line.text.starts_with("rests")));
}

#[test]
fn what_no_node_should_do_is_told() {
    let mut story = STORY.clone();
    story.oddities.push("lamp, at 3 ms: stopped".into());
    let summary = Summary::of(&WORKSHOP, &story);
    assert!(!summary.passed() && summary.to_string().contains("BROKEN: lamp, at 3 ms: stopped"), "{summary}");
}
