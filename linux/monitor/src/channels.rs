//! The channels of the segment: who publishes, who subscribes, what was sent last.

use std::collections::{BTreeMap, HashMap};

use cosmic_core::Subject;
use cosmic_core::can::{Etag, Frame, Payload, TxNode};
use cosmic_core::protocol::{Class, Interest, LayoutHash, Side};
use cosmic_core::time::{Duration, Instant};

use crate::latency::Latency;
use crate::load::Rate;
use crate::messages::Whole;

/// Channels that are kept.
pub const MOST_CHANNELS: usize = 4096;
/// Entries of publishers and subscribers that are kept, of all channels together.
pub const MOST_PARTICIPANTS: usize = 16_384;

/// All channels that were heard of.
#[derive(Clone, Debug)]
pub(crate) struct Channels {
    channels: BTreeMap<Etag, ChannelSeen>,
    etags: HashMap<Subject, Etag>,
    participants: usize,
    overlooked: u64,
}

/// A channel.
#[derive(Clone, Debug)]
pub(crate) struct ChannelSeen {
    pub(crate) subject: Option<Subject>,
    /// As somebody who announces or subscribes says.
    pub(crate) class: Option<Class>,
    pub(crate) publishers: Vec<PublisherSeen>,
    pub(crate) subscribers: Vec<SubscriberSeen>,
    pub(crate) rate: Rate,
    pub(crate) frames: u64,
    pub(crate) last: Option<Last>,
    /// The last message, if this is a channel of messages.
    pub(crate) message: Option<Whole>,
    pub(crate) latency: Latency,
    used_at: Instant,
}

/// The last frame of a channel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Last {
    pub(crate) tx_node: TxNode,
    pub(crate) payload: Payload,
    pub(crate) at: Instant,
}

/// A publisher.
#[derive(Clone, Debug)]
pub(crate) struct PublisherSeen {
    pub(crate) tx_node: TxNode,
    pub(crate) announced_until: Option<Instant>,
    layout: LayoutHash,
    pub(crate) frames: u64,
    pub(crate) rate: Rate,
    pub(crate) last_at: Option<Instant>,
    pub(crate) mean: Option<Duration>,
    pub(crate) shortest: Option<Duration>,
    pub(crate) longest: Option<Duration>,
}

/// A subscriber.
#[derive(Clone, Debug)]
pub(crate) struct SubscriberSeen {
    pub(crate) tx_node: TxNode,
    pub(crate) until: Instant,
    layout: LayoutHash,
}

impl Channels {
    pub(crate) fn new() -> Self {
        Self { channels: BTreeMap::new(), etags: HashMap::new(), participants: 0, overlooked: 0 }
    }

