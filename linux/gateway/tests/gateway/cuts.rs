//! Ways that are slow, stall and break: nothing stale reaches the far bus.

use std::time::Duration as Span;

use crate::bed::{Pair, count, name, until, with_etag};
use cosmic_core::Subject;
use cosmic_core::can::{Etag, Frame};
use cosmic_core::event_layer::{Channel, Policy, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_linux::{Publisher, Subscriber, Tap};
use cosmic_wan::State;
use tokio::time::Instant;

const ETAG: Etag = Etag::new(5000).unwrap();
const VALIDITY: Span = Span::from_millis(200);
const COMMAND: Channel<u32> = Channel::soft(
    Subject::new(0xC05A_0000_0000_0002).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(100), validity: Duration::from_millis(200) },
)
.with_etag(ETAG);
const TABLE: &str = r#"
[[channel]]
name = "command"
subject = "0xC05A000000000002"
class = "soft"
deadline = "100 ms"
validity = "200 ms"
interval = "1 ms"
burst = 200
longest-wait = "5 ms"
"#;

/// Commands from west to east.
struct Bed {
    pair: Pair,
    publisher: Publisher<u32>,
    _subscriber: Subscriber<u32>,
    tap: Tap,
    /// When each command was published.
    published: Vec<Instant>,
    heard: Vec<Frame>,
}

impl Bed {
    async fn start() -> Self {
        let more = "ceiling = 100\netags = { command = 5000, gateways = 5001 }";
        let pair = Pair::start(TABLE, [more, more]).await;
        let publisher = pair.west.node(1).announce(&COMMAND).unwrap();
        let subscriber = pair.east.node(1).subscribe(&COMMAND, Policy::Latest).unwrap();
        publisher.bound().await;
        let tap = pair.east.tap().await;
        let mut bed =
            Self { pair, publisher, _subscriber: subscriber, tap, published: Vec::new(), heard: Vec::new() };
        bed.until_it_crosses().await;
        bed
    }

    fn publish(&mut self) {
        let number = u32::try_from(self.published.len()).unwrap();
        self.published.push(Instant::now());
        self.publisher.publish(number).unwrap();
    }

    async fn publish_for(&mut self, span: Span) {
        let begun = Instant::now();
        while begun.elapsed() < span {
            self.publish();
            tokio::time::sleep(Span::from_millis(10)).await;
        }
    }

    /// The numbers that are on the far bus by now.
    fn heard(&mut self) -> Vec<u32> {
        self.heard.extend(with_etag(&crate::bed::frames(&self.tap), ETAG));
        let number = |frame: &Frame| u32::from_be_bytes(frame.payload.as_slice().try_into().unwrap());
        self.heard.iter().map(number).collect()
    }

    async fn until_it_crosses(&mut self) {
        let (begun, before) = (Instant::now(), self.heard().len());
        while self.heard().len() == before {
            assert!(begun.elapsed() < crate::bed::PATIENCE, "nothing crosses");
            self.publish();
            tokio::time::sleep(Span::from_millis(20)).await;
        }
    }

    /// The way is in a state for so long, while commands are published all the time. Of those that were stale when it
    /// healed none reaches the far bus; fresh ones do again.
    async fn interrupt(&mut self, state: State, span: Span) {
        self.publish_for(Span::from_millis(100)).await;
        self.pair.way.set(state);
        tokio::time::sleep(Span::from_millis(20)).await;
        let first = self.published.len();
        self.publish_for(span).await;
        let healed = Instant::now();
        self.pair.way.set(State::Open);
        self.until_it_crosses().await;
        self.publish_for(Span::from_millis(300)).await;
        tokio::time::sleep(Span::from_millis(300)).await;
        let heard = self.heard();
        let stale = |number: &&u32| {
            let number = usize::try_from(**number).unwrap();
            number >= first && self.published[number] + VALIDITY < healed
        };
        let stale: Vec<_> = heard.iter().filter(stale).collect();
        assert!(stale.is_empty(), "stale commands on the far bus: {stale:?}");
        let mut once = heard.clone();
        once.sort_unstable();
        once.dedup();
        assert_eq!(once.len(), heard.len(), "nothing comes twice");
        // Before the first one the way was not open yet.
        let lost = self.published.len() - heard[0] as usize - heard.len();
        let told = self.told();
        let metrics = [&self.pair.of_west, &self.pair.of_east].map(|gateway| gateway.metrics());
        assert!(told >= lost as u64, "{lost} lost, {told} told: {}", metrics.concat());
    }

