//! A log as a listener hears it: each entry at its instant, with a monitor that has heard all up to it.

use std::fs;
use std::path::Path;
use std::time::Duration;

use cosmic_core::time::{self, Instant};
use cosmic_linux::{Tapped, What};
use cosmic_monitor::Monitor;

use crate::{Entry, LogError, Reader};

/// Time in a log: that since its first entry. It does not go back, whatever the stamps say.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct LogTime {
    began: Option<Duration>,
    latest: Instant,
}

impl LogTime {
    /// Of a log of which nothing has been read.
    pub const fn new() -> Self {
        Self { began: None, latest: Instant::EPOCH }
    }

    /// The instant of the next entry, which has this stamp.
    pub fn at(&mut self, stamp: Duration) -> Instant {
        let since = stamp.saturating_sub(*self.began.get_or_insert(stamp));
        let ticks = u64::try_from(since.as_nanos()).unwrap_or(u64::MAX / 2);
        self.latest = self.latest.max(Instant::from_epoch(time::Duration::from_ticks(ticks)));
        self.latest
    }

    /// The stamp of the first entry.
    pub const fn began(&self) -> Option<Duration> {
        self.began
    }

    /// The instant of the last entry that was read.
    pub const fn latest(&self) -> Instant {
        self.latest
    }
}

impl Default for LogTime {
    fn default() -> Self {
        Self::new()
    }
}

/// A log that a monitor hears.
pub struct Heard {
    reader: Reader,
    time: LogTime,
    monitor: Monitor,
}

impl Heard {
    /// Opens a log for a monitor that has heard nothing of it; `-` is standard input. [Learns](learn_bindings) first.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub fn open(path: &Path, mut monitor: Monitor) -> Result<Self, LogError> {
        learn_bindings(&mut monitor, path);
        Ok(Self { reader: Reader::open(path)?, time: LogTime::new(), monitor })
    }

    /// What has heard the log up to the last entry.
    pub const fn monitor(&self) -> &Monitor {
        &self.monitor
    }
}

impl Iterator for Heard {
    /// With the stamp that the log has.
    type Item = Result<(Duration, Tapped), LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        let heard = self.reader.next()?.map(|Entry { stamp, what }| {
            let tapped = Tapped { at: self.time.at(stamp), what };
            feed(&mut self.monitor, &tapped);
            (stamp, tapped)
        });
        Some(heard)
    }
}

/// Tells a monitor which etags a log binds, for an event may come before the binding that says what it is. Takes a
/// reading of the whole log: what passes once only, a pipe, is not read for it.
pub fn learn_bindings(monitor: &mut Monitor, path: &Path) {
    // `-` is the standard input, also where a file has that name.
    if path.as_os_str() == "-" || !fs::metadata(path).is_ok_and(|data| data.is_file()) {
        return;
    }
    // What is wrong with the log, whoever reads it next is told.
    let Ok(reader) = Reader::open(path) else { return };
    let (mut first, mut time) = (monitor.clone(), LogTime::new());
    for Entry { stamp, what } in reader.map_while(Result::ok) {
        feed(&mut first, &Tapped { at: time.at(stamp), what });
    }
    first.bindings().for_each(|(subject, etag)| monitor.learn(subject, etag));
}

/// Hands what happened to a monitor.
pub fn feed(monitor: &mut Monitor, tapped: &Tapped) {
    let at = tapped.at;
    match &tapped.what {
        What::Frame(frame) => monitor.on_frame(frame, at),
        What::Foreign(frame) => monitor.on_foreign(frame.as_ref(), at),
        What::Lost(frames) => monitor.on_lost(*frames, at),
        What::Errors(errors) => monitor.on_errors(*errors, at),
        What::BusOff => monitor.on_bus_off(at),
        What::Connected | What::Disconnected { .. } | What::Malformed => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_begins_with_a_log_and_does_not_go_back() {
        let mut time = LogTime::new();
        let at = [100, 103, 101, 1 << 40].map(|seconds| time.at(Duration::from_secs(seconds)));
        let since = at.map(|at| at.since_epoch().as_ticks() / 1_000_000_000);
        assert_eq!(since[..3], [0, 3, 3]);
        assert_eq!((time.began(), time.latest()), (Some(Duration::from_secs(100)), at[3]));
    }
}
