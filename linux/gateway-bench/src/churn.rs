//! Subjects that come and go: what a gateway keeps of them.
//!
//! A participant on IP and a node on the gateway's segment announce and subscribe to subjects, each for a moment, and never
//! again. Gateway, participant and node live in this process, whose allocator counts; so what any of them keeps shows.

use std::fmt;
use std::time::Duration as Span;

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::{Channel, Policy, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_core::{NodeUid, Subject};
use cosmic_gateway::Gateway;
use cosmic_gateway::config::{Config, Ip, Mode};
use cosmic_gateway::ip;
use cosmic_gateway::keys::{Keys, Name};
use cosmic_linux::Node;
use cosmic_linux::link::segment::SegmentLink;
use serde::Serialize;
use zenoh::sample::Locality;

use crate::alone;
use crate::config::{self, Setup, free_port, subject_of};
use crate::cost::Cost;
use crate::failed::Failed;
use crate::latency::PATIENCE;
use crate::wire::Wire;

/// Who lets subjects come and go.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub enum Who {
    /// A node on a segment.
    OnSegment,
    /// A participant on IP that stays.
    Staying,
    /// A session of zenoh that stays, with publishers and subscribers of zenoh: what is left of these is not ours.
    StayingAlone,
    /// Participants on IP, each of which leaves after some subjects.
    Leaving,
    /// Sessions of zenoh that do so.
    LeavingAlone,
}

impl Who {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::OnSegment, Self::Staying, Self::StayingAlone, Self::Leaving, Self::LeavingAlone];

    const fn words(self) -> &'static str {
        match self {
            Self::OnSegment => "on a segment",
            Self::Leaving => "on IP, by participants that leave",
            Self::Staying => "on IP, by one that stays",
            Self::StayingAlone => "zenoh alone, by a session that stays",
            Self::LeavingAlone => "zenoh alone, by sessions that leave",
        }
    }
}

/// What was left of some subjects.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub struct Left {
    /// Who let them come and go.
    pub who: Who,
    /// How many.
    pub subjects: usize,
    /// Bytes in use before, when some had come and gone already.
    pub before: u64,
    /// Bytes in use after.
    pub after: u64,
}

impl Left {
    /// Bytes that were left of a subject; below zero: there were less than before.
    pub fn of_subject(&self) -> f64 {
        (self.after as f64 - self.before as f64) / self.subjects as f64
    }
}

/// What was found.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Churn {
    /// By who let subjects come and go.
    pub left: Vec<Left>,
}

impl Churn {
    fn of(&self, who: Who) -> f64 {
        self.left.iter().find(|left| left.who == who).map_or(0.0, Left::of_subject)
    }

    /// What is left that should not be. zenoh numbers each key that a session declares, and keeps the number for as long as
    /// the session, at both ends: that is not ours. Its tables double now and then, so the two are not equal to the byte.
    pub fn broken(&self) -> Vec<String> {
        let beyond = |who: Who, alone: f64| (who, self.of(who), MOST + alone * 1.1);
        let all = [
            beyond(Who::OnSegment, 0.0),
            beyond(Who::Staying, self.of(Who::StayingAlone)),
            beyond(Who::Leaving, self.of(Who::LeavingAlone)),
        ];
        let too_much = all.into_iter().filter(|(_, bytes, most)| bytes > most);
        let tell = |(who, bytes, most): (Who, f64, f64)| {
            format!("{}: {bytes:.0} bytes left of a subject, not {most:.0} at most", who.words())
        };
        too_much.map(tell).collect()
    }
}

impl fmt::Display for Churn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "memory: subjects that are announced and subscribed to for a moment, and never again")?;
        for left in &self.left {
            let megabytes = |bytes: u64| bytes as f64 / 1e6;
            let (before, after) = (megabytes(left.before), megabytes(left.after));
            writeln!(
                f,
                "  {:<37} {:>6} subjects, {before:.3} MB in use before, {after:.3} MB after: {:.1} bytes a subject",
                left.who.words(),
                left.subjects,
                left.of_subject()
            )?;
        }
        Ok(())
    }
}

