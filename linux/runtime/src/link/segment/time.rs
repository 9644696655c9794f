//! Sleeping more finely than tokio, whose timer has a resolution of a millisecond: a frame takes 50 to 160 µs.

use std::os::fd::OwnedFd;
use std::time::Duration;

use rustix::time::{Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec};
use tokio::io::unix::AsyncFd;
use tokio::time::Instant;

use crate::descriptor::watched;

/// Sleeps until an instant.
pub(super) enum Alarm {
    /// By a timer of the kernel.
    Fine(AsyncFd<OwnedFd>),
    /// By tokio's clock, which tests can stop.
    Coarse,
}

impl Alarm {
    pub(super) fn new(coarse: bool) -> std::io::Result<Self> {
        if coarse {
            return Ok(Self::Coarse);
        }
        let flags = TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC;
        let timer = rustix::time::timerfd_create(TimerfdClockId::Monotonic, flags)?;
        Ok(Self::Fine(watched(timer)?))
    }

    /// Returns at the instant, or for ever never.
    pub(super) async fn wait_until(&self, at: Option<Instant>) {
        let Some(at) = at else { return std::future::pending().await };
        match self {
            Self::Coarse => tokio::time::sleep_until(at).await,
            Self::Fine(timer) => {
                let span = at.saturating_duration_since(Instant::now());
                if span.is_zero() || wait(timer, span).await.is_err() {
                    tokio::time::sleep_until(at).await;
                }
            }
        }
    }
}

async fn wait(timer: &AsyncFd<OwnedFd>, span: Duration) -> std::io::Result<()> {
    let value = Timespec { tv_sec: span.as_secs().cast_signed(), tv_nsec: span.subsec_nanos().into() };
    let once = Itimerspec { it_interval: Timespec { tv_sec: 0, tv_nsec: 0 }, it_value: value };
    rustix::time::timerfd_settime(timer.get_ref(), TimerfdTimerFlags::empty(), &once)?;
    loop {
        let mut ready = timer.readable().await?;
        let mut count = [0; 8];
        if let Ok(read) = ready.try_io(|timer| Ok(rustix::io::read(timer.get_ref(), &mut count)?)) {
            return read.map(|_| ());
        }
    }
}
