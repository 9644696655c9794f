//! Event rates: a publisher is held to what it announced, and a subscriber is told of what does not come.

use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::event_half::{Due, EventHalf, Input, Step, receive};
use cosmic_core::event_layer::{
    AnnounceError, Channel, ChannelCounters, Constant, Depth, Event, EventRate, ExceptionKind, Filter,
    Importance, MessagePublisher, NonRealTimeAttributes, Policy, PublishError, SoftAttributes,
};
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::network::soft::RESERVED;
use cosmic_core::time::{Duration, GlobalClock, Instant};

const ME: TxNode = TxNode::new(1).unwrap();
const OTHER: TxNode = TxNode::new(2).unwrap();

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    Duration::from_millis(10),
    &[],
);

const ETAG: Etag = Etag::new(5_000).unwrap();

const fn subject(number: u64) -> Subject {
    Subject::new(number).unwrap()
}

const fn plain(number: u64, etag: u16) -> Channel<u16> {
    let attributes =
        SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(8) };
    Channel::soft(subject(number), attributes).with_etag(Etag::new(etag).unwrap())
}

/// Twice at once, then every 10 ms; a 4096th of the interval (2441 ns) is for the clocks.
const BURSTS: Channel<u16> =
    plain(0x200, 5_000).with_rate(EventRate::sporadic(Duration::from_millis(10)).with_burst(2));

/// Every 10 ms, up to 1 ms late, and sent 5 ms later at worst.
const PERIODIC: Channel<u16> = plain(0x200, 5_000)
    .with_rate(EventRate::periodic(Duration::from_millis(10)).with_jitter(Duration::from_millis(1)));

const TEXT: Channel<Payload> = Channel::non_real_time(
    subject(0x300),
    NonRealTimeAttributes { importance: Importance::MOST, validity: None },
)
.with_etag(Etag::BOUND_FIRST)
.with_rate(EventRate::sporadic(Duration::from_millis(100)));

fn at(microseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_micros(microseconds))
}

type Half = EventHalf<2, 4, 3, 8, { 2 + RESERVED }, { 2 + RESERVED }>;

fn node() -> Half {
    Half::new(Some(ME), &CALENDAR, (), HrtBuffers::new(GlobalClock::free_running()))
}

/// What goes on the bus is sent at once.
fn send(half: &mut Half, due: Due, now: Instant) -> Option<Frame> {
    let Some(Command::Load(mailbox, frame)) = due.command() else { return None };
    half.on_input(&Input::Outcome(mailbox, Outcome::Sent), now);
    Some(frame)
}

/// Returns when it is to be polled next.
fn poll(half: &mut Half, now: Instant) -> Instant {
    loop {
        match half.poll(now) {
            Step::SleepUntil(instant) => return instant,
            Step::Command(Command::Load(mailbox, _)) => {
                half.on_input(&Input::Outcome(mailbox, Outcome::Sent), now);
            }
            Step::Command(Command::Withdraw(_)) => {}
        }
    }
}

/// Returns whether something may be due earlier.
fn arrive(half: &mut Half, now: Instant) -> bool {
    let frame = Frame::new(Id::new(Priority::new(9), OTHER, ETAG), Payload::new(&[0, 7]).unwrap());
    let input = receive(&frame, now, half.hard_mut()).unwrap();
    half.on_input(&input, now)
}

#[test]
fn a_publisher_is_held_to_its_rate() {
    let mut half = node();
    let publication = half.announce(&BURSTS).unwrap();
    let mut publish = |now| {
        let due = half.publish(at(now), &publication, &Event::new(7));
        due.map(|due| send(&mut half, due, at(now)))
    };
    // Deadline 5 ms, Δt_p 160 us: priority 32 of node 1, etag 5000.
    let frame = Frame::new(Id::from_raw(0x0400_5388).unwrap(), Payload::new(&[0, 7]).unwrap());
    assert_eq!(publish(0), Ok(Some(frame)));
    assert_eq!(publish(0), Ok(Some(frame)));
    assert_eq!(publish(0), Err(PublishError::TooFast));
    assert_eq!(publish(9_990), Err(PublishError::TooFast));
    assert_eq!(publish(9_998), Ok(Some(frame)));
    assert_eq!(publish(9_998), Err(PublishError::TooFast));
    let counters = half.channel_counters(BURSTS.subject()).unwrap();
    let expected = ChannelCounters { published: 3, refused: 3, too_fast: 3, sent: 3, ..Default::default() };
    assert_eq!(counters, expected);
    assert_eq!(half.exceptions(ExceptionKind::RateExceeded), 3);
    let exception = half.take_exception().unwrap();
    assert_eq!((exception.subject, exception.at), (Some(BURSTS.subject()), at(0)));
}

