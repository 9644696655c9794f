//! The gateway: a two-faced event channel handler, between its segments and the network on IP.
//!
//! Toward a segment it is a node that announces what may enter, and subscribes to what somebody elsewhere wants. Toward
//! IP it is a participant that publishes what its segments say, and subscribes to what somebody on them wants. What
//! nobody wants on the other side does not cross.

mod hub;
mod messages;
mod origins;
mod outlet;
mod ways;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration as Span;

use tokio::sync::Notify;
use tokio::task::JoinSet;

use crate::config::Config;
use crate::counters::{Counters, Direction, Metrics};
use crate::crossing::Watch;
use crate::error::StartError;
use crate::keys::Name;
use crate::leader::group_of;
use crate::network::{Network, NetworkError};
use crate::segment::{Segment, keep_leader};
use crate::table::{self, Table};
use hub::Hub;
use origins::Origins;
use outlet::Outlet;

/// A gateway that runs. It ends when it is dropped, or [in order](Gateway::stop).
pub struct Gateway {
    hub: Arc<Hub>,
    tasks: JoinSet<Result<(), StartError>>,
}

impl Gateway {
    /// Starts a gateway, inside a runtime of tokio with several threads. That a segment or another gateway cannot be
    /// reached yet is no error: it is tried again and again.
    ///
    /// # Errors
    /// [`StartError`]
    pub async fn start(config: &Config) -> Result<Self, StartError> {
        Self::start_with(config, None).await
    }

    /// As [`start`](Self::start); `watch` is told of each event, and what becomes of it. It must not wait.
    ///
    /// # Errors
    /// As there.
    pub async fn start_watched(config: &Config, watch: Box<Watch>) -> Result<Self, StartError> {
        Self::start_with(config, Some(watch)).await
    }

    async fn start_with(config: &Config, watch: Option<Box<Watch>>) -> Result<Self, StartError> {
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
            channels: config.channels.clone(),
            origins: Origins::new(config.channels.len()),
            door: network.door(),
            network,
            segments,
            outlets,
            metrics,
            changed,
            has_company: AtomicBool::new(false),
            watch,
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
        self.tasks.spawn(ways::keep(Arc::clone(&self.hub)));
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
