//! Frames that should not be there, for the [doctor](super::doctor).

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::time::{Duration, Instant};

use crate::plan::SegmentPlan;
use crate::slots::Standing;

/// What was seen of suspicious frames, bounded.
#[derive(Clone, Default, Debug)]
pub(crate) struct Suspects {
    pub(crate) hard: Vec<Suspect<Standing>>,
    pub(crate) publishers: Vec<Suspect<()>>,
    calendars: Vec<Suspect<u32>>,
    pub(crate) step: Option<(TxNode, i64, Instant)>,
}

/// Frames of one kind from one node.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Suspect<T> {
    pub(crate) etag: Etag,
    pub(crate) tx_node: TxNode,
    pub(crate) what: T,
    pub(crate) count: u64,
    pub(crate) at: Instant,
}

impl Suspects {
    pub(crate) fn hard(&mut self, etag: Etag, tx_node: TxNode, standing: Standing, at: Instant) {
        note(&mut self.hard, etag, tx_node, standing, at);
    }

    pub(crate) fn publisher(&mut self, etag: Etag, tx_node: TxNode, at: Instant) {
        note(&mut self.publishers, etag, tx_node, (), at);
    }

    /// A sync frame stated this digest.
    pub(crate) fn calendar(&mut self, tx_node: TxNode, digest: u32, at: Instant) {
        if digest != 0 {
            note(&mut self.calendars, Etag::SYNC, tx_node, digest, at);
        }
    }

    pub(crate) fn clock_step(&mut self, tx_node: TxNode, by: i64, at: Instant) {
        self.step = Some((tx_node, by, at));
    }

    /// Two digests of late, or one that is not the plan's: the nodes, and the digests.
    pub(crate) fn two_calendars(
        &self,
        plan: Option<&SegmentPlan>,
        now: Instant,
    ) -> Option<(Vec<u8>, String)> {
        let fresh = |suspect: &&Suspect<u32>| now.saturating_since(suspect.at) <= CALENDAR;
        let fresh: Vec<_> = self.calendars.iter().filter(fresh).collect();
        let reference = plan.map(SegmentPlan::digest).or(fresh.first().map(|suspect| suspect.what))?;
        let other = fresh.iter().find(|suspect| suspect.what != reference)?;
        let whose = if plan.is_some() { "the plan has" } else { "another master has" };
        let what = format!(
            "time master {} has calendar {:08X}, {whose} {reference:08X}",
            named(other.tx_node, plan),
            other.what
        );
        Some((fresh.iter().map(|suspect| suspect.tx_node.get()).collect(), what))
    }
}

impl Suspect<Standing> {
    pub(crate) fn standing(&self) -> Standing {
        self.what
    }
}

/// Constant time: a short list, in which the one seen longest ago makes room.
fn note<T: PartialEq + Copy>(list: &mut Vec<Suspect<T>>, etag: Etag, tx_node: TxNode, what: T, at: Instant) {
    let same =
        |suspect: &&mut Suspect<T>| (suspect.etag, suspect.tx_node, suspect.what) == (etag, tx_node, what);
    if let Some(suspect) = list.iter_mut().find(same) {
        suspect.count += 1;
        suspect.at = at;
        return;
    }
    if list.len() == SUSPECTS {
        let oldest = (0..list.len()).min_by_key(|index| list[*index].at).unwrap_or(0);
        list.swap_remove(oldest);
    }
    list.push(Suspect { etag, tx_node, what, count: 1, at });
}

/// The node in words.
pub(crate) fn named(tx_node: TxNode, plan: Option<&SegmentPlan>) -> String {
    match plan.and_then(|plan| plan.node(tx_node)) {
        Some(node) => format!("{} ({tx_node})", node.name),
        None => format!("node {tx_node}"),
    }
}

/// Suspicious senders that are remembered, of each kind.
const SUSPECTS: usize = 16;
/// Digests within this span contradict each other; a master that was replaced is silent for longer.
const CALENDAR: Duration = Duration::from_secs(5);
