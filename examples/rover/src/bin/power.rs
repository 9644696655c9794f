//! The power supply: says how full the battery is, and keeps the journal.
#![no_std]
#![no_main]

use rover::plan::channels::{battery, journal};
use rover::plan::contents::Battery;
use rover::plan::nodes::power::NODE;
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
        spawn!(calendar(calendar), events(events), exceptions(), measure(), keep());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn measure(cx: measure::Context) { super::measure(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn keep(cx: keep::Context) { super::keep(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Rover>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

async fn measure(mut node: impl Mutex<T = Node<Rover>>) {
    let battery = |_: &mut _| Battery { voltage: 24_600, current: -320, temperature: 65, charge: 87 };
    publish_every(&battery::CHANNEL, battery::PERIOD, &mut node, battery).await.expect(PLANNED);
}

async fn keep(mut node: impl Mutex<T = Node<Rover>>) {
    let mut journal = MessageSubscriber::subscribe(&journal::CHANNEL, TIME_OUT, &mut node).expect(PLANNED);
    loop {
        let entry = journal.next(&mut node).await;
        defmt::info!("node {} was at latitude {}", entry.publisher.get(), entry.content.latitude);
    }
}

/// A message is dropped when nothing more comes of it for so long.
const TIME_OUT: Duration = Duration::from_millis(500);
