//! A probe in the workshop.
#![no_std]
#![no_main]

use workshop::{plan::nodes::probe::NODE, *};

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
#[rustfmt::skip] // A task is a line.
mod app {
    use super::*;
    #[shared] struct Shared { node: Node<Workshop> }
    #[local] struct Local { urgent: Urgent<Workshop>, outcomes: Outcomes<Workshop>, status: Status<Workshop>, other: Other<Workshop> }

    #[init(local = [storage: Storage<Workshop> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let parts = start(boards::resources!(cx.device), &NODE, cx.local.storage);
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        spawn!(calendar(calendar), events(events), exceptions(), news(), measure());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn measure(cx: measure::Context) { super::measure_here(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn news(cx: news::Context) { tell(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Workshop>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

async fn measure_here(mut node: impl Mutex<T = Node<Workshop>>) {
    let mut diary = MessagePublisher::announce(&DIARY, &mut node).expect(PLANNED);
    let write = async |count: u16, node: &mut _| {
        let entry = Bytes::text(format_args!("{count} readings since I was switched on"));
        match diary.publish(&entry.unwrap_or(Bytes::EMPTY), node).await {
            Ok(()) => defmt::info!("has written into the diary"),
            Err(error) => defmt::warn!("the diary was not sent: {}", error),
        }
    };
    measure(7, node, write).await
}
