//! The life of each event: published, on the wire, visible to each subscriber, taken.
//!
//! All instants are true time. Contents are not understood: an event is known by the order of things. A node sends
//! the events of a channel in the order in which it published them (a hard real-time one: the newest), so a frame that
//! is put into a mailbox carries the first that is neither sent nor expired; the digest of its bytes must agree.
//! What becomes visible to a subscriber is what was last received.

use cosmic_bus::{Field, VirtualInstant};
use cosmic_core::can::{Etag, Payload, TxNode};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::Duration;

use crate::bus_log::{Attempt, Ending, Load};
use crate::cluster::{Channel, Promise};
use crate::journal::Journal;
use crate::record::{Digest, Queue, RecordKind};

/// The events of all channels and the exceptions of all nodes.
#[derive(Clone, Debug)]
pub struct Ledger {
    /// One for each channel of the cluster, in its order.
    pub channels: Vec<Account>,
    /// All exceptions, node by node.
    pub told: Vec<Told>,
    /// All subscriptions, node by node.
    pub subscriptions: Vec<Subscribed>,
    /// Records of nodes that were lost.
    pub lost_records: Vec<(TxNode, u64)>,
    /// Frames and records of events that nobody published.
    pub unknown_events: usize,
    /// Which event was in a frame that was put into a mailbox: account and event, by the load's index.
    carried: Vec<Option<(usize, usize)>>,
}

/// The events of a channel.
#[derive(Clone, Debug)]
pub struct Account {
    /// Which channel.
    pub channel: &'static Channel,
    /// Its events, in the order of publication.
    pub events: Vec<Life>,
}

/// The life of an event.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Life {
    /// When the application handed it to the middleware.
    pub published_at: VirtualInstant,
    /// Whether the middleware took it.
    pub taken: bool,
    /// When it should have been sent; soft real-time only.
    pub deadline: Option<VirtualInstant>,
    /// When it is of no use any more.
    pub expires_at: Option<VirtualInstant>,
    /// The end of the first transmission that was not destroyed.
    pub sent_at: Option<VirtualInstant>,
    /// The end of the first transmission that some receiver may have accepted.
    pub heard_at: Option<VirtualInstant>,
    /// What arrived at the subscribers.
    pub deliveries: Vec<Delivery>,
    /// Bytes of its content, and their digest.
    content: (u8, Digest),
    /// Whether an exception told of its refusal, if it was refused.
    queue_full: bool,
}

/// An event at a subscriber.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Delivery {
    /// Who.
    pub subscriber: TxNode,
    /// When it became visible.
    pub visible_at: VirtualInstant,
    /// When the application took it.
    pub taken_at: VirtualInstant,
}

/// An exception that an application was told of.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Told {
    /// At which node.
    pub node: TxNode,
    /// Of which channel; `None` if it concerns the node as a whole.
    pub etag: Option<Etag>,
    /// What.
    pub kind: ExceptionKind,
    /// When the node noticed.
    pub at: VirtualInstant,
}

/// A subscription of an application.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Subscribed {
    /// At which node.
    pub node: TxNode,
    /// To which channel: its number in the plan.
    pub channel: u16,
    /// Since when.
    pub from: VirtualInstant,
    /// Until when, if it was given up.
    pub until: Option<VirtualInstant>,
    /// How many events it keeps.
    pub queue: Queue,
    /// Whether its filter holds back some events.
    pub filtered: bool,
}

impl Ledger {
    /// Puts the records and the frames of a run together.
    pub fn of(journal: &Journal) -> Self {
        let channels = journal.cluster.channels.iter();
        let mut ledger = Self {
            channels: channels.map(|channel| Account { channel, events: Vec::new() }).collect(),
            told: Vec::new(),
            subscriptions: Vec::new(),
            lost_records: Vec::new(),
            unknown_events: 0,
            carried: Vec::new(),
        };
        ledger.open(journal);
        ledger.note_frames(journal);
        ledger.note_deliveries(journal);
        ledger
    }

    /// The account of a channel, as far as this node publishes on it.
    pub fn account(&self, etag: Etag, publisher: TxNode) -> Option<&Account> {
        self.channels.get(self.index(etag, publisher)?)
    }

    /// The number of the event, in its account, that was in a frame that was put into a mailbox.
    pub fn event_of(&self, load: usize) -> Option<usize> {
        self.carried.get(load).copied()?.map(|(_, event)| event)
    }

    /// The life of the event that was in a frame that was put into a mailbox.
    pub fn life(&self, load: usize) -> Option<&Life> {
        let (account, event) = self.carried.get(load).copied()??;
        self.channels.get(account)?.events.get(event)
    }

