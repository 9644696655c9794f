//! The soft and non real-time path against a plain oracle, in virtual time.

use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::network::soft::{
    Etch, EtchStep, Full, Incident, IncidentKind, Outgoing, PriorityMap, RESERVED, Tag, Unsent,
};
use cosmic_core::time::{Duration, Instant};
use proptest::prelude::*;

const MAP: PriorityMap = PriorityMap::of(BitRate::MAX);
/// Room for four events of each class.
type Path = Etch<{ 4 + RESERVED }, { 4 + RESERVED }>;

const STEP: Duration = Duration::from_micros(160);

fn at(microseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_micros(microseconds))
}

fn soft(number: u8, deadline: Instant, expires_at: Instant) -> Outgoing {
    let id = Id::new(Priority::SOFT_MOST_URGENT, TxNode::new(5).unwrap(), Etag::BOUND_LAST);
    let frame = Frame::new(id, Payload::new(&[number]).unwrap());
    Outgoing { tag: Tag(number), frame, deadline, expires_at }
}

fn bulk(number: u8, priority: u8) -> Outgoing {
    let id = Id::new(Priority::new(priority), TxNode::new(5).unwrap(), Etag::BOUND_FIRST);
    let frame = Frame::new(id, Payload::new(&[number]).unwrap());
    Outgoing { tag: Tag(number), frame, deadline: Instant::FAR_FUTURE, expires_at: Instant::FAR_FUTURE }
}

fn loaded(step: EtchStep) -> (Mailbox, Frame) {
    match step {
        EtchStep::Command(Command::Load(mailbox, frame)) => (mailbox, frame),
        other => panic!("{other:?}"),
    }
}

#[test]
fn remaining_time_becomes_priority() {
    let priority = |microseconds| MAP.priority(Duration::from_micros(microseconds)).get();
    assert_eq!(priority(0), 1);
    assert_eq!(priority(159), 1);
    assert_eq!(priority(160), 2);
    assert_eq!(priority(160 * 248 - 1), 248);
    assert_eq!(priority(160 * 248), 249);
    assert_eq!(priority(u64::MAX / 1_000_000), 249);
}

#[test]
fn a_frame_is_promoted_as_its_deadline_nears() {
    let mut etch = Path::new(MAP);
    let command = etch.submit_soft(at(0), soft(1, at(500), at(1_000))).unwrap();
    let Some(Command::Load(Mailbox::Soft, frame)) = command else { panic!("{command:?}") };
    // 500 µs are three whole steps of 160 µs: priority 4, TxNode 5, etag 0x3FFF.
    assert_eq!(frame.id.raw(), 0x0081_7FFF);
    let EtchStep::SleepUntil(promotion) = etch.poll(at(0)) else { panic!("nothing else is to be done") };
    assert_eq!(promotion.saturating_since(at(0)), Duration::from_ticks(20_001));
    assert_eq!(etch.poll(promotion), EtchStep::Command(Command::Withdraw(Mailbox::Soft)));
    assert_eq!(etch.on_outcome(Mailbox::Soft, Outcome::Withdrawn, promotion).incident, None);
    let (_, frame) = loaded(etch.poll(promotion));
    assert_eq!(frame.id.priority().get(), 3);
}

#[test]
fn an_earlier_deadline_overtakes_what_waits_in_the_mailbox() {
    let mut etch = Path::new(MAP);
    assert!(etch.submit_soft(at(0), soft(1, at(20_000), at(90_000))).unwrap().is_some());
    assert!(etch.submit_soft(at(10), soft(2, at(5_000), at(90_000))).unwrap().is_none());
    assert_eq!(etch.poll(at(10)), EtchStep::Command(Command::Withdraw(Mailbox::Soft)));
    // Nothing more is done until the controller has told what became of it.
    assert!(matches!(etch.poll(at(11)), EtchStep::SleepUntil(_)));
    etch.on_outcome(Mailbox::Soft, Outcome::Withdrawn, at(12));
    assert_eq!(loaded(etch.poll(at(12))).1.payload.as_slice(), [2]);
    etch.on_outcome(Mailbox::Soft, Outcome::Sent, at(150));
    assert_eq!(loaded(etch.poll(at(150))).1.payload.as_slice(), [1]);
}

#[test]
fn a_frame_on_the_wire_may_be_sent_in_spite_of_its_withdrawal() {
    let mut etch = Path::new(MAP);
    let _ = etch.submit_soft(at(0), soft(1, at(20_000), at(90_000))).unwrap();
    let _ = etch.submit_soft(at(10), soft(2, at(5_000), at(90_000))).unwrap();
    assert_eq!(etch.poll(at(10)), EtchStep::Command(Command::Withdraw(Mailbox::Soft)));
    let departure = etch.on_outcome(Mailbox::Soft, Outcome::Sent, at(120));
    assert_eq!(departure.sent.map(|sent| sent.tag), Some(Tag(1)));
    assert_eq!(loaded(etch.poll(at(120))).1.payload.as_slice(), [2]);
    assert_eq!(etch.len(), 1);
}

