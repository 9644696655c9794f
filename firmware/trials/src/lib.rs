//! A small cluster for trials: nodes with all services, a watchdog, and a way to misbehave.
//!
//! | node | does |
//! |---|---|
//! | `master` | of the time; hosts the broker, and counts what the others send |
//! | `deputy` | stands by for both |
//! | `worker` | publishes in each slot of the calendar |
//! | `guest` | asks for its id; publishes softly every 10 ms |
//! | `hearer` | asks for its id; subscribes to that for 0.4 s, cancels it for 0.4 s, and so on |
//!
//! Each obeys the [first byte](Misdeed::of_this_part) of its part's unique identifier, which the emulator sets: some time
//! after its start it hangs in one of several ways. After a reset by the watchdog it does not.
#![no_std]

mod app;
mod misdeed;

use core::marker::PhantomData;

use boards::Stm32F4;
use boards::pac::IWDG;
use boards::stm32f4::OfBoard;
use boards::watchdog::{Patience, Watchdog};
use boards::wiring::{Stm32H405, Wiring};
use cosmic_core::broker::Broker;
use cosmic_core::plan::NodePlan;
use cosmic_core::protocol::ResetCause;
use cosmic_core::services::{NodeConfig, NodeServices};
pub use cosmic_rtic::prelude::*;
use cosmic_rtic::{Log, Memory, PlannedHost, Progress};

pub use crate::misdeed::Misdeed;
use crate::plan::channels::{beat, count};

cosmic_core::include_plan!();

cosmic_core::content! {
    /// What is sent.
    #[derive(Clone, Copy, Debug, defmt::Format)]
    pub struct Number {
        /// Counts up.
        pub number: u32,
    }
}

/// What a node is made of: what it hosts, and its board.
pub struct Trial<B = (), W = Stm32H405>(PhantomData<(B, W)>);

/// One that hosts a broker.
pub type Host = Trial<Broker<8, 8>>;

impl<B: PlannedHost + 'static, W: Wiring> System for Trial<B, W> {
    type Board = Stm32F4<W>;
    type Capacity = plan::Capacities;
    type Services = NodeServices<8, 16, 8, 16, B>;
    type Observer = (&'static Progress<1>, (Memory, Log));
}

/// A node that is brought up.
pub struct Up<B: PlannedHost + 'static, W: Wiring> {
    /// Its parts.
    pub parts: Parts<Trial<B, W>>,
    /// Its watchdog, which runs.
    pub watchdog: Watchdog,
    /// What it is to do wrong.
    pub misdeed: Misdeed,
}

/// Brings up a node with the id of its plan, or one that asks for its id.
pub fn start<B: PlannedHost, W: Wiring>(
    resources: OfBoard<W>,
    watchdog: IWDG,
    node: &NodePlan,
    asks: bool,
    storage: &'static mut Storage<Trial<B, W>>,
) -> Up<B, W> {
    cosmic_rtt::start!(2048, cosmic_rtic::EVENT_PRIORITY);
    let cause = boards::reset::take_cause();
    let mut memory = boards::reset::take_memory(cause).expect("nobody else takes it");
    defmt::info!("started by {}", cause);
    memory.recover(|exception| defmt::info!("before that: {}", exception));
    let board = Stm32F4::<W>::start(resources, node).expect("the plan fits the board");
    let planned = NodeConfig::planned(node).expect(CLOCKED);
    let tx_node = planned.tx_node.filter(|_| !asks);
    let config = NodeConfig { tx_node, ..planned };
    let services =
        NodeServices::new(&config, node.calendar, B::planned(node), Stm32F4::<W>::now()).expect(CLOCKED);
    let observer = (&PROGRESS, (memory, Log));
    let mut parts = cosmic_rtic::start_with(board, node, storage, services, observer, (&PROGRESS, ((), ())));
    parts.node.set_reset_cause(cause);
    let misdeed = if cause == ResetCause::Watchdog { Misdeed::None } else { Misdeed::of_this_part() };
    Up { parts, watchdog: Watchdog::start(watchdog, PATIENCE), misdeed }
}

/// Feeds the watchdog.
pub async fn supervise<B: PlannedHost + 'static, W: Wiring>(
    watchdog: Watchdog,
    node: impl Mutex<T = Node<Trial<B, W>>>,
) -> ! {
    PROGRESS.supervise(watchdog, PERIOD, node).await
}