    pub(crate) fn get(&self, etag: Etag) -> Option<&ChannelSeen> {
        self.channels.get(&etag)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (Etag, &ChannelSeen)> {
        self.channels.iter().map(|(etag, channel)| (*etag, channel))
    }

    pub(crate) fn etag_of(&self, subject: Subject) -> Option<Etag> {
        self.etags.get(&subject).copied()
    }

    pub(crate) fn overlooked(&self) -> u64 {
        self.overlooked
    }

    /// The channel, if there is a place for it. Logarithmic in the number of channels.
    pub(crate) fn of(&mut self, etag: Etag, at: Instant) -> Option<&mut ChannelSeen> {
        if self.channels.len() >= MOST_CHANNELS && !self.channels.contains_key(&etag) {
            self.overlooked += 1;
            return None;
        }
        let channel = self.channels.entry(etag).or_insert_with(ChannelSeen::new);
        channel.used_at = at;
        Some(channel)
    }

    /// A message of the channel is complete.
    pub(crate) fn on_message(&mut self, whole: &Whole, at: Instant) {
        if let Some(channel) = self.of(whole.etag, at) {
            channel.message = Some(whole.clone());
        }
    }

    /// A frame of the channel was sent. Linear in its publishers, of which there are at most 128.
    pub(crate) fn on_event(&mut self, frame: &Frame, at: Instant) {
        let (etag, tx_node) = (frame.id.etag(), frame.id.tx_node());
        let room = self.participants < MOST_PARTICIPANTS;
        let Some(channel) = self.of(etag, at) else { return };
        channel.frames += 1;
        channel.rate.add(at);
        channel.last = Some(Last { tx_node, payload: frame.payload, at });
        match channel.publisher(tx_node, room) {
            Some((publisher, is_new)) => {
                publisher.sent(at);
                self.participants += usize::from(is_new);
            }
            None => self.overlooked += 1,
        }
    }

    /// A node wants or offers the channel; returns the nodes that lay out its content differently.
    pub(crate) fn on_interest(&mut self, interest: &Interest, at: Instant) -> Vec<TxNode> {
        let room = self.participants < MOST_PARTICIPANTS;
        let Some(channel) = self.of(interest.etag, at) else { return Vec::new() };
        channel.class = Some(interest.class);
        let until = at + interest.lease.duration();
        let grown = match (interest.side, interest.lease.is_withdrawn()) {
            (Side::Publisher, _) => channel.announce(interest, until, room),
            (Side::Subscriber, true) => channel.unsubscribe(interest.tx_node),
            (Side::Subscriber, false) => channel.subscribe(interest, until, room),
        };
        let conflicts = channel.conflicts(interest);
        match grown {
            Some(grown) => self.participants = self.participants.saturating_add_signed(grown),
            None => self.overlooked += 1,
        }
        conflicts
    }

    /// A subject has this etag; returns the etag that it had, if it was another.
    pub(crate) fn bind(&mut self, subject: Subject, etag: Etag, at: Instant) -> Option<Etag> {
        let channel = self.of(etag, at)?;
        let displaced = channel.subject.replace(subject).filter(|before| *before != subject);
        if let Some(displaced) = displaced {
            self.etags.remove(&displaced);
        }
        let before = self.etags.insert(subject, etag).filter(|before| *before != etag)?;
        if let Some(channel) = self.channels.get_mut(&before) {
            channel.subject = None;
        }
        Some(before)
    }

    /// Nodes that have left neither publish nor subscribe. Linear in what is known.
    pub(crate) fn forget_node(&mut self, tx_node: TxNode) {
        for channel in self.channels.values_mut() {
            let before = channel.participants();
            channel.publishers.retain(|publisher| publisher.tx_node != tx_node);
            channel.subscribers.retain(|subscriber| subscriber.tx_node != tx_node);
            self.participants -= before - channel.participants();
        }
    }

    /// Ends leases and forgets channels that nobody has used for a minute. Linear in what is known.
    pub(crate) fn advance(&mut self, now: Instant) {
        for channel in self.channels.values_mut() {
            let before = channel.participants();
            channel.subscribers.retain(|subscriber| subscriber.until > now);
            channel.publishers.retain_mut(|publisher| publisher.is_still_there(now));
            self.participants -= before - channel.participants();
        }
        let etags = &mut self.etags;
        self.channels.retain(|_, channel| {
            let used = channel.participants() > 0 || now.saturating_since(channel.used_at) <= UNUSED;
            if let Some(subject) = channel.subject.filter(|_| !used) {
                etags.remove(&subject);
            }
            used
        });
    }
}

impl ChannelSeen {
    fn new() -> Self {
        Self {
            subject: None,
            class: None,
            publishers: Vec::new(),
            subscribers: Vec::new(),
            rate: Rate::default(),
            frames: 0,
            last: None,
            message: None,
            latency: Latency::default(),
            used_at: Instant::EPOCH,
        }
    }

    fn participants(&self) -> usize {
        self.publishers.len() + self.subscribers.len()
    }

    /// The publisher, and whether it is new; `None` if it is and there is no room.
    fn publisher(&mut self, tx_node: TxNode, room: bool) -> Option<(&mut PublisherSeen, bool)> {
        let known = self.publishers.iter().position(|publisher| publisher.tx_node == tx_node);
        if known.is_none() && !room {
            return None;
        }
        let at = known.unwrap_or_else(|| {
            self.publishers.push(PublisherSeen::new(tx_node));
            self.publishers.len() - 1
        });
        Some((&mut self.publishers[at], known.is_none()))
    }

    /// By how many participants it has grown; `None` if there was no room.
    fn announce(&mut self, interest: &Interest, until: Instant, room: bool) -> Option<isize> {
        let withdrawn = interest.lease.is_withdrawn();
        if withdrawn && !self.publishers.iter().any(|publisher| publisher.tx_node == interest.tx_node) {
            return Some(0);
        }
        let (publisher, is_new) = self.publisher(interest.tx_node, room)?;
        publisher.announced_until = (!withdrawn).then_some(until);
        publisher.layout = interest.layout;
        Some(is_new.into())
    }

    fn subscribe(&mut self, interest: &Interest, until: Instant, room: bool) -> Option<isize> {
        let Interest { tx_node, layout, .. } = *interest;
        let seen = SubscriberSeen { tx_node, until, layout };
        if let Some(known) = self.subscribers.iter_mut().find(|known| known.tx_node == tx_node) {
            *known = seen;
            return Some(0);
        }
        room.then(|| self.subscribers.push(seen))?;
        Some(1)
    }

    fn unsubscribe(&mut self, tx_node: TxNode) -> Option<isize> {
        let before = self.subscribers.len();
        self.subscribers.retain(|subscriber| subscriber.tx_node != tx_node);
        Some(if self.subscribers.len() < before { -1 } else { 0 })
    }

    fn conflicts(&self, interest: &Interest) -> Vec<TxNode> {
        let layouts = self.publishers.iter().map(|publisher| (publisher.tx_node, publisher.layout));
        let layouts = layouts.chain(self.subscribers.iter().map(|seen| (seen.tx_node, seen.layout)));
        let differs = |(_, layout): &(TxNode, LayoutHash)| layout.conflicts_with(interest.layout);
        layouts.filter(differs).map(|(tx_node, _)| tx_node).collect()
    }
}

impl PublisherSeen {
    pub(crate) fn new(tx_node: TxNode) -> Self {
        Self {
            tx_node,
            announced_until: None,
            layout: LayoutHash::UNSTATED,
            frames: 0,
            rate: Rate::default(),
            last_at: None,
            mean: None,
            shortest: None,
            longest: None,
        }
    }

