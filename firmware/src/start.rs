//! Brings a node up: board, middleware, logs, and the parts for each task.

use boards::pac;
use boards::stm32f4::{Board, Settings};
use cosmic_core::plan::NodePlan;
use rtic_monotonics::stm32::Priority;

use crate::application::Reporter;
use crate::inbox::{Inbox, Storage};
use crate::node::{self, Node};
use crate::records::Records;
use crate::tasks::{CalendarParts, OtherParts, OutcomeParts, UrgentParts};

/// A node, taken apart for its tasks.
pub struct Parts {
    /// For the `calendar` task.
    pub calendar: CalendarParts,
    /// For `CAN1_RX0`.
    pub urgent: UrgentParts,
    /// For `CAN1_TX`.
    pub outcomes: OutcomeParts,
    /// For `CAN1_RX1`.
    pub other: OtherParts,
    /// For the `etch` task.
    pub inbox: Inbox,
    /// Shared by the `etch` task and the application.
    pub node: Node,
    /// Shared by the tasks of the application.
    pub reporter: Reporter,
}

/// Brings up the node of this plan. For RTIC's `init`; a mistake in the settings ends there, with a log.
pub fn start(device: pac::Peripherals, plan: NodePlan, storage: &'static mut Storage) -> Parts {
    let records = Records::start();
    let bit_rate = plan.calendar.segment().bit_rate;
    let settings = Settings { bit_rate, filters: plan.filters.iter() };
    let board = match Board::new(device, settings, Priority::new(TIMER_PRIORITY)) {
        Ok(board) => board,
        Err(error) => defmt::panic!("the board cannot be brought up: {}", defmt::Debug2Format(&error)),
    };
    let (half, dispatcher) = node::parts(&plan);
    let ends = storage.split();
    defmt::info!("node {} is up, calendar {=u32:08X}", plan.tx_node.get(), plan.calendar.digest());
    Parts {
        calendar: CalendarParts {
            dispatcher,
            mailbox: board.hard,
            running: board.points.calendar,
            notified: board.points.delivered,
            notices: ends.notices,
            wakes: ends.calendar_wakes,
        },
        urgent: UrgentParts { fifo: board.urgent, frames: ends.urgent },
        outcomes: OutcomeParts { outcomes: board.outcomes, left: ends.outcomes },
        other: OtherParts { fifo: board.other, frames: ends.frames },
        inbox: ends.inbox,
        node: Node::new(half, board.soft, board.non_real_time, board.bus, ends.wake_calendar),
        reporter: Reporter::new(records, ends.wake, board.points.published, board.points.exception),
    }
}

/// That of the calendar task, the highest: the timer must not wait for a task that it wakes, and everybody
/// reads the clock.
const TIMER_PRIORITY: u8 = 7;