#[test]
fn an_event_that_is_refused_for_another_reason_costs_nothing() {
    let mut half = node();
    let rate = EventRate::sporadic(Duration::from_millis(10));
    let channel = plain(0x200, 5_000).with_rate(rate);
    let publication = half.announce(&channel).unwrap();
    let late = Event::new(1).deadline(at(50));
    assert_eq!(half.publish(at(50), &publication, &late), Err(PublishError::Deadline));
    let due = half.publish(at(60), &publication, &Event::new(1)).unwrap();
    assert!(send(&mut half, due, at(60)).is_some());
    // An event that comes too early is not given back what it was not charged.
    assert_eq!(half.publish(at(70), &publication, &Event::new(1)), Err(PublishError::TooFast));
    assert_eq!(half.publish(at(80), &publication, &Event::new(1)), Err(PublishError::TooFast));
    // The queue is full: by a channel without a rate.
    let other = half.announce(&plain(0x201, 5_001)).unwrap();
    while half.publish(at(20_000), &other, &Event::new(1)).is_ok() {}
    assert_eq!(half.publish(at(20_000), &publication, &Event::new(1)), Err(PublishError::QueueFull));
    let _ = half.cancel_publication(other);
    half.on_input(&Input::Outcome(Mailbox::Soft, Outcome::Withdrawn), at(20_001));
    assert!(half.publish(at(20_002), &publication, &Event::new(1)).is_ok());
}

#[test]
fn giving_a_channel_up_and_announcing_it_again_fills_no_bucket() {
    let mut half = node();
    let publish = |half: &mut Half, now| {
        let publication = half.announce(&BURSTS).unwrap();
        let published = half.publish(at(now), &publication, &Event::new(7));
        if let Ok(due) = published {
            send(half, due, at(now)).unwrap();
        }
        let [Due::NOTHING, Due::NOTHING] = half.cancel_publication(publication) else { panic!() };
        published.is_ok()
    };
    let taken = (0..40).filter(|_| publish(&mut half, 5)).count();
    assert_eq!(taken, 2);
    // The channel is remembered, but takes no place and no name from others, and may come back as another one.
    let channels: Vec<_> =
        (0..3).map(|number| half.announce(&plain(0x210 + number, 5_010 + number as u16))).collect();
    assert!(channels.iter().all(Result::is_ok));
    let same_etag = half.announce(&plain(0x220, 5_000)).unwrap();
    assert_eq!(half.announce(&BURSTS).unwrap_err(), AnnounceError::TooManyChannels);
    let _ = half.cancel_publication(same_etag);
    half.announce(&plain(0x200, 5_000)).unwrap();
    assert_eq!(half.announce(&BURSTS).unwrap_err(), AnnounceError::Contradiction);
}

#[test]
fn a_message_counts_once_however_many_frames_it_has() {
    let mut half = node();
    let mut publisher = MessagePublisher::<64>::new(half.announce(&TEXT).unwrap());
    let mut send_all = |now| {
        publisher.start(&[0x5A; 30]).unwrap();
        let mut frames = 0;
        while !publisher.is_idle() {
            let due = half.send_message(at(now), &mut publisher)?;
            frames += u32::from(send(&mut half, due, at(now)).is_some());
        }
        Ok(frames)
    };
    assert_eq!(send_all(0), Ok(5));
    // Refused as a whole: no frame of it goes.
    assert_eq!(send_all(50_000), Err(PublishError::TooFast));
    assert_eq!(send_all(100_000), Ok(5));
    let counters = half.channel_counters(TEXT.subject()).unwrap();
    assert_eq!((counters.published, counters.sent, counters.too_fast), (10, 10, 1));
}

#[test]
fn a_subscriber_is_told_of_each_periodic_event_that_does_not_come() {
    // By the long way and by the short one.
    for policy in [Policy::Latest, Policy::Fifo(Depth::new(8).unwrap())] {
        each_event_that_does_not_come_is_told(policy);
    }
}

fn each_event_that_does_not_come_is_told(policy: Policy) {
    let mut half = node();
    let subscription = half.subscribe(&PERIODIC, Filter::ALL, policy).unwrap();
    // Nothing has come yet: nothing is awaited.
    assert_eq!(poll(&mut half, at(1_000_000)), Instant::FAR_FUTURE);
    assert!(arrive(&mut half, at(1_000_000)), "the next is awaited");
    // Period, jitter, deadline, and a 4096th of the period.
    let overdue = at(1_016_000) + Duration::from_ticks(2441);
    assert_eq!(poll(&mut half, at(1_000_000)), overdue);
    // The next is as late as it may be.
    assert!(!arrive(&mut half, at(1_016_002)), "nothing is awaited earlier");
    let overdue = at(1_032_002) + Duration::from_ticks(2441);
    assert_eq!(poll(&mut half, at(1_016_003)), overdue);
    assert_eq!(half.exceptions(ExceptionKind::EventOverdue), 0);
    // Then one does not come, and another one neither.
    assert_eq!(poll(&mut half, overdue), overdue + Duration::from_millis(10));
    let exception = half.take_exception().unwrap();
    assert_eq!(
        (exception.subject, exception.kind, exception.at),
        (Some(PERIODIC.subject()), ExceptionKind::EventOverdue, overdue)
    );
    assert_eq!(poll(&mut half, overdue + Duration::from_millis(10)), overdue + Duration::from_millis(20));
    assert_eq!(half.exceptions(ExceptionKind::EventOverdue), 2);
    // The publisher is back.
    arrive(&mut half, at(1_060_000));
    assert_eq!(poll(&mut half, at(1_060_000)), at(1_076_000) + Duration::from_ticks(2441));
    assert_eq!(half.next(&subscription).map(|event| event.content), Some(7));
    // Nobody waits any more.
    half.cancel_subscription(subscription);
    assert_eq!(poll(&mut half, at(2_000_000)), Instant::FAR_FUTURE);
    assert_eq!(half.exceptions(ExceptionKind::EventOverdue), 2);
}

