//! A participant of the network on IP: a session of zenoh, and what is known of the other participants.

mod door;
mod peers;
mod settings;

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::task::JoinHandle;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::Queryable;
use zenoh::sample::Locality;

pub(crate) use door::{Admitted, Door, Overheard};
use peers::Peers;

use crate::clock::Reading;
use crate::config::Ip;
use crate::encoding::Sender;
use crate::keys::{Keys, Name, SenderKey};

/// The network cannot be taken part in.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NetworkError(String);

impl fmt::Display for NetworkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NetworkError {}

impl NetworkError {
    pub(crate) fn new(what: impl Into<String>) -> Self {
        Self(what.into())
    }
}

/// A session, and who we are in it.
pub(crate) struct Network {
    pub(crate) session: Session,
    pub(crate) keys: Keys,
    pub(crate) sender: Sender,
    pub(crate) peers: Arc<Peers>,
    /// How often our clock was asked for.
    answered: Arc<AtomicU64>,
    /// Keeps the clocks of the others known.
    keeper: JoinHandle<()>,
}

impl Drop for Network {
    fn drop(&mut self) {
        self.keeper.abort();
    }
}

/// While it is held, others see that we speak for a segment, and can ask our clock.
pub(crate) struct Voice {
    _token: LivelinessToken,
    _clock: Queryable<()>,
}

impl Network {
    /// Takes part in a network.
    pub(crate) async fn join(ip: &Ip, name: &Name) -> Result<Self, NetworkError> {
        let config = settings::of(ip, name)?;
        let session = zenoh::open(config).await.map_err(|error| settings::explain(ip, &error.to_string()))?;
        let (keys, sender) = (Keys::new(name), Sender::draw());
        let peers = Arc::new(Peers::new());
        let watch = peers::watch(&session, &keys, sender, Arc::clone(&peers)).await;
        let watcher = watch.map_err(|error| failed(&error))?;
        let keep = peers::keep(session.clone(), keys.clone(), Arc::clone(&peers), watcher);
        let keeper = tokio::spawn(keep);
        Ok(Self { session, keys, sender, peers, answered: Arc::default(), keeper })
    }

    /// Where events come in. Each lets an event in once.
    pub(crate) fn door(&self) -> Door {
        Door::new(self.keys.clone(), Arc::clone(&self.peers))
    }

    /// Speaks for a segment from now on.
    pub(crate) async fn speak_for(&self, segment: &Name) -> Result<Voice, NetworkError> {
        let me = SenderKey { segment: segment.clone(), sender: self.sender };
        let answered = Arc::clone(&self.answered);
        let answer = move |query: zenoh::query::Query| {
            answered.fetch_add(1, Ordering::Relaxed);
            let key = query.key_expr().clone();
            let bytes = Reading::now().0.to_be_bytes();
            // Who asked is told nothing then, and asks again.
            let _ = zenoh::Wait::wait(query.reply(key, bytes.as_slice()));
        };
        let clock = self.session.declare_queryable(self.keys.clock(&me)).allowed_origin(Locality::Remote);
        let clock = clock.callback(answer).await.map_err(|error| failed(&error))?;
        let token = self.session.liveliness().declare_token(self.keys.live(&me)).await;
        Ok(Voice { _token: token.map_err(|error| failed(&error))?, _clock: clock })
    }

    /// How often our clock was asked for.
    pub(crate) fn answered(&self) -> u64 {
        self.answered.load(Ordering::Relaxed)
    }

    /// Returns whether anybody is connected.
    pub(crate) async fn has_company(&self) -> bool {
        let info = self.session.info();
        let (routers, peers) = (info.routers_zid().await, info.peers_zid().await);
        routers.count() + peers.count() > 0
    }

    /// Waits until somebody is connected.
    pub(crate) async fn connected(&self) {
        while !self.has_company().await {
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    }

    /// Ends the session.
    pub(crate) async fn leave(&self) {
        if let Err(error) = self.session.close().await {
            tracing::debug!("the session did not close in order: {error}");
        }
    }
}

pub(crate) fn failed(error: &zenoh::Error) -> NetworkError {
    NetworkError(format!("zenoh refuses what COSMIC needs of it: {error}"))
}
