//! What an application may call, what it gives up, and what it is refused.

use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::event_half::{self, Due, EventHalf, Input, Step, receive};
use cosmic_core::event_layer::{
    AnnounceError, Attribute, Channel, Context, Depth, Event, ExceptionKind, Filter, HardAttributes,
    Importance, MessageSubscriber, NonRealTimeAttributes, Policy, PublishError, SoftAttributes,
    SubscribeError,
};
use cosmic_core::network::hard::{CalendarStep, Dispatcher, HrtBuffers};
use cosmic_core::network::soft::RESERVED;
use cosmic_core::services::{ClockService, Services};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant};

const ME: TxNode = TxNode::new(1).unwrap();
const OTHER: TxNode = TxNode::new(2).unwrap();
const PERIOD: Duration = Duration::from_millis(10);

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    PERIOD,
    &[slot(0, ME, 2), slot(1, OTHER, 4), slot(2, OTHER, 6)],
);

const fn slot(number: u16, publisher: TxNode, phase_ms: u64) -> Slot {
    Slot {
        etag: Etag::new(100 + number).unwrap(),
        publisher,
        len: 2,
        omission_degree: 1,
        periodic: true,
        period: PERIOD,
        phase: Duration::from_millis(phase_ms),
    }
}

const QUALITY: HardAttributes = HardAttributes { period: PERIOD, periodic: true, omission_degree: 1 };

const fn hard(number: u16) -> Channel<u16> {
    Channel::hard(subject(number as u64 + 0x100), Etag::new(100 + number).unwrap(), QUALITY)
}

const SOFT: Channel<u16> = soft(0x200, 5_000);

const fn soft(number: u64, etag: u16) -> Channel<u16> {
    let attributes =
        SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) };
    Channel::soft(subject(number), attributes).with_etag(Etag::new(etag).unwrap())
}

const TEXT: Channel<Payload> = Channel::non_real_time(
    subject(0x300),
    NonRealTimeAttributes { importance: Importance::MOST, validity: Some(Duration::from_millis(50)) },
)
.with_etag(Etag::BOUND_FIRST);

const fn subject(number: u64) -> Subject {
    Subject::new(number).unwrap()
}

fn at(microseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_micros(microseconds))
}

fn fifo(depth: u8) -> Policy {
    Policy::Fifo(Depth::new(depth).unwrap())
}

/// Room for two hard slots, four channels, three subscriptions, four waiting events, two events of each
/// class to be sent.
type Half<S = ()> = EventHalf<2, 4, 3, 4, { 2 + RESERVED }, { 2 + RESERVED }, S>;
type Buffers = HrtBuffers<2>;

fn node() -> Half {
    Half::new(Some(ME), &CALENDAR, (), Buffers::new(GlobalClock::free_running()))
}

fn frame(etag: u16, bytes: &[u8]) -> Frame {
    let id = Id::new(Priority::new(9), OTHER, Etag::new(etag).unwrap());
    Frame::new(id, Payload::new(bytes).unwrap())
}

