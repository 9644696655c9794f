//! The brake: applies a force for every wheel speed, and tells which.
#![no_std]
#![no_main]

use cosmic_rtt as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use cosmic_rtic::prelude::*;
    use firmware::cluster::plan::channels::{brake_force, suspension, temperature, wheel_speed};
    use firmware::cluster::plan::contents::BrakeForce;
    use firmware::cluster::plan::nodes;
    use firmware::signals;
    use firmware::vehicle::{Vehicle, planned, start};

    /// For each subscription.
    const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());

    #[shared]
    struct Shared {
        node: Node<Vehicle>,
        /// The disc's temperature as last heard, in hundredths of a degree Celsius.
        disc: i16,
    }

    #[local]
    struct Local {
        calendar: Calendar<Vehicle>,
        urgent: Urgent<Vehicle>,
        outcomes: Outcomes<Vehicle>,
        status: Status<Vehicle>,
        other: Other<Vehicle>,
        events: Events,
    }

    #[init(local = [storage: Storage<Vehicle> = Storage::new()])]
    fn init(context: init::Context) -> (Shared, Local) {
        let parts = start(boards::resources!(context.device), nodes::brake::NODE, context.local.storage);
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        let spawned = [
            calendar::spawn(),
            events::spawn(),
            exceptions::spawn(),
            brake::spawn(),
            watch_temperature::spawn(),
            watch_suspension::spawn(),
        ];
        // Each task is spawned once, so there is room for it.
        defmt::assert!(spawned.iter().all(Result::is_ok));
        (Shared { node, disc: 0 }, Local { calendar, urgent, outcomes, status, other, events })
    }

    #[task(local = [calendar], priority = 7)]
    async fn calendar(context: calendar::Context) {
        context.local.calendar.run().await
    }

    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)]
    fn can_rx_urgent(context: can_rx_urgent::Context) {
        context.local.urgent.run();
    }

    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)]
    fn can_tx(context: can_tx::Context) {
        context.local.outcomes.run();
    }

    #[task(binds = CAN1_SCE, local = [status], priority = 5)]
    fn can_status(context: can_status::Context) {
        context.local.status.run();
    }

    #[task(binds = CAN1_RX1, local = [other], priority = 4)]
    fn can_rx_other(context: can_rx_other::Context) {
        context.local.other.run();
    }

    #[task(local = [events], shared = [node], priority = 3)]
    async fn events(context: events::Context) {
        context.local.events.run(context.shared.node).await
    }

    #[task(shared = [node], priority = 1)]
    async fn exceptions(context: exceptions::Context) {
        report_exceptions(context.shared.node).await
    }

    /// Brakes as the wheel speed demands, less when the disc is hot.
    #[task(shared = [node, disc], priority = 1)]
    async fn brake(mut context: brake::Context) {
        let brake::SharedResources { node, disc, .. } = &mut context.shared;
        let Some(brake_force) = planned(Publisher::announce(&brake_force::CHANNEL, node)) else { return };
        // The publisher waits for it, too: before, there is nothing that could be missed.
        settled(node).await;
        let Some(wheel_speed) = planned(Subscriber::subscribe(&wheel_speed::CHANNEL, QUEUE, node)) else {
            return;
        };
        let mut sequence = 0;
        loop {
            let event = wheel_speed.next(node).await;
            let centidegrees = disc.lock(|disc| *disc);
            let content = BrakeForce {
                sequence,
                force: signals::brake_force(event.content.speed, centidegrees),
                based_on: event.content.sequence as u16,
            };
            let _ = brake_force.publish(content, node);
            sequence = sequence.wrapping_add(1);
        }
    }

    #[task(shared = [node, disc], priority = 1)]
    async fn watch_temperature(mut context: watch_temperature::Context) {
        let watch_temperature::SharedResources { node, disc, .. } = &mut context.shared;
        let Some(temperature) = planned(Subscriber::subscribe(&temperature::CHANNEL, QUEUE, node)) else {
            return;
        };
        loop {
            let event = temperature.next(node).await;
            disc.lock(|disc| *disc = event.content.temperature);
        }
    }

    #[task(shared = [node], priority = 1)]
    async fn watch_suspension(mut context: watch_suspension::Context) {
        let node = &mut context.shared.node;
        let Some(suspension) = planned(Subscriber::subscribe(&suspension::CHANNEL, QUEUE, node)) else {
            return;
        };
        loop {
            let event = suspension.next(node).await;
            defmt::trace!("{}", event.content);
        }
    }
}
