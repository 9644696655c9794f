//! What happened, newest last: nodes that come and go, exceptions, faults.

use std::collections::VecDeque;

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::{Duration, Instant};
use serde::Serialize;

/// Notices that are kept. Older ones are dropped.
pub const MOST_NOTICES: usize = 256;

/// Something that happened.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct Notice {
    /// Stays the same when the notice is told again because it happened again.
    pub id: u64,
    /// Grows with every change: ask for those behind the last one you have seen.
    pub sequence: u64,
    /// When it happened last, in nanoseconds of the monitor's time.
    pub at_ns: u64,
    /// How often, or how many.
    pub count: u64,
    /// What it was.
    pub kind: NoticeKind,
    /// The node that it concerns.
    pub tx_node: Option<u8>,
    /// The channel that it concerns.
    pub etag: Option<u16>,
    /// A sentence.
    pub text: String,
    /// Exceptions of the middleware that it is, or that may explain it. Empty if nothing on the bus did.
    pub exceptions: Vec<Explanation>,
}

/// An exception of the middleware, and what it means.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Debug)]
pub struct Explanation {
    /// Its name.
    pub name: &'static str,
    /// A sentence that also says where to look.
    pub meaning: &'static str,
}

impl From<ExceptionKind> for Explanation {
    fn from(kind: ExceptionKind) -> Self {
        Self { name: kind.name(), meaning: kind.meaning() }
    }
}

/// The kinds of notices.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Debug)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum NoticeKind {
    /// A node was heard that was not there.
    NodeAppeared,
    /// A node said that it leaves, or gave its TxNode back.
    NodeLeft,
    /// A node has not been heard for too long.
    NodeSilent,
    /// A node has started again.
    NodeRestarted,
    /// A node does something else than before.
    NodeState,
    /// A node counted exceptions.
    Exceptions,
    /// Two nodes with one TxNode, or one UID.
    Duplicate,
    /// Another node is time master.
    Master,
    /// Global time has jumped.
    ClockStep,
    /// Another node is broker.
    Broker,
    /// The broker refused a binding or a TxNode.
    Refused,
    /// Two nodes lay out the content of a channel differently.
    LayoutMismatch,
    /// Slots of a periodic channel passed without a frame.
    MissedSlot,
    /// A hard real-time frame that the calendar does not know, or outside of its window.
    OutsideSlot,
    /// Frames were lost before they arrived here.
    Lost,
    /// The link's own controller has left the bus.
    BusOff,
}

/// The notices, and the numbers of the next ones.
#[derive(Clone, Default, Debug)]
pub(crate) struct Feed {
    notices: VecDeque<Notice>,
    sequence: u64,
    ids: u64,
}

/// A notice before it has numbers.
#[derive(Clone, Debug)]
pub(crate) struct News {
    pub(crate) kind: NoticeKind,
    pub(crate) tx_node: Option<TxNode>,
    pub(crate) etag: Option<Etag>,
    pub(crate) count: u64,
    pub(crate) text: String,
    pub(crate) exceptions: Vec<ExceptionKind>,
}

impl News {
    pub(crate) fn new(kind: NoticeKind, text: impl Into<String>) -> Self {
        Self { kind, tx_node: None, etag: None, count: 1, text: text.into(), exceptions: Vec::new() }
    }

    pub(crate) fn of(self, tx_node: TxNode) -> Self {
        Self { tx_node: Some(tx_node), ..self }
    }

    pub(crate) fn on(self, etag: Etag) -> Self {
        Self { etag: Some(etag), ..self }
    }

    pub(crate) fn times(self, count: u64) -> Self {
        Self { count, ..self }
    }

    pub(crate) fn because(self, exceptions: impl Into<Vec<ExceptionKind>>) -> Self {
        Self { exceptions: exceptions.into(), ..self }
    }
}

impl Feed {
    /// Adds a notice. The same of the same node and channel within a second is told once more with a larger count, so
    /// that a fault that goes on and on does not drive out the others. Linear in [`RECENT`].
    pub(crate) fn add(&mut self, news: News, at: Instant) {
        let (tx_node, etag) = (news.tx_node.map(TxNode::get), news.etag.map(Etag::get));
        let at_ns = at.since_epoch().as_ticks();
        self.sequence += 1;
        let same = |notice: &Notice| {
            (notice.kind, notice.tx_node, notice.etag) == (news.kind, tx_node, etag)
                && at_ns.saturating_sub(notice.at_ns) < AGAIN.as_ticks()
        };
        let recent = self.notices.len().saturating_sub(RECENT);
        let again =
            self.notices.iter().skip(recent).position(same).and_then(|at| self.notices.remove(recent + at));
        let (id, count) = match again {
            Some(before) => (before.id, before.count.saturating_add(news.count)),
            None => {
                self.ids += 1;
                (self.ids, news.count)
            }
        };
        if self.notices.len() == MOST_NOTICES {
            self.notices.pop_front();
        }
        self.notices.push_back(Notice {
            id,
            sequence: self.sequence,
            at_ns,
            count,
            kind: news.kind,
            tx_node,
            etag,
            text: news.text,
            exceptions: news.exceptions.into_iter().map(Explanation::from).collect(),
        });
    }

    /// The notices behind this number.
    pub(crate) fn after(&self, sequence: u64) -> impl Iterator<Item = &Notice> {
        self.notices.iter().skip_while(move |notice| notice.sequence <= sequence)
    }
}

/// The same within this span is one notice.
const AGAIN: Duration = Duration::from_secs(1);
/// So many notices are looked at for the same one.
const RECENT: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(ms))
    }

    #[test]
    fn the_same_again_is_told_with_a_larger_count() {
        let mut feed = Feed::default();
        feed.add(News::new(NoticeKind::MissedSlot, "missed").on(Etag::HARD_FIRST), at(0));
        feed.add(News::new(NoticeKind::Lost, "lost").times(3), at(1));
        feed.add(News::new(NoticeKind::MissedSlot, "missed").on(Etag::HARD_FIRST), at(500));
        let all: Vec<_> = feed.after(0).map(|notice| (notice.id, notice.sequence, notice.count)).collect();
        assert_eq!(all, [(2, 2, 3), (1, 3, 2)]);
        assert_eq!(feed.after(2).count(), 1);
        feed.add(News::new(NoticeKind::MissedSlot, "missed").on(Etag::HARD_FIRST), at(2_000));
        assert_eq!(feed.after(3).map(|notice| notice.count).collect::<Vec<_>>(), [1]);
    }

    #[test]
    fn a_flood_stays_within_its_bound() {
        let mut feed = Feed::default();
        for ms in 0..10_000 {
            let etag = Etag::new(ms as u16 % 16_000).unwrap();
            feed.add(News::new(NoticeKind::OutsideSlot, "no slot").on(etag), at(ms));
        }
        assert_eq!(feed.after(0).count(), MOST_NOTICES);
        assert_eq!(feed.after(9_999).count(), 1);
    }
}