#[test]
fn what_cannot_be_announced() {
    let mut half = node();
    // The slot is another node's; of another period, omission degree or kind; there is none.
    let period = Duration::from_millis(5);
    let wrong = [
        hard(1),
        Channel::hard(subject(1), Etag::new(100).unwrap(), HardAttributes { period, ..QUALITY }),
        Channel::hard(subject(1), Etag::new(100).unwrap(), HardAttributes { omission_degree: 2, ..QUALITY }),
        Channel::hard(subject(1), Etag::new(100).unwrap(), HardAttributes { periodic: false, ..QUALITY }),
        Channel::hard(subject(1), Etag::new(200).unwrap(), QUALITY),
    ];
    for channel in &wrong {
        assert_eq!(half.announce(channel).unwrap_err(), AnnounceError::NotInCalendar);
    }
    // Content that is longer than the slot.
    let long: Channel<u32> = Channel::hard(subject(1), Etag::new(100).unwrap(), QUALITY);
    assert_eq!(half.announce(&long).unwrap_err(), AnnounceError::NotInCalendar);
    half.announce(&SOFT).unwrap();
    // The same subject with another content; another subject with the same etag.
    let contradiction: Channel<i16> = Channel::soft(
        SOFT.subject(),
        SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) },
    )
    .with_etag(Etag::new(5_000).unwrap());
    assert_eq!(half.announce(&contradiction).unwrap_err(), AnnounceError::Contradiction);
    assert_eq!(half.announce(&soft(0x201, 5_000)).unwrap_err(), AnnounceError::EtagInUse);
    for number in 1..4 {
        half.announce(&soft(0x200 + number, 5_000 + number as u16)).unwrap();
    }
    assert_eq!(half.announce(&soft(0x210, 6_000)).unwrap_err(), AnnounceError::TooManyChannels);
    let mut nameless = Half::new(None, &CALENDAR, (), Buffers::new(GlobalClock::free_running()));
    assert_eq!(nameless.announce(&hard(0)).unwrap_err(), AnnounceError::NoTxNode);
}

#[test]
fn what_cannot_be_subscribed_to() {
    let mut half = node();
    half.subscribe(&hard(0), Filter::ALL, Policy::Latest).unwrap();
    half.subscribe(&hard(1), Filter::ALL, Policy::Latest).unwrap();
    let full = SubscribeError::Channel(AnnounceError::TooManySlots);
    assert_eq!(half.subscribe(&hard(2), Filter::ALL, Policy::Latest).unwrap_err(), full);
    half.subscribe(&SOFT, Filter::ALL, fifo(1)).unwrap();
    let full = SubscribeError::TooManySubscriptions;
    assert_eq!(half.subscribe(&SOFT, Filter::ALL, fifo(1)).unwrap_err(), full);
    assert_eq!(Depth::new(0), None);
}

#[test]
fn what_cannot_be_published() {
    let mut half = node();
    let now = at(1_000);
    let speed = half.announce(&hard(0)).unwrap();
    let temperature = half.announce(&SOFT).unwrap();
    let unbound: Channel<u16> = Channel::soft(
        subject(0x400),
        SoftAttributes { deadline: Duration::from_millis(1), validity: Duration::from_millis(1) },
    );
    let unbound = half.announce(&unbound).unwrap();
    assert_eq!(half.publish(now, &unbound, &Event::new(1)), Err(PublishError::NotBound));
    let late = Event::new(1).deadline(now);
    assert_eq!(half.publish(now, &temperature, &late), Err(PublishError::Deadline));
    let short = Event::new(1).deadline(at(3_000)).expires_at(at(2_000));
    assert_eq!(half.publish(now, &temperature, &short), Err(PublishError::Deadline));
    let timed = Event::new(1).deadline(at(3_000));
    assert_eq!(half.publish(now, &speed, &timed), Err(PublishError::HardDeadline));
    let placed = Event::new(1).context(Context::EMPTY.with(Attribute::Sensor, 1).unwrap());
    assert_eq!(half.publish(now, &temperature, &placed), Err(PublishError::TooLong));
    for _ in 0..2 {
        assert!(half.publish(now, &temperature, &Event::new(1)).is_ok());
    }
    assert_eq!(half.publish(now, &temperature, &Event::new(1)), Err(PublishError::QueueFull));
    assert_eq!(half.exceptions(ExceptionKind::TransmitQueueFull), 1);
    // Each of them has been counted.
    let counts = |subject| half.channel_counters(subject).map(|it| (it.published, it.refused));
    assert_eq!(counts(hard(0).subject()), Some((0, 1)));
    assert_eq!(counts(SOFT.subject()), Some((2, 4)));
    assert_eq!(counts(subject(0x400)), Some((0, 1)));
}

