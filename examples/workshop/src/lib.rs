//! What the nodes of the workshop share: the plan, the contents, and how a node is brought up.
#![no_std]

use core::marker::PhantomData;

pub use boards::Stm32F405;
pub use cosmic_core::client::AdmissionState;
pub use cosmic_core::event_layer::{Attribute, Bytes, Context, Event, Filter};
use cosmic_core::event_layer::{Channel, EventRate, SoftAttributes};
use cosmic_core::plan::NodePlan;
use cosmic_core::services::{AdmittingBroker, News, NodeServices};
use cosmic_core::uid::Subject;
pub use cosmic_rtic::prelude::*;
use cosmic_rtic::{Log, PlannedHost};

// What `cosmic-plan` makes of cluster.toml: the module `plan`.
cosmic_core::include_plan!();

cosmic_core::content! {
    /// Everybody stops.
    #[derive(Clone, Copy, Debug, defmt::Format)]
    pub struct Stop {
        /// The reading that is the reason.
        pub reading: u16,
    }
}

cosmic_core::content! {
    /// What a probe has measured. Where, and by which sensor, says the context of the event.
    #[derive(Clone, Copy, Debug, defmt::Format)]
    pub struct Reading {
        /// In hundredths.
        pub value: u16,
    }
}

/// Hard real-time, sporadic.
pub const EMERGENCY_STOP: Channel<Stop> = plan::channels::emergency_stop::channel();

/// Soft real-time; the broker gives the etag.
pub const READING: Channel<Reading> = plan::channels::reading::channel::<Reading>().with_context();

/// Non real-time, in messages of several frames: what the probe has done.
pub const DIARY: plan::channels::diary::MessageChannel<Bytes<40>> = plan::channels::diary::channel();

/// Soft real-time, and in no plan: whoever publishes it asks for it at run time, by its rate and its deadline.
pub const VIBRATION: Channel<Reading> = Channel::soft(Subject::new(0xC000_0000_0000_00F1).unwrap(), FAST)
    .with_rate(EventRate::sporadic(VIBRATION_EVERY));
/// Between two events of the vibration, at least.
pub const VIBRATION_EVERY: Duration = Duration::from_millis(20);
const FAST: SoftAttributes =
    SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) };

cosmic_core::capacity! {
    /// What the plan asks for, and one channel beside it.
    pub Capacities {
        slots: 2,
        channels: 4,
        subscriptions: 5,
        events: 32,
        soft: 8,
        non_real_time: 8,
    }
}

/// What a node of the workshop is made of: all services, and what it hosts.
pub struct Workshop<B = ()>(PhantomData<B>);

/// One that hosts a broker for so many nodes and subjects, and for so many channels that are in no plan.
pub type Host = Workshop<AdmittingBroker<16, 16, 8>>;

impl<B: PlannedHost + 'static> System for Workshop<B> {
    type Board = Stm32F405;
    type Capacity = Capacities;
    type Services = NodeServices<8, 16, 8, 16, B>;
    type Observer = Log;
}

/// Starts a node, with the id that it has in the plan, or one that it asks the broker for.
pub fn start<B: PlannedHost>(
    resources: boards::stm32f4::Resources,
    node: &NodePlan,
    storage: &'static mut Storage<Workshop<B>>,
) -> Parts<Workshop<B>> {
    cosmic_rtic::start_observed(board(resources, node), node, storage, Log, ()).expect(CLOCKED)
}

/// The board, with its log.
fn board(resources: boards::stm32f4::Resources, node: &NodePlan) -> Stm32F405 {
    cosmic_rtt::start!(2048, cosmic_rtic::EVENT_PRIORITY);
    Stm32F405::start(resources, node).expect("the plan fits the board")
}

/// Tells what becomes of the node and of the broker that it hosts.
pub async fn tell<B: PlannedHost + 'static>(mut node: impl Mutex<T = Node<Workshop<B>>>) {
    loop {
        match next_news(&mut node).await {
            News::Configuration(event) => defmt::info!("{}", event),
            News::Broker(event) => defmt::info!("{}", event),
            News::Member(event) => defmt::info!("{}", event),
            News::Admission(event) => defmt::info!("{}", event),
            _ => {}
        }
    }
}

/// A probe: measures fifty times, gives its channel up, rests, and announces it again.
///
/// `at_rest` is told how many it has measured.
pub async fn measure<N: Mutex<T = Node<Workshop>>>(
    location: u16,
    mut node: N,
    mut at_rest: impl AsyncFnMut(u16, &mut N),
) {
    let context = Context::EMPTY.with(Attribute::Location, location.into()).expect("there is room");
    let mut values = 0..;
    loop {
        let readings = Publisher::announce(&READING, &mut node).expect(PLANNED);
        readings.bound(&mut node).await;
        let mut ticker = Ticker::<Stm32F405>::every(plan::channels::reading::MIN_INTERARRIVAL);
        for value in values.by_ref().take(50) {
            ticker.tick().await;
            let event = Event::new(Reading { value }).context(context);
            let _ = readings.publish_event(&event, &mut node);
        }
        defmt::info!("rests, and gives its channel up");
        readings.cancel(&mut node);
        at_rest(values.start, &mut node).await;
        Stm32F405::delay_until(Stm32F405::now() + REST).await;
    }
}

/// Events that wait for a subscriber.
pub const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());
/// Why a channel can be announced and subscribed to.
pub const PLANNED: &str = "the plan has the channel";
/// Why the services can be started.
const CLOCKED: &str = "the plan has a clock";
/// Of a probe and of the lamp.
pub const REST: Duration = Duration::from_millis(300);
