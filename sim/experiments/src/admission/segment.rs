//! A segment in virtual time: nodes that publish as early and as often as their rates let them, and a judge who sees the
//! bus.

use super::planned::{BROKERS, NODES, Offered, PUBLISHER, Planned, soft_channels};
use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{Bus, FaultModel, StationId, VirtualInstant};
use cosmic_core::admission::AdmissionTiming;
use cosmic_core::broker::{Broker, BrokerTiming, Nodes, Subjects};
use cosmic_core::can::{Etag, Frame, TxNode};
use cosmic_core::client::AdmissionState;
use cosmic_core::event_layer::{AnnounceError, Channel, Event, HardAttributes, Publication, PublishError};
use cosmic_core::services::{self, AdmittingBroker, NodeServices};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_core::{NodeUid, Subject};
use cosmic_plan::cluster::PlannedClass;
use std::cell::RefCell;
use std::collections::{HashMap, VecDeque};
use std::rc::Rc;

/// Channels that can be admitted.
pub(super) const ADMITTED: usize = 40;

type Services = NodeServices<64, 128, 16, 128, Option<AdmittingBroker<16, 64, ADMITTED>>>;
type Node<'n> = Access<'n, Services>;

/// A publication, whatever the length of its events.
trait Published {
    fn publish(&self, node: &mut Node<'_>) -> Result<(), PublishError>;
    fn cancel(self: Box<Self>, node: &mut Node<'_>);
}

impl<const LEN: usize> Published for Publication<[u8; LEN]> {
    fn publish(&self, node: &mut Node<'_>) -> Result<(), PublishError> {
        // Close to the longest frame of this length.
        node.publish(self, &Event::new([0x0F; LEN]))
    }

    fn cancel(self: Box<Self>, node: &mut Node<'_>) {
        node.cancel_publication(*self);
    }
}

fn announce<const LEN: usize>(
    node: &mut Node<'_>,
    offered: &Offered,
) -> Result<Box<dyn Published>, AnnounceError> {
    let channel: Channel<[u8; LEN]> =
        Channel::soft(offered.subject, offered.attributes()).with_rate(offered.rate);
    Ok(Box::new(node.announce(&channel)?))
}

/// A channel that a node publishes, with the bucket of tokens that its node has, too.
struct Sender {
    node: usize,
    subject: Subject,
    interval: Duration,
    tolerance: Duration,
    /// `None`: that of the calendar.
    deadline: Option<Duration>,
    published: Box<dyn Published>,
    /// The nominal instant of the next event.
    nominal: Instant,
    /// Nothing before this instant.
    not_before: Instant,
    pausing: bool,
}

impl Sender {
    fn due_at(&self) -> Instant {
        let earliest = Instant::from_epoch(self.nominal.saturating_since(Instant::EPOCH + self.tolerance));
        if self.pausing { Instant::FAR_FUTURE } else { earliest.max(self.not_before) }
    }
}

/// What all nodes share with the one who judges.
#[derive(Default)]
struct Shared {
    senders: Vec<Sender>,
    /// Events on their way, by TxNode and etag, with when they are to be sent at the latest. A channel's are sent in their
    /// order.
    under_way: HashMap<(u8, Etag), VecDeque<VirtualInstant>>,
    refused: u64,
}

struct App {
    node: usize,
    shared: Rc<RefCell<Shared>>,
}

impl Application<Services> for App {
    fn start(&mut self, node: &mut Node<'_>) -> Instant {
        self.shared.borrow_mut().senders.retain(|sender| sender.node != self.node);
        node.now
    }

    fn wake(&mut self, node: &mut Node<'_>) -> Instant {
        let now = node.now;
        let mut shared = self.shared.borrow_mut();
        let Shared { senders, under_way, refused } = &mut *shared;
        let mut next = now + TICK;
        for sender in senders.iter_mut().filter(|sender| sender.node == self.node) {
            while now >= sender.due_at() {
                match sender.published.publish(node) {
                    Ok(()) => {
                        let etag = node.half().services().etag_of(sender.subject);
                        if let (Some(etag), Some(deadline)) = (etag, sender.deadline) {
                            let events = under_way.entry((number(sender.node), etag)).or_default();
                            events.push_back(node.true_now + deadline);
                        }
                    }
                    Err(_) => *refused += 1,
                }
                sender.nominal = sender.nominal.max(now) + sender.interval;
            }
            next = next.min(sender.due_at());
        }
        next
    }

    fn notified(&mut self, node: &mut Node<'_>) {
        while node.half().services_mut().take_news().is_some() {}
        while node.take_exception().is_some() {}
    }
}

/// What the judge has seen.
#[derive(Clone, Copy, Default)]
pub(super) struct Seen {
    pub(super) sent: u64,
    pub(super) late: u64,
    /// Events of channels that may be published, and were not taken.
    pub(super) refused: u64,
}

pub(super) struct Segment {
    cluster: Cluster<Services>,
    stations: Vec<StationId>,
    shared: Rc<RefCell<Shared>>,
    trace: Vec<TraceEvent>,
    seen: Seen,
}

impl Segment {
    /// The nodes of a plan, switched on; they ask for what is not planned, or not.
    pub(super) fn new(planned: &Planned, seed: u64, asks: bool) -> Self {
        let mut bus = Bus::new(planned.cluster.segment.bit_rate, FaultModel::none());
        bus.record_trace(true);
        let shared = Rc::<RefCell<Shared>>::default();
        let mut cluster = Cluster::new(bus, seed);
        let stations: Vec<StationId> =
            (0..NODES.len()).map(|at| cluster.add(node(planned, at, asks, &shared))).collect();
        let mut new = Self { cluster, stations, shared, trace: Vec::new(), seen: Seen::default() };
        for station in new.stations.clone() {
            new.cluster.power_on(station);
            new.run(Duration::from_millis(3));
        }
        new.announce_what_is_planned(planned);
        new
    }

    pub(super) fn run(&mut self, span: Duration) {
        self.cluster.run_until(self.cluster.now() + span);
        self.cluster.bus().take_trace(&mut self.trace);
        let mut shared = self.shared.borrow_mut();
        for event in self.trace.drain(..) {
            let TraceKind::FrameEnd { frame, .. } = event.kind else { continue };
            let Ok(frame) = Frame::try_from(frame) else { continue };
            let key = (frame.id.tx_node().get(), frame.id.etag());
            let Some(latest) = shared.under_way.get_mut(&key).and_then(VecDeque::pop_front) else { continue };
            self.seen.sent += 1;
            self.seen.late += u64::from(event.at > latest);
        }
        self.seen.refused = shared.refused;
    }

    /// What the judge has seen. Events that are not sent, though they should be by now, count as late.
    pub(super) fn seen(&self) -> Seen {
        let now = self.cluster.now();
        let shared = self.shared.borrow();
        let late = shared.under_way.values().flatten().filter(|latest| now > **latest).count();
        Seen { late: self.seen.late + late as u64, ..self.seen }
    }

    /// What is planned is published from now on.
    pub(super) fn begin(&mut self) {
        self.shared.borrow_mut().senders.iter_mut().for_each(|sender| sender.pausing = false);
    }

    /// A node announces a channel, which it publishes when it may.
    pub(super) fn announce(&mut self, node: usize, offered: &Offered) -> Result<(), AnnounceError> {
        let shared = Rc::clone(&self.shared);
        let announced = self.cluster.visit(self.stations[node], |access| {
            let published = match offered.len {
                2 => announce::<2>(access, offered),
                5 => announce::<5>(access, offered),
                _ => announce::<8>(access, offered),
            }?;
            shared.borrow_mut().senders.push(Sender {
                node,
                subject: offered.subject,
                interval: offered.rate.interval(),
                tolerance: offered.rate.tolerance(),
                deadline: Some(offered.deadline),
                published,
                nominal: access.now,
                not_before: access.now,
                pausing: true,
            });
            Ok(())
        });
        announced.unwrap_or(Ok(()))
    }

    pub(super) fn state(&mut self, node: usize, subject: Subject) -> Option<AdmissionState> {
        self.cluster.visit(self.stations[node], |node| node.half().services().admission_of(subject)).flatten()
    }

    pub(super) fn is_bound(&mut self, node: usize, subject: Subject) -> bool {
        let etag = |node: &mut Node<'_>| node.half().services().etag_of(subject);
        self.cluster.visit(self.stations[node], etag).flatten().is_some()
    }

    /// It may be published from now on, or not.
    pub(super) fn let_publish(&mut self, subject: Subject, may: bool) {
        let mut shared = self.shared.borrow_mut();
        shared.senders.iter_mut().filter(|it| it.subject == subject).for_each(|it| it.pausing = !may);
    }

    pub(super) fn cancel(&mut self, subject: Subject) {
        let mut shared = self.shared.borrow_mut();
        let Some(at) = shared.senders.iter().position(|sender| sender.subject == subject) else { return };
        let Sender { node, published, .. } = shared.senders.swap_remove(at);
        drop(shared);
        self.cluster.visit(self.stations[node], |access| published.cancel(access));
    }

    /// All channels rest until their buckets are full, and then publish at the same instant.
    pub(super) fn synchronise(&mut self, rest: Duration) {
        let mut nodes = Vec::new();
        for station in &self.stations {
            nodes.push(self.cluster.visit(*station, |node| node.now).unwrap_or(Instant::EPOCH) + rest);
        }
        for sender in &mut self.shared.borrow_mut().senders {
            sender.not_before = nodes[sender.node];
        }
    }

    /// The node with this broker is off from now on.
    pub(super) fn switch_off(&mut self, node: usize) {
        self.cluster.power_off(self.stations[node]);
    }

    fn announce_what_is_planned(&mut self, planned: &Planned) {
        for (_, offered) in soft_channels(&planned.cluster) {
            let _it_is_in_the_plan = self.announce(PUBLISHER, &offered);
        }
        for channel in planned.cluster.channels.iter() {
            let (PlannedClass::Hard { omission_degree, .. }, Some(etag)) = (&channel.class, channel.etag)
            else {
                continue;
            };
            let Some(subject) = Subject::new(channel.subject) else { continue };
            let period = channel.recurrence.span();
            let attributes = HardAttributes { period, periodic: true, omission_degree: *omission_degree };
            let hard: Channel<[u8; 8]> = Channel::hard(subject, etag, attributes);
            let shared = Rc::clone(&self.shared);
            self.cluster.visit(self.stations[PUBLISHER], |access| {
                let Ok(publication) = access.announce(&hard) else { return };
                shared.borrow_mut().senders.push(Sender {
                    node: PUBLISHER,
                    subject,
                    interval: period,
                    tolerance: Duration::from_ticks(0),
                    deadline: None,
                    published: Box::new(publication),
                    nominal: access.now,
                    not_before: access.now,
                    pausing: true,
                });
            });
        }
    }
}

fn number(node: usize) -> u8 {
    node as u8 + 1
}

fn node(planned: &Planned, at: usize, asks: bool, shared: &Rc<RefCell<Shared>>) -> NodeConfig<Services> {
    let of = &planned.cluster.nodes[at];
    let (tx_node, uid) = (of.tx_node, NodeUid::new(of.uid).expect("a UID that is not zero"));
    let (calendar, admission) = (planned.calendar, planned.admission);
    let sync = planned.cluster.sync().unwrap_or(SyncConfig::DEFAULT);
    let clock = SyncConfig { rank: of.rank, calendar_digest: calendar.digest(), ..sync };
    let shared = Rc::clone(shared);
    NodeConfig {
        name: of.name.clone(),
        tx_node: Some(tx_node),
        calendar,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(10_000 * at as i32 - 20_000)),
        services: Box::new(move |now| {
            let config = services::NodeConfig {
                tx_node: Some(tx_node),
                noise: at as u64,
                clock,
                admission: asks.then_some(admission),
                admission_timing: &TIMING,
                ..services::NodeConfig::new(uid)
            };
            let broker = (at < BROKERS).then(|| {
                let broker = Broker::new(uid, BrokerTiming::DEFAULT, Nodes::new(), Subjects::new());
                AdmittingBroker::new(broker, Some(admission), TIMING)
            });
            Services::new(&config, calendar, broker, now).expect("the settings of the plan are right")
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || Box::new(App { node: at, shared: Rc::clone(&shared) })),
    }
}

/// What is refused is given up here, and not asked for again.
const TIMING: AdmissionTiming =
    AdmissionTiming { refused: Duration::from_secs(3600), ..AdmissionTiming::DEFAULT };

/// How often an application looks whether it has a new channel.
const TICK: Duration = Duration::from_millis(1);

const _: () = assert!(TxNode::MAX.get() as usize > NODES.len());
