//! The axis of time, in milliseconds.

use cosmic_core::time::Duration;
use svg::node::element::Group;

use super::canvas::{Anchor, Label, Scale, line};
use super::palette::{FAINT_INK, INK};
use cosmic_bus::VirtualInstant;

/// True time since the start of the run, with a mark every `step`.
pub(super) fn draw(scale: &Scale, y: f64, step: Duration, decimals: usize) -> Group {
    let first = scale.from.as_ticks().div_ceil(step.as_ticks()) * step.as_ticks();
    let marks = (first..=scale.until.as_ticks()).step_by(step.as_ticks() as usize);
    let mut group = Group::new().add(line((scale.left, y), (scale.right, y), INK, 1.2));
    for ticks in marks {
        let x = scale.x(VirtualInstant::from_ticks(ticks));
        let text = format!("{:.decimals$}", ticks as f64 / 1e6);
        group = group
            .add(line((x, y), (x, y + 5.0), INK, 1.2))
            .add(Label::new(&text, 11.0).anchor(Anchor::Middle).ink(FAINT_INK).at(x, y + 18.0));
    }
    let name = Label::new("ms", 11.0).ink(FAINT_INK).anchor(Anchor::End);
    group.add(name.at(scale.left - UNIT_GAP, y + 18.0))
}

/// From the first mark to the unit: half of what stands at the mark, and a space.
pub(super) const UNIT_GAP: f64 = 32.0;