#[test]
fn a_missed_deadline_is_told_once_and_the_event_is_still_sent() {
    let mut etch = Path::new(MAP);
    let _ = etch.submit_soft(at(0), soft(1, at(100), at(900))).unwrap();
    assert_eq!(etch.poll(at(50)), EtchStep::SleepUntil(at(100)));
    let missed = Incident { tag: Tag(1), kind: IncidentKind::MissedDeadline };
    assert_eq!(etch.poll(at(100)), EtchStep::Incident(missed));
    assert_eq!(etch.poll(at(101)), EtchStep::SleepUntil(at(900)));
    let departure = etch.on_outcome(Mailbox::Soft, Outcome::Sent, at(300));
    assert_eq!((departure.sent.is_some(), departure.incident), (true, None));
    assert_eq!(etch.counters().missed, 1);
}

#[test]
fn an_expired_event_is_discarded_from_queue_and_mailbox() {
    let mut etch = Path::new(MAP);
    let _ = etch.submit_soft(at(0), soft(1, at(100), at(200))).unwrap();
    let _ = etch.submit_soft(at(0), soft(2, at(150), at(180))).unwrap();
    let mut told = Vec::new();
    let mut withdrawn = false;
    for now in 0..300 {
        loop {
            match etch.poll(at(now)) {
                EtchStep::Incident(incident) => told.push((now, incident.tag.0, incident.kind)),
                EtchStep::Command(Command::Withdraw(_)) => {
                    withdrawn = true;
                    let departure = etch.on_outcome(Mailbox::Soft, Outcome::Withdrawn, at(now));
                    let incident = departure.incident.unwrap();
                    told.push((now, incident.tag.0, incident.kind));
                }
                EtchStep::Command(command) => panic!("{command:?}"),
                EtchStep::SleepUntil(_) => break,
            }
        }
    }
    use IncidentKind::{Expired, MissedDeadline};
    let expected = [(100, 1, MissedDeadline), (150, 2, MissedDeadline), (180, 2, Expired), (200, 1, Expired)];
    assert_eq!(told, expected);
    assert!(withdrawn && etch.is_empty());
}

#[test]
fn importance_rules_among_non_real_time_events() {
    let mut etch = Path::new(MAP);
    assert!(etch.submit_non_real_time(at(0), bulk(1, 255)).unwrap().is_some());
    for (number, priority) in [(2, 252), (3, 255), (4, 252)] {
        assert!(etch.submit_non_real_time(at(0), bulk(number, priority)).unwrap().is_none());
    }
    assert_eq!(etch.submit_non_real_time(at(0), bulk(5, 251)), Err(Full));
    assert_eq!(etch.poll(at(0)), EtchStep::Command(Command::Withdraw(Mailbox::NonRealTime)));
    etch.on_outcome(Mailbox::NonRealTime, Outcome::Withdrawn, at(1));
    let mut order = Vec::new();
    while let EtchStep::Command(Command::Load(mailbox, frame)) = etch.poll(at(1)) {
        order.push(frame.payload.as_slice()[0]);
        etch.on_outcome(mailbox, Outcome::Sent, at(1));
    }
    // The one that was withdrawn keeps its place before the later one of its importance.
    assert_eq!(order, [2, 4, 1, 3]);
    assert_eq!((etch.counters().refused, etch.counters().sent), (1, 4));
}

#[test]
fn recalled_events_are_not_sent() {
    let mut etch = Path::new(MAP);
    let _ = etch.submit_soft(at(0), soft(1, at(1_000), at(2_000))).unwrap();
    let _ = etch.submit_soft(at(0), soft(1, at(1_500), at(2_000))).unwrap();
    let _ = etch.submit_soft(at(0), soft(2, at(1_800), at(2_000))).unwrap();
    let commands = etch.recall(&Unsent::Of(Tag(1)));
    assert_eq!(commands, [Some(Command::Withdraw(Mailbox::Soft)), None]);
    let departure = etch.on_outcome(Mailbox::Soft, Outcome::Withdrawn, at(1));
    assert_eq!((departure.sent, departure.incident), (None, None));
    assert_eq!(loaded(etch.poll(at(1))).1.payload.as_slice(), [2]);
}

