//! The curves of scale: one panel for each cost, against the number of segments, both axes logarithmic.

use svg::Document;
use svg::node::element::{Circle, Line, Polyline, Rectangle, Text};

use crate::scale::{Point, Scale};

/// One curve of a panel.
struct Curve {
    label: &'static str,
    colour: &'static str,
    /// Broken: it is zenoh's, not ours.
    is_zenoh: bool,
    of: fn(&Point) -> f64,
}

struct Panel {
    title: &'static str,
    curves: &'static [Curve],
}

const PANELS: [Panel; 4] = [
    Panel {
        title: "processor time of an event, µs",
        curves: &[
            Curve { label: "gateway that sends", colour: BLUE, is_zenoh: false, of: |it| it.event[0] },
            Curve { label: "gateway that gets", colour: GREEN, is_zenoh: false, of: |it| it.event[2] },
            Curve {
                label: "router, for each receiver",
                colour: ORANGE,
                is_zenoh: true,
                of: |it| it.event[1],
            },
        ],
    },
    Panel {
        title: "processor time of a declaration, µs",
        curves: &[
            Curve { label: "gateway", colour: BLUE, is_zenoh: false, of: |it| it.declaration[0] },
            Curve { label: "router", colour: ORANGE, is_zenoh: true, of: |it| it.declaration[1] },
        ],
    },
    Panel {
        title: "memory in use, MB",
        curves: &[
            Curve { label: "a gateway", colour: BLUE, is_zenoh: false, of: |it| it.memory[0] },
            Curve { label: "the router", colour: ORANGE, is_zenoh: true, of: |it| it.memory[1] },
        ],
    },
    Panel {
        title: "with nothing to forward, ms of processor a second",
        curves: &[
            Curve { label: "a gateway", colour: BLUE, is_zenoh: false, of: |it| it.idle[0] },
            Curve { label: "the router", colour: ORANGE, is_zenoh: true, of: |it| it.idle[1] },
        ],
    },
];

/// Draws them. Subjects are told apart by the marks: hollow for the fewest, full for the most.
pub fn draw(scale: &Scale) -> String {
    let mut document = Document::new()
        .set("viewBox", (0, 0, 2.0 * WIDTH, 2.0 * HEIGHT + FOOT))
        .set("font-family", "sans-serif")
        .set("font-size", 13)
        .add(Rectangle::new().set("width", "100%").set("height", "100%").set("fill", "white"));
    let mut subjects: Vec<usize> = scale.points.iter().map(|point| point.subjects).collect();
    subjects.sort_unstable();
    subjects.dedup();
    for (at, panel) in PANELS.iter().enumerate() {
        let corner = ((at % 2) as f64 * WIDTH, (at / 2) as f64 * HEIGHT);
        document = draw_panel(document, panel, scale, &subjects, corner);
    }
    let names: Vec<_> = subjects.iter().map(ToString::to_string).collect();
    let legend = [
        format!(
            "Against the number of segments, with {} subjects on each (hollow marks: {}); broken lines: zenoh's router.",
            names.join(" and "),
            names.first().map_or("", String::as_str),
        ),
        "All scales are logarithmic; less is better.".to_owned(),
    ];
    for (row, line) in legend.into_iter().enumerate() {
        let y = 2.0 * HEIGHT + 14.0 + 18.0 * row as f64;
        document = document.add(Text::new(line).set("x", LEFT).set("y", y).set("fill", "#333"));
    }
    document.to_string()
}

/// From numbers to places.
struct Axes {
    corner: (f64, f64),
    x: (f64, f64),
    y: (f64, f64),
}

impl Axes {
    fn of(panel: &Panel, scale: &Scale, corner: (f64, f64)) -> Self {
        let values = scale.points.iter().flat_map(|point| panel.curves.iter().map(|it| (it.of)(point)));
        let values: Vec<f64> = values.map(|value| value.max(LEAST)).collect();
        let segments: Vec<f64> = scale.points.iter().map(|point| point.segments as f64).collect();
        let span = |all: &[f64]| {
            let (low, high) =
                all.iter().fold((f64::MAX, LEAST), |(low, high), it| (low.min(*it), high.max(*it)));
            (low, high)
        };
        let (low, high) = span(&values);
        Self {
            corner,
            x: span(&segments),
            // With room for the names of the curves.
            y: (10_f64.powf(low.log10().floor()), 10_f64.powf((high.log10() + 0.5).ceil())),
        }
    }

    fn place(&self, segments: f64, value: f64) -> (f64, f64) {
        let part = |at: f64, (low, high): (f64, f64)| {
            if high > low { (at.max(LEAST).ln() - low.ln()) / (high.ln() - low.ln()) } else { 0.5 }
        };
        let (width, height) = (WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM);
        (
            self.corner.0 + LEFT + part(segments, self.x) * width,
            self.corner.1 + TOP + (1.0 - part(value, self.y)) * height,
        )
    }
}

