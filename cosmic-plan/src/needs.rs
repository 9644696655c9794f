//! How much the nodes of a cluster must have room for.
//!
//! The numbers are those of the node that needs most, so that all nodes of a cluster share one type.

use crate::cluster::{Channel, Cluster, PlannedClass};
use crate::plan::Plan;
use cosmic_core::network::soft::RESERVED;

/// The capacities of a node; what each is of stands at `EventHalf` in the core.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Needs {
    /// Slots of the calendar in which it takes part: a power of two.
    pub slots: usize,
    /// Channels that it announces or subscribes to: a power of two.
    pub channels: usize,
    /// Subscriptions.
    pub subscriptions: usize,
    /// Received events that wait, in all queues together.
    pub events: usize,
    /// Soft real-time events that wait to be sent.
    pub soft: usize,
    /// Non real-time events that wait to be sent.
    pub non_real_time: usize,
}

impl Needs {
    /// What the nodes of the cluster need.
    pub fn of(cluster: &Cluster, plan: &Plan) -> Self {
        let most = |need: &dyn Fn(usize) -> usize| {
            (0..cluster.nodes.len()).map(need).max().unwrap_or(0).max(LEAST).next_power_of_two()
        };
        let nodes = &cluster.nodes;
        let takes_part = |node: usize, channel: usize| {
            nodes[node].publishes.contains(&channel) || nodes[node].subscribes.contains(&channel)
        };
        let published = |node: usize, need: &dyn Fn(&Channel) -> usize| -> usize {
            nodes[node].publishes.iter().map(|channel| need(&cluster.channels[*channel])).sum()
        };
        Self {
            slots: most(&|node| {
                let ours = |slot: &&crate::plan::PlannedSlot| {
                    slot.node == node || nodes[node].subscribes.contains(&slot.channel)
                };
                plan.slots().iter().filter(ours).count()
            }),
            channels: most(&|node| {
                (0..cluster.channels.len()).filter(|channel| takes_part(node, *channel)).count()
            }),
            // A channel may have two readers in one node.
            subscriptions: most(&|node| 2 * nodes[node].subscribes.len()),
            events: most(&|node| EVENTS_OF_A_SUBSCRIPTION * nodes[node].subscribes.len().max(1))
                .min(MOST_PLACES),
            // The core keeps places for the services, beside at least one for events, whether there are any or not.
            soft: most(&|node| published(node, &waiting_soft).max(1) + RESERVED).min(MOST_PLACES),
            non_real_time: most(&|node| published(node, &waiting_non_real_time).max(1) + RESERVED)
                .min(MOST_PLACES),
        }
    }
}

/// As many events as can be valid at the same time.
fn waiting_soft(channel: &Channel) -> usize {
    if !matches!(channel.class, PlannedClass::Soft) {
        return 0;
    }
    let period = channel.recurrence.span().as_ticks().max(1);
    let valid = channel.validity.or(channel.deadline).unwrap_or(channel.recurrence.span());
    let count = (valid.as_ticks() + channel.tolerance().as_ticks()).div_ceil(period);
    usize::try_from(count).unwrap_or(MOST_PLACES).clamp(1, MOST_PLACES)
}

fn waiting_non_real_time(channel: &Channel) -> usize {
    if matches!(channel.class, PlannedClass::NonRealTime { .. }) {
        EVENTS_OF_A_NON_REAL_TIME_CHANNEL
    } else {
        0
    }
}

/// No capacity is less.
const LEAST: usize = 2;

/// A queue has at most so many places.
const MOST_PLACES: usize = 255;

/// Received events of a subscription that may wait.
const EVENTS_OF_A_SUBSCRIPTION: usize = 16;

/// Non real-time events may wait for any time, so this is a choice.
const EVENTS_OF_A_NON_REAL_TIME_CHANNEL: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Source;
    use crate::plan::{Effort, plan};

    /// The core refuses smaller queues when it is compiled.
    #[test]
    fn a_cluster_without_channels_of_a_class_has_a_queue_for_it_all_the_same() {
        let text = "[segment]\nname = \"s\"\nbit_rate = \"1 Mbit/s\"\nclock_accuracy = \"50 us\"\n\
            release_jitter = \"20 us\"\nsync_period = \"25 ms\"\n\
            [[node]]\nname = \"a\"\nuid = 1\npublishes = [\"c\"]\n\
            [[node]]\nname = \"b\"\nuid = 2\nsubscribes = [\"c\"]\n\
            [[channel]]\nname = \"c\"\nsubject = 3\nclass = \"HRT\"\nlength = 2\nperiod = \"10 ms\"\n\
            omission_degree = 1\n";
        let cluster = Cluster::read(&Source::new("hard.toml", text)).unwrap();
        let plan = plan(&cluster, &Effort::default()).unwrap();
        let needs = Needs::of(&cluster, &plan);
        assert!(needs.soft > RESERVED && needs.non_real_time > RESERVED, "{needs:?}");
    }
}
