//! Clock synchronisation: one master, followers, and a succession of masters.
//!
//! The master sends a sync frame every period, time-stamps the end of its transmission, and tells the
//! stamp in a follow-up (Gergeleit and Streich). All receivers time-stamp the same end of frame, so what
//! remains of the delay is only what the two stamps are wrong. From these pairs a follower computes
//! where the master's clock can be at all; see `estimate.rs` for how. Nobody adjusts a timer: the result
//! is a [`GlobalClock`], which converts.
//!
//! # What ε means
//! Global time is the time scale of the present master. [`GlobalClock::accuracy`] bounds the distance
//! from it, given that the bounds in [`SyncConfig`] hold. Any two synchronised nodes are therefore
//! within the sum of their ε.
//!
//! When a master is lost, the first candidate by rank takes over, at its own estimate and rate, without
//! a step. Some nodes may not know it yet and still extrapolate the old time scale. So that the sum
//! above holds for them too, the new master states for seven periods, the *handover*, how far it may be
//! from the old scale, in its sync frames; it and its followers add that to ε. After six periods
//! without synchronisation a node is not synchronised any more, so then nobody is left on the old scale
//! and the addition ends. A second fail-over is at least three periods after the first, so nobody is
//! left on the first scale then.
//!
//! A candidate that does not know the old time scale well enough starts a new one, but only after eight
//! periods of silence. A node that meets a time scale it has not followed (it started the scale; it has
//! just joined; two halves of a bus have met; the master stepped) is not synchronised for six periods,
//! the starter for seven, in which the nodes on another scale change over as well or run out.
//!
//! All this holds if no node misses more than three pairs of a living master in a row. Two halves of a bus that are joined again do not agree until the loser's followers have heard the
//! winner, one period later; nobody can know before.
//!
//! # Succession
//! A candidate takes over after `(3 + rank / 8)` periods of silence; the stagger is longer than a
//! sync frame is ever delayed, and the time-out of the last one is still within the six periods. A
//! restarted master follows whoever is in office. If two masters meet, the lower rank (then the lower
//! TxNode) stays, and the other yields at once. A master that cannot send for three periods, because no
//! node acknowledges or its controller is off the bus, gives up its office and listens again. Only complete pairs count: a master whose follow-ups do
//! not arrive is silent.
//!
//! # Bad masters
//! A pair that contradicts what is known is not used, counted, and reported. The third in a row is
//! believed: the node starts anew, not synchronised for six periods.
//!
//! # Calling order
//! Hand every received sync and follow-up frame to [`ClockSync::on_frame`] with its time-stamp, and every
//! transmitted one to [`ClockSync::on_sent`]. After either, and at [`ClockSync::next_wakeup`], call
//! [`ClockSync::poll`] until it returns `None`, and send the frames in that order; then fetch the events
//! and copy [`ClockSync::clock`] to where it is used. Calls may be late; a late one delays the frames,
//! nothing else. All work is constant but that of a pair, which is linear in a window of eight points.

mod config;
mod estimate;
mod event;
mod master;

pub use config::{SyncConfig, SyncConfigError};
pub use event::{ClockEvent, SyncCounters};

use crate::can::{Etag, Frame, TxNode};
use crate::protocol::{FollowUp, Rank, SyncMessage, SyncSequence};
use crate::time::{Duration, GlobalClock, GlobalInstant, Instant, Rate, Uncertainty};
use estimate::Estimate;
use event::{Events, count};
use master::Mastership;

/// The clock synchronisation of one node. See the [module](self) for the rules and the calling order.
///
/// ```
/// use cosmic_core::can::TxNode;
/// use cosmic_core::protocol::Rank;
/// use cosmic_core::time::sync::{ClockSync, SyncConfig};
/// use cosmic_core::time::{Duration, Instant};
///
/// let config = SyncConfig { rank: Some(Rank::FIRST), ..SyncConfig::DEFAULT };
/// let mut sync = ClockSync::new(config, Instant::EPOCH)?;
/// sync.set_tx_node(TxNode::new(7));
/// // Nobody else is there: after eight periods it becomes master and sends its first sync frame.
/// assert_eq!(sync.poll(Instant::EPOCH), None);
/// assert_eq!(sync.next_wakeup(), Instant::EPOCH + Duration::from_millis(800));
/// let frame = sync.poll(sync.next_wakeup()).unwrap();
/// assert!(sync.is_master());
/// // The driver reports when it was sent; the follow-up tells everybody.
/// sync.on_sent(&frame, Instant::EPOCH + Duration::from_micros(800_160));
/// let follow_up = sync.poll(Instant::EPOCH + Duration::from_micros(800_170)).unwrap();
/// assert_eq!(follow_up.payload.as_slice(), [0, 0, 0, 0, 0x2F, 0xB1, 0x79, 0x00]);
/// # Ok::<(), cosmic_core::time::sync::SyncConfigError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ClockSync {
    config: SyncConfig,
    tx_node: Option<TxNode>,
    role: Role,
    clock: GlobalClock,
    pending: Option<Pending>,
    calendar_mismatch: bool,
    events: Events,
    counters: SyncCounters,
}

