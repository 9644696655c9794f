//! How far a run is, on standard error, when it takes longer than a few seconds.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use cosmic_bus::VirtualInstant;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Tells how far a run is: as a bar on a terminal, else as a line now and then.
#[derive(Debug)]
pub struct Progress {
    started: Instant,
    end: VirtualInstant,
    bar: Option<ProgressBar>,
    on_terminal: bool,
    told_at: Duration,
}

impl Progress {
    /// Of a run until `end` that starts now.
    pub fn new(end: VirtualInstant) -> Self {
        let on_terminal = std::io::stderr().is_terminal();
        Self { started: Instant::now(), end, bar: None, on_terminal, told_at: QUIET }
    }

    /// The run has come this far.
    pub fn reached(&mut self, now: VirtualInstant) {
        let spent = self.started.elapsed();
        if spent < QUIET {
            return;
        }
        if self.on_terminal {
            let (end, text) = (self.end.as_ticks(), self.describe(now));
            let bar = self.bar.get_or_insert_with(|| bar(end));
            bar.set_position(now.as_ticks());
            bar.set_message(text);
        } else if spent >= self.told_at + INTERVAL {
            self.told_at = spent;
            eprintln!("demo: {}", self.describe(now));
        }
    }

    /// The run is over. Says how long it took.
    pub fn finish(self) -> String {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        self.describe(self.end)
    }

    fn describe(&self, now: VirtualInstant) -> String {
        let (done, whole) = (seconds(now), seconds(self.end));
        let speed = done / self.started.elapsed().as_secs_f64().max(1e-6);
        format!("{done:.1} of {whole:.1} virtual seconds, {speed:.2} a second")
    }
}

fn bar(end: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(end), ProgressDrawTarget::stderr());
    // A template that is none would be a mistake of this line; then the usual one will do.
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {msg}, {eta} left") {
        bar.set_style(style);
    }
    bar
}

fn seconds(at: VirtualInstant) -> f64 {
    at.as_ticks() as f64 / 1e9
}

/// Nobody wants to read anything about a run that is shorter.
const QUIET: Duration = Duration::from_secs(2);
/// Between two lines.
const INTERVAL: Duration = Duration::from_secs(5);
