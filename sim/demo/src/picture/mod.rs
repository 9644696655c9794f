//! A picture of the bus: one slot close up, and the cycles around it.
//!
//! It shows the slot that tells most: one that was not as promised, else one beyond its fault hypothesis,
//! else the first whose frame was destroyed, else the one next to the first destroyed frame, else any. An SVG file; in a browser, what the pointer rests on
//! explains itself.

mod axis;
mod canvas;
mod closeup;
mod cycles;
mod frames;
mod legend;
mod palette;

use cosmic_bus::VirtualInstant;
use svg::Document;

use crate::columns::counted;
use crate::hard::{Fate, Occurrence};
use crate::journal::Journal;
use crate::report::Settings;
use crate::span::Span;
use crate::verdict::Verdict;
use canvas::{Area, Label, definitions};
use palette::{FAINT_INK, PAPER};

/// Draws a run.
pub fn draw(settings: &Settings, journal: &Journal, verdict: &Verdict) -> String {
    let focus = focus(journal, verdict);
    let start = start_of_cycle(journal, focus);
    let closeup = TITLE + 40.0;
    let cycles = match focus {
        Some(_) => closeup + closeup::height(journal.cluster.nodes.len()) + 44.0,
        None => closeup,
    };
    let legend = cycles + cycles::HEIGHT + 16.0;
    let height = legend + legend::HEIGHT + 8.0;
    let paper = Area { x: 0.0, y: 0.0, width: WIDTH, height };
    let mut document = Document::new()
        .set("viewBox", (0, 0, WIDTH, height))
        .set("width", WIDTH)
        .set("height", height)
        .set("font-family", "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif")
        .add(definitions())
        .add(paper.rectangle(PAPER))
        .add(Label::new("COSMIC on the CAN bus", 22.0).bold().at(24.0, 36.0))
        .add(Label::new(&subtitle(settings, journal), 13.0).ink(FAINT_INK).at(24.0, 58.0));
    if let Some(occurrence) = focus {
        document = document
            .add(Label::new(&caption(journal, occurrence), 15.0).bold().at(24.0, TITLE + 16.0))
            .add(closeup::draw(journal, verdict, occurrence, closeup));
    }
    let heading = "The cycles around it: one row for each, from the start of the cycle (ms since the start of \
                   the run) on";
    document
        .add(Label::new(heading, 15.0).bold().at(24.0, cycles - 14.0))
        .add(cycles::draw(journal, verdict, start, focus, cycles))
        .add(legend::draw(journal.cluster, legend))
        .to_string()
}

/// The slot that tells most.
fn focus<'v>(journal: &Journal, verdict: &'v Verdict) -> Option<&'v Occurrence> {
    let judged = || verdict.slots.occurrences.iter().filter(|it| it.fate.is_judged());
    let with = |fate| judged().find(|it| it.fate == fate);
    let faulted = || judged().find(|it| it.faulted > 0);
    let near_error = || {
        let first = judged().next()?.window.ready;
        let last = judged().next_back()?.window.delivery;
        let mut attempts = journal.bus.attempts().iter();
        let error = attempts.find(|it| it.has_failed() && it.start > first && it.start < last)?;
        judged().min_by_key(|it| Span::between(it.window.ready, error.start).abs())
    };
    let any = || judged().nth(judged().count() / 2);
    with(Fate::Violated).or_else(|| with(Fate::Lost)).or_else(faulted).or_else(near_error).or_else(any)
}

fn start_of_cycle(journal: &Journal, focus: Option<&Occurrence>) -> VirtualInstant {
    let cycle = journal.cluster.calendar.cycle().as_ticks();
    let Some(occurrence) = focus else {
        return VirtualInstant::from_ticks(journal.end.as_ticks().saturating_sub(3 * cycle));
    };
    let timeline = journal.timeline();
    let ready = timeline.global(occurrence.window.ready).map_or(0, |at| at.since_epoch().as_ticks());
    // One nanosecond of rounding must not push the slot into the cycle before.
    let into = (ready + 1_000) % cycle;
    VirtualInstant::from_ticks(occurrence.window.ready.as_ticks().saturating_sub(into.saturating_sub(1_000)))
}

fn subtitle(settings: &Settings, journal: &Journal) -> String {
    format!(
        "{} nodes at {} kbit/s, load {:.0}%; a frame is destroyed with chance {}; seed {}; the run ended after \
         {:.3} s. Axes in milliseconds of true time.",
        journal.cluster.nodes.len(),
        journal.bit_rate.bits_per_second() / 1000,
        settings.load_percent,
        settings.error_rate,
        settings.seed,
        journal.end.as_ticks() as f64 / 1e9
    )
}

fn caption(journal: &Journal, occurrence: &Occurrence) -> String {
    let name = (journal.cluster.channel_of(occurrence.slot.etag, occurrence.slot.publisher))
        .map_or("a channel", |channel| channel.name);
    let faults = match occurrence.faulted {
        0 => "no attempt was destroyed".to_owned(),
        1 => "one attempt was destroyed".to_owned(),
        count => format!("{count} attempts were destroyed"),
    };
    let outcome = match occurrence.fate {
        Fate::Settling => "clocks not synchronised",
        Fate::NoCommonTime => "no common time",
        Fate::Delivered => "delivered at its instant all the same",
        Fate::Unused => "nothing was published",
        Fate::Lost => "lost, and publisher and subscribers were told",
        Fate::Violated => "NOT AS PROMISED",
    };
    let outcome = if occurrence.faulted == 0 && occurrence.fate == Fate::Delivered {
        "delivered at its instant"
    } else {
        outcome
    };
    format!(
        "The slot of \"{name}\" (hard real-time, tolerates {}): {faults}, {outcome}",
        counted(u32::from(occurrence.slot.omission_degree), "omission")
    )
}

const WIDTH: f64 = 1480.0;
/// Where time begins and ends on the paper.
const LEFT: f64 = 120.0;
const RIGHT: f64 = 1440.0;
/// The lower edge of the title.
const TITLE: f64 = 72.0;
