//! The sensor: wheel speed in hard real-time every 10 ms, temperature in soft real-time every 20 ms.
#![no_std]
#![no_main]

use cosmic_rtt as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use cosmic_rtic::prelude::*;
    use firmware::cluster::plan::channels::{logbook, temperature, wheel_speed};
    use firmware::cluster::plan::contents::{Temperature, WheelSpeed};
    use firmware::cluster::plan::nodes;
    use firmware::signals;
    use firmware::vehicle::{Board, Vehicle, planned, start};

    /// A measurement is published this long before its slot.
    const LEAD: Duration = Duration::from_micros(500);
    const TEMPERATURE_PERIOD: Duration = temperature::PERIOD;

    #[shared]
    struct Shared {
        node: Node<Vehicle>,
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
        let parts = start(boards::resources!(context.device), nodes::sensor::NODE, context.local.storage);
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        let spawned = [
            calendar::spawn(),
            events::spawn(),
            exceptions::spawn(),
            measure_wheel::spawn(),
            measure_temperature::spawn(),
            keep_logbook::spawn(),
        ];
        // Each task is spawned once, so there is room for it.
        defmt::assert!(spawned.iter().all(Result::is_ok));
        (Shared { node }, Local { calendar, urgent, outcomes, status, other, events })
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

    /// One measurement for each slot of the calendar, shortly before it.
    #[task(shared = [node], priority = 1)]
    async fn measure_wheel(mut context: measure_wheel::Context) {
        let node = &mut context.shared.node;
        // What is published before the others know the time would be lost.
        settled(node).await;
        // Announced shortly before the first event: from then on a slot without one is an error.
        before_slot(&wheel_speed::SLOT, LEAD, node).await;
        let Some(publisher) = planned(Publisher::announce(&wheel_speed::CHANNEL, node)) else { return };
        let mut sequence = 0;
        loop {
            let content = WheelSpeed { sequence, speed: signals::wheel_speed(sequence), valid: true };
            let _ = publisher.publish(content, node);
            sequence = sequence.wrapping_add(1);
            before_slot(&wheel_speed::SLOT, LEAD, node).await;
        }
    }

    #[task(shared = [node], priority = 1)]
    async fn measure_temperature(mut context: measure_temperature::Context) {
        let node = &mut context.shared.node;
        let Some(publisher) = planned(Publisher::announce(&temperature::CHANNEL, node)) else { return };
        let mut ticker = Ticker::<Board>::every(TEMPERATURE_PERIOD);
        let mut sequence = 0;
        loop {
            ticker.tick().await;
            let content = Temperature { sequence, temperature: signals::disc_temperature(sequence) };
            let _ = publisher.publish(content, node);
            sequence = sequence.wrapping_add(1);
        }
    }

    #[task(shared = [node], priority = 1)]
    async fn keep_logbook(mut context: keep_logbook::Context) {
        let node = &mut context.shared.node;
        let policy = Policy::Fifo(const { Depth::new(16).unwrap() });
        let Some(logbook) = planned(Subscriber::subscribe(&logbook::CHANNEL, policy, node)) else { return };
        loop {
            let entry = logbook.next(node).await;
            defmt::debug!("node {}: {}", entry.publisher, entry.content);
        }
    }
}
