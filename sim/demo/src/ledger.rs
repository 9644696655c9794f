//! The life of each event: published, on the wire, visible to each subscriber, taken.
//!
//! All instants are true time. An event is known by its channel and its sequence number, which its content
//! begins with.

use std::collections::BTreeMap;

use cosmic_bus::VirtualInstant;
use cosmic_core::can::{Etag, Frame, TxNode};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::Duration;

use crate::bus_log::{Ending, sequence_of};
use crate::example::{Channel, Promise};
use crate::journal::Journal;
use crate::record::RecordKind;

/// The events of all channels and the exceptions of all nodes.
#[derive(Clone, Debug)]
pub struct Ledger {
    /// One for each channel of the cluster, in its order.
    pub channels: Vec<Account>,
    /// All exceptions, node by node.
    pub told: Vec<Told>,
    /// Records of events that nobody published.
    pub unknown_events: usize,
}

/// The events of a channel.
#[derive(Clone, Debug)]
pub struct Account {
    /// Which channel.
    pub channel: &'static Channel,
    /// Its events by their sequence number.
    pub events: BTreeMap<u32, Life>,
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
    /// When it is of no use any more; soft real-time only.
    pub expires_at: Option<VirtualInstant>,
    /// The end of the first transmission that was not destroyed.
    pub sent_at: Option<VirtualInstant>,
    /// What arrived at the subscribers.
    pub deliveries: Vec<Delivery>,
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

impl Ledger {
    /// Puts the records and the frames of a run together.
    pub fn of(journal: &Journal) -> Self {
        let channels = journal.cluster.channels.iter();
        let mut ledger = Self {
            channels: channels.map(|channel| Account { channel, events: BTreeMap::new() }).collect(),
            told: Vec::new(),
            unknown_events: 0,
        };
        ledger.open(journal);
        ledger.note_frames(journal);
        ledger.note_deliveries(journal);
        ledger
    }

    /// The account of a channel.
    pub fn account(&self, etag: Etag) -> Option<&Account> {
        self.channels.iter().find(|account| account.channel.etag == etag)
    }

    /// The life of the event that a frame carries.
    pub fn life(&self, frame: &Frame) -> Option<&Life> {
        let account = self.account(frame.id.etag())?;
        account.events.get(&sequence_of(frame)?)
    }

    /// How many exceptions of a kind a node was told of on a channel.
    pub fn count(&self, node: TxNode, etag: Etag, kind: ExceptionKind) -> usize {
        let same = |told: &&Told| (told.node, told.etag, told.kind) == (node, Some(etag), kind);
        self.told.iter().filter(same).count()
    }

    fn account_mut(&mut self, etag: Etag) -> Option<&mut Account> {
        self.channels.iter_mut().find(|account| account.channel.etag == etag)
    }

    fn open(&mut self, journal: &Journal) {
        for (node, record) in &journal.records {
            let Some(clock) = journal.clock(*node) else { continue };
            let (sequence, taken) = match record.kind {
                RecordKind::Published { sequence } => (sequence, true),
                RecordKind::Refused { sequence } => (sequence, false),
                RecordKind::Exception(kind) => {
                    let at = clock.instant(record.at);
                    self.told.push(Told { node: *node, etag: record.etag, kind, at });
                    continue;
                }
                RecordKind::Delivered { .. } => continue,
            };
            let Some(account) = record.etag.and_then(|etag| self.account_mut(etag)) else {
                self.unknown_events += 1;
                continue;
            };
            let after = |span: Duration| Some(clock.instant(record.at + span));
            let (deadline, expires_at) = match account.channel.class {
                Promise::Soft { deadline, validity } => (after(deadline), after(validity)),
                Promise::Hard | Promise::NonRealTime => (None, None),
            };
            let published_at = clock.instant(record.at);
            let deliveries = Vec::new();
            let life = Life { published_at, taken, deadline, expires_at, sent_at: None, deliveries };
            account.events.insert(sequence, life);
        }
    }

    fn note_frames(&mut self, journal: &Journal) {
        for attempt in journal.bus.attempts().iter().filter(|attempt| attempt.ending == Ending::Sent) {
            let Some(frame) = attempt.frame() else { continue };
            let Some(sequence) = sequence_of(&frame) else { continue };
            let Some(account) = self.account_mut(frame.id.etag()) else { continue };
            if account.channel.publisher != frame.id.tx_node() {
                continue;
            }
            match account.events.get_mut(&sequence) {
                Some(life) => life.sent_at = life.sent_at.or(Some(attempt.end)),
                None => self.unknown_events += 1,
            }
        }
    }

    fn note_deliveries(&mut self, journal: &Journal) {
        for (node, record) in &journal.records {
            let RecordKind::Delivered { sequence, publisher, visible_at } = record.kind else { continue };
            let Some(clock) = journal.clock(*node) else { continue };
            let account = record.etag.and_then(|etag| self.account_mut(etag));
            let life = account
                .filter(|account| account.channel.publisher == publisher)
                .and_then(|account| account.events.get_mut(&sequence));
            match life {
                Some(life) => life.deliveries.push(Delivery {
                    subscriber: *node,
                    visible_at: clock.instant(visible_at),
                    taken_at: clock.instant(record.at),
                }),
                None => self.unknown_events += 1,
            }
        }
    }
}

impl Account {
    /// Sequence numbers that are missing from 0 to the last: records that were lost.
    pub fn gaps(&self) -> u64 {
        let expected = self.events.keys().next_back().map_or(0, |last| u64::from(*last) + 1);
        expected - self.events.len() as u64
    }
}

impl Life {
    /// What arrived at a subscriber.
    pub fn deliveries_to(&self, subscriber: TxNode) -> impl Iterator<Item = &Delivery> {
        self.deliveries.iter().filter(move |delivery| delivery.subscriber == subscriber)
    }
}
