//! A picture of the calendar: one cycle as a time line, and one slot in detail.
//!
//! The top lane shows all windows and what is free; below, one lane for each channel and publisher (or for each node,
//! if there are very many), the load over the cycle, and the bounds of the other classes against their deadlines. Opened in a browser, the wheel zooms around the pointer, dragging moves,
//! a double click shows all again, and every window tells its instants when the pointer rests on it.

mod bounds;
mod load;

use crate::analysis::segment::Assessment;
use crate::cluster::Cluster;
use crate::plan::{Plan, PlannedSlot};
use crate::units::show;
use cosmic_core::time::Duration;
use svg::Document;
use svg::node::element::{Group, Line, Polygon, Rectangle, Script, Style, Text, Title};

/// The text of the file.
pub fn render(cluster: &Cluster, plan: &Plan, assessment: &Assessment) -> String {
    let lanes = lanes(cluster, plan);
    let lane = if lanes.len() > FEW_LANES { LOW_LANE } else { LANE };
    let bottom = TOP + LANE + lane * lanes.len() as f64;
    let detail_top = bottom + 50.0;
    let load_top = detail_top + if plan.slots().is_empty() { 30.0 } else { DETAIL + 40.0 };
    let (load, load_height) = load::draw(plan, assessment, load_top);
    let bounds_top = load_top + load_height;
    let (bounds, bounds_height) = bounds::draw(cluster, assessment, bounds_top);
    let height = bounds_top + bounds_height;
    let scale = Scale { cycle: plan.cycle().as_ticks().max(1) as f64 };
    let mut lines = Group::new().set("id", "zoomed");
    lines = lines.add(all_windows(plan, &scale));
    for (at, entry) in lanes.iter().enumerate() {
        let top = TOP + LANE + lane * at as f64;
        lines = lines.add(lane_of(cluster, plan, &scale, entry, top, lane));
    }
    lines = lines.add(axis(plan.cycle(), &scale, bottom));
    // What is zoomed must not run into the labels.
    let clip = svg::node::element::ClipPath::new()
        .set("id", "lines")
        .add(Rectangle::new().set("x", LEFT).set("y", 40).set("width", WIDTH).set("height", bottom - 10.0));
    let mut document = Document::new()
        .set("viewBox", (0, 0, LEFT + WIDTH + 20.0, height))
        .set("font-family", "DejaVu Sans, Verdana, sans-serif")
        .add(Style::new(STYLE))
        .add(Rectangle::new().set("width", "100%").set("height", "100%").set("fill", "#fff"))
        .add(heading(cluster, plan))
        .add(clip)
        .add(Group::new().set("clip-path", "url(#lines)").add(lines))
        .add(labels(&lanes, lane));
    if let Some(first) = plan.slots().iter().max_by_key(|planned| planned.times.delivery) {
        document = document.add(detail(cluster, first, detail_top));
    } else {
        document = document.add(
            text(LEFT, detail_top, "There are no hard real-time channels: the whole cycle is free.")
                .set("class", "label"),
        );
    }
    document = document.add(load).add(bounds).add(Script::new(ZOOM));
    format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{document}\n")
}

/// From instants of the cycle to places in the picture.
struct Scale {
    cycle: f64,
}

impl Scale {
    fn x(&self, instant: u64) -> f64 {
        LEFT + instant as f64 / self.cycle * WIDTH
    }
}

struct Lane {
    label: String,
    /// Positions in [`Plan::slots`].
    slots: Vec<usize>,
}

fn lanes(cluster: &Cluster, plan: &Plan) -> Vec<Lane> {
    let by_node =
        plan.slots().iter().map(|s| s.channel).collect::<std::collections::BTreeSet<_>>().len() > MOST_LANES;
    let mut lanes: Vec<Lane> = Vec::new();
    for (at, planned) in plan.slots().iter().enumerate() {
        let node = &cluster.nodes[planned.node].name;
        let channel = &cluster.channels[planned.channel].name;
        let label = if by_node { node.clone() } else { format!("{channel} ({node})") };
        match lanes.iter_mut().find(|lane| lane.label == label) {
            Some(lane) => lane.slots.push(at),
            None => lanes.push(Lane { label, slots: vec![at] }),
        }
    }
    lanes
}

/// A label that ends where the lanes begin.
fn shortened(label: &str) -> String {
    if label.chars().count() <= LABEL {
        return label.to_owned();
    }
    label.chars().take(LABEL - 1).chain(['…']).collect()
}

fn text(x: f64, y: f64, content: impl Into<String>) -> Text {
    Text::new(content.into()).set("x", round(x)).set("y", round(y))
}

