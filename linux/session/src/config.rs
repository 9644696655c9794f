//! What a node is told at its start, by the description of its cluster.

use std::sync::{Mutex, PoisonError};

use cosmic_core::NodeUid;
use cosmic_core::calendar::Calendar;
use cosmic_core::can::BitRate;
use cosmic_linux::{Config, calendar_without_slots};
use cosmic_monitor::SegmentPlan;

/// A node with this UID on the segment of a plan, or of this bit rate where there is none. A node of the plan has its
/// TxNode there; any other asks for one.
pub fn node_config(uid: NodeUid, plan: Option<&SegmentPlan>, bit_rate: BitRate) -> Config {
    let config = Config::new(uid);
    let Some(plan) = plan else { return config.calendar(calendar_without_slots(bit_rate)) };
    let mut config = config.calendar(kept(plan.calendar()));
    let planned = plan.cluster().nodes.iter().find(|node| NodeUid::new(node.uid) == Some(uid));
    config.node.tx_node = planned.filter(|node| !node.asks).map(|node| node.tx_node);
    if let Some(clock) = plan.cluster().sync() {
        config.node.clock = clock;
    }
    config
}

/// A node refers to its calendar for as long as the program runs: one is kept of each.
fn kept(calendar: Calendar) -> &'static Calendar {
    static CALENDARS: Mutex<Vec<&Calendar>> = Mutex::new(Vec::new());
    let mut calendars = CALENDARS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(calendar) = calendars.iter().find(|kept| ***kept == calendar) {
        return calendar;
    }
    let calendar = &*Box::leak(Box::new(calendar));
    calendars.push(calendar);
    calendar
}
