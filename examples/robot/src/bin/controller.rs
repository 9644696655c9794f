//! The controller: answers each second angle with a set point, and watches the motor.
#![no_std]
#![no_main]

use panic_probe as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use boards::Stm32F405;
    use cosmic_rtic::prelude::*;
    use robot::plan::{channels, nodes::controller};
    use robot::*;

    #[shared]
    struct Shared {
        node: Node<Robot>,
    }

    #[local]
    struct Local {
        calendar: Calendar<Robot>,
        urgent: Urgent<Robot>,
        outcomes: Outcomes<Robot>,
        status: Status<Robot>,
        other: Other<Robot>,
        events: Events,
    }

    #[init(local = [storage: Storage<Robot> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        rtt_target::rtt_init_defmt!();
        let board = Stm32F405::start(cx.device, &controller::NODE).expect("the plan fits the board");
        let parts =
            cosmic_rtic::start(board, &controller::NODE, cx.local.storage).expect("the plan has a clock");
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        let tasks = [calendar::spawn(), events::spawn(), exceptions::spawn(), steer::spawn(), watch::spawn()];
        assert!(tasks.iter().all(Result::is_ok));
        (Shared { node }, Local { calendar, urgent, outcomes, status, other, events })
    }

    /// A set point for each of its slots, from the angle that was delivered 500 µs before it.
    #[task(shared = [node], priority = 1)]
    async fn steer(mut cx: steer::Context) {
        let node = &mut cx.shared.node;
        settled(node).await;
        let angles =
            Subscriber::subscribe(&JOINT_ANGLE, Policy::Latest, node).expect("the plan has the channel");
        let mut angle = angles.next(node).await.content;
        before_slot(&channels::set_point::SLOT, LEAD, node).await;
        let set_point = Publisher::announce(&SET_POINT, node).expect("the plan has the channel");
        loop {
            angle = angles.try_next(node).map_or(angle, |event| event.content);
            let answer = SetPoint { millidegrees: angle.millidegrees + 1_000, speed: 100 };
            if let Err(error) = set_point.publish(answer, node) {
                defmt::warn!("the set point was not published: {}", error);
            }
            before_slot(&channels::set_point::SLOT, LEAD, node).await;
        }
    }

    /// Says every second how hot the motor is, and where the joint.
    #[task(shared = [node], priority = 1)]
    async fn watch(mut cx: watch::Context) {
        let node = &mut cx.shared.node;
        let heat = Subscriber::subscribe(&MOTOR_HEAT, QUEUE, node).expect("the plan has the channel");
        let mut count = 0_u32;
        loop {
            let MotorHeat { centidegrees } = heat.next(node).await.content;
            count += 1;
            if count.is_multiple_of(EVENTS_IN_A_SECOND) {
                defmt::info!("{} events of motor_heat, the last {}", count, centidegrees);
            }
        }
    }

    #[task(shared = [node], priority = 1)]
    async fn exceptions(mut cx: exceptions::Context) {
        loop {
            defmt::warn!("{}", next_exception(&mut cx.shared.node).await);
        }
    }

    /// A set point is published this long before its slot.
    const LEAD: Duration = Duration::from_micros(300);
    const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());
    const EVENTS_IN_A_SECOND: u32 = 50;

    // The node, one task for each of its parts.

    #[task(local = [calendar], priority = 7)]
    async fn calendar(cx: calendar::Context) {
        cx.local.calendar.run().await
    }

    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)]
    fn can_urgent(cx: can_urgent::Context) {
        cx.local.urgent.run();
    }

    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)]
    fn can_sent(cx: can_sent::Context) {
        cx.local.outcomes.run();
    }

    #[task(binds = CAN1_SCE, local = [status], priority = 5)]
    fn can_status(cx: can_status::Context) {
        cx.local.status.run();
    }

    #[task(binds = CAN1_RX1, local = [other], priority = 4)]
    fn can_other(cx: can_other::Context) {
        cx.local.other.run();
    }

    #[task(local = [events], shared = [node], priority = 3)]
    async fn events(cx: events::Context) {
        cx.local.events.run(cx.shared.node).await
    }
}