    /// How many exceptions of a kind a node was told of on a channel.
    pub fn count(&self, node: TxNode, etag: Etag, kind: ExceptionKind) -> usize {
        let same = |told: &&Told| (told.node, told.etag, told.kind) == (node, Some(etag), kind);
        self.told.iter().filter(same).count()
    }

    /// The subscription by which a node must get what is published on a channel at `at`, if it has any.
    pub fn subscription(&self, node: TxNode, channel: u16, at: VirtualInstant) -> Option<&Subscribed> {
        self.subscriptions.iter().find(|it| {
            (it.node, it.channel) == (node, channel)
                && !it.filtered
                && it.from < at
                && it.until.is_none_or(|until| until > at)
        })
    }

    /// When a node first subscribed to a channel, whatever it filters; `None` if it never did.
    pub fn subscribed_from(&self, node: TxNode, channel: u16) -> Option<VirtualInstant> {
        let of_both = self.subscriptions.iter().filter(|it| (it.node, it.channel) == (node, channel));
        of_both.map(|it| it.from).min()
    }

    fn index(&self, etag: Etag, publisher: TxNode) -> Option<usize> {
        let same = |account: &Account| (account.channel.etag, account.channel.publisher) == (etag, publisher);
        self.channels.iter().position(same)
    }

    fn open(&mut self, journal: &Journal) {
        for (node, record) in &journal.records {
            let Some(clock) = journal.clock(*node) else { continue };
            let (node, at) = (*node, clock.instant(record.at));
            let etag = record.channel.and_then(|number| journal.cluster.etag(number));
            let (content, taken, queue_full) = match record.kind {
                RecordKind::Published { len, digest } => ((len, digest), true, false),
                RecordKind::Refused { digest, queue_full } => ((0, digest), false, queue_full),
                RecordKind::Exception(kind) => {
                    self.told.push(Told { node, etag, kind, at });
                    continue;
                }
                RecordKind::Subscribed { queue, filtered } => {
                    let Some(channel) = record.channel else { continue };
                    let (from, until) = (at, None);
                    self.subscriptions.push(Subscribed { node, channel, from, until, queue, filtered });
                    continue;
                }
                RecordKind::Cancelled => {
                    let same = |it: &&mut Subscribed| (it.node, Some(it.channel)) == (node, record.channel);
                    let open = self.subscriptions.iter_mut().filter(same).find(|it| it.until.is_none());
                    open.into_iter().for_each(|it| it.until = Some(at));
                    continue;
                }
                RecordKind::Lost { count } => {
                    self.lost_records.push((node, count.into()));
                    continue;
                }
                RecordKind::Delivered { .. } => continue,
            };
            let Some(index) = etag.and_then(|etag| self.index(etag, node)) else {
                self.unknown_events += 1;
                continue;
            };
            let after = |span: Duration| Some(clock.instant(record.at + span));
            let (deadline, expires_at) = match self.channels[index].channel.class {
                Promise::Soft { deadline, validity } => (after(deadline), after(validity)),
                Promise::NonRealTime { validity } => (None, validity.and_then(after)),
                Promise::Hard => (None, None),
            };
            self.channels[index].events.push(Life {
                published_at: at,
                taken,
                deadline,
                expires_at,
                sent_at: None,
                heard_at: None,
                deliveries: Vec::new(),
                content,
                queue_full,
            });
        }
    }

    /// Follows the mailboxes through the run: loads and ends of attempts, as they came.
    fn note_frames(&mut self, journal: &Journal) {
        let (loads, attempts) = (journal.bus.loads(), journal.bus.attempts());
        let mut ended = attempts.iter().filter(|attempt| attempt.ending != Ending::Open).peekable();
        for load in loads {
            while let Some(attempt) = ended.next_if(|attempt| attempt.end <= load.at) {
                self.end(attempt);
            }
            let carried = self.first_waiting(journal, load);
            self.carried.push(carried);
        }
        ended.for_each(|attempt| self.end(attempt));
    }

    /// The event that a node must have put into a mailbox now.
    fn first_waiting(&self, journal: &Journal, load: &Load) -> Option<(usize, usize)> {
        let (etag, publisher) = (load.frame.id.etag(), load.frame.id.tx_node());
        let index = self.index(etag, publisher)?;
        journal.stations.contains(&(publisher, load.station)).then_some(())?;
        let account = &self.channels[index];
        let published = account.events.partition_point(|life| life.published_at <= load.at + READING);
        let waits = |life: &Life| {
            life.taken
                && life.sent_at.is_none()
                && life.expires_at.is_none_or(|expires| expires + READING > load.at)
                && life.may_be(&load.frame.payload)
        };
        let mut recent =
            (published.saturating_sub(LOOK_BACK)..published).filter(|at| waits(&account.events[*at]));
        let event = match account.channel.class {
            Promise::Hard => recent.next_back(),
            Promise::Soft { .. } | Promise::NonRealTime { .. } => recent.next(),
        };
        event.map(|event| (index, event))
    }

