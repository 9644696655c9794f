//! A node, and the channels that a program has asked for.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use cosmic_core::can::{BitRate, Payload, TxNode};
use cosmic_core::event_layer::{Bytes, ChannelCounters, Event, PublishError};
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::link::LinkAddress;
use cosmic_linux::{AnnounceError, MessagePublisher, Node, Publisher, drawn_uid};
use cosmic_monitor::{SegmentPlan, hexadecimal};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::watch;

use crate::config::node_config;
use crate::events::Events;
use crate::failure::Failure;
use crate::quality::{Declared, LONGEST_MESSAGE, Quality, Times};
use crate::subscription::{Queue, Subscription};

/// What a session is told when it is opened.
#[derive(Clone, Debug)]
pub struct Settings {
    /// How to reach the segment.
    pub link: LinkAddress,
    /// The file that describes the cluster.
    pub cluster: Option<PathBuf>,
    /// The UID of the node; one is drawn if there is none. One of the cluster's file brings its TxNode.
    pub uid: Option<NodeUid>,
    /// The TxNode, where no broker gives one.
    pub tx_node: Option<TxNode>,
    /// The bit rate, where no file says it.
    pub bit_rate: BitRate,
    /// For how long to wait for the link, and for what a broker gives.
    pub patience: Duration,
}

impl Settings {
    /// A session on this link at 1 Mbit/s, that is given its names by a broker.
    pub const fn new(link: LinkAddress) -> Self {
        let (cluster, uid, tx_node, bit_rate, patience) = (None, None, None, BitRate::MAX, PATIENCE);
        Self { link, cluster, uid, tx_node, bit_rate, patience }
    }
}

/// A node with a thread of its own. Any thread may call it. It ends when it is closed or dropped.
pub struct Session {
    node: Node,
    plan: Option<SegmentPlan>,
    patience: Duration,
    open: Mutex<Open>,
    closed: watch::Sender<bool>,
}

/// What a session has until it is closed.
struct Open {
    /// `None` when it has been closed. Calls that wait hold it, too, until they have heard of that.
    thread: Option<Arc<Thread>>,
    /// One for each subject, until it is withdrawn.
    publishers: HashMap<Subject, Outlet>,
    subscriptions: Vec<Weak<Subscription>>,
}

/// The right to publish on a channel.
#[derive(Clone)]
enum Outlet {
    Events(Arc<Publisher<Payload>>),
    Messages(Arc<MessagePublisher<Bytes<LONGEST_MESSAGE>>>),
}

/// The thread of a session. What runs there may wait for a file or a device, perhaps for ever: nobody waits for its end.
struct Thread(Option<Runtime>);

impl Thread {
    fn start() -> std::io::Result<Self> {
        let runtime =
            Builder::new_multi_thread().worker_threads(1).thread_name("cosmic").enable_all().build();
        Ok(Self(Some(runtime?)))
    }

    fn block_on<F: Future>(&self, what: F) -> Result<F::Output, Failure> {
        Ok(self.0.as_ref().ok_or(Failure::Closed)?.block_on(what))
    }
}

impl Drop for Thread {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}

impl Session {
    /// Starts a node, and waits until its link is connected.
    ///
    /// # Errors
    /// [`Failure::Input`], [`Failure::Link`]
    pub fn open(settings: &Settings) -> Result<Self, Failure> {
        let plan = settings.cluster.as_ref().map(SegmentPlan::read).transpose();
        let plan = plan.map_err(|why| Failure::Input(why.to_string()))?;
        let bit_rate = plan.as_ref().map_or(settings.bit_rate, SegmentPlan::bit_rate);
        let link = settings.link.link(bit_rate).map_err(Failure::Input)?;
        let mut config = node_config(settings.uid.unwrap_or_else(drawn_uid), plan.as_ref(), bit_rate);
        config.node.tx_node = settings.tx_node.or(config.node.tx_node);
        let thread = Thread::start();
        let thread = thread.map_err(|why| Failure::Link(format!("no thread can be started: {why}")))?;
        let patience = settings.patience;
        let node = thread.block_on(async {
            let node = Node::start(config, link).map_err(|why| Failure::Input(why.to_string()))?;
            match tokio::time::timeout(patience, node.connected_or_failed()).await {
                Ok(Ok(())) => Ok(node),
                Ok(Err(why)) => Err(Failure::Link(why.to_string())),
                Err(_) => Err(Failure::Link(match node.link_error() {
                    Some(why) => format!("{why}; tried for {patience:?}"),
                    None => format!("{} does not answer within {patience:?}", settings.link),
                })),
            }
        })??;
        let (publishers, subscriptions) = (HashMap::new(), Vec::new());
        let open = Mutex::new(Open { thread: Some(Arc::new(thread)), publishers, subscriptions });
        Ok(Self { node, plan, patience, open, closed: watch::Sender::new(false) })
    }

