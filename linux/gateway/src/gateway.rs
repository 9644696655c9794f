//! The gateway: a two-faced event channel handler, between its segments and the network on IP.
//!
//! Toward a segment it is a node that announces what may enter, and subscribes to what somebody elsewhere wants. Toward
//! IP it is a participant that publishes what its segments say, and subscribes to what somebody on them wants. What
//! nobody wants on the other side does not cross.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration as Span;

use cosmic_core::Subject;
use cosmic_core::can::Payload;
use cosmic_core::event_layer::Delivered;
use cosmic_core::protocol::LayoutHash;
use cosmic_linux::Subscriber;
use tokio::sync::Notify;
use tokio::task::{JoinHandle, JoinSet};
use zenoh::Wait as _;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Locality, Sample, SampleKind};

use crate::clock::Reading;
use crate::config::{ChannelConfig, Config};
use crate::counters::{Counters, Direction, Metrics, Outcome};
use crate::encoding::Envelope;
use crate::error::StartError;
use crate::keys::Name;
use crate::leader::group_of;
use crate::network::{Network, NetworkError, Voice};
use crate::segment::{Incoming, Left, Segment, keep_leader};
use crate::sequence::Windows;
use crate::table::{self, Table};

/// A gateway that runs. It ends when it is dropped, or [in order](Gateway::stop).
pub struct Gateway {
    hub: Arc<Hub>,
    tasks: JoinSet<Result<(), StartError>>,
}

/// What all tasks of a gateway share.
struct Hub {
    network: Network,
    segments: Vec<Arc<Segment>>,
    channels: Vec<ChannelConfig>,
    by_subject: HashMap<Subject, usize>,
    /// For each segment and channel: its way to IP, if it may leave.
    outlets: Vec<Vec<Option<Outlet>>>,
    /// What comes from IP and belongs to no segment.
    unassigned: Counters,
    /// What has come from IP.
    windows: Windows,
    metrics: Metrics,
    changed: Arc<Notify>,
    has_company: AtomicBool,
}

/// The way of a channel from a segment to IP.
struct Outlet {
    publisher: zenoh::pubsub::Publisher<'static>,
    /// Somebody on IP subscribes.
    wanted: Arc<AtomicBool>,
    sequence: AtomicU64,
    /// Reads the channel on the segment, while somebody elsewhere wants it.
    reader: Mutex<Option<JoinHandle<()>>>,
}

impl Drop for Outlet {
    fn drop(&mut self) {
        if let Some(reader) = self.reader.get_mut().unwrap_or_else(PoisonError::into_inner).take() {
            reader.abort();
        }
    }
}

impl Gateway {
    /// Starts a gateway, inside a runtime of tokio with several threads. That a segment or another gateway cannot be
    /// reached yet is no error: it is tried again and again.
    ///
    /// # Errors
    /// [`StartError`]
    pub async fn start(config: &Config) -> Result<Self, StartError> {
        let network = Network::join(&config.ip, &config.network).await.map_err(StartError::Network)?;
        let metrics = Metrics::new();
        let group = group_of(&config.network);
        let (mut segments, mut tables) = (Vec::new(), Vec::new());
        for of_segment in &config.segments {
            let refused = |error: table::TableError| StartError::segment(&of_segment.name, error.to_string());
            let table = of_segment.broker.as_deref().map(Table::open).transpose().map_err(refused)?;
            let segment = Segment::start(of_segment, &config.channels, group, table.as_ref(), &metrics)?;
            let segment = Arc::new(segment);
            if let Some(table) = table {
                tables.push((Arc::clone(&segment), table));
            }
            segments.push(segment);
        }
        let changed = Arc::new(Notify::new());
        let mut outlets = Vec::new();
        for segment in &segments {
            let mut of_segment = Vec::new();
            for channel in &config.channels {
                let leaves = channel.from.has(&segment.name);
                of_segment.push(if leaves {
                    Some(Outlet::open(&network, &segment.name, channel, &changed).await?)
                } else {
                    None
                });
            }
            outlets.push(of_segment);
        }
        let hub = Arc::new(Hub {
            unassigned: metrics.of_no_segment(),
            by_subject: config.channels.iter().enumerate().map(|(at, it)| (it.subject, at)).collect(),
            channels: config.channels.clone(),
            network,
            segments,
            outlets,
            windows: Windows::default(),
            metrics,
            changed,
            has_company: AtomicBool::new(false),
        });
        let mut gateway = Self { hub, tasks: JoinSet::new() };
        gateway.spawn(tables);
        Ok(gateway)
    }

