//! One slot, close up: its instants, the frames in it, and what the nodes see of it.

use cosmic_bus::VirtualInstant;
use cosmic_core::can::TxNode;
use cosmic_core::time::Duration;
use svg::node::element::{Circle, Group};

use super::canvas::{Anchor, Area, Label, Scale, line, pointer};
use super::frames::{self, Lane};
use super::palette::{ERROR, FAINT_INK, GRID, INK, LANE, Look, MARK, PARTS};
use super::{LEFT, RIGHT, axis};
use crate::hard::Occurrence;
use crate::journal::Journal;
use crate::verdict::Verdict;

/// The height of the panel for so many nodes.
pub(super) fn height(nodes: usize) -> f64 {
    NODES + nodes as f64 * NODE_LANE + 46.0
}

/// Draws it with its upper edge at `top`.
pub(super) fn draw(journal: &Journal, verdict: &Verdict, occurrence: &Occurrence, top: f64) -> Group {
    let window = &occurrence.window;
    let scale = Scale {
        from: VirtualInstant::from_ticks(window.ready.as_ticks().saturating_sub(BEFORE.as_ticks())),
        until: window.delivery + BEHIND,
        left: LEFT,
        right: RIGHT,
    };
    let bottom = top + NODES + journal.cluster.nodes.len() as f64 * NODE_LANE;
    let lane = Lane { scale, y: top + BUS, height: 40.0, text: 12.0 };
    let mut group = Group::new()
        .add(parts(journal, occurrence, &scale, top))
        .add(Area::between(LEFT, RIGHT, lane.y, lane.height).rectangle(LANE))
        .add(Label::new("bus", 13.0).bold().anchor(Anchor::End).at(LEFT - 12.0, lane.y + 25.0))
        .add(instants(occurrence, &scale, top, bottom))
        .add(frames::draw(journal, &verdict.ledger, &lane));
    for (at, node) in journal.cluster.nodes.iter().enumerate() {
        let y = top + NODES + at as f64 * NODE_LANE;
        let name = Label::new(node.name, 13.0).bold().shrunk_to(LEFT - 16.0).anchor(Anchor::End);
        group = group
            .add(name.at(LEFT - 12.0, y + 21.0))
            .add(line((LEFT, y + 16.0), (RIGHT, y + 16.0), GRID, 1.0))
            .add(seen(journal, verdict, occurrence, &scale, node.tx_node, y + 16.0));
    }
    group.add(axis::draw(&scale, bottom, Duration::from_micros(100), 1))
}

/// The parts of the window, as coloured spans with their names.
fn parts(journal: &Journal, occurrence: &Occurrence, scale: &Scale, top: f64) -> Group {
    let window = &occurrence.window;
    let longest = journal.bit_rate.longest_frame(usize::from(occurrence.slot.len));
    let first_end = window.latest_start + longest;
    let k = occurrence.slot.omission_degree;
    let again = match k {
        1 => "one retransmission".to_owned(),
        k => format!("{k} retransmissions"),
    };
    let spans = [
        (window.ready, window.latest_start, "waits for the bus".to_owned()),
        (window.latest_start, first_end, "longest frame".to_owned()),
        (first_end, window.deadline, again),
        (window.deadline, window.delivery, "clock gap".to_owned()),
    ];
    let mut group = Group::new();
    for ((from, until, name), fill) in spans.into_iter().zip(PARTS) {
        if until <= from {
            continue;
        }
        let area = Area::between(scale.x(from), scale.x(until), top + WINDOW, 24.0);
        let label = Label::new(&name, 11.0).anchor(Anchor::Middle).ink(MARK);
        group = group.add(area.rectangle(fill).set("stroke", MARK).set("stroke-width", 0.6));
        if label.width() < area.width + 4.0 {
            group = group.add(label.at(area.x + area.width / 2.0, area.y + 16.0));
        }
    }
    let name = Label::new("calendar", 13.0).bold().anchor(Anchor::End);
    group.add(name.at(LEFT - 12.0, top + WINDOW + 17.0))
}

