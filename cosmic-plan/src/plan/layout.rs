//! From channels to windows, and back from positions to slots.

use super::found::{Method, Plan, PlannedSlot};
use super::request::{Item, Link, Request, Spacing, gcd, ticks};
use crate::cluster::{Cluster, PlannedClass, Recurrence, Wishes};
use cosmic_core::calendar::{Slot, SlotTimes};
use cosmic_core::can::{ERROR_RECOVERY_BITS, Etag, TxNode};
use cosmic_core::time::Duration;

/// What an item is for: the slots that share its window (one, if it is no pool).
#[derive(Clone, Debug)]
pub(super) struct Owner {
    pub(super) slots: Vec<(usize, usize)>,
    pub(super) pool: Option<usize>,
    pub(super) times: SlotTimes,
}

/// A request and what its items are for.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub(super) request: Request,
    pub(super) owners: Vec<Owner>,
    /// The last position of each item if its user wishes nothing.
    pub(super) unwished: Vec<i64>,
    pub(super) cycle: i64,
}

impl Layout {
    /// One strictly periodic window for every slot, or for every pool of slots.
    pub(super) fn of(cluster: &Cluster) -> Self {
        let mut owners = Vec::new();
        let mut pooled = Vec::new();
        for channel in super::hard_channels(cluster) {
            match cluster.pool_of(channel) {
                Some(pool) if pooled.contains(&pool) => {}
                Some(pool) => {
                    pooled.push(pool);
                    owners.push(pool_owner(cluster, pool));
                }
                None => owners.extend(publishers(cluster, channel).map(|node| Owner {
                    slots: vec![(channel, node)],
                    pool: None,
                    times: times(cluster, channel),
                })),
            }
        }
        let items: Vec<Item> = owners.iter().map(|owner| item(cluster, owner)).collect();
        let cycle = items.iter().fold(1, |cycle, item| item.period / gcd(cycle, item.period) * cycle);
        let links = links(cluster, &owners);
        let unwished =
            owners.iter().zip(&items).map(|(owner, item)| unwished(cluster, owner, item)).collect();
        Self { request: Request { items, links }, owners, unwished, cycle }
    }

    /// Every occurrence of the channels that allow jitter by itself, within that part of it; `None` if no
    /// channel does.
    pub(super) fn by_occurrence(&self, cluster: &Cluster, part: i64) -> Option<Self> {
        let mut split =
            Self { request: Request::default(), owners: Vec::new(), unwished: Vec::new(), cycle: self.cycle };
        let mut first_of = Vec::new();
        let mut any = false;
        for ((item, owner), unwished) in self.request.items.iter().zip(&self.owners).zip(&self.unwished) {
            let jitter =
                owner.slots.iter().map(|(channel, _)| ticks(cluster.channels[*channel].jitter)).min();
            let allowed = jitter.unwrap_or(0);
            let jitter = allowed / part;
            let linked = self.request.links.iter().any(|link| {
                [link.first, link.then].iter().any(|at| std::ptr::eq(&self.request.items[*at], item))
            });
            let turns = if allowed > 0 && !linked { self.cycle / item.period } else { 1 };
            let reference = split.request.items.len();
            first_of.push(reference);
            any |= turns > 1;
            for turn in 0..turns {
                let offset = turn * item.period;
                let spacing = (turn > 0).then_some(Spacing { reference, offset, jitter });
                split.request.items.push(Item {
                    period: if turns > 1 { self.cycle } else { item.period },
                    window: item.window,
                    earliest: item.earliest + offset,
                    latest: item.latest + offset,
                    spacing,
                });
                split.owners.push(owner.clone());
                split.unwished.push(unwished + offset);
            }
        }
        let moved = |link: &Link| Link { first: first_of[link.first], then: first_of[link.then], ..*link };
        split.request.links = self.request.links.iter().map(moved).collect();
        any.then_some(split)
    }

    /// The slots at these positions.
    pub(super) fn plan(&self, cluster: &Cluster, positions: &[i64], method: Method) -> Plan {
        let mut slots = Vec::new();
        for ((item, owner), position) in self.request.items.iter().zip(&self.owners).zip(positions) {
            let phase = position.rem_euclid(item.period);
            for &(channel, node) in &owner.slots {
                let mut slot = slot(cluster, channel, node, item.period, phase);
                if let Some(pool) = owner.pool {
                    // In the calendar, slots that are ready together share this one budget.
                    slot.omission_degree = cluster.pools[pool].faults;
                }
                slots.push(PlannedSlot { channel, node, slot, times: owner.times, pool: owner.pool });
            }
        }
        slots.sort_by_key(|planned| (planned.slot.phase, planned.slot.etag, planned.slot.publisher));
        let cycle = Duration::from_ticks(self.cycle.unsigned_abs());
        Plan { segment: cluster.segment, cycle, slots, method }
    }
}

