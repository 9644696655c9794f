//! The task of a segment: beacons, and who wants what.

use std::sync::Arc;
use std::time::Duration as Span;

use cosmic_core::event_layer::{Depth, Policy};
use cosmic_core::time::Instant;
use tokio::sync::broadcast::error::RecvError;

use super::Segment;
use crate::counters::Outcome;
use crate::leader::{self, Beacon, Bytes, PERIOD};

/// Keeps the leadership of a segment, and looks for interest, for ever. `able`: says whether we could lead now.
pub(crate) async fn keep_leader(
    segment: Arc<Segment>,
    able: Arc<dyn Fn() -> bool + Send + Sync>,
) -> Result<std::convert::Infallible, String> {
    let channel = match segment.etag_of_gateways {
        Some(etag) => leader::channel().with_etag(etag),
        None => leader::channel(),
    };
    let refused = |what: String| format!("the channel {:?} is refused: {what}", crate::config::GATEWAYS_NAME);
    let publisher = segment.node.announce(&channel).map_err(|error| refused(error.to_string()))?;
    let subscriber = segment.node.subscribe(&channel, Policy::Fifo(WAITING));
    let subscriber = subscriber.map_err(|error| refused(error.to_string()))?;
    let mut news = segment.node.news();
    let mut ticks = tokio::time::interval(Span::from_nanos(PERIOD.as_ticks()));
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut beacons = Beacons { published: None, sent: 0, forwarded: false };
    loop {
        tokio::select! {
            _ = ticks.tick() => {
                beacons.tick(&segment, &publisher, able());
                if segment.look_for_interest() {
                    segment.changed.notify_one();
                }
            }
            event = subscriber.next() => {
                let is_own = Some(event.publisher) == segment.node.tx_node();
                if let Some(beacon) = Beacon::decode(event.content).filter(|_| !is_own)
                    && segment.leadership().on_beacon(event.publisher, beacon, event.received_at)
                {
                    // Who published it was alive then, and forwarded what had come before.
                    segment.passed_over().forget_before(published_by(event.received_at));
                }
            }
            news = news.recv() => {
                // Who is behind looks at all there is anyway.
                if !matches!(news, Err(RecvError::Closed)) && segment.look_for_interest() {
                    segment.changed.notify_one();
                }
            }
        }
    }
}

struct Beacons {
    /// When the last one was published, and whether it said that we lead.
    published: Option<(Instant, bool)>,
    /// So many were sent.
    sent: u32,
    /// We could forward when it was looked at last.
    forwarded: bool,
}

impl Beacons {
    fn tick(&mut self, segment: &Segment, publisher: &cosmic_linux::Publisher<Bytes>, able: bool) {
        let node = &segment.node;
        let now = node.now();
        let sent = node.channel_counters(leader::channel().subject()).map_or(0, |counters| counters.sent);
        // It expires before the next is published, so it is the last one that was sent.
        if std::mem::replace(&mut self.sent, sent) != sent
            && let Some((at, true)) = self.published.take()
        {
            segment.leadership().on_sent(at);
        }
        let forwards = segment.leadership().may_forward(now);
        if forwards && !std::mem::replace(&mut self.forwarded, forwards) {
            let heard = segment.leadership().leader_heard_at();
            // If nobody led before, nobody has forwarded what was left to others.
            let since = heard.map_or(Instant::EPOCH, published_by);
            segment.outgoing.count_many(Outcome::PerhapsLost, segment.passed_over().take_since(since));
        }
        self.forwarded = forwards;
        let me = node.tx_node().filter(|_| node.is_connected());
        let (before, after, beacon) = {
            let mut leadership = segment.leadership();
            let before = leadership.leads();
            let beacon = leadership.tick(me, able, now);
            (before, leadership.leads(), beacon)
        };
        if let Some(beacon) = beacon {
            // Without an etag there is no beacon, and without beacons nobody leads.
            let published = publisher.publish(beacon.encode());
            self.published = published.is_ok().then_some((now, beacon.leads));
        }
        if before != after {
            tell(segment, after, now);
            segment.changed.notify_one();
        }
    }
}

/// A beacon that arrives now was published after this.
fn published_by(received_at: Instant) -> Instant {
    received_at.saturating_sub(PERIOD)
}

fn tell(segment: &Segment, leads: bool, now: Instant) {
    let name = &segment.name;
    if !leads {
        tracing::warn!("segment {name}: another gateway speaks for it, or this one cannot; standing by");
        return;
    }
    match segment.leadership().leader_heard_at() {
        Some(heard) => {
            let silent = now.saturating_since(heard).as_ticks() / 1_000_000;
            tracing::warn!(
                "segment {name}: the gateway that spoke for it is silent for {silent} ms; taking over"
            );
        }
        None => tracing::info!("segment {name}: speaking for it"),
    }
}

const WAITING: Depth = Depth::new(32).unwrap();
