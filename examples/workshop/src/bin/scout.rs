//! A probe in the yard, which the lamp does not care for. It also tells of vibrations, which nobody planned for.
#![no_std]
#![no_main]

use workshop::{plan::nodes::scout::NODE, *};

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
        spawn!(calendar(calendar), events(events), exceptions(), news(), measure(), shake());
        (Shared { node }, Local { urgent, outcomes, status, other })
    }

    #[task(shared = [node], priority = 1)] async fn measure(cx: measure::Context) { super::measure_here(cx.shared.node).await }
    #[task(shared = [node], priority = 1)] async fn shake(cx: shake::Context) { super::shake(cx.shared.node).await }
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

async fn measure_here(node: impl Mutex<T = Node<Workshop>>) {
    measure(42, node, async |_, _| {}).await
}

/// Publishes once the broker's node has found that nobody's deadline is missed for it.
async fn shake(mut node: impl Mutex<T = Node<Workshop>>) {
    let vibrations = Publisher::announce(&VIBRATION, &mut node).expect(PLANNED);
    vibrations.bound(&mut node).await;
    let mut ticker = Ticker::<Stm32F405>::every(VIBRATION_EVERY);
    for value in 0.. {
        ticker.tick().await;
        let state = node.lock(|node| node.services().admission_of(VIBRATION.subject()));
        if let Some(AdmissionState::Admitted(_)) = state {
            let _ = vibrations.publish(Reading { value }, &mut node);
        }
    }
}
