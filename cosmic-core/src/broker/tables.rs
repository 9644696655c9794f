//! The broker's tables: which node has which TxNode, which subject has which etag.
//!
//! An id is the index of its entry, counted from the top of its range down, so that looking one up is one
//! access, and every id that the broker can hand out has a place in which "somebody uses this" can be
//! kept. Looking for a UID or a subject walks the table.

use super::table::{Conflict, Table};
use crate::can::{Etag, TxNode};
use crate::time::{Duration, Instant};
use crate::uid::{NodeUid, Subject};

/// Node UIDs and their TxNodes: the `N` ids from 0x7E down. Ids below them are never handed out, and are
/// the place for nodes whose id is fixed.
#[derive(Clone, Debug)]
pub struct Nodes<const N: usize>(Table<NodeUid, N>);

impl<const N: usize> Nodes<N> {
    /// An empty table.
    pub const fn new() -> Self {
        const { assert!(N >= 1 && N <= TxNode::MAX.get() as usize + 1, "there are 127 TxNodes") };
        Self(Table::new())
    }

    /// Enters a pair, as when a stored table is restored. O(`N`).
    ///
    /// # Errors
    /// When another node has the id, or it is not one that this table covers.
    pub fn restore(&mut self, uid: NodeUid, tx_node: TxNode) -> Result<(), Conflict<NodeUid>> {
        self.0.insert(uid, Self::index(tx_node).ok_or(Conflict::OutOfRange)?)
    }

    /// All pairs, to be stored and restored. O(`N`).
    pub fn entries(&self) -> impl Iterator<Item = (NodeUid, TxNode)> + '_ {
        self.0.entries().filter_map(|(uid, at)| Some((uid, Self::tx_node(at)?)))
    }

    /// Whose id this is.
    pub fn uid_of(&self, tx_node: TxNode) -> Option<NodeUid> {
        self.0.name(Self::index(tx_node)?)
    }

    /// How many ids are left, without those of which only the use was seen. O(`N`).
    pub fn free(&self) -> usize {
        self.0.free()
    }

    /// Of how many ids only the use was seen. O(`N`).
    pub fn unnamed(&self) -> usize {
        self.0.unnamed()
    }

    /// The id of a node, which it gets now if it has none, from the top down; `None` if none is left. O(`N`).
    pub(super) fn assign(&mut self, uid: NodeUid, now: Instant, named: Duration) -> Option<TxNode> {
        Self::tx_node(self.0.promise(uid, now, named, false)?)
    }

    /// As [`assign`](Self::assign), from the bottom up: where another broker has handed out ids from the top,
    /// nobody knows how many, it has come down to these last.
    pub(super) fn assign_from_below(
        &mut self,
        uid: NodeUid,
        now: Instant,
        named: Duration,
    ) -> Option<TxNode> {
        Self::tx_node(self.0.promise(uid, now, named, true)?)
    }

    /// The active broker has assigned this id; whoever had it before. O(`N`).
    pub(super) fn mirror(&mut self, uid: NodeUid, tx_node: TxNode) {
        let known = self.uid_of(tx_node) == Some(uid);
        if let (Some(at), false) = (Self::index(tx_node), known) {
            self.0.release(uid);
            self.0.promise_at(uid, at);
        }
    }

    /// A node said that it uses this id; whoever had it before. O(`N`).
    pub(super) fn learn(&mut self, uid: NodeUid, tx_node: TxNode) {
        match Self::index(tx_node) {
            Some(at) if at < N => self.0.overwrite(uid, at),
            // It has a fixed id that we never hand out; one that we gave it before is free again.
            _ => _ = self.0.release(uid),
        }
    }

    /// This id is in use, and is not handed out to another node before `until`. Returns whether it was free.
    /// Constant time.
    pub(super) fn occupy(&mut self, tx_node: TxNode, until: Instant) -> bool {
        Self::index(tx_node).is_some_and(|at| self.0.occupy(at, until))
    }

    /// A broker that hands ids out from the top has come down to this one. O(`N`).
    pub(super) fn occupy_down_to(&mut self, tx_node: TxNode, until: Instant) -> bool {
        Self::index(tx_node).is_some_and(|at| self.0.occupy_up_to(at, until))
    }

    pub(super) fn release(&mut self, uid: NodeUid) -> bool {
        self.0.release(uid)
    }

    fn index(tx_node: TxNode) -> Option<usize> {
        TxNode::MAX.get().checked_sub(tx_node.get()).map(usize::from)
    }

    fn tx_node(at: usize) -> Option<TxNode> {
        TxNode::new(TxNode::MAX.get().checked_sub(u8::try_from(at).ok()?)?)
    }
}