/// The application of the worker: an event for each slot, once the cluster has a time.
pub async fn work<W: Wiring>(misdeed: Misdeed, mut node: impl Mutex<T = Node<Trial<(), W>>>) {
    let mut ticker = Ticker::<Stm32F4<W>>::every(TURN);
    while !node.lock(|node| node.clock()).is_synchronised(Stm32F4::<W>::now()) {
        ticker.tick().await;
        PROGRESS.made::<0>();
    }
    before_slot(&beat::SLOT, LEAD, &mut node).await;
    let beats = Publisher::announce(const { &beat::channel::<Number>() }, &mut node).expect(PLANNED);
    for number in 0.. {
        PROGRESS.made::<0>();
        let _ = beats.publish(Number { number }, &mut node);
        if number == MISDEED_AFTER {
            misdeed.commit(&mut node).await;
        }
        before_slot(&beat::SLOT, LEAD, &mut node).await;
    }
}

/// The application of the guest.
pub async fn count<W: Wiring>(misdeed: Misdeed, mut node: impl Mutex<T = Node<Trial<(), W>>>) {
    let counts = Publisher::announce(const { &count::channel::<Number>() }, &mut node).expect(PLANNED);
    let mut ticker = Ticker::<Stm32F4<W>>::every(TURN);
    for number in 0.. {
        ticker.tick().await;
        PROGRESS.made::<0>();
        // Refused until the broker has given id and etag.
        let _ = counts.publish(Number { number }, &mut node);
        if number == MISDEED_AFTER {
            misdeed.commit(&mut node).await;
        }
    }
}

/// The application of the hearer.
pub async fn hear<W: Wiring>(_: Misdeed, mut node: impl Mutex<T = Node<Trial<(), W>>>) {
    let mut ticker = Ticker::<Stm32F4<W>>::every(TURN);
    loop {
        let counts =
            Subscriber::subscribe(const { &count::channel::<Number>() }, QUEUE, &mut node).expect(PLANNED);
        defmt::info!("hears");
        let mut heard = 0_u32;
        for _ in 0..HEARS_FOR {
            ticker.tick().await;
            PROGRESS.made::<0>();
            while counts.try_next(&mut node).is_some() {
                heard += 1;
            }
        }
        counts.cancel(&mut node);
        defmt::info!("has heard {}", heard);
        for _ in 0..HEARS_FOR {
            ticker.tick().await;
            PROGRESS.made::<0>();
        }
    }
}

/// The application of the master and the deputy: says what has come.
pub async fn watch<B: PlannedHost + 'static, W: Wiring>(
    misdeed: Misdeed,
    mut node: impl Mutex<T = Node<Trial<B, W>>>,
) {
    let beats = Subscriber::subscribe(const { &beat::channel::<Number>() }, QUEUE, &mut node).expect(PLANNED);
    let counts =
        Subscriber::subscribe(const { &count::channel::<Number>() }, QUEUE, &mut node).expect(PLANNED);
    let mut ticker = Ticker::<Stm32F4<W>>::every(TURN);
    let (mut beaten, mut counted) = (0_u32, 0_u32);
    for number in 0.. {
        ticker.tick().await;
        PROGRESS.made::<0>();
        while beats.try_next(&mut node).is_some() {
            beaten += 1;
        }
        while counts.try_next(&mut node).is_some() {
            counted += 1;
        }
        if number % 100 == 0 {
            defmt::info!("{} beats, {} counts", beaten, counted);
        }
        if number == MISDEED_AFTER {
            misdeed.commit(&mut node).await;
        }
    }
}

static PROGRESS: Progress<1> = Progress::new();

/// In which everybody makes progress.
const PERIOD: Duration = Duration::from_millis(20);
const PATIENCE: Patience = Patience::at_least(Duration::from_millis(100)).unwrap();
/// Of an application.
const TURN: Duration = Duration::from_millis(10);
/// Turns of the hearer.
const HEARS_FOR: u32 = 40;
/// Turns of the application.
const MISDEED_AFTER: u32 = 120;
/// Before a slot.
const LEAD: Duration = Duration::from_micros(500);
const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());
const PLANNED: &str = "the plan has the channel";
const CLOCKED: &str = "the plan has a clock";