/// The four instants, as lines through all lanes.
fn instants(occurrence: &Occurrence, scale: &Scale, top: f64, bottom: f64) -> Group {
    let window = &occurrence.window;
    let instants = [
        (window.ready, "ready", "frame into the mailbox"),
        (window.latest_start, "latest start (LST)", "surely on the bus, if no fault"),
        (window.deadline, "deadline", "last retransmission ended"),
        (window.delivery, "delivery", "subscribers see the event"),
    ];
    let mut group = Group::new();
    for (at, name, meaning) in instants {
        let x = scale.x(at);
        let anchor = if name == "deadline" { Anchor::End } else { Anchor::Start };
        let shift = if name == "deadline" { 6.0 } else { -6.0 };
        group = group
            .add(line((x, top + WINDOW - 2.0), (x, bottom), MARK, 1.3).set("stroke-dasharray", "5 3"))
            .add(pointer(x, top + WINDOW - 2.0, MARK))
            .add(Label::new(name, 13.0).bold().ink(MARK).anchor(anchor).at(x + shift, top + 14.0))
            .add(Label::new(meaning, 11.0).ink(FAINT_INK).anchor(anchor).at(x + shift, top + 29.0));
    }
    group
}

/// What a node does and sees: publication, visibility, exceptions.
fn seen(
    journal: &Journal,
    verdict: &Verdict,
    occurrence: &Occurrence,
    scale: &Scale,
    node: TxNode,
    y: f64,
) -> Group {
    let mut group = Group::new();
    let slot = occurrence.slot;
    let account = verdict.ledger.account(slot.etag, slot.publisher);
    let life = account.zip(occurrence.event).and_then(|(account, number)| account.events.get(number));
    let channel = journal.cluster.channel_of(slot.etag, slot.publisher);
    if let Some((life, channel)) = life.zip(channel) {
        let number = occurrence.event.unwrap_or(0);
        if channel.publisher == node {
            let before =
                (occurrence.window.ready.as_ticks().saturating_sub(life.published_at.as_ticks())) as f64;
            let text = if scale.shows(life.published_at) {
                format!("publishes {} {number}", channel.name)
            } else {
                format!("published {number}, {:.2} ms before ready", before / 1e6)
            };
            group = group.add(mark(scale.x(life.published_at), y, Look::Hard.paint().fill, &text, false));
        }
        for delivery in life.deliveries_to(node) {
            let off = crate::span::Span::between(occurrence.window.delivery, delivery.visible_at);
            let text = format!("sees {} {number} ({:+.1} µs)", channel.name, off.as_micros());
            group = group.add(mark(scale.x(delivery.visible_at), y, Look::Hard.paint().fill, &text, false));
        }
    }
    let told = verdict.ledger.told.iter().filter(|told| told.node == node && scale.shows(told.at));
    for told in told {
        let text = format!("told: {}", told.kind.name());
        let fits_behind = scale.x(told.at) + Label::new(&text, 11.0).width() + 10.0 < RIGHT;
        group = group.add(mark(scale.x(told.at), y, ERROR, &text, !fits_behind));
    }
    group
}

fn mark(x: f64, y: f64, fill: &str, text: &str, before: bool) -> Group {
    let ink = if fill == ERROR { ERROR } else { INK };
    let (shift, anchor) = if before { (-9.0, Anchor::End) } else { (9.0, Anchor::Start) };
    Group::new()
        .add(Circle::new().set("cx", x).set("cy", y).set("r", 5).set("fill", fill))
        .add(Label::new(text, 11.0).ink(ink).anchor(anchor).halo().at(x + shift, y - 4.0))
}

/// What is shown before the ready and behind the delivery instant.
const BEFORE: Duration = Duration::from_micros(260);
const BEHIND: Duration = Duration::from_micros(330);
/// Distances of the lanes from the upper edge.
const WINDOW: f64 = 44.0;
const BUS: f64 = 92.0;
const NODES: f64 = 158.0;
const NODE_LANE: f64 = 32.0;
