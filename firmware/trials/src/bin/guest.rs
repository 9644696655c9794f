//! The guest: asks for its id.
#![no_std]
#![no_main]

use trials::{plan::nodes::guest::NODE, *};

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
#[rustfmt::skip] // A task is a line.
mod app {
    use super::*;
    use boards::watchdog::Watchdog;
    #[shared] struct Shared { node: Node<Trial> }
    #[local] struct Local { urgent: Urgent<Trial>, outcomes: Outcomes<Trial>, status: Status<Trial>, other: Other<Trial> }

    #[init(local = [storage: Storage<Trial> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let up = start(boards::resources!(cx.device), cx.device.IWDG, &NODE, true, cx.local.storage);
        let Parts { calendar, urgent, outcomes, status, other, events, node } = up.parts;
        spawn!(calendar(calendar), events(events), exceptions(), supervise(up.watchdog), count(up.misdeed));
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn count(cx: count::Context, misdeed: Misdeed) { super::count(misdeed, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn supervise(cx: supervise::Context, watchdog: Watchdog) { super::supervise(watchdog, cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Trial>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}
