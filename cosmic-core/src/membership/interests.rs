//! What the other nodes want and offer.

use crate::can::{Etag, Frame, TxNode};
use crate::protocol::{Class, Interest, LayoutHash, Side};
use crate::time::Instant;

/// The interest in one side of a channel has begun or ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum InterestEvent {
    /// The first node has joined this side of the channel.
    Begun {
        /// The channel.
        etag: Etag,
        /// The side.
        side: Side,
    },
    /// The last node has left this side of the channel, or its lease has ended.
    Ended {
        /// The channel.
        etag: Etag,
        /// The side.
        side: Side,
    },
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    interest: Interest,
    expires_at: Instant,
}

/// Up to `N` interests of other nodes; the contract is that of [`crate::membership`].
///
/// Every call takes O(`N`), but `poll` and `next_wakeup` O(1) while no lease has ended.
#[derive(Clone, Debug)]
pub struct Interests<const N: usize> {
    entries: [Option<Entry>; N],
    overflows: u16,
    /// No lease ends before this.
    first_expiry: Instant,
}

impl<const N: usize> Interests<N> {
    /// Nothing is known.
    pub const fn new() -> Self {
        Self { entries: [None; N], overflows: 0, first_expiry: Instant::FAR_FUTURE }
    }

    /// The nodes on `side` of the channel `etag`, with the class and the layout that each uses.
    pub fn nodes(&self, etag: Etag, side: Side) -> impl Iterator<Item = (TxNode, Class, LayoutHash)> + '_ {
        let of_side = move |interest: &&Interest| (interest.etag, interest.side) == (etag, side);
        let entries = self.entries.iter().flatten().map(|entry| &entry.interest);
        entries.filter(of_side).map(|interest| (interest.tx_node, interest.class, interest.layout))
    }

    /// Returns whether any node subscribes to the channel `etag`.
    pub fn is_wanted(&self, etag: Etag) -> bool {
        self.nodes(etag, Side::Subscriber).next().is_some()
    }

    /// Interests that were not kept because there was no room. While that grows, [`Interests::is_wanted`]
    /// may miss a subscriber.
    pub const fn overflows(&self) -> u16 {
        self.overflows
    }

    /// Takes a received frame.
    pub fn on_frame(&mut self, frame: &Frame, now: Instant) -> Option<InterestEvent> {
        let interest = Interest::decode(frame)?;
        let Interest { tx_node, etag, side, lease, .. } = interest;
        if lease.is_withdrawn() {
            let at = self.position(tx_node, etag, side)?;
            return self.remove(at);
        }
        let known = self.position(tx_node, etag, side);
        let Some(at) = known.or_else(|| self.entries.iter().position(Option::is_none)) else {
            self.overflows = self.overflows.saturating_add(1);
            return None;
        };
        let begins = known.is_none() && self.nodes(etag, side).next().is_none();
        let expires_at = now + lease.duration();
        *self.entries.get_mut(at)? = Some(Entry { interest, expires_at });
        self.first_expiry = self.first_expiry.min(expires_at);
        begins.then_some(InterestEvent::Begun { etag, side })
    }

    /// Another node has left: its leases end at the next `poll`.
    pub fn on_node_left(&mut self, now: Instant, tx_node: TxNode) {
        for entry in self.entries.iter_mut().flatten().filter(|entry| entry.interest.tx_node == tx_node) {
            entry.expires_at = now;
            self.first_expiry = self.first_expiry.min(now);
        }
    }

    /// Interest that has ended; call until it returns `None`.
    pub fn poll(&mut self, now: Instant) -> Option<InterestEvent> {
        // At most as many rounds as there are entries: each removes one.
        while now >= self.first_expiry {
            let expired = |place: &Option<Entry>| place.is_some_and(|entry| now >= entry.expires_at);
            let Some(at) = self.entries.iter().position(expired) else {
                let expiries = self.entries.iter().flatten().map(|entry| entry.expires_at);
                self.first_expiry = expiries.min().unwrap_or(Instant::FAR_FUTURE);
                break;
            };
            if let Some(event) = self.remove(at) {
                return Some(event);
            }
        }
        None
    }

    /// When `poll` must be called even if no frame arrives. A lease that was refreshed may have it called for
    /// nothing, once.
    pub const fn next_wakeup(&self) -> Instant {
        self.first_expiry
    }

    fn remove(&mut self, at: usize) -> Option<InterestEvent> {
        let Interest { etag, side, .. } = self.entries.get_mut(at)?.take()?.interest;
        self.nodes(etag, side).next().is_none().then_some(InterestEvent::Ended { etag, side })
    }

    fn position(&self, tx_node: TxNode, etag: Etag, side: Side) -> Option<usize> {
        let same = |known: &Interest| (known.tx_node, known.etag, known.side) == (tx_node, etag, side);
        self.entries.iter().position(|place| place.is_some_and(|entry| same(&entry.interest)))
    }
}