impl<const N: usize> Default for Nodes<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Subjects and their etags: the `N` etags from 16383 down.
#[derive(Clone, Debug)]
pub struct Subjects<const N: usize>(Table<Subject, N>);

impl<const N: usize> Subjects<N> {
    /// An empty table.
    pub const fn new() -> Self {
        const {
            let all = (Etag::BOUND_LAST.get() - Etag::BOUND_FIRST.get()) as usize + 1;
            assert!(N >= 1 && N <= all, "there are 15360 etags to bind");
        }
        Self(Table::new())
    }

    /// Enters a pair, as when a stored table is restored. O(`N`).
    ///
    /// # Errors
    /// When another subject has the etag, or it is not one that this table covers.
    pub fn restore(&mut self, subject: Subject, etag: Etag) -> Result<(), Conflict<Subject>> {
        self.0.insert(subject, Self::index(etag))
    }

    /// All pairs, to be stored and restored. O(`N`).
    pub fn entries(&self) -> impl Iterator<Item = (Subject, Etag)> + '_ {
        self.0.entries().filter_map(|(subject, at)| Some((subject, Self::etag(at)?)))
    }

    /// Whose etag this is.
    pub fn subject_of(&self, etag: Etag) -> Option<Subject> {
        self.0.name(Self::index(etag))
    }

    /// The etag of a subject. O(`N`).
    pub fn etag_of(&self, subject: Subject) -> Option<Etag> {
        Self::etag(self.0.index_of(subject)?)
    }

    /// How many etags are left, without those of which only the use was seen. O(`N`).
    pub fn free(&self) -> usize {
        self.0.free()
    }

    /// Of how many etags only the use was seen. O(`N`).
    pub fn unnamed(&self) -> usize {
        self.0.unnamed()
    }

    /// The pair that comes after `before` in the table, or the first one behind the last. O(`N`).
    #[expect(clippy::arithmetic_side_effects, reason = "a position is below 2^14")]
    pub(super) fn after(&self, before: Option<Etag>) -> Option<(Subject, Etag)> {
        let from = before.map_or(0, |etag| Self::index(etag) + 1);
        let (at, subject) = (from..N).chain(0..from.min(N)).find_map(|at| Some((at, self.0.name(at)?)))?;
        Some((subject, Self::etag(at)?))
    }

    /// The etag of a subject, which it gets now if it has none; `None` if none is left. O(`N`).
    pub(super) fn bind(&mut self, subject: Subject, now: Instant, named: Duration) -> Option<Etag> {
        Self::etag(self.0.assign(subject, now, named)?)
    }

    /// The active broker said so: whoever had that etag before. O(`N`).
    pub(super) fn mirror(&mut self, subject: Subject, etag: Etag) {
        let at = Self::index(etag);
        if at < N {
            self.0.overwrite(subject, at);
        }
    }

    /// Somebody uses this etag; it is not handed out before `until`. Returns whether it was free. Constant
    /// time.
    pub(super) fn occupy(&mut self, etag: Etag, until: Instant) -> bool {
        self.0.occupy(Self::index(etag), until)
    }

    /// A broker that hands etags out from the top has come down to this one. O(`N`).
    pub(super) fn occupy_down_to(&mut self, etag: Etag, until: Instant) -> bool {
        self.0.occupy_up_to(Self::index(etag), until)
    }

    pub(super) fn release(&mut self, subject: Subject) -> bool {
        self.0.release(subject)
    }

    #[expect(clippy::arithmetic_side_effects, reason = "a bound etag is at most the last one")]
    fn index(etag: Etag) -> usize {
        usize::from(Etag::BOUND_LAST.get() - etag.get())
    }

    fn etag(at: usize) -> Option<Etag> {
        Etag::new(Etag::BOUND_LAST.get().checked_sub(u16::try_from(at).ok()?)?)
    }
}

