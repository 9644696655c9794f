//! Channels that the plan does not know, in whole clusters: asked for, admitted, refused, held over fail-over, cuts, lost
//! frames and hostile questions.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{Bus, Chance, FaultModel, StationId, VirtualInstant, WireFrame};
use cosmic_core::admission::{
    AdmissionPlan, AdmissionTiming, CalendarDemand, Faults, Reservations, Unplanned,
};
use cosmic_core::broker::{Broker, BrokerRole, BrokerTiming, Nodes, Subjects};
use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Etag, Frame, TxNode};
use cosmic_core::client::{AdmissionEvent, AdmissionState};
use cosmic_core::event_layer::{
    AnnounceError, Channel, Event, EventRate, ExceptionKind, Publication, PublishError, SoftAttributes,
};
use cosmic_core::protocol::{
    AdmissionReply, AdmissionRequest, AdmissionVerdict, AskNumber, CoarseSpan, Rank, RefusalReason,
};
use cosmic_core::services::{self, AdmittingBroker, News, NodeServices};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_core::{NodeUid, Subject};
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

const ADMITTED: usize = 8;
type Full = NodeServices<64, 128, 16, 64, Option<AdmittingBroker<16, 32, ADMITTED>>>;

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[],
);

const fn plan(unplanned: Unplanned) -> AdmissionPlan {
    AdmissionPlan {
        unplanned,
        planned: &[],
        reservations: Reservations {
            bit_rate: BitRate::MAX,
            priority_step: Duration::from_micros(160),
            reload: Duration::from_micros(5),
            slow_refill: false,
            faults: Faults::None,
            calendar: CalendarDemand::NONE,
            above: &[],
            soft: &[],
            guarded: &[],
        },
    }
}

static ASK: AdmissionPlan = plan(Unplanned::Ask);
static REFUSE: AdmissionPlan = plan(Unplanned::Refuse);
static NON_REAL_TIME: AdmissionPlan = plan(Unplanned::NonRealTime);

/// What the nodes did and heard.
#[derive(Default)]
struct Journal {
    news: Vec<(u8, AdmissionEvent)>,
    exceptions: Vec<(u8, ExceptionKind)>,
    publishing: HashMap<(u8, u64), Publishing>,
}

struct Publishing {
    publication: Publication<u64>,
    interval: Duration,
    next: Instant,
    taken: u32,
    refused: Vec<(VirtualInstant, PublishError)>,
}

type Shared = Rc<RefCell<Journal>>;