    /// What did not cross, as far as the gateways have told.
    fn told(&self) -> u64 {
        let west = count(&self.pair.of_west, "west", Direction::Out, Outcome::Unwanted);
        let lost = [
            Outcome::Missing,
            Outcome::Expired,
            Outcome::AgeUnknown,
            Outcome::Unwanted,
            Outcome::RateExceeded,
        ];
        west + self.of_west_standing_by()
            + self.expired_in_east()
            + lost.map(|outcome| self.of_east(outcome)).iter().sum::<u64>()
    }

    /// And what had to wait for the bus for too long.
    fn expired_in_east(&self) -> u64 {
        let node = self.pair.of_east.node(&name("east")).unwrap();
        node.channel_counters(COMMAND.subject()).unwrap().discarded.into()
    }

    /// On a machine that is busy a gateway may have stood still for a moment.
    fn of_west_standing_by(&self) -> u64 {
        count(&self.pair.of_west, "west", Direction::Out, Outcome::StandingBy)
            + self.of_east(Outcome::StandingBy)
    }

    fn of_east(&self, outcome: Outcome) -> u64 {
        self.pair.of_east.unassigned().get(outcome)
            + count(&self.pair.of_east, "east", Direction::In, outcome)
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_stalled_way_kept_is_discarded_when_it_comes() {
    let mut bed = Bed::start().await;
    // Shorter than zenoh needs to give the connection up: so all of it arrives, late.
    bed.interrupt(State::Stalled, Span::from_millis(1000)).await;
    let told = bed.of_east(Outcome::Expired) + bed.of_east(Outcome::Missing);
    assert!(told > 20, "{told} of what was kept are accounted for");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_way_that_is_cut_for_half_a_minute_brings_nothing_stale() {
    let mut bed = Bed::start().await;
    bed.interrupt(State::Cut, Span::from_secs(30)).await;
    assert_eq!(count(&bed.pair.of_west, "west", Direction::Out, Outcome::NotSent), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cuts_and_stalls_in_turn() {
    let mut bed = Bed::start().await;
    for round in 0..4_u32 {
        let state = if round % 2 == 0 { State::Stalled } else { State::Cut };
        bed.interrupt(state, Span::from_millis(u64::from(300 + 700 * round))).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_slow_way_is_charged_whichever_direction_is_slow() {
    let mut bed = Bed::start().await;
    // East asks, west answers: events come by the way back. It takes longer than a command is of use.
    bed.pair.way.delay(cosmic_wan::Direction::Back, Span::from_millis(250));
    // What was under way before still crosses.
    tokio::time::sleep(Span::from_millis(300)).await;
    let before = (bed.heard().len(), bed.of_east(Outcome::Expired));
    bed.publish_for(Span::from_millis(500)).await;
    until("they are discarded", || bed.of_east(Outcome::Expired) > before.1 + 5).await;
    assert_eq!(bed.heard().len(), before.0, "every one was too old");
    // A slow way there makes nothing older, and clocks that were asked before it was slow stay known.
    bed.pair.way.delay(cosmic_wan::Direction::Back, Span::ZERO);
    bed.pair.way.delay(cosmic_wan::Direction::There, Span::from_millis(250));
    bed.until_it_crosses().await;
}
