//! The hub: all segments, all browsers.

use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use cosmic_monitor::Monitor;
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

use crate::browsers::{Browsers, Message};
use crate::crossings::{Crossing, Crossings};
use crate::messages::{Hello, SegmentHead};
use crate::publishing::Publishing;
use crate::secret;
use crate::segment::Segment;

/// What a page is to be.
#[derive(Default)]
pub struct Config {
    /// Its title; `COSMIC` if it is empty.
    pub title: String,
    /// Names under which browsers may ask for it, besides addresses and `localhost`.
    pub hosts: Vec<String>,
    /// How events are published, and who may; `None`: nobody.
    pub publishing: Option<Publishing>,
}

/// All segments, and all browsers that watch them. Clones are the same hub.
#[derive(Clone)]
pub struct Hub {
    pub(crate) shared: Arc<Shared>,
}

pub(crate) struct Shared {
    pub(crate) config: Config,
    instance: String,
    segments: RwLock<Vec<Segment>>,
    browsers: Mutex<Browsers>,
    crossings: Mutex<Crossings>,
    pulses: Mutex<u64>,
}

impl Hub {
    /// A page without segments.
    pub fn new(mut config: Config) -> Self {
        if config.title.is_empty() {
            "COSMIC".clone_into(&mut config.title);
        }
        Self {
            shared: Arc::new(Shared {
                config,
                instance: secret::unpredictable(),
                segments: RwLock::default(),
                browsers: Mutex::default(),
                crossings: Mutex::default(),
                pulses: Mutex::new(0),
            }),
        }
    }

    /// Another segment, shown under this name. Browsers that watch already are told when they connect anew.
    pub fn segment(&self, name: impl Into<String>, link: impl Into<String>, monitor: Monitor) -> Segment {
        let mut segments = self.shared.segments.write().unwrap_or_else(PoisonError::into_inner);
        let segment = Segment::new(segments.len(), name.into(), link.into(), monitor);
        segments.push(segment.clone());
        segment
    }

    /// An event has come to a gateway. Never waits for a browser.
    pub fn crossed(&self, crossing: Crossing) {
        self.shared.crossings().add(crossing);
    }

    /// How many browsers watch.
    pub fn browsers(&self) -> usize {
        self.shared.browsers().count()
    }

    /// Tells all browsers what is new. [`Hub::run`] calls this; a test may do so instead.
    pub fn pulse(&self) {
        let state_is_due = {
            let mut pulses = self.shared.pulses.lock().unwrap_or_else(PoisonError::into_inner);
            *pulses += 1;
            pulses.is_multiple_of(PULSES_PER_STATE)
        };
        // Nobody comes between what is new and its being told: he would be told neither by this nor by the next.
        let mut browsers = self.shared.browsers();
        let segments = self.segments();
        let mut news: Vec<Message> =
            segments.iter().flat_map(|segment| segment.shared.news(state_is_due)).collect();
        if state_is_due {
            self.shared.crossings().reckon(Instant::now());
            news.extend(self.shared.what_crosses());
        }
        browsers.tell(&news, || self.everything());
    }

    /// Tells all browsers what is new, ten times a second, for ever.
    pub async fn run(&self) {
        let mut tick = tokio::time::interval(PULSE);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tick.tick().await;
            self.pulse();
        }
    }

    /// Another browser watches; `None` if there are too many.
    pub(crate) fn watch(&self) -> Option<mpsc::Receiver<Message>> {
        self.shared.browsers().open(|| self.everything())
    }

    /// What a browser needs that knows nothing.
    pub(crate) fn everything(&self) -> Vec<Message> {
        let segments = self.segments();
        let heads = segments
            .iter()
            .map(|segment| SegmentHead { name: &segment.shared.name, link: &segment.shared.link });
        let hello = Hello {
            instance: &self.shared.instance,
            version: env!("CARGO_PKG_VERSION"),
            title: &self.shared.config.title,
            may_publish: self.shared.config.publishing.is_some(),
            segments: heads.collect(),
        };
        let mut messages = vec![Message::new("hello", &hello, 0)];
        messages.extend(segments.iter().flat_map(|segment| segment.shared.everything()));
        messages.extend(self.shared.what_crosses());
        messages
    }

    fn segments(&self) -> Vec<Segment> {
        self.shared.segments.read().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Shared {
    fn browsers(&self) -> std::sync::MutexGuard<'_, Browsers> {
        self.browsers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn crossings(&self) -> std::sync::MutexGuard<'_, Crossings> {
        self.crossings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn what_crosses(&self) -> Option<Message> {
        self.crossings().told().map(|told| Message::new("crossings", &told, 0))
    }
}

/// How often browsers are told.
const PULSE: Duration = Duration::from_millis(100);
/// Each of so many pulses tells the whole state.
const PULSES_PER_STATE: u64 = 10;

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::sync::atomic::{AtomicBool, Ordering};

    use cosmic_core::can::BitRate;
    use cosmic_core::time;
    use cosmic_linux::{Tapped, What};

    use super::*;

    /// The numbers of the notices in messages.
    fn noticed(messages: &mut mpsc::Receiver<Message>) -> BTreeSet<u64> {
        let told =
            std::iter::from_fn(|| messages.try_recv().ok()).filter(|message| message.kind == "notices");
        let values = told.map(|message| serde_json::from_str::<serde_json::Value>(&message.text).unwrap());
        let numbers = |value: serde_json::Value| {
            let notices = value["notices"].as_array().unwrap().clone();
            notices.into_iter().map(|notice| notice["sequence"].as_u64().unwrap())
        };
        values.flat_map(numbers).collect()
    }

    #[test]
    fn who_comes_while_things_happen_misses_none_of_them() {
        let hub = Hub::new(Config::default());
        let segment = hub.segment("bench", "log:none", Monitor::new(BitRate::MAX, time::Instant::EPOCH));
        let ends = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let mut seconds = 0;
                while !ends.load(Ordering::Relaxed) {
                    // So far apart that none is told as another one once more.
                    seconds += 2;
                    let at = time::Instant::from_epoch(time::Duration::from_secs(seconds));
                    segment.on_tapped(&Tapped { at, what: What::BusOff });
                    hub.pulse();
                    // A lock that is taken again at once is nobody else's.
                    std::thread::sleep(std::time::Duration::from_micros(50));
                }
            });
            for _ in 0..100 {
                let mut browser = hub.watch().unwrap();
                let mut numbers = noticed(&mut browser);
                let enough = numbers.last().copied().unwrap_or(0) + 2;
                while !numbers.contains(&enough) {
                    std::thread::yield_now();
                    numbers.extend(noticed(&mut browser));
                }
                let (first, last) = (numbers.first().copied().unwrap(), numbers.last().copied().unwrap());
                assert_eq!(numbers, (first..=last).collect());
            }
            ends.store(true, Ordering::Relaxed);
        });
    }
}
