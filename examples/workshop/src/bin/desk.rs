//! The desk: names the nodes and their channels, and stops everything when a reading is too high.
#![no_std]
#![no_main]

use workshop::{plan::nodes::desk::NODE, *};

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2, SPI3])]
#[rustfmt::skip] // A task is a line.
mod app {
    use super::*;
    #[shared] struct Shared { node: Node<Host> }
    #[local] struct Local { urgent: Urgent<Host>, outcomes: Outcomes<Host>, status: Status<Host>, other: Other<Host> }

    #[init(local = [storage: Storage<Host> = Storage::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let parts = start(boards::resources!(cx.device), &NODE, cx.local.storage);
        let Parts { calendar, urgent, outcomes, status, other, events, node } = parts;
        spawn!(calendar(calendar), events(events), exceptions(), news(), watch(), read());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn watch(cx: watch::Context) { super::watch(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn read(cx: read::Context) { super::read(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn news(cx: news::Context) { tell(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn exceptions(cx: exceptions::Context) { report_exceptions(cx.shared.node).await }

    // The node, one task for each of its parts.
    #[task(priority = 7)] async fn calendar(_: calendar::Context, mut part: Calendar<Host>) { part.run().await }
    #[task(binds = CAN1_RX0, local = [urgent], priority = 6)] fn can_urgent(cx: can_urgent::Context) { cx.local.urgent.run() }
    #[task(binds = CAN1_TX, local = [outcomes], priority = 5)] fn can_sent(cx: can_sent::Context) { cx.local.outcomes.run() }
    #[task(binds = CAN1_SCE, local = [status], priority = 5)] fn can_status(cx: can_status::Context) { cx.local.status.run() }
    #[task(binds = CAN1_RX1, local = [other], priority = 4)] fn can_other(cx: can_other::Context) { cx.local.other.run() }
    #[task(shared = [node], priority = 3)] async fn events(cx: events::Context, mut part: Events) { part.run(cx.shared.node).await }
}

async fn watch(mut node: impl Mutex<T = Node<Host>>) {
    let stop = Publisher::announce(&EMERGENCY_STOP, &mut node).expect(PLANNED);
    let readings = Subscriber::subscribe(&READING, QUEUE, &mut node).expect(PLANNED);
    loop {
        let reading = readings.next(&mut node).await.content.value;
        if reading % 100 == 99 {
            defmt::info!("stops, for a reading of {}", reading);
            let _ = stop.publish(Stop { reading }, &mut node);
        }
    }
}

async fn read(mut node: impl Mutex<T = Node<Host>>) {
    let mut diary = MessageSubscriber::subscribe(&DIARY, TIME_OUT, &mut node).expect(PLANNED);
    loop {
        let entry = diary.next(&mut node).await;
        defmt::info!("node {} writes: {}", entry.publisher.get(), entry.content);
    }
}

/// A message is dropped when nothing more comes of it for so long.
const TIME_OUT: Duration = Duration::from_millis(500);
