//! Names and their ids, which a broker hands out.
//!
//! What is kept of a name that nobody has told ends by itself: otherwise frames with every id in turn, from a
//! node that is broken or does not mean well, would leave none to hand out, for good. For the same reason a name that
//! was told goes, when nothing else is left and nobody was seen to use its id for a long time.

use crate::time::{Duration, Instant};

/// The entry contradicts what the table knows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Conflict<Name> {
    /// The id is outside the part of its range that this table covers.
    OutOfRange,
    /// The id belongs to this one.
    Taken(Name),
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Slot<Name> {
    Free,
    /// Somebody uses it; we do not know who. From then on it is handed out rather than a name be refused.
    Unknown {
        until: Instant,
    },
    /// Handed out, and not seen in use. The name may be one that does not exist, made of two searches for
    /// a UID that were mixed up; so this one is given away before any is refused.
    Promised(Name),
    Of(Name),
}

impl<Name: Copy + Eq> Slot<Name> {
    fn is_of(&self, name: Name) -> bool {
        matches!(self, Self::Promised(other) | Self::Of(other) if *other == name)
    }
}

/// Names by their index: room for `N`.
#[derive(Clone, Debug)]
pub(super) struct Table<Name, const N: usize> {
    slots: [Slot<Name>; N],
    /// Until when each was used, as far as is known; for those with a name.
    used_until: [Instant; N],
}

impl<Name: Copy + Eq, const N: usize> Table<Name, N> {
    pub(super) const fn new() -> Self {
        Self { slots: [Slot::Free; N], used_until: [Instant::EPOCH; N] }
    }

    pub(super) fn index_of(&self, name: Name) -> Option<usize> {
        self.slots.iter().position(|slot| slot.is_of(name))
    }

    /// The index that `name` has, or a free one that it gets now; at worst that of a name that was not used for `named`.
    pub(super) fn assign(&mut self, name: Name, now: Instant, named: Duration) -> Option<usize> {
        let at = (self.index_of(name))
            .or_else(|| self.first(|slot| *slot == Slot::Free))
            .or_else(|| self.longest_unused(now))
            .or_else(|| self.longest_unused_name(now, named))?;
        self.use_until(at, now);
        let slot = self.slots.get_mut(at)?;
        if !slot.is_of(name) {
            *slot = Slot::Of(name);
        }
        Some(at)
    }

    /// The index that `name` has, or one that it is promised now: the first that is free, or the last; at worst as
    /// [`assign`](Self::assign).
    pub(super) fn promise(&mut self, name: Name, now: Instant, named: Duration, last: bool) -> Option<usize> {
        let free = |slot: &Slot<Name>| *slot == Slot::Free;
        let at = (self.index_of(name))
            .or_else(|| if last { self.slots.iter().rposition(free) } else { self.first(free) })
            .or_else(|| self.first(|slot| matches!(slot, Slot::Promised(_))))
            .or_else(|| self.longest_unused(now))
            .or_else(|| self.longest_unused_name(now, named))?;
        self.use_until(at, now);
        if !self.slots.get(at)?.is_of(name) {
            self.promise_at(name, at);
        }
        Some(at)
    }

    /// The index is promised to `name`, whoever had it.
    pub(super) fn promise_at(&mut self, name: Name, at: usize) {
        if let Some(slot) = self.slots.get_mut(at) {
            *slot = Slot::Promised(name);
        }
    }

    fn first(&self, of: impl Fn(&Slot<Name>) -> bool) -> Option<usize> {
        self.slots.iter().position(of)
    }

    /// The one of those without a name that has not been used for the longest time, and for long enough.
    fn longest_unused(&self, now: Instant) -> Option<usize> {
        let ends = |slot: &Slot<Name>| match slot {
            Slot::Unknown { until } if *until <= now => Some(*until),
            _ => None,
        };
        let ended = self.slots.iter().enumerate().filter_map(|(at, slot)| Some((ends(slot)?, at)));
        ended.min().map(|(_, at)| at)
    }

    /// As [`longest_unused`](Self::longest_unused), of those with a name.
    fn longest_unused_name(&self, now: Instant, named: Duration) -> Option<usize> {
        let uses = self.slots.iter().zip(&self.used_until).enumerate();
        let ended = uses.filter_map(|(at, (slot, until))| match slot {
            Slot::Of(_) if *until + named <= now => Some((*until, at)),
            _ => None,
        });
        ended.min().map(|(_, at)| at)
    }

    fn use_until(&mut self, at: usize, until: Instant) {
        if let Some(known) = self.used_until.get_mut(at) {
            *known = until.max(*known);
        }
    }

    /// Somebody uses this index. Returns whether it was free.
    pub(super) fn occupy(&mut self, at: usize, until: Instant) -> bool {
        self.use_until(at, until);
        let Some(slot) = self.slots.get_mut(at) else {
            return false;
        };
        match *slot {
            Slot::Promised(name) => *slot = Slot::Of(name),
            Slot::Unknown { until: known } => *slot = Slot::Unknown { until: known.max(until) },
            Slot::Free => {
                *slot = Slot::Unknown { until };
                return true;
            }
            Slot::Of(_) => {}
        }
        false
    }

    /// Indices up to this one are in use by nodes that may never have been heard. Returns whether one of them
    /// was free.
    pub(super) fn occupy_up_to(&mut self, last: usize, until: Instant) -> bool {
        let mut any = false;
        for slot in self.slots.iter_mut().take(last.saturating_add(1)).filter(|slot| **slot == Slot::Free) {
            *slot = Slot::Unknown { until };
            any = true;
        }
        any
    }

    /// Enters `name` at `at` unless another one has that id. A former entry of `name` ends.
    pub(super) fn insert(&mut self, name: Name, at: usize) -> Result<(), Conflict<Name>> {
        match self.slots.get(at) {
            None => return Err(Conflict::OutOfRange),
            Some(Slot::Promised(other) | Slot::Of(other)) if *other != name => {
                return Err(Conflict::Taken(*other));
            }
            Some(_) => {}
        }
        self.overwrite(name, at);
        Ok(())
    }

    /// Enters `name` at `at`, whoever had that id. A former entry of `name` ends.
    pub(super) fn overwrite(&mut self, name: Name, at: usize) {
        self.release(name);
        if let Some(slot) = self.slots.get_mut(at) {
            *slot = Slot::Of(name);
        }
    }

    pub(super) fn release(&mut self, name: Name) -> bool {
        let slot = self.slots.iter_mut().find(|slot| slot.is_of(name));
        slot.map(|slot| *slot = Slot::Free).is_some()
    }

    pub(super) fn name(&self, at: usize) -> Option<Name> {
        match self.slots.get(at) {
            Some(Slot::Promised(name) | Slot::Of(name)) => Some(*name),
            Some(Slot::Free | Slot::Unknown { .. }) | None => None,
        }
    }

    pub(super) fn entries(&self) -> impl Iterator<Item = (Name, usize)> + '_ {
        (0..N).filter_map(|at| Some((self.name(at)?, at)))
    }

    pub(super) fn free(&self) -> usize {
        self.slots.iter().filter(|slot| **slot == Slot::Free).count()
    }

    pub(super) fn unnamed(&self) -> usize {
        self.slots.iter().filter(|slot| matches!(slot, Slot::Unknown { .. })).count()
    }
}
