//! What this node wants and offers.

use crate::can::{Etag, Frame, TxNode};
use crate::protocol::{Class, Interest, LayoutHash, Lease, Probe, Side};
use crate::time::{Duration, Instant};

/// Another node uses a channel with another layout of its content: the two would misread each other.
///
/// The other node hears of it too, from our interest.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LayoutMismatch {
    /// The channel.
    pub etag: Etag,
    /// Our side of it.
    pub side: Side,
    /// Our layout.
    pub ours: LayoutHash,
    /// The other node.
    pub tx_node: TxNode,
    /// Its layout.
    pub theirs: LayoutHash,
}

/// There is no room for another declaration.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DeclarationsFull;

#[derive(Clone, Copy, Debug)]
struct Entry {
    etag: Etag,
    side: Side,
    class: Class,
    layout: LayoutHash,
    send_at: Instant,
    withdrawn: bool,
    /// The node whose other layout we told of last.
    told_of: Option<TxNode>,
}

/// The interest of this node in up to `N` channels; the contract is that of [`crate::membership`].
///
/// Every call takes O(`N`).
#[derive(Clone, Debug)]
pub struct Declarations<const N: usize> {
    entries: [Option<Entry>; N],
    lease: Lease,
    tx_node: Option<TxNode>,
    /// When the last probe is, or was, answered.
    answer_at: Option<Instant>,
}

impl<const N: usize> Declarations<N> {
    /// Nothing is declared; each declaration will hold for `lease` and be refreshed three times in it.
    pub const fn new(lease: Lease) -> Self {
        Self { entries: [None; N], lease, tx_node: None, answer_at: None }
    }

    /// The node has this TxNode from now on, or none and is silent.
    pub fn set_tx_node(&mut self, now: Instant, tx_node: Option<TxNode>) {
        if self.tx_node != tx_node {
            self.tx_node = tx_node;
            self.send_all(now);
        }
    }

    /// This node is on `side` of a channel from now on; also to change the class or layout of it.
    ///
    /// # Errors
    /// When `N` other declarations are in use.
    pub fn declare(
        &mut self,
        now: Instant,
        etag: Etag,
        side: Side,
        class: Class,
        layout: LayoutHash,
    ) -> Result<(), DeclarationsFull> {
        let entry = Entry { etag, side, class, layout, send_at: now, withdrawn: false, told_of: None };
        let at = self.position(etag, side).or_else(|| self.entries.iter().position(Option::is_none));
        let place = at.and_then(|at| self.entries.get_mut(at)).ok_or(DeclarationsFull)?;
        *place = Some(entry);
        Ok(())
    }

    /// This node is no longer on `side` of a channel. Its place is free when the others were told.
    pub fn withdraw(&mut self, now: Instant, etag: Etag, side: Side) {
        let at = self.position(etag, side);
        if let Some(Some(entry)) = at.and_then(|at| self.entries.get_mut(at)) {
            (entry.withdrawn, entry.send_at) = (true, now);
        }
    }

    /// Takes a received frame. Returns what another node's interest contradicts, once for each node in
    /// turn.
    pub fn on_frame(&mut self, frame: &Frame, now: Instant) -> Option<LayoutMismatch> {
        match frame.id.etag() {
            Etag::INTEREST => self.on_interest(&Interest::decode(frame)?),
            Etag::PROBE => {
                Probe::decode(frame)?;
                self.answer(now);
                None
            }
            _ => None,
        }
    }

    /// The next frame to be sent, which is non real-time; call until it returns `None`.
    pub fn poll(&mut self, now: Instant) -> Option<Frame> {
        let tx_node = self.tx_node?;
        let due = |place: &&mut Option<Entry>| place.is_some_and(|entry| now >= entry.send_at);
        let place = self.entries.iter_mut().find(due)?;
        let entry = place.as_mut()?;
        let &mut Entry { etag, side, class, layout, withdrawn, .. } = entry;
        entry.send_at = now + refresh_period(self.lease);
        if withdrawn {
            *place = None;
        }
        let lease = if withdrawn { Lease::WITHDRAWN } else { self.lease };
        Some(Interest { tx_node, etag, side, class, layout, lease }.encode())
    }

    /// When `poll` must be called even if no frame arrives.
    pub fn next_wakeup(&self) -> Instant {
        if self.tx_node.is_none() {
            return Instant::FAR_FUTURE;
        }
        self.entries.iter().flatten().map(|entry| entry.send_at).fold(Instant::FAR_FUTURE, Instant::min)
    }

    fn on_interest(&mut self, interest: &Interest) -> Option<LayoutMismatch> {
        let &Interest { tx_node, etag, layout: theirs, lease, .. } = interest;
        let of_channel = |entry: &&mut Entry| entry.etag == etag && !entry.withdrawn;
        let mut told = None;
        for entry in self.entries.iter_mut().flatten().filter(of_channel) {
            let conflicts = !lease.is_withdrawn() && entry.layout.conflicts_with(theirs);
            if conflicts && entry.told_of != Some(tx_node) && told.is_none() {
                entry.told_of = Some(tx_node);
                told = Some(LayoutMismatch { etag, side: entry.side, ours: entry.layout, tx_node, theirs });
            } else if !conflicts && entry.told_of == Some(tx_node) {
                entry.told_of = None;
            }
        }
        told
    }

    fn send_all(&mut self, at: Instant) {
        for entry in self.entries.iter_mut().flatten() {
            entry.send_at = entry.send_at.min(at);
        }
    }

