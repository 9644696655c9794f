//! What the small nodes share: the plan of their cluster, and what they do.
//!
//! | image | node |
//! |---|---|
//! | `ups` | non real-time only; asks a broker for its id and the etags of its channels: what UPS calls an ECH |
//! | `full` | all three classes, clock, configuration, binding, interest, status |
//! | `full_logs` | the same, with logs |
//! | `hub` | names them, asks them, and logs what they answer; not small |
//!
//! They are built for size, by the profile `firmware-small`. `cargo xtask size` shows how small they are, and
//! `sim/demo/tests/small.rs` lets them work together in the emulated cluster.
#![no_std]

// What copies, in 150 bytes.
use cosmic_mem as _;

pub use boards::Stm32F405;
pub use cosmic_core::event_layer::Channel;
pub use cosmic_rtic::prelude::*;

cosmic_core::include_plan!();

/// Soft real-time; the broker gives the etags.
pub const WISH: Channel<u16> = plan::channels::wish::channel();
/// See [`WISH`].
pub const HEAT: Channel<u16> = plan::channels::heat::channel();
/// Non real-time.
pub const REQUEST: Channel<u16> = plan::channels::request::channel();
/// Non real-time.
pub const REPORT: Channel<u16> = plan::channels::report::channel();
/// Hard real-time, of the hub.
pub const BEAT: Channel<u16> = plan::channels::beat::channel();

/// Events that wait for a subscriber.
pub const QUEUE: Policy = Policy::Fifo(Depth::new(4).unwrap());

/// Before its slot a hard real-time event is published.
pub const LEAD: Duration = Duration::from_micros(500);

/// Answers each event of one channel with the same number on another.
pub async fn answer<T: System<Observer: cosmic_rtic::Observes<u16>>>(
    ask: &'static Channel<u16>,
    answer: &'static Channel<u16>,
    mut node: impl Mutex<T = Node<T>>,
) {
    let Ok(asked) = Subscriber::subscribe(ask, QUEUE, &mut node) else { return };
    let Ok(answers) = Publisher::announce(answer, &mut node) else { return };
    loop {
        let event = asked.next(&mut node).await;
        let _ = answers.publish(event.content, &mut node);
    }
}

/// Answers the beat of the hub in the slots of a channel, with its latest number.
pub async fn follow<T: System<Observer: cosmic_rtic::Observes<u16>>>(
    channel: &'static Channel<u16>,
    slot: &cosmic_core::calendar::Slot,
    mut node: impl Mutex<T = Node<T>>,
) {
    settled(&mut node).await;
    let Ok(beats) = Subscriber::subscribe(&BEAT, Policy::Latest, &mut node) else { return };
    let mut latest = 0;
    let next = |node: &mut _| {
        latest = beats.try_next(node).map_or(latest, |beat| beat.content);
        latest
    };
    let _ = publish_in_slots(channel, slot, LEAD, &mut node, next).await;
}
