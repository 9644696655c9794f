//! Messages longer than a frame.

use std::cell::RefCell;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use cosmic_core::Subject;
use cosmic_core::can::{Frame, Id, Mailbox, Outcome, Payload, Priority};
use cosmic_core::event_layer::{Bytes, ExceptionKind, Importance, MessageChannel, NonRealTimeAttributes};
use cosmic_core::time::Duration;
use cosmic_rtic::{Events, Message, MessageError, MessagePublisher, MessageSubscriber, Parts};

use crate::bench::*;

type Lines = MessageChannel<Bytes<30>, 30, 1>;

const ATTRIBUTES: NonRealTimeAttributes =
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None };
const LINES: Lines = MessageChannel::new(Subject::new(0xD1).unwrap(), ATTRIBUTES).with_etag(ETAG);
/// As it is published, in pieces of seven bytes with two of CRC: four frames.
const TEXT: &[u8] = b"twenty bytes or less";

/// Counts how often its task was woken.
#[derive(Default)]
struct Count(AtomicU32);

impl Wake for Count {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

impl Count {
    fn take(&self) -> u32 {
        self.0.swap(0, Ordering::Relaxed)
    }
}

fn text(bytes: &[u8]) -> Bytes<30> {
    Bytes::new(bytes).unwrap()
}

/// The frame that is in the mailbox, which thereby leaves it.
fn send_loaded(
    outcomes: &mut cosmic_rtic::Outcomes<Tested>,
    events: &mut Events,
    node: &RefCell<Node>,
) -> Frame {
    let loaded = LOADED.take();
    assert_eq!(loaded.len(), 1, "one fragment at a time");
    assert_eq!(loaded[0].0, Mailbox::NonRealTime);
    OUTCOMES.with_borrow_mut(|outcomes| outcomes.push_back((Mailbox::NonRealTime, Outcome::Sent)));
    outcomes.run();
    run_events(events, node);
    loaded[0].1
}

type Node = cosmic_rtic::Node<Tested>;

fn poll<F: Future>(task: Pin<&mut F>, count: &Arc<Count>) -> Poll<F::Output> {
    task.poll(&mut Context::from_waker(&Waker::from(count.clone())))
}

fn receive(frame: &Frame, publisher: cosmic_core::can::TxNode) {
    let id = Id::new(frame.id.priority(), publisher, frame.id.etag());
    RECEIVED.with_borrow_mut(|received| received.push_back(Frame::new(id, frame.payload)));
}

#[test]
fn the_task_that_publishes_sleeps_until_a_frame_has_left_and_ends_with_the_last() {
    let Parts { node, mut events, mut outcomes, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let mut lines = MessagePublisher::announce(&LINES, &mut resource).unwrap();
    let count = Arc::new(Count::default());
    let content = text(TEXT);
    let mut task = pin!(lines.publish(&content, &mut resource));
    for frame in 0..4 {
        assert!(poll(task.as_mut(), &count).is_pending());
        run_events(&mut events, &node);
        assert_eq!(count.take(), 0, "nothing has left");
        let sent = send_loaded(&mut outcomes, &mut events, &node);
        assert_eq!(sent.payload.as_slice()[0] & 0x0F, frame);
        assert_eq!(count.take(), 1);
    }
    assert_eq!(poll(task.as_mut(), &count), Poll::Ready(Ok(())));
    assert!(LOADED.take().is_empty());
    let told = ["80", "01", "02", "43"].map(|header| format!("published {header} true"));
    assert_eq!(notes(&node), told, "the observer hears of each frame");
}

#[test]
fn a_message_in_each_period() {
    let Parts { node, mut events, mut outcomes, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let mut numbers = b'1'..;
    let number = |_: &mut Resource<'_>| text(&[numbers.next().unwrap()]);
    let period = Duration::from_micros(10);
    let mut task = pin!(cosmic_rtic::publish_message_every(&LINES, period, &mut resource, number));
    for (now, sent) in [(0, None), (9_999, None), (10_000, Some(b'1')), (20_000, Some(b'2'))] {
        NOW.set(now);
        run(task.as_mut());
        if let Some(sent) = sent {
            assert_eq!(send_loaded(&mut outcomes, &mut events, &node).payload.as_slice()[1], sent);
            run(task.as_mut());
        }
        assert!(LOADED.take().is_empty(), "one message in a period");
    }
}

#[test]
fn a_message_that_cannot_be_published_says_so() {
    let Parts { node, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let unbound: Lines = MessageChannel::new(Subject::new(0xD2).unwrap(), ATTRIBUTES);
    let mut lines = MessagePublisher::announce(Box::leak(Box::new(unbound)), &mut resource).unwrap();
    let count = Arc::new(Count::default());
    let content = text(TEXT);
    let result = poll(pin!(lines.publish(&content, &mut resource)), &count);
    let error = cosmic_core::event_layer::PublishError::NotBound;
    assert_eq!(result, Poll::Ready(Err(MessageError::Publish(error))));
}

#[test]
fn a_message_whose_frame_expires_ends_with_an_error() {
    let Parts { node, mut events, mut outcomes, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let validity = Some(Duration::from_millis(1));
    let attributes = NonRealTimeAttributes { validity, ..ATTRIBUTES };
    let channel: Lines = MessageChannel::new(Subject::new(0xD3).unwrap(), attributes).with_etag(ETAG);
    let mut lines = MessagePublisher::announce(Box::leak(Box::new(channel)), &mut resource).unwrap();
    let count = Arc::new(Count::default());
    let content = text(TEXT);
    let mut task = pin!(lines.publish(&content, &mut resource));
    assert!(poll(task.as_mut(), &count).is_pending());
    NOW.set(2_000_000);
    run_events(&mut events, &node);
    // The frame is being withdrawn; the controller says that it was.
    OUTCOMES.with_borrow_mut(|outcomes| outcomes.push_back((Mailbox::NonRealTime, Outcome::Withdrawn)));
    outcomes.run();
    run_events(&mut events, &node);
    assert!(count.take() > 0);
    assert_eq!(poll(task.as_mut(), &count), Poll::Ready(Err(MessageError::Discarded)));
    LOADED.take();
}

/// As by a `select` of futures: what it has begun is sent before the next message.
#[test]
fn a_call_that_is_given_up_leaves_nothing_half_sent() {
    let Parts { node, mut events, mut outcomes, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let mut lines = MessagePublisher::announce(&LINES, &mut resource).unwrap();
    let count = Arc::new(Count::default());
    let (first, second) = (text(TEXT), text(b"second"));
    assert!(poll(pin!(lines.publish(&first, &mut resource)), &count).is_pending());
    let mut task = pin!(lines.publish(&second, &mut resource));
    let mut frames = Vec::new();
    while poll(task.as_mut(), &count).is_pending() {
        frames.push(send_loaded(&mut outcomes, &mut events, &node));
    }
    // Four frames of message 0, then message 1, in one.
    let headers: Vec<_> = frames.iter().map(|frame| frame.payload.as_slice()[0]).collect();
    assert_eq!(headers, [0x80, 0x01, 0x02, 0x43, 0xD0]);
    assert_eq!(&frames[4].payload.as_slice()[1..], b"second");
}

#[test]
fn the_task_that_subscribes_is_woken_by_frames_and_gets_whole_messages() {
    let Parts { node, mut events, mut other, mut outcomes, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let mut lines = MessagePublisher::announce(&LINES, &mut resource).unwrap();
    let count = Arc::new(Count::default());
    let content = text(TEXT);
    let mut frames = Vec::new();
    {
        let mut task = pin!(lines.publish(&content, &mut resource));
        while poll(task.as_mut(), &count).is_pending() {
            frames.push(send_loaded(&mut outcomes, &mut events, &node));
        }
    }
    notes(&node);
    let time_out = Duration::from_millis(100);
    let mut subscriber = MessageSubscriber::subscribe(&LINES, time_out, &mut resource).unwrap();
    count.take();
    let mut task = pin!(subscriber.next(&mut resource));
    assert!(poll(task.as_mut(), &count).is_pending());
    let last = frames.len() - 1;
    for (number, frame) in frames.iter().enumerate() {
        receive(frame, OTHER);
        other.run();
        run_events(&mut events, &node);
        assert_eq!(count.take(), 1);
        let next = poll(task.as_mut(), &count);
        if number < last {
            assert!(next.is_pending());
        } else {
            assert_eq!(next, Poll::Ready(Message { content, publisher: OTHER }));
        }
    }
}

#[test]
fn a_message_that_is_no_value_of_the_type_is_passed_over_and_told() {
    let Parts { node, mut events, mut other, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let flags: MessageChannel<bool, 30, 1> =
        MessageChannel::new(Subject::new(0xD1).unwrap(), ATTRIBUTES).with_etag(ETAG);
    let time_out = Duration::from_millis(100);
    let mut subscriber =
        MessageSubscriber::subscribe(Box::leak(Box::new(flags)), time_out, &mut resource).unwrap();
    // Messages of one frame: 2 is no `bool`, 1 is.
    for bytes in [[0xC0, 2], [0xD0, 1]] {
        let id = Id::new(Priority::LEAST, OTHER, ETAG);
        let payload = Payload::new(&bytes).unwrap();
        RECEIVED.with_borrow_mut(|received| received.push_back(Frame::new(id, payload)));
    }
    other.run();
    run_events(&mut events, &node);
    let count = Arc::new(Count::default());
    let next = poll(pin!(subscriber.next(&mut resource)), &count);
    assert_eq!(next, Poll::Ready(Message { content: true, publisher: OTHER }));
    assert_eq!(exceptions(&node, ExceptionKind::Malformed), 1);
}
