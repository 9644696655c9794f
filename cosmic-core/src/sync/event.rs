//! What the clock synchronisation tells its owner, and what it counts.

use crate::can::TxNode;

/// Something that the owner of a [`ClockSync`](super::ClockSync) should know.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ClockEvent {
    /// This node is master now.
    BecameMaster {
        /// It continues the time scale of its predecessor; else a new one begins.
        continued: bool,
    },
    /// No sync frame could be sent for three periods: nobody hears this node, and another one will take
    /// over. It listens again.
    Isolated,
    /// Another master comes first; this node follows it now.
    Yielded {
        /// The other one.
        to: TxNode,
    },
    /// The master has been silent for three periods.
    MasterLost {
        /// The silent one.
        master: TxNode,
    },
    /// This node follows another master than before, or its first one.
    MasterChanged {
        /// The new one.
        master: TxNode,
        /// It continues the time scale of the former one; else global time may have stepped, and is not
        /// to be relied on for some periods.
        continued: bool,
    },
    /// A synchronisation contradicted what is known of the master's clock, and was not used.
    Implausible {
        /// Its sender.
        master: TxNode,
    },
    /// The contradiction persisted: the master's clock was stepped. This node follows it anew.
    Restarted {
        /// The master.
        master: TxNode,
    },
    /// A master told an instant at or after [`FollowUp::END`](crate::protocol::FollowUp::END), which no time
    /// scale reaches. Nothing of it is used; told once for each such master in a row.
    OutOfRange {
        /// Its sender.
        master: TxNode,
    },
    /// The time scale had come to its end. This node, its master, starts a new one at the origin.
    Exhausted,
    /// The master has another calendar: this node must be silent in hard real-time slots.
    CalendarMismatch {
        /// The master.
        master: TxNode,
    },
    /// The master has this node's calendar, after it had another.
    CalendarMatch {
        /// The master.
        master: TxNode,
    },
}

/// What was sent, used, and dropped. Each stays at its largest value when it gets there.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SyncCounters {
    /// Sync frames whose transmission was confirmed.
    pub sent: u32,
    /// Sync frames given out whose transmission was not confirmed within two periods.
    pub unsent: u32,
    /// Pairs of sync and follow-up that went into the clock.
    pub used: u32,
    /// Syncs without follow-up.
    pub follow_ups_missed: u32,
    /// Follow-ups without the sync to them.
    pub syncs_missed: u32,
    /// Sync frames that came twice.
    pub duplicates: u32,
    /// Pairs that contradicted what is known.
    pub implausible: u32,
    /// Frames and pairs of a master that comes after the one that is in office.
    pub foreign: u32,
    /// Pairs with an instant that no time scale reaches.
    pub out_of_range: u32,
    /// Frames with the etag of a sync or follow-up that are none.
    pub malformed: u32,
    /// Events that the owner did not fetch in time.
    pub events_lost: u32,
}

/// Adds one, up to the largest value.
pub(super) fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

/// A few events, first in first out.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Events([Option<ClockEvent>; 6]);

impl Events {
    pub(super) const EMPTY: Self = Self([None; 6]);

    /// `false` if there is no room.
    #[must_use]
    pub(super) fn push(&mut self, event: ClockEvent) -> bool {
        match self.0.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some(event);
                true
            }
            None => false,
        }
    }

    pub(super) fn pop(&mut self) -> Option<ClockEvent> {
        let first = self.0[0].take();
        self.0.rotate_left(1);
        first
    }
}
