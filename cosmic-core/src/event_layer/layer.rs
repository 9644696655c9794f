//! The event channel handler (ECH): which channels a node announces and subscribes to, and what they are called.

use super::channel::{
    Channel, ChannelCounters, Entry, NONE, Outlet, Policy, Publication, Route, Subscriber, Subscription,
};
use super::content::Content;
use super::declared::{Declared, Listed};
use super::error::{AnnounceError, SubscribeError};
use super::filter::Filter;
use super::gate::Gate;
use super::pool::Pool;
use super::rate::Guard;
use crate::can::{Etag, TxNode, TxNodes};
use crate::network::hard::BufferId;
use crate::network::id_map::IdMap;
use crate::network::soft::{PriorityMap, Tag};
use crate::time::Instant;
use crate::uid::Subject;
use core::task::Waker;

/// The channels, subscriptions and waiting events of a node: room for `CHANNELS` (a power of two),
/// `SUBSCRIPTIONS`, and `EVENTS` in all queues together.
#[derive(Debug)]
// In this order, what every frame needs is near the start, where an instruction reaches it without a
// second one for its address.
#[repr(C)]
pub struct EventLayer<const CHANNELS: usize, const SUBSCRIPTIONS: usize, const EVENTS: usize, D = Declared> {
    tx_node: Option<TxNode>,
    pub(super) map: PriorityMap,
    pub(super) by_etag: IdMap<{ Route::BITS }, CHANNELS>,
    pub(super) pool: Pool<EVENTS>,
    pub(super) subscribers: [Subscriber; SUBSCRIPTIONS],
    pub(super) channels: [Option<Entry<D>>; CHANNELS],
    /// No event is overdue before this instant.
    pub(super) first_overdue: Instant,
    /// Other etags may concern somebody here since this was asked last, or the node has another TxNode.
    renamed: bool,
}

