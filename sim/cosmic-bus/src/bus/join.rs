//! Two buses become one: a cable between two running segments is plugged in.

use super::Bus;
use crate::event::StationId;

impl Bus {
    /// Returns whether no frame is on the wire, nor about to start.
    pub const fn is_free(&self) -> bool {
        self.on_the_wire.is_none() && self.next_start.is_none()
    }

    /// Takes over all stations of a bus of the same bit rate that has come to the same instant, while both are
    /// [free](Self::is_free): each with its counters, filters and mailboxes. Nobody sees an error, as if the plug did not
    /// bounce. Returns what they are called from now on, in the order of their attachment.
    ///
    /// Faults, accounting and trace stay those of `self`; the other's end. What the other has not reported yet, this
    /// reports.
    ///
    /// # Errors
    /// The other bus, unchanged, if not both are free at one instant and equally fast.
    pub fn join(&mut self, other: Self) -> Result<Vec<StationId>, Box<Self>> {
        let fits = self.bit_rate == other.bit_rate && self.now == other.now;
        if !fits || !self.is_free() || !other.is_free() {
            return Err(Box::new(other));
        }
        let offset = self.stations.len() as u32;
        let moved = |station: StationId| StationId(station.0 + offset);
        let theirs = other.stations().map(moved).collect();
        self.names.extend(other.names);
        self.stations.extend(other.stations);
        self.contenders.extend(other.contenders);
        self.free_from = self.free_from.max(other.free_from);
        let recovering = other.recovering.into_iter();
        self.recovering.extend(recovering.map(|mut it| {
            it.station = moved(it.station);
            it
        }));
        self.outbox.extend(other.outbox.into_iter().map(|mut event| {
            event.station = moved(event.station);
            event
        }));
        self.outbox.sort_by_key(|event| event.at);
        Ok(theirs)
    }
}
