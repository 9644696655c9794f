//! Frames on the bus, as boxes.

use cosmic_bus::VirtualInstant;
use cosmic_core::can::BitRate;
use svg::node::element::Group;

use super::canvas::{Anchor, Area, Label, Scale, cross, explained};
use super::palette::{ERROR, HATCH, Look, PAPER};
use crate::bus_log::{Attempt, Ending};
use crate::cluster::Cluster;
use crate::journal::Journal;
use crate::ledger::Ledger;

/// A lane for frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lane {
    pub(super) scale: Scale,
    pub(super) y: f64,
    pub(super) height: f64,
    /// The size of the text in the boxes.
    pub(super) text: f64,
}

/// Draws all attempts that the lane shows.
pub(super) fn draw(journal: &Journal, ledger: &Ledger, lane: &Lane) -> Group {
    let attempts = journal.bus.attempts();
    let first = attempts.partition_point(|attempt| attempt.end < lane.scale.from);
    let mut group = Group::new();
    for (at, attempt) in attempts.iter().enumerate().skip(first) {
        if attempt.start > lane.scale.until {
            break;
        }
        let next = attempts.get(at + 1).map(|next| next.start);
        group = group.add(frame(journal, ledger, lane, attempt, next));
    }
    group
}

fn frame(
    journal: &Journal,
    ledger: &Ledger,
    lane: &Lane,
    attempt: &Attempt,
    next: Option<VirtualInstant>,
) -> Group {
    let look = Look::of(journal.cluster, attempt);
    let (left, right) = (lane.scale.x(attempt.start), lane.scale.x(attempt.end));
    let area = Area::between(left, right, lane.y, lane.height);
    let paint = look.paint();
    let mut group = explained(&describe(journal.cluster, ledger, attempt));
    let failed = attempt.has_failed();
    let repeated = attempt.attempt > 1;
    let mut shape = area.rectangle(if failed { HATCH } else { paint.fill });
    shape = match (failed, repeated) {
        (true, _) => shape.set("stroke", paint.fill).set("stroke-width", 1.6),
        (false, true) => shape.set("stroke", ERROR).set("stroke-width", 2),
        (false, false) => shape.set("stroke", PAPER).set("stroke-width", 0.7),
    };
    group = group.add(shape);
    if failed {
        group = group.add(cross(&area));
        let until = error_frame_end(journal.bit_rate, attempt, next);
        let flag = Area::between(right, lane.scale.x(until), lane.y, lane.height);
        group = group.add(flag.rectangle(ERROR));
    } else if let Some(text) = fitting(&names(journal.cluster, ledger, attempt), area.width, lane.text) {
        let label = Label::new(&text, lane.text).ink(paint.ink).anchor(Anchor::Middle);
        group = group.add(label.at(left + area.width / 2.0, lane.y + lane.height / 2.0 + lane.text * 0.36));
    }
    if lane.text >= ANNOTATED {
        group = annotate(journal.cluster, ledger, lane, attempt, &area, group);
    }
    group
}

/// Says above and below the box what cannot stand in it.
fn annotate(
    cluster: &Cluster,
    ledger: &Ledger,
    lane: &Lane,
    attempt: &Attempt,
    area: &Area,
    mut group: Group,
) -> Group {
    let (middle, size) = (area.x + area.width / 2.0, lane.text - 1.0);
    fn label(text: &str, size: f64) -> Label<'_> {
        Label::new(text, size).ink(ERROR).bold().anchor(Anchor::Middle).halo()
    }
    let again = match attempt.attempt {
        0 | 1 => String::new(),
        number => format!("attempt {number}"),
    };
    let below = if attempt.has_failed() {
        group = group.add(label("destroyed", size).at(middle, lane.y - 5.0));
        let comma = if again.is_empty() { "" } else { ", " };
        let names =
            names(cluster, ledger, attempt).into_iter().skip(1).map(|name| format!("{name}{comma}{again}"));
        let mut names = names.chain([again.clone()]);
        names.find(|name| label(name, size).width() < area.width + GAP).unwrap_or(again)
    } else {
        again
    };
    group.add(label(&below, size).at(middle, lane.y + lane.height + lane.text + 2.0))
}

/// A destroyed attempt is followed by an error flag, which others may prolong, and eight recessive bits.
fn error_frame_end(bit_rate: BitRate, attempt: &Attempt, next: Option<VirtualInstant>) -> VirtualInstant {
    let usual = attempt.end + bit_rate.bits(ERROR_FRAME_BITS);
    next.map_or(usual, |next| usual.min(next).max(attempt.end))
}

/// Names of a frame, the longest first.
fn names(cluster: &Cluster, ledger: &Ledger, attempt: &Attempt) -> Vec<String> {
    let Some(frame) = attempt.frame() else { return vec!["foreign".into()] };
    match cluster.channel_of(frame.id.etag(), frame.id.tx_node()) {
        Some(channel) => {
            let event = attempt.load.and_then(|load| ledger.event_of(load));
            let number = event.map_or(String::new(), |event| format!(" {event}"));
            vec![format!("{}{number}", channel.name), channel.name.into(), initials(channel.name)]
        }
        None if frame.id.etag().is_reserved() => vec!["clock sync".into(), "sync".into()],
        None => vec!["load".into()],
    }
}

pub(super) fn initials(name: &str) -> String {
    name.split([' ', '_', '-']).filter_map(|word| word.chars().next()).collect::<String>().to_uppercase()
}

fn fitting(names: &[String], width: f64, size: f64) -> Option<String> {
    names.iter().find(|name| Label::new(name, size).width() < width - 2.0).cloned()
}

/// All about a frame, for who points at it.
fn describe(cluster: &Cluster, ledger: &Ledger, attempt: &Attempt) -> String {
    let ms = |at: VirtualInstant| at.as_ticks() as f64 / 1e6;
    let what = names(cluster, ledger, attempt).into_iter().next().unwrap_or_default();
    let frame = attempt.frame();
    let priority = frame.map_or(String::new(), |frame| format!(", priority {}", frame.id.priority().get()));
    let sender = frame.map_or("", |frame| cluster.node(frame.id.tx_node()).map_or("", |node| node.name));
    let sender = if sender.is_empty() { String::new() } else { format!(" from {sender}") };
    let ending = match attempt.ending {
        Ending::Open => "on the wire at the end".to_owned(),
        Ending::Sent => "sent".to_owned(),
        Ending::Failed(error) => format!("destroyed in bit {} ({:?})", error.bit, error.field),
    };
    format!(
        "{what}{sender}{priority}, attempt {}, {ending}, {:.3} to {:.3} ms, {:?}",
        attempt.attempt,
        ms(attempt.start),
        ms(attempt.end),
        attempt.wire_frame
    )
}

/// In a lane with texts of this size or more there is room above and below the boxes.
const ANNOTATED: f64 = 11.0;
/// A label may be wider than its box by this.
const GAP: f64 = 30.0;
/// Six bits of flag, up to six of echo, eight of delimiter (ISO 11898-1, error frame): usually this.
const ERROR_FRAME_BITS: u32 = 20;