    /// Tells all interest, unless that was just done: then a little later.
    fn answer(&mut self, now: Instant) {
        if self.answer_at.is_none_or(|at| at < now) {
            let at = self.answer_at.map_or(now, |last| now.max(last + BETWEEN_ANSWERS));
            self.answer_at = Some(at);
            self.send_all(at);
        }
    }

    fn position(&self, etag: Etag, side: Side) -> Option<usize> {
        let same =
            |place: &Option<Entry>| place.is_some_and(|entry| (entry.etag, entry.side) == (etag, side));
        self.entries.iter().position(same)
    }
}

fn refresh_period(lease: Lease) -> Duration {
    Duration::from_ticks(lease.duration().as_ticks() / 3)
}

/// Between two answers to probes, at least.
const BETWEEN_ANSWERS: Duration = Duration::from_millis(200);

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const ME: TxNode = TxNode::new(1).unwrap();
    const OTHER: TxNode = TxNode::new(2).unwrap();
    const ETAG: Etag = Etag::BOUND_LAST;

    fn at(milliseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(milliseconds))
    }

    fn declared(layout: u32) -> Declarations<2> {
        let mut declarations = Declarations::new(Lease::new(Duration::from_secs(3)).unwrap());
        declarations.set_tx_node(at(0), Some(ME));
        let layout = LayoutHash::new(layout);
        declarations.declare(at(0), ETAG, Side::Subscriber, Class::Soft, layout).unwrap();
        declarations
    }

    fn sent(declarations: &mut Declarations<2>, now: Instant) -> Vec<Interest> {
        core::iter::from_fn(|| declarations.poll(now))
            .map(|frame| Interest::decode(&frame).unwrap())
            .collect()
    }

    fn theirs(layout: u32, lease: Lease) -> Frame {
        let layout = LayoutHash::new(layout);
        let side = Side::Publisher;
        Interest { tx_node: OTHER, etag: ETAG, side, class: Class::Soft, layout, lease }.encode()
    }

    #[test]
    fn interest_is_refreshed_at_a_third_of_its_lease_and_withdrawn_once() {
        let mut declarations = declared(7);
        assert_eq!(sent(&mut declarations, at(0)).len(), 1);
        assert_eq!(declarations.next_wakeup(), at(1000));
        assert_eq!(sent(&mut declarations, at(999)), []);
        assert_eq!(sent(&mut declarations, at(1000)).len(), 1);
        declarations.withdraw(at(1100), ETAG, Side::Subscriber);
        assert!(sent(&mut declarations, at(1100))[0].lease.is_withdrawn());
        assert_eq!(declarations.next_wakeup(), Instant::FAR_FUTURE);
    }

    #[test]
    fn a_probe_is_answered_with_all_there_is() {
        let mut declarations = declared(7);
        declarations.declare(at(0), ETAG, Side::Publisher, Class::Soft, LayoutHash::UNSTATED).unwrap();
        let third =
            declarations.declare(at(0), Etag::BOUND_FIRST, Side::Publisher, Class::Soft, LayoutHash::new(1));
        assert_eq!(third, Err(DeclarationsFull));
        assert_eq!(sent(&mut declarations, at(0)).len(), 2);
        assert_eq!(declarations.on_frame(&Probe { tx_node: OTHER }.encode(), at(10)), None);
        assert_eq!(sent(&mut declarations, at(10)).len(), 2);
    }

    #[test]
    fn a_flood_of_probes_is_answered_five_times_a_second() {
        let mut declarations = declared(7);
        let mut answers = 0;
        for now in 0..2000 {
            let _ = declarations.on_frame(&Probe { tx_node: OTHER }.encode(), at(now));
            answers += sent(&mut declarations, at(now)).len();
        }
        assert_eq!(answers, 10);
        // The last of them is not forgotten.
        assert_eq!((declarations.next_wakeup(), sent(&mut declarations, at(2000)).len()), (at(2000), 1));
    }

    #[test]
    fn another_layout_is_told_once() {
        let mut declarations = declared(7);
        let mismatch = declarations.on_frame(&theirs(8, Lease::MIN), at(0)).unwrap();
        assert_eq!((mismatch.tx_node, mismatch.theirs), (OTHER, LayoutHash::new(8)));
        assert_eq!(declarations.on_frame(&theirs(8, Lease::MIN), at(1)), None);
        // It was mended, and then broken again.
        assert_eq!(declarations.on_frame(&theirs(7, Lease::MIN), at(2)), None);
        assert!(declarations.on_frame(&theirs(8, Lease::MIN), at(3)).is_some());
        assert_eq!(declarations.on_frame(&theirs(9, Lease::WITHDRAWN), at(4)), None);
    }

    #[test]
    fn two_nodes_with_different_layouts_are_both_told() {
        let (mut one, mut other) = (declared(7), declared(8));
        other.set_tx_node(at(0), Some(OTHER));
        let (to_other, to_one) = (one.poll(at(0)).unwrap(), other.poll(at(0)).unwrap());
        let mismatches = [one.on_frame(&to_one, at(1)), other.on_frame(&to_other, at(1))];
        assert_eq!(mismatches.map(|mismatch| mismatch.map(|of| of.tx_node)), [Some(OTHER), Some(ME)]);
    }

    #[test]
    fn without_an_id_a_node_is_silent() {
        let mut declarations = declared(7);
        declarations.set_tx_node(at(0), None);
        assert_eq!(sent(&mut declarations, at(5000)), []);
        assert_eq!(declarations.next_wakeup(), Instant::FAR_FUTURE);
        declarations.set_tx_node(at(6000), Some(OTHER));
        assert_eq!(sent(&mut declarations, at(6000))[0].tx_node, OTHER);
    }
}
