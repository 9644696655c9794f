//! How a node begins and ends to take part in slots.
//!
//! The event layer does that at any time, and shares the buffers with the calendar task. To look through all slots
//! while it holds them would delay that task, so both go in steps: one place at a time.

use super::buffers::{Buffer, BufferId, HardMailbox, HrtBuffers, LocalSlot, Role};
use crate::calendar::{Calendar, Slot, SlotTimes};
use crate::can::{Id, Priority};
use crate::time::Duration;

/// A request to take part in a slot of the calendar; see [`HrtBuffers::attach`].
#[derive(Clone, Copy, Debug)]
pub struct Attach<'c> {
    /// The calendar of the segment.
    pub calendar: &'c Calendar,
    /// One of its slots.
    pub slot: &'c Slot,
    /// What this node does in it.
    pub role: Role,
}

/// Why a node cannot take part in a slot.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum AttachError {
    /// All buffers, or all places for slots, are in use: make `N` larger.
    Full,
}

impl<const N: usize> HrtBuffers<N> {
    /// Takes part in a slot. Roles add up when the same channel and publisher are attached again. The
    /// dispatcher acts on it from its next wake-up on.
    ///
    /// # Errors
    /// [`AttachError::Full`]; nothing has changed then.
    pub fn attach(&mut self, request: &Attach<'_>) -> Result<BufferId, AttachError> {
        let mut attaching = Attaching::new(request);
        loop {
            if let Some(attached) = self.attach_step(&mut attaching) {
                return attached;
            }
        }
    }

    /// One step of [`attach`](Self::attach), for an owner who shares the buffers and must not hold them for long;
    /// `None`: call it again. In between nobody else attaches or detaches. O(1), but for the one that may have to move
    /// other keys of the map ([`IdMap::insert`](crate::network::id_map::IdMap::insert)).
    pub(crate) fn attach_step(&mut self, attaching: &mut Attaching) -> Option<Result<BufferId, AttachError>> {
        match attaching.next {
            Step::Look(at) => {
                match (self.buffers.get(usize::from(at)), self.slots.get(usize::from(at))) {
                    (Some(buffer), Some(slot)) => {
                        let owner = slot.and_then(|slot| self.buffer(slot.buffer)).map(|buffer| buffer.id);
                        attaching.look_at(at, buffer.as_ref(), slot.as_ref(), owner);
                        attaching.next = Step::Look(at.saturating_add(1));
                    }
                    _ => attaching.next = if attaching.known.is_some() { Step::Join } else { Step::Make },
                }
                None
            }
            Step::Make => {
                attaching.next = Step::Enter;
                self.make_buffer(attaching).err().map(Err)
            }
            Step::Enter => {
                attaching.next = Step::Join;
                self.enter_buffer(attaching).err().map(Err)
            }
            Step::Join => Some(self.join_slot(attaching)),
        }
    }

    /// A buffer for the channel and publisher, if there will be a place for the slot, too.
    fn make_buffer(&mut self, attaching: &Attaching) -> Result<(), AttachError> {
        let at = attaching.free_buffer.filter(|_| attaching.free_slot.is_some()).ok_or(AttachError::Full)?;
        let place = self.buffers.get_mut(usize::from(at)).ok_or(AttachError::Full)?;
        *place = Some(Buffer::new(attaching.id));
        Ok(())
    }

    /// From now on its frames are found.
    fn enter_buffer(&mut self, attaching: &mut Attaching) -> Result<(), AttachError> {
        let at = attaching.free_buffer.ok_or(AttachError::Full)?;
        if self.by_id.insert(attaching.id.raw(), at.into()).is_err() {
            if let Some(place) = self.buffers.get_mut(usize::from(at)) {
                *place = None;
            }
            return Err(AttachError::Full);
        }
        attaching.known = Some(at);
        Ok(())
    }

    fn join_slot(&mut self, attaching: &Attaching) -> Result<BufferId, AttachError> {
        let at = attaching.known.ok_or(AttachError::Full)?;
        let place = attaching.same.or(attaching.free_slot).ok_or(AttachError::Full)?;
        let revision = self.revision.wrapping_add(1);
        let buffer = self.buffer_mut(at).ok_or(AttachError::Full)?;
        buffer.role.publishes |= attaching.role.publishes;
        buffer.role.subscribes |= attaching.role.subscribes;
        buffer.window = buffer.window.max(attaching.slot.delivery);
        let place = self.slots.get_mut(usize::from(place)).ok_or(AttachError::Full)?;
        *place = Some(LocalSlot { buffer: at, attached: revision, ..attaching.slot });
        self.revision = revision;
        Ok(BufferId(at))
    }

