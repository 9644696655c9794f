//! Round trips by path, as Kaiser and Brudna's table 5 has them: an event goes, and one comes back for it.

use std::time::{Duration as Span, Instant};

use cosmic_core::can::Etag;
use cosmic_core::event_layer::{Channel, Depth, Policy, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_gateway::ip;
use cosmic_linux::Node;
use serde::Serialize;

use crate::channels::{COMMAND_ETAG, SUBJECTS};
use crate::failed::Failed;

const QUALITY: SoftAttributes =
    SoftAttributes { deadline: Duration::from_millis(500), validity: Duration::from_millis(1000) };

/// Round trips of a path.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct RoundTrips {
    /// From where to where.
    pub path: &'static str,
    /// How many came back.
    pub count: usize,
    /// How many did not.
    pub lost: usize,
    /// In milliseconds.
    pub min: f64,
    /// In milliseconds.
    pub mean: f64,
    /// In milliseconds.
    pub median: f64,
    /// In milliseconds.
    pub max: f64,
}

/// Either end of a path.
#[derive(Clone)]
pub enum End {
    /// A node on a segment.
    Segment(Node),
    /// A node on IP.
    Ip(ip::Node),
}

enum Publisher {
    Segment(cosmic_linux::Publisher<u32>),
    Ip(Box<ip::Publisher<u32>>),
}

enum Subscriber {
    Segment(cosmic_linux::Subscriber<u32>),
    Ip(ip::Subscriber<u32>),
}

fn channel(number: u16) -> Result<Channel<u32>, Failed> {
    let wrong = || Failed("the demo's channels are wrong".to_owned());
    let subject = *SUBJECTS.get(usize::from(number)).ok_or_else(wrong)?;
    let etag = Etag::new(COMMAND_ETAG + number).ok_or_else(wrong)?;
    Ok(Channel::soft(subject, QUALITY).with_etag(etag))
}

impl End {
    async fn announce(&self, channel: &Channel<u32>) -> Result<Publisher, Failed> {
        Ok(match self {
            Self::Segment(node) => {
                let publisher = node.announce(channel).map_err(|error| Failed(error.to_string()))?;
                publisher.bound().await;
                Publisher::Segment(publisher)
            }
            Self::Ip(node) => {
                let publisher = node.announce(channel).await.map_err(|error| Failed(error.to_string()))?;
                Publisher::Ip(Box::new(publisher))
            }
        })
    }

    async fn subscribe(&self, channel: &Channel<u32>) -> Result<Subscriber, Failed> {
        Ok(match self {
            Self::Segment(node) => Subscriber::Segment(
                node.subscribe(channel, Policy::Fifo(WAITING)).map_err(|error| Failed(error.to_string()))?,
            ),
            Self::Ip(node) => Subscriber::Ip(
                node.subscribe(channel, Policy::Fifo(WAITING))
                    .await
                    .map_err(|error| Failed(error.to_string()))?,
            ),
        })
    }
}

impl Publisher {
    fn publish(&self, number: u32) {
        // One that is refused shows as lost.
        let _ = match self {
            Self::Segment(publisher) => publisher.publish(number),
            Self::Ip(publisher) => publisher.publish(number),
        };
    }
}

impl Subscriber {
    async fn next(&self) -> u32 {
        match self {
            Self::Segment(subscriber) => subscriber.next().await.content,
            Self::Ip(subscriber) => subscriber.next().await.content,
        }
    }
}

/// Measures a path: so many round trips, one after the other.
///
/// # Errors
/// A channel is refused, or nothing comes back at all.
pub async fn measure(path: &'static str, near: End, far: End, count: u32) -> Result<RoundTrips, Failed> {
    let (ping, pong) = (channel(1)?, channel(2)?);
    let heard = far.subscribe(&ping).await?;
    let answer = far.announce(&pong).await?;
    let echo = tokio::spawn(async move {
        loop {
            answer.publish(heard.next().await);
        }
    });
    let answered = near.subscribe(&pong).await?;
    let ask = near.announce(&ping).await?;
    // Until all on the way have heard who wants what.
    let mut number = 0;
    let opened = tokio::time::timeout(PATIENCE, async {
        loop {
            number += 1;
            ask.publish(number);
            if tokio::time::timeout(Span::from_millis(50), answered.next()).await.is_ok() {
                return;
            }
        }
    });
    opened.await.map_err(|_| Failed(format!("{path}: nothing comes back")))?;
    tokio::time::sleep(Span::from_millis(200)).await;
    while tokio::time::timeout(Span::from_millis(20), answered.next()).await.is_ok() {}
    let (mut taken, mut lost) = (Vec::new(), 0);
    for _ in 0..count {
        number += 1;
        let begun = Instant::now();
        ask.publish(number);
        let came =
            tokio::time::timeout(Span::from_secs(1), async { while answered.next().await != number {} });
        match came.await {
            Ok(()) => taken.push(begun.elapsed().as_secs_f64() * 1e3),
            Err(_) => lost += 1,
        }
        // So that no rate holds one back.
        tokio::time::sleep(Span::from_millis(3)).await;
    }
    echo.abort();
    if taken.is_empty() {
        return Err(Failed(format!("{path}: nothing came back in time")));
    }
    taken.sort_by(f64::total_cmp);
    let (count, sum) = (taken.len(), taken.iter().sum::<f64>());
    let (min, median, max) = (taken[0], taken[count / 2], taken[count - 1]);
    Ok(RoundTrips { path, count, lost, min, mean: sum / count as f64, median, max })
}

const WAITING: Depth = Depth::new(64).unwrap();
const PATIENCE: Span = Span::from_secs(30);
