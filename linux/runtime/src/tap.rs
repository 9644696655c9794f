//! A link without a node: what crosses it is told as it is, and frames are sent as they are.
//!
//! For tools that look at a segment: they take no TxNode, announce nothing, and the segment does not notice them, but
//! that the controller behind the link acknowledges what it receives.

use std::collections::VecDeque;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_core::can::{Command, ErrorCounters, Frame, Mailbox, Outcome};
use cosmic_core::time::{self, Instant};
use tokio::sync::Notify;
use tokio::task::JoinHandle;

use crate::link::{self, Bell, End, Handover, Link, LinkError};
use crate::places::Places;

/// A link without a node. The link ends with it.
///
/// ```no_run
/// use cosmic_linux::link::segment::SegmentLink;
/// use cosmic_linux::{Tap, What};
///
/// # async fn run() {
/// let tap = Tap::start(SegmentLink::new("/run/cosmic/segment"));
/// loop {
///     if let What::Frame(frame) = tap.next().await.what {
///         println!("{frame}");
///     }
/// }
/// # }
/// ```
pub struct Tap {
    shared: Arc<Shared>,
    task: JoinHandle<()>,
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// What a tap tells.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Tapped {
    /// When, by a clock that begins with the tap and does not go back. Where the link stamps frames itself, its stamp,
    /// moved so that the first one of the connection is right.
    pub at: Instant,
    /// What.
    pub what: What,
}

/// What a tap tells of.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum What {
    /// The connection stands.
    Connected,
    /// It does not, or no longer; it is tried again, unless `ends`.
    Disconnected {
        /// Why, and what to do.
        why: LinkError,
        /// It is not tried again.
        ends: bool,
    },
    /// A frame has arrived.
    Frame(Frame),
    /// A frame has arrived that COSMIC does not use; `None` if the link does not say what it was.
    Foreign(Option<WireFrame>),
    /// Something has arrived that means nothing.
    Malformed,
    /// So many frames were lost: by the link, or because nobody fetched them here.
    Lost(u32),
    /// The error counters of the controller behind the link.
    Errors(ErrorCounters),
    /// The controller behind the link has left the bus.
    BusOff,
}

/// What a frame of any kind is to a listener.
impl From<WireFrame> for What {
    fn from(frame: WireFrame) -> Self {
        Frame::try_from(frame).map_or(Self::Foreign(Some(frame)), Self::Frame)
    }
}

/// A frame could not be sent: the connection was lost, or there was none.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NotSent;

impl fmt::Display for NotSent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the frame was not sent: the link is down, or only reads")
    }
}

impl std::error::Error for NotSent {}

struct Shared {
    state: Mutex<State>,
    /// There is something to be told.
    told: Notify,
    /// There is something for the link.
    bell: Bell,
    /// A frame has been sent, or will not be.
    concluded: Notify,
    start: tokio::time::Instant,
}

struct State {
    told: VecDeque<Tapped>,
    /// Nobody fetched so many frames.
    dropped: u32,
    latest: Instant,
    /// When that was told, by the clock of this machine.
    latest_told_at: Instant,
    /// What the first stamp of this connection was, and when.
    origin: Option<(Duration, Instant)>,
    is_connected: bool,
    connections: u64,
    places: Places,
    /// What became of the frame that is being sent.
    outcome: Option<Outcome>,
}

impl State {
    /// The latest instant that was told, and what has passed since.
    fn present(&self, now: Instant) -> Instant {
        self.latest + now.saturating_since(self.latest_told_at)
    }
}

impl Tap {
    /// Starts, inside a runtime of tokio. A link that cannot be reached is tried again and again.
    pub fn start(link: impl Link) -> Self {
        let state = State {
            told: VecDeque::new(),
            dropped: 0,
            latest: Instant::EPOCH,
            latest_told_at: Instant::EPOCH,
            origin: None,
            is_connected: false,
            connections: 0,
            places: Places::new(),
            outcome: None,
        };
        let shared = Arc::new(Shared {
            state: Mutex::new(state),
            told: Notify::new(),
            bell: Bell::default(),
            concluded: Notify::new(),
            start: tokio::time::Instant::now(),
        });
        let task = tokio::spawn(link::keep_connected(link, Arc::clone(&shared) as Arc<dyn End>));
        Self { shared, task }
    }

    /// Waits for the next thing. Cancelling the wait loses none. Up to [`Tap::MOST_WAITING`] wait to be fetched; beyond
    /// that frames are dropped, and told as [`What::Lost`].
    pub async fn next(&self) -> Tapped {
        loop {
            if let Some(tapped) = self.try_next() {
                return tapped;
            }
            self.shared.told.notified().await;
        }
    }

    /// The next thing, if there is one.
    pub fn try_next(&self) -> Option<Tapped> {
        let mut state = self.shared.lock();
        if let Some(tapped) = state.told.pop_front() {
            return Some(tapped);
        }
        let dropped = core::mem::take(&mut state.dropped);
        (dropped > 0).then(|| Tapped { at: state.latest, what: What::Lost(dropped) })
    }

    /// So many things wait to be fetched at most: eight seconds of a full bus.
    pub const MOST_WAITING: usize = 65_536;

    /// The present time, as [`Tapped::at`] states it: the latest of these, and what has passed since it was told.
    pub fn now(&self) -> Instant {
        let now = self.shared.now();
        self.shared.lock().present(now)
    }

