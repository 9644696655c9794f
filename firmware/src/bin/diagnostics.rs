//! Diagnostics: observes the others, keeps a logbook in non real-time, and publishes so much of the
//! suspension in soft real-time that deadlines matter.
#![no_std]
#![no_main]

use panic_probe as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use boards::clock;
    use cosmic_core::event_layer::{Depth, Policy};
    use cosmic_core::protocol::Rank;
    use cosmic_core::time::Duration;
    use firmware::application::{self, Publisher, Reporter, Subscriber};
    use firmware::cluster::{self, BrakeForce, LogEntry, Suspension, WheelSpeed};
    use firmware::inbox::{Inbox, Storage};
    use firmware::node::{Buffers, Node};
    use firmware::signals;
    use firmware::start::{Parts, start};
    use firmware::tasks::{self, CalendarParts, OtherParts, OutcomeParts, UrgentParts};

    const SUSPENSION_PERIOD: Duration = Duration::from_millis(1);
    /// Codes of the logbook.
    const SPEED: u16 = 1;
    const FORCE: u16 = 2;
    const LOGBOOK_PERIOD: Duration = Duration::from_millis(4);

    /// In the succession of time masters.
    const RANK: Rank = Rank::new(2).unwrap();

    #[shared]
    struct Shared {
        buffers: Buffers,
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
        suspension: Publisher<Suspension>,
        logbook: Publisher<LogEntry>,
        wheel_speed: Subscriber<WheelSpeed>,
        brake_force: Subscriber<BrakeForce>,
    }

    #[init(local = [storage: Storage = Storage::new()])]
    fn init(context: init::Context) -> (Shared, Local) {
        let parts = start(context.device, cluster::DIAGNOSTICS, RANK, context.local.storage);
        let Parts { calendar, urgent, outcomes, other, inbox, mut node, mut buffers, reporter } = parts;
        let suspension = Publisher::announce(&cluster::SUSPENSION, &mut node, &mut buffers);
        let logbook = Publisher::announce(&cluster::LOGBOOK, &mut node, &mut buffers);
        let queue = Policy::Fifo(const { Depth::new(8).unwrap() });
        let wheel_speed = Subscriber::subscribe(&cluster::WHEEL_SPEED, queue, &mut node, &mut buffers);
        let brake_force = Subscriber::subscribe(&cluster::BRAKE_FORCE, queue, &mut node, &mut buffers);

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
        (
            Shared { buffers, node, reporter, seen: (SPEED, 0) },
            Local { calendar, urgent, outcomes, other, inbox, suspension, logbook, wheel_speed, brake_force },
        )
    }

    #[task(local = [calendar], shared = [buffers], priority = 7)]
    async fn calendar(context: calendar::Context) {
        tasks::calendar(context.local.calendar, context.shared.buffers).await
    }

    #[task(binds = CAN1_RX0, local = [urgent], shared = [buffers], priority = 6)]
    fn can_rx_urgent(context: can_rx_urgent::Context) {
        tasks::receive_urgent(context.local.urgent, context.shared.buffers);
    }

    #[task(binds = CAN1_TX, local = [outcomes], shared = [buffers], priority = 5)]
    fn can_tx(context: can_tx::Context) {
        tasks::report_outcomes(context.local.outcomes, context.shared.buffers);
    }

    #[task(binds = CAN1_RX1, local = [other], priority = 4)]
    fn can_rx_other(context: can_rx_other::Context) {
        tasks::receive_other(context.local.other);
    }

    #[task(local = [inbox], shared = [node, buffers], priority = 3)]
    async fn etch(context: etch::Context) {
        tasks::etch(context.local.inbox, context.shared.node, context.shared.buffers).await
    }

    #[task(shared = [node, reporter], priority = 1)]
    async fn exceptions(context: exceptions::Context) {
        application::report_exceptions(context.shared.node, context.shared.reporter).await
    }

    #[task(local = [suspension], shared = [node, buffers, reporter], priority = 1)]
    async fn measure_suspension(mut context: measure_suspension::Context) {
        let shared = &mut context.shared;
        let mut next = clock::now();
        let mut sequence = 0;
        loop {
            next = next + SUSPENSION_PERIOD;
            clock::delay_until(next).await;
            let (travel, velocity) = signals::suspension(sequence);
            let content = Suspension { sequence, travel, velocity };
            let publisher = &context.local.suspension;
            publisher.publish(content, &mut shared.node, &mut shared.buffers, &mut shared.reporter);
            sequence = sequence.wrapping_add(1);
        }
    }

    /// Logs what was observed last.
    #[task(local = [logbook], shared = [node, buffers, reporter, seen], priority = 1)]
    async fn write_logbook(mut context: write_logbook::Context) {
        let shared = &mut context.shared;
        let mut next = clock::now();
        let mut sequence = 0;
        loop {
            next = next + LOGBOOK_PERIOD;
            clock::delay_until(next).await;
            let (code, value) = shared.seen.lock(|seen| *seen);
            let publisher = &context.local.logbook;
            let content = LogEntry { sequence, code, value };
            publisher.publish(content, &mut shared.node, &mut shared.buffers, &mut shared.reporter);
            sequence = sequence.wrapping_add(1);
        }
    }

    #[task(local = [wheel_speed], shared = [node, reporter, seen], priority = 1)]
    async fn watch_wheel(mut context: watch_wheel::Context) {
        let shared = &mut context.shared;
        loop {
            let event = context.local.wheel_speed.next(&mut shared.node, &mut shared.reporter).await;
            shared.seen.lock(|seen| *seen = (SPEED, event.content.speed));
        }
    }

    #[task(local = [brake_force], shared = [node, reporter, seen], priority = 1)]
    async fn watch_brake(mut context: watch_brake::Context) {
        let shared = &mut context.shared;
        loop {
            let event = context.local.brake_force.next(&mut shared.node, &mut shared.reporter).await;
            shared.seen.lock(|seen| *seen = (FORCE, event.content.force));
        }
    }
}
