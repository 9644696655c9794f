//! Which frames the controller of each node is to accept.
//!
//! A frame that nobody wants should cost a node nothing. A node wants the frames of clock synchronisation, of the
//! channels that it subscribes to, and all that carry its own TxNode: nobody else should send such a frame, and
//! it must be noticed if somebody does. It also wants the messages of the protocol, for whoever takes part in
//! membership, and so that a broker is noticed where there should be none. Of a hard real-time slot the whole identifier
//! is known.
//!
//! Where a broker hands out TxNodes and etags, they are not known here. A node that asks for its TxNode, or subscribes to
//! such a channel, is named at run time: half of the banks are left for what it wants by its names then, and for all
//! channels that are no hard real-time.

use crate::cluster::Cluster;
use crate::plan::Plan;
use cosmic_core::can::filter_banks::{Fifo, FilterBank, FilterBanks, FilterBanksError, Wanted};
use cosmic_core::can::{Etag, Id, Priority, TxNode};
use std::fmt;

/// A node has no filters.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NoFilters {
    /// The name of the node.
    pub node: String,
    /// How many frames of different kind it wants.
    pub wanted: usize,
}

impl fmt::Display for NoFilters {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { node, wanted } = self;
        write!(f, "node.{node}.subscribes: {wanted} kinds of frames are too many for its filters; ")?;
        write!(f, "let it subscribe to less, at most {MOST_WANTED}")
    }
}

/// The filters of each node, in the order of the file.
///
/// # Errors
/// The first node that wants too much.
pub fn of_all(cluster: &Cluster, plan: &Plan) -> Result<Vec<Vec<FilterBank>>, NoFilters> {
    (0..cluster.nodes.len()).map(|node| of_node(cluster, plan, node)).collect()
}

fn of_node(cluster: &Cluster, plan: &Plan, at: usize) -> Result<Vec<FilterBank>, NoFilters> {
    let wanted = wanted(cluster, plan, at);
    let planned = if is_named_at_run_time(cluster, at) {
        planned::<{ BANKS / 2 }>(&wanted)
    } else {
        planned::<BANKS>(&wanted)
    };
    planned.map_err(|_| NoFilters { node: cluster.nodes[at].name.clone(), wanted: wanted.len() })
}

/// Returns whether a broker gives the node its TxNode, or etags of what it subscribes to.
pub fn is_named_at_run_time(cluster: &Cluster, at: usize) -> bool {
    let node = &cluster.nodes[at];
    node.asks || node.subscribes.iter().any(|channel| cluster.channels[*channel].etag.is_none())
}

/// The work grows with the cube of the capacity, so it is chosen as small as it suffices.
fn planned<const BANKS: usize>(wanted: &[Wanted]) -> Result<Vec<FilterBank>, FilterBanksError> {
    let banks: FilterBanks<BANKS> = match wanted.len() {
        0..=32 => FilterBanks::plan::<32>(wanted)?,
        33..=128 => FilterBanks::plan::<128>(wanted)?,
        _ => FilterBanks::plan::<MOST_WANTED>(wanted)?,
    };
    Ok(banks.iter().copied().collect())
}

fn wanted(cluster: &Cluster, plan: &Plan, at: usize) -> Vec<Wanted> {
    let node = &cluster.nodes[at];
    let mut wanted = Vec::new();
    if cluster.sync_period.is_some() {
        wanted.push(Wanted::etag(Fifo::Urgent, Etag::SYNC));
        wanted.push(Wanted::etag(Fifo::Urgent, Etag::FOLLOW_UP));
    }
    // Interest and status, and whoever acts as broker: in a cluster that has none of it, nothing comes.
    wanted.push(masked(0, RESERVED_ETAGS));
    let slots = plan.slots().iter().filter(|slot| node.subscribes.contains(&slot.channel));
    let others = slots.filter(|slot| slot.node != at).map(|slot| (slot.slot.etag, slot.slot.publisher));
    wanted.extend(others.map(|(etag, publisher)| Wanted::hard(etag, publisher)));
    if !is_named_at_run_time(cluster, at) {
        wanted.push(Wanted::tx_node(Fifo::Other, node.tx_node));
        let etags = node.subscribes.iter().filter_map(|channel| cluster.channels[*channel].etag);
        wanted.extend(etags.filter(|etag| !etag.is_hard()).map(|etag| Wanted::etag(Fifo::Other, etag)));
    }
    wanted
}

