//! Names the others, asks them in all three classes, and logs what they answer.
#![no_std]
#![no_main]

use cosmic_core::broker::Broker;
use cosmic_core::services::NodeServices;
use cosmic_rtic::Log;
use small::plan::{channels, nodes::hub::NODE};
use small::*;

cosmic_core::capacity! {
    Room { slots: 4, channels: 8, subscriptions: 8, events: 32, soft: 8, non_real_time: 8 }
}

/// What the node is made of.
pub struct Hub;

impl System for Hub {
    type Board = Stm32F405;
    type Capacity = Room;
    type Services = NodeServices<8, 16, 4, 16, Broker<8, 8>>;
    type Observer = Log;
}

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
#[rustfmt::skip] // A task is a line.
mod app {
    use super::*;
    #[shared] struct Shared { node: Node<Hub> }
    #[local] struct Local { calendar: Calendar<Hub>, urgent: Urgent<Hub>, outcomes: Outcomes<Hub>, status: Status<Hub>, other: Other<Hub>, events: Events }

    #[init(local = [storage: Storage<Hub> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        cosmic_rtt::start!(4096, cosmic_rtic::EVENT_PRIORITY);
        let board = Stm32F405::start(boards::resources!(cx.device), &NODE).expect("the plan fits the board");
        let parts = cosmic_rtic::start_observed(board, &NODE, cx.local.storage, Log, ()).expect("the plan has a clock");
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        spawn!(calendar(), events(), exceptions(), beat(), wish(), request(), angle(), torque(), heat(), report());
        (Shared { node }, Local { calendar, urgent, outcomes, status, other, events })
    }

    #[task(shared = [node], priority = 1)] async fn beat(cx: beat::Context) { super::beat(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn wish(cx: wish::Context) { ask(&WISH, channels::wish::PERIOD, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn request(cx: request::Context) { ask(&REQUEST, channels::request::PERIOD, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn angle(cx: angle::Context) { listen("angle", const { &channels::angle::channel() }, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn torque(cx: torque::Context) { listen("torque", const { &channels::torque::channel() }, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn heat(cx: heat::Context) { listen("heat", &HEAT, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn report(cx: report::Context) { listen("report", &REPORT, cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(local = [calendar], priority = 7)] async fn calendar(cx: calendar::Context) { cx.local.calendar.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(local = [events], shared = [node], priority = 3)] async fn events(cx: events::Context) { cx.local.events.run(cx.shared.node).await }
}

async fn beat(mut node: impl Mutex<T = Node<Hub>>) {
    let mut numbers = 1..;
    let next = |_: &mut _| numbers.next().unwrap_or_default();
    let _ = publish_in_slots(&BEAT, &channels::beat::SLOT, LEAD, &mut node, next).await;
}

async fn ask(channel: &'static Channel<u16>, period: Duration, mut node: impl Mutex<T = Node<Hub>>) {
    let mut numbers = 1..;
    let next = |_: &mut _| numbers.next().unwrap_or_default();
    let _ = publish_every(channel, period, &mut node, next).await;
}

async fn listen(name: &str, channel: &'static Channel<u16>, mut node: impl Mutex<T = Node<Hub>>) {
    settled(&mut node).await;
    let Ok(events) = Subscriber::subscribe(channel, QUEUE, &mut node) else { return };
    loop {
        let event = events.next(&mut node).await;
        if event.content % 10 == 0 {
            defmt::info!("{=str} {=u16} of node {=u8}", name, event.content, event.publisher.get());
        }
    }
}
