//! What the workshop promises, each with what became of it.

use std::collections::BTreeSet;

use cosmic_core::can::{Etag, Priority};
use cosmic_core::protocol::{AdmissionVerdict, ControlMessage};
use cosmic_plan::cluster::{Channel, Cluster};

use super::names::{Bound, Name};
use super::{
    DESK, DESK_GOES, LAMP, NANOSECONDS_OF_MILLISECOND, PROBE, SCOUT, SPARE, Sent, Story, millisecond,
};
use crate::columns::counted;

/// A promise, and what became of it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Promise {
    /// What became of it, with its figures.
    pub text: String,
    /// Whether it was kept.
    pub is_kept: bool,
}

/// All that is promised, of a run.
pub(super) fn all(workshop: &Cluster, story: &Story, ids: &[Name], bound: &[Bound]) -> Vec<Promise> {
    let run = Run { workshop, story, ids, bound };
    vec![
        run.names(),
        run.etags(),
        run.stops(),
        run.slots(),
        run.filters(),
        run.rests(),
        run.messages(),
        run.admission(),
        run.takes_over(),
    ]
}

/// A run, with what was read out of it.
struct Run<'r> {
    workshop: &'r Cluster,
    story: &'r Story,
    ids: &'r [Name],
    bound: &'r [Bound],
}