/// Lets so many subjects come and go, in each of these ways. Who has left is remembered for a minute; `forgotten`: how long
/// is waited for that.
///
/// # Errors
/// Something does not start.
pub fn measure(subjects: usize, ways: &[Who], forgotten: Span) -> Result<Churn, Failed> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(Failed::at("no threads"))?;
    let folder = tempfile::tempdir().map_err(Failed::at("no folder"))?;
    runtime.block_on(async {
        let bed = Bed::start(folder.path()).await?;
        let (mut left, mut next) = (Vec::new(), 0);
        for &who in ways {
            // What is allocated once, and tables that grow to their size.
            let warm = (subjects / 5).max(2 * OF_EACH);
            let patience = match who {
                Who::Leaving | Who::LeavingAlone => forgotten,
                _ => UNDER_WAY,
            };
            bed.come_and_go(who, next..next + warm).await?;
            let before = settled(patience).await;
            bed.come_and_go(who, next + warm..next + warm + subjects).await?;
            left.push(Left { who, subjects, before, after: settled(patience).await });
            next += warm + subjects;
        }
        Ok(Churn { left })
    })
}

/// The least that is in use within some time.
async fn settled(patience: Span) -> u64 {
    let begun = std::time::Instant::now();
    let mut least = u64::MAX;
    while begun.elapsed() < patience {
        tokio::time::sleep(Span::from_millis(50)).await;
        least = least.min(Cost::now().live);
    }
    least
}

struct Bed {
    _wire: Wire,
    _gateway: Gateway,
    desk: ip::Node,
    /// Where participants join.
    ip: Ip,
    endpoint: (&'static str, String),
    alone: zenoh::Session,
    node: Node,
}

impl Bed {
    async fn start(folder: &std::path::Path) -> Result<Self, Failed> {
        let wire = Wire::serve(&folder.join("churn"), |_, _| {})?;
        let port = free_port()?;
        let segments = [("west".to_owned(), wire.path().to_owned())];
        let channels = [config::Channel::between(0, "west", "west")];
        let mode = "router";
        let setup =
            Setup { mode, listen: Some(port), connect: None, segments: &segments, channels: &channels };
        let file = setup.write(folder, "churn")?;
        let config = Config::read(&file).map_err(|problems| Failed(problems.to_string()))?;
        let gateway = Gateway::start(&config).await.map_err(Failed::at("the gateway"))?;
        let ip = Ip { mode: Mode::Peer, connect: vec![format!("tcp/127.0.0.1:{port}")], ..Ip::default() };
        let desk = join(&ip, "stays").await?;
        let endpoint = ("connect/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]"));
        let alone = alone::session("peer", std::slice::from_ref(&endpoint))?;
        let uid = NodeUid::new(7).unwrap_or(NodeUid::MIN);
        let tx_node = TxNode::new(7).unwrap_or(TxNode::MIN);
        // A wire carries to one, and the gateway is that: this node is on a wire of its own.
        let own = Wire::serve(&folder.join("churn-node"), |_, _| {})?;
        let of_node = cosmic_linux::Config::new(uid).tx_node(tx_node);
        let node = Node::start(of_node, SegmentLink::new(own.path())).map_err(Failed::at("the node"))?;
        let begun = std::time::Instant::now();
        while desk.others().1 == 0 || !gateway.leads(&name("west")?) {
            if begun.elapsed() > PATIENCE {
                return Err(Failed("the gateway does not begin".to_owned()));
            }
            tokio::time::sleep(Span::from_millis(20)).await;
        }
        Ok(Self { _wire: wire, _gateway: gateway, desk, ip, endpoint, alone, node })
    }

    async fn come_and_go(&self, who: Who, numbers: std::ops::Range<usize>) -> Result<(), Failed> {
        match who {
            Who::OnSegment => {
                for number in numbers {
                    self.on_segment(&channel(number)?)?;
                    // Others on the segment are told that it is gone, then there is room for the next.
                    tokio::time::sleep(Span::from_millis(2)).await;
                }
                Ok(())
            }
            Who::Leaving => {
                for first in numbers.clone().step_by(OF_EACH) {
                    let node = join(&self.ip, "guest").await?;
                    for number in first..numbers.end.min(first + OF_EACH) {
                        on_ip(&node, &channel(number)?).await?;
                    }
                    node.stop().await;
                }
                Ok(())
            }
            Who::Staying => {
                for number in numbers {
                    on_ip(&self.desk, &channel(number)?).await?;
                }
                Ok(())
            }
            Who::StayingAlone => {
                for number in numbers {
                    alone_on_ip(&self.alone, channel(number)?.subject()).await?;
                }
                Ok(())
            }
            Who::LeavingAlone => {
                for first in numbers.clone().step_by(OF_EACH) {
                    let session = alone::session("peer", std::slice::from_ref(&self.endpoint))?;
                    // As each participant has them, under keys of its own.
                    let (token, clock) = (format!("bench/live/{first}"), format!("bench/clock/{first}"));
                    let token = session.liveliness().declare_token(token).await;
                    let _token = token.map_err(Failed::at("zenoh"))?;
                    let clock = session.declare_queryable(clock).callback(|_| {}).await;
                    let _clock = clock.map_err(Failed::at("zenoh"))?;
                    for number in first..numbers.end.min(first + OF_EACH) {
                        alone_on_ip(&session, channel(number)?.subject()).await?;
                    }
                    session.close().await.map_err(Failed::at("zenoh"))?;
                }
                Ok(())
            }
        }
    }

