//! The hub: all segments, all browsers.

use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use cosmic_monitor::Monitor;
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

use crate::browsers::{Browsers, Message};
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
        let segments = self.segments();
        let news: Vec<Message> =
            segments.iter().flat_map(|segment| segment.shared.news(state_is_due)).collect();
        self.shared.browsers().tell(&news, || self.everything());
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
        let everything = self.everything();
        self.shared.browsers().open(everything)
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
}

/// How often browsers are told.
const PULSE: Duration = Duration::from_millis(100);
/// Each of so many pulses tells the whole state.
const PULSES_PER_STATE: u64 = 10;