    /// Ends the node, with its subscriptions. Events that wait to be sent are discarded. Whoever waits in another call is
    /// told.
    pub fn close(&self) {
        let open = {
            let mut open = self.lock();
            let (publishers, subscriptions) = (HashMap::new(), Vec::new());
            std::mem::replace(&mut *open, Open { thread: None, publishers, subscriptions })
        };
        self.closed.send_replace(true);
        open.subscriptions.iter().filter_map(Weak::upgrade).for_each(|subscription| subscription.close());
    }

    /// Returns whether it has been closed.
    pub fn is_closed(&self) -> bool {
        self.lock().thread.is_none()
    }

    /// The subject of a channel, by its name in the cluster's file or as up to 16 hexadecimal digits behind `0x`.
    pub fn subject_of(&self, name: &str) -> Option<Subject> {
        let planned =
            self.plan.as_ref().and_then(|plan| Subject::new(plan.channel(plan.channel_named(name)?).subject));
        planned.or_else(|| Subject::new(hexadecimal(name).filter(|_| name.starts_with("0x"))?))
    }

    /// The description of the cluster.
    pub const fn plan(&self) -> Option<&SegmentPlan> {
        self.plan.as_ref()
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.node
    }

    /// Announces a channel, and waits until it can be published on. Does nothing for one that has been announced.
    ///
    /// # Errors
    /// [`Failure::Input`], [`Failure::Refused`], [`Failure::NotBound`], [`Failure::Closed`]; then the channel is not
    /// announced.
    pub fn announce(&self, subject: Subject, quality: Option<&Quality>) -> Result<(), Failure> {
        self.publisher(subject, quality).map(|_| ())
    }

    /// Gives up the announcement of a channel. Events that wait to be sent are discarded. Returns whether there was
    /// one.
    pub fn withdraw(&self, subject: Subject) -> bool {
        let publisher = self.lock().publishers.remove(&subject);
        publisher.is_some()
    }

    /// Publishes an event of now. The first one on a channel that has not been announced announces it, as the cluster's
    /// file says or with the [default quality](Quality::DEFAULT), and may wait for a broker; no other waits. On a channel
    /// of [messages](crate::Class::Messages), which have no deadline, a few may wait to be sent.
    ///
    /// # Errors
    /// As [`announce`](Self::announce), and [`Failure::NotPublished`].
    pub fn publish(&self, subject: Subject, content: &[u8], times: Times) -> Result<(), Failure> {
        let publisher = match self.publisher(subject, None)? {
            Outlet::Events(publisher) => publisher,
            Outlet::Messages(publisher) => {
                if times.deadline.is_some() {
                    return Err(Failure::Input("a message is non real-time: give no deadline".to_owned()));
                }
                let content = Bytes::new(content).ok_or(PublishError::TooLong)?;
                return Ok(publisher.publish_within(&content, times.validity)?);
            }
        };
        let content = Payload::new(content).ok_or(PublishError::TooLong)?;
        let now = self.node.now();
        let mut event = Event::new(content);
        event.deadline = times.deadline.map(|deadline| now + deadline);
        event.expires_at = times.validity.map(|validity| now + validity);
        Ok(publisher.publish_event(&event)?)
    }

