//! The sensor: wheel speed in hard real-time every 10 ms, temperature in soft real-time every 20 ms.
#![no_std]
#![no_main]

use panic_probe as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use boards::clock;
    use cosmic_core::event_layer::{Depth, Policy};
    use cosmic_core::time::Duration;
    use firmware::application::{self, Publisher, Reporter, Subscriber};
    use firmware::cluster::plan::{channels, nodes};
    use firmware::cluster::{self, Temperature, WheelSpeed};
    use firmware::inbox::{Inbox, Storage};
    use firmware::node::Node;
    use firmware::signals;
    use firmware::start::{Parts, start};
    use firmware::tasks::{self, CalendarParts, OtherParts, OutcomeParts, UrgentParts};

    /// A measurement is published this long before its slot.
    const LEAD: Duration = Duration::from_micros(500);
    const TEMPERATURE_PERIOD: Duration = channels::temperature::PERIOD;

    #[shared]
    struct Shared {
        node: Node,
        reporter: Reporter,
    }

    #[local]
    struct Local {
        calendar: CalendarParts,
        urgent: UrgentParts,
        outcomes: OutcomeParts,
        other: OtherParts,
        inbox: Inbox,
    }

    #[init(local = [storage: Storage = Storage::new()])]
    fn init(context: init::Context) -> (Shared, Local) {
        let parts = start(context.device, nodes::sensor::NODE, context.local.storage);
        let Parts { calendar, urgent, outcomes, other, inbox, node, reporter } = parts;
        let spawned = [
            calendar::spawn(),
            etch::spawn(),
            exceptions::spawn(),
            measure_wheel::spawn(),
            measure_temperature::spawn(),
            keep_logbook::spawn(),
        ];
        // Each task is spawned once, so there is room for it.
        defmt::assert!(spawned.iter().all(Result::is_ok));
        (Shared { node, reporter }, Local { calendar, urgent, outcomes, other, inbox })
    }

    #[task(local = [calendar], priority = 7)]
    async fn calendar(context: calendar::Context) {
        tasks::calendar(context.local.calendar).await
    }

    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)]
    fn can_rx_urgent(context: can_rx_urgent::Context) {
        tasks::receive_urgent(context.local.urgent);
    }

    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)]
    fn can_tx(context: can_tx::Context) {
        tasks::report_outcomes(context.local.outcomes);
    }

    #[task(binds = CAN1_RX1, local = [other], priority = 4)]
    fn can_rx_other(context: can_rx_other::Context) {
        tasks::receive_other(context.local.other);
    }

    #[task(local = [inbox], shared = [node], priority = 3)]
    async fn etch(context: etch::Context) {
        tasks::etch(context.local.inbox, context.shared.node).await
    }

    #[task(shared = [node, reporter], priority = 1)]
    async fn exceptions(context: exceptions::Context) {
        application::report_exceptions(context.shared.node, context.shared.reporter).await
    }

    /// One measurement for each slot of the calendar, shortly before it.
    #[task(shared = [node, reporter], priority = 1)]
    async fn measure_wheel(mut context: measure_wheel::Context) {
        let measure_wheel::SharedResources { node, reporter, .. } = &mut context.shared;
        // What is published before the others know the time would be lost.
        application::synchronised(node).await;
        clock::delay_until(clock::now() + cluster::SETTLING).await;
        // Announced shortly before the first event: from then on a slot without one is an error.
        let next = node.lock(|node| node.before_slot(&channels::wheel_speed::SLOT, LEAD, clock::now()));
        clock::delay_until(next).await;
        let publisher = Publisher::announce(&cluster::WHEEL_SPEED, node);
        let mut sequence = 0;
        loop {
            let content = WheelSpeed { sequence, speed: signals::wheel_speed(sequence), valid: true };
            publisher.publish(content, node, reporter);
            sequence = sequence.wrapping_add(1);
            let next = node.lock(|node| node.before_slot(&channels::wheel_speed::SLOT, LEAD, clock::now()));
            clock::delay_until(next).await;
        }
    }

    #[task(shared = [node, reporter], priority = 1)]
    async fn measure_temperature(mut context: measure_temperature::Context) {
        let measure_temperature::SharedResources { node, reporter, .. } = &mut context.shared;
        let publisher = Publisher::announce(&cluster::TEMPERATURE, node);
        let mut next = clock::now();
        let mut sequence = 0;
        loop {
            next = next + TEMPERATURE_PERIOD;
            clock::delay_until(next).await;
            let content = Temperature { sequence, centidegrees: signals::disc_temperature(sequence) };
            publisher.publish(content, node, reporter);
            sequence = sequence.wrapping_add(1);
        }
    }

    #[task(shared = [node, reporter], priority = 1)]
    async fn keep_logbook(mut context: keep_logbook::Context) {
        let keep_logbook::SharedResources { node, reporter, .. } = &mut context.shared;
        let policy = Policy::Fifo(const { Depth::new(16).unwrap() });
        let logbook = Subscriber::subscribe(&cluster::LOGBOOK, policy, node);
        loop {
            let entry = logbook.next(node, reporter).await;
            defmt::debug!("node {}: {}", entry.publisher, entry.content);
        }
    }
}
