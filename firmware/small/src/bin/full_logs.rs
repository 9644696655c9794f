//! A node with everything but a broker: answers in all three classes, and logs what it is told.
#![no_std]
#![no_main]

use cosmic_core::services::{FollowingServices, News};
use cosmic_rtic::Log;
use small::plan::{channels::torque, nodes::full_logs::NODE};
use small::*;

cosmic_core::capacity! {
    Room { slots: 2, channels: 8, subscriptions: 3, events: 8, soft: 3, non_real_time: 3, contexts: false }
}

/// What the node is made of.
pub struct Full;

impl System for Full {
    type Board = Stm32F405;
    type Capacity = Room;
    type Services = FollowingServices<6, 12, 3, 8, 8>;
    type Observer = Log;
}

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
#[rustfmt::skip] // A task is a line.
mod app {
    use super::*;
    #[shared] struct Shared { node: Node<Full> }
    #[local] struct Local { calendar: Calendar<Full>, urgent: Urgent<Full>, outcomes: Outcomes<Full>, status: Status<Full>, other: Other<Full>, events: Events }

    #[init(local = [storage: Storage<Full> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        cosmic_rtt::start!(1024, cosmic_rtic::EVENT_PRIORITY);
        let board = Stm32F405::start(boards::resources!(cx.device), &NODE).expect("the plan fits the board");
        let parts = cosmic_rtic::start_observed(board, &NODE, cx.local.storage, Log, ()).expect("the plan has a clock");
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        spawn!(calendar(), events(), exceptions(), news(), turn(), heat(), report());
        (Shared { node }, Local { calendar, urgent, outcomes, status, other, events })
    }

    #[task(shared = [node], priority = 1)] async fn turn(cx: turn::Context) { follow(const { &torque::channel() }, &torque::SLOT, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn heat(cx: heat::Context) { answer(&WISH, &HEAT, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn report(cx: report::Context) { answer(&REQUEST, &REPORT, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn news(cx: news::Context) { tell(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(local = [calendar], priority = 7)] async fn calendar(cx: calendar::Context) { cx.local.calendar.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(local = [events], shared = [node], priority = 3)] async fn events(cx: events::Context) { cx.local.events.run(cx.shared.node).await }
}

async fn tell(mut node: impl Mutex<T = Node<Full>>) {
    loop {
        match next_news(&mut node).await {
            News::Configuration(event) => defmt::info!("{}", event),
            News::Clock(event) => defmt::info!("{}", event),
            News::Member(event) => defmt::info!("{}", event),
            _ => {}
        }
    }
}