impl Run<'_> {
    fn names(&self) -> Promise {
        let nodes = self.workshop.nodes.len();
        let named: BTreeSet<_> = self.ids.iter().map(|name| &name.node).collect();
        let used: BTreeSet<_> = self.ids.iter().map(|name| (name.tx_node, &name.node)).collect();
        let ids: BTreeSet<_> = used.iter().map(|(id, _)| id).collect();
        Promise {
            text: format!("Ids: {} of {nodes} nodes have one, each its own.", named.len()),
            is_kept: named.len() == nodes && ids.len() == used.len(),
        }
    }

    fn etags(&self) -> Promise {
        let asks = |channel: &&Channel| channel.etag.is_none();
        let of_plan: Vec<_> = self.workshop.channels.iter().filter(asks).collect();
        let etags = |channel: &Channel| self.bound.iter().filter(|it| it.subject == channel.subject).count();
        let once = of_plan.iter().filter(|channel| etags(channel) == 1).count();
        Promise {
            text: format!(
                "Etags: {once} of {} channels of the plan were bound, also across the fail-over to one etag.",
                of_plan.len()
            ),
            is_kept: once == of_plan.len(),
        }
    }

    /// The desk asks for a stop, and the lamp stops.
    fn stops(&self) -> Promise {
        let (asked, came) = (self.story.instants(DESK, "stops, for"), self.story.instants(LAMP, "Stop {"));
        let slowest = asked.iter().zip(&came).map(|(asked, came)| came.saturating_sub(*asked)).max();
        let interval = self.channel("emergency_stop").map_or(0, |it| it.recurrence.span().as_millis());
        Promise {
            text: format!(
                "Emergency stop, sporadic and hard: {} of {} came, {} ms after it was asked for at most; a slot is there \
                 every {interval} ms.",
                came.len(),
                asked.len(),
                slowest.unwrap_or(0)
            ),
            // Lines are read out once in a millisecond.
            is_kept: !asked.is_empty()
                && asked.len() == came.len()
                && slowest.is_some_and(|it| it <= interval + 2),
        }
    }

    /// Hard frames come at one phase of their period. The time is the desk's, whose crystal is as fast as the bus's clock.
    fn slots(&self) -> Promise {
        let period = self.channel("emergency_stop").map_or(1, |it| it.recurrence.span().as_nanos());
        let hard = self.story.frames.iter().filter(|it| it.frame.id.priority() == Priority::HARD);
        let phases: Vec<_> = hard.map(|it| it.at.as_ticks() % period).collect();
        let apart = |a: u64, b: u64| a.abs_diff(b).min(period - a.abs_diff(b));
        let spread = phases.iter().map(|phase| apart(*phase, phases[0])).max();
        let segment = &self.workshop.segment;
        let allowed = 2 * (segment.accuracy.as_nanos() + segment.release_jitter.as_nanos());
        Promise {
            text: format!(
                "Its slot: {} on the bus, at most {:.1} µs from one phase; allowed {:.1} µs.",
                counted(phases.len() as u64, "frame"),
                spread.unwrap_or(0) as f64 / 1e3,
                allowed as f64 / 1e3
            ),
            is_kept: spread.is_some_and(|spread| spread <= allowed),
        }
    }

    /// The lamp wants readings of the places 1 to 9: the probe's, not the scout's.
    fn filters(&self) -> Promise {
        let (near, far) = (self.on_bus("reading", PROBE), self.on_bus("reading", SCOUT));
        let shown = |place: &str| {
            let is_one = |it: &&super::Line| it.node == LAMP && it.text.ends_with(place);
            self.story.lines.iter().filter(is_one).count()
        };
        let (seen, excluded) = (shown("at Some(7)"), shown("at Some(42)"));
        Promise {
            text: format!(
                "Filter by context: {near} readings of place 7 and {far} of place 42 on the bus; the lamp, which asks for 1 \
                 to 9, was shown {excluded} of the latter."
            ),
            is_kept: near > 0 && far > 0 && seen > 0 && excluded == 0,
        }
    }

    /// The probe gives its channel up, and announces it again.
    fn rests(&self) -> Promise {
        let rests = self.story.instants(PROBE, "rests");
        let Some(etag) = self.etag("reading") else {
            return broken("Channels at run time: the reading has no etag.");
        };
        // Within a second.
        let sends =
            |from: u64| self.sent(PROBE, etag).any(|it| (from..from + 1_000).contains(&millisecond(it.at)));
        let again = rests.iter().filter(|rest| sends(**rest + PAUSE)).count();
        Promise {
            text: format!(
                "Channels at run time: given up {} times, announced again {again} times.",
                rests.len()
            ),
            // After the last rest the run may end.
            is_kept: rests.len() >= 2 && again + 1 >= rests.len(),
        }
    }

    /// What the probe writes, the desk reads, as long as it is there.
    fn messages(&self) -> Promise {
        let written = self.story.instants(PROBE, "has written").iter().filter(|at| **at < DESK_GOES).count();
        let read = self.story.instants(DESK, "node ").len();
        Promise {
            text: format!("Messages longer than a frame: {read} of {written} came as a whole."),
            is_kept: read > 0 && read == written,
        }
    }

    /// What is in no plan is not published before it is admitted, and its deadline holds then.
    fn admission(&self) -> Promise {
        let Some(vibration) = self.bound.iter().find(|it| it.channel.is_none()) else {
            return broken("Admission: nobody asked for a channel that is in no plan.");
        };
        let is_admitted = |sent: &&Sent| match ControlMessage::decode(&sent.frame) {
            Some(ControlMessage::AdmissionReply(reply)) => {
                reply.etag == vibration.etag && matches!(reply.verdict, AdmissionVerdict::Admitted(_))
            }
            _ => false,
        };
        let Some(admitted) = self.story.frames.iter().find(is_admitted).map(|it| it.at) else {
            return broken("Admission: the channel that is in no plan was not admitted.");
        };
        let events: Vec<_> =
            self.story.frames.iter().filter(|it| it.frame.id.etag() == vibration.etag).collect();
        let before = events.iter().filter(|it| it.at < admitted).count();
        let gap = events.windows(2).map(|two| two[1].at.as_ticks() - two[0].at.as_ticks()).max();
        Promise {
            text: format!(
                "Admission: the scout's vibration, in no plan, was admitted at {:.1} s; {before} events before that, {} \
                 afterwards, at most {:.1} ms apart: every {VIBRATION_EVERY} ms, with a deadline of {VIBRATION_DEADLINE} ms.",
                admitted.as_ticks() as f64 / 1e9,
                events.len() - before,
                gap.unwrap_or(0) as f64 / 1e6
            ),
            is_kept: before == 0
                && gap.is_some_and(|gap| {
                    gap <= (VIBRATION_EVERY + VIBRATION_DEADLINE) * NANOSECONDS_OF_MILLISECOND
                }),
        }
    }

    /// The spare is the broker when the desk is gone, and the lamp, which starts anew, gets its id of it.
    fn takes_over(&self) -> Promise {
        let active = self.story.instants(SPARE, "Became(Active)").into_iter().find(|at| *at >= DESK_GOES);
        let lamp = self.ids.iter().filter(|name| name.node == LAMP).collect::<Vec<_>>();
        let Some(active) = active else {
            return broken("Fail-over: the spare did not take over from the desk.");
        };
        let [first, again] = lamp.as_slice() else {
            return broken("Fail-over: the lamp, started anew, has no id.");
        };
        let is_the_same = first.tx_node == again.tx_node;
        Promise {
            text: format!(
                "Fail-over: the spare names nodes {:.1} s after the desk was switched off; the lamp, started anew, has id {} \
                 of it after {} ms, {}.",
                (active - DESK_GOES) as f64 / 1e3,
                again.tx_node.get(),
                again.after,
                if is_the_same { "as before" } else { "and had another one before" }
            ),
            is_kept: active - DESK_GOES <= TAKE_OVER && is_the_same,
        }
    }

    fn channel(&self, name: &str) -> Option<&Channel> {
        self.workshop.channels.iter().find(|it| it.name == name)
    }

    fn etag(&self, channel: &str) -> Option<Etag> {
        let by_broker = self.bound.iter().find(|it| it.channel.as_deref() == Some(channel));
        self.channel(channel)?.etag.or(by_broker.map(|it| it.etag))
    }

    /// Events of a channel that a node sent.
    fn on_bus(&self, channel: &str, node: &str) -> usize {
        self.etag(channel).map_or(0, |etag| self.sent(node, etag).count())
    }

    /// What a node sent on an etag.
    fn sent(&self, node: &str, etag: Etag) -> impl Iterator<Item = &Sent> {
        let id = self.ids.iter().find(|it| it.node == node).map(|it| it.tx_node);
        let is_one = move |it: &&Sent| it.frame.id.etag() == etag && Some(it.frame.id.tx_node()) == id;
        self.story.frames.iter().filter(is_one)
    }
}

fn broken(text: &str) -> Promise {
    Promise { text: text.into(), is_kept: false }
}

/// Into a rest, in milliseconds: nothing of before is on its way any more.
const PAUSE: u64 = 200;
/// Until a spare takes over, in milliseconds (`BrokerTiming::DEFAULT`).
const TAKE_OVER: u64 = 1_300;
/// What the workshop's lib.rs states of the vibration, in milliseconds.
const VIBRATION_EVERY: u64 = 20;
const VIBRATION_DEADLINE: u64 = 5;
