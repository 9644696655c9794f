//! Nodes on a simulated segment, in virtual time: tokio's clock is stopped, and goes on when all wait.

mod common;

use std::time::Duration as Span;

use common::{Bed, HEAT, TEXT, uid};
use cosmic_core::admission::{AdmissionPlan, Reservations, Unplanned};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::client::AdmissionState;
use cosmic_core::event_layer::{
    Channel, Event, EventRate, ExceptionKind, HardAttributes, Policy, PublishError,
};
use cosmic_core::protocol::RefusalReason;
use cosmic_core::services::News;
use cosmic_core::time::Duration;
use cosmic_core::{Subject, broker::BrokerRole};
use cosmic_linux::{AnnounceError, BrokerTables, Config, Node};

/// A station that joins takes part once it has seen eleven recessive bits.
async fn settled(node: &Node) {
    node.connected().await;
    tokio::time::sleep(Span::from_millis(1)).await;
}

#[tokio::test(start_paused = true)]
async fn an_event_goes_from_node_to_node() {
    let bed = Bed::start().await;
    let (sensor, display) = (bed.node(1), bed.node(2));
    let heat = sensor.announce(&HEAT).unwrap();
    let subscriber = display.subscribe(&HEAT, Policy::Latest).unwrap();
    heat.bound().await;
    settled(&display).await;
    heat.publish(-21).unwrap();
    let event = subscriber.next().await;
    assert_eq!((event.content, event.publisher), (-21, TxNode::new(1).unwrap()));
    tokio::time::sleep(Span::from_millis(10)).await;
    assert_eq!(sensor.channel_counters(HEAT.subject()).unwrap().sent, 1);
}

#[tokio::test(start_paused = true)]
async fn a_node_without_ids_gets_them_from_a_broker_on_linux() {
    let bed = Bed::start().await;
    let config = Config::new(uid(1)).tx_node(TxNode::new(1).unwrap()).broker(BrokerTables::default());
    let host = bed.start_node(config);
    let sensor = bed.start_node(Config::new(uid(0xAFFE)));
    let channel: Channel<u8> = Channel::soft(Subject::new(0x77).unwrap(), common::QUALITY);
    let publisher = sensor.announce(&channel).unwrap();
    assert_eq!(publisher.publish(0), Err(PublishError::NotBound));
    let subscriber = host.subscribe(&channel, Policy::Latest).unwrap();
    publisher.bound().await;
    assert_eq!(host.broker_role(), Some(BrokerRole::Active));
    let tables = host.broker_tables().unwrap();
    assert!(tables.nodes.contains(&(uid(0xAFFE), sensor.tx_node().unwrap())));
    assert_eq!(tables.subjects, [(channel.subject(), sensor.etag_of(channel.subject()).unwrap())]);
    publisher.publish(5).unwrap();
    assert_eq!(subscriber.next().await.content, 5);
    // A broker that is started anew from the table knows them.
    drop((publisher, subscriber, sensor, host));
    let config = Config::new(uid(1)).tx_node(TxNode::new(1).unwrap()).broker(tables.clone());
    assert_eq!(bed.start_node(config).broker_tables().unwrap().subjects, tables.subjects);
}

/// What the plan of the segment says: nothing is on it, and what it does not know is asked for.
static ASKED: AdmissionPlan = AdmissionPlan {
    unplanned: Unplanned::Ask,
    planned: &[],
    reservations: Reservations::nothing(BitRate::MAX, Duration::from_micros(160), Duration::from_micros(10)),
};

#[tokio::test(start_paused = true)]
async fn a_channel_that_is_not_planned_is_published_when_it_is_admitted() {
    let bed = Bed::start().await;
    let asking = |mut config: Config| {
        config.node.admission = Some(&ASKED);
        bed.start_node(config)
    };
    let host = Config::new(uid(1)).tx_node(TxNode::new(1).unwrap()).broker(BrokerTables::default());
    let (host, sensor) = (asking(host), asking(Config::new(uid(0xAFFE))));
    let channel = |subject, interval| -> Channel<u8> {
        let rate = EventRate::sporadic(Duration::from_micros(interval));
        Channel::soft(Subject::new(subject).unwrap(), common::QUALITY).with_rate(rate)
    };
    let publisher = sensor.announce(&channel(0x77, 5_000)).unwrap();
    assert_eq!(publisher.admitted().await, Ok(()));
    assert!(matches!(publisher.admission(), Some(AdmissionState::Admitted(_))));
    publisher.publish(5).unwrap();
    // A frame every 50 us is more than the bus has. The node of the broker asks itself.
    for node in [&sensor, &host] {
        let wild = node.announce(&channel(0x78, 50)).unwrap();
        let refusal = wild.admitted().await.unwrap_err();
        assert_eq!(refusal.reason, RefusalReason::Utilisation);
        assert_eq!(wild.publish(5), Err(PublishError::NotAdmitted));
    }
}

#[tokio::test(start_paused = true)]
async fn interest_is_told_and_ends() {
    let bed = Bed::start().await;
    let (gateway, display) = (bed.node(1), bed.node(2));
    let mut news = gateway.news();
    let subscriber = display.subscribe(&HEAT, Policy::Latest).unwrap();
    let etag = Etag::new(5000).unwrap();
    let wanted = |node: &Node| node.interested(etag, cosmic_core::protocol::Side::Subscriber);
    loop {
        if let News::Interest(event) = news.recv().await.unwrap() {
            let begun = cosmic_core::membership::InterestEvent::Begun {
                etag,
                side: cosmic_core::protocol::Side::Subscriber,
            };
            assert_eq!(event, begun);
            break;
        }
    }
    assert_eq!(wanted(&gateway), [TxNode::new(2).unwrap()]);
    drop(subscriber);
    tokio::time::sleep(Span::from_secs(1)).await;
    assert!(wanted(&gateway).is_empty(), "withdrawn");
}

