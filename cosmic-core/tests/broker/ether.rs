//! A bus for the tests of one protocol: frames, arbitration and seeded faults, without bits.
//!
//! What matters of CAN is here: the smallest identifier goes first, identical frames of several senders
//! are one frame, and different data under one identifier are an error of both senders. (On a real bus
//! they try again until they are error passive; then the one whose data is smaller comes through.)

use std::collections::VecDeque;

use cosmic_core::broker::*;
use cosmic_core::can::{Etag, Frame, Id, Payload, TxNode};
use cosmic_core::client::*;
use cosmic_core::protocol::Output;
use cosmic_core::time::{Duration, Instant};
use cosmic_core::{NodeUid, Subject};

pub(crate) const FRAME_TIME: Duration = Duration::from_micros(150);
/// What a node lets wait for transmission.
const QUEUE: usize = 3;

pub(crate) type TestBroker = Broker<20, 16>;

/// A participant of the bus.
pub(crate) trait Station {
    fn on_frame(&mut self, frame: &Frame, now: Instant);
    /// Moves what is to be sent into the outbox; called often.
    fn poll(&mut self, now: Instant, outbox: &mut VecDeque<Frame>);
    fn next_wakeup(&self) -> Instant;
    /// The id and the etag of an old client.
    fn old_names(&self) -> Option<(Option<u8>, Option<u16>)> {
        None
    }
    fn as_node(&self) -> Option<&Node> {
        None
    }
    fn as_node_mut(&mut self) -> Option<&mut Node> {
        None
    }
}

/// A node of ours: both clients, and perhaps a broker.
pub(crate) struct Node {
    pub(crate) configuration: Configuration,
    pub(crate) binding: Binding<8>,
    pub(crate) broker: Option<TestBroker>,
    wanted: Vec<u64>,
    pub(crate) configuration_events: Vec<ConfigurationEvent>,
    pub(crate) binding_events: Vec<BindingEvent>,
    pub(crate) broker_events: Vec<BrokerEvent>,
}

pub(crate) fn at(milliseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_millis(milliseconds))
}

pub(crate) const fn uid(uid: u64) -> NodeUid {
    NodeUid::new(uid).unwrap()
}

pub(crate) const fn subject(subject: u64) -> Subject {
    Subject::new(subject).unwrap()
}

pub(crate) const fn tx_node(id: u8) -> TxNode {
    TxNode::new(id).unwrap()
}

/// A frame as `candump` writes it: identifier, `#`, data.
pub(crate) fn from_candump(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let id = Id::from_raw(u32::from_str_radix(id, 16).unwrap()).unwrap();
    let digits = |at: usize| u8::from_str_radix(&data[at..at + 2], 16).unwrap();
    let bytes: Vec<u8> = (0..data.len()).step_by(2).map(digits).collect();
    Frame::new(id, Payload::new(&bytes).unwrap())
}

impl Node {
    fn of(configuration: Configuration, noise: u64) -> Self {
        Self {
            binding: Binding::new(configuration.uid().get() ^ noise, &BindingTiming::DEFAULT),
            configuration,
            broker: None,
            wanted: Vec::new(),
            configuration_events: Vec::new(),
            binding_events: Vec::new(),
            broker_events: Vec::new(),
        }
    }

    /// A node that asks for its id.
    pub(crate) fn asking(now: Instant, of: u64, noise: u64) -> Self {
        Self::of(Configuration::new(now, uid(of), noise, &ConfigurationTiming::DEFAULT), noise)
    }

    /// A node with a fixed id.
    pub(crate) fn fixed(now: Instant, of: u64, id: u8, noise: u64) -> Self {
        let timing = &ConfigurationTiming::DEFAULT;
        Self::of(Configuration::fixed(now, uid(of), tx_node(id), noise, timing), noise)
    }

    pub(crate) fn hosting(self, nodes: Nodes<20>, subjects: Subjects<16>) -> Self {
        let broker = Broker::new(self.configuration.uid(), BrokerTiming::DEFAULT, nodes, subjects);
        Self { broker: Some(broker), ..self }
    }

    pub(crate) fn with_subjects(mut self, subjects: impl IntoIterator<Item = u64>) -> Self {
        self.wanted.extend(subjects);
        self.wanted.iter().for_each(|of| self.binding.bind(subject(*of)).unwrap());
        self
    }

    /// The subjects that the node asks for.
    pub(crate) fn subjects(&self) -> impl Iterator<Item = u64> {
        self.wanted.iter().copied()
    }