#[test]
fn an_event_that_was_received_before_it_was_missed_brings_the_next_forward() {
    for policy in [Policy::Latest, Policy::Fifo(Depth::new(8).unwrap())] {
        let mut half = node();
        half.subscribe(&PERIODIC, Filter::ALL, policy).unwrap();
        arrive(&mut half, at(0));
        arrive(&mut half, at(10_000));
        let overdue = at(26_000) + Duration::from_ticks(2441);
        assert_eq!(poll(&mut half, overdue), overdue + Duration::from_millis(10));
        assert_eq!(half.exceptions(ExceptionKind::EventOverdue), 1);
        // It had waited in a queue.
        assert!(arrive(&mut half, at(19_000)), "the next is awaited from then on");
        assert_eq!(poll(&mut half, overdue), at(35_000) + Duration::from_ticks(2441));
    }
}

#[test]
fn a_late_poll_tells_all_that_were_missed_at_once() {
    let mut half = node();
    half.subscribe(&PERIODIC, Filter::ALL, Policy::Latest).unwrap();
    arrive(&mut half, at(0));
    let next = poll(&mut half, at(16_003 + 95_000));
    assert_eq!(half.exceptions(ExceptionKind::EventOverdue), 10);
    assert_eq!(next, at(16_000 + 100_000) + Duration::from_ticks(2441));
    // A clock that jumps to the end of the time scale ends the wait, and not the node.
    assert_eq!(poll(&mut half, Instant::FAR_FUTURE), Instant::FAR_FUTURE);
    arrive(&mut half, Instant::FAR_FUTURE);
    let _ = poll(&mut half, Instant::FAR_FUTURE);
}

#[test]
fn only_periodic_soft_channels_are_awaited() {
    let mut half = node();
    half.subscribe(&BURSTS, Filter::ALL, Policy::Latest).unwrap();
    arrive(&mut half, at(0));
    assert_eq!(poll(&mut half, at(10_000_000)), Instant::FAR_FUTURE);
    assert_eq!(half.exceptions(ExceptionKind::EventOverdue), 0);
}

#[test]
fn a_publication_on_the_node_itself_is_an_event_like_any_other() {
    let mut half = node();
    half.subscribe(&PERIODIC, Filter::ALL, Policy::Latest).unwrap();
    let publication = half.announce(&PERIODIC).unwrap();
    let due = half.publish(at(0), &publication, &Event::new(1)).unwrap();
    send(&mut half, due, at(0)).unwrap();
    assert_eq!(poll(&mut half, at(0)), at(16_000) + Duration::from_ticks(2441));
}

#[test]
fn rates_must_agree_within_a_node() {
    let mut half = node();
    half.announce(&BURSTS).unwrap();
    assert_eq!(half.announce(&PERIODIC).unwrap_err(), AnnounceError::Contradiction);
}

type Constants =
    EventHalf<2, 4, 3, 8, { 2 + RESERVED }, { 2 + RESERVED }, (), HrtBuffers<2>, Constant<true, false>>;

#[test]
fn a_node_without_rates_leaves_them_to_its_application() {
    let mut half = Constants::new(Some(ME), &CALENDAR, (), HrtBuffers::new(GlobalClock::free_running()));
    static BURSTS_HERE: Channel<u16> = BURSTS;
    static AWAITED: Channel<u16> =
        plain(0x201, 5_001).with_rate(EventRate::periodic(Duration::from_millis(10)));
    let publication = half.announce(&BURSTS_HERE).unwrap();
    for now in [0, 0, 1, 2] {
        let due = half.publish(at(now), &publication, &Event::new(7)).unwrap();
        let Some(Command::Load(mailbox, _)) = due.command() else { panic!("not sent at once") };
        half.on_input(&Input::Outcome(mailbox, Outcome::Sent), at(now));
    }
    let subscription = half.subscribe(&AWAITED, Filter::ALL, Policy::Latest).unwrap();
    let id = Id::new(Priority::new(9), OTHER, Etag::new(5_001).unwrap());
    let frame = Frame::new(id, Payload::new(&[0, 7]).unwrap());
    assert!(!half.on_input(&Input::Frame(frame), at(10)), "nothing is awaited");
    assert_eq!(half.next(&subscription).map(|event| event.content), Some(7));
    assert_eq!(half.poll(at(1_000_000)), Step::SleepUntil(Instant::FAR_FUTURE));
    assert_eq!(
        half.exceptions(ExceptionKind::EventOverdue) + half.exceptions(ExceptionKind::RateExceeded),
        0
    );
}
