//! What holds for the whole segment: bus, clocks, faults.

use super::{Checker, ZERO};
use crate::analysis::errors::ErrorModel;
use crate::cluster::Cluster;
use crate::cluster::format::{ErrorsTable, SegmentTable};
use crate::units::show;
use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, LONGEST_FRAME_BITS};
use cosmic_core::sync::{SyncConfig, SyncConfigError};
use cosmic_core::time::Duration;

impl Checker<'_> {
    pub(super) fn segment(&self, table: &SegmentTable) -> (Segment, Duration) {
        let bit_rate = table.bit_rate.as_ref().map_or(BitRate::MAX, |at| at.value.0);
        let segment = Segment {
            bit_rate,
            accuracy: table.clock_accuracy.as_ref().map_or(ZERO, |at| at.value.0),
            release_jitter: table.release_jitter.as_ref().map_or(ZERO, |at| at.value.0),
        };
        let longest = Calendar::LONGEST_PRIORITY_STEP;
        if let Some(at) = table.priority_step.as_ref().filter(|at| at.value.0 > longest) {
            let what = format!("{} is too long", show(at.value.0));
            let help = format!("write at most {}", show(longest));
            self.problem(&at.place, "segment.priority_step".to_owned(), what, help);
        }
        let step = table.priority_step.as_ref().map_or(bit_rate.bits(LONGEST_FRAME_BITS), |at| at.value.0);
        (segment, step)
    }

    /// The clock synchronisation of the nodes refuses the same settings; here they have a place.
    pub(super) fn clock(&self, table: &SegmentTable, cluster: &Cluster) {
        let Some(config) = cluster.sync() else { return };
        let Err(error) = config.check() else { return self.accuracy(table, cluster, &config) };
        let (field, at) = match (error, &table.sync_period) {
            (SyncConfigError::Period, at) | (_, at @ Some(_)) => ("sync_period", at),
            _ => ("stamp_latency", &table.stamp_latency),
        };
        let (what, help) = match error {
            SyncConfigError::Period => (
                "is out of range".to_owned(),
                format!(
                    "write {} to {}, or \"0 s\" for a cluster without clock synchronisation",
                    show(SyncConfig::SHORTEST_PERIOD),
                    show(SyncConfig::LONGEST_PERIOD)
                ),
            ),
            _ => (
                format!("is too short for time-stamps that are {} late", show(cluster.stamp_latency)),
                "make sync_period at least a hundred times stamp_latency".to_owned(),
            ),
        };
        let place = at.as_ref().map_or(0..0, |at| at.place.clone());
        self.problem(&place, format!("segment.{field}"), what, help);
    }

    /// No clock is better than the stamps that set it.
    fn accuracy(&self, table: &SegmentTable, cluster: &Cluster, config: &SyncConfig) {
        let accuracy = cluster.segment.accuracy;
        let Some(at) = table.clock_accuracy.as_ref().filter(|_| accuracy <= config.stamp_error) else {
            return;
        };
        let error = show(config.stamp_error);
        let what = format!("{} cannot be held: time-stamps may be wrong by {error}", show(accuracy));
        let latency = show(cluster.stamp_latency);
        let help = format!("write more than {error}, or a smaller stamp_latency (it is {latency})");
        self.problem(&at.place, "segment.clock_accuracy".to_owned(), what, help);
    }

    pub(super) fn errors(&self, table: &ErrorsTable) -> ErrorModel {
        match (&table.burst, &table.interval, &table.count, &table.window) {
            (Some(burst), Some(interval), None, None) => {
                ErrorModel::Burst { burst: burst.value, interval: interval.value.0 }
            }
            (None, None, Some(count), Some(window)) => {
                ErrorModel::Window { count: count.value, window: window.value.0 }
            }
            _ if !table.malformed.is_empty() => ErrorModel::None,
            _ => {
                let what = "is neither of the two models";
                let help = "write burst and interval, or count and window";
                self.problem(&table.place, "errors".to_owned(), what, help);
                ErrorModel::None
            }
        }
    }
}

/// Interrupt latency and resolution of the timer, if the file does not say.
pub(super) const USUAL_STAMP_LATENCY: Duration = Duration::from_micros(10);