    pub(crate) fn tx_node(&self) -> Option<TxNode> {
        self.configuration.tx_node()
    }

    pub(crate) fn etag_of(&self, of: u64) -> Option<Etag> {
        self.binding.etag_of(subject(of))
    }

    pub(crate) fn role(&self) -> BrokerRole {
        self.broker.as_ref().map_or(BrokerRole::Off, Broker::role)
    }

    fn poll_configuration(&mut self, now: Instant, outbox: &mut VecDeque<Frame>) {
        while outbox.len() < QUEUE {
            match self.configuration.poll(now) {
                None => break,
                Some(Output::Send(frame)) => outbox.push_back(frame),
                Some(Output::Withdraw(frame)) => outbox.retain(|queued| *queued != frame),
                Some(Output::Event(event)) => {
                    self.configuration_events.push(event);
                    let id = self.configuration.tx_node();
                    self.binding.set_tx_node(id);
                    if let Some(broker) = &mut self.broker {
                        broker.set_tx_node(now, id);
                    }
                }
            }
        }
    }

    fn poll_binding(&mut self, now: Instant, outbox: &mut VecDeque<Frame>) {
        while outbox.len() < QUEUE {
            match self.binding.poll(now) {
                None => break,
                Some(Output::Send(frame)) => {
                    if let Some(broker) = &mut self.broker {
                        broker.on_frame(&frame, now);
                    }
                    outbox.push_back(frame);
                }
                Some(Output::Withdraw(frame)) => outbox.retain(|queued| *queued != frame),
                Some(Output::Event(event)) => self.binding_events.push(event),
            }
        }
    }

    fn poll_broker(&mut self, now: Instant, outbox: &mut VecDeque<Frame>) {
        let Some(broker) = &mut self.broker else { return };
        while outbox.len() < QUEUE {
            match broker.poll(now) {
                None => break,
                Some(Output::Send(frame)) => {
                    self.binding.on_frame(&frame, now);
                    outbox.push_back(frame);
                }
                Some(Output::Withdraw(frame)) => outbox.retain(|queued| *queued != frame),
                Some(Output::Event(event)) => self.broker_events.push(event),
            }
        }
    }
}

impl Station for Node {
    fn on_frame(&mut self, frame: &Frame, now: Instant) {
        self.configuration.on_frame(frame, now);
        self.binding.on_frame(frame, now);
        if let Some(broker) = &mut self.broker {
            broker.on_frame(frame, now);
        }
    }

    fn poll(&mut self, now: Instant, outbox: &mut VecDeque<Frame>) {
        self.poll_configuration(now, outbox);
        self.poll_broker(now, outbox);
        self.poll_binding(now, outbox);
    }

    fn next_wakeup(&self) -> Instant {
        let broker = self.broker.as_ref().map_or(Instant::FAR_FUTURE, Broker::next_wakeup);
        self.configuration.next_wakeup().min(self.binding.next_wakeup()).min(broker)
    }

    fn as_node(&self) -> Option<&Node> {
        Some(self)
    }

    fn as_node_mut(&mut self) -> Option<&mut Node> {
        Some(self)
    }
}

/// Faults that each receiver suffers on its own, in permille of the frames.
#[derive(Clone, Copy, Default)]
pub(crate) struct Faults {
    pub(crate) lost: u64,
    pub(crate) twice: u64,
    /// Delivered 5 ms late, behind frames that came after.
    pub(crate) late: u64,
}

struct Attached {
    station: Box<dyn Station>,
    outbox: VecDeque<Frame>,
    alive: bool,
    segment: u8,
}

/// The bus. Segments model a bus that is cut: frames stay within one.
pub(crate) struct Ether {
    pub(crate) now: Instant,
    pub(crate) faults: Faults,
    pub(crate) log: Vec<Frame>,
    /// Frames of two senders with one identifier and different data.
    pub(crate) collisions: usize,
    random: u64,
    stations: Vec<Attached>,
    late: VecDeque<(Instant, usize, Frame)>,
}

