//! Messages of several frames: they cross whole, or not at all.

use std::time::Duration as Span;

use crate::bed::{PATIENCE, Pair, count, fifo, frames, until, with_etag};
use cosmic_core::Subject;
use cosmic_core::can::{Etag, Frame, Payload};
use cosmic_core::event_layer::{Channel, Importance, NonRealTimeAttributes};
use cosmic_core::network::fragments::{Fragmenter, Reassembler};
use cosmic_core::time::{Duration, Instant};
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_linux::{Publisher, Subscriber, Tap};

const ETAG_EAST: Etag = Etag::new(7000).unwrap();
pub(crate) const TABLE: &str = r#"
[[channel]]
name = "log"
subject = "0xC05A000000000003"
class = "non-real-time"
importance = 2
validity = "400 ms"
interval = "1 ms"
burst = 20
longest-message = 200
"#;

fn channel(etag: Etag) -> Channel<Payload> {
    let subject = Subject::new(0xC05A_0000_0000_0003).unwrap();
    let quality = NonRealTimeAttributes { importance: Importance::LEAST, validity: None };
    Channel::non_real_time(subject, quality).with_etag(etag)
}

/// Two publishers in the west, and what comes to the east.
struct Bed {
    pair: Pair,
    publishers: [Publisher<Payload>; 2],
    fragmenters: [Fragmenter<1024>; 2],
    _subscriber: Subscriber<Payload>,
    tap: Tap,
}

impl Bed {
    /// `validity`: of a message, from when it leaves the west.
    async fn start(validity: &str) -> Self {
        let pair = Pair::start(
            &TABLE.replace("400 ms", validity),
            ["etags = { log = 5000, gateways = 5001 }", "etags = { log = 7000, gateways = 7001 }"],
        )
        .await;
        let in_west = channel(Etag::new(5000).unwrap());
        let publishers = [1, 2].map(|node| pair.west.node(node).announce(&in_west).unwrap());
        let _subscriber = pair.east.node(1).subscribe(&channel(ETAG_EAST), fifo(1)).unwrap();
        for publisher in &publishers {
            publisher.bound().await;
        }
        let tap = pair.east.tap().await;
        let mut bed =
            Self { pair, publishers, fragmenters: [Fragmenter::new(), Fragmenter::new()], _subscriber, tap };
        let begun = tokio::time::Instant::now();
        while with_etag(&frames(&bed.tap), ETAG_EAST).is_empty() {
            assert!(begun.elapsed() < PATIENCE, "nothing crosses");
            bed.send([Some(b"open"), None]).await;
            tokio::time::sleep(Span::from_millis(50)).await;
        }
        tokio::time::sleep(Span::from_millis(300)).await;
        frames(&bed.tap);
        bed
    }

    /// Messages of both publishers at a time, frame by frame in turn.
    async fn send(&mut self, messages: [Option<&[u8]>; 2]) {
        for (fragmenter, message) in self.fragmenters.iter_mut().zip(messages) {
            message.into_iter().for_each(|message| fragmenter.start(message).unwrap());
        }
        while self.fragmenters.iter().any(|fragmenter| !fragmenter.is_idle()) {
            for (fragmenter, publisher) in self.fragmenters.iter_mut().zip(&self.publishers) {
                let Some(fragment) = fragmenter.poll() else { continue };
                publisher.publish(fragment).unwrap();
                fragmenter.on_sent();
                tokio::time::sleep(Span::from_millis(1)).await;
            }
        }
    }

    fn out_of_west(&self, outcome: Outcome) -> u64 {
        count(&self.pair.of_west, "west", Direction::Out, outcome)
    }

    fn of_east(&self, outcome: Outcome) -> u64 {
        count(&self.pair.of_east, "east", Direction::In, outcome)
    }

    /// The frames on the far bus, and the messages that they are.
    async fn heard(&self, messages: usize) -> (Vec<Frame>, Vec<Vec<u8>>) {
        let (mut reassembler, mut all, mut whole) =
            (Reassembler::<4, 1024>::new(Duration::from_secs(10)), Vec::new(), Vec::new());
        let begun = tokio::time::Instant::now();
        while whole.len() < messages {
            assert!(begun.elapsed() < PATIENCE, "{whole:?}");
            for frame in with_etag(&frames(&self.tap), ETAG_EAST) {
                let message = reassembler.on_frame(&frame, Instant::EPOCH);
                whole.extend(message.map(|message| message.content.to_vec()));
                all.push(frame);
            }
            tokio::time::sleep(Span::from_millis(5)).await;
        }
        (all, whole)
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_of_two_publishers_at_a_time_cross_whole() {
    // However busy the machine is.
    let mut bed = Bed::start("60 s").await;
    let [long, longer] = [b"123456789".as_slice(), &[0xA5; 200]];
    bed.send([Some(long), Some(longer)]).await;
    let (frames, mut messages) = bed.heard(2).await;
    messages.sort_by_key(Vec::len);
    assert_eq!(messages, [long.to_vec(), longer.to_vec()]);
    assert!(frames.iter().all(|frame| frame.id.tx_node().get() == 100), "the gateway has cut them anew");
    // The shorter one was whole first. But for the number of the message, its frames are these:
    let of_first: Vec<Vec<u8>> = frames[..2].iter().map(|frame| frame.payload.as_slice().to_vec()).collect();
    assert_eq!([of_first[0][0] & 0xCF, of_first[1][0] & 0xCF], [0x80, 0x41]);
    assert_eq!([&of_first[0][1..], &of_first[1][1..]], [b"1234567".as_slice(), b"89\x29\xB1"]);
    // As many frames as those of 200 bytes and their CRC.
    assert_eq!(frames.len(), 2 + 29);
    assert_eq!(bed.out_of_west(Outcome::Incomplete) + bed.out_of_west(Outcome::StrayFrame), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_not_whole_too_long_or_too_old_does_not_cross_and_is_counted() {
    let mut bed = Bed::start("400 ms").await;
    // Its first frame only; the next message tells that the rest will not come.
    bed.fragmenters[0].start(b"123456789").unwrap();
    bed.publishers[0].publish(bed.fragmenters[0].poll().unwrap()).unwrap();
    bed.fragmenters[0].on_discarded();
    bed.send([Some(&[1; 201]), None]).await;
    until("both are counted", || {
        (bed.out_of_west(Outcome::Incomplete), bed.of_east(Outcome::TooLong)) == (1, 1)
    })
    .await;
    // The rest of a message of which the begin is not there.
    bed.fragmenters[0].start(&[3; 30]).unwrap();
    let _ = bed.fragmenters[0].poll();
    bed.fragmenters[0].on_sent();
    bed.send([None, None]).await;
    until("its frames are counted", || bed.out_of_west(Outcome::StrayFrame) == 4).await;
    // A way that takes longer than a message is of use.
    bed.pair.way.delay(cosmic_wan::Direction::Back, Span::from_millis(600));
    bed.send([Some(&[2; 100]), None]).await;
    until("it has expired", || bed.pair.of_east.unassigned().get(Outcome::Expired) == 1).await;
    bed.pair.way.delay(cosmic_wan::Direction::Back, Span::ZERO);
    // What is on it already keeps back what comes behind.
    tokio::time::sleep(Span::from_millis(700)).await;
    bed.send([Some(b"the end"), None]).await;
    assert_eq!(bed.heard(1).await.1, [b"the end"]);
}
