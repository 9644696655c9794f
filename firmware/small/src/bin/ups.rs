//! The smallest node: answers requests, in non real-time. A broker names it and its channels. No logs.
#![no_std]
#![no_main]

use cosmic_core::services::NamingService;
use small::{plan::nodes::ups::NODE, *};

#[path = "../last_words.rs"]
mod last_words;

cosmic_core::capacity! {
    Room { slots: 0, channels: 2, subscriptions: 2, events: 4, soft: 0, non_real_time: 4, exceptions: 0, urgent: 0, contexts: false, rates: false }
}

/// What the node is made of.
pub struct Ups;

impl System for Ups {
    type Board = Stm32F405;
    type Capacity = Room;
    type Services = NamingService<2>;
    type Observer = ();
}

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
#[rustfmt::skip] // A task is a line.
mod app {
    use super::*;
    #[shared] struct Shared { node: Node<Ups> }
    #[local] struct Local { outcomes: Outcomes<Ups>, status: Status<Ups>, other: Other<Ups>, events: Events }

    #[init(local = [storage: Storage<Ups> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = Stm32F405::start(boards::resources!(cx.device), &NODE).expect("the plan fits the board");
        let services = NamingService::new(NODE.uid, 0, Stm32F405::now());
        let parts = cosmic_rtic::start_with(board, &NODE, cx.local.storage, services, (), ());
        let Parts { outcomes, status, other, events, node, .. } = parts;
        spawn!(events(), report());
        (Shared { node }, Local { outcomes, status, other, events })
    }

    #[task(shared = [node], priority = 1)] async fn report(cx: report::Context) { answer(&REQUEST, &REPORT, cx.shared.node).await }

    // The node, one task for each of its parts; none for the urgent FIFO, where the frames of a clock would be.
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(local = [events], shared = [node], priority = 3)] async fn events(cx: events::Context) { cx.local.events.run(cx.shared.node).await }
}
