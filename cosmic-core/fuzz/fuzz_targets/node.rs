//! A whole node on any frames and calls: no panic, an end to every `poll`, a wake-up that lies ahead, no load
//! into a mailbox that is taken, and hard real-time frames in their own mailbox only.
#![no_main]

use cosmic_core::admission::{AdmissionPlan, AdmissionTiming, Reservations, Unplanned};
use cosmic_core::broker::{Broker, BrokerTiming, Nodes, Subjects};
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{
    BitRate, Command, ErrorCounters, Etag, Frame, Id, Mailbox, Outcome, Priority, TxNode,
};
use cosmic_core::event_half::{self, Due, EventHalf, Input, Step, receive};
use cosmic_core::event_layer::{
    Channel, Depth, Event, EventRate, Filter, HardAttributes, Importance, NonRealTimeAttributes, Policy,
    Publication, SoftAttributes, Subscription,
};
use cosmic_core::network::hard::{self, Dispatcher, HrtBuffers};
use cosmic_core::protocol::Rank;
use cosmic_core::services::{AdmittingBroker, NodeConfig, NodeServices};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_core_fuzz::{Act, Script, drain, subject, tx_node, uid};
use libfuzzer_sys::fuzz_target;

type Services = NodeServices<4, 8, 3, 4, Option<AdmittingBroker<4, 4, 2>>>;
type Half = EventHalf<4, 4, 6, 8, 5, 5, Services>;

const fn slot(number: u16, publisher: u8, phase: u64) -> Slot {
    Slot {
        etag: Etag::new(Etag::HARD_FIRST.get() + number).unwrap(),
        publisher: TxNode::new(publisher).unwrap(),
        len: 4,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(10),
        phase: Duration::from_millis(phase),
    }
}

/// The node publishes in the first slot, and subscribes to the second.
static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(20),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[slot(0, 1, 0), slot(1, 2, 5)],
);

/// Soft channels are asked for, and some are refused.
static PLAN: AdmissionPlan = AdmissionPlan {
    unplanned: Unplanned::Ask,
    planned: &[],
    reservations: Reservations::nothing(BitRate::MAX, Duration::from_micros(160), Duration::from_micros(5)),
};

fn hard_channel(number: u16) -> Channel<u32> {
    let attributes = HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 };
    Channel::hard(subject(number as u8), CALENDAR.slots()[usize::from(number)].etag, attributes)
}

/// Two hard, two soft, and two non real-time channels, which are one more than the node has room for.
fn channel(of: u8) -> Channel<u32> {
    let deadline = Duration::from_millis(u64::from(of % 6));
    match of % 6 {
        number @ 0..=1 => hard_channel(number.into()),
        number @ 2..=3 => {
            let validity = deadline + Duration::from_millis(u64::from(of / 6));
            let rate = EventRate::sporadic(Duration::from_micros(400 + u64::from(of)));
            Channel::soft(subject(number), SoftAttributes { deadline, validity }).with_rate(rate)
        }
        number => {
            let attributes = NonRealTimeAttributes { importance: Importance::MOST, validity: Some(deadline) };
            Channel::non_real_time(subject(number), attributes)
        }
    }
}

struct Node {
    half: Half,
    dispatcher: Dispatcher<4>,
    /// What is in each mailbox, if anything: a frame, which is to be withdrawn or not.
    mailboxes: [Option<bool>; 3],
    publications: Vec<Publication<u32>>,
    subscriptions: Vec<Subscription<u32>>,
}

impl Node {
    fn new(first: u8) -> Self {
        let config = NodeConfig {
            tx_node: (first & 1 != 0).then_some(TxNode::new(1).unwrap()),
            clock: SyncConfig { rank: Rank::new(first >> 4), ..SyncConfig::DEFAULT },
            admission: (first & 4 != 0).then_some(&PLAN),
            ..NodeConfig::new(uid(first))
        };
        let broker = (first & 2 != 0).then(|| {
            let broker = Broker::new(uid(first), BrokerTiming::DEFAULT, Nodes::new(), Subjects::new());
            AdmittingBroker::new(broker, config.admission, AdmissionTiming::DEFAULT)
        });
        let services = Services::new(&config, &CALENDAR, broker, Instant::EPOCH).unwrap();
        Self {
            half: EventHalf::new(
                config.tx_node,
                &CALENDAR,
                services,
                HrtBuffers::new(GlobalClock::unsynchronised()),
            ),
            dispatcher: Dispatcher::new(&CALENDAR),
            mailboxes: [const { None }; 3],
            publications: Vec::new(),
            subscriptions: Vec::new(),
        }
    }

    fn on_frame(&mut self, frame: &Frame, now: Instant) {
        if let Some(input) = receive(frame, now, self.half.hard_mut()) {
            self.half.on_input(&input, now);
        }
    }

    fn execute(&mut self, command: Command) {
        match command {
            Command::Load(mailbox, frame) => {
                let place = &mut self.mailboxes[mailbox as usize];
                assert!(place.is_none(), "{mailbox:?} is taken");
                assert_eq!(mailbox == Mailbox::Hard, frame.id.priority() == Priority::HARD);
                *place = Some(false);
            }
            Command::Withdraw(mailbox) => {
                if let Some(withdrawn) = &mut self.mailboxes[mailbox as usize] {
                    *withdrawn = true;
                }
            }
        }
    }

