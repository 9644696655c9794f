//! Clusters that configure themselves: ids and etags from a broker on one of the nodes.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, Chance, FaultModel, StationId, VirtualInstant};
use cosmic_core::broker::{Broker, BrokerRole, BrokerTiming, Nodes, Subjects};
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::client::ConfigurationEvent;
use cosmic_core::event_layer::{
    Channel, Depth, Event, ExceptionKind, Filter, HardAttributes, Policy, Publication, PublishError,
    SoftAttributes, Subscription,
};
use cosmic_core::membership::{InterestEvent, MemberEvent};
use cosmic_core::protocol::Rank;
use cosmic_core::services::{self, News, NodeServices, Services};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_core::{NodeUid, Subject};
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

type Full = NodeServices<64, 128, 16, 64, Option<Broker<16, 32>>>;

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: TxNode::new(1).unwrap(),
        len: 2,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(10),
        phase: Duration::from_millis(0),
    }],
);

static OTHER_CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[],
);

const HARD: Channel<u16> = Channel::hard(
    Subject::new(0xA).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 },
);
const SOFT_ATTRIBUTES: SoftAttributes =
    SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) };
const SOFT: Channel<u32> = Channel::soft(Subject::new(0xB).unwrap(), SOFT_ATTRIBUTES);
/// The same subject with another content.
const CONTRADICTION: Channel<i16> = Channel::soft(Subject::new(0xB).unwrap(), SOFT_ATTRIBUTES);

#[derive(Default)]
struct Journal {
    configured: HashMap<u8, TxNode>,
    received: HashMap<u8, u32>,
    hard: HashMap<u8, u32>,
    news: Vec<(u8, News)>,
    exceptions: Vec<(u8, ExceptionKind)>,
}

type Shared = Rc<RefCell<Journal>>;

/// Node 1 publishes on both channels, the others subscribe.
struct App {
    number: u8,
    contradicts: bool,
    journal: Shared,
    hard: Option<Publication<u16>>,
    soft: Option<Publication<u32>>,
    hard_in: Option<Subscription<u16>>,
    soft_in: Option<Subscription<u32>>,
    wrong_in: Option<Subscription<i16>>,
}

impl Application<Full> for App {
    fn start(&mut self, node: &mut Access<'_, Full>) -> Instant {
        let fifo = Policy::Fifo(Depth::new(8).unwrap());
        if self.number == 1 {
            self.hard = node.announce(&HARD).ok();
            self.soft = Some(node.announce(&SOFT).unwrap());
        } else if self.contradicts {
            self.wrong_in = Some(node.subscribe(&CONTRADICTION, Filter::ALL, fifo).unwrap());
        } else {
            self.hard_in = node.subscribe(&HARD, Filter::ALL, fifo).ok();
            self.soft_in = Some(node.subscribe(&SOFT, Filter::ALL, fifo).unwrap());
        }
        node.now + Duration::from_millis(5)
    }

    fn wake(&mut self, node: &mut Access<'_, Full>) -> Instant {
        if let Some(soft) = &self.soft {
            match node.publish(soft, &Event::new(1)) {
                Ok(()) | Err(PublishError::NotBound) => {}
                Err(error) => panic!("{error:?}"),
            }
        }
        if let Some(hard) = &self.hard {
            let _ = node.publish(hard, &Event::new(2));
        }
        node.now + Duration::from_millis(10)
    }

    fn notified(&mut self, node: &mut Access<'_, Full>) {
        let mut journal = self.journal.borrow_mut();
        while let Some(news) = node.half().services_mut().take_news() {
            if let News::Configuration(ConfigurationEvent::Configured(tx_node)) = news {
                journal.configured.insert(self.number, tx_node);
            }
            journal.news.push((self.number, news));
        }
        while let Some(exception) = node.take_exception() {
            journal.exceptions.push((self.number, exception.kind));
        }
        if let Some(subscription) = &self.soft_in {
            while node.next(subscription).is_some() {
                *journal.received.entry(self.number).or_default() += 1;
            }
        }
        if let Some(subscription) = &self.hard_in {
            while node.next(subscription).is_some() {
                *journal.hard.entry(self.number).or_default() += 1;
            }
        }
    }
}

#[derive(Clone, Copy)]
struct Kind {
    number: u8,
    fixed: Option<u8>,
    broker: bool,
    contradicts: bool,
    calendar: &'static Calendar,
}

impl Kind {
    /// A plain subscriber that asks the broker for everything.
    fn plain(number: u8) -> Self {
        Self { number, fixed: None, broker: false, contradicts: false, calendar: &CALENDAR }
    }

