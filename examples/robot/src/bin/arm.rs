//! The arm: measures the angle of its joint every 5 ms, and how hot its motor is.
#![no_std]
#![no_main]

use panic_probe as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
mod app {
    use boards::Stm32F405;
    use cosmic_rtic::prelude::*;
    use robot::plan::{channels, nodes::arm};
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
        let board = Stm32F405::start(cx.device, &arm::NODE).expect("the plan fits the board");
        let parts = cosmic_rtic::start(board, &arm::NODE, cx.local.storage).expect("the plan has a clock");
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        let tasks = [
            calendar::spawn(),
            events::spawn(),
            exceptions::spawn(),
            joint::spawn(),
            motor::spawn(),
            follow::spawn(),
        ];
        assert!(tasks.iter().all(Result::is_ok));
        (Shared { node }, Local { calendar, urgent, outcomes, status, other, events })
    }

    /// An angle for each slot of the calendar, measured shortly before it.
    #[task(shared = [node], priority = 1)]
    async fn joint(mut cx: joint::Context) {
        let node = &mut cx.shared.node;
        settled(node).await;
        before_slot(&channels::joint_angle::SLOT, LEAD, node).await;
        let angle = Publisher::announce(&JOINT_ANGLE, node).expect("the plan has the channel");
        // In place of a sensor: a degree forth in a second.
        for step in 0_i32.. {
            if let Err(error) = angle.publish(JointAngle { millidegrees: 5 * step }, node) {
                defmt::warn!("angle {} was not published: {}", step, error);
            }
            before_slot(&channels::joint_angle::SLOT, LEAD, node).await;
        }
    }

    #[task(shared = [node], priority = 1)]
    async fn motor(mut cx: motor::Context) {
        let node = &mut cx.shared.node;
        let heat = Publisher::announce(&MOTOR_HEAT, node).expect("the plan has the channel");
        let mut ticker = Ticker::<Stm32F405>::every(channels::motor_heat::PERIOD);
        loop {
            ticker.tick().await;
            if let Err(error) = heat.publish(MotorHeat { centidegrees: 4_150 }, node) {
                defmt::warn!("the heat was not published: {}", error);
            }
        }
    }

    /// Where the controller wants the joint.
    #[task(shared = [node], priority = 1)]
    async fn follow(mut cx: follow::Context) {
        let node = &mut cx.shared.node;
        settled(node).await;
        let set_points = Subscriber::subscribe(&SET_POINT, QUEUE, node).expect("the plan has the channel");
        let mut count = 0_u32;
        loop {
            let event = set_points.next(node).await;
            count += 1;
            if count.is_multiple_of(EVENTS_IN_A_SECOND) {
                defmt::info!("{} set points, the last {}", count, event.content);
            }
        }
    }

    #[task(shared = [node], priority = 1)]
    async fn exceptions(mut cx: exceptions::Context) {
        loop {
            defmt::warn!("{}", next_exception(&mut cx.shared.node).await);
        }
    }

    /// A measurement is published this long before its slot.
    const LEAD: Duration = Duration::from_micros(300);
    const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());
    const EVENTS_IN_A_SECOND: u32 = 100;

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
