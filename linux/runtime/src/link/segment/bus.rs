//! A bus that a server can hold: the simulated one, or any other in virtual time.

use cosmic_bus::{Bus, ErrorLevel, EventKind, StationId, VirtualInstant, WireFrame};
use cosmic_core::can::BitRate;

/// A connection, as a station on the bus.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Member(pub u32);

/// Something that a connection's controller learns.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct MemberEvent {
    /// When.
    pub at: VirtualInstant,
    /// Whose controller.
    pub member: Member,
    /// What.
    pub kind: EventKind,
}

/// A bus in virtual time. Each call states the present; time does not go back.
pub trait Segment: 'static {
    /// Its bit rate.
    fn bit_rate(&self) -> BitRate;

    /// A station joins; `None` if there is no room.
    fn attach(&mut self, now: VirtualInstant) -> Option<Member>;

    /// A station leaves, with the frames in its mailboxes.
    fn detach(&mut self, now: VirtualInstant, member: Member);

    /// Loads a frame into a mailbox. Returns whether that was empty.
    fn load(&mut self, now: VirtualInstant, member: Member, mailbox: usize, frame: WireFrame) -> bool;

    /// Withdraws the frame of a mailbox.
    fn withdraw(&mut self, now: VirtualInstant, member: Member, mailbox: usize);

    /// Lets time pass, and appends what happened.
    fn advance(&mut self, to: VirtualInstant, events: &mut Vec<MemberEvent>);

    /// When to call [`advance`](Self::advance) next if nothing is loaded.
    fn next_event(&self) -> Option<VirtualInstant>;

    /// The error counters of a station, as a controller shows them.
    fn errors(&self, member: Member) -> (u8, u8);
}

/// The bit-accurate bus of `cosmic-bus`.
pub struct SimulatedSegment {
    bus: Bus,
    /// It acknowledges.
    listener: StationId,
    members: Vec<(StationId, bool)>,
    events: Vec<cosmic_bus::Event>,
}

impl SimulatedSegment {
    /// On this bus, which may have stations of its own.
    pub fn new(mut bus: Bus) -> Self {
        let listener = bus.attach("listener");
        Self { bus, listener, members: Vec::new(), events: Vec::new() }
    }

    /// The bus, for its accounting, faults and trace.
    pub const fn bus_mut(&mut self) -> &mut Bus {
        &mut self.bus
    }

    fn station(&self, member: Member) -> Option<StationId> {
        self.members.get(member.0 as usize).map(|(station, _)| *station)
    }
}

impl Segment for SimulatedSegment {
    fn bit_rate(&self) -> BitRate {
        self.bus.bit_rate()
    }

    fn attach(&mut self, now: VirtualInstant) -> Option<Member> {
        if let Some(at) = self.members.iter().position(|(_, used)| !used) {
            let (station, used) = &mut self.members[at];
            *used = true;
            self.bus.connect(now, *station);
            return Some(Member(at as u32));
        }
        if self.members.len() >= MEMBERS {
            return None;
        }
        let at = self.members.len();
        self.members.push((self.bus.attach(format!("member {at}")), true));
        Some(Member(at as u32))
    }

    fn detach(&mut self, now: VirtualInstant, member: Member) {
        if let Some((station, used)) = self.members.get_mut(member.0 as usize) {
            *used = false;
            self.bus.disconnect(now, *station);
            self.bus.reset(now, *station);
        }
    }

    fn load(&mut self, now: VirtualInstant, member: Member, mailbox: usize, frame: WireFrame) -> bool {
        self.station(member).is_some_and(|station| self.bus.load(now, station, mailbox, frame).is_ok())
    }

    fn withdraw(&mut self, now: VirtualInstant, member: Member, mailbox: usize) {
        if let Some(station) = self.station(member) {
            self.bus.withdraw(now, station, mailbox);
        }
    }

    fn advance(&mut self, to: VirtualInstant, events: &mut Vec<MemberEvent>) {
        self.bus.advance(to, &mut self.events);
        for event in self.events.drain(..) {
            if event.station == self.listener {
                continue;
            }
            let at = self.members.iter().position(|(station, used)| *used && *station == event.station);
            if let Some(at) = at {
                events.push(MemberEvent { at: event.at, member: Member(at as u32), kind: event.kind });
            }
        }
    }

    fn next_event(&self) -> Option<VirtualInstant> {
        self.bus.next_event()
    }

    fn errors(&self, member: Member) -> (u8, u8) {
        let Some(station) = self.station(member) else { return (0, 0) };
        let state = self.bus.error_state(station);
        let low_byte = |count: u16| u8::try_from(count).unwrap_or(u8::MAX);
        (low_byte(state.transmit_errors), low_byte(state.receive_errors))
    }
}

/// Returns whether the station has left the bus.
pub(super) fn is_bus_off(kind: &EventKind) -> bool {
    matches!(kind, EventKind::ErrorState(state) if state.level() == ErrorLevel::BusOff)
}

/// Connections at once, at most: a segment has no more nodes.
const MEMBERS: usize = 127;
