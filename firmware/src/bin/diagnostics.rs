//! Diagnostics: observes the others, keeps a logbook in non real-time, and publishes so much of the
//! suspension in soft real-time that deadlines matter.
#![no_std]
#![no_main]

use cosmic_rtt as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use cosmic_rtic::prelude::*;
    use firmware::cluster::plan::channels::{brake_force, logbook, suspension, wheel_speed};
    use firmware::cluster::plan::contents::{LogEntry, LogEntryCode, Suspension};
    use firmware::cluster::plan::nodes;
    use firmware::signals;
    use firmware::vehicle::{Board, Vehicle, planned, start};

    const SUSPENSION_PERIOD: Duration = suspension::PERIOD;
    const LOGBOOK_PERIOD: Duration = logbook::MIN_INTERARRIVAL;

    /// For each subscription.
    const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());

    #[shared]
    struct Shared {
        node: Node<Vehicle>,
        /// What was observed last: what is logged of it, and the value.
        seen: (LogEntryCode, u16),
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
        let parts =
            start(boards::resources!(context.device), nodes::diagnostics::NODE, context.local.storage);
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        let spawned = [
            calendar::spawn(),
            events::spawn(),
            exceptions::spawn(),
            measure_suspension::spawn(),
            write_logbook::spawn(),
            watch_wheel::spawn(),
            watch_brake::spawn(),
        ];
        // Each task is spawned once, so there is room for it.
        defmt::assert!(spawned.iter().all(Result::is_ok));
        (
            Shared { node, seen: (LogEntryCode::Speed, 0) },
            Local { calendar, urgent, outcomes, status, other, events },
        )
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

    #[task(shared = [node], priority = 1)]
    async fn measure_suspension(mut context: measure_suspension::Context) {
        let node = &mut context.shared.node;
        let Some(suspension) = planned(Publisher::announce(&suspension::CHANNEL, node)) else { return };
        let mut ticker = Ticker::<Board>::every(SUSPENSION_PERIOD);
        let mut sequence = 0;
        loop {
            ticker.tick().await;
            let (travel, velocity) = signals::suspension(sequence);
            let _ = suspension.publish(Suspension { sequence, travel, velocity }, node);
            sequence = sequence.wrapping_add(1);
        }
    }

    /// Logs what was observed last.
    #[task(shared = [node, seen], priority = 1)]
    async fn write_logbook(mut context: write_logbook::Context) {
        let write_logbook::SharedResources { node, seen, .. } = &mut context.shared;
        let Some(logbook) = planned(Publisher::announce(&logbook::CHANNEL, node)) else { return };
        let mut ticker = Ticker::<Board>::every(LOGBOOK_PERIOD);
        let mut sequence = 0;
        loop {
            ticker.tick().await;
            let (code, value) = seen.lock(|seen| *seen);
            let _ = logbook.publish(LogEntry { sequence, code, value }, node);
            sequence = sequence.wrapping_add(1);
        }
    }

    #[task(shared = [node, seen], priority = 1)]
    async fn watch_wheel(mut context: watch_wheel::Context) {
        let watch_wheel::SharedResources { node, seen, .. } = &mut context.shared;
        // The publisher waits for it, too: before, there is nothing that could be missed.
        settled(node).await;
        let Some(wheel_speed) = planned(Subscriber::subscribe(&wheel_speed::CHANNEL, QUEUE, node)) else {
            return;
        };
        loop {
            let event = wheel_speed.next(node).await;
            seen.lock(|seen| *seen = (LogEntryCode::Speed, event.content.speed));
        }
    }

    #[task(shared = [node, seen], priority = 1)]
    async fn watch_brake(mut context: watch_brake::Context) {
        let watch_brake::SharedResources { node, seen, .. } = &mut context.shared;
        let Some(brake_force) = planned(Subscriber::subscribe(&brake_force::CHANNEL, QUEUE, node)) else {
            return;
        };
        loop {
            let event = brake_force.next(node).await;
            seen.lock(|seen| *seen = (LogEntryCode::Force, event.content.force));
        }
    }
}