struct App {
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

struct Bed {
    cluster: Cluster<Full>,
    stations: Vec<StationId>,
    journal: Shared,
}

fn uid(number: u8) -> NodeUid {
    NodeUid::new(0xC05_0000 + u64::from(number)).unwrap()
}

fn node(number: u8, brokers: u8, plan: &'static AdmissionPlan, journal: &Shared) -> NodeConfig<Full> {
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

fn channel(subject: u64, interval: Duration, deadline: Duration) -> Channel<u64> {
    let validity = Duration::from_ticks(deadline.as_ticks() * 4);
    Channel::soft(Subject::new(subject).unwrap(), SoftAttributes { deadline, validity })
        .with_rate(EventRate::sporadic(interval).with_jitter(Duration::from_micros(500)))
}

const fn us(microseconds: u64) -> Duration {
    Duration::from_micros(microseconds)
}

impl Bed {
    /// Nodes with the numbers 1 to `nodes`, of which the first host brokers.
    fn new(nodes: u8, brokers: u8, plan: &'static AdmissionPlan, faults: FaultModel) -> Self {
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

    fn station(&self, number: u8) -> StationId {
        self.stations[usize::from(number) - 1]
    }

    fn run(&mut self, milliseconds: u64) {
        let until = VirtualInstant::from_ticks(self.cluster.now().as_ticks() + milliseconds * 1_000_000);
        self.cluster.run_until(until);
    }

    fn announce(&mut self, number: u8, channel: Channel<u64>) -> Result<(), AnnounceError> {
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

    fn cancel(&mut self, number: u8, subject: u64) {
        let one = self.journal.borrow_mut().publishing.remove(&(number, subject)).unwrap();
        self.cluster.visit(self.station(number), |node| node.cancel_publication(one.publication));
    }

    fn state(&mut self, number: u8, subject: u64) -> Option<AdmissionState> {
        let subject = Subject::new(subject).unwrap();
        self.cluster
            .visit(self.station(number), |node| node.half().services().admission_of(subject))
            .flatten()
    }

    fn is_admitted(&mut self, number: u8, subject: u64) -> bool {
        matches!(self.state(number, subject), Some(AdmissionState::Admitted(_)))
    }

    /// What the active broker has admitted, by node.
    fn table(&mut self) -> Vec<u8> {
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

    fn refused(&self, number: u8, subject: u64) -> Vec<PublishError> {
        let journal = self.journal.borrow();
        journal.publishing[&(number, subject)].refused.iter().map(|(_, error)| *error).collect()
    }

    fn forget_refusals(&self) {
        self.journal.borrow_mut().publishing.values_mut().for_each(|one| one.refused.clear());
    }

    fn taken(&self, number: u8, subject: u64) -> u32 {
        self.journal.borrow().publishing[&(number, subject)].taken
    }

    fn none_was_late(&self) {
        let late = [ExceptionKind::MissedDeadline, ExceptionKind::ValidityExpired];
        assert!(!self.journal.borrow().exceptions.iter().any(|(_, kind)| late.contains(kind)));
    }

    fn frames(&mut self, etag: Etag) -> Vec<Frame> {
        let mut trace: Vec<TraceEvent> = Vec::new();
        self.cluster.bus().take_trace(&mut trace);
        let ends = trace.iter().filter_map(|event| match event.kind {
            TraceKind::FrameEnd { frame, .. } => Frame::try_from(frame).ok(),
            _ => None,
        });
        ends.filter(|frame| frame.id.etag() == etag).collect()
    }

    /// Three nodes publish a channel each, which together take four fifths of the bus.
    fn with_three_admitted(&mut self) {
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

    fn all_three_go_on(&mut self) {
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
    fn a_fourth_is_refused(&mut self) {
        self.announce(6, channel(6, us(500), us(3_000))).unwrap();
        self.run(1_000);
        assert!(matches!(self.state(6, 6), Some(AdmissionState::Refused(_))), "{:?}", self.state(6, 6));
        assert_eq!(self.taken(6, 6), 0);
        self.cancel(6, 6);
    }
}

#[test]
fn a_channel_is_published_when_it_is_admitted_and_frees_its_place_when_it_is_given_up() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    bed.announce(3, channel(0xB, us(10_000), us(5_000))).unwrap();
    // A broker that has just started first hears what is held.
    bed.run(1_000);
    assert_eq!(bed.state(3, 0xB), Some(AdmissionState::Waiting));
    bed.run(1_500);
    assert!(bed.is_admitted(3, 0xB));
    let refused = bed.refused(3, 0xB);
    assert!(refused.contains(&PublishError::NotBound) && refused.contains(&PublishError::NotAdmitted));
    // Now an answer takes milliseconds.
    bed.announce(4, channel(0xC, us(10_000), us(5_000))).unwrap();
    bed.run(20);
    assert!(bed.is_admitted(4, 0xC));
    assert_eq!(bed.table(), [3, 4]);
    bed.forget_refusals();
    // Beyond the lease, which is renewed.
    bed.run(25_000);
    assert_eq!(bed.table(), [3, 4]);
    assert!(bed.taken(3, 0xB) > 2_400 && bed.refused(3, 0xB).is_empty());
    bed.cancel(3, 0xB);
    bed.run(20);
    assert_eq!(bed.table(), [4]);
    bed.none_was_late();
}

#[test]
fn a_refusal_says_why_and_what_would_fit() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    bed.run(2_500);
    bed.announce(3, channel(0xB, us(150), us(2_000))).unwrap();
    bed.run(300);
    let Some(AdmissionState::Refused(refusal)) = bed.state(3, 0xB) else { panic!("{:?}", bed.state(3, 0xB)) };
    assert_eq!(refusal.reason, RefusalReason::Utilisation);
    assert_eq!(bed.taken(3, 0xB), 0);
    assert!(bed.journal.borrow().exceptions.contains(&(3, ExceptionKind::NotAdmitted)));
    // What is said to fit fits.
    let interval = refusal.fits_at.unwrap().duration();
    bed.cancel(3, 0xB);
    bed.announce(3, channel(0xB, interval, us(2_000))).unwrap();
    bed.run(100);
    assert!(bed.is_admitted(3, 0xB));
    // Another whose deadline is shorter than the frame that may be before it; and one that makes the first late.
    bed.announce(4, channel(0xC, us(50_000), us(200))).unwrap();
    bed.run(300);
    let Some(AdmissionState::Refused(refusal)) = bed.state(4, 0xC) else { panic!("it is refused") };
    assert_eq!((refusal.reason, refusal.fits_at), (RefusalReason::Blocking, None));
    bed.announce(
        4,
        channel(0xD, us(100_000), us(1_000)).with_rate(EventRate::sporadic(us(100_000)).with_burst(12)),
    )
    .unwrap();
    bed.run(300);
    let Some(AdmissionState::Refused(refusal)) = bed.state(4, 0xD) else { panic!("it is refused") };
    assert!(matches!(refusal.reason, RefusalReason::Late | RefusalReason::OtherLate), "{refusal:?}");
    bed.none_was_late();
}

#[test]
fn what_states_no_rate_or_is_out_of_range_cannot_be_asked_for() {
    let mut bed = Bed::new(3, 1, &ASK, FaultModel::none());
    let attributes = SoftAttributes { deadline: us(5_000), validity: us(5_000) };
    let plain: Channel<u64> = Channel::soft(Subject::new(0xB).unwrap(), attributes);
    assert_eq!(bed.announce(3, plain), Err(AnnounceError::NoRate));
    let jumpy =
        plain.with_rate(EventRate::sporadic(us(5_000)).with_jitter(Duration::from_secs(3600 * 24 * 30)));
    assert_eq!(bed.announce(3, jumpy), Err(AnnounceError::NotAskable));
    // It did not stay behind.
    bed.announce(3, channel(0xB, us(5_000), us(5_000))).unwrap();
}

#[test]
fn what_was_admitted_outlives_the_broker() {
    let mut bed = Bed::new(6, 2, &ASK, FaultModel::none());
    bed.with_three_admitted();
    bed.cluster.power_off(bed.station(1));
    // The lease passes, and the standby is broker now.
    bed.run(12_000);
    bed.all_three_go_on();
    bed.a_fourth_is_refused();
    // The first comes back: one of the two stays.
    bed.cluster.power_on(bed.station(1));
    bed.run(12_000);
    bed.all_three_go_on_but_for_refused_fourth();
}

impl Bed {
    fn all_three_go_on_but_for_refused_fourth(&mut self) {
        self.journal.borrow_mut().news.retain(|(number, _)| *number != 6);
        self.all_three_go_on();
    }
}

#[test]
fn a_broker_that_restarts_at_once_learns_what_is_held_before_it_admits_more() {
    for pause in [5, 100, 700] {
        let mut bed = Bed::new(6, 1, &ASK, FaultModel::none());
        bed.with_three_admitted();
        bed.cluster.power_off(bed.station(1));
        bed.run(pause);
        bed.cluster.power_on(bed.station(1));
        bed.run(5);
        bed.announce(6, channel(6, us(500), us(3_000))).unwrap();
        bed.run(12_000);
        assert!(matches!(bed.state(6, 6), Some(AdmissionState::Refused(_))), "{:?}", bed.state(6, 6));
        assert_eq!(bed.taken(6, 6), 0, "after a pause of {pause} ms");
        bed.all_three_go_on_but_for_refused_fourth();
    }
}

#[test]
fn without_any_broker_what_was_admitted_goes_on_and_nothing_else_begins() {
    let mut bed = Bed::new(6, 1, &ASK, FaultModel::none());
    bed.with_three_admitted();
    bed.cluster.power_off(bed.station(1));
    bed.run(1_500);
    bed.announce(6, channel(6, us(50_000), us(3_000))).unwrap();
    bed.run(30_000);
    for number in 3..=5 {
        assert_eq!(bed.refused(number, number.into()), []);
    }
    assert_eq!((bed.state(6, 6), bed.taken(6, 6)), (Some(AdmissionState::Waiting), 0));
    bed.cancel(6, 6);
    bed.cluster.power_on(bed.station(1));
    bed.run(12_000);
    bed.all_three_go_on_but_for_refused_fourth();
}

#[test]
fn a_node_that_falls_silent_frees_its_place() {
    let mut bed = Bed::new(6, 1, &ASK, FaultModel::none());
    bed.with_three_admitted();
    bed.cluster.power_off(bed.station(4));
    bed.run(11_000);
    assert_eq!(bed.table(), [3, 5]);
    bed.announce(6, channel(6, us(600), us(3_000))).unwrap();
    bed.run(300);
    assert!(bed.is_admitted(6, 6));
}

#[test]
fn frames_that_are_lost_cost_time_only() {
    let faults = FaultModel::seeded(9)
        .with_inversion(Chance::new(0.02).unwrap())
        .with_omission(Chance::new(0.02).unwrap());
    let mut bed = Bed::new(6, 2, &ASK, faults);
    bed.run(3_000);
    for number in 3..=5 {
        bed.announce(number, channel(u64::from(number), us(2_000), us(8_000))).unwrap();
    }
    bed.run(2_000);
    bed.forget_refusals();
    bed.cluster.power_off(bed.station(1));
    bed.run(12_000);
    for number in 3..=5 {
        assert!(bed.is_admitted(number, number.into()));
        assert_eq!(bed.refused(number, number.into()), []);
    }
    assert_eq!(bed.table(), [3, 4, 5]);
}

#[test]
fn two_halves_that_admitted_too_much_together_find_out() {
    let mut bed = Bed::new(6, 2, &ASK, FaultModel::none());
    bed.run(2_500);
    // Each half asks while the other is off the bus, and has a broker.
    for number in [2, 5, 6] {
        bed.cluster.disconnect(bed.station(number));
    }
    for number in [3, 4] {
        bed.announce(number, channel(u64::from(number), us(500), us(3_000))).unwrap();
    }
    bed.run(500);
    assert!(bed.is_admitted(3, 3) && bed.is_admitted(4, 4));
    for number in [1, 3, 4] {
        bed.cluster.disconnect(bed.station(number));
    }
    for number in [2, 5, 6] {
        bed.cluster.connect(bed.station(number));
    }
    for number in [5, 6] {
        bed.announce(number, channel(u64::from(number), us(500), us(3_000))).unwrap();
    }
    bed.run(5_000);
    assert!(bed.is_admitted(5, 5) && bed.is_admitted(6, 6));
    for number in [1, 3, 4] {
        bed.cluster.connect(bed.station(number));
    }
    bed.run(8_000);
    let admitted = (3..=6).filter(|number| bed.is_admitted(*number, (*number).into())).count();
    // Three of them fit.
    assert_eq!((admitted, bed.table().len()), (3, 3));
    // From then on none is late.
    bed.journal.borrow_mut().exceptions.clear();
    bed.run(5_000);
    bed.none_was_late();
}

#[test]
fn without_a_broker_the_plan_decides() {
    let mut bed = Bed::new(3, 1, &REFUSE, FaultModel::none());
    assert_eq!(bed.announce(3, channel(0xB, us(5_000), us(5_000))), Err(AnnounceError::OutsidePlan));

    let mut bed = Bed::new(3, 1, &NON_REAL_TIME, FaultModel::none());
    let etag = Etag::new(0x1234).unwrap();
    bed.announce(3, channel(0xB, us(5_000), us(5_000)).with_etag(etag)).unwrap();
    // Its id is claimed first.
    bed.run(100);
    bed.forget_refusals();
    bed.run(1_000);
    assert_eq!(bed.refused(3, 0xB), []);
    let frames = bed.frames(etag);
    assert!(frames.len() > 190 && frames.iter().all(|frame| frame.id.priority().get() == 255));
}

/// A station that is no node of ours.
struct Stranger(StationId);

impl Stranger {
    /// Sends as many of these frames as the bus takes, for so long.
    fn flood(&self, bed: &mut Bed, milliseconds: u64, mut next: impl FnMut(u32) -> Frame) {
        for turn in 0..milliseconds as u32 * 10 {
            let now = bed.cluster.now();
            let _busy = bed.cluster.bus().load(now, self.0, 0, WireFrame::from(next(turn)));
            let until = VirtualInstant::from_ticks(now.as_ticks() + 100_000);
            bed.cluster.run_until(until);
        }
    }
}

fn question(tx_node: u8, etag: u16, interval: u64, held: bool, number: u8) -> AdmissionRequest {
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

#[test]
fn a_flood_of_questions_is_answered_within_bounds_and_others_are_served() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    let stranger = Stranger(bed.cluster.bus().attach("stranger"));
    bed.run(2_500);
    let _ = bed.frames(Etag::ADMISSION_REPLY);
    bed.announce(3, channel(0xB, us(10_000), us(5_000))).unwrap();
    // Any interval, any channel, from sixteen ids, new or held.
    stranger.flood(&mut bed, 2_000, |turn| {
        let interval = [1, 7, 200, 1_000, 100_000, 1 << 39][turn as usize % 6];
        question(100 + turn as u8 % 16, 1024 + turn as u16 % 97, interval, turn % 3 == 0, turn as u8).encode()
    });
    assert!(bed.is_admitted(3, 0xB), "{:?}", bed.state(3, 0xB));
    let replies = bed.frames(Etag::ADMISSION_REPLY);
    assert!(replies.iter().all(|frame| AdmissionReply::decode(frame).is_some()));
    assert!((10..=420).contains(&replies.len()), "{} replies in two seconds", replies.len());
    assert!(bed.table().len() <= ADMITTED);
    // When it ends, its channels do with their leases.
    bed.run(11_000);
    assert_eq!(bed.table(), [3]);
    bed.none_was_late();
}

#[test]
fn questions_that_no_node_sends_do_not_disturb_others() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    let stranger = Stranger(bed.cluster.bus().attach("stranger"));
    bed.run(2_500);
    // A frame that has bytes which no message has.
    stranger.flood(&mut bed, 100, |turn| {
        let mut frame = question(50, 1024, 1_000, false, 0).encode();
        let mut bytes = frame.payload.padded();
        bytes[turn as usize % 8] = 0xFF;
        frame = Frame::new(frame.id, cosmic_core::can::Payload::full(bytes));
        frame
    });
    bed.run(500);
    let others: Vec<u8> = bed.table().into_iter().filter(|node| *node != 50).collect();
    assert_eq!(others, []);
    bed.announce(4, channel(0xC, us(10_000), us(5_000))).unwrap();
    bed.run(100);
    assert!(bed.is_admitted(4, 0xC));
}

#[test]
fn false_answers_admit_nothing_that_was_not_asked() {
    let mut bed = Bed::new(4, 1, &ASK, FaultModel::none());
    let stranger = Stranger(bed.cluster.bus().attach("stranger"));
    bed.run(2_500);
    let lease = AdmissionTiming::DEFAULT.lease;
    let false_answers = |bed: &mut Bed| {
        stranger.flood(bed, 200, |turn| {
            let (etag, number) =
                (Etag::new(1024 + turn as u16 / 8 % 64).unwrap(), AskNumber::new(turn as u8));
            let requester = TxNode::new(3 + (turn / 512 % 2) as u8).unwrap();
            AdmissionReply { requester, etag, number, verdict: AdmissionVerdict::Admitted(lease) }.encode()
        });
    };
    // Every etag and number, to nodes that have asked nothing.
    false_answers(&mut bed);
    assert!((bed.state(3, 0xB), bed.state(4, 0xC)) == (None, None));
    assert_eq!(bed.table(), []);
    // To one that holds its channel, and has no question open.
    bed.announce(3, channel(0xB, us(10_000), us(5_000))).unwrap();
    bed.run(100);
    let held = bed.state(3, 0xB);
    assert!(matches!(held, Some(AdmissionState::Admitted(_))));
    false_answers(&mut bed);
    assert_eq!(bed.state(3, 0xB), held, "its lease is no longer than it was");
}