#[derive(Clone, Debug)]
// The large variant is the usual one, and there is no heap.
#[allow(clippy::large_enum_variant)]
enum Role {
    /// No master has been heard.
    Listening {
        since: Instant,
    },
    Following(Following),
    Master(Mastership),
}

#[derive(Clone, Debug)]
struct Following {
    master: TxNode,
    rank: Rank,
    /// The predecessor that the master named when this node began to follow it.
    predecessor: TxNode,
    /// When the last pair was heard, plausible or not.
    heard_at: Instant,
    /// The sequence number of the last pair.
    sequence: SyncSequence,
    /// From here on nobody is left on another time scale.
    trusted_from: Instant,
    estimate: Estimate,
    /// Implausible pairs since the last plausible one.
    implausible: u8,
    /// The loss has been reported.
    lost: bool,
}

/// A sync frame that waits for its follow-up.
#[derive(Clone, Copy, Debug)]
struct Pending {
    from: TxNode,
    message: SyncMessage,
    received_at: Instant,
}

/// A sync frame and its follow-up.
#[derive(Clone, Copy)]
struct Pair {
    from: TxNode,
    message: SyncMessage,
    received_at: Instant,
    sent_at: GlobalInstant,
}

impl ClockSync {
    /// Starts to listen. It takes part as a follower at once, and as a candidate from
    /// [`ClockSync::set_tx_node`] on.
    ///
    /// # Errors
    /// The first setting that is refused.
    pub const fn new(config: SyncConfig, now: Instant) -> Result<Self, SyncConfigError> {
        if let Err(error) = config.check() {
            return Err(error);
        }
        Ok(Self {
            config,
            tx_node: None,
            role: Role::Listening { since: now },
            clock: GlobalClock::unsynchronised(),
            pending: None,
            calendar_mismatch: false,
            events: Events::EMPTY,
            counters: SyncCounters {
                sent: 0,
                unsent: 0,
                used: 0,
                follow_ups_missed: 0,
                syncs_missed: 0,
                duplicates: 0,
                implausible: 0,
                foreign: 0,
                malformed: 0,
                events_lost: 0,
            },
        })
    }

    /// This node's id from now on; a node without one sends nothing. A master that loses its id goes on
    /// when it has one again.
    pub fn set_tx_node(&mut self, tx_node: Option<TxNode>) {
        self.tx_node = tx_node;
    }

    /// The clock as of the last call. Valid until the next call to any other method that changes it.
    pub const fn clock(&self) -> GlobalClock {
        self.clock
    }

    /// Is this node the master?
    pub const fn is_master(&self) -> bool {
        matches!(self.role, Role::Master(_))
    }

    /// The master that this node follows, which may be itself.
    pub const fn master(&self) -> Option<TxNode> {
        match &self.role {
            Role::Listening { .. } => None,
            Role::Following(following) => Some(following.master),
            Role::Master(_) => self.tx_node,
        }
    }

    /// Has the master that this node follows another calendar? Then the node must be silent in hard
    /// real-time slots.
    pub const fn has_calendar_mismatch(&self) -> bool {
        self.calendar_mismatch
    }

    /// What was sent, used, and dropped.
    pub const fn counters(&self) -> &SyncCounters {
        &self.counters
    }

    /// The oldest event that has not been fetched. At most six are kept; more are counted as lost.
    pub fn poll_event(&mut self) -> Option<ClockEvent> {
        self.events.pop()
    }

    /// Takes a received frame, with the local time of its end. Frames with other etags are ignored.
    pub fn on_frame(&mut self, frame: &Frame, received_at: Instant) {
        let from = frame.id.tx_node();
        if frame.id.etag() != Etag::SYNC && frame.id.etag() != Etag::FOLLOW_UP {
            return;
        }
        if let Some(message) = SyncMessage::decode(frame) {
            self.on_sync(Pending { from, message, received_at });
        } else if let Some(message) = FollowUp::decode(frame) {
            self.on_follow_up(from, message, received_at);
        } else {
            count(&mut self.counters.malformed);
        }
    }

