//! Whole clusters whose nodes ask for channels, and what becomes of them.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{Bus, FaultModel, StationId, VirtualInstant, WireFrame};
use cosmic_core::admission::{AdmissionPlan, AdmissionTiming, Reservations, Unplanned};
use cosmic_core::broker::{Broker, BrokerRole, BrokerTiming, Nodes, Subjects};
use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Etag, Frame, TxNode};
use cosmic_core::client::{AdmissionEvent, AdmissionState};
use cosmic_core::event_layer::{
    AnnounceError, Channel, Event, EventRate, ExceptionKind, Publication, PublishError, SoftAttributes,
};
use cosmic_core::protocol::{AdmissionRequest, AskNumber, CoarseSpan, Rank};
use cosmic_core::services::{self, AdmittingBroker, News, NodeServices};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_core::{NodeUid, Subject};
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

pub(crate) const ADMITTED: usize = 8;
pub(crate) type Full = NodeServices<64, 128, 16, 64, Option<AdmittingBroker<16, 32, ADMITTED>>>;

pub(crate) static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[],
);

pub(crate) const fn plan(unplanned: Unplanned) -> AdmissionPlan {
    AdmissionPlan {
        unplanned,
        planned: &[],
        reservations: Reservations::nothing(
            BitRate::MAX,
            Duration::from_micros(160),
            Duration::from_micros(5),
        ),
    }
}

pub(crate) static ASK: AdmissionPlan = plan(Unplanned::Ask);
pub(crate) static REFUSE: AdmissionPlan = plan(Unplanned::Refuse);
pub(crate) static NON_REAL_TIME: AdmissionPlan = plan(Unplanned::NonRealTime);

/// What the nodes did and heard.
#[derive(Default)]
pub(crate) struct Journal {
    pub(crate) news: Vec<(u8, AdmissionEvent)>,
    pub(crate) exceptions: Vec<(u8, ExceptionKind)>,
    pub(crate) publishing: HashMap<(u8, u64), Publishing>,
}

pub(crate) struct Publishing {
    pub(crate) publication: Publication<u64>,
    pub(crate) interval: Duration,
    pub(crate) next: Instant,
    pub(crate) taken: u32,
    pub(crate) refused: Vec<(VirtualInstant, PublishError)>,
}

pub(crate) type Shared = Rc<RefCell<Journal>>;

pub(crate) struct App {
    number: u8,
    journal: Shared,
}

impl Application<Full> for App {
    fn start(&mut self, node: &mut Access<'_, Full>) -> Instant {
        // What it published before it was switched off is gone.
        self.journal.borrow_mut().publishing.retain(|(number, _), _| *number != self.number);
        node.now
    }

    fn wake(&mut self, node: &mut Access<'_, Full>) -> Instant {
        let mut journal = self.journal.borrow_mut();
        let own = journal.publishing.iter_mut().filter(|((number, _), _)| *number == self.number);
        let now = node.now;
        for (_, one) in own.filter(|(_, one)| now >= one.next) {
            one.next = now + one.interval;
            match node.publish(&one.publication, &Event::new(0)) {
                Ok(()) => one.taken += 1,
                Err(error) => one.refused.push((node.true_now, error)),
            }
        }
        node.now + Duration::from_micros(250)
    }

    fn notified(&mut self, node: &mut Access<'_, Full>) {
        let mut journal = self.journal.borrow_mut();
        while let Some(news) = node.half().services_mut().take_news() {
            if let News::Admission(event) = news {
                journal.news.push((self.number, event));
            }
        }
        while let Some(exception) = node.take_exception() {
            journal.exceptions.push((self.number, exception.kind));
        }
    }
}

pub(crate) struct Bed {
    pub(crate) cluster: Cluster<Full>,
    pub(crate) stations: Vec<StationId>,
    pub(crate) journal: Shared,
}

pub(crate) fn uid(number: u8) -> NodeUid {
    NodeUid::new(0xC05_0000 + u64::from(number)).unwrap()
}

