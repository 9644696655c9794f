//! How the load of the bus goes through the cycle: what windows reserve, what hard real-time frames take of it, and
//! what all others take on average.

use super::{LEFT, WIDTH, rectangle, round, text};
use crate::analysis::segment::Assessment;
use crate::plan::Plan;
use svg::node::element::{Group, Line};

/// The group and its height.
pub(super) fn draw(plan: &Plan, assessment: &Assessment, top: f64) -> (Group, f64) {
    let shares = &assessment.utilisation;
    let others = shares.total() - shares.hard;
    let heading = format!(
        "Load over the cycle: hard real-time frames {:.1} %, reserved {:.1} %, all others {:.1} % on average (dashed)",
        shares.hard * 100.0,
        shares.reserved * 100.0,
        others * 100.0
    );
    let mut group = Group::new().add(text(20.0, top, heading).set("class", "subtitle"));
    let (base, width) = (top + 16.0 + HEIGHT, WIDTH / COLUMNS as f64);
    group = group.add(rectangle(LEFT, base - HEIGHT, WIDTH, HEIGHT, "free"));
    for (at, (reserved, frames)) in columns(plan).into_iter().enumerate() {
        let x = LEFT + width * at as f64;
        for (share, class) in [(reserved, "provision"), (frames, "frame")] {
            if share > 0.0 {
                group = group.add(rectangle(x, base - HEIGHT * share, width, HEIGHT * share, class));
            }
        }
    }
    // What has no instant of its own.
    let y = round(base - HEIGHT * others.clamp(0.0, 1.0));
    let line = Line::new().set("x1", LEFT).set("x2", LEFT + WIDTH).set("y1", y).set("y2", y);
    group = group.add(line.set("class", "others"));
    for (share, words) in [(0.0, "0 %"), (0.5, "50 %"), (1.0, "100 %")] {
        let label = text(LEFT - 8.0, base - HEIGHT * share + 4.0, words);
        group = group.add(label.set("class", "small").set("text-anchor", "end"));
    }
    (group, HEIGHT + 50.0)
}

/// For each part of the cycle which share of it is reserved, and which share hard real-time frames take.
fn columns(plan: &Plan) -> Vec<(f64, f64)> {
    let cycle = plan.cycle().as_ticks().max(1);
    let mut columns = vec![(0.0, 0.0); COLUMNS];
    let mut add = |from: u64, to: u64, is_frame: bool| {
        let scale = COLUMNS as f64 / cycle as f64;
        let (from, to) = (from as f64 * scale, to as f64 * scale);
        let mut at = from;
        while at < to {
            let end = (at.floor() + 1.0).min(to);
            if let Some(column) = columns.get_mut(at as usize % COLUMNS) {
                let share = end - at;
                if is_frame { column.1 += share } else { column.0 += share }
            }
            at = end;
        }
    };
    for (ready, planned) in plan.occurrences() {
        let ready = ready.as_ticks();
        add(ready, ready + planned.times.delivery.as_ticks(), false);
        let start = ready + planned.times.latest_start.as_ticks();
        let frame = plan.segment().bit_rate.longest_frame(usize::from(planned.slot.len)).as_ticks();
        add(start, start + frame, true);
    }
    columns
}

const COLUMNS: usize = 236;
const HEIGHT: f64 = 70.0;
