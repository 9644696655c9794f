//! Where events come in from IP: each once, and with its age.

use std::sync::Arc;

use cosmic_core::Subject;
use cosmic_core::time::Duration;
use zenoh::sample::{Sample, SampleKind};

use super::peers::Peers;
use crate::clock::Reading;
use crate::counters::{Counters, Outcome};
use crate::encoding::Envelope;
use crate::keys::{EventKey, Keys, Name};
use crate::sequence::Windows;

/// Lets events in that have not come before, and of which it is known how old they are.
pub(crate) struct Door {
    keys: Keys,
    peers: Arc<Peers>,
    /// What has come.
    windows: Windows,
}

/// An event that is let in.
pub(crate) struct Admitted {
    /// Where it was published.
    pub(crate) segment: Name,
    pub(crate) envelope: Envelope,
    /// It is not older than this.
    pub(crate) age: Duration,
}

/// An event that was heard, as far as it is known.
pub(crate) struct Overheard {
    pub(crate) key: EventKey,
    pub(crate) envelope: Envelope,
    pub(crate) missing: u64,
    pub(crate) age: Option<Duration>,
}

impl Door {
    pub(super) fn new(keys: Keys, peers: Arc<Peers>) -> Self {
        Self { keys, peers, windows: Windows::default() }
    }

    /// Looks at what has come for a subject. `is_own`: whether a segment is ours, so that we know its events. What is
    /// missing before it is counted. O(1).
    pub(crate) fn admit(
        &self,
        sample: &Sample,
        subject: Subject,
        is_own: impl FnOnce(&Name) -> bool,
        counters: &Counters,
    ) -> Result<Admitted, Outcome> {
        let now = Reading::now();
        let key = self.key(sample).filter(|key| key.subject == subject).ok_or(Outcome::Malformed)?;
        if is_own(&key.segment) {
            return Err(Outcome::ComeBack);
        }
        let envelope = Envelope::decode(&sample.payload().to_bytes()).map_err(|_| Outcome::Malformed)?;
        let missing = self.windows.note(&key, &envelope, now)?;
        counters.count_many(Outcome::Missing, missing);
        let age = self.peers.age(&key.segment, &envelope, now)?;
        Ok(Admitted { segment: key.segment, envelope, age })
    }

    /// As [`admit`](Self::admit), for whoever only listens: of any subject, and with how many are missing before it. Its age is
    /// not known before the clock of its sender is.
    pub(crate) fn overhear(&self, sample: &Sample) -> Result<Overheard, Outcome> {
        let now = Reading::now();
        let key = self.key(sample).ok_or(Outcome::Malformed)?;
        let envelope = Envelope::decode(&sample.payload().to_bytes()).map_err(|_| Outcome::Malformed)?;
        let missing = self.windows.note(&key, &envelope, now)?;
        let age = self.peers.age(&key.segment, &envelope, now).ok();
        Ok(Overheard { key, envelope, missing, age })
    }

    fn key(&self, sample: &Sample) -> Option<EventKey> {
        let key = self.keys.read_event(sample.key_expr().as_str())?;
        (sample.kind() == SampleKind::Put).then_some(key)
    }
}
