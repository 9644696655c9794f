//! What a participant on IP can do to a segment that follows no rules: not much.

use std::time::Duration as Span;

use crate::bed::{HEAT, HEAT_TABLE, Segment, Setup, Stranger, count, fifo, frames, port, settled, until};
use cosmic_core::Subject;
use cosmic_core::can::{Etag, Priority};
use cosmic_gateway::Gateway;
use cosmic_gateway::clock::Reading;
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_gateway::encoding::Envelope;
use cosmic_linux::Subscriber;

const ETAG: Etag = Etag::new(5000).unwrap();

struct Bed {
    bus: Segment,
    gateway: Gateway,
    stranger: Stranger,
    subscriber: Subscriber<i16>,
    next: std::cell::Cell<u64>,
}

impl Bed {
    async fn start(more: &str) -> Self {
        Self::with(more, HEAT_TABLE).await
    }

    async fn with(more: &str, channels: &str) -> Self {
        let bus = Segment::start().await;
        let listen = port();
        let more = format!("etags = {{ heat = 5000, gateways = 5001 }}\n{more}");
        let connect = &[];
        let setup =
            Setup { segment: "plant", bus: &bus, tx_node: 100, listen, connect, more: &more, channels };
        let gateway = setup.start().await;
        let stranger = Stranger::start(listen, "stranger").await;
        let subscriber = bus.node(1).subscribe(&HEAT.with_etag(ETAG), fifo(200)).unwrap();
        settled(&[(&gateway, "plant")]).await;
        until("the clock is known", || gateway.others() == (1, 1)).await;
        let bed = Self { bus, gateway, stranger, subscriber, next: 0.into() };
        // Until the gateway has subscribed on IP, events go nowhere.
        let begun = tokio::time::Instant::now();
        while bed.subscriber.try_next().is_none() {
            assert!(begun.elapsed() < crate::bed::PATIENCE);
            bed.put(bed.envelope(&[0, 0])).await;
            tokio::time::sleep(Span::from_millis(50)).await;
        }
        tokio::time::sleep(Span::from_millis(200)).await;
        while bed.subscriber.try_next().is_some() {}
        bed
    }

    fn envelope(&self, content: &[u8]) -> Envelope {
        self.next.set(self.next.get() + 1);
        self.stranger.envelope(self.next.get(), content)
    }

    async fn put(&self, envelope: Envelope) {
        self.stranger.put(HEAT.subject(), &envelope).await;
    }

    fn of_ip(&self, outcome: Outcome) -> u64 {
        self.gateway.unassigned().get(outcome)
    }

    fn of_segment(&self, outcome: Outcome) -> u64 {
        count(&self.gateway, "plant", Direction::In, outcome)
    }