fn draw_panel(
    document: Document,
    panel: &Panel,
    scale: &Scale,
    subjects: &[usize],
    corner: (f64, f64),
) -> Document {
    let axes = Axes::of(panel, scale, corner);
    let title = Text::new(panel.title).set("x", corner.0 + LEFT).set("y", corner.1 + 22.0);
    let mut document = grid(document.add(title.set("font-size", 15)), &axes, scale);
    for (row, curve) in panel.curves.iter().enumerate() {
        for (at, &of) in subjects.iter().enumerate() {
            let points = scale.points.iter().filter(|point| point.subjects == of);
            let places: Vec<_> =
                points.map(|point| axes.place(point.segments as f64, (curve.of)(point))).collect();
            document = draw_curve(document, curve, &places, at + 1 == subjects.len());
        }
        let y = corner.1 + TOP + 14.0 + 17.0 * row as f64;
        let x = corner.0 + LEFT + 10.0;
        document = document
            .add(stroke(curve, (x, y - 4.0), (x + 22.0, y - 4.0)))
            .add(Text::new(curve.label).set("x", x + 28.0).set("y", y).set("fill", curve.colour));
    }
    document
}

fn draw_curve(mut document: Document, curve: &Curve, places: &[(f64, f64)], is_full: bool) -> Document {
    let points: Vec<_> = places.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let line =
        Polyline::new().set("points", points.join(" ")).set("fill", "none").set("stroke", curve.colour);
    document = document.add(line.set("stroke-width", 1.6).set("stroke-dasharray", dashes(curve)));
    for (x, y) in places {
        let fill = if is_full { curve.colour } else { "white" };
        let mark = Circle::new().set("cx", *x).set("cy", *y).set("r", 3.5).set("fill", fill);
        document = document.add(mark.set("stroke", curve.colour).set("stroke-width", 1.4));
    }
    document
}

fn grid(mut document: Document, axes: &Axes, scale: &Scale) -> Document {
    let mut decade = axes.y.0;
    while decade <= axes.y.1 * 1.001 {
        let (left, y) = axes.place(axes.x.0, decade);
        let (right, _) = axes.place(axes.x.1, decade);
        document = document
            .add(thin((left, y), (right, y)))
            .add(Text::new(label(decade)).set("x", left - 8.0).set("y", y + 4.0).set("text-anchor", "end"));
        decade *= 10.0;
    }
    let mut segments: Vec<usize> = scale.points.iter().map(|point| point.segments).collect();
    segments.sort_unstable();
    segments.dedup();
    for at in segments {
        let (x, bottom) = axes.place(at as f64, axes.y.0);
        let (_, top) = axes.place(at as f64, axes.y.1);
        document = document
            .add(thin((x, bottom), (x, top)))
            .add(Text::new(at.to_string()).set("x", x).set("y", bottom + 18.0).set("text-anchor", "middle"));
    }
    document
}

fn label(decade: f64) -> String {
    if decade < 1.0 { format!("{decade}") } else { format!("{decade:.0}") }
}

fn thin(from: (f64, f64), to: (f64, f64)) -> Line {
    line(from, to).set("stroke", "#ddd").set("stroke-width", 1)
}

fn stroke(curve: &Curve, from: (f64, f64), to: (f64, f64)) -> Line {
    line(from, to).set("stroke", curve.colour).set("stroke-width", 1.6).set("stroke-dasharray", dashes(curve))
}

fn line(from: (f64, f64), to: (f64, f64)) -> Line {
    Line::new().set("x1", from.0).set("y1", from.1).set("x2", to.0).set("y2", to.1)
}

fn dashes(curve: &Curve) -> &'static str {
    if curve.is_zenoh { "5 4" } else { "none" }
}

const WIDTH: f64 = 500.0;
const HEIGHT: f64 = 320.0;
const FOOT: f64 = 48.0;
const LEFT: f64 = 60.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 36.0;
const BOTTOM: f64 = 36.0;
/// What is less is drawn as this.
const LEAST: f64 = 0.01;
const BLUE: &str = "#0072b2";
const GREEN: &str = "#007a5a";
const ORANGE: &str = "#d55e00";

#[cfg(test)]
mod tests {
    use super::*;

    fn point(segments: usize, subjects: usize) -> Point {
        let cost = segments as f64;
        Point {
            segments,
            subjects,
            began: 1.0,
            declaration: [cost, cost * 2.0],
            memory: [1.0, cost],
            idle: [0.0, cost],
            event: [10.0, 5.0, 8.0],
            arrived: (10, 1.0),
        }
    }

    #[test]
    fn every_point_of_every_curve_has_a_mark() {
        let points = vec![point(2, 10), point(100, 10), point(2, 100), point(100, 100)];
        let picture = draw(&Scale { points });
        let curves: usize = PANELS.iter().map(|panel| panel.curves.len()).sum();
        assert_eq!(picture.matches("<circle").count(), 4 * curves);
        assert!(!picture.contains("NaN") && !picture.contains("inf"));
    }
}
