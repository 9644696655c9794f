//! The share of message sets whose deadlines are all met, over the load: one curve a policy.

use super::report::Report;
use svg::Document;
use svg::node::element::{Line, Polyline, Rectangle, Text};

/// Draws the curves, as the text of an SVG file.
pub(super) fn draw(report: &Report<'_>) -> String {
    let plot = Plot::around(report);
    let mut document = Document::new()
        .set("viewBox", (0, 0, WIDTH, HEIGHT))
        .set("width", WIDTH)
        .set("font-family", "Helvetica, Arial, sans-serif")
        .set("font-size", 14)
        .add(Rectangle::new().set("width", WIDTH).set("height", HEIGHT).set("fill", "white"));
    document = plot.axes(document);
    for (at, style) in STYLES.iter().enumerate() {
        document = document.add(plot.curve(report, at, style));
    }
    plot.legend(report, document).to_string() + "\n"
}

/// How a curve is drawn. Ideal EDF comes first and widest, because others may hide it.
struct Style {
    colour: &'static str,
    width: f64,
    dashes: &'static str,
}

/// In the order of the policies.
const STYLES: [Style; super::POLICIES.len()] = [
    Style { colour: "#c0c0c0", width: 8.0, dashes: "none" },
    Style { colour: "#0060c0", width: 2.5, dashes: "none" },
    Style { colour: "#c04000", width: 2.5, dashes: "none" },
    Style { colour: "#208040", width: 2.5, dashes: "7 4" },
];

struct Plot {
    /// The load at the left edge, in percent.
    from: u32,
}

impl Plot {
    fn around(report: &Report<'_>) -> Self {
        let loads = report.sets.iter().flat_map(|set| set.breakdown).map(|it| it.load * 100.0);
        let least = loads.fold(RIGHTMOST.into(), f64::min);
        Self { from: ((least - 1.0).max(0.0) / 5.0) as u32 * 5 }
    }

    fn x(&self, percent: f64) -> f64 {
        LEFT + (percent - f64::from(self.from)) / f64::from(RIGHTMOST - self.from) * (RIGHT - LEFT)
    }

    fn y(share: f64) -> f64 {
        BOTTOM - share * (BOTTOM - TOP)
    }

    fn axes(&self, mut document: Document) -> Document {
        for percent in (self.from..=RIGHTMOST).step_by(if RIGHTMOST - self.from > 30 { 10 } else { 5 }) {
            let x = self.x(percent.into());
            let text = label(&format!("{percent} %"), (x, BOTTOM + 20.0), "middle");
            document = document.add(grid_line((x, x), (TOP, BOTTOM))).add(text);
        }
        for percent in (0..=100).step_by(25) {
            let y = Self::y(f64::from(percent) / 100.0);
            let text = label(&format!("{percent} %"), (LEFT - 8.0, y + 5.0), "end");
            document = document.add(grid_line((LEFT, RIGHT), (y, y))).add(text);
        }
        let below = ((LEFT + RIGHT) / 2.0, BOTTOM + 44.0);
        let above = (LEFT, TOP - 16.0);
        let document = document.add(label("Load of the bus", below, "middle"));
        document.add(label("Message sets without a missed deadline", above, "start"))
    }

    /// Falls by one set at the breakdown of each.
    fn curve(&self, report: &Report<'_>, at: usize, style: &Style) -> Polyline {
        let mut loads: Vec<f64> = report.sets.iter().map(|set| set.breakdown[at].load * 100.0).collect();
        loads.sort_by(f64::total_cmp);
        let mut points = vec![(LEFT, Self::y(1.0))];
        let count = loads.len() as f64;
        for (left, load) in (0..loads.len()).rev().zip(loads) {
            let x = self.x(load.min(RIGHTMOST.into()));
            points.push((x, Self::y((left + 1) as f64 / count)));
            points.push((x, Self::y(left as f64 / count)));
        }
        let points: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        Polyline::new()
            .set("points", points.join(" "))
            .set("fill", "none")
            .set("stroke", style.colour)
            .set("stroke-width", style.width)
            .set("stroke-dasharray", style.dashes)
            .set("stroke-linejoin", "round")
    }

    fn legend(&self, report: &Report<'_>, mut document: Document) -> Document {
        for (row, (style, summary)) in STYLES.iter().zip(&report.policies).enumerate() {
            let x = if row < 2 { LEFT } else { (LEFT + RIGHT) / 2.0 };
            let y = BOTTOM + 72.0 + 24.0 * (row % 2) as f64;
            let sample = Line::new()
                .set("x1", x)
                .set("x2", x + 36.0)
                .set("y1", y)
                .set("y2", y)
                .set("stroke", style.colour)
                .set("stroke-width", style.width)
                .set("stroke-dasharray", style.dashes);
            let text = format!("{}: {:.1} % on average", summary.policy, summary.mean * 100.0);
            document = document.add(sample).add(label(&text, (x + 46.0, y + 5.0), "start"));
        }
        document
    }
}

fn grid_line((x1, x2): (f64, f64), (y1, y2): (f64, f64)) -> Line {
    let line = Line::new().set("x1", x1).set("x2", x2).set("y1", y1).set("y2", y2);
    line.set("stroke", "#e0e0e0").set("stroke-width", 1)
}

fn label(text: &str, (x, y): (f64, f64), anchor: &str) -> Text {
    Text::new(text).set("x", x).set("y", y).set("text-anchor", anchor)
}

const WIDTH: u32 = 800;
const HEIGHT: u32 = 500;
const LEFT: f64 = 72.0;
const RIGHT: f64 = 770.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 380.0;
/// The load at the right edge, in percent: that of a bus which is never free.
const RIGHTMOST: u32 = 100;
