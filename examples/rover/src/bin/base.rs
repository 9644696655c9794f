//! The base: drives, moves the arm, and writes a journal.
#![no_std]
#![no_main]

use rover::plan::channels::{attitude, battery, drive, gripper, joint, journal, left_wheel, right_wheel};
use rover::plan::contents::{Drive, DriveMode, Joint, Journal};
use rover::plan::nodes::base::NODE;
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
        spawn!(calendar(calendar), events(events), exceptions(), steer(), reach(), write(), left(), right(), tilt(), grip(), power());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn steer(cx: steer::Context) { super::steer(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn reach(cx: reach::Context) { super::reach(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn write(cx: write::Context) { super::write(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn left(cx: left::Context) { follow(&left_wheel::CHANNEL, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn right(cx: right::Context) { follow(&right_wheel::CHANNEL, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn tilt(cx: tilt::Context) { follow(&attitude::CHANNEL, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn grip(cx: grip::Context) { follow(&gripper::CHANNEL, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn power(cx: power::Context) { follow(&battery::CHANNEL, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Rover>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

async fn steer(mut node: impl Mutex<T = Node<Rover>>) {
    let drive = |_: &mut _| Drive { speed: 400, turn: 25, mode: DriveMode::Drive, lights: true };
    publish_in_slots(&drive::CHANNEL, &drive::SLOT, LEAD, &mut node, drive).await.expect(PLANNED);
}

/// One joint after the other.
async fn reach(mut node: impl Mutex<T = Node<Rover>>) {
    let mut joints = (0..6).cycle();
    let joint = |_: &mut _| Joint { number: joints.next().unwrap_or_default(), angle: 0.5 };
    publish_every(&joint::CHANNEL, joint::MIN_INTERARRIVAL * 2, &mut node, joint).await.expect(PLANNED);
}

async fn write(mut node: impl Mutex<T = Node<Rover>>) {
    let at = |_: &mut _| Journal { at: 1_800_000_000, latitude: 52.14, longitude: 11.64, cells: [4_100; 6] };
    publish_message_every(&journal::CHANNEL, journal::MIN_INTERARRIVAL, &mut node, at).await.expect(PLANNED);
}
