//! What happened in the slots of a calendar, counted.

/// What happened in the slots of one buffer since it was attached. All counts wrap.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Published events that were sent within their window.
    pub sent: u32,
    /// Published events that were not sent, or not sent within their window: the faults on the bus exceeded
    /// the omission degree.
    pub omitted: u32,
    /// Slots of a periodic channel for which nothing fresh had been published.
    pub unused: u32,
    /// Published events replaced by a newer one before their slot came.
    pub replaced: u32,
    /// Slots in which nothing was sent, because the dispatcher came too late or the mailbox was not free; and
    /// those in which nothing was delivered, because the clock was set while they were open.
    pub skipped: u32,
    /// Slots passed over in silence, because the clock was out of bound or the calendar another one.
    pub inhibited: u32,
    /// Events delivered at their instant.
    pub delivered: u32,
    /// Slots of a periodic channel in which nothing was received.
    pub missed: u32,
    /// Further copies of an event, suppressed.
    pub duplicates: u32,
    /// Further frames in a window whose content is not that of the first, suppressed: no retransmission, but
    /// another node that sends in this slot.
    pub contradictory: u32,
    /// Frames that arrived outside their window, dropped.
    pub untimely: u32,
    /// Delivered events that the event layer did not fetch before the next one.
    pub overrun: u32,
}

impl Counters {
    /// Nothing has happened yet.
    pub const NONE: Self = Self {
        sent: 0,
        omitted: 0,
        unused: 0,
        replaced: 0,
        skipped: 0,
        inhibited: 0,
        delivered: 0,
        missed: 0,
        duplicates: 0,
        contradictory: 0,
        untimely: 0,
        overrun: 0,
    };

    /// Those that the application hears of as exceptions: omitted, unused, skipped, missed, overrun,
    /// contradictory, inhibited.
    pub(crate) const fn exceptional(&self) -> Exceptional {
        [
            self.omitted,
            self.unused,
            self.skipped,
            self.missed,
            self.overrun,
            self.contradictory,
            self.inhibited,
        ]
    }
}

/// Counts of what the application hears of, in the order of [`Counters::exceptional`].
pub(crate) type Exceptional = [u32; 7];
