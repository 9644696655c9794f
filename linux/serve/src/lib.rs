//! An emulated cluster as a segment that is served in real time: flashed images on one side, programs on Linux on the
//! other, on one bit-accurate bus. The program `serve-emulated` serves one.
//!
//! Time passes as the wall clock does, as long as this machine can follow. If it cannot, the segment's time stands still
//! meanwhile, which the nodes on it do not notice; [`Pace`] tells for how long it did.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use cosmic_bus::{EventKind, MAILBOXES, StationId, VirtualInstant, WireFrame};
use cosmic_core::can::BitRate;
use cosmic_core::time::Duration;
use cosmic_emu::{Cluster, Port, Station};
use cosmic_linux::link::segment::{Member, MemberEvent, Segment};

/// How well a segment keeps pace with the wall clock.
#[derive(Clone, Debug, Default)]
pub struct Pace {
    stood: Arc<AtomicU64>,
}

impl Pace {
    /// For how long its time stood still so far.
    pub fn stood(&self) -> std::time::Duration {
        std::time::Duration::from_nanos(self.stood.load(Ordering::Relaxed))
    }
}

/// An emulated cluster as a segment.
pub struct EmulatedSegment {
    cluster: Cluster,
    members: Vec<Place>,
    pace: Pace,
    /// How far the segment's time is behind that of the server.
    behind: Duration,
}

struct Place {
    station: StationId,
    room: Rc<RefCell<Mailroom>>,
    used: bool,
}

/// What goes between a connection and its station.
#[derive(Default)]
struct Mailroom {
    wishes: VecDeque<Wish>,
    /// Not before this; `None` before the first wish.
    at: Option<VirtualInstant>,
    occupied: [bool; MAILBOXES],
    events: Vec<(VirtualInstant, EventKind)>,
}

enum Wish {
    Load(usize, WireFrame),
    Withdraw(usize),
}

/// The station of a connection.
struct Outside(Rc<RefCell<Mailroom>>);

impl Station for Outside {
    fn acts_at(&self) -> Option<VirtualInstant> {
        let room = self.0.borrow();
        room.at.filter(|_| !room.wishes.is_empty())
    }

    fn act(&mut self, port: &mut Port<'_>) {
        let wishes = std::mem::take(&mut self.0.borrow_mut().wishes);
        for wish in wishes {
            match wish {
                Wish::Load(mailbox, frame) => {
                    if !port.load(mailbox, frame) {
                        self.0.borrow_mut().events.push((port.now(), EventKind::Withdrawn { mailbox }));
                    }
                }
                Wish::Withdraw(mailbox) => port.withdraw(mailbox),
            }
        }
    }

    fn on_event(&mut self, event: &EventKind, port: &mut Port<'_>) {
        let mut room = self.0.borrow_mut();
        if let EventKind::Sent { mailbox } | EventKind::Withdrawn { mailbox } = event
            && let Some(occupied) = room.occupied.get_mut(*mailbox)
        {
            *occupied = false;
        }
        room.events.push((port.now(), *event));
    }
}

impl EmulatedSegment {
    /// This cluster, from its present instant on, which is the beginning.
    pub fn new(cluster: Cluster) -> (Self, Pace) {
        let pace = Pace::default();
        let segment =
            Self { cluster, members: Vec::new(), pace: pace.clone(), behind: Duration::from_ticks(0) };
        (segment, pace)
    }

    /// The segment's time, when it is that of the server.
    fn time(&self, at: VirtualInstant) -> VirtualInstant {
        let at = at.as_ticks().saturating_sub(self.behind.as_ticks());
        VirtualInstant::from_ticks(at).max(self.cluster.bus().now())
    }

    fn wish(&mut self, now: VirtualInstant, member: Member, wish: Wish) {
        let at = self.time(now);
        if let Some(place) = self.members.get(member.0 as usize) {
            let mut room = place.room.borrow_mut();
            room.at = Some(at);
            room.wishes.push_back(wish);
        }
    }
}

