//! The controller: answers each second angle with a set point, and watches the motor.
#![no_std]
#![no_main]

use robot::plan::{channels::set_point, nodes::controller::NODE};
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
        spawn!(calendar(calendar), events(events), exceptions(), steer(), watch());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn steer(cx: steer::Context) { super::steer(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn watch(cx: watch::Context) { super::watch(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Robot>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

/// A set point for each of its slots, from the angle that was delivered 500 µs before it.
async fn steer(mut node: impl Mutex<T = Node<Robot>>) {
    settled(&mut node).await;
    let angles = Subscriber::subscribe(&JOINT_ANGLE, Policy::Latest, &mut node).expect(PLANNED);
    let mut angle = angles.next(&mut node).await.content;
    let answer = |node: &mut _| {
        angle = angles.try_next(node).map_or(angle, |event| event.content);
        SetPoint { angle: angle.angle + 1_000, speed: 100 }
    };
    publish_in_slots(&SET_POINT, &set_point::SLOT, LEAD, &mut node, answer).await.expect(PLANNED);
}

/// Writes into the diary every second how hot the motor is.
async fn watch(mut node: impl Mutex<T = Node<Robot>>) {
    let heat = Subscriber::subscribe(&MOTOR_HEAT, QUEUE, &mut node).expect(PLANNED);
    let mut diary = MessagePublisher::announce(&DIARY, &mut node).expect(PLANNED);
    for count in 1_u32.. {
        let MotorHeat { temperature } = heat.next(&mut node).await.content;
        if count.is_multiple_of(50) {
            let entry = Bytes::text(format_args!("motor at {temperature} after {count} events"));
            let sent = diary.publish(&entry.unwrap_or(Bytes::EMPTY), &mut node).await;
            sent.unwrap_or_else(|error| defmt::warn!("the diary was not sent: {}", error));
        }
    }
}
