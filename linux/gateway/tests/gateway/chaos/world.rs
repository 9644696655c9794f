//! Two segments, two gateways of the west and one of the east, ways between them, a stranger on IP.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration as Span;

use cosmic_core::Subject;
use cosmic_core::event_layer::{Channel, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_gateway::Gateway;
use cosmic_gateway::clock::Reading;
use cosmic_gateway::counters::{Counters, Direction, Outcome};
use cosmic_gateway::encoding::Envelope;
use cosmic_linux::{Node, Publisher, Subscriber};
use cosmic_wan::{State, Way};
use tokio::task::JoinHandle;
use tokio::time::Instant;

use super::Step;
use super::judge::{Account, Far, Heard, Kill, Verdict};
use crate::bed::{PATIENCE, Segment, Setup, Stranger, fifo, frames_at, name, port, until};

/// Of commands, reports and noise.
pub(super) const DEADLINE: Duration = Duration::from_millis(100);
pub(super) const VALIDITY: Span = Span::from_millis(200);
/// From west to east, from east to west, from the stranger to both.
pub(super) const TAGS: [u8; 3] = [0xA0, 0xB0, 0xC0];
/// In milliseconds, and the burst: what the table says.
pub(super) const RATES: [(u64, u64); 3] = [(5, 5), (5, 5), (20, 3)];
const TABLE: &str = r#"
[[channel]]
name = "command"
subject = "0xC05A0000000000A0"
class = "soft"
deadline = "100 ms"
validity = "200 ms"
interval = "5 ms"
burst = 5
longest-wait = "5 ms"
from = ["west"]

[[channel]]
name = "report"
subject = "0xC05A0000000000B0"
class = "soft"
deadline = "100 ms"
validity = "200 ms"
interval = "5 ms"
burst = 5
longest-wait = "5 ms"
from = ["east"]

[[channel]]
name = "noise"
subject = "0xC05A0000000000C0"
class = "soft"
deadline = "100 ms"
validity = "200 ms"
interval = "20 ms"
burst = 3
longest-wait = "5 ms"
"#;
const ETAGS_OF_EAST: &str = "etags = { command = 7000, report = 7001, noise = 7002, gateways = 7003 }";

/// A gateway's place in the world.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Station {
    /// Of the west, with its broker.
    First,
    /// Of the west.
    Second,
    East,
}

impl Station {
    const ALL: [Self; 3] = [Self::First, Self::Second, Self::East];

    const fn segment(self) -> &'static str {
        match self {
            Self::First | Self::Second => "west",
            Self::East => "east",
        }
    }

    /// West is zero.
    pub(super) const fn side(self) -> usize {
        matches!(self, Self::East) as usize
    }

    const fn tx_node(self) -> u8 {
        match self {
            Self::First | Self::East => 100,
            Self::Second => 101,
        }
    }
}

/// What a gateway has counted, also of those that are gone.
#[derive(Clone)]
pub(super) struct Counted {
    pub(super) station: Station,
    pub(super) outgoing: Counters,
    pub(super) incoming: Counters,
    pub(super) of_ip: Counters,
}

/// Events of a publisher: when each was published, by its number.
type Published = Arc<Mutex<Vec<Instant>>>;

pub(super) struct World {
    west: Segment,
    east: Segment,
    folder: tempfile::TempDir,
    listen: [u16; 3],
    ways: [Way; 2],
    gateways: [Option<Gateway>; 3],
    counted: Vec<Counted>,
    stranger: Stranger,
    nodes: [Node; 2],
    _subscribers: Vec<Subscriber<u32>>,
    tasks: Vec<JoinHandle<()>>,
    /// Of commands, reports, noise.
    published: [Published; 3],
    /// In the west, in the east.
    heard: [Heard; 2],
    /// What the stranger has sent, with nonsense and what is stale.
    sent: u64,
    stale: Vec<u32>,
    /// What nodes have told that was to come to the west, and to the east, and was not sent or not fetched in time.
    of_nodes: [u64; 2],
    /// Around these instants events may have died with a gateway.
    kills: Vec<Kill>,
}