impl<const CHANNELS: usize, const SUBSCRIPTIONS: usize, const EVENTS: usize, D: Listed>
    EventLayer<CHANNELS, SUBSCRIPTIONS, EVENTS, D>
{
    /// A layer without channels. A node that is configured at run time has no TxNode yet.
    pub const fn new(tx_node: Option<TxNode>, map: PriorityMap) -> Self {
        const {
            assert!(CHANNELS <= 128, "at most 128 channels a node");
            assert!(SUBSCRIPTIONS < NONE as usize, "at most 254 subscriptions a node");
        }
        Self {
            tx_node,
            map,
            channels: [const { None }; CHANNELS],
            by_etag: IdMap::new(),
            subscribers: [Subscriber::VACANT; SUBSCRIPTIONS],
            pool: Pool::new(),
            first_overdue: Instant::FAR_FUTURE,
            renamed: true,
        }
    }

    /// The node has been given its TxNode, or lost it.
    pub fn set_tx_node(&mut self, tx_node: Option<TxNode>) {
        self.tx_node = tx_node;
        for at in 0..CHANNELS {
            self.update(at as u8);
        }
    }

    /// Announces a channel: from now on this node may publish on it. Several announcements of a channel
    /// are counted. O(CHANNELS).
    pub(crate) fn announce<'c, C: Content>(
        &mut self,
        channel: &'c Channel<C>,
    ) -> Result<Publication<C>, AnnounceError>
    where
        D: From<&'c Declared>,
    {
        let at = self.enter(&channel.declared)?;
        if let Some(entry) = self.entry_mut(at) {
            entry.announcements = entry.announcements.saturating_add(1);
        }
        self.update(at);
        Ok(Publication::new(at))
    }

    /// Whose events of a channel are taken, if the plan of the cluster is sealed. O(CHANNELS).
    pub(crate) fn set_publishers(&mut self, subject: Subject, publishers: Option<&'static TxNodes>) {
        let Some(at) = self.find(subject) else { return };
        if let Some(entry) = self.entry_mut(at as u8) {
            entry.publishers = publishers;
        }
        self.update(at as u8);
    }

    /// The HRT message buffer through which a hard real-time channel is published.
    pub(crate) fn set_buffer<C>(&mut self, publication: &Publication<C>, buffer: Option<BufferId>) {
        if let Some(entry) = self.entry_mut(publication.channel) {
            entry.buffer = buffer;
        }
    }

    /// The HRT message buffer through which a channel is published, if it is hard real-time.
    pub(crate) fn buffer_of(&self, tag: Tag) -> Option<BufferId> {
        self.channels.get(usize::from(tag.0))?.as_ref()?.buffer
    }

    /// A hard real-time channel is not published by this node any more.
    pub(crate) fn forget_buffer(&mut self, tag: Tag) {
        if let Some(entry) = self.entry_mut(tag.0) {
            entry.buffer = None;
        }
    }

    /// Subscribes to a channel. O(CHANNELS + SUBSCRIPTIONS).
    #[allow(clippy::indexing_slicing, reason = "the place was found by its number")]
    pub(crate) fn subscribe<'c, C: Content>(
        &mut self,
        channel: &'c Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Result<Subscription<C>, SubscribeError>
    where
        D: From<&'c Declared>,
    {
        if !D::CONTEXTS && filter != Filter::ALL {
            return Err(SubscribeError::Channel(AnnounceError::NoContexts));
        }
        let index = (self.subscribers.iter().position(Subscriber::is_vacant))
            .ok_or(SubscribeError::TooManySubscriptions)?;
        let at = self.enter(&channel.declared).map_err(SubscribeError::Channel)?;
        let Some(entry) = self.entry_mut(at) else {
            return Err(SubscribeError::Channel(AnnounceError::TooManyChannels));
        };
        let next = entry.first_subscription;
        entry.first_subscription = index as u8;
        entry.subscriptions = entry.subscriptions.saturating_add(1);
        self.subscribers[index] = Subscriber::new(at, next, filter, policy);
        self.update(at);
        Ok(Subscription::new(index as u8, channel.declared.context))
    }

    /// Gives up an announcement. Says whether it was the last one of its channel, and with which buffer.
    pub(crate) fn cancel_publication<C>(&mut self, publication: &Publication<C>) -> Option<Option<BufferId>> {
        let entry = self.entry_mut(publication.channel)?;
        entry.announcements = entry.announcements.checked_sub(1)?;
        if entry.announcements > 0 {
            return None;
        }
        let buffer = entry.buffer.take();
        self.update(publication.channel);
        self.forget_unused(publication.channel);
        Some(buffer)
    }

    /// Gives up a subscription, with the events that wait for it. Says which channel has lost its last
    /// subscriber here. O(SUBSCRIPTIONS + EVENTS).
    pub(crate) fn cancel_subscription<C>(&mut self, subscription: Subscription<C>) -> Option<D> {
        let index = subscription.index;
        let place = self.subscribers.get_mut(usize::from(index)).filter(|place| !place.is_vacant())?;
        let mut gone = core::mem::replace(place, Subscriber::VACANT);
        gone.list.clear(&mut self.pool);
        let entry = self.channels.get_mut(usize::from(gone.channel))?.as_mut()?;
        if entry.first_subscription == index {
            entry.first_subscription = gone.next;
        } else {
            let is_before = |other: &&mut Subscriber| other.channel == gone.channel && other.next == index;
            if let Some(before) = self.subscribers.iter_mut().find(is_before) {
                before.next = gone.next;
            }
        }
        entry.subscriptions = entry.subscriptions.saturating_sub(1);
        if entry.subscriptions == 0 {
            entry.awaited_since = Instant::FAR_FUTURE;
        }
        entry.counters.delivered = entry.counters.delivered.wrapping_add(gone.delivered);
        let last = (entry.subscriptions == 0).then_some(entry.declared);
        self.update(gone.channel);
        self.forget_unused(gone.channel);
        last
    }

    /// Returns whether other etags may concern somebody here since the last call, or the node has another TxNode.
    pub(crate) fn take_renamed(&mut self) -> bool {
        core::mem::take(&mut self.renamed)
    }

    /// The etags whose frames somebody here subscribes to. Those of hard real-time channels are none: what they carry
    /// comes out of HRT message buffers.
    pub(crate) fn etags(&self) -> impl Iterator<Item = Etag> {
        let subscribed = self.channels.iter().flatten().filter(|entry| entry.first_subscription != NONE);
        subscribed.filter_map(|entry| entry.etag).filter(|etag| !etag.is_hard())
    }

    /// Where events with this etag go, if that is anywhere here. One map look-up.
    #[inline]
    pub(crate) fn route_of(&self, etag: Etag) -> Option<Route> {
        self.by_etag.get(key(etag)).map(Route::decode)
    }

    /// Returns whether anybody subscribes to the channel here.
    #[inline]
    pub(crate) fn is_subscribed(&self, tag: Tag) -> bool {
        let entry = self.channels.get(usize::from(tag.0));
        matches!(entry, Some(Some(entry)) if entry.first_subscription != NONE)
    }

    /// Has the waker woken by the next event of the subscription.
    pub(crate) fn set_waker<C>(&mut self, subscription: &Subscription<C>, waker: &Waker) {
        if let Some(subscriber) = self.subscribers.get_mut(usize::from(subscription.index)) {
            subscriber.waker = Some(waker.clone());
        }
    }

    /// What happened on a channel.
    pub fn counters(&self, subject: Subject) -> Option<ChannelCounters> {
        let at = self.find(subject)?;
        let counters = self.channels.get(at)?.as_ref()?.counters;
        let subscribers = self.subscribers.iter().filter(|subscriber| usize::from(subscriber.channel) == at);
        let delivered = subscribers.fold(counters.delivered, |sum, one| sum.wrapping_add(one.delivered));
        Some(ChannelCounters { delivered, ..counters })
    }

    /// The broker has bound the subject. O(CHANNELS).
    pub(crate) fn bind(&mut self, subject: Subject, etag: Etag) -> Result<(), AnnounceError> {
        let Some(at) = self.find(subject) else { return Ok(()) };
        self.name(at as u8, etag)
    }

    /// The subject has no etag any more: nothing is published or received on its channel. O(CHANNELS).
    pub(crate) fn unbind(&mut self, subject: Subject) {
        let Some(at) = self.find(subject) else { return };
        let former = self.entry_mut(at as u8).and_then(|entry| {
            entry.awaited_since = Instant::FAR_FUTURE;
            entry.etag.take()
        });
        if let Some(former) = former {
            self.by_etag.remove(key(former));
        }
        self.update(at as u8);
    }

    /// An event of the channel has left the node.
    pub(crate) fn note_departure(&mut self, tag: Tag, sent: bool) {
        if let Some(entry) = self.entry_mut(tag.0) {
            let counters = &mut entry.counters;
            let count = if sent { &mut counters.sent } else { &mut counters.discarded };
            *count = count.wrapping_add(1);
        }
    }

    /// An event was not taken. `was_counted`: as published, before there turned out to be no room for it.
    pub(crate) fn note_refusal(&mut self, tag: Tag, was_counted: bool) {
        if let Some(entry) = self.entry_mut(tag.0) {
            let counters = &mut entry.counters;
            counters.refused = counters.refused.wrapping_add(1);
            counters.published = counters.published.wrapping_sub(was_counted.into());
            entry.refund();
        }
    }

    /// What happened on a channel, by its number.
    pub(crate) fn counters_of(&self, tag: Tag) -> ChannelCounters {
        let entry = self.channels.get(usize::from(tag.0)).and_then(Option::as_ref);
        entry.map_or(ChannelCounters::default(), |entry| entry.counters)
    }

    /// The etag of a subscription's channel, if it is known.
    pub(crate) fn etag_of<C>(&self, subscription: &Subscription<C>) -> Option<Etag> {
        let subscriber = self.subscribers.get(usize::from(subscription.index))?;
        self.channels.get(usize::from(subscriber.channel))?.as_ref()?.etag
    }

    /// Returns whether this node publishes on the channel, and whether it subscribes to it. O(CHANNELS).
    pub(crate) fn roles(&self, subject: Subject) -> (bool, bool) {
        let entry = self.find(subject).and_then(|at| self.channels.get(at)?.as_ref());
        entry.map_or((false, false), |entry| (entry.announcements > 0, entry.subscriptions > 0))
    }

    /// A channel as it was declared, by its number.
    pub(crate) fn declared(&self, tag: Tag) -> Option<&D> {
        Some(&self.channels.get(usize::from(tag.0))?.as_ref()?.declared)
    }

    /// The subject of a channel by its number.
    pub(crate) fn subject(&self, tag: Tag) -> Option<Subject> {
        Some(self.declared(tag)?.borrow().subject)
    }

    /// The channel that has this etag here.
    pub(crate) fn subject_of(&self, etag: Etag) -> Option<Subject> {
        self.subject(self.route_of(etag)?.tag)
    }

    /// Marks an event whose content is no value of the channel's type.
    pub(crate) fn note_malformed<C>(&mut self, subscription: &Subscription<C>) -> Option<Subject> {
        let at = self.subscribers.get(usize::from(subscription.index))?.channel;
        let entry = self.entry_mut(at)?;
        entry.counters.malformed = entry.counters.malformed.wrapping_add(1);
        Some(entry.declared().subject)
    }

    /// The number of a subject's channel, if this node has it. O(CHANNELS).
    pub(crate) fn tag_of(&self, subject: Subject) -> Option<Tag> {
        self.find(subject).map(|at| Tag(at as u8))
    }

    fn find(&self, subject: Subject) -> Option<usize> {
        let is_it =
            |place: &Option<Entry<D>>| place.as_ref().is_some_and(|e| e.declared().subject == subject);
        self.channels.iter().position(is_it)
    }

    pub(super) fn entry_mut(&mut self, at: u8) -> Option<&mut Entry<D>> {
        self.channels.get_mut(usize::from(at))?.as_mut()
    }

    /// The entry of a channel, made if there is none.
    #[allow(clippy::indexing_slicing, reason = "the place was found or is free, by its number")]
    fn enter<'c>(&mut self, declared: &'c Declared) -> Result<u8, AnnounceError>
    where
        D: From<&'c Declared>,
    {
        if declared.subject == Subject::RESERVED {
            return Err(AnnounceError::ReservedSubject);
        }
        if declared.context && !D::CONTEXTS {
            return Err(AnnounceError::NoContexts);
        }
        let found = self.find(declared.subject);
        let former = found.and_then(|at| self.channels[at].as_ref());
        if let (Some(at), Some(entry)) = (found, former)
            && entry.is_used()
        {
            return if entry.declared() == declared {
                Ok(at as u8)
            } else {
                Err(AnnounceError::Contradiction)
            };
        }
        let guard = former.map_or(Guard::NEW, |entry| entry.guard);
        let vacant = |entry: &Option<Entry<D>>| entry.is_none();
        let unused = |entry: &Option<Entry<D>>| entry.as_ref().is_some_and(|entry| !entry.is_used());
        let at = found
            .or_else(|| self.channels.iter().position(vacant))
            .or_else(|| self.channels.iter().position(unused))
            .ok_or(AnnounceError::TooManyChannels)?;
        if let Some(etag) = declared.etag
            && self.route_of(etag).is_some()
        {
            return Err(AnnounceError::EtagInUse);
        }
        let before = self.channels[at].take();
        self.channels[at] = Some(Entry::new(declared.into(), guard));
        if let Some(etag) = declared.etag
            && let Err(error) = self.name(at as u8, etag)
        {
            self.channels[at] = before;
            return Err(error);
        }
        Ok(at as u8)
    }

    fn name(&mut self, at: u8, etag: Etag) -> Result<(), AnnounceError> {
        if self.route_of(etag).is_some_and(|route| route.tag != Tag(at)) {
            return Err(AnnounceError::EtagInUse);
        }
        let former = self.entry_mut(at).and_then(|entry| entry.etag);
        if let Some(former) = former {
            self.by_etag.remove(key(former));
        }
        let route = Route { tag: Tag(at), only: NONE, is_awaited: false };
        self.by_etag.insert(key(etag), route.encode()).map_err(|_| AnnounceError::TooManyChannels)?;
        if let Some(entry) = self.entry_mut(at) {
            entry.etag = Some(etag);
        }
        self.update(at);
        Ok(())
    }

    /// Something has changed that decides where frames of a channel go, or what they are called.
    pub(super) fn update(&mut self, at: u8) {
        self.renamed = true;
        let Some(Some(entry)) = self.channels.get_mut(usize::from(at)) else { return };
        let outlet = match (self.tx_node, entry.etag) {
            (Some(tx_node), Some(etag)) if entry.announcements > 0 && entry.gate != Gate::Closed => {
                Outlet::new(tx_node, etag)
            }
            _ => Outlet::CLOSED,
        };
        let guarded = entry.rate().is_some() || entry.gate == Gate::NonRealTime;
        entry.outlet = if guarded { Outlet::CLOSED } else { outlet };
        entry.guarded_outlet = if guarded { outlet } else { Outlet::CLOSED };
        let plain = entry.subscriptions == 1 && !entry.has_context() && entry.publishers.is_none();
        let only = if plain { entry.first_subscription } else { NONE };
        if let Some(etag) = entry.etag {
            // It is there already, so there is a place.
            let route = Route { tag: Tag(at), only, is_awaited: entry.is_awaited() };
            let _ = self.by_etag.insert(key(etag), route.encode());
        }
    }

    /// The channel is free if nothing holds it any more. One whose events were charged stays, without its etag, until
    /// its place is needed: announced again, it has no fresh bucket.
    fn forget_unused(&mut self, at: u8) {
        let Some(place) = self.channels.get_mut(usize::from(at)) else { return };
        let Some(entry) = place.as_mut().filter(|entry| !entry.is_used()) else { return };
        let etag = entry.etag.take();
        if !entry.guard.is_in_use() {
            *place = None;
        }
        if let Some(etag) = etag {
            self.by_etag.remove(key(etag));
        }
    }
}

/// Under which key the channel with this etag stands. That of a hard real-time one is no etag, so that a frame
/// off the bus does not find it, at no cost for the others.
#[inline]
const fn key(etag: Etag) -> u32 {
    if etag.is_hard() { key_of_hard(etag) } else { etag.get() as u32 }
}

/// As [`key`], for an etag of the calendar.
#[inline]
pub(super) const fn key_of_hard(etag: Etag) -> u32 {
    etag.get() as u32 | 1 << 14
}