    /// The publisher, with a fixed TxNode because of the calendar, and a broker.
    fn publisher() -> Self {
        Self { fixed: Some(1), broker: true, ..Self::plain(1) }
    }
}

fn uid(number: u8) -> NodeUid {
    NodeUid::new(0xC05_0000 + u64::from(number)).unwrap()
}

fn config(kind: Kind, journal: &Shared) -> NodeConfig<Full> {
    let journal = journal.clone();
    NodeConfig {
        name: format!("node {}", kind.number),
        tx_node: kind.fixed.and_then(TxNode::new),
        calendar: kind.calendar,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(20_000 * i32::from(kind.number) - 60_000)),
        services: Box::new(move |now| {
            let config = services::NodeConfig {
                tx_node: kind.fixed.and_then(TxNode::new),
                noise: u64::from(kind.number),
                clock: SyncConfig { rank: Rank::new(kind.number - 1), ..SyncConfig::DEFAULT },
                ..services::NodeConfig::new(uid(kind.number))
            };
            let broker = kind
                .broker
                .then(|| Broker::new(uid(kind.number), BrokerTiming::DEFAULT, Nodes::new(), Subjects::new()));
            Full::new(&config, kind.calendar, broker, now).unwrap()
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || {
            Box::new(App {
                number: kind.number,
                contradicts: kind.contradicts,
                journal: journal.clone(),
                hard: None,
                soft: None,
                hard_in: None,
                soft_in: None,
                wrong_in: None,
            })
        }),
    }
}

fn start(kinds: &[Kind], faults: FaultModel) -> (Cluster<Full>, Vec<StationId>, Shared) {
    let journal = Shared::default();
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, faults), 5);
    let stations: Vec<_> = kinds.iter().map(|kind| cluster.add(config(*kind, &journal))).collect();
    for station in &stations {
        cluster.power_on(*station);
    }
    (cluster, stations, journal)
}

fn after(cluster: &Cluster<Full>, milliseconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(cluster.now().as_ticks() + milliseconds * 1_000_000)
}

fn run(cluster: &mut Cluster<Full>, milliseconds: u64) {
    let until = after(cluster, milliseconds);
    cluster.run_until(until);
}

#[test]
fn a_cluster_configures_itself_and_all_classes_flow() {
    let kinds = [Kind::publisher(), Kind::plain(2), Kind::plain(3), Kind::plain(4)];
    let (mut cluster, _, journal) = start(&kinds, FaultModel::none());
    run(&mut cluster, 5_000);
    let journal = journal.borrow();
    let mut ids: Vec<_> = journal.configured.values().map(|tx_node| tx_node.get()).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), 4, "{:?}", journal.configured);
    for number in 2..=4 {
        assert!(journal.received[&number] > 350, "{:?}", journal.received);
        assert!(journal.hard[&number] > 250, "{:?}", journal.hard);
    }
    // Everybody heard of everybody, and the publisher of the interest in its channel.
    for number in 1..=4 {
        let joined = journal
            .news
            .iter()
            .filter(|(node, news)| *node == number && matches!(news, News::Member(MemberEvent::Joined(_))));
        assert_eq!(joined.count(), 3);
    }
    let wanted = |news: &News| matches!(news, News::Interest(InterestEvent::Begun { .. }));
    assert!(journal.news.iter().any(|(node, news)| *node == 1 && wanted(news)));
}

#[test]
fn the_same_under_bit_errors() {
    let faults = FaultModel::seeded(3).with_inversion(Chance::new(0.05).unwrap());
    let kinds = [Kind::publisher(), Kind::plain(2), Kind::plain(3), Kind::plain(4)];
    let (mut cluster, _, journal) = start(&kinds, faults);
    run(&mut cluster, 8_000);
    let journal = journal.borrow();
    assert_eq!(journal.configured.len(), 4);
    for number in 2..=4 {
        assert!(journal.received[&number] > 600, "{:?}", journal.received);
    }
}

#[test]
fn a_dead_node_is_missed_and_a_restarted_one_gets_its_old_id() {
    let kinds = [Kind::publisher(), Kind::plain(2), Kind::plain(3)];
    let (mut cluster, stations, journal) = start(&kinds, FaultModel::none());
    run(&mut cluster, 3_000);
    let id = journal.borrow().configured[&3];
    cluster.power_off(stations[2]);
    run(&mut cluster, 3_000);
    let silent = (1, News::Member(MemberEvent::Silent(id)));
    assert!(journal.borrow().news.contains(&silent));
    journal.borrow_mut().configured.remove(&3);
    cluster.power_on(stations[2]);
    run(&mut cluster, 2_000);
    assert_eq!(journal.borrow().configured.get(&3), Some(&id));
}

