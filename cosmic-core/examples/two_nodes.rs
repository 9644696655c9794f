//! Two nodes in one process: what one publishes, the other receives. The frame is carried by hand.

use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Command, Etag, Outcome, TxNode};
use cosmic_core::event_half::{outcome, receive};
use cosmic_core::event_layer::{Channel, Event, Filter, Policy, SoftAttributes};
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_core::{EventHalf, Subject};

/// Both know the channel: its subject, its quality, what it carries, and its etag on this bus.
const HEAT: Channel<i16> = Channel::soft(
    Subject::new(0x2A).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) },
)
.with_etag(Etag::BOUND_FIRST);

/// No hard real-time slots in this segment.
static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    Duration::from_millis(10),
    &[],
);

/// One slot, four channels, four subscriptions, eight events that wait, six to be sent of each class.
type Node = EventHalf<1, 4, 4, 8, 6, 6>;

fn node(number: u8) -> Node {
    Node::new(TxNode::new(number), &CALENDAR, (), HrtBuffers::new(GlobalClock::free_running()))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let now = Instant::EPOCH;
    let (mut sensor, mut display) = (node(1), node(2));
    let heat = sensor.announce(&HEAT)?;
    let subscription = display.subscribe(&HEAT, Filter::ALL, Policy::Latest)?;

    // Publishing yields a command for the controller: load this frame into this mailbox.
    let due = sensor.publish(now, &heat, &Event::new(21))?;
    let Some(Command::Load(mailbox, frame)) = due.command() else { return Err("no frame".into()) };
    println!("on the bus: {frame}");

    // The bus: the sender learns that it was sent, the others receive it.
    let at = now + BitRate::MAX.longest_frame(frame.payload.len());
    if let Some(input) = outcome(mailbox, Outcome::Sent, at, sensor.hard_mut()) {
        sensor.on_input(&input, at);
    }
    if let Some(input) = receive(&frame, at, display.hard_mut()) {
        display.on_input(&input, at);
    }
    let event = display.next(&subscription).ok_or("no event")?;
    println!("node {} says {} degrees", event.publisher, event.content);
    assert_eq!((event.publisher.get(), event.content), (1, 21));
    Ok(())
}

#[test]
fn runs() {
    main().unwrap();
}
