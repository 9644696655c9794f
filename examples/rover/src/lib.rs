//! What the nodes of the rover share: the plan, with the contents of its channels, and how a node is brought up.
#![no_std]

pub use boards::Stm32F405;
use cosmic_core::event_layer::{Channel, Content};
use cosmic_core::plan::NodePlan;
use cosmic_core::services::ClockService;
use cosmic_records::watch::{self, Watcher};
use cosmic_rtic::Log;
pub use cosmic_rtic::prelude::*;

// What `cosmic-plan` makes of cluster.toml: the module `plan`.
cosmic_core::include_plan!();

/// What a node of the rover is made of.
pub struct Rover;

impl cosmic_rtic::System for Rover {
    type Board = Stm32F405;
    type Capacity = plan::Capacities;
    type Services = ClockService;
    type Observer = (Log, Watcher);
}

/// Brings the board up that a node of the plan runs on, with its log.
pub fn board(resources: boards::stm32f4::Resources, node: &NodePlan) -> Stm32F405 {
    cosmic_records::open!(4096);
    cosmic_rtt::start!(1024, cosmic_rtic::EVENT_PRIORITY);
    Stm32F405::start(resources, node).expect("the plan fits the board")
}

/// Starts the node.
pub fn start(board: Stm32F405, node: &NodePlan, storage: &'static mut Storage<Rover>) -> Parts<Rover> {
    let observers = (Log, watch::watcher(&plan::CHANNELS));
    cosmic_rtic::start_observed(board, node, storage, observers, ((), ())).expect("the plan has a clock")
}

/// A hard real-time event is published this long before its slot.
pub const LEAD: Duration = Duration::from_micros(300);
/// Events that wait for a subscriber.
pub const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());
/// Why a channel can be announced and subscribed to.
pub const PLANNED: &str = "the plan has the channel";

/// Follows a channel: takes one event after the other.
pub async fn follow<C: Content>(channel: &'static Channel<C>, mut node: impl Mutex<T = Node<Rover>>) {
    // Before, there is nothing that could be missed.
    settled(&mut node).await;
    let events = Subscriber::subscribe(channel, QUEUE, &mut node).expect(PLANNED);
    loop {
        events.next(&mut node).await;
    }
}