pub(crate) fn node(
    number: u8,
    brokers: u8,
    plan: &'static AdmissionPlan,
    journal: &Shared,
) -> NodeConfig<Full> {
    let journal = journal.clone();
    let tx_node = TxNode::new(number);
    NodeConfig {
        name: format!("node {number}"),
        tx_node,
        calendar: &CALENDAR,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(20_000 * i32::from(number) - 60_000)),
        services: Box::new(move |now| {
            let config = services::NodeConfig {
                tx_node,
                noise: u64::from(number),
                clock: SyncConfig { rank: Rank::new(number - 1), ..SyncConfig::DEFAULT },
                admission: Some(plan),
                ..services::NodeConfig::new(uid(number))
            };
            let broker = (number <= brokers).then(|| {
                AdmittingBroker::new(
                    Broker::new(uid(number), BrokerTiming::DEFAULT, Nodes::new(), Subjects::new()),
                    Some(plan),
                    AdmissionTiming::DEFAULT,
                )
            });
            Full::new(&config, &CALENDAR, broker, now).unwrap()
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || Box::new(App { number, journal: journal.clone() })),
    }
}

pub(crate) fn channel(subject: u64, interval: Duration, deadline: Duration) -> Channel<u64> {
    let validity = Duration::from_ticks(deadline.as_ticks() * 4);
    Channel::soft(Subject::new(subject).unwrap(), SoftAttributes { deadline, validity })
        .with_rate(EventRate::sporadic(interval).with_jitter(Duration::from_micros(500)))
}

pub(crate) const fn us(microseconds: u64) -> Duration {
    Duration::from_micros(microseconds)
}

impl Bed {
    /// Nodes with the numbers 1 to `nodes`, of which the first host brokers.
    pub(crate) fn new(nodes: u8, brokers: u8, plan: &'static AdmissionPlan, faults: FaultModel) -> Self {
        let mut bus = Bus::new(BitRate::MAX, faults);
        bus.record_trace(true);
        let journal = Shared::default();
        let mut cluster = Cluster::new(bus, 7);
        let stations: Vec<_> =
            (1..=nodes).map(|number| cluster.add(node(number, brokers, plan, &journal))).collect();
        let mut bed = Self { cluster, stations, journal };
        for number in 1..=nodes {
            bed.cluster.power_on(bed.station(number));
            bed.run(3);
        }
        bed
    }

    pub(crate) fn station(&self, number: u8) -> StationId {
        self.stations[usize::from(number) - 1]
    }

    pub(crate) fn run(&mut self, milliseconds: u64) {
        let until = VirtualInstant::from_ticks(self.cluster.now().as_ticks() + milliseconds * 1_000_000);
        self.cluster.run_until(until);
    }

    pub(crate) fn announce(&mut self, number: u8, channel: Channel<u64>) -> Result<(), AnnounceError> {
        let journal = self.journal.clone();
        let announced = self.cluster.visit(self.station(number), |node| {
            let publication = node.announce(&channel)?;
            let interval = channel.rate().map_or(us(1_000), |rate| rate.interval());
            let one = Publishing { publication, interval, next: node.now, taken: 0, refused: Vec::new() };
            journal.borrow_mut().publishing.insert((number, channel.subject().get()), one);
            Ok(())
        });
        announced.expect("it is on")
    }

    pub(crate) fn cancel(&mut self, number: u8, subject: u64) {
        let one = self.journal.borrow_mut().publishing.remove(&(number, subject)).unwrap();
        self.cluster.visit(self.station(number), |node| node.cancel_publication(one.publication));
    }

    pub(crate) fn state(&mut self, number: u8, subject: u64) -> Option<AdmissionState> {
        let subject = Subject::new(subject).unwrap();
        self.cluster
            .visit(self.station(number), |node| node.half().services().admission_of(subject))
            .flatten()
    }

    pub(crate) fn is_admitted(&mut self, number: u8, subject: u64) -> bool {
        matches!(self.state(number, subject), Some(AdmissionState::Admitted(_)))
    }

    /// What the active broker has admitted, by node.
    pub(crate) fn table(&mut self) -> Vec<u8> {
        let mut tables = Vec::new();
        for number in 1..=2 {
            let table = self.cluster.visit(self.station(number), |node| {
                let broker = node.half().services().broker().as_ref()?;
                (broker.broker().role() == BrokerRole::Active).then(|| {
                    broker
                        .control()
                        .unwrap()
                        .table()
                        .admitted()
                        .map(|one| one.ask.tx_node.get())
                        .collect::<Vec<_>>()
                })
            });
            tables.extend(table.flatten());
        }
        assert_eq!(tables.len(), 1, "one broker is active");
        let mut table = tables.remove(0);
        table.sort_unstable();
        table
    }

