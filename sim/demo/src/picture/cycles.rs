//! Some cycles of the calendar, one below the other, so that the slots stand in columns.

use cosmic_bus::VirtualInstant;
use cosmic_core::time::Duration;
use svg::node::element::{Group, Text};

use super::axis::UNIT_GAP;
use super::canvas::{Anchor, Area, Label, Scale, line};
use super::frames::{self, Lane};
use super::palette::{FAINT_INK, INK, LANE, MARK, WINDOW};
use super::{LEFT, RIGHT, WIDTH};
use crate::hard::Occurrence;
use crate::journal::Journal;
use crate::verdict::Verdict;

/// The height of the panel.
pub(super) const HEIGHT: f64 = CYCLES as f64 * ROW + 44.0;

/// Draws the cycle that starts at `start` in the middle, with its upper edge at `top`. `focus` is marked.
pub(super) fn draw(
    journal: &Journal,
    verdict: &Verdict,
    start: VirtualInstant,
    focus: Option<&Occurrence>,
    top: f64,
) -> Group {
    let cycle = journal.cluster.calendar.cycle();
    let before = start.as_ticks().min(cycle.as_ticks() * (CYCLES / 2)) / cycle.as_ticks();
    let first = start.as_ticks() - before * cycle.as_ticks();
    let mut group = Group::new();
    for row in 0..CYCLES {
        let from = VirtualInstant::from_ticks(first + row * cycle.as_ticks());
        let scale = Scale { from, until: from + cycle, left: LEFT, right: RIGHT };
        let y = top + row as f64 * ROW;
        let lane = Lane { scale, y: y + 13.0, height: 24.0, text: 9.0 };
        let text = format!("{:.2}", from.as_ticks() as f64 / 1e6);
        group = group
            .add(Label::new(&text, 12.0).anchor(Anchor::End).at(LEFT - 12.0, lane.y + 16.0))
            .add(Area::between(LEFT, RIGHT, lane.y, lane.height).rectangle(LANE));
        let shown = verdict.slots.occurrences.iter().filter(|it| scale.shows(it.window.ready));
        for occurrence in shown {
            group = group.add(window(occurrence, &scale, y, focus == Some(occurrence)));
        }
        group = group.add(frames::draw(journal, &verdict.ledger, &lane));
        let shown = verdict.slots.occurrences.iter().filter(|it| scale.shows(it.window.ready));
        for occurrence in shown {
            group = group.add(instants(occurrence, &scale, y));
        }
    }
    group.add(axis(cycle, top + CYCLES as f64 * ROW + 2.0))
}

fn window(occurrence: &Occurrence, scale: &Scale, y: f64, in_focus: bool) -> Group {
    let (left, right) = (scale.x(occurrence.window.ready), scale.x(occurrence.window.delivery));
    let area = Area::between(left, right, y + 6.0, 38.0);
    let shape = area.rectangle(WINDOW).set("stroke", MARK);
    let width = if in_focus { 2.4 } else { 0.8 };
    let group = Group::new().add(shape.set("stroke-width", width));
    if in_focus { group.add(shown_above(left, right, y)) } else { group }
}

/// Beside the slot in focus, on that side where there is room.
fn shown_above(left: f64, right: f64, y: f64) -> Text {
    let label = Label::new("shown above", 10.0).bold().ink(MARK);
    if right + GAP + label.width() <= WIDTH {
        label.at(right + GAP, y + 10.5)
    } else {
        label.anchor(Anchor::End).at(left - GAP, y + 10.5)
    }
}

/// Ready, LST, deadline and delivery, as ticks below the frames.
fn instants(occurrence: &Occurrence, scale: &Scale, y: f64) -> Group {
    let window = &occurrence.window;
    let mut group = Group::new();
    for (at, height) in
        [(window.ready, 7.0), (window.latest_start, 5.0), (window.deadline, 5.0), (window.delivery, 7.0)]
    {
        let x = scale.x(at);
        group = group.add(line((x, y + 37.0), (x, y + 37.0 + height), MARK, 1.4));
    }
    group
}

fn axis(cycle: Duration, y: f64) -> Group {
    let mut group = Group::new().add(line((LEFT, y), (RIGHT, y), INK, 1.2));
    let marks = cycle.as_millis().max(1);
    for mark in 0..=marks {
        let x = LEFT + (RIGHT - LEFT) * mark as f64 / marks as f64;
        let text = format!("+{mark}");
        group = group
            .add(line((x, y), (x, y + 5.0), INK, 1.2))
            .add(Label::new(&text, 11.0).ink(FAINT_INK).anchor(Anchor::Middle).at(x, y + 18.0));
    }
    group.add(Label::new("ms", 11.0).ink(FAINT_INK).anchor(Anchor::End).at(LEFT - UNIT_GAP, y + 18.0))
}

/// Between a slot and what is said of it.
const GAP: f64 = 4.0;
const CYCLES: u64 = 5;
const ROW: f64 = 54.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_of_a_slot_is_never_cut_off() {
        let place = |right: f64| shown_above(right - 160.0, right, 0.0).to_string();
        assert!(place(RIGHT - 200.0).contains("start"), "{}", place(RIGHT - 200.0));
        assert!(place(RIGHT).contains("text-anchor=\"end\""), "{}", place(RIGHT));
        assert!(place(RIGHT).contains(&format!("x=\"{}\"", RIGHT - 160.0 - GAP)), "{}", place(RIGHT));
    }
}