impl<const N: usize> Default for Interests<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Lease;
    use crate::time::Duration;

    const ETAG: Etag = Etag::BOUND_LAST;

    fn at(milliseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(milliseconds))
    }

    fn frame(node: u8, etag: Etag, lease: Option<u64>) -> Frame {
        let lease = lease.map_or(Lease::WITHDRAWN, |ms| Lease::new(Duration::from_millis(ms)).unwrap());
        let (tx_node, side) = (TxNode::new(node).unwrap(), Side::Subscriber);
        Interest { tx_node, etag, side, class: Class::Soft, layout: LayoutHash::UNSTATED, lease }.encode()
    }

    const BEGUN: Option<InterestEvent> = Some(InterestEvent::Begun { etag: ETAG, side: Side::Subscriber });
    const ENDED: Option<InterestEvent> = Some(InterestEvent::Ended { etag: ETAG, side: Side::Subscriber });

    #[test]
    fn interest_lives_as_long_as_its_last_lease() {
        let mut interests = Interests::<4>::new();
        assert_eq!(interests.on_frame(&frame(1, ETAG, Some(1000)), at(0)), BEGUN);
        assert_eq!(interests.on_frame(&frame(2, ETAG, Some(3000)), at(0)), None);
        assert_eq!(interests.next_wakeup(), at(1000));
        assert_eq!(interests.on_frame(&frame(1, ETAG, Some(1000)), at(900)), None, "refreshed");
        assert_eq!(interests.poll(at(1899)), None);
        assert_eq!(interests.nodes(ETAG, Side::Subscriber).count(), 2);
        assert_eq!(interests.poll(at(1900)), None, "one is left");
        assert_eq!(interests.nodes(ETAG, Side::Subscriber).count(), 1);
        assert_eq!(interests.poll(at(3000)), ENDED);
        assert_eq!(interests.poll(at(3000)), None);
        assert!(!interests.is_wanted(ETAG));
        assert_eq!(interests.next_wakeup(), Instant::FAR_FUTURE);
    }

    #[test]
    fn interest_ends_when_it_is_withdrawn_or_its_node_leaves() {
        let mut interests = Interests::<4>::new();
        let _ = interests.on_frame(&frame(1, ETAG, Some(1000)), at(0));
        assert_eq!(interests.on_frame(&frame(1, ETAG, None), at(1)), ENDED);
        assert_eq!(interests.on_frame(&frame(1, ETAG, None), at(2)), None, "nothing to withdraw");
        let _ = interests.on_frame(&frame(1, ETAG, Some(1000)), at(3));
        interests.on_node_left(at(4), TxNode::new(1).unwrap());
        assert_eq!(interests.poll(at(4)), ENDED);
    }

    #[test]
    fn what_does_not_fit_is_counted() {
        let mut interests = Interests::<1>::new();
        assert_eq!(interests.on_frame(&frame(1, ETAG, Some(1000)), at(0)), BEGUN);
        assert_eq!(interests.on_frame(&frame(2, ETAG, Some(1000)), at(0)), None);
        assert_eq!(interests.overflows(), 1);
    }
}