#[test]
fn a_message_that_stops_is_dropped_at_the_next_wakeup() {
    let mut half = node();
    let subscription = half.subscribe(&TEXT, Filter::ALL, fifo(2)).unwrap();
    let mut subscriber = MessageSubscriber::<2, 32>::new(subscription, Duration::from_millis(5));
    assert_eq!(subscriber.next_wakeup(), Instant::FAR_FUTURE);
    for late in [0, 7_000] {
        let begin = 10_000 + late * 10;
        // First of message 0; the rest never comes.
        let first = frame(1_024, &[0x80, 1, 2, 3, 4, 5, 6, 7]);
        half.on_input(&Input::Frame(first), at(begin));
        half.receive_messages(&mut subscriber, at(begin), |message| panic!("{message:?}"));
        assert_eq!(subscriber.next_wakeup(), at(begin + 5_000));
        let dropped = subscriber.counters().timed_out;
        // Early calls do no harm; a late one makes up for it.
        half.receive_messages(&mut subscriber, at(begin + 4_999), |message| panic!("{message:?}"));
        assert_eq!(subscriber.counters().timed_out, dropped);
        assert_eq!(subscriber.next_wakeup(), at(begin + 5_000));
        half.receive_messages(&mut subscriber, at(begin + 5_000 + late), |message| panic!("{message:?}"));
        assert_eq!(subscriber.counters().timed_out, dropped + 1);
        assert_eq!(subscriber.next_wakeup(), Instant::FAR_FUTURE);
    }
}

#[test]
fn a_cancelled_publication_sends_nothing_any_more() {
    let mut half = node();
    let first = half.announce(&SOFT).unwrap();
    let second = half.announce(&SOFT).unwrap();
    let loaded = half.publish(at(0), &first, &Event::new(1)).unwrap();
    assert!(matches!(loaded.command(), Some(Command::Load(Mailbox::Soft, _))));
    assert_eq!(half.publish(at(0), &second, &Event::new(2)), Ok(Due::NOTHING));
    // While another announcement of the channel stands, its events stay.
    assert_eq!(half.cancel_publication(second), [Due::NOTHING; 2]);
    let again = half.announce(&SOFT).unwrap();
    assert_eq!(half.cancel_publication(again), [Due::NOTHING; 2]);
    let commands: Vec<Command> =
        half.cancel_publication(first).into_iter().filter_map(Due::command).collect();
    assert_eq!(commands, [Command::Withdraw(Mailbox::Soft)]);
    half.on_input(&Input::Outcome(Mailbox::Soft, Outcome::Withdrawn), at(5));
    assert!(matches!(half.poll(at(5)), Step::SleepUntil(_)));
    assert_eq!(half.channel_counters(SOFT.subject()), None, "nobody uses the channel any more");
    // Its place and its etag are free again.
    half.announce(&soft(0x999, 5_000)).unwrap();
}

#[test]
fn a_cancelled_hard_publication_leaves_its_slot_empty() {
    let mut half = node();
    let mut dispatcher = Dispatcher::<2>::new(&CALENDAR);
    let speed = half.announce(&hard(0)).unwrap();
    assert!(half.publish(at(0), &speed, &Event::new(7)).unwrap() == Due::NOTHING);
    assert_eq!(half.cancel_publication(speed), [Due::NOTHING; 2]);
    for now in 0..12 {
        loop {
            match dispatcher.poll(at(now * 1_000), half.hard_mut()) {
                CalendarStep::SleepUntil(_) => break,
                CalendarStep::Continue => {}
                step => panic!("{step:?}"),
            }
        }
    }
}