impl<const N: usize> Default for Subjects<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    const NAMED: Duration = Duration::from_secs(3600);

    const NOW: Instant = Instant::EPOCH;
    const LATER: Instant = Instant::from_epoch(Duration::from_secs(1));

    const fn uid(uid: u64) -> NodeUid {
        NodeUid::new(uid).unwrap()
    }

    const fn subject(subject: u64) -> Subject {
        Subject::new(subject).unwrap()
    }

    #[test]
    fn a_uid_keeps_its_id() {
        let mut nodes = Nodes::<2>::new();
        assert_eq!(nodes.assign(uid(1), NOW, NAMED), Some(TxNode::MAX));
        assert_eq!(nodes.assign(uid(2), NOW, NAMED), TxNode::new(0x7D));
        assert_eq!(nodes.assign(uid(1), NOW, NAMED), Some(TxNode::MAX));
        nodes.occupy(TxNode::MAX, LATER);
        nodes.occupy(TxNode::new(0x7D).unwrap(), LATER);
        assert_eq!(nodes.assign(uid(3), NOW, NAMED), None, "no id left");
        assert!(nodes.release(uid(1)));
        assert_eq!(nodes.assign(uid(3), NOW, NAMED), Some(TxNode::MAX));
    }

    #[test]
    fn an_id_that_nobody_has_come_to_use_is_given_away_last() {
        let mut nodes = Nodes::<2>::new();
        nodes.assign(uid(1), NOW, NAMED).unwrap();
        assert_eq!(nodes.assign(uid(2), NOW, NAMED), TxNode::new(0x7D));
        nodes.occupy(TxNode::new(0x7D).unwrap(), LATER);
        assert_eq!(nodes.assign(uid(3), NOW, NAMED), Some(TxNode::MAX));
        assert!(nodes.entries().eq([(uid(3), TxNode::MAX), (uid(2), TxNode::new(0x7D).unwrap())]));
    }

    #[test]
    fn ids_that_are_in_use_are_not_handed_out() {
        let mut nodes = Nodes::<3>::new();
        nodes.occupy(TxNode::MAX, LATER);
        nodes.occupy(TxNode::MIN, LATER); // outside the table: nothing to remember
        nodes.occupy(TxNode::BROKER, LATER);
        nodes.learn(uid(9), TxNode::new(0x7D).unwrap());
        assert_eq!(nodes.assign(uid(1), NOW, NAMED), TxNode::new(0x7C));
        assert_eq!(nodes.free(), 0);
        nodes.occupy(TxNode::new(0x7C).unwrap(), LATER);
        assert_eq!(nodes.assign(uid(2), NOW, NAMED), None);
        // Who it is becomes known.
        nodes.learn(uid(8), TxNode::MAX);
        assert_eq!(nodes.uid_of(TxNode::MAX), Some(uid(8)));
        // A node with an id in the table turns out to use a fixed one below it.
        nodes.learn(uid(8), TxNode::MIN);
        assert_eq!(nodes.free(), 1);
    }

    #[test]
    fn what_was_exported_is_restored() {
        let mut before = Subjects::<8>::new();
        for at in 1..=5 {
            before.bind(subject(at), NOW, NAMED).unwrap();
        }
        before.release(subject(2));
        let mut after = Subjects::<8>::new();
        for (subject, etag) in before.entries() {
            after.restore(subject, etag).unwrap();
        }
        assert!(before.entries().eq(after.entries()));
        assert_eq!(after.bind(subject(5), NOW, NAMED), Etag::new(0x3FFF - 4));
        assert_eq!(after.restore(subject(7), Etag::BOUND_LAST), Err(Conflict::Taken(subject(1))));
        assert_eq!(after.restore(subject(7), Etag::BOUND_FIRST), Err(Conflict::OutOfRange));
        assert_eq!(after.subject_of(Etag::BOUND_LAST), Some(subject(1)));
    }

    #[test]
    fn pairs_follow_each_other_in_a_circle() {
        let mut subjects = Subjects::<4>::new();
        assert_eq!(subjects.after(None), None);
        let [first, _, third] =
            [1, 2, 3].map(|of| (subject(of), subjects.bind(subject(of), NOW, NAMED).unwrap()));
        subjects.release(subject(2));
        assert_eq!(subjects.after(None), Some(first));
        assert_eq!(subjects.after(Some(first.1)), Some(third));
        assert_eq!(subjects.after(Some(third.1)), Some(first));
        // A place that is not in the table, as after a start from another one.
        assert_eq!(subjects.after(Some(Etag::BOUND_FIRST)), Some(first));
    }

    #[test]
    fn a_use_that_is_not_seen_again_is_forgotten_rather_than_a_name_refused() {
        let mut subjects = Subjects::<2>::new();
        let [top, below] = [0x3FFF, 0x3FFE].map(|etag| Etag::new(etag).unwrap());
        assert!(subjects.occupy(top, LATER) && subjects.occupy(below, NOW));
        assert!(!subjects.occupy(below, NOW), "it is no longer free");
        assert_eq!((subjects.free(), subjects.unnamed()), (0, 2));
        assert_eq!(subjects.bind(subject(1), NOW, NAMED), Some(below));
        assert_eq!(subjects.bind(subject(2), NOW, NAMED), None);
        assert_eq!(subjects.bind(subject(2), LATER, NAMED), Some(top));
        assert_eq!(subjects.bind(subject(3), LATER, NAMED), None, "those that have a name are kept");
    }

    #[test]
    fn a_name_that_nobody_was_seen_to_use_goes_before_another_is_refused() {
        let after = |seconds| Instant::from_epoch(Duration::from_secs(seconds));
        let mut subjects = Subjects::<2>::new();
        let [top, below] = [0x3FFF, 0x3FFE].map(|etag| Etag::new(etag).unwrap());
        assert_eq!([1, 2].map(|of| subjects.bind(subject(of), NOW, NAMED)), [Some(top), Some(below)]);
        subjects.occupy(top, after(100));
        assert_eq!(subjects.bind(subject(3), after(3599), NAMED), None);
        assert_eq!(subjects.bind(subject(3), after(3600), NAMED), Some(below));
        assert_eq!(subjects.bind(subject(4), after(3699), NAMED), None);
        assert_eq!(subjects.bind(subject(4), after(3700), NAMED), Some(top));
        // One that was restored from a table and is off has as long from the start on.
        let mut nodes = Nodes::<1>::new();
        nodes.restore(uid(1), TxNode::MAX).unwrap();
        assert_eq!(nodes.assign(uid(2), after(3599), NAMED), None);
        assert_eq!(nodes.assign(uid(2), after(3600), NAMED), Some(TxNode::MAX));
    }

    #[test]
    fn what_another_broker_has_handed_out_is_in_use() {
        let mut nodes = Nodes::<4>::new();
        nodes.assign(uid(1), NOW, NAMED).unwrap();
        assert!(nodes.occupy_down_to(TxNode::new(0x7C).unwrap(), LATER));
        assert!(!nodes.occupy_down_to(TxNode::BROKER, LATER));
        assert_eq!((nodes.uid_of(TxNode::MAX), nodes.unnamed()), (Some(uid(1)), 2));
        assert_eq!(nodes.assign(uid(2), NOW, NAMED), TxNode::new(0x7B));
        let mut nodes = Nodes::<4>::new();
        assert_eq!(nodes.assign_from_below(uid(1), NOW, NAMED), TxNode::new(0x7B));
        assert_eq!(nodes.assign_from_below(uid(2), NOW, NAMED), TxNode::new(0x7C));
    }
}