impl Ether {
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            now: Instant::from_epoch(Duration::from_millis(1)),
            faults: Faults::default(),
            log: Vec::new(),
            collisions: 0,
            random: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1,
            stations: Vec::new(),
            late: VecDeque::new(),
        }
    }

    pub(crate) fn add(&mut self, station: impl Station + 'static) -> usize {
        let station = Box::new(station);
        self.stations.push(Attached { station, outbox: VecDeque::new(), alive: true, segment: 0 });
        self.stations.len() - 1
    }

    pub(crate) fn kill(&mut self, at: usize) {
        self.stations[at].alive = false;
        self.stations[at].outbox.clear();
    }

    /// The station in this place is another one from now on.
    pub(crate) fn replace(&mut self, at: usize, station: impl Station + 'static) {
        self.stations[at] =
            Attached { station: Box::new(station), outbox: VecDeque::new(), alive: true, segment: 0 };
    }

    pub(crate) fn move_to_segment(&mut self, at: usize, segment: u8) {
        self.stations[at].segment = segment;
    }

    pub(crate) fn node(&self, at: usize) -> &Node {
        self.stations[at].station.as_node().unwrap()
    }

    pub(crate) fn node_mut(&mut self, at: usize) -> &mut Node {
        self.stations[at].station.as_node_mut().unwrap()
    }

    /// The nodes of ours that are alive.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = &Node> {
        self.stations.iter().filter(|at| at.alive).filter_map(|at| at.station.as_node())
    }

    /// The names of the old clients that are alive.
    pub(crate) fn old_names(&self) -> impl Iterator<Item = (Option<u8>, Option<u16>)> {
        self.stations.iter().filter(|at| at.alive).filter_map(|at| at.station.old_names())
    }

    pub(crate) fn run(&mut self, span: Duration) {
        let end = self.now + span;
        while self.now < end {
            self.step(end);
        }
    }

    /// Runs until `done`; panics if that takes longer than `limit`.
    pub(crate) fn run_until(&mut self, limit: Duration, done: impl Fn(&Self) -> bool) -> Duration {
        let (start, end) = (self.now, self.now + limit);
        while !done(self) {
            assert!(self.now < end, "not done after {limit}");
            self.step(end);
        }
        self.now.saturating_since(start)
    }

    /// One frame on each segment, or else the time until something happens; then everybody acts.
    fn step(&mut self, end: Instant) {
        let mut segments: Vec<u8> = self.stations.iter().map(|at| at.segment).collect();
        segments.sort_unstable();
        segments.dedup();
        let mut busy = false;
        for segment in segments {
            busy |= self.transmit(segment);
        }
        self.now = if busy { self.now + FRAME_TIME } else { self.next_instant(end) };
        self.deliver_late();
        for at in self.stations.iter_mut().filter(|at| at.alive) {
            at.station.poll(self.now, &mut at.outbox);
        }
    }

    fn next_instant(&self, end: Instant) -> Instant {
        let wakeups = self.stations.iter().filter(|at| at.alive).map(|at| at.station.next_wakeup());
        let late = self.late.iter().map(|(at, ..)| *at);
        let next = wakeups.chain(late).min().unwrap_or(end).min(end);
        next.max(self.now + Duration::from_micros(1))
    }

    fn transmit(&mut self, segment: u8) -> bool {
        let ready =
            |at: &Attached| (at.alive && at.segment == segment).then(|| at.outbox.front().copied())?;
        let order = |frame: &Frame| (frame.id, frame.payload.padded(), frame.payload.len());
        let Some(frame) = self.stations.iter().filter_map(ready).min_by_key(order) else {
            return false;
        };
        let mut received = Vec::new();
        for (index, at) in self.stations.iter_mut().enumerate() {
            if !at.alive || at.segment != segment {
                continue;
            }
            match at.outbox.front() {
                Some(front) if *front == frame => _ = at.outbox.pop_front(),
                front => {
                    self.collisions += usize::from(front.is_some_and(|front| front.id == frame.id));
                    received.push(index);
                }
            }
        }
        self.log.push(frame);
        let done = self.now + FRAME_TIME;
        for index in received {
            self.deliver(done, index, &frame);
        }
        true
    }

    fn deliver(&mut self, done: Instant, index: usize, frame: &Frame) {
        if self.happens(self.faults.lost) {
            return;
        }
        if self.happens(self.faults.late) {
            self.late.push_back((done + Duration::from_millis(5), index, *frame));
            return;
        }
        self.stations[index].station.on_frame(frame, done);
        if self.happens(self.faults.twice) {
            self.stations[index].station.on_frame(frame, done);
        }
    }

    fn deliver_late(&mut self) {
        while self.late.front().is_some_and(|(at, ..)| *at <= self.now) {
            let (_, index, frame) = self.late.pop_front().unwrap();
            if self.stations[index].alive {
                self.stations[index].station.on_frame(&frame, self.now);
            }
        }
    }

    fn happens(&mut self, permille: u64) -> bool {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random % 1000 < permille
    }
}