#[test]
fn a_cancelled_subscription_gives_back_its_events_and_its_channel() {
    let mut half = node();
    let one = half.subscribe(&SOFT, Filter::ALL, fifo(4)).unwrap();
    let two = half.subscribe(&SOFT, Filter::ALL, fifo(4)).unwrap();
    for value in 0..2 {
        half.on_input(&Input::Frame(frame(5_000, &[0, value])), at(1));
    }
    // All four places of the pool are taken.
    half.on_input(&Input::Frame(frame(5_000, &[0, 9])), at(2));
    assert_eq!(half.exceptions(ExceptionKind::QueueFull), 1);
    half.cancel_subscription(one);
    half.on_input(&Input::Frame(frame(5_000, &[0, 2])), at(3));
    let received: Vec<u16> = std::iter::from_fn(|| half.next(&two)).map(|event| event.content).collect();
    assert_eq!(received, [0, 1, 2]);
    half.cancel_subscription(two);
    half.on_input(&Input::Frame(frame(5_000, &[0, 3])), at(4));
    assert_eq!(half.foreign_frames(), 1);
    // A subscription in the middle of the list of a channel.
    let [a, b, c] = [(); 3].map(|()| half.subscribe(&TEXT, Filter::ALL, fifo(1)).unwrap());
    half.cancel_subscription(b);
    half.on_input(&Input::Frame(frame(Etag::BOUND_FIRST.get(), b"hi")), at(5));
    for subscription in [&a, &c] {
        assert_eq!(half.next(subscription).unwrap().content.as_slice(), b"hi");
        assert!(half.next(subscription).is_none());
    }
}

#[test]
fn content_of_the_wrong_length_is_dropped_and_told() {
    let mut half = node();
    let subscription = half.subscribe(&SOFT, Filter::ALL, fifo(4)).unwrap();
    for bytes in [&[1][..], &[0, 2], &[1, 2, 3]] {
        half.on_input(&Input::Frame(frame(5_000, bytes)), at(1));
    }
    assert_eq!(half.next(&subscription).map(|event| event.content), Some(2));
    assert!(half.next(&subscription).is_none());
    assert_eq!(half.exceptions(ExceptionKind::Malformed), 2);
    let exception = half.take_exception().unwrap();
    assert_eq!((exception.subject, exception.kind), (Some(SOFT.subject()), ExceptionKind::Malformed));
}

#[test]
fn an_expired_event_is_told_and_not_sent() {
    let mut half = node();
    let text = half.announce(&TEXT).unwrap();
    let command = half.publish(at(0), &text, &Event::new(Payload::new(b"x").unwrap())).unwrap();
    let Some(Command::Load(Mailbox::NonRealTime, frame)) = command.command() else { panic!("{command:?}") };
    assert_eq!(frame.id.priority(), Priority::new(251));
    assert_eq!(half.poll(at(50_000)), Step::Command(Command::Withdraw(Mailbox::NonRealTime)));
    half.on_input(&Input::Outcome(Mailbox::NonRealTime, Outcome::Withdrawn), at(50_001));
    let exception = half.take_exception().unwrap();
    assert_eq!((exception.subject, exception.kind), (Some(TEXT.subject()), ExceptionKind::ValidityExpired));
    assert_eq!(half.channel_counters(TEXT.subject()).unwrap().discarded, 1);
}

/// A frame off the bus reaches a hard real-time channel through its slot only: one of another publisher or
/// priority is foreign, whatever its etag.
#[test]
fn a_frame_outside_the_calendar_is_no_hard_event() {
    let mut half = node();
    let subscription = half.subscribe(&hard(1), Filter::ALL, Policy::Latest).unwrap();
    let etag = Etag::new(101).unwrap();
    let stranger = TxNode::new(9).unwrap();
    for (priority, publisher) in
        [(Priority::HARD, stranger), (Priority::new(9), OTHER), (Priority::LEAST, OTHER)]
    {
        let frame = Frame::new(Id::new(priority, publisher, etag), Payload::new(&[0, 1]).unwrap());
        let input = receive(&frame, at(4_100), half.hard_mut()).expect("no buffer takes it");
        half.on_input(&input, at(4_100));
    }
    assert!(half.next(&subscription).is_none());
    assert_eq!(half.foreign_frames(), 3);
    let genuine = Frame::new(Id::new(Priority::HARD, OTHER, etag), Payload::new(&[0, 2]).unwrap());
    assert_eq!(receive(&genuine, at(4_200), half.hard_mut()), None, "its buffer takes it");
}

