//! A CAN controller with its bus, as a value: what the driver of a node would talk to.
//!
//! Three transmit mailboxes and one peer on the bus. Whenever the bus is free the frame with the smallest
//! identifier starts, from a mailbox or from the peer; it takes the longest time that a frame of its
//! length can take. There are no errors here: those are the business of the bus simulation on the host.
//! Like the core, the model is told the time, so it runs by exact instants and by a timer alike.

use cosmic_core::can::{BitRate, Command, Frame, Mailbox, Outcome};
use cosmic_core::time::Instant;
use heapless::Vec;

/// The controller of a node, its bus, and a peer.
pub struct Controller {
    bit_rate: BitRate,
    mailboxes: [Option<Frame>; 3],
    peer: Vec<Frame, 16>,
    wire: Option<OnWire>,
}

#[derive(Clone, Copy)]
struct OnWire {
    from: Sender,
    frame: Frame,
    until: Instant,
}

/// Who sent a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Sender {
    /// This node, from this mailbox, which is empty now.
    Mailbox(Mailbox),
    /// The peer: the frame is received.
    Peer,
}

/// A frame has ended on the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Sent {
    /// Who sent it.
    pub from: Sender,
    /// The frame.
    pub frame: Frame,
    /// Its end.
    pub at: Instant,
}

impl Controller {
    /// An idle bus.
    pub const fn new(bit_rate: BitRate) -> Self {
        Self { bit_rate, mailboxes: [None; 3], peer: Vec::new(), wire: None }
    }

    /// Carries a command out. A frame that is withdrawn while it waits has its outcome at once; one that
    /// is on the wire is sent.
    ///
    /// # Panics
    /// If a mailbox is loaded that is not empty.
    pub fn execute(&mut self, command: Command, now: Instant) -> Option<(Mailbox, Outcome)> {
        match command {
            Command::Load(mailbox, frame) => {
                let before = self.mailboxes[mailbox as usize].replace(frame);
                assert!(before.is_none(), "{mailbox:?} mailbox loaded twice");
                self.start(now);
                None
            }
            Command::Withdraw(mailbox) => {
                let on_wire = self.wire.is_some_and(|wire| wire.from == Sender::Mailbox(mailbox));
                if on_wire || self.mailboxes[mailbox as usize].take().is_none() {
                    return None;
                }
                Some((mailbox, Outcome::Withdrawn))
            }
        }
    }

    /// The peer wants to send a frame.
    ///
    /// # Panics
    /// If more than 16 wait.
    pub fn peer_sends(&mut self, frame: Frame, now: Instant) {
        assert!(self.peer.push(frame).is_ok(), "too many frames of the peer");
        self.start(now);
    }

    /// When [`advance`](Self::advance) has to be called next.
    pub fn next_event(&self) -> Instant {
        self.wire.map_or(Instant::FAR_FUTURE, |wire| wire.until)
    }

    /// The frame that has ended by `now`, if any; the next one has started then. Call it until there is
    /// none.
    pub fn advance(&mut self, now: Instant) -> Option<Sent> {
        let OnWire { from, frame, until } = self.wire.take_if(|wire| wire.until <= now)?;
        if let Sender::Mailbox(mailbox) = from {
            self.mailboxes[mailbox as usize] = None;
        }
        self.start(until);
        Some(Sent { from, frame, at: until })
    }

    /// Arbitration, if the bus is free.
    fn start(&mut self, at: Instant) {
        if self.wire.is_some() {
            return;
        }
        let own = Mailbox::ALL
            .into_iter()
            .filter_map(|mailbox| Some((self.mailboxes[mailbox as usize]?, Sender::Mailbox(mailbox))))
            .min_by_key(|(frame, _)| frame.id);
        let of_peer = (0..self.peer.len()).min_by_key(|&place| self.peer[place].id);
        let (frame, from) = match (own, of_peer) {
            (Some(own), Some(place)) if own.0.id < self.peer[place].id => own,
            (_, Some(place)) => (self.peer.remove(place), Sender::Peer),
            (Some(own), None) => own,
            (None, None) => return,
        };
        let until = at + self.bit_rate.longest_frame(frame.payload.len());
        self.wire = Some(OnWire { from, frame, until });
    }
}
