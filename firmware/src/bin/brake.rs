//! The brake: applies a force for every wheel speed, and tells which.
#![no_std]
#![no_main]

use panic_probe as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use cosmic_core::event_layer::{Depth, Policy};
    use firmware::application::{self, Publisher, Reporter, Subscriber};
    use firmware::cluster::plan::nodes;
    use firmware::cluster::{self, BrakeForce};
    use firmware::inbox::{Inbox, Storage};
    use firmware::node::Node;
    use firmware::signals;
    use firmware::start::{Parts, start};
    use firmware::tasks::{self, CalendarParts, OtherParts, OutcomeParts, UrgentParts};

    /// For each subscription.
    const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());

    #[shared]
    struct Shared {
        node: Node,
        reporter: Reporter,
        /// The disc's temperature as last heard, in hundredths of a degree Celsius.
        disc: i16,
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
        let parts = start(context.device, nodes::brake::NODE, context.local.storage);
        let Parts { calendar, urgent, outcomes, other, inbox, node, reporter } = parts;
        let spawned = [
            calendar::spawn(),
            etch::spawn(),
            exceptions::spawn(),
            brake::spawn(),
            watch_temperature::spawn(),
            watch_suspension::spawn(),
        ];
        // Each task is spawned once, so there is room for it.
        defmt::assert!(spawned.iter().all(Result::is_ok));
        (Shared { node, reporter, disc: 0 }, Local { calendar, urgent, outcomes, other, inbox })
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

    /// Brakes as the wheel speed demands, less when the disc is hot.
    #[task(shared = [node, reporter, disc], priority = 1)]
    async fn brake(mut context: brake::Context) {
        let brake::SharedResources { node, reporter, disc, .. } = &mut context.shared;
        let brake_force = Publisher::announce(&cluster::BRAKE_FORCE, node);
        application::synchronised(node).await;
        let wheel_speed = Subscriber::subscribe(&cluster::WHEEL_SPEED, QUEUE, node);
        let mut sequence = 0;
        loop {
            let event = wheel_speed.next(node, reporter).await;
            let centidegrees = disc.lock(|disc| *disc);
            let content = BrakeForce {
                sequence,
                force: signals::brake_force(event.content.speed, centidegrees),
                based_on: event.content.sequence as u16,
            };
            brake_force.publish(content, node, reporter);
            sequence = sequence.wrapping_add(1);
        }
    }

    #[task(shared = [node, reporter, disc], priority = 1)]
    async fn watch_temperature(mut context: watch_temperature::Context) {
        let watch_temperature::SharedResources { node, reporter, disc, .. } = &mut context.shared;
        let temperature = Subscriber::subscribe(&cluster::TEMPERATURE, QUEUE, node);
        loop {
            let event = temperature.next(node, reporter).await;
            disc.lock(|disc| *disc = event.content.centidegrees);
        }
    }

    #[task(shared = [node, reporter], priority = 1)]
    async fn watch_suspension(mut context: watch_suspension::Context) {
        let watch_suspension::SharedResources { node, reporter, .. } = &mut context.shared;
        let suspension = Subscriber::subscribe(&cluster::SUSPENSION, QUEUE, node);
        loop {
            let event = suspension.next(node, reporter).await;
            defmt::trace!("{}", event.content);
        }
    }
}
