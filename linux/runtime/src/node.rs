//! A node: its tasks, and the handle that an application has of it.

use std::sync::Arc;

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::{ChannelCounters, Exception, ExceptionKind};
use cosmic_core::protocol::{LayoutHash, Side};
use cosmic_core::services::News;
use cosmic_core::time::Instant;
use cosmic_core::{Subject, broker};
use tokio::sync::{broadcast, watch};
use tokio::task::JoinHandle;

use crate::config::{BrokerTables, Config, StartError};
use crate::link::{self, Link, LinkCounters, LinkError};
use crate::shared::Shared;

/// A node of a segment. Clones are handles of the same node; it ends with the last of them and of its publishers and
/// subscribers.
#[derive(Clone)]
pub struct Node {
    pub(crate) running: Arc<Running>,
}

/// The tasks end with it.
pub(crate) struct Running {
    pub(crate) shared: Arc<Shared>,
    tasks: [JoinHandle<()>; 2],
}

impl Drop for Running {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

impl Node {
    /// Starts a node on a link, inside a runtime of tokio. That the link cannot be reached yet is no error: it is tried
    /// again and again.
    ///
    /// # Errors
    /// [`StartError`]
    pub fn start(config: Config, link: impl Link) -> Result<Self, StartError> {
        let shared = Arc::new(Shared::new(&config)?);
        let tasks = [
            tokio::spawn(keep_time(Arc::clone(&shared))),
            tokio::spawn(link::keep_connected(link, Arc::clone(&shared) as Arc<dyn link::End>)),
        ];
        Ok(Self { running: Arc::new(Running { shared, tasks }) })
    }

    /// Waits for the next exception.
    pub async fn next_exception(&self) -> Exception {
        std::future::poll_fn(|context| self.shared().look(|core| core.half.poll_exception(context.waker())))
            .await
    }

    /// How many exceptions of a kind there were. Wraps.
    pub fn exceptions(&self, kind: ExceptionKind) -> u32 {
        self.shared().look(|core| core.half.exceptions(kind))
    }

    /// What happened on a channel at this node. Of a channel of messages: what happened to their frames; whole messages
    /// count where they were refused, expired before they began, or found no place with their subscriber.
    pub fn channel_counters(&self, subject: Subject) -> Option<ChannelCounters> {
        self.shared().look(|core| {
            let mut counters = core.half.channel_counters(subject)?;
            core.messages.add_to(subject, &mut counters);
            Some(counters)
        })
    }

    /// What the link did.
    pub fn link_counters(&self) -> LinkCounters {
        self.shared().look(|core| core.counters)
    }

    /// Returns whether the link is connected.
    pub fn is_connected(&self) -> bool {
        self.shared().look(|core| core.is_connected)
    }

    /// Why the link is not connected; `None` if it is, or has not been tried yet.
    pub fn link_error(&self) -> Option<LinkError> {
        self.shared().look(|core| core.link_error.clone())
    }

    /// Waits until the link is connected or has failed for good, so that it is not tried again.
    ///
    /// # Errors
    /// It has failed for good.
    pub async fn connected_or_failed(&self) -> Result<(), LinkError> {
        self.until(|node| {
            let failed = || node.link_error().filter(LinkError::is_final);
            if node.is_connected() { Some(Ok(())) } else { failed().map(Err) }
        })
        .await
    }

    /// Waits until the link is connected.
    pub async fn connected(&self) {
        self.until(|node| node.is_connected().then_some(())).await;
    }

    /// The present local time: what deadlines and expirations are stated in.
    pub fn now(&self) -> Instant {
        self.shared().now()
    }

    /// The node's TxNode, if it has one.
    pub fn tx_node(&self) -> Option<TxNode> {
        self.shared().look(|core| core.half.services().tx_node())
    }

    /// Waits until the node has its TxNode.
    pub async fn configured(&self) -> TxNode {
        self.until(Self::tx_node).await
    }

    /// The etag of a subject, if this node knows it: of its own channels, or from the table of its broker.
    pub fn etag_of(&self, subject: Subject) -> Option<Etag> {
        self.shared().look(|core| {
            let services = core.half.services();
            let of_broker = || services.broker().as_ref()?.broker().subjects().etag_of(subject);
            services.etag_of(subject).or_else(of_broker)
        })
    }

    /// The other nodes on a side of a channel, as far as they have told.
    pub fn interested(&self, etag: Etag, side: Side) -> Vec<TxNode> {
        self.shared().look(|core| core.half.services().interests().nodes(etag, side).map(|it| it.0).collect())
    }

    /// How the other nodes on a side of a channel lay out its content.
    pub fn layouts(&self, etag: Etag, side: Side) -> Vec<LayoutHash> {
        self.shared().look(|core| core.half.services().interests().nodes(etag, side).map(|it| it.2).collect())
    }

    /// What the broker that this node hosts does; `None` if it hosts none.
    pub fn broker_role(&self) -> Option<broker::BrokerRole> {
        self.shared()
            .look(|core| core.half.services().broker().as_ref().map(|hosting| hosting.broker().role()))
    }

    /// The table of the broker that this node hosts, to be stored; `None` if it hosts none.
    pub fn broker_tables(&self) -> Option<BrokerTables> {
        self.shared().look(|core| {
            let broker = core.half.services().broker().as_ref()?.broker();
            Some(BrokerTables {
                nodes: broker.nodes().entries().collect(),
                subjects: broker.subjects().entries().collect(),
            })
        })
    }

    /// What happens in the cluster from now on: nodes that come and go, interest, what the broker does. Who is more
    /// than a thousand behind is told how many were lost.
    pub fn news(&self) -> broadcast::Receiver<News> {
        self.shared().news.subscribe()
    }

    /// Changes with each frame that the link has sent or given back: who sends one after the other waits for it. A frame
    /// that expires before it comes to the link changes nothing.
    pub fn departures(&self) -> watch::Receiver<u64> {
        self.shared().departures.subscribe()
    }

    /// Waits until the node has its TxNode and the channel of this subject its etag.
    pub(crate) async fn until_bound(&self, subject: Subject) {
        let bound = |node: &Self| {
            let etag = node.shared().look(|core| core.half.services().etag_of(subject));
            etag.zip(node.tx_node()).map(|_| ())
        };
        self.until(bound).await;
    }

    /// Waits until there is what is looked for. It is looked for whenever the link connects or a control frame has come.
    pub(crate) async fn until<R>(&self, look: impl Fn(&Self) -> Option<R>) -> R {
        let mut changed = self.shared().changed.subscribe();
        loop {
            if let Some(found) = look(self) {
                return found;
            }
            // The sender lives as long as the node.
            let _ = changed.changed().await;
        }
    }

    pub(crate) fn shared(&self) -> &Shared {
        &self.running.shared
    }
}

/// Polls the core at the instants that it names.
async fn keep_time(shared: Arc<Shared>) {
    loop {
        shared.act(|_, _| ());
        let at = shared.poll_next_at();
        tokio::select! {
            () = sleep_until(at) => {}
            () = shared.timer_wake.notified() => {}
        }
    }
}

/// Sleeps until then, or for ever.
pub(crate) async fn sleep_until(at: Option<tokio::time::Instant>) {
    match at {
        Some(at) => tokio::time::sleep_until(at).await,
        None => std::future::pending().await,
    }
}