#[test]
fn a_standby_takes_over_and_bindings_stay() {
    let standby = Kind { broker: true, ..Kind::plain(2) };
    let kinds = [Kind::publisher(), standby, Kind::plain(3), Kind::plain(4)];
    let (mut cluster, stations, journal) = start(&kinds[..3], FaultModel::none());
    run(&mut cluster, 4_000);
    let etag = cluster.visit(stations[2], |node| node.half().services().etag_of(SOFT.subject())).unwrap();
    assert!(etag.is_some());
    cluster.power_off(stations[0]);
    run(&mut cluster, 4_000);
    let role = cluster.visit(stations[1], |node| node.half().services().broker().as_ref().map(Broker::role));
    assert_eq!(role, Some(Some(BrokerRole::Active)));
    // A newcomer is served by the standby, with the same etag.
    let newcomer = cluster.add(config(kinds[3], &journal));
    cluster.power_on(newcomer);
    run(&mut cluster, 3_000);
    let again = cluster.visit(newcomer, |node| node.half().services().etag_of(SOFT.subject())).unwrap();
    assert_eq!(again, etag);
}

#[test]
fn nodes_with_different_layouts_are_told() {
    let wrong = Kind { contradicts: true, ..Kind::plain(2) };
    let (mut cluster, _, journal) = start(&[Kind::publisher(), wrong], FaultModel::none());
    run(&mut cluster, 3_000);
    let journal = journal.borrow();
    for number in [1, 2] {
        assert!(journal.exceptions.contains(&(number, ExceptionKind::LayoutMismatch)), "{number}");
    }
}

#[test]
fn two_nodes_with_one_tx_node_are_told_and_one_gives_way() {
    let intruder = Kind { fixed: Some(1), ..Kind::plain(2) };
    let (mut cluster, stations, journal) = start(&[Kind::publisher(), intruder], FaultModel::none());
    run(&mut cluster, 5_000);
    let told = journal.borrow().exceptions.iter().any(|(_, kind)| *kind == ExceptionKind::DuplicateTxNode);
    assert!(told, "{:?}", journal.borrow().exceptions);
    let ids: Vec<_> = (stations.iter())
        .map(|station| cluster.visit(*station, |node| node.half().services().tx_node()).unwrap())
        .collect();
    assert_ne!(ids[0], ids[1], "{ids:?}");
}

#[test]
fn a_node_with_another_calendar_keeps_silent_and_says_so() {
    let other = Kind { calendar: &OTHER_CALENDAR, ..Kind::plain(2) };
    let publisher = Kind::publisher();
    let (mut cluster, stations, journal) = start(&[publisher, other, Kind::plain(3)], FaultModel::none());
    run(&mut cluster, 4_000);
    let inhibited =
        |cluster: &mut Cluster<Full>, station| cluster.visit(station, |node| node.hard().is_inhibited());
    assert_eq!(inhibited(&mut cluster, stations[1]), Some(true));
    assert_eq!(inhibited(&mut cluster, stations[2]), Some(false));
    assert!(journal.borrow().hard[&3] > 100);
    let told = (2, ExceptionKind::CalendarMismatch);
    assert!(journal.borrow().exceptions.contains(&told), "{:?}", journal.borrow().exceptions);
}

/// The trait is what the test needs of the type parameter.
const _: fn() = || {
    fn services<S: Services>() {}
    services::<Full>();
};

/// An event that is published before the one before it was sent takes its place, and the publisher hears so.
#[test]
fn a_replaced_event_is_an_exception() {
    let (mut cluster, stations, journal) = start(&[Kind::publisher(), Kind::plain(2)], FaultModel::none());
    run(&mut cluster, 3_000);
    let count = |journal: &Shared| {
        let replaced = |it: &&(u8, ExceptionKind)| **it == (1, ExceptionKind::EventReplaced);
        journal.borrow().exceptions.iter().filter(replaced).count()
    };
    let before = count(&journal);
    cluster.visit(stations[0], |node| {
        let again = node.announce(&HARD).unwrap();
        for value in 0..3 {
            node.publish(&again, &Event::new(value)).unwrap();
        }
    });
    run(&mut cluster, 20);
    assert!(count(&journal) >= before + 2);
}