    /// Takes the local time at which the transmission of a frame that [`ClockSync::poll`] gave out ended.
    /// Other frames are ignored.
    pub fn on_sent(&mut self, frame: &Frame, sent_at: Instant) {
        let Role::Master(mastership) = &mut self.role else { return };
        if SyncMessage::decode(frame)
            .is_some_and(|message| mastership.on_sent(&message, sent_at, &self.clock))
        {
            count(&mut self.counters.sent);
        }
    }

    /// The next frame to be sent, at the most urgent soft real-time priority; call it until there is none.
    /// At most two frames a period.
    pub fn poll(&mut self, now: Instant) -> Option<Frame> {
        self.report_loss(now);
        self.give_up_unheard(now);
        if self.takeover_at().is_some_and(|at| now >= at) {
            self.become_master(now);
        }
        let tx_node = self.tx_node?;
        let Role::Master(mastership) = &mut self.role else { return None };
        if mastership.end_handover(now, tx_node) {
            self.clock = self.clock.with_uncertainty(Uncertainty::NONE);
        }
        if let Some(follow_up) = mastership.take_follow_up() {
            return Some(follow_up.encode(tx_node));
        }
        let rank = self.config.rank?;
        let (sequence, unsent) = mastership.next_sync(now, self.config.period)?;
        if unsent {
            count(&mut self.counters.unsent);
        }
        let predecessor = mastership.predecessor();
        // The followers take it as it is until the next sync frame; it must be right until then.
        let distance = self.clock.accuracy(now + self.config.period);
        let message = SyncMessage {
            sequence,
            rank,
            predecessor,
            accuracy: if predecessor == tx_node { Duration::from_ticks(0) } else { distance },
            calendar_digest: self.config.calendar_digest,
        };
        Some(message.encode(tx_node))
    }

    /// When [`ClockSync::poll`] has something to do, if no frame comes before.
    pub fn next_wakeup(&self) -> Instant {
        match &self.role {
            Role::Listening { .. } => self.takeover_at().unwrap_or(Instant::FAR_FUTURE),
            Role::Following(following) => {
                let loss = following.heard_at + self.config.loss_time_out();
                let loss = if following.lost { Instant::FAR_FUTURE } else { loss };
                self.takeover_at().unwrap_or(Instant::FAR_FUTURE).min(loss)
            }
            Role::Master(_) if self.tx_node.is_none() => Instant::FAR_FUTURE,
            Role::Master(mastership) => mastership.next_wakeup(),
        }
    }

    fn on_sync(&mut self, sync: Pending) {
        let period = self.config.period;
        if let Some(pending) = &self.pending {
            let age = sync.received_at.saturating_since(pending.received_at);
            if pending.from == sync.from {
                // The later copy of a repeated frame is the one that the master has time-stamped.
                let repeated = pending.message.sequence == sync.message.sequence && age < period;
                let counters = &mut self.counters;
                count(if repeated { &mut counters.duplicates } else { &mut counters.follow_ups_missed });
            } else if precedes(pending, &sync) && age < Duration::from_ticks(period.as_ticks() / 4) {
                // Frames of two masters interleave: the better one's follow-up is awaited.
                count(&mut self.counters.foreign);
                return;
            } else {
                count(&mut self.counters.follow_ups_missed);
            }
        }
        self.pending = Some(sync);
    }

    fn on_follow_up(&mut self, from: TxNode, message: FollowUp, received_at: Instant) {
        let matching = self.pending.filter(|pending| {
            pending.from == from
                && pending.message.sequence == message.sequence
                && received_at.saturating_since(pending.received_at) < self.config.period
        });
        let Some(Pending { message: sync, received_at, .. }) = matching else {
            count(&mut self.counters.syncs_missed);
            return;
        };
        self.pending = None;
        self.on_pair(Pair { from, message: sync, received_at, sent_at: message.sent_at });
    }

    fn on_pair(&mut self, pair: Pair) {
        match &self.role {
            Role::Listening { .. } => self.follow_anew(&pair),
            Role::Following(following) if following.master == pair.from => self.on_own_master(&pair),
            Role::Following(following) => {
                let in_office = (following.rank, following.master);
                // A master that sent a frame lately is in office, even if one of its frames was lost.
                let alive = pair.received_at.saturating_since(following.heard_at) < self.config.periods(2);
                if alive && in_office < (pair.message.rank, pair.from) {
                    count(&mut self.counters.foreign);
                } else {
                    self.change_master(&pair);
                }
            }
            Role::Master(_) => {
                if self.own_place().is_some_and(|own| own < (pair.message.rank, pair.from)) {
                    count(&mut self.counters.foreign);
                } else {
                    self.yield_to(&pair);
                }
            }
        }
    }

