//! The soft and non real-time path of the core on a Cortex-M: every command to the mailboxes, with exact
//! instants.
//!
//! Time is a parameter of the core, so the instants are those of the program: what is printed is the same
//! on any processor, to the nanosecond. How many instructions a call takes goes to standard error.
#![no_std]
#![no_main]

use core::hint::black_box;

use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::network::soft::{
    Etch, EtchStep, Full, Incident, Outgoing, PriorityMap, RESERVED, Tag, Unsent,
};
use cosmic_core::time::{Duration, Instant};
use qemu_tests::controller::{Controller, Sender, Sent};
use qemu_tests::mono::Mono;
use qemu_tests::{count, measured, pass, println};

#[cortex_m_rt::entry]
fn main() -> ! {
    Mono::start();
    earliest_deadline_first();
    promotion();
    missed_and_expired();
    importance();
    full();
    recalled();
    urgent();
    measure();
    pass()
}

fn earliest_deadline_first() {
    let mut node = Node::new("earliest deadline first", 3);
    for (event, deadline) in [(1, 9_000), (2, 3_000), (3, 6_000), (4, 3_000)] {
        node.submit_soft(event, deadline, 20_000);
    }
    node.run_until(3_000);
}

fn promotion() {
    let mut node = Node::new("promotion while others have the bus", 7);
    node.submit_soft(1, 1_100, 5_000);
    node.run_until(3_000);
}

fn missed_and_expired() {
    let mut node = Node::new("missed deadlines are sent, expired events are not", 9);
    node.submit_soft(1, 500, 900);
    node.submit_soft(2, 600, 5_000);
    node.submit_soft(3, 700, 1_000);
    node.submit_non_real_time(Priority::LEAST, 4, 800);
    node.run_until(3_000);
}

fn importance() {
    let mut node = Node::new("non real-time events by importance, behind all others", 1);
    for (event, priority) in [(1, 255), (2, 252), (3, 252), (4, 251)] {
        node.submit_non_real_time(Priority::new(priority), event, 10_000);
    }
    node.submit_soft(5, 9_000, 10_000);
    node.run_until(3_000);
}

fn full() {
    let mut node = Node::new("a full queue refuses, and counts", 1);
    for event in 1..=6 {
        node.submit_soft(event, 1_000 + u64::from(event), 5_000);
    }
    println!("  refused {}", node.etch.counters().refused);
    node.run_until(3_000);
}

fn recalled() {
    let mut node = Node::new("recalled events are not sent", 1);
    for event in 1..=3 {
        node.submit_soft(event, 1_000, 5_000);
    }
    for command in node.etch.recall(&Unsent::OfOthersThan(Tag(3))).into_iter().flatten() {
        node.execute(command);
    }
    node.run_until(3_000);
}

fn urgent() {
    let mut node = Node::new("clock synchronisation goes before all soft events", 2);
    node.submit_soft(1, 400, 5_000);
    let frame = frame(Priority::LEAST, 2);
    let command = node.etch.submit_urgent(node.now, Tag(2), frame, Instant::FAR_FUTURE);
    node.submitted(command);
    node.run_until(3_000);
}

/// A node with the path under test, on a bus with a peer.
struct Node {
    etch: Etch<{ 5 + RESERVED }, { 4 + RESERVED }>,
    controller: Controller,
    now: Instant,
}

impl Node {
    /// At instant 0, with a peer that has just begun to send this many frames of higher priority.
    fn new(title: &str, peer_frames: u8) -> Self {
        println!("{}", title);
        let mut node = Self {
            etch: Etch::new(PriorityMap::of(BitRate::MAX)),
            controller: Controller::new(BitRate::MAX),
            now: Instant::EPOCH,
        };
        for _ in 0..peer_frames {
            node.controller.peer_sends(frame(Priority::HARD, 0), node.now);
        }
        node
    }

    /// An event with its deadline and its expiration, in microseconds of the run.
    fn submit_soft(&mut self, event: u8, deadline_us: u64, expires_us: u64) {
        let outgoing = outgoing(Priority::LEAST, event, deadline_us, expires_us);
        let command = self.etch.submit_soft(self.now, outgoing);
        self.submitted(command);
    }

    fn submit_non_real_time(&mut self, priority: Priority, event: u8, expires_us: u64) {
        let deadline_us = expires_us;
        let command =
            self.etch.submit_non_real_time(self.now, outgoing(priority, event, deadline_us, expires_us));
        self.submitted(command);
    }

    fn submitted(&mut self, result: Result<Option<Command>, Full>) {
        match result {
            Ok(Some(command)) => self.execute(command),
            Ok(None) => {}
            Err(Full) => println!("{:>9} ns refused", nanoseconds(self.now)),
        }
        self.poll();
    }