#[test]
fn what_was_lost_below_is_told_and_counted() {
    let mut half = node();
    half.on_input(&Input::Lost(0), at(1));
    assert_eq!(half.take_exception(), None);
    half.on_input(&Input::Lost(3), at(2));
    half.on_input(&Input::Overrun(2), at(3));
    half.on_input(&Input::BusOff, at(3));
    for kind in [ExceptionKind::InputLost, ExceptionKind::ReceiveOverrun, ExceptionKind::BusOff] {
        assert_eq!(half.take_exception().map(|exception| exception.kind), Some(kind));
    }
    let counts = [ExceptionKind::InputLost, ExceptionKind::ReceiveOverrun].map(|kind| half.exceptions(kind));
    assert_eq!(counts, [3, 2]);
}

/// Carries out what the dispatcher and the half want at this instant; outcomes are not told.
fn run<S: Services>(half: &mut Half<S>, dispatcher: &mut Dispatcher<2>, now: Instant) {
    loop {
        match dispatcher.poll(now, half.hard_mut()) {
            CalendarStep::Notify(buffer) => _ = half.on_input(&Input::Notice(buffer), now),
            CalendarStep::SleepUntil(_) => break,
            CalendarStep::Command(_) | CalendarStep::Continue => {}
        }
    }
    while let Step::Command(_) = half.poll(now) {}
}

#[test]
fn a_second_event_that_differs_is_told() {
    let mut half = node();
    let mut dispatcher = Dispatcher::new(&CALENDAR);
    let subscription = half.subscribe(&hard(1), Filter::ALL, Policy::Latest).unwrap();
    run(&mut half, &mut dispatcher, at(3_900));
    for (microseconds, bytes) in [(4_150, [0, 1]), (4_250, [0, 1]), (4_350, [0, 2])] {
        let id = Id::new(Priority::HARD, OTHER, Etag::new(101).unwrap());
        let frame = Frame::new(id, Payload::new(&bytes).unwrap());
        assert_eq!(receive(&frame, at(microseconds), half.hard_mut()), None);
    }
    run(&mut half, &mut dispatcher, at(4_600));
    assert_eq!(half.next(&subscription).unwrap().content, 1);
    let exception = half.take_exception().unwrap();
    assert_eq!(exception.kind, ExceptionKind::ContradictoryEvent);
    assert_eq!(exception.subject, Some(hard(1).subject()));
    assert_eq!(half.take_exception(), None);
}

#[test]
fn a_hard_event_under_the_nodes_own_name_is_told_and_reaches_no_subscriber() {
    let service = ClockService::new(SyncConfig::DEFAULT, &CALENDAR, Some(ME), at(0)).unwrap();
    let buffers = Buffers::new(GlobalClock::free_running());
    let mut half: Half<ClockService> = Half::new(Some(ME), &CALENDAR, service, buffers);
    let publication = half.announce(&hard(0)).unwrap();
    let subscription = half.subscribe(&hard(0), Filter::ALL, Policy::Latest).unwrap();
    let id = Id::new(Priority::HARD, ME, Etag::new(100).unwrap());
    let frame = Frame::new(id, Payload::new(&[6, 6]).unwrap());
    let input = receive(&frame, at(2_100), half.hard_mut()).expect("no buffer takes it");
    half.on_input(&input, at(2_100));
    while let Step::Command(_) = half.poll(at(2_100)) {}
    assert_eq!(half.exceptions(ExceptionKind::DuplicateTxNode), 1);
    assert!(half.next(&subscription).is_none());
    let _ = half.cancel_publication(publication);
}

