//! Where frames come from: a link, or a log.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use cosmic_core::can::BitRate;
use cosmic_core::time::{self, Instant};
use cosmic_linux::link::{AnyLink, LinkAddress};
use cosmic_linux::{Tap, Tapped, What};
use cosmic_log::{Entry, LogTime, Reader};

use crate::failure::Failure;

/// The link that was chosen, to be taken part in.
///
/// # Errors
/// It is a log, or cannot have this bit rate.
pub(crate) fn link(address: &LinkAddress, bit_rate: BitRate) -> Result<AnyLink, Failure> {
    if let LinkAddress::Log(_) = address {
        let what = "a log can only be listened to: give a link to a segment, such as --link sim:PATH";
        return Err(Failure::input(what));
    }
    address.link(bit_rate).map_err(Failure::input)
}

/// Where frames come from.
pub(crate) enum Source {
    Live {
        tap: Tap,
        /// The clock of the wall when the tap's began.
        began: Duration,
        until: Option<tokio::time::Instant>,
    },
    Log {
        reader: Reader,
        time: LogTime,
        /// Entries come at the distances that they had.
        pace: Option<tokio::time::Instant>,
        /// An entry whose time has not come.
        waiting: Option<Tapped>,
        has_ended: bool,
    },
}

impl Source {
    /// Opens a link or a log.
    pub(crate) fn open(choice: &LinkAddress, bit_rate: BitRate) -> Result<Self, Failure> {
        if let LinkAddress::Log(file) = choice {
            let (reader, time) = (Reader::open(file)?, LogTime::new());
            return Ok(Self::Log { reader, time, pace: None, waiting: None, has_ended: false });
        }
        let tap = Tap::start(link(choice, bit_rate)?);
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(Self::Live { tap, began: now, until: None })
    }

    /// Ends a live source after this span, from when it connects; a log is read to its end.
    pub(crate) fn for_span(mut self, span: Option<time::Duration>) -> Self {
        if let Self::Live { until, .. } = &mut self {
            *until = end_of(span);
        }
        self
    }

    /// Lets a log pass as it did.
    pub(crate) fn in_its_time(mut self) -> Self {
        if let Self::Log { pace, .. } = &mut self {
            *pace = Some(tokio::time::Instant::now());
        }
        self
    }

    /// Waits until a live source is connected.
    ///
    /// # Errors
    /// It cannot be: why, and what to do.
    pub(crate) async fn connected(&mut self, patience: Duration) -> Result<(), Failure> {
        let Self::Live { tap, until, .. } = self else { return Ok(()) };
        let begun = tokio::time::Instant::now();
        let mut reason = "the link does not answer".to_owned();
        loop {
            let refused = |reason: &str| Err(Failure::link(format!("{reason}; look at the option --link")));
            match tokio::time::timeout_at(begun + patience, tap.next()).await.map(|tapped| tapped.what) {
                Ok(What::Connected) => break,
                Ok(What::Disconnected { why, ends: true }) => return refused(&why.to_string()),
                // A server may be about to start.
                Ok(What::Disconnected { why, .. }) => reason = why.to_string(),
                Ok(_) => {}
                Err(_) => return refused(&reason),
            }
        }
        *until = until.map(|until| until + begun.elapsed());
        Ok(())
    }

    /// The next thing that happened; `None` at the end of the log or of the span, or when the user interrupts.
    pub(crate) async fn next(&mut self) -> Option<Result<Tapped, Failure>> {
        match self {
            Self::Live { tap, until, .. } => {
                if let Some(tapped) = tap.try_next() {
                    // Not even a full bus keeps a span from ending.
                    return until
                        .is_none_or(|until| tokio::time::Instant::now() < until)
                        .then_some(Ok(tapped));
                }
                tokio::select! {
                    biased;
                    _ = tokio::signal::ctrl_c() => None,
                    () = sleep_until(*until) => None,
                    tapped = tap.next() => Some(Ok(tapped)),
                }
            }
            Self::Log { .. } => self.next_of_log().await,
        }
    }

    async fn next_of_log(&mut self) -> Option<Result<Tapped, Failure>> {
        let Self::Log { reader, time, pace, waiting, has_ended } = self else { return None };
        if waiting.is_none() {
            let Some(entry) = reader.next() else {
                *has_ended = true;
                return None;
            };
            match entry {
                Ok(Entry { stamp, what }) => *waiting = Some(Tapped { at: time.at(stamp), what }),
                Err(error) => return Some(Err(error.into())),
            }
        }
        if let (Some(start), Some(tapped)) = (*pace, waiting.as_ref()) {
            // When this wait is cancelled, the entry still waits.
            tokio::time::sleep_until(start + std_span(tapped.at.since_epoch())).await;
        }
        waiting.take().map(Ok)
    }

    /// The clock of the wall at an instant of this source.
    pub(crate) fn wall(&self, at: Instant) -> Duration {
        let began = match self {
            Self::Live { began, .. } => *began,
            Self::Log { time, .. } => time.began().unwrap_or_default(),
        };
        began + std_span(at.since_epoch())
    }

    /// The present instant of this source.
    pub(crate) fn now(&self) -> Instant {
        match self {
            Self::Live { tap, .. } => tap.now(),
            // Behind the end of a log no time passes.
            Self::Log { time, pace: None, .. } | Self::Log { time, has_ended: true, .. } => time.latest(),
            Self::Log { time, pace: Some(start), .. } => {
                let ticks = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX / 2);
                Instant::from_epoch(time::Duration::from_ticks(ticks)).max(time.latest())
            }
        }
    }
}

/// A span as the host counts it.
pub(crate) fn std_span(span: time::Duration) -> Duration {
    Duration::from_nanos(span.as_ticks())
}

/// When a span that begins now is over; `None`: never.
pub(crate) fn end_of(span: Option<time::Duration>) -> Option<tokio::time::Instant> {
    tokio::time::Instant::now().checked_add(std_span(span?))
}

/// Sleeps until then, or for ever.
pub(crate) async fn sleep_until(at: Option<tokio::time::Instant>) {
    match at {
        Some(at) => tokio::time::sleep_until(at).await,
        None => std::future::pending().await,
    }
}