    async fn next(&self) -> i16 {
        tokio::time::timeout(crate::bed::PATIENCE, self.subscriber.next()).await.unwrap().content
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_kind_of_nonsense_is_counted_and_nothing_of_it_reaches_the_bus() {
    let bed = Bed::start("").await;
    let tap = bed.bus.tap().await;
    // Twice the same, then one that left a gap of three.
    let one = bed.envelope(&[0, 1]);
    bed.put(one.clone()).await;
    bed.put(one).await;
    assert_eq!(bed.next().await, 1);
    until("the duplicate is counted", || bed.of_ip(Outcome::Duplicate) == 1).await;
    let missing = bed.of_ip(Outcome::Missing);
    bed.next.set(bed.next.get() + 3);
    bed.put(bed.envelope(&[0, 2])).await;
    assert_eq!(bed.next().await, 2);
    assert_eq!(bed.of_ip(Outcome::Missing), missing + 3);
    // Late, but of use still: it goes on.
    let late = Reading(Reading::now().0 - 600_000_000);
    bed.put(Envelope { sent_at: late, ..bed.envelope(&[0, 5]) }).await;
    assert_eq!(bed.next().await, 5);
    assert_eq!(bed.of_segment(Outcome::ForwardedLate), 1);
    // Stamps that cannot be, or are past.
    bed.put(Envelope { sent_at: Reading(Reading::now().0 + 10_000_000_000), ..bed.envelope(&[0, 3]) }).await;
    until("the future is counted", || bed.of_ip(Outcome::FromTheFuture) == 1).await;
    bed.put(Envelope { sent_at: Reading(Reading::now().0 - 1_100_000_000), ..bed.envelope(&[0, 3]) }).await;
    until("the past is counted", || bed.of_ip(Outcome::Expired) == 1).await;
    // An event that claims to keep for ever keeps as long as the channel says.
    let old = Reading(Reading::now().0 - 1_100_000_000);
    bed.put(Envelope { sent_at: old, to_deadline: None, to_expiry: None, ..bed.envelope(&[0, 3]) }).await;
    until("it has expired too", || bed.of_ip(Outcome::Expired) == 2).await;
    // Bytes.
    let key = bed.stranger.keys.event(HEAT.subject(), &bed.stranger.segment);
    for bytes in [vec![], vec![0xFF; 4096], vec![1; 47]] {
        bed.stranger.put_bytes(&key, bytes).await;
    }
    until("malformed bytes are counted", || bed.of_ip(Outcome::Malformed) == 3).await;
    bed.put(bed.envelope(&[0; 9])).await;
    until("what is too long is counted", || bed.of_segment(Outcome::TooLong) == 1).await;
    // It claims to be the segment itself.
    let key = bed.stranger.keys.event(HEAT.subject(), &crate::bed::name("plant"));
    bed.stranger.put_bytes(&key, bed.envelope(&[0, 3]).encode()).await;
    until("it is counted", || bed.of_ip(Outcome::ComeBack) == 1).await;
    // Subjects that nobody has let in: those of the middleware, and any other.
    let forbidden = [Subject::RESERVED, cosmic_gateway::config::GATEWAYS, Subject::new(0x1234).unwrap()];
    for subject in forbidden {
        bed.stranger.put(subject, &bed.envelope(&[0, 3])).await;
    }
    bed.put(bed.envelope(&[0, 4])).await;
    assert_eq!(bed.next().await, 4);
    tokio::time::sleep(Span::from_millis(100)).await;
    let frames: Vec<_> = frames(&tap)
        .iter()
        .filter(|frame| frame.id.etag() != Etag::new(5001).unwrap())
        .map(|frame| (frame.id.etag(), frame.payload.as_slice().to_vec()))
        .collect();
    assert_eq!(frames, [1, 2, 5, 4].map(|last| (ETAG, vec![0, last])));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_babbling_participant_exceeds_neither_the_rate_nor_the_ceiling() {
    // The channel may have 1000 events a second; a hundredth of the bus are 80 of its frames of two bytes.
    let bed = Bed::start("ceiling = 1").await;
    let tap = bed.bus.tap().await;
    let told = || {
        let all = Outcome::ALL.iter();
        all.map(|outcome| bed.of_segment(*outcome) + bed.of_ip(*outcome)).sum::<u64>()
    };
    let (told_before, sent_before) = (told(), bed.next.get());
    let begun = tokio::time::Instant::now();
    while begun.elapsed() < Span::from_millis(1500) {
        for _ in 0..50 {
            bed.put(bed.envelope(&[0, 9])).await;
        }
        tokio::time::sleep(Span::from_millis(1)).await;
    }
    let elapsed = begun.elapsed();
    until("all are accounted for", || told() - told_before >= bed.next.get() - sent_before).await;
    let heard = crate::bed::with_etag(&frames(&tap), ETAG);
    let per_second = heard.len() as f64 / elapsed.as_secs_f64();
    // 100 bits: a hundredth of the bus is 100 a second, and 20 ms of it at once.
    assert!((10.0..=120.0).contains(&per_second), "{per_second}");
    assert!(bed.of_segment(Outcome::CeilingExceeded) > 1000);
    assert!(heard.iter().all(|frame| frame.id.priority() > Priority::HARD), "nothing is hard real-time");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_the_rate_refuses_takes_nothing_of_the_ceiling() {
    // Hundreds of events would be more than a hundredth of the bus; one of them may come in.
    let table = HEAT_TABLE.replace("\"1 ms\"", "\"600 s\"").replace("burst = 20", "burst = 2");
    let bed = Bed::with("ceiling = 1", &table).await;
    for _ in 0..500 {
        bed.put(bed.envelope(&[0, 9])).await;
    }
    until("all are refused", || bed.of_segment(Outcome::RateExceeded) >= 499).await;
    assert_eq!(bed.of_segment(Outcome::CeilingExceeded), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_rate_of_a_channel_holds_for_all_publishers_together() {
    let bed = Bed::start("ceiling = 100").await;
    let before = bed.of_segment(Outcome::Forwarded);
    let begun = tokio::time::Instant::now();
    while begun.elapsed() < Span::from_millis(500) {
        for _ in 0..20 {
            bed.put(bed.envelope(&[0, 9])).await;
        }
        tokio::time::sleep(Span::from_millis(1)).await;
    }
    tokio::time::sleep(Span::from_millis(100)).await;
    let passed = bed.of_segment(Outcome::Forwarded) - before;
    let most = 20 + (begun.elapsed().as_millis() as u64 * 4097).div_ceil(4096) + 1;
    assert!(passed <= most, "{passed} of {most}");
    assert!(bed.of_segment(Outcome::RateExceeded) > 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn content_of_another_layout_is_refused() {
    let bed = Bed::start("").await;
    let other = cosmic_core::event_layer::layout_of(&["u16"]);
    bed.put(Envelope { layout: other, ..bed.envelope(&[0, 1]) }).await;
    until("it is counted", || bed.of_segment(Outcome::LayoutMismatch) == 1).await;
    let same = cosmic_core::event_layer::layout_of(&["i16"]);
    bed.put(Envelope { layout: same, ..bed.envelope(&[0, 2]) }).await;
    assert_eq!(bed.next().await, 2);
}
