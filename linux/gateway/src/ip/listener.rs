//! Who only listens on IP: hears the events of a network, and speaks for nobody.
//!
//! To the gateways it is a subscriber like any other: what it listens to is forwarded while it does.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use cosmic_core::Subject;
use cosmic_core::protocol::Class;
use cosmic_core::time::{Duration, Instant};
use tokio::sync::mpsc;
use zenoh::sample::{Locality, Sample};

use super::{Origin, now};
use crate::clock::Reading;
use crate::config::Ip;
use crate::counters::Outcome;
use crate::keys::Name;
use crate::network::{Door, Network, NetworkError, Overheard, failed};

/// An event that was heard on IP.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Heard {
    /// Its subject.
    pub subject: Subject,
    /// Where it was published.
    pub origin: Origin,
    /// Its class there.
    pub class: Class,
    /// Its number among the events of its sender, segment and subject.
    pub number: u64,
    /// So many before it did not come.
    pub missing: u64,
    /// What was published.
    pub content: Vec<u8>,
    /// When it arrived.
    pub received_at: Instant,
    /// Not less than the time since it was sent; `None`: the clock of its sender is not known yet, and what follows neither.
    pub age: Option<Duration>,
    /// Its deadline, if it has one.
    pub deadline: Option<Instant>,
    /// When it is of no use any more, if ever.
    pub expires_at: Option<Instant>,
}

/// One that speaks for a segment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Participant {
    /// The segment, or the name of a node on IP.
    pub segment: Name,
    /// How much more than the age of its events may be told; `None`: its clock is not known yet.
    pub uncertainty: Option<Duration>,
}

/// Hears the events of a network.
pub struct Listener {
    network: Network,
    shared: Arc<Shared>,
    heard: mpsc::Receiver<Heard>,
    _subscribers: Vec<zenoh::pubsub::Subscriber<()>>,
}

struct Shared {
    door: Door,
    queue: mpsc::Sender<Heard>,
    lost: AtomicU64,
}

impl Listener {
    /// Listens to these subjects, or to all, inside a runtime of tokio with several threads.
    ///
    /// # Errors
    /// [`NetworkError`]
    pub async fn start(ip: &Ip, network: &Name, subjects: Option<&[Subject]>) -> Result<Self, NetworkError> {
        let network = Network::join(ip, network).await?;
        let (queue, heard) = mpsc::channel(MOST_WAITING);
        let shared = Arc::new(Shared { door: network.door(), queue, lost: AtomicU64::new(0) });
        let mut subscribers = Vec::new();
        let keys = match subjects {
            Some(subjects) => subjects.iter().map(|subject| network.keys.events(*subject)).collect(),
            None => vec![network.keys.all_events()],
        };
        for key in keys {
            let events = Arc::clone(&shared);
            let subscriber = network.session.declare_subscriber(key).allowed_origin(Locality::Remote);
            let subscriber = subscriber.callback(move |sample| events.on_event(&sample)).await;
            subscribers.push(subscriber.map_err(|error| failed(&error))?);
        }
        Ok(Self { network, shared, heard, _subscribers: subscribers })
    }

    /// Waits until it is connected to somebody.
    pub async fn connected(&self) {
        self.network.connected().await;
    }

    /// Waits for the next event. Cancelling the wait loses none. Up to [`Listener::MOST_WAITING`] wait to be fetched; what
    /// comes beyond that is [lost](Self::lost).
    pub async fn next(&mut self) -> Heard {
        match self.heard.recv().await {
            Some(heard) => heard,
            // This listener holds a sender itself.
            None => std::future::pending().await,
        }
    }

    /// Gives up the events that wait.
    pub fn forget(&mut self) {
        while self.heard.try_recv().is_ok() {}
    }

    /// How many events were lost because nobody fetched them.
    pub fn lost(&self) -> u64 {
        self.shared.lost.load(Ordering::Relaxed)
    }

    /// Who speaks for segments, by the name of these.
    pub fn participants(&self) -> Vec<Participant> {
        let speakers = self.network.peers.speakers(Reading::now()).into_iter();
        let mut all: Vec<_> =
            speakers.map(|(segment, uncertainty)| Participant { segment, uncertainty }).collect();
        all.sort_by(|one, other| one.segment.cmp(&other.segment));
        all
    }

    /// The present time, as deadlines are stated in.
    pub fn now(&self) -> Instant {
        now()
    }

    /// Ends in order.
    pub async fn stop(self) {
        self.network.leave().await;
    }

    /// So many events wait to be fetched at most.
    pub const MOST_WAITING: usize = MOST_WAITING;
}

impl Shared {
    fn on_event(&self, sample: &Sample) {
        // Bytes that are no event, and events that have come already, are nothing that crosses.
        let Ok(heard) = self.hear(sample) else { return };
        if self.queue.try_send(heard).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn hear(&self, sample: &Sample) -> Result<Heard, Outcome> {
        let received_at = now();
        let Overheard { key, envelope, missing, age } = self.door.overhear(sample)?;
        let sent_at = age.map(|age| received_at.saturating_sub(age));
        let after = |span: Option<Duration>| Some(sent_at? + span?);
        Ok(Heard {
            deadline: after(envelope.to_deadline),
            expires_at: after(envelope.to_expiry),
            subject: key.subject,
            origin: Origin { segment: key.segment, node: envelope.node },
            class: envelope.class,
            number: envelope.sequence,
            missing,
            content: envelope.content,
            received_at,
            age,
        })
    }
}

const MOST_WAITING: usize = 65_536;