#[test]
fn events_that_wait_go_under_the_new_etag_of_their_channel() {
    let mut etch = Path::new(MAP);
    let etag = Etag::BOUND_FIRST;
    let of_one = |content| {
        let mut event = soft(1, at(9_000), at(99_000));
        event.frame.payload = Payload::new(&[content]).unwrap();
        event
    };
    for event in [of_one(1), of_one(2), soft(3, at(9_000), at(99_000))] {
        let _ = etch.submit_soft(at(0), event).unwrap();
    }
    assert_eq!(etch.rename(Tag(1), etag), Some(Command::Withdraw(Mailbox::Soft)));
    assert_eq!(etch.rename(Tag(1), etag), None, "once is enough");
    etch.on_outcome(Mailbox::Soft, Outcome::Withdrawn, at(10));
    for (content, etag) in [(1, etag), (2, etag), (3, Etag::BOUND_LAST)] {
        let (_, frame) = loaded(etch.poll(at(10)));
        assert_eq!((frame.payload.as_slice(), frame.id.etag()), (&[content][..], etag));
        assert!(etch.on_outcome(Mailbox::Soft, Outcome::Sent, at(10)).sent.is_some());
    }
}

#[test]
fn events_are_discarded_with_the_etag_of_their_channel_wherever_they_are() {
    // In the mailbox, on the way out of it, and in the queue.
    for withdrawing in [false, true] {
        let mut etch = Path::new(MAP);
        let _ = etch.submit_soft(at(0), soft(1, at(9_000), at(99_000))).unwrap();
        if withdrawing {
            let _ = etch.submit_soft(at(0), soft(2, at(8_000), at(99_000))).unwrap();
            assert_eq!(etch.poll(at(0)), EtchStep::Command(Command::Withdraw(Mailbox::Soft)));
        }
        let _ = etch.submit_soft(at(0), soft(1, at(9_500), at(99_000))).unwrap();
        etch.revoke(at(5), &Unsent::Of(Tag(1)));
        let lost = Incident { tag: Tag(1), kind: IncidentKind::IdentifierLost };
        if !withdrawing {
            assert_eq!(etch.poll(at(5)), EtchStep::Command(Command::Withdraw(Mailbox::Soft)));
        }
        assert_eq!(etch.poll(at(5)), EtchStep::Incident(lost));
        assert_eq!(etch.on_outcome(Mailbox::Soft, Outcome::Withdrawn, at(6)).incident, Some(lost));
        assert_eq!((etch.len(), etch.counters().identifier_lost), (usize::from(withdrawing), 2));
        assert_eq!(etch.counters().expired, 0);
    }
}

#[test]
fn the_services_have_places_of_their_own() {
    let mut etch = Path::new(MAP);
    let mut accepted = 0;
    while etch.submit_soft(at(0), soft(1, at(9_000), at(99_000))).is_ok() {
        accepted += 1;
    }
    assert_eq!(accepted, 4);
    let sync = soft(0, at(0), at(0)).frame;
    for _ in 0..RESERVED {
        assert!(etch.has_room_for_services());
        assert_eq!(etch.submit_urgent(at(1), Tag::SERVICES, sync, at(99_000)), Ok(None));
    }
    assert!(!etch.has_room_for_services());
    assert_eq!(etch.submit_urgent(at(1), Tag::SERVICES, sync, at(99_000)), Err(Full));
    // They go before everything else.
    assert_eq!(etch.poll(at(1)), EtchStep::Command(Command::Withdraw(Mailbox::Soft)));
    etch.on_outcome(Mailbox::Soft, Outcome::Withdrawn, at(2));
    let (_, frame) = loaded(etch.poll(at(2)));
    assert_eq!((frame.id.priority(), frame.payload), (Priority::SOFT_MOST_URGENT, sync.payload));
}

#[derive(Clone, Debug)]
enum Operation {
    /// Submit with this much time to the deadline, and from there to the expiration.
    Submit(u64, u64),
    /// Let time pass, polling whenever the path asked for it.
    Pass(u64),
    /// The bus is free: what is in the soft mailbox is sent.
    BusFree,
}

fn operation() -> impl Strategy<Value = Operation> {
    prop_oneof![
        3 => (1_u64..50_000, 0_u64..20_000).prop_map(|(deadline, more)| Operation::Submit(deadline, more)),
        3 => (1_u64..8_000).prop_map(Operation::Pass),
        3 => Just(Operation::BusFree),
    ]
}

/// One node whose controller answers at once.
struct Model {
    etch: Etch<{ 8 + RESERVED }, { 1 + RESERVED }>,
    now: Instant,
    in_mailbox: Option<Frame>,
    waiting: Vec<(Instant, usize, u8, Instant)>,
    expired: Vec<u8>,
    wakes_at: Instant,
}