fn channel(tag: u8) -> Channel<u32> {
    let subject = Subject::new(0xC05A_0000_0000_0000 + u64::from(tag)).unwrap();
    let validity = Duration::from_ticks(VALIDITY.as_nanos() as u64);
    Channel::soft(subject, SoftAttributes { deadline: DEADLINE, validity })
}

fn in_east(tag: u8) -> Channel<u32> {
    let at = TAGS.iter().position(|it| *it == tag).unwrap();
    channel(tag).with_etag(cosmic_core::can::Etag::new(7000 + at as u16).unwrap())
}

pub(super) const fn content(tag: u8, number: usize) -> u32 {
    (tag as u32) << 24 | number as u32
}

/// Publishes every ten milliseconds.
async fn publish(publisher: Publisher<u32>, tag: u8, published: Published) {
    publisher.bound().await;
    loop {
        {
            let mut published = published.lock().unwrap();
            if publisher.publish(content(tag, published.len())).is_ok() {
                published.push(Instant::now());
            }
        }
        tokio::time::sleep(Span::from_millis(10)).await;
    }
}

/// Writes down what gateways publish on a segment.
async fn hear(segment: PathBuf, heard: Heard) {
    let (begun, tap) =
        (Instant::now(), cosmic_linux::Tap::start(cosmic_linux::link::segment::SegmentLink::new(segment)));
    loop {
        for (at, frame) in frames_at(&tap) {
            let content = <[u8; 4]>::try_from(frame.payload.as_slice()).ok().map(u32::from_be_bytes);
            if let Some(content) = content.filter(|_| frame.id.tx_node().get() >= 100) {
                let at = begun
                    + Span::from_nanos(at.saturating_since(cosmic_core::time::Instant::EPOCH).as_ticks());
                heard.lock().unwrap().push(Far { content, at });
            }
        }
        tokio::time::sleep(Span::from_millis(5)).await;
    }
}

impl World {
    pub(super) async fn start() -> Self {
        let (west, east) = (Segment::start().await, Segment::start().await);
        let listen = [port(), port(), port()];
        let ways = [Way::to(([127, 0, 0, 1], listen[0]).into()), Way::to(([127, 0, 0, 1], listen[1]).into())];
        let [first, second] = ways;
        let ways = [first.await.unwrap(), second.await.unwrap()];
        let mut tasks = Vec::new();
        let heard = [&west, &east].map(|bus| {
            let heard = Heard::default();
            tasks.push(tokio::spawn(hear(bus.path.clone(), Arc::clone(&heard))));
            heard
        });
        let nodes = [west.node(1), east.node(1)];
        let published = [Published::default(), Published::default(), Published::default()];
        let subscribers = vec![
            nodes[0].subscribe(&channel(TAGS[1]), fifo(1)).unwrap(),
            nodes[0].subscribe(&channel(TAGS[2]), fifo(1)).unwrap(),
            nodes[1].subscribe(&in_east(TAGS[0]), fifo(1)).unwrap(),
            nodes[1].subscribe(&in_east(TAGS[2]), fifo(1)).unwrap(),
        ];
        let publishers =
            [nodes[0].announce(&channel(TAGS[0])).unwrap(), nodes[1].announce(&in_east(TAGS[1])).unwrap()];
        let folder = tempfile::tempdir().unwrap();
        let mut gateways = [None, None, None];
        let mut counted = Vec::new();
        for station in Station::ALL {
            let gateway = start(station, &west, &east, &folder, listen, &ways).await;
            counted.push(count(station, &gateway));
            gateways[station as usize] = Some(gateway);
        }
        let stranger = Stranger::start(listen[2], "stranger").await;
        for (publisher, at) in publishers.into_iter().zip(0..) {
            tasks.push(tokio::spawn(publish(publisher, TAGS[at], Arc::clone(&published[at]))));
        }
        let world = Self {
            west,
            east,
            folder,
            listen,
            ways,
            gateways,
            counted,
            stranger,
            nodes,
            of_nodes: [0; 2],
            _subscribers: subscribers,
            tasks,
            published,
            heard,
            sent: 0,
            stale: Vec::new(),
            kills: Vec::new(),
        };
        world.crosses().await;
        world
    }

