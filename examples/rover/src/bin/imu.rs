//! The inertial unit: says how the rover stands.
#![no_std]
#![no_main]

use rover::plan::channels::{attitude, left_wheel, right_wheel};
use rover::plan::contents::Attitude;
use rover::plan::nodes::imu::NODE;
use rover::*;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
#[rustfmt::skip] // A task is a line.
mod app {
    use super::*;
    #[shared] struct Shared { node: Node<Rover> }
    #[local] struct Local { urgent: Urgent<Rover>, outcomes: Outcomes<Rover>, status: Status<Rover>, other: Other<Rover> }

    #[init(local = [storage: Storage<Rover> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = board(boards::resources!(cx.device), &NODE);
        let Parts { calendar, urgent, outcomes, status, other, events, node } = start(board, &NODE, cx.local.storage);
        spawn!(calendar(calendar), events(events), exceptions(), measure(), left(), right());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn measure(cx: measure::Context) { super::measure(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn left(cx: left::Context) { super::left(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn right(cx: right::Context) { super::right(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Rover>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

/// In place of a sensor: the rover turns slowly.
async fn measure(mut node: impl Mutex<T = Node<Rover>>) {
    let mut angles = (0..18_000).cycle();
    let attitude = |_: &mut _| {
        let yaw = angles.next().unwrap_or_default();
        Attitude { roll: 0, pitch: 150, yaw, quality: 9, calibrated: true }
    };
    publish_every(&attitude::CHANNEL, attitude::PERIOD, &mut node, attitude).await.expect(PLANNED);
}

async fn left(node: impl Mutex<T = Node<Rover>>) {
    follow(&left_wheel::CHANNEL, node).await;
}

async fn right(node: impl Mutex<T = Node<Rover>>) {
    follow(&right_wheel::CHANNEL, node).await;
}
