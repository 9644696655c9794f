//! The arm: measures the angle of its joint every 5 ms, and how hot its motor is.
#![no_std]
#![no_main]

use robot::plan::channels::{joint_angle, motor_heat};
use robot::plan::nodes::arm::NODE;
use robot::*;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
#[rustfmt::skip] // A task is a line.
mod app {
    use super::*;
    #[shared] struct Shared { node: Node<Robot> }
    #[local] struct Local { urgent: Urgent<Robot>, outcomes: Outcomes<Robot>, status: Status<Robot>, other: Other<Robot> }

    #[init(local = [storage: Storage<Robot> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = board(boards::resources!(cx.device), &NODE);
        let Parts { calendar, urgent, outcomes, status, other, events, node } = start(board, &NODE, cx.local.storage);
        spawn!(calendar(calendar), events(events), exceptions(), joint(), motor(), follow());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn joint(cx: joint::Context) { super::joint(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn motor(cx: motor::Context) { super::motor(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn follow(cx: follow::Context) { super::follow(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Robot>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

/// An angle for each slot of the calendar, measured shortly before it. In place of a sensor: a degree forth in a second.
async fn joint(mut node: impl Mutex<T = Node<Robot>>) {
    let mut steps = 0..;
    let angle = |_: &mut _| JointAngle { angle: 5 * steps.next().unwrap_or_default() };
    publish_in_slots(&JOINT_ANGLE, &joint_angle::SLOT, LEAD, &mut node, angle).await.expect(PLANNED);
}

async fn motor(mut node: impl Mutex<T = Node<Robot>>) {
    let heat = |_: &mut _| MotorHeat { temperature: 4_150 };
    publish_every(&MOTOR_HEAT, motor_heat::PERIOD, &mut node, heat).await.expect(PLANNED);
}

/// Where the controller wants the joint.
async fn follow(mut node: impl Mutex<T = Node<Robot>>) {
    settled(&mut node).await;
    let set_points = Subscriber::subscribe(&SET_POINT, QUEUE, &mut node).expect(PLANNED);
    for count in 1_u32.. {
        let event = set_points.next(&mut node).await;
        if count.is_multiple_of(100) {
            defmt::info!("{} set points, the last {}", count, event.content);
        }
    }
}