/// The etags that agree with one in the bits of a mask.
fn masked(of: u16, mask: u16) -> Wanted {
    Wanted::masked(Fifo::Other, Id::new(Priority::HARD, TxNode::MIN, etag(of)), u32::from(mask))
}

fn etag(value: u16) -> Etag {
    Etag::new(value).unwrap_or(Etag::SYNC)
}

/// The banks of one bxCAN controller that has no second one beside it (RM0090, bxCAN filter banks).
const BANKS: usize = 14;

/// Wishes of a node, at most.
const MOST_WANTED: usize = 512;

/// These bits are zero in the etags 0..=31, in which the protocol's own are.
const RESERVED_ETAGS: u16 = 0x3FE0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::EXAMPLE;
    use crate::document::Source;
    use crate::plan::{Effort, plan};

    fn filters(text: &str) -> (Cluster, Vec<Vec<FilterBank>>) {
        let cluster = Cluster::read(&Source::new("test.toml", text)).unwrap();
        let plan = plan(&cluster, &Effort::default()).unwrap();
        let filters = of_all(&cluster, &plan).unwrap();
        (cluster, filters)
    }

    fn accepts(filters: &[FilterBank], priority: u8, tx_node: u8, tag: u16) -> bool {
        let id = Id::new(Priority::new(priority), TxNode::new(tx_node).unwrap(), etag(tag));
        filters.iter().any(|bank| bank.accepts(id))
    }

    #[test]
    fn a_node_accepts_every_frame_with_its_own_tx_node() {
        let (cluster, filters) = filters(EXAMPLE);
        for (node, filters) in cluster.nodes.iter().zip(&filters) {
            for priority in [0, 1, 100, 255] {
                for tag in [0, 16, 19, 100, 101, 1023, 1024, 9_999, 16_383] {
                    assert!(accepts(filters, priority, node.tx_node.get(), tag), "{} {tag}", node.name);
                }
            }
        }
    }

    #[test]
    fn a_node_accepts_what_it_subscribes_to_and_the_protocol_and_nothing_else() {
        let (cluster, filters) = filters(EXAMPLE);
        let brake = cluster.nodes.iter().position(|node| node.name == "brake").unwrap();
        let tag = |name: &str| cluster.channels[cluster.channel_named(name).unwrap()].etag.unwrap().get();
        let brake = &filters[brake];
        assert!(brake.len() <= BANKS);
        // The wheel speed in the slot of the sensor, not elsewhere.
        assert!(accepts(brake, 0, 1, tag("wheel_speed")));
        assert!(!accepts(brake, 0, 3, tag("wheel_speed")));
        assert!(!accepts(brake, 1, 1, tag("wheel_speed")));
        for own in [tag("temperature"), tag("suspension"), 16, 17] {
            assert!(accepts(brake, 1, 3, own) && accepts(brake, 249, 1, own), "{own}");
        }
        for foreign in [tag("logbook"), tag("brake_force")] {
            assert!(!accepts(brake, 250, 3, foreign), "{foreign}");
        }
        // Who is there, who wants what, and a broker where there should be none.
        for protocol in [0, 1, 2, 4, 7, 8, 9, 18, 19] {
            assert!(accepts(brake, 250, 3, protocol), "{protocol}");
        }
        // What must be read at once has a FIFO of its own.
        let sync = Id::new(Priority::new(1), TxNode::MIN, Etag::SYNC);
        assert!(brake.iter().any(|bank| bank.fifo() == Fifo::Urgent && bank.accepts(sync)));
    }

    #[test]
    fn with_a_broker_the_plan_has_only_what_nobody_names_and_leaves_banks_for_the_rest() {
        let (cluster, filters) = filters(&EXAMPLE.replace("\"static\"", "\"broker\""));
        for (at, (node, filters)) in cluster.nodes.iter().zip(&filters).enumerate() {
            assert!(is_named_at_run_time(&cluster, at), "{}", node.name);
            assert!(filters.len() <= BANKS / 2, "{}", node.name);
            for tag in [0, 1, 2, 4, 16, 18, 19] {
                assert!(accepts(filters, 200, 99, tag), "{} {tag}", node.name);
            }
            for tag in [101, 1024, 2048, 9_999, 16_383] {
                assert!(!accepts(filters, 200, 99, tag), "{} {tag}", node.name);
            }
        }
        let brake = cluster.nodes.iter().position(|node| node.name == "brake").unwrap();
        let wheel_speed = cluster.channels[cluster.channel_named("wheel_speed").unwrap()].etag.unwrap();
        assert!(accepts(&filters[brake], 0, 1, wheel_speed.get()));
    }
}
