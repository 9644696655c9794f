//! Bounds of what is sent by events, against their deadlines, as bars.

use super::{LEFT, WIDTH, rectangle, text};
use crate::analysis::proof::Proof;
use crate::analysis::segment::Assessment;
use crate::cluster::{Cluster, PlannedClass};
use crate::units::show;
use svg::node::element::{Group, Line};

/// The group and its height.
pub(super) fn draw(cluster: &Cluster, assessment: &Assessment, top: f64) -> (Group, f64) {
    let mut rows = rows(cluster, assessment);
    if rows.is_empty() {
        return (Group::new(), 0.0);
    }
    // What is nearest to its deadline comes first, what has none last.
    rows.sort_by(|a, b| b.2.total_cmp(&a.2));
    let heading = "Bounds of soft and non real-time events, as shares of their deadlines";
    let mut group = Group::new().add(text(20.0, top, heading).set("class", "subtitle"));
    let hidden = rows.len().saturating_sub(MOST);
    rows.truncate(MOST);
    let bottom = top + 18.0 + ROW * rows.len() as f64;
    for (at, (label, proof, share)) in rows.iter().enumerate() {
        let y = top + 18.0 + ROW * at as f64;
        group = group.add(text(20.0, y + 13.0, super::shortened(label)).set("class", "label"));
        let (class, share) = match proof.deadline {
            None => ("provision", 0.0),
            Some(_) if proof.verdict.holds() => ("bound", *share),
            Some(_) => ("late", *share),
        };
        let width = share.min(LONGEST) * FULL;
        group = group.add(rectangle(LEFT, y + 2.0, width, ROW - 6.0, class));
        let words = match (proof.bound, proof.deadline) {
            (Some(bound), Some(deadline)) => format!("{} of {}", show(bound), show(deadline)),
            (None, Some(deadline)) => format!("no bound, deadline {}", show(deadline)),
            (Some(bound), None) => format!("{}, no deadline", show(bound)),
            (None, None) => "no bound, no deadline".to_owned(),
        };
        group = group.add(text(LEFT + width + 8.0, y + 13.0, words).set("class", "small"));
    }
    let deadline = Line::new().set("x1", LEFT + FULL).set("x2", LEFT + FULL);
    group = group.add(deadline.set("y1", top + 14.0).set("y2", bottom).set("class", "deadline"));
    let name = text(LEFT + FULL, top + 10.0, "deadline").set("class", "small").set("text-anchor", "middle");
    group = group.add(name);
    let mut height = bottom - top + 30.0;
    if hidden > 0 {
        let words = format!("and {hidden} more, each farther from its deadline");
        group = group.add(text(LEFT, bottom + 14.0, words).set("class", "small"));
        height += 16.0;
    }
    (group, height)
}

/// Name, proof, and the share of the deadline; without a bound more than any, without a deadline less.
fn rows<'a>(cluster: &Cluster, assessment: &'a Assessment) -> Vec<(String, &'a Proof, f64)> {
    let share = |proof: &Proof| match (proof.bound, proof.deadline) {
        (Some(bound), Some(deadline)) => bound.as_ticks() as f64 / deadline.as_ticks().max(1) as f64,
        (None, Some(_)) => f64::MAX,
        (_, None) => -1.0,
    };
    let channels = assessment.channels.iter().filter_map(|proven| {
        let channel = &cluster.channels[proven.channel];
        let by_events = !matches!(channel.class, PlannedClass::Hard { .. });
        by_events.then(|| (format!("{} ({})", channel.name, cluster.nodes[proven.node].name), &proven.proof))
    });
    let foreign =
        cluster.foreign.iter().zip(&assessment.foreign).map(|(frame, proof)| (frame.name.clone(), proof));
    channels.chain(foreign).map(|(name, proof)| (name, proof, share(proof))).collect()
}

const ROW: f64 = 20.0;
const MOST: usize = 40;
/// How long a bar is that reaches its deadline.
const FULL: f64 = WIDTH * 0.6;
/// Bars beyond so many deadlines end here.
const LONGEST: f64 = 1.3;
