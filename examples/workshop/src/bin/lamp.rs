//! The lamp: shows readings of the workshop, and is dark for a while after a stop.
#![no_std]
#![no_main]

use workshop::{plan::nodes::lamp::NODE, *};

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
        spawn!(calendar(calendar), events(events), exceptions(), news(), show(), stop());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn show(cx: show::Context) { super::show(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn stop(cx: stop::Context) { super::stop(cx.shared.node).await }
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

/// Readings of the places 1 to 9.
async fn show(mut node: impl Mutex<T = Node<Workshop>>) {
    let near = Filter::at_least(&[Attribute::Location]).with_range(Attribute::Location, 1, 9);
    loop {
        let readings = Subscriber::subscribe_filtered(&READING, near, QUEUE, &mut node).expect(PLANNED);
        for _ in 0..100 {
            let event = readings.next(&mut node).await;
            if event.content.value % 25 == 0 {
                defmt::info!("{} at {}", event.content, event.context.get(Attribute::Location));
            }
        }
        defmt::info!("is dark");
        readings.cancel(&mut node);
        Stm32F405::delay_until(Stm32F405::now() + REST).await;
    }
}

async fn stop(mut node: impl Mutex<T = Node<Workshop>>) {
    settled(&mut node).await;
    let stops = Subscriber::subscribe(&EMERGENCY_STOP, QUEUE, &mut node).expect(PLANNED);
    loop {
        let event = stops.next(&mut node).await;
        defmt::info!("{} by node {}", event.content, event.publisher.get());
    }
}