    /// The controller has sent the frame of a mailbox, or has withdrawn it if that was asked for.
    fn finish(&mut self, of: u8, now: Instant) {
        let mailbox = Mailbox::ALL[usize::from(of) % 3];
        let Some(withdrawn) = self.mailboxes[mailbox as usize].take() else { return };
        let outcome = if withdrawn && of & 0x80 != 0 { Outcome::Withdrawn } else { Outcome::Sent };
        if let Some(input) = event_half::outcome(mailbox, outcome, now, self.half.hard_mut()) {
            self.half.on_input(&input, now);
        }
    }

    fn call(&mut self, number: u8, of: u8, now: Instant) {
        let fifo = [
            Policy::Fifo(Depth::new(of % 4 + 1).unwrap()),
            Policy::DeadlineOrder(Depth::new(of % 4 + 1).unwrap()),
            Policy::Latest,
        ][usize::from(of) % 3];
        match number {
            0..=19 => self.finish(of, now),
            20..=24 => self.publications.extend(self.half.announce(&channel(of))),
            25..=29 => {
                let subscribed = self.half.subscribe(&channel(of), Filter::ALL, fifo);
                self.subscriptions.extend(subscribed);
            }
            30..=39 => {
                let count = self.publications.len().max(1);
                if let Some(publication) = self.publications.get(usize::from(of) % count) {
                    let event = Event::new(u32::from(of));
                    if let Ok(due) = self.half.publish(now, publication, &event) {
                        due.command().into_iter().for_each(|command| self.execute(command));
                    }
                }
            }
            40 => {
                if let Some(publication) = self.publications.pop() {
                    let due = self.half.cancel_publication(publication);
                    due.into_iter().filter_map(Due::command).for_each(|command| self.execute(command));
                }
            }
            41 => {
                if let Some(subscription) = self.subscriptions.pop() {
                    self.half.cancel_subscription(subscription);
                }
            }
            42 => _ = self.half.on_input(&Input::BusOff, now),
            44 if of & 1 == 0 => _ = self.half.on_input(&Input::Lost(of.into()), now),
            44 => _ = self.half.on_input(&Input::Overrun(of.into()), now),
            43 => self.half.services_mut().release(),
            _ => _ = self.half.on_input(&Input::Errors(ErrorCounters { transmit: of, receive: of }), now),
        }
    }

    fn run(&mut self, now: Instant) {
        drain(now, || self.dispatch(now), |()| {});
        drain(now, || self.poll_half(now), |()| {});
        let subscriptions = core::mem::take(&mut self.subscriptions);
        for subscription in &subscriptions {
            while self.half.next(subscription).is_some() {}
        }
        self.subscriptions = subscriptions;
        while self.half.take_exception().is_some() {}
        while self.half.services_mut().take_news().is_some() {}
    }

    fn dispatch(&mut self, now: Instant) -> Option<()> {
        match self.dispatcher.poll(now, self.half.hard_mut()) {
            hard::CalendarStep::Command(command) => self.execute(command),
            hard::CalendarStep::Notify(buffer) => _ = self.half.on_input(&Input::Notice(buffer), now),
            hard::CalendarStep::Continue => {}
            hard::CalendarStep::SleepUntil(at) => {
                assert!(at > now, "the dispatcher wakes at {at:?}, which is not behind {now:?}");
                return None;
            }
        }
        Some(())
    }

    fn poll_half(&mut self, now: Instant) -> Option<()> {
        match self.half.poll(now) {
            Step::Command(command) => self.execute(command),
            Step::SleepUntil(at) => {
                assert!(at > now, "the node wakes at {at:?}, which is not behind {now:?}");
                return None;
            }
        }
        Some(())
    }
}

/// Some frames are turned into events of the node's channels.
fn near_events(frame: Frame) -> Frame {
    let (etag, priority) = match frame.id.etag().get() {
        22 => (CALENDAR.slots()[0].etag, Priority::HARD),
        23 => (CALENDAR.slots()[1].etag, Priority::HARD),
        24 => (Etag::BOUND_LAST, Priority::SOFT_MOST_URGENT),
        25 => (Etag::new(Etag::BOUND_LAST.get() - 1).unwrap(), Priority::LEAST),
        _ => return frame,
    };
    let tx_node = tx_node(frame.id.tx_node().get() % 4).unwrap_or(TxNode::MIN);
    Frame::new(Id::new(priority, tx_node, etag), frame.payload)
}

fuzz_target!(|bytes: &[u8]| {
    let Some((first, bytes)) = bytes.split_first() else { return };
    let mut script = Script::new(bytes);
    let mut node = Node::new(*first);
    node.run(script.now);
    while let Some(step) = script.next() {
        let now = script.now;
        match step {
            Act::Frame(frame) => node.on_frame(&near_events(frame), now),
            Act::Call(number, of) => node.call(number, of, now),
            Act::Pause => {}
        }
        node.run(now);
    }
});
