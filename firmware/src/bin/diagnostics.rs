//! Diagnostics: observes the others, keeps a logbook in non real-time, and publishes so much of the
//! suspension in soft real-time that deadlines matter.
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
    use firmware::cluster::{self, LogEntry, Suspension};
    use firmware::inbox::{Inbox, Storage};
    use firmware::node::Node;
    use firmware::signals;
    use firmware::start::{Parts, start};
    use firmware::tasks::{self, CalendarParts, OtherParts, OutcomeParts, UrgentParts};

    const SUSPENSION_PERIOD: Duration = channels::suspension::PERIOD;
    /// Codes of the logbook.
    const SPEED: u16 = 1;
    const FORCE: u16 = 2;
    const LOGBOOK_PERIOD: Duration = channels::logbook::MIN_INTERARRIVAL;

    /// For each subscription.
    const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());

    #[shared]
    struct Shared {
        node: Node,
        reporter: Reporter,
        /// What was observed last: a code of the logbook, and the value.
        seen: (u16, u16),
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
        let parts = start(context.device, nodes::diagnostics::NODE, context.local.storage);
        let Parts { calendar, urgent, outcomes, other, inbox, node, reporter } = parts;
        let spawned = [
            calendar::spawn(),
            etch::spawn(),
            exceptions::spawn(),
            measure_suspension::spawn(),
            write_logbook::spawn(),
            watch_wheel::spawn(),
            watch_brake::spawn(),
        ];
        // Each task is spawned once, so there is room for it.
        defmt::assert!(spawned.iter().all(Result::is_ok));
        (Shared { node, reporter, seen: (SPEED, 0) }, Local { calendar, urgent, outcomes, other, inbox })
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

    #[task(shared = [node, reporter], priority = 1)]
    async fn measure_suspension(mut context: measure_suspension::Context) {
        let measure_suspension::SharedResources { node, reporter, .. } = &mut context.shared;
        let suspension = Publisher::announce(&cluster::SUSPENSION, node);
        let mut next = clock::now();
        let mut sequence = 0;
        loop {
            next = next + SUSPENSION_PERIOD;
            clock::delay_until(next).await;
            let (travel, velocity) = signals::suspension(sequence);
            suspension.publish(Suspension { sequence, travel, velocity }, node, reporter);
            sequence = sequence.wrapping_add(1);
        }
    }

    /// Logs what was observed last.
    #[task(shared = [node, reporter, seen], priority = 1)]
    async fn write_logbook(mut context: write_logbook::Context) {
        let write_logbook::SharedResources { node, reporter, seen, .. } = &mut context.shared;
        let logbook = Publisher::announce(&cluster::LOGBOOK, node);
        let mut next = clock::now();
        let mut sequence = 0;
        loop {
            next = next + LOGBOOK_PERIOD;
            clock::delay_until(next).await;
            let (code, value) = seen.lock(|seen| *seen);
            logbook.publish(LogEntry { sequence, code, value }, node, reporter);
            sequence = sequence.wrapping_add(1);
        }
    }

    #[task(shared = [node, reporter, seen], priority = 1)]
    async fn watch_wheel(mut context: watch_wheel::Context) {
        let watch_wheel::SharedResources { node, reporter, seen, .. } = &mut context.shared;
        application::synchronised(node).await;
        let wheel_speed = Subscriber::subscribe(&cluster::WHEEL_SPEED, QUEUE, node);
        loop {
            let event = wheel_speed.next(node, reporter).await;
            seen.lock(|seen| *seen = (SPEED, event.content.speed));
        }
    }

    #[task(shared = [node, reporter, seen], priority = 1)]
    async fn watch_brake(mut context: watch_brake::Context) {
        let watch_brake::SharedResources { node, reporter, seen, .. } = &mut context.shared;
        let brake_force = Subscriber::subscribe(&cluster::BRAKE_FORCE, QUEUE, node);
        loop {
            let event = brake_force.next(node, reporter).await;
            seen.lock(|seen| *seen = (FORCE, event.content.force));
        }
    }
}
