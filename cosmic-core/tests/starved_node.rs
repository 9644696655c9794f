//! A node whose non real-time frames never win the bus: its clock synchronisation goes on.

use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Command, Etag, Mailbox, Outcome, TxNode};
use cosmic_core::event_layer::{Channel, Event, Importance, NonRealTimeAttributes, PublishError};
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::protocol::Rank;
use cosmic_core::services::{NodeConfig, NodeServices};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_core::{EventHalf, Input, NodeUid, Step, Subject};

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[],
);

const BULK: Channel<u32> = Channel::non_real_time(
    Subject::new(1).unwrap(),
    NonRealTimeAttributes { importance: Importance::MOST, validity: None },
)
.with_etag(Etag::BOUND_FIRST);

#[test]
fn the_clock_goes_on_when_non_real_time_frames_starve() {
    let config = NodeConfig {
        tx_node: TxNode::new(1),
        clock: SyncConfig { rank: Some(Rank::FIRST), ..SyncConfig::DEFAULT },
        ..NodeConfig::new(NodeUid::new(1).unwrap())
    };
    let services = NodeServices::<2, 4, 2, 2>::new(&config, &CALENDAR, (), Instant::EPOCH).unwrap();
    let hard = HrtBuffers::new(GlobalClock::unsynchronised());
    let mut half = EventHalf::<2, 2, 2, 4, 4, 4, _>::new(config.tx_node, &CALENDAR, services, hard);
    let bulk = half.announce(&BULK).unwrap();
    let (mut sent, mut stuck) = (Vec::new(), 0);
    for millisecond in 0..3_000 {
        let now = Instant::from_epoch(Duration::from_millis(millisecond));
        // Until then it claims its id.
        let starved = millisecond >= 500;
        if starved {
            let published = half.publish(now, &bulk, &Event::new(1));
            stuck += u32::from(published == Err(PublishError::QueueFull));
        }
        while let Step::Command(command) = half.poll(now) {
            let Command::Load(mailbox, frame) = command else { continue };
            if mailbox == Mailbox::Soft || !starved {
                sent.push(frame.id.etag());
                half.on_input(&Input::Outcome(mailbox, Outcome::Sent), now + Duration::from_micros(150));
            }
        }
    }
    assert!(stuck > 2_400, "{stuck}");
    // Master after eight periods of 100 ms; then a sync frame and its follow-up in each.
    let count = |etag| sent.iter().filter(|it| **it == etag).count();
    assert_eq!((count(Etag::SYNC), count(Etag::FOLLOW_UP)), (22, 22), "{sent:?}");
    assert!(half.services().clock().is_master());
}
