//! What was promised, and what came.

use std::collections::HashSet;
use std::sync::{Arc, Mutex};
use std::time::Duration as Span;

use cosmic_gateway::counters::{Counters, Outcome};
use tokio::time::Instant;

use super::STEPS;
use super::world::{Counted, RATES, TAGS, VALIDITY, content};

/// A frame that a gateway has published.
#[derive(Clone, Copy, Debug)]
pub(super) struct Far {
    pub(super) content: u32,
    pub(super) at: Instant,
}

pub(super) type Heard = Arc<Mutex<Vec<Far>>>;

/// What the gateways have told of what did not come.
pub(super) struct Account {
    pub(super) counted: Vec<Counted>,
    /// What nodes have told, by the side to which it did not come.
    pub(super) of_nodes: [u64; 2],
    /// What the stranger has sent.
    pub(super) sent: u64,
    pub(super) kills: Vec<Kill>,
}

/// Nobody tells of what was on its way through a gateway that died, nor of what is published while a segment has none.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kill {
    pub(super) at: Instant,
    /// The same, but for the only gateway of its segment: then its successor reads.
    pub(super) until: Instant,
}

pub(super) struct Verdict {
    pub(super) account: Account,
    /// Commands, reports, noise.
    pub(super) published: [Vec<Instant>; 3],
    /// In the west, in the east.
    pub(super) heard: [Vec<Far>; 2],
    /// Noise that was old when it was sent.
    pub(super) stale: Vec<u32>,
}

impl Verdict {
    pub(super) fn judge(&self, seed: u64) {
        for (side, heard) in self.heard.iter().enumerate() {
            self.judge_frames(seed, side, heard);
            self.judge_account(seed, side, heard);
        }
    }

    fn judge_frames(&self, seed: u64, side: usize, heard: &[Far]) {
        let mut once = HashSet::new();
        for far in heard {
            let Far { content, at } = *far;
            assert!(once.insert(content), "seed {seed}: {content:08X} came twice to side {side}");
            assert!(!self.stale.contains(&content), "seed {seed}: {content:08X} was old when it was sent");
            let tag = TAGS.iter().position(|tag| u32::from(*tag) == content >> 24).unwrap();
            let published = self.published[tag][(content & 0xFF_FFFF) as usize];
            let age = at.saturating_duration_since(published);
            assert!(age < VALIDITY + SLACK, "seed {seed}: {content:08X} came after {age:?} to side {side}");
        }
        let is_of_side = |counted: &&Counted| counted.station.side() == side;
        let lives = self.account.counted.iter().filter(is_of_side).count() as u64;
        for (tag, (interval, burst)) in TAGS.iter().zip(RATES) {
            let of_tag: Vec<_> =
                heard.iter().filter(|it| it.content >> 24 == u32::from(*tag)).map(|it| it.at).collect();
            // What has passed the bucket may wait in the node's queue for as long as it is valid.
            let at_once = burst * lives + VALIDITY.as_millis() as u64 / interval + 1;
            assert_rate(&of_tag, Span::from_millis(interval), at_once, seed);
        }
    }

    /// What was published for a side and did not come there is told, by whoever might have carried it.
    fn judge_account(&self, seed: u64, side: usize, heard: &[Far]) {
        let came: HashSet<u32> = heard.iter().map(|far| far.content).collect();
        let own = 1 - side;
        let lost = |number: &usize| !came.contains(&content(TAGS[own], *number));
        let published = &self.published[own];
        // Before the first one the way was not open yet.
        let first = (0..published.len()).find(|number| !lost(number)).unwrap_or(0);
        let lost = (first..published.len()).filter(lost).filter(|at| !self.excused(published[*at]));
        let lost = lost.count() as u64;
        let noise = came.iter().filter(|content| *content >> 24 == u32::from(TAGS[2])).count() as u64;
        let unheard = self.account.sent - noise;
        let told = self.account.told(side);
        let crossed = came.len() as u64 - noise;
        assert!(
            lost + unheard <= told,
            "seed {seed}, side {side}: {crossed} of {} crossed, {lost} lost, {unheard} of {} of the stranger unheard, \
             {told} told:{}",
            published.len(),
            self.account.sent,
            self.account.text(),
        );
        // How many of all cross depends on the machine; that some did, after each step, the world has waited for.
        assert!(crossed > STEPS as u64, "seed {seed}: {crossed} of {}", published.len());
    }

    /// What was on its way through a gateway when that died: it is known on its bus, or by its session, but not any more
    /// by itself. So with what nobody read.
    fn excused(&self, published: Instant) -> bool {
        let around = |kill: &Kill| kill.at < published + SLACK && published < kill.until + SLACK;
        self.account.kills.iter().any(around)
    }
}

impl Account {
    fn told(&self, side: usize) -> u64 {
        let into = self.counted.iter().filter(|it| it.station.side() == side);
        let from = self.counted.iter().filter(|it| it.station.side() != side);
        let all = |counters: &Counters, but: &[Outcome]| -> u64 {
            Outcome::ALL.iter().filter(|it| !but.contains(it)).map(|it| counters.get(*it)).sum()
        };
        // Who stands by says at a take-over what of that is lost.
        let out = [Outcome::Forwarded, Outcome::OfGateway, Outcome::StandingBy];
        let of_origin: u64 = from.map(|it| all(&it.outgoing, &out)).sum();
        let passed = [Outcome::Forwarded, Outcome::ForwardedLate];
        self.of_nodes[side]
            + of_origin
            + into.map(|it| all(&it.incoming, &passed) + all(&it.of_ip, &[])).sum::<u64>()
    }

    fn text(&self) -> String {
        let mut text = format!("\nnodes: {:?}", self.of_nodes);
        for counted in &self.counted {
            for (what, counters) in
                [("out", &counted.outgoing), ("in", &counted.incoming), ("of IP", &counted.of_ip)]
            {
                let some = Outcome::ALL.iter().filter(|it| counters.get(**it) > 0);
                let some: Vec<_> = some.map(|it| format!("{it:?} {}", counters.get(*it))).collect();
                text += &format!("\n{:?} {what}: {}", counted.station, some.join(", "));
            }
        }
        text
    }
}

/// A bucket that holds so many tokens, and gets one each interval.
fn assert_rate(at: &[Instant], interval: Span, at_once: u64, seed: u64) {
    let (mut level, mut before) = (at_once as f64, None);
    for at in at {
        let since = before.map_or(Span::ZERO, |before| at.saturating_duration_since(before));
        level = (level + since.as_secs_f64() / interval.as_secs_f64()).min(at_once as f64) - 1.0;
        assert!(level >= 0.0, "seed {seed}: more than one in {interval:?}, and {at_once} at once");
        before = Some(*at);
    }
}

/// Under load threads wait for the processor. What was kept back in a cut or a stall is older by far.
const SLACK: Span = Span::from_millis(500);