    /// Sends a frame as it is, and waits until it was sent. One at a time: so frames keep their order.
    ///
    /// # Errors
    /// There is no connection, or it was lost meanwhile.
    pub async fn send(&mut self, frame: Frame) -> Result<(), NotSent> {
        while !self.shared.load(frame)? {
            self.shared.bell.ring(&*self.shared);
            self.shared.concluded.notified().await;
        }
        self.shared.bell.ring(&*self.shared);
        loop {
            match self.shared.lock().outcome {
                Some(Outcome::Sent) => return Ok(()),
                Some(Outcome::Withdrawn) => return Err(NotSent),
                None => {}
            }
            self.shared.concluded.notified().await;
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether the frame was loaded; else the link still has the one before it, whose call was cancelled.
    fn load(&self, frame: Frame) -> Result<bool, NotSent> {
        let mut state = self.lock();
        if !state.is_connected {
            return Err(NotSent);
        }
        let _ = state.places.execute(&Command::Withdraw(Mailbox::Soft));
        if !state.places.is_empty(Mailbox::Soft) {
            return Ok(false);
        }
        state.outcome = None;
        let _ = state.places.execute(&Command::Load(Mailbox::Soft, frame));
        Ok(true)
    }

    fn now(&self) -> Instant {
        let elapsed = u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX / 2);
        Instant::from_epoch(time::Duration::from_ticks(elapsed))
    }

    fn tell(&self, what: What, stamp: Option<Duration>) {
        let now = self.now();
        let mut state = self.lock();
        let at = stamp.map_or(state.present(now), |stamp| {
            let (first, then) = *state.origin.get_or_insert((stamp, now));
            let since = u64::try_from(stamp.saturating_sub(first).as_nanos()).unwrap_or(u64::MAX / 4);
            then + time::Duration::from_ticks(since)
        });
        let at = at.max(state.latest);
        (state.latest, state.latest_told_at) = (at, now);
        let is_full = state.told.len() >= Tap::MOST_WAITING;
        if is_full && matches!(what, What::Frame(_) | What::Foreign(_) | What::Malformed) {
            state.dropped = state.dropped.saturating_add(1);
            return;
        }
        if state.dropped > 0 && !is_full {
            let lost = core::mem::take(&mut state.dropped);
            state.told.push_back(Tapped { at, what: What::Lost(lost) });
        }
        // What is not a frame is rare, and bounded with the connections.
        if !is_full || state.told.len() < 2 * Tap::MOST_WAITING {
            state.told.push_back(Tapped { at, what });
        }
        drop(state);
        self.told.notify_one();
    }
}

impl End for Shared {
    fn connected(&self) {
        {
            let mut state = self.lock();
            (state.is_connected, state.origin) = (true, None);
            state.connections += 1;
        }
        self.tell(What::Connected, None);
    }

    fn disconnected(&self, why: &LinkError) {
        {
            let mut state = self.lock();
            state.is_connected = false;
            state.places = Places::new();
            state.outcome = Some(Outcome::Withdrawn);
        }
        self.concluded.notify_one();
        self.tell(What::Disconnected { why: why.clone(), ends: why.is_final() }, None);
    }

    fn received(&self, frame: &Frame, stamp: Option<Duration>) {
        self.tell(What::Frame(*frame), stamp);
    }

    fn foreign(&self, frame: Option<&WireFrame>, stamp: Option<Duration>) {
        self.tell(What::Foreign(frame.copied()), stamp);
    }

    fn malformed(&self) {
        self.tell(What::Malformed, None);
    }

    fn lost(&self, frames: u32) {
        self.tell(What::Lost(frames), None);
    }

    fn bus_off(&self) {
        self.tell(What::BusOff, None);
    }

    fn errors(&self, errors: ErrorCounters) {
        self.tell(What::Errors(errors), None);
    }

    fn hand_over(&self, link_withdraws: bool) -> Option<Handover> {
        self.lock().places.hand_over(link_withdraws)
    }

    fn bell(&self) -> &Bell {
        &self.bell
    }

    fn conclude(&self, mailbox: Mailbox, outcome: Outcome) {
        let mut state = self.lock();
        if state.places.conclude(mailbox) {
            state.outcome = Some(outcome);
        }
        drop(state);
        self.concluded.notify_one();
    }

    fn unsent(&self) {}

    fn connections(&self) -> u64 {
        self.lock().connections
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(milliseconds: u64) -> Instant {
        Instant::from_epoch(time::Duration::from_millis(milliseconds))
    }

    /// A link that is never connected.
    struct Silent;

    impl Link for Silent {
        async fn run(&mut self, _: &link::Port) -> LinkError {
            std::future::pending().await
        }
    }

    /// A link whose clock has stood still for a while: that of an emulated segment, when the machine cannot follow.
    #[tokio::test(start_paused = true)]
    async fn the_present_time_is_that_of_the_stamps() {
        let tap = Tap::start(Silent);
        tap.shared.tell(What::Malformed, Some(Duration::from_millis(500)));
        tokio::time::advance(Duration::from_millis(50)).await;
        tap.shared.tell(What::Malformed, Some(Duration::from_millis(510)));
        // What has no stamp does not run ahead of what has.
        tap.shared.tell(What::Malformed, None);
        tap.shared.tell(What::Malformed, Some(Duration::from_millis(511)));
        let instants: Vec<_> = std::iter::from_fn(|| tap.try_next()).map(|tapped| tapped.at).collect();
        assert_eq!(instants, [at(0), at(10), at(10), at(11)]);
        assert_eq!(tap.now(), at(11));
        tokio::time::advance(Duration::from_millis(3)).await;
        assert_eq!(tap.now(), at(14));
    }
}