    fn sent(&mut self, at: Instant) {
        self.frames += 1;
        self.rate.add(at);
        let Some(before) = self.last_at.replace(at) else { return };
        let since = at.saturating_since(before);
        let mean = self.mean.map_or(since, |mean| {
            Duration::from_ticks(mean.as_ticks() - mean.as_ticks() / 8 + since.as_ticks() / 8)
        });
        self.mean = Some(mean);
        self.shortest = Some(self.shortest.map_or(since, |shortest| shortest.min(since)));
        self.longest = Some(self.longest.map_or(since, |longest| longest.max(since)));
    }

    /// An announcement holds for its lease; who has sent without one is kept for a while.
    fn is_still_there(&mut self, now: Instant) -> bool {
        self.announced_until = self.announced_until.filter(|until| *until > now);
        let sent = self.last_at.is_some_and(|at| now.saturating_since(at) <= UNUSED);
        self.announced_until.is_some() || sent
    }
}

/// Who and what nobody has heard of for so long is forgotten.
const UNUSED: Duration = Duration::from_secs(60);

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::{Id, Priority};
    use cosmic_core::protocol::Lease;

    fn at(ms: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(ms))
    }

    fn interest(node: u8, side: Side, lease_s: u64, layout: u32) -> Interest {
        let lease = Lease::new(Duration::from_secs(lease_s)).unwrap_or(Lease::WITHDRAWN);
        let (tx_node, etag) = (TxNode::new(node).unwrap(), Etag::BOUND_LAST);
        Interest { tx_node, etag, side, class: Class::Soft, layout: LayoutHash::new(layout), lease }
    }

    #[test]
    fn leases_end_by_themselves_and_by_withdrawal() {
        let mut channels = Channels::new();
        channels.on_interest(&interest(1, Side::Publisher, 10, 0), at(0));
        channels.on_interest(&interest(2, Side::Subscriber, 10, 0), at(0));
        channels.on_interest(&interest(3, Side::Subscriber, 100, 0), at(0));
        let counts = |channels: &Channels| {
            channels.get(Etag::BOUND_LAST).map(|seen| (seen.publishers.len(), seen.subscribers.len()))
        };
        assert_eq!(counts(&channels), Some((1, 2)));
        channels.advance(at(10_001));
        assert_eq!(counts(&channels), Some((0, 1)));
        channels.on_interest(&interest(3, Side::Subscriber, 0, 0), at(20_000));
        assert_eq!((counts(&channels), channels.participants), (Some((0, 0)), 0));
        channels.advance(at(90_000));
        assert_eq!(counts(&channels), None);
    }

    #[test]
    fn nodes_that_would_misread_each_other_are_named() {
        let mut channels = Channels::new();
        assert!(channels.on_interest(&interest(1, Side::Publisher, 10, 7), at(0)).is_empty());
        assert!(channels.on_interest(&interest(2, Side::Subscriber, 10, 7), at(0)).is_empty());
        let conflicts = channels.on_interest(&interest(3, Side::Subscriber, 10, 8), at(0));
        assert_eq!(conflicts.iter().map(|node| node.get()).collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn a_subject_has_one_etag() {
        let mut channels = Channels::new();
        let [one, other] = [1, 2].map(|subject| Subject::new(subject).unwrap());
        let next = Etag::new(Etag::BOUND_LAST.get() - 1).unwrap();
        assert_eq!(channels.bind(one, Etag::BOUND_LAST, at(0)), None);
        assert_eq!(channels.bind(one, Etag::BOUND_LAST, at(1)), None);
        assert_eq!(channels.bind(one, next, at(2)), Some(Etag::BOUND_LAST));
        assert_eq!(channels.bind(other, next, at(3)), None);
        assert_eq!((channels.etag_of(one), channels.etag_of(other)), (None, Some(next)));
    }

    #[test]
    fn a_flood_of_channels_and_publishers_stays_within_its_bounds() {
        let mut channels = Channels::new();
        for raw in 0..100_000_u32 {
            let etag = Etag::new((raw * 7 % 15_000 + 1_024) as u16).unwrap();
            let tx_node = TxNode::new((raw % 127) as u8).unwrap();
            channels.on_event(&Frame::new(Id::new(Priority::LEAST, tx_node, etag), Payload::EMPTY), at(0));
        }
        assert_eq!(channels.channels.len(), MOST_CHANNELS);
        let participants: usize = channels.channels.values().map(ChannelSeen::participants).sum();
        assert_eq!((channels.participants, participants <= MOST_PARTICIPANTS), (participants, true));
        assert!(channels.overlooked() > 0);
        channels.advance(at(100_000));
        assert_eq!((channels.channels.len(), channels.participants), (0, 0));
    }
}