    fn spawn(&mut self, tables: Vec<(Arc<Segment>, Table)>) {
        for segment in &self.hub.segments {
            let (hub, of) = (Arc::clone(&self.hub), Arc::clone(segment));
            let able: Arc<dyn Fn() -> bool + Send + Sync> = Arc::new(move || hub.can_forward());
            self.tasks.spawn(async move {
                let name = of.name.clone();
                match keep_leader(of, able).await {
                    Err(what) => Err(StartError::segment(&name, what)),
                }
            });
            let (changed, of) = (Arc::clone(&self.hub.changed), Arc::clone(segment));
            self.tasks.spawn(async move {
                loop {
                    of.changed.notified().await;
                    changed.notify_one();
                }
            });
        }
        for (segment, table) in tables {
            self.tasks.spawn(async move {
                let name = segment.name.clone();
                let kept = table::keep(table, &segment.node).await;
                kept.map_err(|error| StartError::segment(&name, error.to_string()))
            });
        }
        let hub = Arc::clone(&self.hub);
        self.tasks.spawn(async move { hub.keep_ways().await });
        let hub = Arc::clone(&self.hub);
        self.tasks.spawn(async move {
            loop {
                hub.has_company.store(hub.network.has_company().await, Ordering::Relaxed);
                tokio::time::sleep(Span::from_millis(100)).await;
            }
        });
    }

    /// Waits until something ends the gateway: why.
    pub async fn ended(&mut self) -> StartError {
        loop {
            match self.tasks.join_next().await {
                Some(Ok(Err(error))) => return error,
                Some(Err(error)) => {
                    return StartError::Network(NetworkError::new(format!("a task has ended: {error}")));
                }
                Some(Ok(Ok(()))) => {}
                None => std::future::pending().await,
            }
        }
    }

    /// What became of events of a segment in a direction.
    pub fn counters(&self, segment: &Name, direction: Direction) -> Option<&Counters> {
        let segment = self.hub.segments.iter().find(|it| it.name == *segment)?;
        Some(match direction {
            Direction::In => &segment.incoming,
            Direction::Out => &segment.outgoing,
        })
    }

    /// What became of events that came from IP and belong to no segment.
    pub fn unassigned(&self) -> &Counters {
        &self.hub.unassigned
    }

    /// The gateway's node on a segment.
    pub fn node(&self, segment: &Name) -> Option<&cosmic_linux::Node> {
        self.hub.segments.iter().find(|it| it.name == *segment).map(|segment| &segment.node)
    }

    /// Returns whether the gateway speaks for a segment now.
    pub fn leads(&self, segment: &Name) -> bool {
        self.hub.segments.iter().any(|it| it.name == *segment && it.leads())
    }

    /// How many others are on IP, and of how many the clock is known.
    pub fn others(&self) -> (usize, usize) {
        self.hub.network.peers.count()
    }

    /// All counters, as Prometheus reads them.
    pub fn metrics(&self) -> String {
        self.hub.metrics.text()
    }

    /// As [`metrics`](Self::metrics), to be called by others; empty when the gateway is gone.
    pub(crate) fn metrics_later(&self) -> impl Fn() -> String + Clone + Send + Sync + 'static {
        let hub = Arc::downgrade(&self.hub);
        move || hub.upgrade().map(|hub| hub.metrics.text()).unwrap_or_default()
    }

    /// Ends in order: others see at once that it is gone.
    pub async fn stop(mut self) {
        self.tasks.shutdown().await;
        self.hub.network.leave().await;
    }
}

