//! Clock synchronisation: one master, followers, and a succession of masters.
//!
//! The master sends a sync frame every period, time-stamps the end of its transmission, and tells the
//! stamp in a follow-up (Gergeleit and Streich). All receivers time-stamp the same frame, one bit before its
//! end, so what remains of the delay is only what the two stamps are wrong. From these pairs a follower computes
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
//! All this holds if no node misses more than three pairs of a living master in a row, and if no frame
//! is sent later than [`ClockSync::frame_lifetime`] allows. Two halves of a bus that are joined again do
//! not agree until the loser's followers have heard the winner, one period later; nobody can know before.
//!
//! # Succession
//! A candidate takes over after `(3 + rank / 8)` periods of silence; the stagger is longer than a
//! sync frame is ever delayed, and the time-out of the last one is still within the six periods. A
//! restarted master follows whoever is in office. If two masters meet, the lower rank (then the lower
//! TxNode) stays, and the other yields at once. A node that has yielded continues no time scale for the
//! next fourteen periods: so long somebody may name it as predecessor and mean the scale that it has given
//! up, and nobody could tell that one from the new one. A master that cannot send for three periods,
//! because no node acknowledges or its controller is off the bus, gives up its office and listens again.
//! Only complete pairs count: a master whose follow-ups do not arrive is silent.
//!
//! # Bad masters
//! A pair that contradicts what is known is not used, counted, and reported. The third in a row is
//! believed: the node starts anew, not synchronised for six periods.
//!
//! A pair with an instant at or after [`FollowUp::END`] is never believed, and its sender is no master. A master
//! starts its time scale anew before it gets there, and nobody continues one that would: whatever instant
//! somebody has told, global time never comes near the wrap of the frames that carry it.
//!
//! # Calling order
//! Hand every received sync and follow-up frame to [`ClockSync::on_frame`] with its time-stamp, and every
//! transmitted one to [`ClockSync::on_sent`]. After either, and at [`ClockSync::next_wakeup`], call
//! [`ClockSync::poll`] until it returns `None`, and send the frames in that order; then fetch the events
//! and, after a [change](ClockSync::take_change), copy [`ClockSync::clock`] to where it is used. Calls may be
//! late; a late one delays the frames, nothing else. All work is constant but that of a pair, which is linear
//! in a window of eight points.

mod config;
mod estimate;
mod event;
mod follower;
mod master;

pub use config::{SyncConfig, SyncConfigError};
pub use event::{ClockEvent, SyncCounters};

use crate::can::{Etag, Frame, TxNode};
use crate::protocol::{FollowUp, Rank, SyncMessage, SyncSequence};
use crate::time::{Duration, GlobalClock, GlobalInstant, Instant, Rate, Uncertainty};
use event::{Events, count};
use follower::{Following, Pending};
use master::Mastership;

/// The clock synchronisation of one node. See the [module](self) for the rules and the calling order.
///
/// ```
/// use cosmic_core::can::TxNode;
/// use cosmic_core::protocol::Rank;
/// use cosmic_core::sync::{ClockSync, SyncConfig};
/// use cosmic_core::time::{Duration, Instant};
///
/// let config = SyncConfig { rank: Some(Rank::FIRST), ..SyncConfig::DEFAULT };
/// let mut sync: ClockSync = ClockSync::new(config, Instant::EPOCH)?;
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
/// # Ok::<(), cosmic_core::sync::SyncConfigError>(())
/// ```
///
/// One that is no `CANDIDATE` only follows, and an image has no code for what a master does.
#[derive(Clone, Debug)]
pub struct ClockSync<const CANDIDATE: bool = true> {
    config: SyncConfig,
    tx_node: Option<TxNode>,
    role: Standing,
    clock: GlobalClock,
    /// It is another one than its owner knows.
    changed: bool,
    /// When this node becomes master, unless a pair comes before; it takes a while to compute.
    takeover_at: Instant,
    /// Before this, somebody may still continue the time scale that this node has given up.
    given_up_until: Instant,
    /// The number of the last sync frame of the mastership before.
    last_sequence: SyncSequence,
    pending: Option<Pending>,
    calendar_mismatch: bool,
    /// The last one whose pair was refused as out of range.
    refused: Option<TxNode>,
    events: Events,
    counters: SyncCounters,
}

#[derive(Clone, Debug)]
// The large variant is the usual one, and there is no heap.
#[allow(clippy::large_enum_variant)]
enum Standing {
    /// No master has been heard.
    Listening {
        since: Instant,
    },
    Following(Following),
    Master(Mastership),
}