    /// Gives up a role in all slots of the buffer; without any role left the buffer becomes free.
    pub fn detach(&mut self, id: BufferId, role: Role) {
        let mut detaching = Detaching::new(id, role);
        while !self.detach_step(&mut detaching) {}
    }

    /// One step of [`detach`](Self::detach), as [`attach_step`](Self::attach_step) is one of `attach`. Returns whether
    /// it was the last one. O(1).
    pub(crate) fn detach_step(&mut self, detaching: &mut Detaching) -> bool {
        let Detaching { id, role, next } = *detaching;
        let Some(place) = self.buffers.get_mut(usize::from(id.0)) else { return true };
        let Some(buffer) = place else { return true };
        let Some(at) = next else {
            detaching.next = Some(0);
            return self.give_up(id, role);
        };
        detaching.next = Some(at.saturating_add(1));
        if let Some(slot) = self.slots.get_mut(usize::from(at)) {
            slot.take_if(|slot| slot.buffer == id.0);
            return false;
        }
        self.by_id.remove(buffer.id.raw());
        *place = None;
        self.revision = self.revision.wrapping_add(1);
        true
    }

    /// Returns whether there is a role left.
    fn give_up(&mut self, id: BufferId, role: Role) -> bool {
        let Some(buffer) = self.buffers.get_mut(usize::from(id.0)).and_then(Option::as_mut) else {
            return true;
        };
        if role.publishes && buffer.role.publishes {
            match self.mailbox {
                HardMailbox::Loaded(loaded) if loaded == id.0 => self.mailbox = HardMailbox::Orphaned,
                HardMailbox::Withdrawing(loaded) if loaded == id.0 => self.mailbox = HardMailbox::Abandoned,
                _ => {}
            }
            self.revision = self.revision.wrapping_add(1);
        }
        if role.publishes {
            buffer.role.publishes = false;
            buffer.fresh = false;
        }
        if role.subscribes {
            buffer.role.subscribes = false;
            buffer.arriving = None;
            buffer.visible = None;
        }
        buffer.role != Role::default()
    }
}

/// What is to be done next.
#[derive(Clone, Copy, Debug)]
enum Step {
    /// Look at the buffer and the slot of this number.
    Look(u8),
    /// Make a buffer.
    Make,
    /// Let it be found.
    Enter,
    /// Take part in the slot.
    Join,
}

/// A request to take part in a slot, on its way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Attaching {
    id: Id,
    role: Role,
    /// Its buffer and revision are not known before the end.
    slot: LocalSlot,
    next: Step,
    /// The buffer that the channel and publisher have.
    known: Option<u8>,
    free_buffer: Option<u8>,
    /// Where the slot stands already.
    same: Option<u8>,
    free_slot: Option<u8>,
}

impl Attaching {
    pub(crate) fn new(request: &Attach<'_>) -> Self {
        let Slot { etag, publisher, period, phase, periodic, .. } = *request.slot;
        let SlotTimes { deadline, delivery, .. } = request.calendar.slot_times(request.slot);
        // The frame may be loaded late by the release jitter; it has its full time all the same.
        let jitter = request.calendar.segment().release_jitter.as_ticks();
        let deadline = Duration::from_ticks(deadline.as_ticks().saturating_add(jitter));
        Self {
            id: Id::new(Priority::HARD, publisher, etag),
            role: request.role,
            slot: LocalSlot { buffer: 0, periodic, period, phase, deadline, delivery, attached: 0 },
            next: Step::Look(0),
            known: None,
            free_buffer: None,
            same: None,
            free_slot: None,
        }
    }

    fn look_at(&mut self, at: u8, buffer: Option<&Buffer>, slot: Option<&LocalSlot>, owner: Option<Id>) {
        match buffer {
            None => self.free_buffer = self.free_buffer.or(Some(at)),
            Some(buffer) if buffer.id == self.id => self.known = Some(at),
            Some(_) => {}
        }
        match slot {
            None => self.free_slot = self.free_slot.or(Some(at)),
            Some(there) if there.phase == self.slot.phase && owner == Some(self.id) => self.same = Some(at),
            Some(_) => {}
        }
    }
}

/// A role that is given up, on its way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Detaching {
    id: BufferId,
    role: Role,
    /// The next slot to look at; `None` at the beginning.
    next: Option<u8>,
}

impl Detaching {
    pub(crate) const fn new(id: BufferId, role: Role) -> Self {
        Self { id, role, next: None }
    }
}