    pub(crate) fn refused(&self, number: u8, subject: u64) -> Vec<PublishError> {
        let journal = self.journal.borrow();
        journal.publishing[&(number, subject)].refused.iter().map(|(_, error)| *error).collect()
    }

    pub(crate) fn forget_refusals(&self) {
        self.journal.borrow_mut().publishing.values_mut().for_each(|one| one.refused.clear());
    }

    pub(crate) fn taken(&self, number: u8, subject: u64) -> u32 {
        self.journal.borrow().publishing[&(number, subject)].taken
    }

    pub(crate) fn none_was_late(&self) {
        let late = [ExceptionKind::MissedDeadline, ExceptionKind::ValidityExpired];
        assert!(!self.journal.borrow().exceptions.iter().any(|(_, kind)| late.contains(kind)));
    }

    pub(crate) fn frames(&mut self, etag: Etag) -> Vec<Frame> {
        let mut trace: Vec<TraceEvent> = Vec::new();
        self.cluster.bus().take_trace(&mut trace);
        let ends = trace.iter().filter_map(|event| match event.kind {
            TraceKind::FrameEnd { frame, .. } => Frame::try_from(frame).ok(),
            _ => None,
        });
        ends.filter(|frame| frame.id.etag() == etag).collect()
    }

    /// Three nodes publish a channel each, which together take four fifths of the bus.
    pub(crate) fn with_three_admitted(&mut self) {
        self.run(2_500);
        for number in 3..=5 {
            self.announce(number, channel(u64::from(number), us(600), us(3_000))).unwrap();
        }
        self.run(300);
        for number in 3..=5 {
            assert!(self.is_admitted(number, number.into()), "{:?}", self.state(number, number.into()));
        }
        assert_eq!(self.table(), [3, 4, 5]);
        self.forget_refusals();
    }

    pub(crate) fn all_three_go_on(&mut self) {
        for number in 3..=5 {
            assert!(self.is_admitted(number, number.into()));
            assert_eq!(self.refused(number, number.into()), []);
        }
        assert_eq!(self.table(), [3, 4, 5]);
        let lapsed = |(_, event): &(u8, AdmissionEvent)| !matches!(event, AdmissionEvent::Admitted(_));
        assert!(!self.journal.borrow().news.iter().any(lapsed), "{:?}", self.journal.borrow().news);
        self.none_was_late();
    }

    /// Node 6 asks for what does not fit beside the three.
    pub(crate) fn a_fourth_is_refused(&mut self) {
        self.announce(6, channel(6, us(500), us(3_000))).unwrap();
        self.run(1_000);
        assert!(matches!(self.state(6, 6), Some(AdmissionState::Refused(_))), "{:?}", self.state(6, 6));
        assert_eq!(self.taken(6, 6), 0);
        self.cancel(6, 6);
    }
}

impl Bed {
    pub(crate) fn all_three_go_on_but_for_refused_fourth(&mut self) {
        self.journal.borrow_mut().news.retain(|(number, _)| *number != 6);
        self.all_three_go_on();
    }
}

/// A station that is no node of ours.
pub(crate) struct Stranger(pub(crate) StationId);

impl Stranger {
    /// Sends as many of these frames as the bus takes, for so long.
    pub(crate) fn flood(&self, bed: &mut Bed, milliseconds: u64, mut next: impl FnMut(u32) -> Frame) {
        for turn in 0..milliseconds as u32 * 10 {
            let now = bed.cluster.now();
            let _busy = bed.cluster.bus().load(now, self.0, 0, WireFrame::from(next(turn)));
            let until = VirtualInstant::from_ticks(now.as_ticks() + 100_000);
            bed.cluster.run_until(until);
        }
    }
}

pub(crate) fn question(tx_node: u8, etag: u16, interval: u64, held: bool, number: u8) -> AdmissionRequest {
    AdmissionRequest {
        tx_node: TxNode::new(tx_node).unwrap(),
        etag: Etag::new(etag).unwrap(),
        number: AskNumber::new(number),
        held,
        len: 8,
        interval: CoarseSpan::floor(us(interval)),
        tolerance: CoarseSpan::floor(us(interval)),
        deadline: CoarseSpan::floor(us(interval)),
    }
}