    /// Waits until commands and reports of now cross.
    async fn crosses(&self) {
        // Commands are heard in the east, reports in the west.
        for ((tag, published), heard) in TAGS.iter().zip(&self.published).zip(self.heard.iter().rev()) {
            let from = content(*tag, published.lock().unwrap().len());
            let is_new = |far: &Far| far.content >= from && far.content >> 24 == u32::from(*tag);
            until("it crosses", || heard.lock().unwrap().iter().any(is_new)).await;
        }
    }

    pub(super) async fn calm(&self) {
        self.crosses().await;
        tokio::time::sleep(Span::from_millis(500)).await;
    }

    pub(super) async fn take(&mut self, step: Step) {
        match step {
            Step::Cut(span) => self.interrupt(State::Cut, span).await,
            Step::Stall(span) => self.interrupt(State::Stalled, span).await,
            Step::Slow(there, back) => {
                for way in &self.ways {
                    way.delay(cosmic_wan::Direction::There, there);
                    way.delay(cosmic_wan::Direction::Back, back);
                }
            }
            Step::Kill { station, pause, forgets } => self.kill(station, pause, forgets).await,
            Step::Babble => self.babble().await,
            Step::ClockSteps(milliseconds) => {
                self.stranger.ahead.store(milliseconds * 1_000_000, std::sync::atomic::Ordering::Relaxed);
                // Until it has been asked.
                tokio::time::sleep(Span::from_millis(1800)).await;
                self.babble().await;
            }
        }
    }

    async fn interrupt(&self, state: State, span: Span) {
        self.ways.iter().for_each(|way| way.set(state));
        tokio::time::sleep(span).await;
        self.ways.iter().for_each(|way| way.set(State::Open));
    }

    async fn kill(&mut self, station: Station, pause: Span, forgets: bool) {
        let at = Instant::now();
        if let Some(gateway) = self.gateways[station as usize].take() {
            self.ask(gateway.node(&name(station.segment())).unwrap(), station.side());
        }
        tokio::time::sleep(pause).await;
        if forgets {
            let _ = std::fs::remove_file(self.folder.path().join("table"));
        }
        let listen = self.listen[station as usize];
        until("its port is free", || std::net::TcpListener::bind(("127.0.0.1", listen)).is_ok()).await;
        let gateway = start(station, &self.west, &self.east, &self.folder, self.listen, &self.ways).await;
        let counted = count(station, &gateway);
        until("it reads again", || {
            counted.outgoing.get(Outcome::StandingBy) + counted.outgoing.get(Outcome::Forwarded) > 0
        })
        .await;
        // The other gateway of the west goes on.
        let until = if station == Station::East { Instant::now() } else { at };
        self.kills.push(Kill { at, until });
        self.counted.push(counted);
        self.gateways[station as usize] = Some(gateway);
        if station == Station::East {
            // The stranger has lost its connection, and the east does not know its clock.
            tokio::time::sleep(Span::from_millis(1500)).await;
        }
    }

    /// What a node of a side has told.
    fn ask(&mut self, node: &Node, side: usize) {
        for (at, tag) in TAGS.iter().enumerate() {
            let counters = node.channel_counters(channel(*tag).subject()).unwrap_or_default();
            if at == side {
                self.of_nodes[1 - side] += u64::from(counters.discarded + counters.overflowed);
            } else {
                self.of_nodes[side] += u64::from(counters.discarded);
            }
        }
    }