    /// This node's place in the succession, smallest first.
    fn own_place(&self) -> Option<(Rank, TxNode)> {
        self.config.rank.zip(self.tx_node)
    }

    fn on_own_master(&mut self, pair: &Pair) {
        let Role::Following(following) = &mut self.role else { return };
        let silent = pair.received_at.saturating_since(following.heard_at);
        if following.sequence == pair.message.sequence && silent < self.config.period {
            // A repeated sync frame and its repeated follow-up.
            count(&mut self.counters.duplicates);
            return;
        }
        // A master that was away may have followed another one in between, and continue that one's scale.
        let predecessor = pair.message.predecessor;
        let same_scale = predecessor == following.predecessor || predecessor == pair.from;
        if silent >= self.config.holdover() || !same_scale {
            return self.follow_anew(pair);
        }
        following.heard_at = pair.received_at;
        following.sequence = pair.message.sequence;
        following.predecessor = predecessor;
        following.lost = false;
        if following.estimate.observe(pair.received_at, pair.sent_at).is_ok() {
            following.implausible = 0;
            self.accept(pair);
        } else {
            self.reject(pair);
        }
    }

    fn reject(&mut self, pair: &Pair) {
        let Role::Following(following) = &mut self.role else { return };
        following.implausible = following.implausible.saturating_add(1);
        let persistent = following.implausible >= IMPLAUSIBLE_LIMIT;
        count(&mut self.counters.implausible);
        if persistent {
            self.restart(pair);
            self.tell(ClockEvent::Restarted { master: pair.from });
        } else {
            self.tell(ClockEvent::Implausible { master: pair.from });
        }
    }

    fn change_master(&mut self, pair: &Pair) {
        let Role::Following(following) = &self.role else { return };
        let estimate = if pair.message.predecessor == following.master {
            self.continuation(&following.estimate, pair)
        } else {
            None
        };
        let trusted_from = following.trusted_from;
        match estimate {
            Some(estimate) => self.follow(pair, estimate, trusted_from, true),
            None => self.follow_anew(pair),
        }
    }

    fn yield_to(&mut self, pair: &Pair) {
        self.tell(ClockEvent::Yielded { to: pair.from });
        let own = Estimate::exact(&self.config, pair.received_at, &self.clock);
        let estimate =
            if Some(pair.message.predecessor) == self.tx_node { self.continuation(&own, pair) } else { None };
        match estimate {
            Some(estimate) => self.follow(pair, estimate, pair.received_at, true),
            None => self.follow_anew(pair),
        }
    }

    /// What is known of the new master's time scale, which continues that of `old`. `None` if it does not.
    fn continuation(&self, old: &Estimate, pair: &Pair) -> Option<Estimate> {
        let rate_error = self.config.takeover_rate_error();
        let mut estimate = old.continued(pair.received_at, pair.message.accuracy, rate_error)?;
        estimate.observe(pair.received_at, pair.sent_at).ok()?;
        Some(estimate)
    }

    fn follow_anew(&mut self, pair: &Pair) {
        self.restart(pair);
        self.tell(ClockEvent::MasterChanged { master: pair.from, continued: false });
    }

    fn restart(&mut self, pair: &Pair) {
        let estimate = Estimate::new(&self.config, pair.received_at, pair.sent_at);
        self.set_following(pair, estimate, pair.received_at + self.config.holdover());
    }

    fn follow(&mut self, pair: &Pair, estimate: Estimate, trusted_from: Instant, continued: bool) {
        self.set_following(pair, estimate, trusted_from);
        self.tell(ClockEvent::MasterChanged { master: pair.from, continued });
    }

    fn set_following(&mut self, pair: &Pair, estimate: Estimate, trusted_from: Instant) {
        self.role = Role::Following(Following {
            master: pair.from,
            rank: pair.message.rank,
            predecessor: pair.message.predecessor,
            heard_at: pair.received_at,
            sequence: pair.message.sequence,
            trusted_from,
            estimate,
            implausible: 0,
            lost: false,
        });
        self.accept(pair);
    }

