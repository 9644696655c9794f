//! The other participants: who is there, and what their clocks say.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration as Span;

use cosmic_core::time::Duration;
use tokio::sync::Notify;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Locality, Sample, SampleKind};

use crate::clock::{Exchange, PeerClock, Reading};
use crate::counters::Outcome;
use crate::encoding::{Envelope, Sender};
use crate::keys::{Keys, Name, SenderKey};

/// What is known of the others.
pub(crate) struct Peers {
    known: Mutex<HashMap<Sender, Peer>>,
    /// There is somebody whose clock is not known.
    ask: Notify,
}

struct Peer {
    /// For which segment it spoke first: there its clock is asked for.
    segment: Name,
    clock: Option<PeerClock>,
    /// Tokens that it holds.
    tokens: u32,
    /// When it was last heard of.
    heard_at: Reading,
    asked_at: Option<Reading>,
}

impl Peer {
    fn new(segment: Name, now: Reading) -> Self {
        Self { segment, clock: None, tokens: 0, heard_at: now, asked_at: None }
    }
}

impl Peers {
    pub(super) fn new() -> Self {
        Self { known: Mutex::new(HashMap::new()), ask: Notify::new() }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Sender, Peer>> {
        // Nothing in here panics; what is there is looked at as it is.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Not less than the age of an event that has come, or why nobody knows it. O(1).
    pub(crate) fn age(&self, segment: &Name, envelope: &Envelope, now: Reading) -> Result<Duration, Outcome> {
        let mut known = self.lock();
        if !known.contains_key(&envelope.sender) && known.len() >= MOST_SENDERS {
            return Err(Outcome::TooManySenders);
        }
        let peer = known.entry(envelope.sender).or_insert_with(|| Peer::new(segment.clone(), now));
        peer.heard_at = now;
        let Some(clock) = &peer.clock else {
            drop(known);
            self.ask.notify_one();
            return Err(Outcome::AgeUnknown);
        };
        clock.age_at_most(envelope.sent_at, now).ok_or(Outcome::FromTheFuture)
    }

    /// Others that are there, and speak for this segment.
    pub(crate) fn speaking_for(&self, segment: &Name) -> usize {
        self.lock().values().filter(|peer| peer.tokens > 0 && peer.segment == *segment).count()
    }

    /// How many others are there, and how many clocks are known.
    pub(crate) fn count(&self) -> (usize, usize) {
        let known = self.lock();
        (
            known.values().filter(|peer| peer.tokens > 0).count(),
            known.values().filter(|peer| peer.clock.is_some()).count(),
        )
    }

    fn on_token(&self, key: SenderKey, alive: bool, now: Reading) {
        let mut known = self.lock();
        if alive {
            if known.len() < MOST_SENDERS || known.contains_key(&key.sender) {
                let peer = known.entry(key.sender).or_insert_with(|| Peer::new(key.segment, now));
                peer.tokens = peer.tokens.saturating_add(1);
                peer.heard_at = now;
                self.ask.notify_one();
            }
        } else if let Some(peer) = known.get_mut(&key.sender) {
            peer.tokens = peer.tokens.saturating_sub(1);
            peer.heard_at = now;
        }
    }

    fn note(&self, sender: Sender, exchange: Exchange) {
        if let Some(peer) = self.lock().get_mut(&sender) {
            match &mut peer.clock {
                Some(clock) => clock.note(exchange),
                None => peer.clock = Some(PeerClock::new(exchange)),
            }
        }
    }

    /// Who is to be asked now. Who was not heard of for long is forgotten.
    fn due(&self, now: Reading) -> Vec<SenderKey> {
        let mut known = self.lock();
        known.retain(|_, peer| peer.tokens > 0 || now.since(peer.heard_at) < MEMORY);
        let mut due = Vec::new();
        for (sender, peer) in known.iter_mut() {
            let pause = if peer.clock.is_some() { BETWEEN_QUESTIONS } else { BETWEEN_FIRST_QUESTIONS };
            if peer.asked_at.is_none_or(|asked| now.since(asked) >= pause) {
                peer.asked_at = Some(now);
                due.push(SenderKey { segment: peer.segment.clone(), sender: *sender });
            }
        }
        due
    }
}

/// Watches who is there.
pub(super) async fn watch(
    session: &Session,
    keys: &Keys,
    me: Sender,
    peers: Arc<Peers>,
) -> zenoh::Result<Subscriber<()>> {
    let reader = keys.clone();
    let on_sample = move |sample: Sample| {
        let key = reader.read_live(sample.key_expr().as_str());
        if let Some(key) = key.filter(|key| key.sender != me) {
            peers.on_token(key, sample.kind() == SampleKind::Put, Reading::now());
        }
    };
    session.liveliness().declare_subscriber(keys.all_live()).history(true).callback(on_sample).await
}

/// Keeps the clocks of the others known. The watcher lives as long.
pub(super) async fn keep(session: Session, keys: Keys, peers: Arc<Peers>, watcher: Subscriber<()>) {
    let _watcher = watcher;
    loop {
        for key in peers.due(Reading::now()) {
            tokio::spawn(ask(session.clone(), keys.clock(&key), key.sender, Arc::clone(&peers)));
        }
        let pause = tokio::time::sleep(Span::from_millis(100));
        tokio::select! {
            () = pause => {}
            () = peers.ask.notified() => {}
        }
    }
}

async fn ask(session: Session, key: String, of: Sender, peers: Arc<Peers>) {
    let asked_at = Reading::now();
    let query = session.get(key).allowed_destination(Locality::Remote).timeout(PATIENCE);
    let Ok(replies) = query.await else { return };
    while let Ok(reply) = replies.recv_async().await {
        let received_at = Reading::now();
        let Ok(sample) = reply.result() else { continue };
        if let Ok(bytes) = <[u8; 8]>::try_from(&*sample.payload().to_bytes()) {
            let answered_at = Reading(u64::from_be_bytes(bytes));
            peers.note(of, Exchange { asked_at, answered_at, received_at });
            return;
        }
    }
}

/// Between two questions to one whose clock is known.
const BETWEEN_QUESTIONS: Duration = Duration::from_secs(1);
/// To one whose clock is not known.
const BETWEEN_FIRST_QUESTIONS: Duration = Duration::from_millis(200);
/// An answer that takes longer is of no use.
const PATIENCE: Span = Span::from_secs(5);
/// So long one without a token is known that was not heard of.
const MEMORY: Duration = Duration::from_secs(60);
/// Others at once, at most.
const MOST_SENDERS: usize = 4096;