    fn end(&mut self, attempt: &Attempt) {
        let Some(frame) = attempt.frame() else { return };
        let Some(index) = self.index(frame.id.etag(), frame.id.tx_node()) else { return };
        let event = attempt.load.and_then(|load| self.event_of(load));
        let Some(life) = event.and_then(|event| self.channels[index].events.get_mut(event)) else {
            self.unknown_events += usize::from(attempt.ending == Ending::Sent);
            return;
        };
        if attempt.ending == Ending::Sent {
            life.sent_at = life.sent_at.or(Some(attempt.end));
        }
        if may_be_heard(attempt) {
            life.heard_at = life.heard_at.or(Some(attempt.end));
        }
    }

    fn note_deliveries(&mut self, journal: &Journal) {
        // A frame is received one bit before its end.
        let early = journal.bit_rate.bit_time() + READING;
        for (node, record) in &journal.records {
            let RecordKind::Delivered { digest, publisher, visible_at } = record.kind else { continue };
            let Some(clock) = journal.clock(*node) else { continue };
            let Some(etag) = record.channel.and_then(|number| journal.cluster.etag(number)) else {
                self.unknown_events += 1;
                continue;
            };
            // Its own events a node sees without the bus.
            if publisher == *node {
                continue;
            }
            let (visible_at, taken_at) = (clock.instant(visible_at), clock.instant(record.at));
            let delivery = Delivery { subscriber: *node, visible_at, taken_at };
            let account = self.index(etag, publisher).map(|index| &mut self.channels[index]);
            match account.and_then(|account| account.last_heard(*node, digest, visible_at + early)) {
                Some(life) => life.deliveries.push(delivery),
                None => self.unknown_events += 1,
            }
        }
    }
}

impl Account {
    /// The event that a node heard last before `at`, with this digest. One that it has seen already only if there is
    /// no other.
    fn last_heard(&mut self, node: TxNode, digest: Digest, at: VirtualInstant) -> Option<&mut Life> {
        let published = self.events.partition_point(|life| life.published_at <= at);
        let recent = published.saturating_sub(LOOK_BACK)..published;
        let heard = |life: &Life| life.heard_at.is_some_and(|heard| heard <= at) && life.content.1 == digest;
        let new = |life: &Life| life.deliveries_to(node).next().is_none();
        let find = |is: &dyn Fn(&Life) -> bool| recent.clone().rev().find(|n| is(&self.events[*n]));
        let place = find(&|life| heard(life) && new(life)).or_else(|| find(&heard))?;
        self.events.get_mut(place)
    }

    /// Returns whether the application may have left an event where it was: replaced by a later one, or still in the
    /// queue of its subscription.
    pub fn is_left(&self, event: usize, subscription: &Subscribed) -> bool {
        let later = self.events.get(event..).unwrap_or_default();
        let seen = |life: &Life| life.deliveries_to(subscription.node).next().is_some();
        match subscription.queue {
            Queue::Latest => true,
            Queue::Fifo(depth) => {
                let waiting = later.iter().filter(|life| life.sent_at.is_some()).count();
                !later.iter().any(seen) && waiting <= depth as usize
            }
        }
    }

    /// Events that were refused because a queue was full.
    pub fn refused_by_queue(&self) -> usize {
        self.events.iter().filter(|life| !life.taken && life.queue_full).count()
    }
}

impl Life {
    /// What arrived at a subscriber.
    pub fn deliveries_to(&self, subscriber: TxNode) -> impl Iterator<Item = &Delivery> {
        self.deliveries.iter().filter(move |delivery| delivery.subscriber == subscriber)
    }

    /// Returns whether a frame may carry it. A payload that has context beside the content cannot be compared.
    fn may_be(&self, payload: &Payload) -> bool {
        let (len, digest) = self.content;
        usize::from(len) != payload.len() || digest == Digest::of(payload.as_slice())
    }
}

/// Returns whether some receiver may have accepted the frame: it was sent, or destroyed when it was complete.
fn may_be_heard(attempt: &Attempt) -> bool {
    match attempt.ending {
        Ending::Sent => true,
        Ending::Failed(error) => error.field == Field::EndOfFrame,
        Ending::Open => false,
    }
}

/// How far readings of a local clock, taken by a program, may be off.
const READING: Duration = Duration::from_micros(1);
/// So many events of one channel are looked through at most.
const LOOK_BACK: usize = 2_048;