    /// Makes the clock after a pair that is part of the estimate.
    fn accept(&mut self, pair: &Pair) {
        let Role::Following(following) = &self.role else { return };
        count(&mut self.counters.used);
        let trusted = pair.received_at >= following.trusted_from;
        let valid_until = if trusted { pair.received_at + self.config.holdover() } else { Instant::EPOCH };
        let distance = pair.message.accuracy;
        let in_handover = !distance.is_zero();
        let more_rate = if in_handover { self.config.takeover_rate_error() } else { 0 };
        self.clock = following.estimate.clock(distance, more_rate, valid_until);
        self.compare_calendars(pair);
    }

    fn compare_calendars(&mut self, pair: &Pair) {
        let (own, other) = (self.config.calendar_digest, pair.message.calendar_digest);
        let mismatch = own != 0 && other != 0 && own != other;
        if mismatch != self.calendar_mismatch {
            self.calendar_mismatch = mismatch;
            let master = pair.from;
            self.tell(if mismatch {
                ClockEvent::CalendarMismatch { master }
            } else {
                ClockEvent::CalendarMatch { master }
            });
        }
    }

    fn report_loss(&mut self, now: Instant) {
        let Role::Following(following) = &mut self.role else { return };
        if !following.lost && now >= following.heard_at + self.config.loss_time_out() {
            following.lost = true;
            let master = following.master;
            self.tell(ClockEvent::MasterLost { master });
        }
    }

    fn give_up_unheard(&mut self, now: Instant) {
        let Role::Master(mastership) = &self.role else { return };
        if mastership.is_unheard(now, self.config.loss_time_out()) {
            self.role = Role::Listening { since: now };
            self.clock = self.clock.with_uncertainty(Uncertainty::COMPLETE);
            self.tell(ClockEvent::Isolated);
        }
    }

    /// When this node becomes master; `None` if it does not.
    fn takeover_at(&self) -> Option<Instant> {
        let (rank, _) = self.own_place()?;
        let delay = self.config.rank_delay(rank);
        match &self.role {
            Role::Listening { since } => Some(*since + self.config.cold_start_time_out() + delay),
            Role::Following(following) => {
                let early = following.heard_at + self.config.loss_time_out() + delay;
                let late = following.heard_at + self.config.cold_start_time_out() + delay;
                Some(if self.continued_clock(following, early).is_some() { early } else { late })
            }
            Role::Master(_) => None,
        }
    }

    /// The clock with which this node continues the time scale that it follows from `at` on. `None` if it
    /// does not know it well enough until the end of the handover.
    fn continued_clock(&self, following: &Following, at: Instant) -> Option<GlobalClock> {
        if !self.clock.is_synchronised(at) {
            return None;
        }
        let clock = following.estimate.clock(Duration::from_ticks(0), 0, Instant::FAR_FUTURE);
        let end = at + self.config.handover() + self.config.period;
        let limit = self.config.takeover_rate_error();
        let known = clock.rate_error(end).is_some_and(|error| error.fraction() <= limit)
            && clock.accuracy(end) < SyncMessage::LARGEST_ACCURACY;
        let own = clock.rate().fraction().abs() <= self.config.master_rate_limit();
        (known && own).then_some(clock)
    }

    fn become_master(&mut self, now: Instant) {
        let Some(tx_node) = self.tx_node else { return };
        let continued = match &self.role {
            Role::Following(following) => {
                self.continued_clock(following, now).map(|clock| (clock, following.master))
            }
            _ => None,
        };
        let (clock, predecessor) = continued.unwrap_or_else(|| {
            let reached = self.clock.to_global(now);
            (GlobalClock::new(now, reached, Rate::ZERO, Uncertainty::COMPLETE), tx_node)
        });
        self.clock = clock;
        self.role = Role::Master(Mastership::new(now, predecessor, now + self.config.handover()));
        self.pending = None;
        if core::mem::take(&mut self.calendar_mismatch) {
            self.tell(ClockEvent::CalendarMatch { master: tx_node });
        }
        self.tell(ClockEvent::BecameMaster { continued: continued.is_some() });
    }

    fn tell(&mut self, event: ClockEvent) {
        if !self.events.push(event) {
            count(&mut self.counters.events_lost);
        }
    }
}

/// Does the sender of the first come before that of the second in the succession?
fn precedes(first: &Pending, second: &Pending) -> bool {
    (first.message.rank, first.from) < (second.message.rank, second.from)
}

/// So many implausible pairs in a row are believed.
const IMPLAUSIBLE_LIMIT: u8 = 3;
