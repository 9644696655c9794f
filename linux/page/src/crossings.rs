//! What crosses between segments: each way of a channel with its counts, and the last events.
//!
//! A gateway tells of each event that comes to it, out of a segment or into one, and what became of it.

use std::collections::{BTreeMap, VecDeque};
use std::time::Instant;

use serde::{Deserialize, Serialize};

/// An event that came to a gateway.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize, Debug)]
pub struct Crossing {
    /// When it came there, in milliseconds since 1970.
    pub at_ms: u64,
    /// Its channel, and what became of it.
    #[serde(flatten)]
    pub way: Way,
    /// The node that published it, by its TxNode in the segment that it comes from; `None`: it is no node of a segment, or
    /// nobody knows.
    pub node: Option<u8>,
    /// What was left to its deadline, in nanoseconds; `None`: it has none, or nobody knows.
    pub left_ns: Option<u64>,
}

/// What events have in common that are counted together.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Debug)]
pub struct Way {
    /// The name of the channel.
    pub channel: String,
    /// Its subject, 16 hexadecimal digits.
    pub subject: String,
    /// Its class: `HRT`, `SRT`, `NRT`.
    pub class: String,
    /// The segment that it comes from; empty if nobody knows.
    pub from: String,
    /// The segment that it goes to, or `IP`.
    pub to: String,
    /// What became of it, in a word.
    pub outcome: String,
    /// It went on.
    pub went: bool,
}

/// All ways, and the last events.
#[derive(Default)]
pub(crate) struct Crossings {
    ways: BTreeMap<Way, Counted>,
    /// The newest first.
    last: VecDeque<Crossing>,
    overlooked: u64,
    told_at: Option<Instant>,
}

#[derive(Clone, Copy, Serialize, Default)]
struct Counted {
    count: u64,
    rate: f64,
    left_ns: Option<u64>,
    least_left_ns: Option<u64>,
    #[serde(skip)]
    told: u64,
}

/// As it is told to browsers.
#[derive(Serialize)]
pub(crate) struct Told<'a> {
    ways: Vec<Line<'a>>,
    last: &'a VecDeque<Crossing>,
    /// Events whose way found no place.
    overlooked: u64,
}

#[derive(Serialize)]
struct Line<'a> {
    #[serde(flatten)]
    way: &'a Way,
    #[serde(flatten)]
    counted: &'a Counted,
}

impl Crossings {
    /// Another event. Logarithmic in the ways, of which [`MOST_WAYS`] are kept, and linear in the last events.
    pub(crate) fn add(&mut self, crossing: Crossing) {
        if !self.ways.contains_key(&crossing.way) {
            if self.ways.len() >= MOST_WAYS {
                self.overlooked += 1;
                return;
            }
            self.ways.insert(crossing.way.clone(), Counted::default());
        }
        let Some(counted) = self.ways.get_mut(&crossing.way) else { return };
        counted.count += 1;
        counted.left_ns = crossing.left_ns;
        let least = [counted.least_left_ns, crossing.left_ns];
        counted.least_left_ns = least.into_iter().flatten().min();
        // Gateways in other processes may tell later of what came earlier.
        let newer = self.last.partition_point(|kept| kept.at_ms > crossing.at_ms);
        self.last.insert(newer, crossing);
        self.last.truncate(MOST_LAST);
    }

    /// Reckons the rates of the ways, of the time since the last call.
    pub(crate) fn reckon(&mut self, now: Instant) {
        let since = self.told_at.replace(now).map(|before| now.duration_since(before).as_secs_f64());
        let Some(seconds) = since.filter(|seconds| *seconds > 0.0) else { return };
        for counted in self.ways.values_mut() {
            counted.rate = (counted.count - counted.told) as f64 / seconds;
            counted.told = counted.count;
        }
    }

    /// What there is to tell; nothing where no gateway tells anything.
    pub(crate) fn told(&self) -> Option<Told<'_>> {
        let ways = self.ways.iter().map(|(way, counted)| Line { way, counted });
        let told = Told { ways: ways.collect(), last: &self.last, overlooked: self.overlooked };
        (!self.ways.is_empty()).then_some(told)
    }
}

/// So many ways are kept.
pub const MOST_WAYS: usize = 512;
/// Events that are kept.
const MOST_LAST: usize = 40;

#[cfg(test)]
mod tests {
    use super::*;

    fn crossing(channel: &str, left_ns: u64) -> Crossing {
        let [from, to, outcome] = ["west", "IP", "Forwarded"].map(str::to_owned);
        let (channel, subject, class) = (channel.to_owned(), "0".repeat(16), "SRT".to_owned());
        let way = Way { channel, subject, class, from, to, outcome, went: true };
        Crossing { at_ms: 0, way, node: Some(1), left_ns: Some(left_ns) }
    }

    #[test]
    fn events_of_a_way_are_counted_together() {
        let mut crossings = Crossings::default();
        assert!(crossings.told().is_none());
        let begun = Instant::now();
        crossings.reckon(begun);
        for left in [30, 10, 20] {
            crossings.add(crossing("heat", left));
        }
        crossings.reckon(begun + std::time::Duration::from_millis(1_500));
        let told = serde_json::to_value(crossings.told()).unwrap();
        let way = &told["ways"][0];
        assert_eq!((&way["count"], &way["rate"], &way["from"]), (&3.into(), &2.0.into(), &"west".into()));
        assert_eq!((&way["left_ns"], &way["least_left_ns"]), (&20.into(), &10.into()));
        assert_eq!(told["last"][0]["left_ns"], 20, "the newest is the first");
    }

    #[test]
    fn the_last_events_stand_in_the_order_of_their_times_whoever_tells_first() {
        let mut crossings = Crossings::default();
        for at_ms in [5, 9, 7, 9] {
            crossings.add(Crossing { at_ms, ..crossing("heat", at_ms) });
        }
        let times: Vec<_> = crossings.last.iter().map(|kept| kept.at_ms).collect();
        assert_eq!(times, [9, 9, 7, 5]);
    }

    #[test]
    fn a_flood_of_ways_stays_within_its_bounds() {
        let mut crossings = Crossings::default();
        (0..2 * MOST_WAYS).for_each(|number| crossings.add(crossing(&number.to_string(), 1)));
        let told = serde_json::to_value(crossings.told()).unwrap();
        assert_eq!(told["ways"].as_array().unwrap().len(), MOST_WAYS);
        assert_eq!(
            (&told["overlooked"], told["last"].as_array().unwrap().len()),
            (&(MOST_WAYS as u64).into(), MOST_LAST)
        );
    }
}