#[test]
fn a_hard_event_that_is_not_fetched_in_time_is_overwritten() {
    let mut half = node();
    let mut dispatcher = Dispatcher::<2>::new(&CALENDAR);
    let subscription = half.subscribe(&hard(1), Filter::ALL, fifo(2)).unwrap();
    let mut notice = None;
    let id = Id::new(Priority::HARD, OTHER, Etag::new(101).unwrap());
    // The slot is ready at 4 ms and 14 ms; nobody looks after the first.
    for now in (0..20_000).step_by(100) {
        if matches!(now, 4_500 | 14_500) {
            let frame = Frame::new(id, Payload::new(&[0, (now / 10_000) as u8]).unwrap());
            assert_eq!(receive(&frame, at(now), half.hard_mut()), None);
        }
        loop {
            match dispatcher.poll(at(now), half.hard_mut()) {
                CalendarStep::SleepUntil(_) => break,
                CalendarStep::Notify(buffer) => notice = Some(buffer),
                CalendarStep::Continue => {}
                step => panic!("{step:?}"),
            }
        }
    }
    half.on_input(&Input::Notice(notice.unwrap()), at(20_000));
    assert_eq!(half.exceptions(ExceptionKind::EventOverwritten), 1);
    assert_eq!(half.exceptions(ExceptionKind::QueueFull), 0);
    assert_eq!(half.next(&subscription).unwrap().content, 1);
    assert!(half.next(&subscription).is_none());
}

/// One priority stands for as much of the remaining time as the plan of the cluster says.
#[test]
fn the_priority_step_of_the_calendar_is_that_of_the_node() {
    static COARSE: Calendar = CALENDAR.with_priority_step(Duration::from_millis(1));
    let priority = |calendar| {
        let mut half = Half::new(Some(ME), calendar, (), Buffers::new(GlobalClock::free_running()));
        let publication = half.announce(&SOFT).unwrap();
        let due = half.publish(at(0), &publication, &Event::new(7)).unwrap();
        let Some(Command::Load(Mailbox::Soft, frame)) = due.command() else { panic!("{due:?}") };
        frame.id.priority()
    };
    // 5 ms are 31 longest frames of 160 µs.
    assert_eq!(priority(&CALENDAR), Priority::new(1 + 31));
    assert_eq!(priority(&COARSE), Priority::new(1 + 5));
    assert_eq!(CALENDAR.digest(), COARSE.digest());
}

/// A frame that comes shortly before its slot, by an accident or an attack, does not cost the event of the slot.
#[test]
fn an_early_frame_is_not_the_first_copy_of_the_event() {
    let mut half = node();
    let mut dispatcher = Dispatcher::new(&CALENDAR);
    let subscription = half.subscribe(&hard(1), Filter::ALL, fifo(2)).unwrap();
    let frame = |value| {
        let id = Id::new(Priority::HARD, OTHER, Etag::new(101).unwrap());
        Frame::new(id, Payload::new(&[0, value]).unwrap())
    };
    run(&mut half, &mut dispatcher, at(0));
    // The slot is ready at 4 ms.
    assert_eq!(receive(&frame(1), at(3_900), half.hard_mut()), None);
    run(&mut half, &mut dispatcher, at(4_000));
    assert_eq!(receive(&frame(2), at(4_200), half.hard_mut()), None);
    run(&mut half, &mut dispatcher, at(5_000));
    assert_eq!(half.next(&subscription).map(|event| event.content), Some(2));
    assert_eq!(half.exceptions(ExceptionKind::MissedEvent), 0);
}

