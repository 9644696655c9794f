//! The panel: shows the diary.
#![no_std]
#![no_main]

use robot::plan::nodes::panel::NODE;
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
        spawn!(calendar(calendar), events(events), exceptions(), show());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn show(cx: show::Context) { super::show(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Robot>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

async fn show(mut node: impl Mutex<T = Node<Robot>>) {
    let mut diary = MessageSubscriber::subscribe(&DIARY, TIME_OUT, &mut node).expect(PLANNED);
    loop {
        let entry = diary.next(&mut node).await;
        defmt::info!("node {} writes: {}", entry.publisher.get(), entry.content);
    }
}

/// A message is dropped when nothing more comes of it for so long.
const TIME_OUT: Duration = Duration::from_millis(500);
