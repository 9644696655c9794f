//! What things look like, in one place, so that the legend cannot lie.

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
            Self::Hard => Paint { fill: "#1d4ed8", ink: "#ffffff" },
            Self::Soft => Paint { fill: "#15803d", ink: "#ffffff" },
            Self::NonRealTime => Paint { fill: "#d97706", ink: "#ffffff" },
            Self::Control => Paint { fill: "#7e22ce", ink: "#ffffff" },
            Self::SoftLoad => Paint { fill: "#bbe3c8", ink: "#14532d" },
            Self::NonRealTimeLoad => Paint { fill: "#f6dfb5", ink: "#78350f" },
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
pub(super) const ERROR: &str = "#dc2626";
/// The fill of destroyed attempts: a pattern that [`super::canvas`] defines.
pub(super) const HATCH: &str = "url(#destroyed)";
pub(super) const WINDOW: &str = "#dbeafe";
pub(super) const MARK: &str = "#1e3a8a";
/// The parts of a window: waiting, first transmission, retransmissions, gap.
pub(super) const PARTS: [&str; 4] = ["#e0e7ff", "#a5b4fc", "#c7d2fe", "#eef2ff"];
