//! Drawing with few words: scales, boxes, lines, texts.

use cosmic_bus::VirtualInstant;
use svg::Node as _;
use svg::node::element::{Definitions, Group, Line, Path, Pattern, Polygon, Rectangle, Text, Title};

use super::palette::{ERROR, INK, PAPER};
use crate::span::Span;

/// Where instants lie on the paper.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    pub(super) from: VirtualInstant,
    pub(super) until: VirtualInstant,
    pub(super) left: f64,
    pub(super) right: f64,
}

impl Scale {
    /// The place of an instant; beyond the ends it is the end.
    pub(super) fn x(&self, at: VirtualInstant) -> f64 {
        let whole = Span::between(self.from, self.until).as_micros().max(1e-3);
        let share = Span::between(self.from, at).as_micros() / whole;
        round(self.left + share.clamp(0.0, 1.0) * (self.right - self.left))
    }

    pub(super) fn shows(&self, at: VirtualInstant) -> bool {
        (self.from..=self.until).contains(&at)
    }
}

/// A box.
#[derive(Clone, Copy, Debug)]
pub(super) struct Area {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) width: f64,
    pub(super) height: f64,
}

impl Area {
    pub(super) fn between(left: f64, right: f64, y: f64, height: f64) -> Self {
        Self { x: left, y, width: round((right - left).max(0.0)), height }
    }

    pub(super) fn rectangle(&self, fill: &str) -> Rectangle {
        Rectangle::new()
            .set("x", self.x)
            .set("y", self.y)
            .set("width", self.width)
            .set("height", self.height)
            .set("fill", fill)
    }
}

/// How a text stands at its place.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A text and its looks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Label<'t> {
    pub(super) text: &'t str,
    pub(super) size: f64,
    pub(super) ink: &'t str,
    pub(super) bold: bool,
    pub(super) anchor: Anchor,
    pub(super) halo: bool,
}

impl<'t> Label<'t> {
    pub(super) const fn new(text: &'t str, size: f64) -> Self {
        Self { text, size, ink: INK, bold: false, anchor: Anchor::Start, halo: false }
    }

    pub(super) const fn bold(self) -> Self {
        Self { bold: true, ..self }
    }

    pub(super) const fn ink(self, ink: &'t str) -> Self {
        Self { ink, ..self }
    }

    pub(super) const fn anchor(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    /// Readable on whatever lies behind it.
    pub(super) const fn halo(self) -> Self {
        Self { halo: true, ..self }
    }

    /// Smaller, if it would be wider than that.
    pub(super) fn shrunk_to(self, width: f64) -> Self {
        Self { size: self.size * (width / self.width()).min(1.0), ..self }
    }

    /// How wide it will be, about: fonts differ.
    pub(super) fn width(&self) -> f64 {
        let share = if self.bold { 0.64 } else { 0.58 };
        self.text.chars().count() as f64 * self.size * share
    }

    pub(super) fn at(&self, x: f64, y: f64) -> Text {
        let anchor = match self.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let mut text = Text::new(self.text)
            .set("x", round(x))
            .set("y", round(y))
            .set("font-size", round(self.size))
            .set("fill", self.ink)
            .set("text-anchor", anchor);
        if self.halo {
            text.assign("stroke", PAPER);
            text.assign("stroke-width", 3);
            text.assign("paint-order", "stroke");
        }
        if self.bold {
            text.assign("font-weight", "bold");
        }
        text
    }
}

pub(super) fn line(from: (f64, f64), to: (f64, f64), ink: &str, width: f64) -> Line {
    Line::new()
        .set("x1", from.0)
        .set("y1", from.1)
        .set("x2", to.0)
        .set("y2", to.1)
        .set("stroke", ink)
        .set("stroke-width", width)
}

/// A triangle that points down at `(x, y)`.
pub(super) fn pointer(x: f64, y: f64, ink: &str) -> Polygon {
    let points = format!("{x},{y} {},{} {},{}", x - 4.5, y - 8.0, x + 4.5, y - 8.0);
    Polygon::new().set("points", points).set("fill", ink)
}

/// A cross over a box.
pub(super) fn cross(area: &Area) -> Path {
    let inset = (area.width.min(area.height) / 5.0).max(1.0);
    let (left, right) = (area.x + inset, area.x + area.width - inset);
    let (top, bottom) = (area.y + inset, area.y + area.height - inset);
    let data =
        format!("M{left:.1} {top:.1}L{right:.1} {bottom:.1}M{left:.1} {bottom:.1}L{right:.1} {top:.1}");
    Path::new().set("d", data).set("stroke", ERROR).set("stroke-width", 1.6).set("fill", "none")
}

/// A group that shows `text` when the pointer rests on it.
pub(super) fn explained(text: &str) -> Group {
    Group::new().add(Title::new(text))
}

pub(super) fn definitions() -> Definitions {
    let stripe = Path::new().set("d", "M-2 8L8 -2M2 12L12 2").set("stroke", ERROR).set("stroke-width", 2.2);
    let pattern = Pattern::new()
        .set("id", "destroyed")
        .set("width", 10)
        .set("height", 10)
        .set("patternUnits", "userSpaceOnUse")
        .add(Rectangle::new().set("width", 10).set("height", 10).set("fill", "#fee2e2"))
        .add(stripe);
    Definitions::new().add(pattern)
}

/// To a hundredth: enough for the eye, and the file stays small.
pub(super) fn round(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_are_shrunk_and_short_ones_are_not() {
        assert_eq!(Label::new("brake", 13.0).bold().shrunk_to(104.0).size, 13.0);
        let long = Label::new("controller of the left front wheel", 13.0).bold().shrunk_to(104.0);
        assert!((103.0..105.0).contains(&long.width()), "{}", long.width());
    }
}