impl Outlet {
    async fn open(
        network: &Network,
        segment: &Name,
        channel: &ChannelConfig,
        changed: &Arc<Notify>,
    ) -> Result<Self, StartError> {
        let refused = |error: zenoh::Error| StartError::Network(crate::network::failed(&error));
        let key = network.keys.event(channel.subject, segment);
        let publisher = network.session.declare_publisher(key);
        let publisher = publisher
            .allowed_destination(Locality::Remote)
            .congestion_control(CongestionControl::Drop)
            .priority(priority_of(channel))
            .express(channel.deadline.is_some())
            .await
            .map_err(refused)?;
        let wanted = Arc::new(AtomicBool::new(false));
        let (seen, notify) = (Arc::clone(&wanted), Arc::clone(changed));
        let listener = publisher.matching_listener().callback(move |status| {
            seen.store(status.matching(), Ordering::Relaxed);
            notify.notify_one();
        });
        listener.background().await.map_err(refused)?;
        let matching = publisher.matching_status().await.map_err(refused)?;
        if matching.matching() {
            wanted.store(true, Ordering::Relaxed);
        }
        Ok(Self { publisher, wanted, sequence: AtomicU64::new(0), reader: Mutex::new(None) })
    }
}

fn priority_of(channel: &ChannelConfig) -> Priority {
    match channel.deadline {
        Some(_) => Priority::RealTime,
        None => Priority::Data,
    }
}

impl Hub {
    /// There is something to forward to.
    fn can_forward(&self) -> bool {
        self.segments.len() > 1 || self.has_company.load(Ordering::Relaxed)
    }

    /// Opens and closes the ways of channels, as they are wanted.
    async fn keep_ways(self: Arc<Self>) -> Result<(), StartError> {
        let mut from_ip = HashMap::new();
        let mut voices: Vec<Option<Voice>> = self.segments.iter().map(|_| None).collect();
        loop {
            for (at, voice) in voices.iter_mut().enumerate() {
                self.keep_readers(at);
                self.keep_voice(at, voice).await.map_err(StartError::Network)?;
            }
            for at in 0..self.channels.len() {
                self.keep_subscriber(at, &mut from_ip).await?;
            }
            let timer = tokio::time::sleep(Span::from_secs(1));
            tokio::select! {
                () = self.changed.notified() => {}
                () = timer => {}
            }
        }
    }

    fn keep_readers(self: &Arc<Self>, segment: usize) {
        for (channel, outlet) in self.outlets[segment].iter().enumerate() {
            let Some(outlet) = outlet else { continue };
            let elsewhere = || {
                let others = self.segments.iter().enumerate().filter(|(at, _)| *at != segment);
                others.map(|(_, other)| other).any(|other| other.wants(channel))
            };
            let wanted = outlet.wanted.load(Ordering::Relaxed) || elsewhere();
            let mut reader = outlet.reader.lock().unwrap_or_else(PoisonError::into_inner);
            if wanted && reader.is_none() {
                match self.segments[segment].listen(channel) {
                    Ok(subscriber) => {
                        *reader = Some(tokio::spawn(read(Arc::clone(self), segment, channel, subscriber)))
                    }
                    Err(why) => {
                        let (name, of) = (&self.channels[channel].name, &self.segments[segment].name);
                        tracing::warn!("segment {of}: the channel {name:?} cannot be subscribed to: {why}");
                    }
                }
            } else if !wanted && let Some(reader) = reader.take() {
                reader.abort();
            }
        }
    }

    async fn keep_voice(&self, segment: usize, voice: &mut Option<Voice>) -> Result<(), NetworkError> {
        let segment = &self.segments[segment];
        if !segment.leads() {
            *voice = None;
        } else if voice.is_none() {
            *voice = Some(self.network.speak_for(&segment.name).await?);
            if self.network.peers.speaking_for(&segment.name) > 0 {
                tracing::warn!(
                    "another gateway speaks for a segment {} too: each segment needs a name of its own",
                    segment.name
                );
            }
        }
        Ok(())
    }