    /// Runs from one event of the path or of the bus to the next.
    fn run_until(&mut self, end_us: u64) {
        let end = microseconds(end_us);
        loop {
            let wakeup = self.poll();
            let next = wakeup.min(self.controller.next_event());
            assert!(next > self.now);
            if next > end {
                break;
            }
            self.now = next;
            while let Some(Sent { from, frame, at }) = self.controller.advance(self.now) {
                if let Sender::Mailbox(mailbox) = from {
                    self.print("sent", frame.payload.as_slice()[0]);
                    let departure = self.etch.on_outcome(mailbox, Outcome::Sent, at);
                    assert_eq!(departure.sent.map(|sent| sent.frame.payload), Some(frame.payload));
                    self.report(departure.incident);
                }
            }
        }
        assert!(self.etch.is_empty());
    }

    fn poll(&mut self) -> Instant {
        loop {
            match self.etch.poll(self.now) {
                EtchStep::Command(command) => self.execute(command),
                EtchStep::Incident(exception) => self.report(Some(exception)),
                EtchStep::SleepUntil(instant) => return instant,
            }
        }
    }

    fn execute(&mut self, command: Command) {
        match command {
            Command::Load(mailbox, frame) => {
                let priority = frame.id.priority().get();
                let at = nanoseconds(self.now);
                println!("{:>9} ns load {} in {:?}, priority {}", at, event(&frame), mailbox, priority);
            }
            Command::Withdraw(mailbox) => self.print("withdraw from", format_args!("{mailbox:?}")),
        }
        if let Some((mailbox, outcome)) = self.controller.execute(command, self.now) {
            let departure = self.etch.on_outcome(mailbox, outcome, self.now);
            assert_eq!(departure.sent, None);
            self.report(departure.incident);
        }
    }

    fn report(&self, exception: Option<Incident>) {
        if let Some(Incident { tag, kind }) = exception {
            self.print("exception:", format_args!("{} {kind:?}", tag.0));
        }
    }

    fn print(&self, what: &str, of: impl core::fmt::Display) {
        println!("{:>9} ns {} {}", nanoseconds(self.now), what, of);
    }
}

fn outgoing(priority: Priority, event: u8, deadline_us: u64, expires_us: u64) -> Outgoing {
    Outgoing {
        tag: Tag(event),
        frame: frame(priority, event),
        deadline: microseconds(deadline_us),
        expires_at: microseconds(expires_us),
    }
}

/// A frame of eight bytes: 160 µs at 1 Mbit/s.
fn frame(priority: Priority, event: u8) -> Frame {
    Frame::new(Id::new(priority, TxNode::MIN, Etag::BOUND_LAST), Payload::full([event; 8]))
}

fn event(frame: &Frame) -> u8 {
    frame.payload.as_slice()[0]
}

fn microseconds(us: u64) -> Instant {
    Instant::from_epoch(Duration::from_micros(us))
}

fn nanoseconds(at: Instant) -> u64 {
    at.since_epoch().as_ticks()
}

/// What the calls cost, with an empty queue and with a full one.
fn measure() {
    let mut etch = Etch::<{ 64 + RESERVED }, { 64 + RESERVED }>::new(PriorityMap::of(BitRate::MAX));
    let now = Instant::EPOCH;
    print_measured(
        "soft event on an idle node: submit, poll, sent, poll",
        count::instructions(|| {
            let loaded = etch.submit_soft(now, outgoing(Priority::LEAST, 1, 1_000, 2_000));
            assert!(matches!(loaded, Ok(Some(_))));
            let _ = black_box(etch.poll(now));
            assert!(etch.on_outcome(Mailbox::Soft, Outcome::Sent, now).sent.is_some());
            let _ = black_box(etch.poll(now));
        }),
    );
    for event in 0..63 {
        let loaded = etch.submit_soft(now, outgoing(Priority::LEAST, event, 1_000, 2_000));
        assert!(loaded.is_ok_and(|command| command.is_some() == (event == 0)));
    }
    let _ = black_box(etch.poll(now));
    print_measured(
        "poll, 63 events wait, nothing due",
        count::instructions(|| {
            assert!(matches!(etch.poll(now), EtchStep::SleepUntil(_)));
        }),
    );
    print_measured(
        "soft event behind 63 others: submit, sent, load",
        count::instructions(|| {
            assert!(matches!(etch.submit_soft(now, outgoing(Priority::LEAST, 1, 1_000, 2_000)), Ok(None)));
            assert!(etch.on_outcome(Mailbox::Soft, Outcome::Sent, now).sent.is_some());
            assert!(matches!(etch.poll(now), EtchStep::Command(Command::Load(..))));
        }),
    );
}

fn print_measured(name: &str, count: count::Count) {
    measured!("{}: {} instructions, exact {}", name, count.instructions, count.exact);
}