impl Segment for EmulatedSegment {
    fn bit_rate(&self) -> BitRate {
        self.cluster.bus().bit_rate()
    }

    fn attach(&mut self, _: VirtualInstant) -> Option<Member> {
        if let Some(free) = self.members.iter().position(|place| !place.used) {
            let place = &mut self.members[free];
            place.used = true;
            *place.room.borrow_mut() = Mailroom::default();
            let at = self.cluster.bus().now();
            self.cluster.bus_mut().connect(at, place.station);
            return Some(Member(u32::try_from(free).ok()?));
        }
        if self.members.len() >= MEMBERS {
            return None;
        }
        let number = self.members.len();
        let room = Rc::new(RefCell::new(Mailroom::default()));
        let station =
            self.cluster.add_station(format!("outside {number}"), Box::new(Outside(Rc::clone(&room))));
        self.members.push(Place { station, room, used: true });
        Some(Member(u32::try_from(number).ok()?))
    }

    fn detach(&mut self, _: VirtualInstant, member: Member) {
        let at = self.cluster.bus().now();
        if let Some(place) = self.members.get_mut(member.0 as usize) {
            place.used = false;
            *place.room.borrow_mut() = Mailroom::default();
            self.cluster.bus_mut().disconnect(at, place.station);
            self.cluster.bus_mut().reset(at, place.station);
        }
    }

    fn load(&mut self, now: VirtualInstant, member: Member, mailbox: usize, frame: WireFrame) -> bool {
        let Some(place) = self.members.get(member.0 as usize) else { return false };
        let was_empty = place
            .room
            .borrow_mut()
            .occupied
            .get_mut(mailbox)
            .is_some_and(|occupied| !std::mem::replace(occupied, true));
        if was_empty {
            self.wish(now, member, Wish::Load(mailbox, frame));
        }
        was_empty
    }

    fn withdraw(&mut self, now: VirtualInstant, member: Member, mailbox: usize) {
        self.wish(now, member, Wish::Withdraw(mailbox));
    }

    fn advance(&mut self, to: VirtualInstant, events: &mut Vec<MemberEvent>) {
        let from = self.cluster.bus().now();
        let wanted = self.time(to);
        let until = wanted.min(from + LONGEST_STEP);
        let stands = Duration::from_ticks(wanted.as_ticks() - until.as_ticks());
        self.behind += stands;
        self.pace.stood.fetch_add(stands.as_ticks(), Ordering::Relaxed);
        self.cluster.run_until(until);
        for (at, place) in self.members.iter().enumerate().filter(|(_, place)| place.used) {
            let member = Member(at as u32);
            let told = std::mem::take(&mut place.room.borrow_mut().events);
            // They bear the segment's own time, in which it has not stood still.
            events.extend(told.into_iter().map(|(at, kind)| MemberEvent { at, member, kind }));
        }
        events.sort_by_key(|event| event.at);
        // Logs and records of the nodes; nobody looks at them here.
        drop(self.cluster.take_observations());
    }

    fn next_event(&self) -> Option<VirtualInstant> {
        // The processors have always something to do.
        Some(self.cluster.bus().now() + self.behind + STEP)
    }

    fn errors(&self, member: Member) -> (u8, u8) {
        let Some(place) = self.members.get(member.0 as usize) else { return (0, 0) };
        let state = self.cluster.bus().error_state(place.station);
        let low_byte = |count: u16| u8::try_from(count).unwrap_or(u8::MAX);
        (low_byte(state.transmit_errors), low_byte(state.receive_errors))
    }
}

/// So often the server lets time pass.
const STEP: Duration = Duration::from_micros(250);
/// A machine that is further behind is too slow: then the segment's time stands.
const LONGEST_STEP: Duration = Duration::from_millis(5);
/// Connections at once, at most.
const MEMBERS: usize = 64;