#[tokio::test(start_paused = true)]
async fn publishing_hard_real_time_is_refused_with_a_reason() {
    let bed = Bed::start().await;
    let node = bed.node(1);
    let hard: Channel<u8> = Channel::hard(
        Subject::new(0x99).unwrap(),
        Etag::new(100).unwrap(),
        HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 },
    );
    let error = node.announce(&hard).err().unwrap();
    assert_eq!(error, AnnounceError::HardRealTime);
    assert!(error.to_string().contains("subscribe to it, or publish on a soft real-time channel"));
}

#[tokio::test(start_paused = true)]
async fn a_hard_event_is_received_once_though_its_frame_was_repeated() {
    let bed = Bed::start().await;
    let node =
        bed.start_node(Config::new(uid(1)).tx_node(TxNode::new(1).unwrap()).calendar(&common::CALENDAR));
    let subscriber = node.subscribe(&common::SPEED, Policy::Latest).unwrap();
    let mut raw = bed.raw().await;
    for (number, copies) in [(1_u8, 2), (2, 1), (2, 1)] {
        for _ in 0..copies {
            raw.send(common::speed_frame(number)).await;
        }
        assert_eq!(subscriber.next().await.content, u16::from(number));
        tokio::time::sleep(Span::from_millis(8)).await;
        assert!(subscriber.try_next().is_none(), "the second copy of {number}");
    }
}

#[tokio::test(start_paused = true)]
async fn while_the_link_is_down_events_expire_and_do_not_come_late() {
    let bed = Bed::start().await;
    let (sensor, display) = (bed.node(1), bed.node(2));
    let heat = sensor.announce(&HEAT).unwrap();
    let subscriber = display.subscribe(&HEAT, Policy::Latest).unwrap();
    heat.bound().await;
    bed.stop().await;
    while sensor.is_connected() || display.is_connected() {
        tokio::time::sleep(Span::from_millis(1)).await;
    }
    for number in 0..100 {
        heat.publish(number).unwrap();
        tokio::time::sleep(Span::from_millis(25)).await;
    }
    let expired = sensor.exceptions(ExceptionKind::ValidityExpired);
    assert!(expired >= 97, "{expired}");
    bed.restart().await;
    sensor.connected().await;
    settled(&display).await;
    tokio::time::sleep(Span::from_millis(100)).await;
    assert!(subscriber.try_next().is_none(), "nothing stale");
    heat.publish(4711).unwrap();
    assert_eq!(subscriber.next().await.content, 4711);
    assert!(sensor.link_counters().connections >= 2);
}

#[tokio::test(start_paused = true)]
async fn what_does_not_fit_is_refused_and_told() {
    let bed = Bed::start().await;
    let (sensor, display) = (bed.node(1), bed.node(2));
    let text = sensor.announce(&TEXT).unwrap();
    let subscriber = display.subscribe(&TEXT, Policy::Fifo(common::depth(4))).unwrap();
    text.bound().await;
    settled(&display).await;
    let refused = (0..1000).filter(|number| text.publish(*number) == Err(PublishError::QueueFull)).count();
    assert!(refused > 800, "{refused}");
    assert_eq!(sensor.exceptions(ExceptionKind::TransmitQueueFull) as usize, refused);
    tokio::time::sleep(Span::from_millis(200)).await;
    let counters = display.channel_counters(TEXT.subject()).unwrap();
    assert_eq!(counters.delivered, 4);
    assert_eq!(counters.overflowed as usize, 1000 - refused - 4, "each that was sent is counted");
    assert_eq!(display.exceptions(ExceptionKind::QueueFull), counters.overflowed);
    drop(subscriber);
}

#[tokio::test(start_paused = true)]
async fn an_event_with_a_deadline_of_its_own() {
    let bed = Bed::start().await;
    let node = bed.node(1);
    let heat = node.announce(&HEAT).unwrap();
    heat.bound().await;
    let past = node.now().saturating_sub(Duration::from_millis(1));
    assert_eq!(heat.publish_event(&Event::new(1).deadline(past)), Err(PublishError::Deadline));
    let soon = node.now() + Duration::from_millis(3);
    heat.publish_event(&Event::new(1).deadline(soon).expires_at(soon)).unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_segment_that_is_served_already_is_not_served_twice() {
    let bed = Bed::start().await;
    let error = common::serve_at(bed.path()).await;
    assert!(error.contains("another server answers there"), "{error}");
    let file = bed.path().with_extension("txt");
    std::fs::write(&file, "precious").unwrap();
    assert!(common::serve_at(&file).await.contains("no socket"));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "precious");
}

#[tokio::test(start_paused = true)]
async fn garbage_ends_a_connection_and_nothing_else() {
    let bed = Bed::start().await;
    let node = bed.node(1);
    let heat = node.announce(&HEAT).unwrap();
    heat.bound().await;
    let mut raw = bed.raw().await;
    raw.send_bytes(&[0xFF; 4096]).await;
    raw.closed().await;
    let display = bed.node(2);
    let subscriber = display.subscribe(&HEAT, Policy::Latest).unwrap();
    settled(&display).await;
    heat.publish(3).unwrap();
    assert_eq!(subscriber.next().await.content, 3);
}
