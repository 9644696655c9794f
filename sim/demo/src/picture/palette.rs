//! What things look like, in one place, so that the legend cannot lie.
//!
//! The colours are those of Okabe and Ito, or near them, so that people who do not see red or green tell them apart.

use cosmic_bus::TrafficClass;
use cosmic_core::can::Etag;

use crate::bus_log::Attempt;
use crate::cluster::Cluster;

/// A fill and the colour of the text on it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Paint {
    pub(super) fill: &'static str,
    pub(super) ink: &'static str,
}

/// What a frame is to the eye.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Look {
    Hard,
    Soft,
    NonRealTime,
    /// Clock synchronisation and other control messages.
    Control,
    SoftLoad,
    NonRealTimeLoad,
}

impl Look {
    pub(super) const ALL: [Self; 6] =
        [Self::Hard, Self::Soft, Self::NonRealTime, Self::Control, Self::SoftLoad, Self::NonRealTimeLoad];

    /// The look of a frame of this cluster; of frames that are not of its channels, background load.
    pub(super) fn of(cluster: &Cluster, attempt: &Attempt) -> Self {
        let etag = attempt.frame().map(|frame| frame.id.etag());
        let known = etag.is_some_and(|etag| cluster.channel(etag).is_some());
        match TrafficClass::of(&attempt.wire_frame) {
            TrafficClass::Hard => Self::Hard,
            _ if etag.is_some_and(Etag::is_reserved) => Self::Control,
            TrafficClass::Soft if known => Self::Soft,
            TrafficClass::Soft => Self::SoftLoad,
            TrafficClass::NonRealTime if known => Self::NonRealTime,
            TrafficClass::NonRealTime | TrafficClass::Foreign => Self::NonRealTimeLoad,
        }
    }

    pub(super) const fn paint(self) -> Paint {
        match self {
            Self::Hard => Paint { fill: "#0072b2", ink: "#ffffff" },
            Self::Soft => Paint { fill: "#009e73", ink: "#ffffff" },
            Self::NonRealTime => Paint { fill: "#e69f00", ink: "#111827" },
            Self::Control => Paint { fill: "#4b2e63", ink: "#ffffff" },
            Self::SoftLoad => Paint { fill: "#bfe6f2", ink: "#14532d" },
            Self::NonRealTimeLoad => Paint { fill: "#f7ecc4", ink: "#78350f" },
        }
    }

    pub(super) const fn meaning(self) -> &'static str {
        match self {
            Self::Hard => "hard real-time (HRT)",
            Self::Soft => "soft real-time (SRT)",
            Self::NonRealTime => "non real-time (NRT)",
            Self::Control => "clock synchronisation",
            Self::SoftLoad => "background load, SRT",
            Self::NonRealTimeLoad => "background load, NRT",
        }
    }
}

pub(super) const INK: &str = "#111827";
pub(super) const FAINT_INK: &str = "#6b7280";
pub(super) const PAPER: &str = "#ffffff";
pub(super) const LANE: &str = "#f3f4f6";
pub(super) const GRID: &str = "#d1d5db";
pub(super) const ERROR: &str = "#c2410c";
/// The fill of destroyed attempts: a pattern that [`super::canvas`] defines.
pub(super) const HATCH: &str = "url(#destroyed)";
pub(super) const WINDOW: &str = "#dbeafe";
pub(super) const MARK: &str = "#1e3a8a";
/// The parts of a window: waiting, first transmission, retransmissions, gap.
pub(super) const PARTS: [&str; 4] = ["#e0e7ff", "#a5b4fc", "#c7d2fe", "#eef2ff"];

#[cfg(test)]
mod tests {
    use super::*;

    /// Linear light of a colour such as `#0072b2`.
    fn light(colour: &str) -> [f64; 3] {
        let part = |at: usize| f64::from(u8::from_str_radix(&colour[at..at + 2], 16).unwrap()) / 255.0;
        [1, 3, 5]
            .map(part)
            .map(|value| if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) })
    }

    fn product(matrix: [[f64; 3]; 3], of: [f64; 3]) -> [f64; 3] {
        matrix.map(|row| row.iter().zip(of).map(|(factor, value)| factor * value).sum())
    }

    /// The distance of two colours as CIE 1976 has it; 2 is just seen.
    fn distance(one: [f64; 3], other: [f64; 3]) -> f64 {
        let lab = |light: [f64; 3]| {
            let xyz = product(
                [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]],
                light,
            );
            let root =
                |value: f64| if value > 0.008856 { value.cbrt() } else { 7.787 * value + 16.0 / 116.0 };
            let [x, y, z] = [xyz[0] / 0.9505, xyz[1], xyz[2] / 1.089].map(|value| root(value.max(0.0)));
            [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
        };
        lab(one).iter().zip(lab(other)).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
    }

    /// Machado, Oliveira, Fernandes 2009, complete: nobody sees red, nobody sees green.
    const BLIND: [[[f64; 3]; 3]; 2] = [
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    ];

    #[test]
    fn who_does_not_see_red_or_green_tells_all_looks_apart() {
        let fills: Vec<_> = Look::ALL.iter().map(|look| look.paint().fill).chain([ERROR]).collect();
        for (at, one) in fills.iter().enumerate() {
            for other in &fills[at + 1..] {
                for blind in BLIND {
                    let distance = distance(product(blind, light(one)), product(blind, light(other)));
                    assert!(distance > 20.0, "{one} and {other}: {distance:.1}");
                }
            }
        }
    }
}