    /// Subscribes to a channel. If its etag is not fixed, waits until the node has a TxNode, under which it asks for it;
    /// to listen takes none.
    ///
    /// # Errors
    /// As [`announce`](Self::announce).
    pub fn subscribe(
        &self,
        subject: Subject,
        quality: Option<&Quality>,
        queue: Queue,
    ) -> Result<Arc<Subscription>, Failure> {
        self.thread()?;
        let channel = self.channel(subject, quality)?;
        let refused = |why: String| Failure::Refused(why);
        let source = Events::of(&self.node, &channel, queue.policy());
        let source = source.map_err(|why| refused(why.to_string()))?;
        let subscription = Subscription::new(source, queue)
            .map_err(|why| refused(format!("no descriptor can be had: {why}; close some")))?;
        if self.node.etag_of(subject).is_none() {
            self.within_patience(self.node.configured())?;
        }
        let subscription = Arc::new(subscription);
        let mut open = self.lock();
        if open.thread.is_none() {
            return Err(Failure::Closed);
        }
        open.subscriptions.retain(|subscription| subscription.strong_count() > 0);
        open.subscriptions.push(Arc::downgrade(&subscription));
        Ok(subscription)
    }

    /// What happened on a channel at this node; `None` if the node does not know it.
    pub fn counters(&self, subject: Subject) -> Option<ChannelCounters> {
        self.node.channel_counters(subject)
    }

    fn publisher(&self, subject: Subject, quality: Option<&Quality>) -> Result<Outlet, Failure> {
        // What has been closed has none.
        if let Some(publisher) = self.lock().publishers.get(&subject) {
            return Ok(publisher.clone());
        }
        self.thread()?;
        let channel = self.channel(subject, quality)?;
        let refused = |why: AnnounceError| Failure::Refused(why.to_string());
        let publisher = match &channel {
            Declared::Events(channel) => {
                let publisher = self.node.announce(channel).map_err(refused)?;
                self.within_patience(publisher.bound())?;
                Outlet::Events(Arc::new(publisher))
            }
            Declared::Messages(channel) => {
                let publisher = self.node.announce_messages(channel).map_err(refused)?;
                self.within_patience(publisher.bound())?;
                Outlet::Messages(Arc::new(publisher))
            }
        };
        let mut open = self.lock();
        if open.thread.is_none() {
            return Err(Failure::Closed);
        }
        // Two threads may have been here; both publishers do.
        Ok(open.publishers.entry(subject).or_insert(publisher).clone())
    }

    /// The channel, as the cluster's file says, or as was given.
    fn channel(&self, subject: Subject, quality: Option<&Quality>) -> Result<Declared, Failure> {
        let planned = self.plan.as_ref().and_then(|plan| Some((plan, plan.channel_of_subject(subject)?)));
        match (planned, quality) {
            (Some(_), Some(_)) => Err(Failure::Input(format!(
                "the cluster's file says the quality of the channel with subject {subject}: give none"
            ))),
            (Some((plan, at)), None) => Declared::by_plan(plan, at).ok_or_else(|| {
                Failure::Input(format!("the cluster's file contradicts itself about subject {subject}"))
            }),
            (None, quality) => quality.unwrap_or(&Quality::DEFAULT).channel(subject),
        }
    }

    fn within_patience<T>(&self, what: impl Future<Output = T>) -> Result<T, Failure> {
        let thread = self.thread()?;
        let mut closed = self.closed.subscribe();
        thread.block_on(async {
            tokio::select! {
                _ = closed.wait_for(|closed| *closed) => Err(Failure::Closed),
                waited = tokio::time::timeout(self.patience, what) => {
                    waited.map_err(|_| Failure::NotBound(self.patience))
                }
            }
        })?
    }

    fn thread(&self) -> Result<Arc<Thread>, Failure> {
        self.lock().thread.clone().ok_or(Failure::Closed)
    }

    fn lock(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// For how long a session waits if it is not told.
pub const PATIENCE: Duration = Duration::from_secs(5);
