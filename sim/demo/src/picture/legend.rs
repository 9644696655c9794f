//! What the colours mean.

use svg::node::element::Group;

use super::LEFT;
use super::canvas::{Area, Label, cross};
use super::frames::initials;
use super::palette::{ERROR, HATCH, Look, MARK, WINDOW};
use crate::cluster::Cluster;

/// The height of the legend.
pub(super) const HEIGHT: f64 = 84.0;

/// Draws it with its upper edge at `top`.
pub(super) fn draw(cluster: &Cluster, top: f64) -> Group {
    let mut group = Group::new();
    for (at, look) in Look::ALL.into_iter().enumerate() {
        group = group.add(entry(
            at,
            top,
            |area| Group::new().add(area.rectangle(look.paint().fill)),
            look.meaning(),
        ));
    }
    let second = top + 28.0;
    let destroyed = |area: &Area| Group::new().add(area.rectangle(HATCH)).add(cross(area));
    let error = |area: &Area| Group::new().add(area.rectangle(ERROR));
    let again = |area: &Area| {
        let fill = Look::Hard.paint().fill;
        Group::new().add(area.rectangle(fill).set("stroke", ERROR).set("stroke-width", 2))
    };
    let window =
        |area: &Area| Group::new().add(area.rectangle(WINDOW).set("stroke", MARK).set("stroke-width", 0.8));
    group
        .add(entry(0, second, destroyed, "destroyed on the wire"))
        .add(entry(1, second, error, "error frame"))
        .add(entry(2, second, again, "retransmission"))
        .add(entry(3, second, window, "HRT slot, ready to delivery"))
        .add(Label::new(&short_names(cluster), 12.0).at(LEFT, top + 68.5))
}

fn short_names(cluster: &Cluster) -> String {
    let names = cluster.channels.iter().map(|it| format!("{} {}", initials(it.name), it.name));
    let names: Vec<_> = names.collect();
    format!("Event channels: {}. In a browser, point at a frame for all about it.", names.join(", "))
}

fn entry(column: usize, y: f64, sample: impl Fn(&Area) -> Group, text: &str) -> Group {
    let x = LEFT + column as f64 * COLUMN;
    let area = Area { x, y, width: 26.0, height: 16.0 };
    sample(&area).add(Label::new(text, 12.0).at(x + 34.0, y + 12.5))
}

const COLUMN: f64 = 216.0;
