//! The right motor: turns its wheel as the base demands, and says how far it went.
#![no_std]
#![no_main]

use rover::plan::channels::{drive, right_wheel};
use rover::plan::contents::Wheel;
use rover::plan::nodes::right_motor::NODE;
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
        spawn!(calendar(calendar), events(events), exceptions(), turn(), obey());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn turn(cx: turn::Context) { super::turn(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn obey(cx: obey::Context) { super::obey(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Rover>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

/// In place of an encoder: a millimetre more in each slot.
async fn turn(mut node: impl Mutex<T = Node<Rover>>) {
    let mut distances = (0..).step_by(10);
    let wheel =
        |_: &mut _| Wheel { distance: distances.next().unwrap_or_default(), speed: 50, stalled: false };
    publish_in_slots(&right_wheel::CHANNEL, &right_wheel::SLOT, LEAD, &mut node, wheel).await.expect(PLANNED);
}

async fn obey(node: impl Mutex<T = Node<Rover>>) {
    follow(&drive::CHANNEL, node).await;
}
