//! The way of a channel from a segment to IP.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use tokio::sync::Notify;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;

use crate::config::ChannelConfig;
use crate::error::StartError;
use crate::keys::Name;
use crate::network::{Network, failed};

/// The way of a channel from a segment to IP.
pub(super) struct Outlet {
    pub(super) publisher: zenoh::pubsub::Publisher<'static>,
    /// Somebody on IP subscribes.
    pub(super) wanted: Arc<AtomicBool>,
    pub(super) sequence: AtomicU64,
}

impl Outlet {
    pub(super) async fn open(
        network: &Network,
        segment: &Name,
        channel: &ChannelConfig,
        changed: &Arc<Notify>,
    ) -> Result<Self, StartError> {
        let refused = |error: zenoh::Error| StartError::Network(failed(&error));
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
        Ok(Self { publisher, wanted, sequence: AtomicU64::new(0) })
    }
}

fn priority_of(channel: &ChannelConfig) -> Priority {
    match channel.deadline {
        Some(_) => Priority::RealTime,
        None => Priority::Data,
    }
}