#[test]
fn a_host_without_a_clock_for_the_calendar_delivers_at_once() {
    let mut half = node();
    let channel: Channel<Payload> = Channel::hard(subject(0x102), Etag::new(102).unwrap(), QUALITY);
    let subscription = half.subscribe_early(&channel, Filter::ALL, fifo(2)).unwrap();
    let frame = |publisher, priority| {
        let id = Id::new(Priority::new(priority), publisher, Etag::new(102).unwrap());
        Frame::new(id, Payload::new(&[7, 8]).unwrap())
    };
    // Neither what another node sends, nor at another priority.
    assert!(!half.on_early_frame(&frame(ME, 0), at(1)));
    assert!(!half.on_early_frame(&frame(OTHER, 1), at(1)));
    assert!(half.next(&subscription).is_none());
    assert!(half.on_early_frame(&frame(OTHER, 0), at(2)));
    let event = half.next(&subscription).unwrap();
    assert_eq!((event.content.as_slice(), event.publisher, event.received_at), (&[7, 8][..], OTHER, at(2)));
    let unplanned: Channel<Payload> = Channel::hard(subject(0x109), Etag::new(109).unwrap(), QUALITY);
    let refused = half.subscribe_early(&unplanned, Filter::ALL, fifo(2)).map(|_| ());
    assert_eq!(refused, Err(SubscribeError::Channel(AnnounceError::NotInCalendar)));
    half.cancel_subscription(subscription);
    assert!(half.on_early_frame(&frame(OTHER, 0), at(3)));
    assert_eq!(half.foreign_frames(), 1);
}

/// A node that has no room for a class at all: what it cannot do it refuses, and the rest works.
#[test]
fn a_node_without_places_for_a_class_refuses_it_and_does_the_rest() {
    let mut half = EventHalf::<0, 4, 3, 4, 0, { 2 + RESERVED }>::new(
        Some(ME),
        &CALENDAR,
        (),
        HrtBuffers::new(GlobalClock::free_running()),
    );
    assert_eq!(half.announce(&hard(0)).unwrap_err(), AnnounceError::TooManySlots);
    let refused = half.subscribe(&hard(1), Filter::ALL, fifo(1)).unwrap_err();
    assert_eq!(refused, SubscribeError::Channel(AnnounceError::TooManySlots));
    assert_eq!(half.announce(&SOFT).unwrap_err(), AnnounceError::TooManyChannels);

    // It hears soft real-time events, and frames of hard real-time are nobody's.
    let heard = half.subscribe(&SOFT, Filter::ALL, fifo(2)).unwrap();
    let hard_frame =
        Frame::new(Id::new(Priority::HARD, OTHER, Etag::new(101).unwrap()), Payload::new(&[1, 2]).unwrap());
    for frame in [hard_frame, frame(5_000, &[0, 7])] {
        let input = receive(&frame, at(10), half.hard_mut()).unwrap();
        half.on_input(&input, at(10));
    }
    assert_eq!(half.next(&heard).unwrap().content, 7);
    assert_eq!(half.next(&heard), None);
    assert_eq!(half.foreign_frames(), 1);
    assert_eq!(event_half::outcome(Mailbox::Hard, Outcome::Sent, at(11), half.hard_mut()), None);

    // It publishes in non real-time, to the end.
    let text = half.announce(&TEXT).unwrap();
    let due = half.publish(at(20), &text, &Event::new(Payload::new(b"a").unwrap())).unwrap();
    assert!(matches!(due.command(), Some(Command::Load(Mailbox::NonRealTime, _))));
    let behind = half.publish(at(21), &text, &Event::new(Payload::new(b"b").unwrap())).unwrap();
    assert_eq!(behind, Due::NOTHING);
    half.on_input(&Input::Outcome(Mailbox::NonRealTime, Outcome::Sent), at(200));
    assert!(matches!(half.poll(at(200)), Step::Command(Command::Load(Mailbox::NonRealTime, _))));
    half.on_input(&Input::Outcome(Mailbox::NonRealTime, Outcome::Sent), at(400));
    assert!(matches!(half.poll(at(400)), Step::SleepUntil(_)));
    assert_eq!(half.etch_counters().sent, 2);
    half.cancel_subscription(heard);
    let _ = half.cancel_publication(text);
}