impl<const CANDIDATE: bool> ClockSync<CANDIDATE> {
    /// Starts to listen. It takes part as a follower at once, and as a candidate from
    /// [`ClockSync::set_tx_node`] on.
    ///
    /// # Errors
    /// The first setting that is refused; a rank, if this is no candidate.
    pub const fn new(config: SyncConfig, now: Instant) -> Result<Self, SyncConfigError> {
        if let Err(error) = config.check() {
            return Err(error);
        }
        if !CANDIDATE && config.rank.is_some() {
            return Err(SyncConfigError::Rank);
        }
        Ok(Self {
            config,
            tx_node: None,
            role: Standing::Listening { since: now },
            clock: GlobalClock::unsynchronised(),
            changed: true,
            takeover_at: Instant::FAR_FUTURE,
            given_up_until: Instant::EPOCH,
            last_sequence: SyncSequence::new(u8::MAX),
            pending: None,
            calendar_mismatch: false,
            refused: None,
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
                out_of_range: 0,
                malformed: 0,
                events_lost: 0,
            },
        })
    }

    /// This node's id from now on; a node without one sends nothing. A master that loses its id goes on
    /// when it has one again.
    pub fn set_tx_node(&mut self, tx_node: Option<TxNode>) {
        self.tx_node = tx_node;
        self.schedule_takeover();
    }

    /// The clock as of the last call. Valid until the next call to any other method that changes it.
    pub const fn clock(&self) -> GlobalClock {
        self.clock
    }

    /// Returns whether the clock has become another one since the last call.
    pub const fn take_change(&mut self) -> bool {
        core::mem::replace(&mut self.changed, false)
    }

    /// Returns whether this node is the master.
    pub const fn is_master(&self) -> bool {
        CANDIDATE && matches!(self.role, Standing::Master(_))
    }

    /// The master that this node follows, which may be itself.
    pub const fn master(&self) -> Option<TxNode> {
        match &self.role {
            Standing::Listening { .. } => None,
            Standing::Following(following) => Some(following.master),
            Standing::Master(_) => self.tx_node,
        }
    }

    /// Returns whether the master that this node follows has another calendar. Then the node must be silent in hard
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

    /// Takes a received frame, with the local time at which it was received: [`SyncConfig::bit_time`] before
    /// its end. Frames with other etags are ignored.
    pub fn on_frame(&mut self, frame: &Frame, received_at: Instant) {
        let from = frame.id.tx_node();
        if frame.id.etag() != Etag::SYNC && frame.id.etag() != Etag::FOLLOW_UP {
            return;
        }
        // The instant at which its sender was done.
        let received_at = received_at + self.config.bit_time;
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
        if !CANDIDATE {
            return;
        }
        let Standing::Master(mastership) = &mut self.role else { return };
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
        if !CANDIDATE {
            return None;
        }
        self.give_up_unheard(now);
        if now >= self.takeover_at {
            self.become_master(now);
        }
        let tx_node = self.tx_node?;
        self.end_time_scale(now, tx_node);
        let Standing::Master(mastership) = &mut self.role else { return None };
        if mastership.end_handover(now, tx_node) {
            self.clock = self.clock.with_uncertainty(Uncertainty::NONE);
            self.changed = true;
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

    /// A frame from [`ClockSync::poll`] that has not been sent for so long is not to be sent any more: two
    /// periods.
    ///
    /// Its sender has given it up, and another frame may bear its number when the bus is back after a
    /// while. A receiver could take the instant of the one for that of the other.
    pub const fn frame_lifetime(&self) -> Duration {
        self.config.periods(2)
    }

    /// When [`ClockSync::poll`] has something to do, if no frame comes before.
    pub fn next_wakeup(&self) -> Instant {
        match &self.role {
            Standing::Listening { .. } => self.takeover_at,
            Standing::Following(following) => {
                let loss = following.heard_at + self.config.loss_time_out();
                let loss = if following.lost { Instant::FAR_FUTURE } else { loss };
                self.takeover_at.min(loss)
            }
            Standing::Master(_) if !CANDIDATE || self.tx_node.is_none() => Instant::FAR_FUTURE,
            Standing::Master(mastership) => mastership.next_wakeup(),
        }
    }

    /// This node's place in the succession, smallest first.
    fn own_place(&self) -> Option<(Rank, TxNode)> {
        if CANDIDATE { self.config.rank.zip(self.tx_node) } else { None }
    }

    fn report_loss(&mut self, now: Instant) {
        let Standing::Following(following) = &mut self.role else { return };
        if !following.lost && now >= following.heard_at + self.config.loss_time_out() {
            following.lost = true;
            let master = following.master;
            self.tell(ClockEvent::MasterLost { master });
        }
    }

    fn give_up_unheard(&mut self, now: Instant) {
        let Standing::Master(mastership) = &self.role else { return };
        if mastership.is_unheard(now, self.config.loss_time_out()) {
            self.last_sequence = mastership.sequence();
            self.role = Standing::Listening { since: now };
            self.set_clock(self.clock.with_uncertainty(Uncertainty::COMPLETE));
            self.schedule_takeover();
            self.tell(ClockEvent::Isolated);
        }
    }

    fn schedule_takeover(&mut self) {
        self.takeover_at = self.candidacy().unwrap_or(Instant::FAR_FUTURE);
    }

    /// When this node becomes master; `None` if it does not.
    fn candidacy(&self) -> Option<Instant> {
        let (rank, _) = self.own_place()?;
        let delay = self.config.rank_delay(rank);
        match &self.role {
            Standing::Listening { since } => Some(*since + self.config.cold_start_time_out() + delay),
            Standing::Following(following) => {
                let early = following.heard_at + self.config.loss_time_out() + delay;
                let early = early.max(self.given_up_until);
                let late = following.heard_at + self.config.cold_start_time_out() + delay;
                Some(if self.continued_clock(following, early).is_some() { early } else { late })
            }
            Standing::Master(_) => None,
        }
    }

    /// The clock with which this node continues the time scale that it follows from `at` on. `None` if it
    /// does not know it well enough until the end of the handover.
    fn continued_clock(&self, following: &Following, at: Instant) -> Option<GlobalClock> {
        if !self.clock.is_synchronised(at) || at < self.given_up_until {
            return None;
        }
        let clock = following.estimate.clock(Duration::from_ticks(0), 0, Instant::FAR_FUTURE);
        let end = at + self.config.handover() + self.config.period;
        let limit = self.config.takeover_rate_error();
        let known = clock.rate_error(end).is_some_and(|error| error.fraction() <= limit)
            && clock.accuracy(end) < SyncMessage::LARGEST_ACCURACY
            && clock.to_global(end) < FollowUp::END;
        let own = clock.rate().fraction().abs() <= self.config.master_rate_limit();
        (known && own).then_some(clock)
    }

    fn become_master(&mut self, now: Instant) {
        let Some(tx_node) = self.tx_node else { return };
        let continued = match &self.role {
            Standing::Following(following) => {
                self.continued_clock(following, now).map(|clock| (clock, following.master))
            }
            _ => None,
        };
        let (clock, predecessor) = continued.unwrap_or_else(|| (self.new_time_scale(now), tx_node));
        self.set_clock(clock);
        self.role = Standing::Master(Mastership::new(
            now,
            self.last_sequence,
            predecessor,
            now + self.config.handover(),
        ));
        self.takeover_at = Instant::FAR_FUTURE;
        self.pending = None;
        if core::mem::take(&mut self.calendar_mismatch) {
            self.tell(ClockEvent::CalendarMatch { master: tx_node });
        }
        self.tell(ClockEvent::BecameMaster { continued: continued.is_some() });
    }

    /// The clock of a time scale that begins now: where this node's clock stands, or at the origin if that is
    /// too near to the end.
    fn new_time_scale(&self, now: Instant) -> GlobalClock {
        let reached = self.clock.to_global(now);
        let ends = self.clock.to_global(now + self.config.handover()) >= FollowUp::END;
        let begin = if ends { GlobalInstant::EPOCH } else { reached };
        GlobalClock::new(now, begin, Rate::ZERO, Uncertainty::COMPLETE)
    }

    /// A master whose time scale comes to its end starts another one at the origin.
    fn end_time_scale(&mut self, now: Instant, tx_node: TxNode) {
        let Standing::Master(mastership) = &self.role else { return };
        // No frame that is given out now is sent later than that.
        if self.clock.to_global(now + self.frame_lifetime()) < FollowUp::END {
            return;
        }
        let last = mastership.sequence();
        self.set_clock(GlobalClock::new(now, GlobalInstant::EPOCH, Rate::ZERO, Uncertainty::COMPLETE));
        self.role = Standing::Master(Mastership::new(now, last, tx_node, now + self.config.handover()));
        self.tell(ClockEvent::Exhausted);
    }

    fn set_clock(&mut self, clock: GlobalClock) {
        self.clock = clock;
        self.changed = true;
    }

    fn tell(&mut self, event: ClockEvent) {
        if !self.events.push(event) {
            count(&mut self.counters.events_lost);
        }
    }
}

#[cfg(test)]
mod tests;