fn publishers(cluster: &Cluster, channel: usize) -> impl Iterator<Item = usize> + '_ {
    (0..cluster.nodes.len()).filter(move |node| cluster.nodes[*node].publishes.contains(&channel))
}

fn omission_degree(cluster: &Cluster, channel: usize) -> u8 {
    match &cluster.channels[channel].class {
        PlannedClass::Hard { omission_degree, .. } => *omission_degree,
        _ => 0,
    }
}

fn wishes(cluster: &Cluster, channel: usize) -> Wishes {
    match &cluster.channels[channel].class {
        PlannedClass::Hard { wishes, .. } => wishes.clone(),
        _ => Wishes::default(),
    }
}

fn length(cluster: &Cluster, channel: usize) -> u8 {
    u8::try_from(cluster.channels[channel].length).unwrap_or(u8::MAX)
}

fn times(cluster: &Cluster, channel: usize) -> SlotTimes {
    cluster.segment.slot_times(length(cluster, channel), omission_degree(cluster, channel))
}

/// A pool's window: all its frames are loaded at its ready instant and wait on the bus together, so only
/// the first can be held up by a lower-priority frame; then they follow each other without a gap. They share
/// one budget of faults, each of which costs the longest of them again.
fn pool_owner(cluster: &Cluster, pool: usize) -> Owner {
    let group = &cluster.pools[pool];
    let slots: Vec<(usize, usize)> =
        group.channels.iter().flat_map(|c| publishers(cluster, *c).map(move |node| (*c, node))).collect();
    let segment = &cluster.segment;
    let frame = |channel: usize| segment.bit_rate.longest_frame(usize::from(length(cluster, channel)));
    let all: u64 = slots.iter().map(|(channel, _)| frame(*channel).as_ticks()).sum();
    let longest = slots.iter().map(|(channel, _)| frame(*channel).as_ticks()).max().unwrap_or(0);
    let recovery = segment.bit_rate.bits(ERROR_RECOVERY_BITS).as_ticks();
    let latest_start = segment.wait();
    let deadline = latest_start.as_ticks() + all + u64::from(group.faults) * (longest + recovery);
    let times = SlotTimes {
        latest_start,
        deadline: Duration::from_ticks(deadline),
        delivery: Duration::from_ticks(deadline + segment.gap().as_ticks()),
    };
    Owner { slots, pool: Some(pool), times }
}

/// An item with the wishes of all its slots; contradicting ones leave no position.
fn item(cluster: &Cluster, owner: &Owner) -> Item {
    let window = ticks(owner.times.delivery);
    let period = owner.slots.first().map_or(1, |(c, _)| ticks(cluster.channels[*c].recurrence.span()));
    let mut item = Item { period, window, earliest: 0, latest: period - 1, spacing: None };
    for (channel, _) in &owner.slots {
        let wishes = wishes(cluster, *channel);
        if let Some(phase) = wishes.phase {
            item.earliest = item.earliest.max(ticks(phase));
            item.latest = item.latest.min(ticks(phase));
        }
        if let Some(earliest) = wishes.earliest {
            item.earliest = item.earliest.max(ticks(earliest));
        }
        // Not later than the end of the period, so that an event is delivered in the period that it is of.
        if let Some(deadline) = cluster.delivery_deadline(*channel) {
            item.latest = item.latest.min(ticks(deadline) - window);
        }
    }
    item
}

/// The last position if nothing is wished: so that a periodic event is delivered in its own period.
fn unwished(cluster: &Cluster, owner: &Owner, item: &Item) -> i64 {
    let periodic = |(channel, _): &(usize, usize)| cluster.delivery_deadline(*channel).is_some();
    if owner.slots.iter().any(periodic) { item.period - item.window } else { item.period - 1 }
}

fn links(cluster: &Cluster, owners: &[Owner]) -> Vec<Link> {
    let owners_of = |channel: usize| {
        (0..owners.len()).filter(move |at| owners[*at].slots.iter().any(|(c, _)| *c == channel))
    };
    let mut links = Vec::new();
    for channel in super::hard_channels(cluster) {
        let Some(after) = wishes(cluster, channel).after else { continue };
        for then in owners_of(channel) {
            for first in owners_of(after.channel).filter(|first| *first != then) {
                links.push(Link { first, then, within: ticks(after.within) });
            }
        }
    }
    links
}

fn slot(cluster: &Cluster, channel: usize, node: usize, period: i64, phase: i64) -> Slot {
    let description = &cluster.channels[channel];
    Slot {
        etag: description.etag.unwrap_or(Etag::HARD_FIRST),
        publisher: cluster.nodes.get(node).map_or(TxNode::MIN, |node| node.tx_node),
        len: length(cluster, channel),
        omission_degree: omission_degree(cluster, channel),
        periodic: matches!(description.recurrence, Recurrence::Periodic(_)),
        period: Duration::from_ticks(period.unsigned_abs()),
        phase: Duration::from_ticks(phase.unsigned_abs()),
    }
}