    async fn keep_subscriber(
        self: &Arc<Self>,
        channel: usize,
        subscribers: &mut HashMap<usize, zenoh::pubsub::Subscriber<()>>,
    ) -> Result<(), StartError> {
        let wanted = self.segments.iter().any(|segment| segment.wants(channel));
        if wanted && !subscribers.contains_key(&channel) {
            let hub = Arc::downgrade(self);
            let on_sample = move |sample: Sample| {
                if let Some(hub) = hub.upgrade() {
                    hub.on_sample(channel, &sample);
                }
            };
            let key = self.network.keys.events(self.channels[channel].subject);
            let subscriber = self.network.session.declare_subscriber(key).allowed_origin(Locality::Remote);
            let subscriber = subscriber.callback(on_sample).await;
            let subscriber =
                subscriber.map_err(|error| StartError::Network(crate::network::failed(&error)))?;
            subscribers.insert(channel, subscriber);
        } else if !wanted {
            subscribers.remove(&channel);
        }
        Ok(())
    }

    /// An event of a segment. Never waits.
    fn on_event(&self, segment: usize, channel: usize, event: &Delivered<Payload>) {
        let (of, config) = (&self.segments[segment], &self.channels[channel]);
        let (node, left) = match of.take(channel, config, event) {
            Ok(taken) => taken,
            Err(outcome) => {
                of.outgoing.count(outcome);
                return;
            }
        };
        let incoming = Incoming { content: event.content.as_slice(), layout: LayoutHash::UNSTATED, left };
        for (at, other) in self.segments.iter().enumerate() {
            if at != segment && other.wants(channel) {
                other.give(channel, config, &incoming);
            }
        }
        let Some(outlet) = &self.outlets[segment][channel] else { return };
        if !outlet.wanted.load(Ordering::Relaxed) {
            return;
        }
        let envelope = Envelope {
            class: config.class,
            node: Some(node),
            layout: LayoutHash::UNSTATED,
            sender: self.network.sender,
            sequence: outlet.sequence.fetch_add(1, Ordering::Relaxed),
            sent_at: Reading::now(),
            to_deadline: left.to_deadline,
            to_expiry: left.to_expiry,
            content: event.content.as_slice().to_vec(),
        };
        let put = outlet.publisher.put(envelope.encode()).wait();
        of.outgoing.count(if put.is_ok() { Outcome::Forwarded } else { Outcome::NotSent });
    }

    /// An event from IP. Never waits.
    fn on_sample(&self, channel: usize, sample: &Sample) {
        if let Err(outcome) = self.pass(channel, sample) {
            self.unassigned.count(outcome);
        }
    }

    fn pass(&self, channel: usize, sample: &Sample) -> Result<(), Outcome> {
        let now = Reading::now();
        let key = self.network.keys.read_event(sample.key_expr().as_str()).ok_or(Outcome::Malformed)?;
        if sample.kind() != SampleKind::Put || self.by_subject.get(&key.subject) != Some(&channel) {
            return Err(Outcome::Malformed);
        }
        if self.segments.iter().any(|segment| segment.name == key.segment) {
            return Err(Outcome::ComeBack);
        }
        let config = &self.channels[channel];
        let bytes = sample.payload().to_bytes();
        let envelope = Envelope::decode(&bytes).map_err(|_| Outcome::Malformed)?;
        let missing = self.windows.note(&key, &envelope, now)?;
        self.unassigned.count_many(Outcome::Missing, missing);
        let age = self.network.peers.age(&key.segment, &envelope, now)?;
        let left = Left { to_deadline: envelope.to_deadline, to_expiry: envelope.to_expiry };
        // An event whose sender states no expiry gets that of the channel, from when it was sent.
        let left = left.at_most(config).after(age).ok_or(Outcome::Expired)?;
        let incoming = Incoming { content: &envelope.content, layout: envelope.layout, left };
        for segment in self.segments.iter().filter(|segment| segment.wants(channel)) {
            segment.give(channel, config, &incoming);
        }
        Ok(())
    }
}

async fn read(hub: Arc<Hub>, segment: usize, channel: usize, subscriber: Subscriber<Payload>) {
    loop {
        let event = subscriber.next().await;
        hub.on_event(segment, channel, &event);
    }
}