    fn on_segment(&self, channel: &Channel<u32>) -> Result<(), Failed> {
        let publisher = self.node.announce(channel).map_err(Failed::at("announce"))?;
        let subscriber = self.node.subscribe(channel, Policy::Latest).map_err(Failed::at("subscribe"))?;
        // That it is refused is all one.
        let _ = publisher.publish(1);
        drop((publisher, subscriber));
        Ok(())
    }
}

async fn on_ip(node: &ip::Node, channel: &Channel<u32>) -> Result<(), Failed> {
    let publisher = node.announce(channel).await.map_err(Failed::at("announce"))?;
    let subscriber = node.subscribe(channel, Policy::Latest).await.map_err(Failed::at("subscribe"))?;
    let _ = publisher.publish(1);
    drop((publisher, subscriber));
    Ok(())
}

/// What zenoh is told of a subject by [`on_ip`], without us.
async fn alone_on_ip(session: &zenoh::Session, subject: Subject) -> Result<(), Failed> {
    let keys = Keys::new(&name(config::NETWORK)?);
    let publisher = session.declare_publisher(keys.event(subject, &name("alone")?));
    let publisher = publisher.allowed_destination(Locality::Remote).express(true).await;
    let publisher = publisher.map_err(Failed::at("zenoh"))?;
    let listener = publisher.matching_listener().callback(|_| {}).background().await;
    listener.map_err(Failed::at("zenoh"))?;
    publisher.matching_status().await.map_err(Failed::at("zenoh"))?;
    let subscriber = session.declare_subscriber(keys.events(subject)).allowed_origin(Locality::Remote);
    let subscriber = subscriber.callback(|_| {}).await.map_err(Failed::at("zenoh"))?;
    publisher.put(vec![0; 52]).await.map_err(Failed::at("zenoh"))?;
    drop((publisher, subscriber));
    Ok(())
}

async fn join(ip: &Ip, as_name: &str) -> Result<ip::Node, Failed> {
    ip::Node::start(ip, &name(config::NETWORK)?, &name(as_name)?).await.map_err(Failed::at("a participant"))
}

fn name(text: &str) -> Result<Name, Failed> {
    Name::new(text).ok_or_else(|| Failed(format!("{text:?} is no name")))
}

/// A subject that no gateway is configured for: what it is told of it is for the others.
fn channel(number: usize) -> Result<Channel<u32>, Failed> {
    let quality =
        SoftAttributes { deadline: Duration::from_millis(100), validity: Duration::from_millis(200) };
    let subject = Subject::new(subject_of(1000) + number as u64);
    let subject = subject.ok_or_else(|| Failed("no subject".to_owned()))?;
    Ok(Channel::soft(subject, quality).with_etag(Etag::BOUND_LAST))
}

/// Bytes that a subject may leave beyond what it leaves of zenoh: an allocator rounds, and buffers differ in size from instant to instant.
pub const MOST: f64 = 64.0;
/// What was under way has arrived by then.
const UNDER_WAY: Span = Span::from_secs(2);
/// By then nothing is remembered of who has left.
pub const FORGOTTEN: Span = Span::from_secs(65);
/// Subjects of a participant that leaves.
const OF_EACH: usize = 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_zenoh_keeps_is_not_ours() {
        let left = |who, after| Left { who, subjects: 100, before: 5000, after };
        let churn = |staying, alone| Churn {
            left: vec![
                left(Who::OnSegment, 4000),
                left(Who::Staying, staying),
                left(Who::StayingAlone, alone),
            ],
        };
        assert!(churn(205_000, 204_000).broken().is_empty());
        assert_eq!(
            churn(205_000, 105_000).broken(),
            ["on IP, by one that stays: 2000 bytes left of a subject, not 1164 at most"]
        );
    }
}