impl Model {
    fn execute(&mut self, command: Command) {
        match command {
            Command::Load(mailbox, frame) => {
                assert_eq!(mailbox, Mailbox::Soft);
                assert_eq!(self.in_mailbox.replace(frame), None, "the mailbox is empty before a load");
                // The head of the queue, under the priority that its remaining time maps on.
                let head = self.waiting.iter().min().unwrap();
                assert_eq!(frame.payload.as_slice(), [head.2]);
                assert_eq!(frame.id.priority(), MAP.priority(head.0.saturating_since(self.now)));
            }
            Command::Withdraw(_) => {
                assert!(self.in_mailbox.take().is_some());
                let departure = self.etch.on_outcome(Mailbox::Soft, Outcome::Withdrawn, self.now);
                self.note(departure.incident);
            }
        }
    }

    fn note(&mut self, incident: Option<Incident>) {
        if let Some(Incident { tag, kind: IncidentKind::Expired }) = incident {
            let entry = self.waiting.iter().position(|entry| entry.2 == tag.0).unwrap();
            let (_, _, number, expires_at) = self.waiting.remove(entry);
            assert!(self.now >= expires_at);
            self.expired.push(number);
        }
    }

    fn settle(&mut self) {
        for _ in 0..100 {
            match self.etch.poll(self.now) {
                EtchStep::Command(command) => self.execute(command),
                EtchStep::Incident(incident) => self.note(Some(incident)),
                EtchStep::SleepUntil(instant) => {
                    assert!(instant > self.now, "a wake-up in the past");
                    self.wakes_at = instant;
                    return;
                }
            }
        }
        panic!("the path does not come to rest");
    }

    /// At rest, the earliest deadline is in the mailbox, under the priority of this very moment.
    fn check(&self) {
        assert!(self.waiting.iter().all(|entry| entry.3 > self.now), "an expired event still waits");
        match (self.in_mailbox, self.waiting.iter().min()) {
            (Some(frame), Some(head)) => {
                assert_eq!(frame.payload.as_slice(), [head.2]);
                assert_eq!(frame.id.priority(), MAP.priority(head.0.saturating_since(self.now)));
            }
            (None, None) => {}
            other => panic!("{other:?}"),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    /// Every event is sent or expires, once; what is sent is always the earliest deadline, and the
    /// identifier is never out of date.
    #[test]
    fn earliest_deadline_first(operations in prop::collection::vec(operation(), 1..120)) {
        let mut model = Model {
            etch: Etch::new(MAP),
            now: at(1),
            in_mailbox: None,
            waiting: Vec::new(),
            expired: Vec::new(),
            wakes_at: Instant::FAR_FUTURE,
        };
        let (mut accepted, mut sent) = (0, 0);
        for (number, operation) in operations.into_iter().enumerate() {
            match operation {
                Operation::Submit(deadline, more) => {
                    let deadline = model.now + Duration::from_micros(deadline);
                    let expires_at = deadline + Duration::from_micros(more + 1);
                    let room = model.waiting.len() < 8;
                    let submitted = model.etch.submit_soft(model.now, soft(number as u8, deadline, expires_at));
                    prop_assert_eq!(submitted.is_ok(), room);
                    if let Ok(command) = submitted {
                        model.waiting.push((deadline, number, number as u8, expires_at));
                        accepted += 1;
                        if let Some(command) = command {
                            model.execute(command);
                        }
                    }
                }
                Operation::Pass(microseconds) => {
                    let until = model.now + Duration::from_micros(microseconds);
                    while model.wakes_at <= until {
                        model.now = model.now.max(model.wakes_at);
                        model.settle();
                        model.check();
                    }
                    model.now = until;
                }
                Operation::BusFree => {
                    if let Some(frame) = model.in_mailbox.take() {
                        let departure = model.etch.on_outcome(Mailbox::Soft, Outcome::Sent, model.now);
                        prop_assert_eq!(departure.sent.map(|sent| sent.frame.payload), Some(frame.payload));
                        model.waiting.retain(|entry| frame.payload.as_slice() != [entry.2]);
                        sent += 1;
                    }
                }
            }
            model.settle();
            model.check();
        }
        prop_assert_eq!(accepted, sent + model.expired.len() + model.waiting.len());
        prop_assert_eq!(model.etch.len(), model.waiting.len());
    }
}

#[test]
fn a_step_that_is_zero_or_too_long_is_refused() {
    assert_eq!(PriorityMap::new(Duration::from_ticks(0)), None);
    assert_eq!(PriorityMap::new(PriorityMap::LONGEST_STEP + Duration::from_ticks(1)), None);
    assert_eq!(PriorityMap::new(STEP), Some(MAP));
}
