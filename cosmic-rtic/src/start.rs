//! Brings a node up: board and middleware become the parts for each task.

use core::mem::MaybeUninit;

use cosmic_core::Capacity;
use cosmic_core::can::ErrorCounters;
use cosmic_core::event_half::HardAccess as _;
use cosmic_core::plan::NodePlan;
use cosmic_core::services::Services as _;
use cosmic_core::time::Duration;

use crate::board::{Board, BoardParts};
use crate::departures::Departures;
use crate::hard::{Hard, HardCell};
use crate::inbox::Queued;
use crate::node::Node;
use crate::observer::Observer;
use crate::rejoin::Rejoin;
use crate::sieve::Sieve;
use crate::system::{Buffers, Half, StartError, System, Timed as _};
use crate::tasks::{Calendar, Events, Other, Outcomes, Receiver, Status, Urgent};

/// Where a node is: the queues between its tasks, the HRT message buffers, and its event-triggered half. One for each
/// app, in the `local` resources of its `init`.
pub struct Storage<T: System> {
    queues: <T::Capacity as Queued>::Queues,
    sieve: Sieve,
    hard: HardCell<Buffers<T>>,
    half: MaybeUninit<Half<T>>,
}

impl<T: System> Storage<T> {
    /// Nothing has happened yet.
    pub const fn new() -> Self {
        Self {
            queues: <T::Capacity as Queued>::EMPTY,
            sieve: Sieve::new(),
            hard: HardCell::new(),
            half: MaybeUninit::uninit(),
        }
    }
}

impl<T: System> Default for Storage<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// A node, taken apart for its tasks.
pub struct Parts<T: System> {
    /// For the calendar task.
    pub calendar: Calendar<T>,
    /// For the interrupt of the urgent FIFO.
    pub urgent: Urgent<T>,
    /// For the transmit interrupt.
    pub outcomes: Outcomes<T>,
    /// For the status change interrupt.
    pub status: Status<T>,
    /// For the interrupt of the other FIFO.
    pub other: Other<T>,
    /// For the event task.
    pub events: Events,
    /// Shared by the event task and the application.
    pub node: Node<T>,
}

/// Starts a node with the services that its plan describes, unobserved. For RTIC's `init`.
///
/// # Errors
/// [`StartError`]: the plan lacks what the services need.
pub fn start<T: System<Observer = ()>>(
    board: T::Board,
    plan: &NodePlan,
    storage: &'static mut Storage<T>,
) -> Result<Parts<T>, StartError> {
    start_observed(board, plan, storage, (), ())
}

/// As [`start`], with somebody who watches.
///
/// # Errors
/// As [`start`].
pub fn start_observed<T: System>(
    board: T::Board,
    plan: &NodePlan,
    storage: &'static mut Storage<T>,
    observer: T::Observer,
    calendar_observer: <T::Observer as Observer>::Calendar,
) -> Result<Parts<T>, StartError> {
    let services = T::Services::planned(plan, T::Board::now())?;
    Ok(start_with(board, plan, storage, services, observer, calendar_observer))
}

/// As [`start_observed`], with services that were put together elsewhere.
pub fn start_with<T: System>(
    board: T::Board,
    plan: &NodePlan,
    storage: &'static mut Storage<T>,
    services: T::Services,
    observer: T::Observer,
    calendar_observer: <T::Observer as Observer>::Calendar,
) -> Parts<T> {
    const {
        let is_heard = T::Services::HEARS_CLOCK;
        assert!(T::Capacity::URGENT > 0 || !is_heard, "the frames of the clock need places");
    };
    let Storage { queues, sieve, hard, half } = storage;
    let sieve: &'static Sieve = sieve;
    let hard = hard.start(<T::Capacity as Capacity>::BUFFERS);
    // Services whose time never changes do not tell it later.
    Hard::new(hard).with(|buffers| T::Capacity::set_clock(buffers, services.global_clock()));
    let tx_node = services.tx_node(plan);
    let ends = T::Capacity::split(queues);
    let BoardParts { hard: mailbox, soft, non_real_time, outcomes, urgent, other, status, changes, filters } =
        board.split();
    Parts {
        calendar: Calendar {
            dispatcher: T::Capacity::dispatcher(plan.calendar),
            hard: Hard::new(hard),
            mailbox,
            notices: ends.notices,
            wakes: ends.wake_calendar,
            observer: calendar_observer,
        },
        urgent: Urgent {
            receiver: Receiver { fifo: urgent, hard: Hard::new(hard), sieve, frames: ends.urgent },
        },
        outcomes: Outcomes { outcomes, hard: Hard::new(hard), left: ends.outcomes },
        status: Status { changes, bus_off: ends.bus_off },
        other: Other {
            receiver: Receiver { fifo: other, hard: Hard::new(hard), sieve, frames: ends.frames },
        },
        events: Events { inbox: ends.inbox },
        node: Node {
            half: half.write(T::Capacity::half(tx_node, plan.calendar, services, Hard::new(hard))),
            soft,
            non_real_time,
            status,
            filters,
            errors: ErrorCounters::NONE,
            rejoin: Rejoin::new(),
            wake: ends.wake,
            wake_calendar: ends.wake_calendar,
            sync_period: plan.sync.map_or(Duration::from_ticks(0), |sync| sync.period),
            synchronised_since: None,
            departures: Departures::NOBODY,
            discarded: 0,
            news_waker: None,
            sieve,
            observer,
        },
    }
}