    /// Half a second of events, fresh and stale, some of them twice, and of nonsense.
    async fn babble(&mut self) {
        for round in 0..50 {
            for _ in 0..4 {
                let number = {
                    let mut noise = self.published[2].lock().unwrap();
                    noise.push(Instant::now());
                    noise.len() - 1
                };
                let number = content(TAGS[2], number);
                let mut envelope = self.envelope(number);
                if round % 5 == 4 {
                    envelope.sent_at = Reading(envelope.sent_at.0 - 1_000_000_000);
                    self.stale.push(number);
                }
                self.put(&envelope).await;
                if round % 10 == 7 {
                    self.put(&envelope).await;
                }
            }
            if round % 10 == 0 {
                let key = self.stranger.keys.event(channel(TAGS[2]).subject(), &self.stranger.segment);
                self.stranger.put_bytes(&key, vec![round; 60]).await;
                self.sent += 1;
            }
            tokio::time::sleep(Span::from_millis(10)).await;
        }
        // On their way.
        tokio::time::sleep(Span::from_millis(500)).await;
    }

    fn envelope(&self, number: u32) -> Envelope {
        let validity = Some(Duration::from_ticks(VALIDITY.as_nanos() as u64));
        Envelope {
            to_deadline: Some(DEADLINE),
            to_expiry: validity,
            ..self.stranger.envelope(self.sent, &number.to_be_bytes())
        }
    }

    async fn put(&mut self, envelope: &Envelope) {
        self.stranger.put(channel(TAGS[2]).subject(), envelope).await;
        self.sent += 1;
    }

    /// All is well again; then all ends.
    pub(super) async fn end(mut self) -> Verdict {
        self.crosses().await;
        self.tasks.drain(2..).for_each(|task| task.abort());
        tokio::time::sleep(VALIDITY + Span::from_millis(800)).await;
        let published = self.published.each_ref().map(|it| it.lock().unwrap().clone());
        let heard = self.heard.each_ref().map(|it| it.lock().unwrap().clone());
        let kills = std::mem::take(&mut self.kills);
        for station in Station::ALL {
            let gateway = self.gateways[station as usize].as_ref().unwrap();
            let node = gateway.node(&name(station.segment())).unwrap().clone();
            self.ask(&node, station.side());
        }
        for (side, node) in self.nodes.clone().iter().enumerate() {
            self.ask(node, side);
        }
        let verdict = Verdict {
            account: Account {
                counted: std::mem::take(&mut self.counted),
                of_nodes: self.of_nodes,
                sent: self.sent,
                kills,
            },
            published,
            heard,
            stale: std::mem::take(&mut self.stale),
        };
        for gateway in self.gateways.iter_mut().filter_map(Option::take) {
            let _ = tokio::time::timeout(PATIENCE, gateway.stop()).await;
        }
        verdict
    }
}

async fn start(
    station: Station,
    west: &Segment,
    east: &Segment,
    folder: &tempfile::TempDir,
    listen: [u16; 3],
    ways: &[Way; 2],
) -> Gateway {
    let broker = format!("broker = {:?}", folder.path().join("table"));
    let (bus, more, connect) = match station {
        Station::First => (west, broker.as_str(), vec![]),
        Station::Second => (west, "", vec![listen[0]]),
        Station::East => (east, ETAGS_OF_EAST, ways.iter().map(|way| way.address().port()).collect()),
    };
    let (segment, tx_node) = (station.segment(), station.tx_node());
    let listen = listen[station as usize];
    Setup { segment, bus, tx_node, listen, connect: &connect, more, channels: TABLE }.start().await
}

fn count(station: Station, gateway: &Gateway) -> Counted {
    let of = |direction| gateway.counters(&name(station.segment()), direction).unwrap().clone();
    let (outgoing, incoming) = (of(Direction::Out), of(Direction::In));
    Counted { station, outgoing, incoming, of_ip: gateway.unassigned().clone() }
}
