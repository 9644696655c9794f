//! How the events of a channel follow each other.

use super::{Checker, UNKNOWN_PERIOD, start_of};
use crate::cluster::Recurrence;
use crate::cluster::format::ChannelTable;
use crate::cluster::values::ClassName;
use cosmic_core::time::Duration;

impl Checker<'_> {
    pub(super) fn recurrence(&self, table: &ChannelTable, field: &dyn Fn(&str) -> String) -> Recurrence {
        match (&table.period, &table.min_interarrival) {
            (Some(period), None) => Recurrence::Periodic(period.value.0),
            (None, Some(distance)) => Recurrence::Sporadic(distance.value.0),
            (None, None) if self.is_malformed(table, &["period", "min_interarrival"]) => {
                Recurrence::Periodic(UNKNOWN_PERIOD)
            }
            (None, None) => {
                let help = "write period = \"10 ms\", or min_interarrival = \"10 ms\" for sporadic events";
                self.problem(&start_of(&table.place), field("period"), "is missing", help);
                Recurrence::Periodic(UNKNOWN_PERIOD)
            }
            (Some(period), Some(distance)) => {
                let what = "stands beside period";
                let help = "keep one: period for periodic events, min_interarrival for sporadic ones";
                self.problem(&distance.place, field("min_interarrival"), what, help);
                Recurrence::Periodic(period.value.0)
            }
        }
    }

    /// How many events may come at once.
    pub(super) fn burst(&self, table: &ChannelTable, field: &dyn Fn(&str) -> String) -> u8 {
        let Some(at) = &table.burst else { return 1 };
        let is_hard = table.class.as_ref().is_some_and(|class| class.value == ClassName::Hard);
        let wrong = if is_hard {
            Some(("means nothing for HRT channels: a slot has one event", "leave it out"))
        } else if table.period.is_some() {
            let help = "leave it out, or write min_interarrival instead of period";
            Some(("a periodic channel has one event in every period", help))
        } else if at.value == 0 {
            Some(("no event at all", "write 1 or more, or leave it out"))
        } else {
            None
        };
        if let Some((what, help)) = wrong {
            self.problem(&at.place, field("burst"), what, help);
        }
        at.value.max(1)
    }
}

/// The jitter that the publisher's node allows.
pub(super) fn allowed_jitter(table: &ChannelTable, recurrence: Recurrence) -> Duration {
    let usual = || (recurrence.span() / SHARE_OF_JITTER).min(MOST_UNSTATED_JITTER);
    table.jitter.as_ref().map_or_else(usual, |at| at.value.0)
}

const SHARE_OF_JITTER: u32 = 10;
const MOST_UNSTATED_JITTER: Duration = Duration::from_millis(1);
