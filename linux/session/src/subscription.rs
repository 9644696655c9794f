//! Events that wait for a program, with a descriptor that says so.

use std::future::Future as _;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, Wake, Waker};
use std::time::{Duration, Instant};

use cosmic_core::event_layer::{Delivered, Depth, Policy};
use cosmic_linux::Node;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::io::Errno;

use crate::events::Events;
use crate::failure::Closed;

/// How events wait.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Queue {
    /// In the order in which they came. When this many wait, or one more that has been made ready, a further one is
    /// dropped, counted, and an exception.
    InOrder(Depth),
    /// Only the latest; an earlier one is replaced and counted.
    Latest,
}

impl Queue {
    pub(crate) const fn policy(self) -> Policy {
        match self {
            Self::InOrder(depth) => Policy::Fifo(depth),
            Self::Latest => Policy::Latest,
        }
    }
}

/// A subscription to a channel. Any thread may call; an event comes to one of them. It ends when it is dropped.
pub struct Subscription {
    source: Events,
    queue: Queue,
    signal: Arc<Signal>,
    waker: Waker,
    /// The event that the descriptor tells of.
    first: Mutex<Option<Delivered<Vec<u8>>>>,
    closed: AtomicBool,
}

impl Subscription {
    pub(crate) fn new(source: Events, queue: Queue) -> std::io::Result<Self> {
        let signal = Arc::new(Signal(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?));
        let waker = Waker::from(Arc::clone(&signal));
        let (first, closed) = (Mutex::new(None), AtomicBool::new(false));
        let subscription = Self { source, queue, signal, waker, first, closed };
        subscription.look_for_first(&mut subscription.lock());
        Ok(subscription)
    }

    /// The next event, if one waits.
    ///
    /// # Errors
    /// The subscription has been closed.
    pub fn try_next(&self) -> Result<Option<Delivered<Vec<u8>>>, Closed> {
        if self.closed.load(Ordering::Acquire) {
            return Err(Closed);
        }
        let mut first = self.lock();
        self.signal.clear();
        let mut event = first.take();
        if event.is_none() || self.queue == Queue::Latest {
            event = self.poll().or(event);
        }
        self.look_for_first(&mut first);
        Ok(event)
    }

    /// Waits for the next event, for this span at most; for ever if there is none. `None` when the span is over.
    ///
    /// # Errors
    /// The subscription has been closed, perhaps while this waited.
    pub fn next(&self, patience: Option<Duration>) -> Result<Option<Delivered<Vec<u8>>>, Closed> {
        let until = patience.and_then(|patience| Instant::now().checked_add(patience));
        loop {
            if let Some(event) = self.try_next()? {
                return Ok(Some(event));
            }
            let left = until.map(|until| until.saturating_duration_since(Instant::now()));
            if left == Some(Duration::ZERO) {
                return Ok(None);
            }
            self.signal.wait(left);
        }
    }

    /// Readable while an event waits, and when the subscription has been closed. Only to be waited for: to read from
    /// it loses wake-ups.
    pub fn descriptor(&self) -> BorrowedFd<'_> {
        self.signal.0.as_fd()
    }

    /// Ends it for all who hold it. Whoever waits is told.
    pub fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.signal.wake_by_ref();
    }

    /// When an event of this subscription arrived, in nanoseconds of `CLOCK_MONOTONIC`, which other languages read, too.
    pub fn received_ns(&self, event: &Delivered<Vec<u8>>) -> u64 {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        let part = |part| u64::try_from(part).unwrap_or(0);
        let now_ns = part(now.tv_sec).saturating_mul(1_000_000_000).saturating_add(part(now.tv_nsec));
        now_ns.saturating_sub(self.node().now().saturating_since(event.received_at).as_ticks())
    }

    /// The node.
    pub fn node(&self) -> &Node {
        self.source.node()
    }

    /// Finds the event that the descriptor is to tell of; if there is none, the next one sets it.
    fn look_for_first(&self, first: &mut Option<Delivered<Vec<u8>>>) {
        if first.is_none() {
            *first = self.poll();
        }
        if first.is_some() || self.closed.load(Ordering::Acquire) {
            self.signal.wake_by_ref();
        }
    }

    fn poll(&self) -> Option<Delivered<Vec<u8>>> {
        let mut context = Context::from_waker(&self.waker);
        match pin!(self.source.next()).poll(&mut context) {
            Poll::Ready(event) => Some(event),
            Poll::Pending => None,
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Delivered<Vec<u8>>>> {
        self.first.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A descriptor that is readable from `wake` until `clear`.
struct Signal(OwnedFd);

impl Signal {
    fn clear(&self) {
        // Fails if it is not set, which is as good.
        let _ = rustix::io::read(&self.0, &mut [0; 8]);
    }

    /// Returns when it is set, the span is over, or a signal came.
    fn wait(&self, span: Option<Duration>) {
        // A span that the kernel cannot count is as good as none.
        let span = span.and_then(|span| Timespec::try_from(span).ok());
        let result = poll(&mut [PollFd::new(&self.0, PollFlags::IN)], span.as_ref());
        if !matches!(result, Ok(_) | Err(Errno::INTR)) {
            // Nothing else can be wrong with a descriptor of one's own; but if it is, others get their turn.
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

impl Wake for Signal {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        // Fails only if it has been set very often, so it is set.
        let _ = rustix::io::write(&self.0, &1_u64.to_ne_bytes());
    }
}
