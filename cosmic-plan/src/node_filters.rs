//! Which frames the controller of each node is to accept.
//!
//! A frame that nobody wants should cost a node nothing. A node wants the frames of clock synchronisation, of the
//! channels that it subscribes to, and all that carry its own TxNode: nobody else should send such a frame, and
//! it must be noticed if somebody does. It also wants the messages of the protocol, for whoever takes part in
//! membership, and so that a broker is noticed where there should be none. Of a hard real-time slot the whole identifier
//! is known. Where the broker hands out etags, they are not known here; then a node that subscribes to such channels
//! accepts all etags of that range.

use crate::cluster::{Cluster, Node};
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
    let node = &cluster.nodes[at];
    let wanted = wanted(cluster, plan, at);
    planned(&wanted).map_err(|_| NoFilters { node: node.name.clone(), wanted: wanted.len() })
}

/// The work grows with the cube of the capacity, so it is chosen as small as it suffices.
fn planned(wanted: &[Wanted]) -> Result<Vec<FilterBank>, FilterBanksError> {
    let banks: FilterBanks<BANKS> = match wanted.len() {
        0..=32 => FilterBanks::plan::<32>(wanted)?,
        33..=128 => FilterBanks::plan::<128>(wanted)?,
        _ => FilterBanks::plan::<MOST_WANTED>(wanted)?,
    };
    Ok(banks.iter().copied().collect())
}

fn wanted(cluster: &Cluster, plan: &Plan, at: usize) -> Vec<Wanted> {
    let node = &cluster.nodes[at];
    // Of one that asks it is not known; a claim to it is among the messages of the protocol.
    let mut wanted: Vec<_> = (!node.asks).then(|| of_own_tx_node(node)).into_iter().collect();
    if cluster.sync_period.is_some() {
        wanted.push(Wanted::etag(Fifo::Urgent, Etag::SYNC));
        wanted.push(Wanted::etag(Fifo::Urgent, Etag::FOLLOW_UP));
    }
    // Interest and status, and whoever acts as broker: in a cluster that has none of it, nothing comes.
    wanted.push(masked(0, RESERVED_ETAGS));
    let slots = plan.slots().iter().filter(|slot| node.subscribes.contains(&slot.channel));
    let others = slots.filter(|slot| slot.node != at).map(|slot| (slot.slot.etag, slot.slot.publisher));
    wanted.extend(others.map(|(etag, publisher)| Wanted::hard(etag, publisher)));
    let mut unknown = false;
    for channel in &node.subscribes {
        match cluster.channels[*channel].etag {
            Some(etag) if etag.is_hard() => {}
            Some(etag) => wanted.push(Wanted::etag(Fifo::Other, etag)),
            None => unknown = true,
        }
    }
    if unknown {
        // From 1024 up, one of the four highest bits is set.
        wanted.extend((10..14).map(|bit| masked(1 << bit, 1 << bit)));
    }
    wanted
}

fn of_own_tx_node(node: &Node) -> Wanted {
    let tx_node_bits = Id::new(Priority::HARD, TxNode::BROKER, etag(0));
    Wanted::masked(Fifo::Other, Id::new(Priority::HARD, node.tx_node, etag(0)), tx_node_bits.raw())
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
        for text in [EXAMPLE, &EXAMPLE.replace("\"static\"", "\"broker\"")] {
            let (cluster, filters) = filters(text);
            for (node, filters) in cluster.nodes.iter().zip(&filters) {
                for priority in [0, 1, 100, 255] {
                    for tag in [0, 16, 19, 100, 101, 1023, 1024, 9_999, 16_383] {
                        assert!(accepts(filters, priority, node.tx_node.get(), tag), "{} {tag}", node.name);
                    }
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
    fn with_a_broker_a_node_accepts_all_that_may_be_bound() {
        let (cluster, filters) = filters(&EXAMPLE.replace("\"static\"", "\"broker\""));
        for (node, filters) in cluster.nodes.iter().zip(&filters) {
            for tag in [0, 1, 2, 4, 16, 18, 19, 1024, 2048, 9_999, 16_383] {
                assert!(accepts(filters, 200, 99, tag), "{} {tag}", node.name);
            }
            assert!(!accepts(filters, 0, 99, 101), "{}", node.name);
        }
    }
}
