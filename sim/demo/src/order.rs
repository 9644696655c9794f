//! Judges whether soft real-time events are sent in the order of their deadlines where they compete.
//!
//! Between nodes the bus decides, by the priority field, which shows a deadline in steps of Δt_p and is
//! promoted as time passes. So a frame may win against one that is more urgent by at most one step, plus
//! one for a promotion that is under way ([`bound`]). Within a node the queue decides: no frame is put into
//! the mailbox while a more urgent event waits behind it.

use cosmic_bus::VirtualInstant;
use cosmic_core::calendar::Calendar;
use cosmic_core::can::{Priority, TxNode};

use crate::bus_log::is_soft;
use crate::journal::Journal;
use crate::ledger::{Ledger, Life};
use crate::span::Span;

/// How soft real-time events competed.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Order {
    /// How often a frame waited while another won the bus.
    pub contests: usize,
    /// How often a node chose between several events.
    pub choices: usize,
    /// The most by which a winner was less urgent than one that waited; negative if it never was.
    pub worst: Option<Span>,
    /// Each time that the bound was exceeded.
    pub inversions: Vec<Inversion>,
}

/// An event that was sent before a more urgent one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Inversion {
    /// When.
    pub at: VirtualInstant,
    /// Who sent it.
    pub winner: TxNode,
    /// Who had the more urgent one.
    pub loser: TxNode,
    /// How much more urgent that was.
    pub by: Span,
}

/// How much less urgent a frame may be than one that waits: two steps of the priority field.
pub fn bound(calendar: &Calendar) -> Span {
    let step = Span::from(calendar.priority_step());
    step + step
}

/// Judges a run.
pub fn judge(journal: &Journal, ledger: &Ledger) -> Order {
    let mut order = Order::default();
    between_nodes(journal, ledger, &mut order);
    within_nodes(journal, ledger, &mut order);
    order
}

fn between_nodes(journal: &Journal, ledger: &Ledger, order: &mut Order) {
    let loads = journal.bus.loads();
    let deadline_of = |load: usize| match ledger.life(load) {
        Some(life) => life.deadline,
        None => journal.background.deadline(&loads.get(load)?.frame),
    };
    let bound = bound(journal.cluster.calendar);
    for contest in journal.bus.contests() {
        let Some(attempt) = journal.bus.attempts().get(contest.winner) else { continue };
        let won = attempt.load.and_then(deadline_of);
        let Some((won, lost)) = won.zip(deadline_of(contest.loser)) else { continue };
        order.contests += 1;
        let remaining = |deadline| remaining(journal.cluster.calendar, attempt.start, deadline);
        let by = remaining(won) - remaining(lost);
        order.worst = Some(order.worst.map_or(by, |worst| worst.max(by)));
        if by > bound {
            let sender = |load: usize| loads[load].frame.id.tx_node();
            let (winner, loser) = (attempt.load.map_or(TxNode::MAX, sender), sender(contest.loser));
            order.inversions.push(Inversion { at: attempt.start, winner, loser, by });
        }
    }
}

/// The time left until a deadline, as far as the priority field can show it.
fn remaining(calendar: &Calendar, now: VirtualInstant, deadline: VirtualInstant) -> Span {
    let steps = i64::from(Priority::SOFT_LEAST_URGENT.get() - Priority::SOFT_MOST_URGENT.get());
    let step = Span::from(calendar.priority_step()).as_nanos();
    Span::between(now, deadline).clamp(Span::ZERO, Span::from_nanos(steps * step))
}

fn within_nodes(journal: &Journal, ledger: &Ledger, order: &mut Order) {
    let bound = bound(journal.cluster.calendar);
    for node in &journal.cluster.nodes {
        let queue = Queue::of(ledger, node.tx_node);
        for (index, load) in journal.bus.loads().iter().enumerate() {
            if !is_soft(load.frame.id) || load.frame.id.tx_node() != node.tx_node {
                continue;
            }
            let Some(deadline) = ledger.life(index).and_then(|life| life.deadline) else { continue };
            let Some(earliest) = queue.earliest_waiting(load.at, bound) else { continue };
            order.choices += 1;
            let by = Span::between(earliest, deadline);
            if by > bound {
                let tx_node = node.tx_node;
                order.inversions.push(Inversion { at: load.at, winner: tx_node, loser: tx_node, by });
            }
        }
    }
}

/// The soft real-time events of a node, in the order of publication.
struct Queue<'l> {
    lives: Vec<&'l Life>,
    longest: Span,
}

impl<'l> Queue<'l> {
    fn of(ledger: &'l Ledger, publisher: TxNode) -> Self {
        let accounts = ledger.channels.iter().filter(|account| account.channel.publisher == publisher);
        let lives = accounts.flat_map(|account| account.events.iter());
        let mut lives: Vec<_> = lives.filter(|life| life.taken && life.deadline.is_some()).collect();
        lives.sort_by_key(|life| life.published_at);
        let spans = lives.iter().filter_map(|life| Some(Span::between(life.published_at, life.expires_at?)));
        let longest = spans.max().unwrap_or_default();
        Self { lives, longest }
    }

    /// The earliest deadline of the events that wait at `now`, for `settled` already.
    fn earliest_waiting(&self, now: VirtualInstant, settled: Span) -> Option<VirtualInstant> {
        let from = (-self.longest).after(now);
        let first = self.lives.partition_point(|life| life.published_at < from);
        let recent = self.lives.get(first..)?.iter().take_while(|life| life.published_at <= now);
        let waits = |life: &&&Life| {
            Span::between(life.published_at, now) >= settled
                && life.sent_at.is_none_or(|sent| sent > now)
                && life.expires_at.is_some_and(|expires| expires > now)
        };
        recent.filter(waits).filter_map(|life| life.deadline).min()
    }
}
