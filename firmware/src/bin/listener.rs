//! A listener in place of the brake, without logs and records: what the middleware alone costs a node is measured here
//! (`sim/demo/tests/cost`). A pin shows when the application has an event.
#![no_std]
#![no_main]

use cosmic_rtt as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use boards::stm32f4::MeasuringPoint;
    use cosmic_core::event_layer::{Channel, Content};
    use cosmic_core::services::ClockService;
    use cosmic_rtic::prelude::*;
    use firmware::cluster::plan::channels::{suspension, temperature, wheel_speed};
    use firmware::cluster::plan::{Capacities, nodes};
    use firmware::vehicle::Board;

    /// For each subscription.
    const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());

    /// What the node is made of.
    pub struct Listener;

    impl System for Listener {
        type Board = Board;
        type Capacity = Capacities;
        type Services = ClockService;
        type Observer = ();
    }

    #[shared]
    struct Shared {
        node: Node<Listener>,
        delivered: MeasuringPoint<14>,
    }

    #[local]
    struct Local {
        calendar: Calendar<Listener>,
        urgent: Urgent<Listener>,
        outcomes: Outcomes<Listener>,
        status: Status<Listener>,
        other: Other<Listener>,
        events: Events,
    }

    #[init(local = [storage: Storage<Listener> = Storage::new()])]
    fn init(context: init::Context) -> (Shared, Local) {
        let node = &nodes::brake::NODE;
        let mut board =
            Board::start(boards::resources!(context.device), node).expect("the plan fits the board");
        let delivered = board.points.take().expect("nobody else takes them").delivered;
        let parts = cosmic_rtic::start(board, node, context.local.storage).expect("the plan has a clock");
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        let spawned = [
            calendar::spawn(),
            events::spawn(),
            hear_wheel_speed::spawn(),
            hear_temperature::spawn(),
            hear_suspension::spawn(),
        ];
        assert!(spawned.iter().all(Result::is_ok));
        (Shared { node, delivered }, Local { calendar, urgent, outcomes, status, other, events })
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

    #[task(shared = [node, delivered], priority = 1)]
    async fn hear_wheel_speed(mut context: hear_wheel_speed::Context) {
        let hear_wheel_speed::SharedResources { node, delivered, .. } = &mut context.shared;
        hear(&wheel_speed::CHANNEL, node, delivered).await;
    }

    #[task(shared = [node, delivered], priority = 1)]
    async fn hear_temperature(mut context: hear_temperature::Context) {
        let hear_temperature::SharedResources { node, delivered, .. } = &mut context.shared;
        hear(&temperature::CHANNEL, node, delivered).await;
    }

    #[task(shared = [node, delivered], priority = 1)]
    async fn hear_suspension(mut context: hear_suspension::Context) {
        let hear_suspension::SharedResources { node, delivered, .. } = &mut context.shared;
        hear(&suspension::CHANNEL, node, delivered).await;
    }

    /// Takes each event of a channel.
    async fn hear<C: Content>(
        channel: &'static Channel<C>,
        node: &mut impl Mutex<T = Node<Listener>>,
        delivered: &mut impl Mutex<T = MeasuringPoint<14>>,
    ) {
        let Ok(subscriber) = Subscriber::subscribe(channel, QUEUE, &mut *node) else { return };
        loop {
            let event = subscriber.next(&mut *node).await;
            core::hint::black_box(event.content);
            delivered.lock(MeasuringPoint::toggle);
        }
    }
}
