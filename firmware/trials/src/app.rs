//! The RTIC app of a node, the same but for node, board and application.

/// An RTIC app: the node of the plan, its type, whether it asks for its id, the function that is its application, and the
/// controller of its board with its interrupts.
#[macro_export]
macro_rules! app {
    ($node:ident, $system:ident, $asks:literal, $work:ident, CAN1) => {
        $crate::app!(@ $node, $system, $asks, $work, [], CAN1_RX0, CAN1_TX, CAN1_SCE, CAN1_RX1);
    };
    ($node:ident, $system:ident, $asks:literal, $work:ident, CAN2) => {
        $crate::app!(@ $node, $system, $asks, $work, [, CAN2], CAN2_RX0, CAN2_TX, CAN2_SCE, CAN2_RX1);
    };
    (@ $node:ident, $system:ident, $asks:literal, $work:ident, [$($can:tt)*], $rx0:ident, $tx:ident, $sce:ident, $rx1:ident) => {
        #[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
        #[rustfmt::skip] // A task is a line.
        mod app {
            use super::*;
            use boards::watchdog::Watchdog;
            #[shared] struct Shared { node: Node<$system> }
            #[local] struct Local { urgent: Urgent<$system>, outcomes: Outcomes<$system>, status: Status<$system>, other: Other<$system> }

            #[init(local = [storage: Storage<$system> = Storage::new()])]
            fn init(cx: init::Context) -> (Shared, Local) {
                let watchdog = cx.device.IWDG;
                let up = start(boards::resources!(cx.device $($can)*), watchdog, &plan::nodes::$node::NODE, $asks, cx.local.storage);
                let Parts { calendar, urgent, outcomes, status, other, events, node } = up.parts;
                spawn!(calendar(calendar), events(events), exceptions(), supervise(up.watchdog), application(up.misdeed));
                (Shared { node }, Local { urgent, outcomes, status, other })
            }

            #[task(shared = [node], priority = 1)] async fn application(cx: application::Context, misdeed: Misdeed) { super::$work(misdeed, cx.shared.node).await }
            #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }
            #[task(shared = [node], priority = 1)] async fn supervise(cx: supervise::Context, watchdog: Watchdog) { super::supervise(watchdog, cx.shared.node).await }

            // The node, one task for each of its parts.
            #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<$system>) { part.run().await }
            #[task(binds = $rx0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
            #[task(binds = $tx, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
            #[task(binds = $sce, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
            #[task(binds = $rx1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
            #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
        }
    };
}