fn rectangle(x: f64, y: f64, width: f64, height: f64, class: &str) -> Rectangle {
    Rectangle::new()
        .set("x", round(x))
        .set("y", round(y))
        .set("width", round(width))
        .set("height", round(height))
        .set("class", class)
}

/// Hundredths of a pixel suffice at any zoom that a browser offers.
fn round(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

fn heading(cluster: &Cluster, plan: &Plan) -> Group {
    let reserved = plan.reserved() * 100.0;
    let title = format!("Calendar of segment {}", cluster.name);
    let digest =
        plan.calendar().map_or(String::new(), |calendar| format!(", digest {:08x}", calendar.digest()));
    let count = plan.slots().len();
    let slots = if count == 1 { "slot" } else { "slots" };
    let line = format!("cycle {}, {count} {slots}, {reserved:.1} % reserved{digest}", show(plan.cycle()));
    Group::new()
        .add(text(20.0, 26.0, title).set("class", "title"))
        .add(text(20.0, 44.0, line).set("class", "label"))
        .add(legend())
}

fn legend() -> Group {
    let entries = [
        ("wait", "ΔT_wait"),
        ("frame", "frame"),
        ("retry", "retransmissions"),
        ("gap", "gap"),
        ("free", "free for soft and non real-time"),
    ];
    let mut group = Group::new();
    let mut x = LEFT + WIDTH - 760.0;
    for (class, name) in [("lst", "LST"), ("deadline", "deadline")] {
        let line =
            Line::new().set("x1", x + 7.0).set("x2", x + 7.0).set("y1", 33).set("y2", 47).set("class", class);
        group = group.add(line).add(text(x + 16.0, 44.0, name).set("class", "label"));
        x += 38.0 + 7.0 * name.chars().count() as f64;
    }
    for (class, name) in entries {
        group = group
            .add(rectangle(x, 34.0, 14.0, 12.0, class))
            .add(text(x + 20.0, 44.0, name).set("class", "label"));
        x += 44.0 + 7.4 * name.chars().count() as f64;
    }
    group
}

fn labels(lanes: &[Lane], height: f64) -> Group {
    let mut group = Group::new().add(text(20.0, TOP + LANE * 0.6, "bus").set("class", "label"));
    for (at, lane) in lanes.iter().enumerate() {
        let y = TOP + LANE + height * (at as f64 + 0.5) + 4.0;
        let class = if height < LANE { "small" } else { "label" };
        group = group.add(text(20.0, y, shortened(&lane.label)).set("class", class));
    }
    group
}

/// The top lane: free time as ground, all windows on it.
fn all_windows(plan: &Plan, scale: &Scale) -> Group {
    let mut group = Group::new().add(rectangle(LEFT, TOP + 4.0, WIDTH, LANE - 8.0, "free"));
    for (ready, planned) in plan.occurrences() {
        group = group.add(window(plan, scale, ready, planned, TOP + 4.0, LANE - 8.0));
    }
    group
}

fn lane_of(cluster: &Cluster, plan: &Plan, scale: &Scale, lane: &Lane, top: f64, height: f64) -> Group {
    let mut group = Group::new().add(
        Line::new()
            .set("x1", LEFT)
            .set("x2", LEFT + WIDTH)
            .set("y1", top + height)
            .set("y2", top + height)
            .set("class", "rule"),
    );
    for (ready, planned) in plan.occurrences() {
        let ours = lane.slots.iter().any(|at| std::ptr::eq(&plan.slots()[*at], planned));
        if ours {
            let drawn = window(plan, scale, ready, planned, top + 0.15 * height, 0.7 * height);
            group = group.add(drawn.add(Title::new(hint(cluster, ready, planned))));
        }
    }
    group
}

fn hint(cluster: &Cluster, ready: Duration, planned: &PlannedSlot) -> String {
    format!(
        "{} of {}\nready {}\nLST {}\ndeadline {}\ndelivery {}",
        cluster.channels[planned.channel].name,
        cluster.nodes[planned.node].name,
        show(ready),
        show(ready + planned.times.latest_start),
        show(ready + planned.times.deadline),
        show(ready + planned.times.delivery)
    )
}

/// The parts of a window: name of the style, and from where to where, relative to ready.
fn parts(plan_rate: cosmic_core::can::BitRate, planned: &PlannedSlot) -> [(&'static str, u64, u64); 4] {
    let times = &planned.times;
    let lst = times.latest_start.as_ticks();
    let deadline = times.deadline.as_ticks();
    let frame = lst + plan_rate.longest_frame(usize::from(planned.slot.len)).as_ticks();
    [
        ("wait", 0, lst),
        ("frame", lst, frame),
        ("retry", frame, deadline),
        ("gap", deadline, times.delivery.as_ticks()),
    ]
}

/// A window; what reaches beyond the end of the cycle is drawn at its start.
fn window(
    plan: &Plan,
    scale: &Scale,
    ready: Duration,
    planned: &PlannedSlot,
    top: f64,
    height: f64,
) -> Group {
    let cycle = plan.cycle().as_ticks();
    let mut group = Group::new();
    for (class, from, to) in parts(plan.segment().bit_rate, planned) {
        let (from, to) = (ready.as_ticks() + from, ready.as_ticks() + to);
        let pieces = if to <= cycle {
            vec![(from, to)]
        } else if from >= cycle {
            vec![(from - cycle, to - cycle)]
        } else {
            vec![(from, cycle), (0, to - cycle)]
        };
        for (from, to) in pieces {
            let (x, end) = (scale.x(from), scale.x(to));
            group = group.add(rectangle(x, top, end - x, height, class));
        }
    }
    let instants = [("lst", planned.times.latest_start), ("deadline", planned.times.deadline)];
    for (class, instant) in instants {
        let x = round(scale.x((ready + instant).as_ticks() % cycle));
        let line = Line::new().set("x1", x).set("x2", x).set("y1", top).set("y2", top + height);
        group = group.add(line.set("class", class));
    }
    group
}

fn axis(cycle: Duration, scale: &Scale, y: f64) -> Group {
    let ticks = cycle.as_ticks();
    let mut group = Group::new().add(
        Line::new().set("x1", LEFT).set("x2", LEFT + WIDTH).set("y1", y).set("y2", y).set("class", "axis"),
    );
    let step = round_step(ticks);
    let mut at = 0;
    while at <= ticks {
        let x = round(scale.x(at));
        let mark =
            Line::new().set("x1", x).set("x2", x).set("y1", TOP).set("y2", y + 6.0).set("class", "tick");
        let anchor = if at == 0 { "start" } else { "middle" };
        let anchor = if at + step > ticks && at == ticks { "end" } else { anchor };
        let label = text(x, y + 20.0, show(Duration::from_ticks(at)))
            .set("class", "small")
            .set("text-anchor", anchor);
        group = group.add(mark).add(label);
        at += step;
    }
    group
}

/// 1, 2 or 5 times a power of ten, so that there are about ten steps.
fn round_step(ticks: u64) -> u64 {
    let rough = (ticks / 10).max(1);
    let power = 10_u64.pow(rough.ilog10());
    [1, 2, 5, 10].map(|factor| factor * power).into_iter().find(|step| *step >= rough).unwrap_or(power)
}

/// One slot with its instants by name.
fn detail(cluster: &Cluster, planned: &PlannedSlot, top: f64) -> Group {
    let whole = planned.times.delivery.as_ticks().max(1);
    let x = |instant: u64| LEFT + 40.0 + instant as f64 / whole as f64 * (WIDTH - 80.0);
    let name = &cluster.channels[planned.channel].name;
    let node = &cluster.nodes[planned.node].name;
    let heading = match planned.pool {
        Some(pool) => format!("The window that {name} shares with the others of pool P{pool}"),
        None => format!("The slot of {name} ({node}) in detail"),
    };
    let mut group = Group::new().add(text(20.0, top, heading).set("class", "subtitle"));
    let (bar, height) = (top + 46.0, 44.0);
    for (class, from, to) in parts(cluster.segment.bit_rate, planned) {
        let width = x(to) - x(from);
        group = group.add(rectangle(x(from), bar, width, height, class));
        let meaning = match class {
            "wait" => "ΔT_wait: a frame that has just started, and a fault on it",
            "frame" => "the frame, all stuff bits",
            "retry" if planned.pool.is_some() => "the pool's other frames, shared fault budget",
            "retry" => "k retransmissions, each with error recovery",
            _ => "gap: 2ε + release jitter",
        };
        let span = show(Duration::from_ticks(to - from));
        let centre = x(from) + width / 2.0;
        let ink = if class == "frame" { "label light" } else { "label" };
        let label = text(centre, bar + 27.0, span).set("class", ink).set("text-anchor", "middle");
        // Texts can be longer than their parts: neighbours stand in different lines.
        let lower = if matches!(class, "wait" | "retry") { 18.0 } else { 36.0 };
        let (at, anchor) = match class {
            "wait" => (x(from), "start"),
            "gap" => (x(to), "end"),
            _ => (centre, "middle"),
        };
        let meaning =
            text(at, bar + height + lower, meaning).set("class", "small").set("text-anchor", anchor);
        if to > from {
            group = group.add(label).add(meaning);
        }
    }
    let times = &planned.times;
    let instants = [
        ("ready: load the mailbox", 0),
        ("LST: surely on the bus by now", times.latest_start.as_ticks()),
        ("deadline: last retry has ended", times.deadline.as_ticks()),
        ("delivery: notify subscribers", whole),
    ];
    for (at, (name, instant)) in instants.into_iter().enumerate() {
        let x = x(instant);
        let anchor = if at < 2 { "start" } else { "end" };
        // The last two stand close together.
        let y = if at == 3 { bar - 24.0 } else { bar - 8.0 };
        let mark = Polygon::new()
            .set("points", format!("{x},{bar} {},{} {},{}", x - 5.0, bar - 7.0, x + 5.0, bar - 7.0));
        let line = Line::new()
            .set("x1", x)
            .set("x2", x)
            .set("y1", y + 2.0)
            .set("y2", bar + height)
            .set("class", "instant");
        let shift = if at < 2 { 8.0 } else { -8.0 };
        group = group
            .add(mark.set("class", "mark"))
            .add(line)
            .add(text(x + shift, y, name).set("class", "small").set("text-anchor", anchor));
    }
    group
}

const LEFT: f64 = 210.0;
const WIDTH: f64 = 1180.0;
const TOP: f64 = 64.0;
const LANE: f64 = 40.0;
/// With more lanes than a few each is lower.
const FEW_LANES: usize = 24;
const LOW_LANE: f64 = 16.0;
/// With more channels there is a lane for each node only.
const MOST_LANES: usize = 150;
/// Letters of a label that fit beside the lanes.
const LABEL: usize = 27;
const DETAIL: f64 = 130.0;

const STYLE: &str = "
.title { font-size: 18px; font-weight: bold } .subtitle { font-size: 14px; font-weight: bold }
.label { font-size: 12px } .light { fill: #fff } .small { font-size: 11px }
.wait { fill: #bcd2ee } .frame { fill: #1f5fa8 } .retry { fill: #6d9fd6 } .gap { fill: #d9d9d9 }
.free { fill: #d9efd5 } .rule { stroke: #ddd } .axis { stroke: #333 } .mark { fill: #b03030 }
.tick { stroke: #999; stroke-dasharray: 2 3 } .instant { stroke: #b03030 }
.provision { fill: #bcd2ee } .bound { fill: #4f8a4b } .late { fill: #b03030 }
.others { stroke: #4f8a4b; stroke-width: 2; stroke-dasharray: 6 3 }
.lst { stroke: #0b2c52 } .deadline { stroke: #b03030; stroke-width: 1.5 }
.tick, .rule, .axis, .instant, .lst, .deadline { vector-effect: non-scaling-stroke }
";

/// Zooms the time axis only: texts keep their width, so the group is redrawn by a transformation of x.
const ZOOM: &str = "
(function () {
  var lines = document.getElementById('zoomed'), root = document.documentElement, scale = 1, shift = 0;
  var left = 210, width = 1180, from = null;
  function at(event) { var p = root.createSVGPoint(); p.x = event.clientX; p.y = event.clientY;
    return p.matrixTransform(root.getScreenCTM().inverse()).x; }
  function draw() {
    shift = Math.min(left * (1 - scale), Math.max(shift, (left + width) * (1 - scale)));
    if (scale === 1) { shift = 0; }
    lines.setAttribute('transform', 'matrix(' + scale + ' 0 0 1 ' + shift + ' 0)');
    Array.prototype.forEach.call(lines.querySelectorAll('text'), function (text) {
      var x = text.getAttribute('x');
      text.setAttribute('transform', 'translate(' + x + ' 0) scale(' + 1 / scale + ' 1) translate(' + -x + ' 0)'); });
  }
  root.addEventListener('wheel', function (event) {
    event.preventDefault();
    var x = at(event), factor = Math.pow(1.0015, -event.deltaY), next = Math.min(2000, Math.max(1, scale * factor));
    shift = x - (x - shift) * next / scale; scale = next; draw(); }, { passive: false });
  root.addEventListener('mousedown', function (event) { from = at(event); });
  root.addEventListener('mousemove', function (event) {
    if (from !== null) { var x = at(event); shift += x - from; from = x; draw(); } });
  root.addEventListener('mouseup', function () { from = null; });
  root.addEventListener('dblclick', function () { scale = 1; shift = 0; draw(); });
})();
";
