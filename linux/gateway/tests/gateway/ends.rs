//! A gateway that ends leaves nothing behind.

use std::net::TcpListener;
use std::time::Duration as Span;

use crate::bed::{HEAT, HEAT_TABLE, Segment, Setup, Stranger, count, port, settled, until};
use cosmic_core::can::Etag;
use cosmic_gateway::counters::{Direction, Outcome};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn its_tasks_and_its_session_are_gone_whether_it_was_stopped_or_dropped() {
    let bus = Segment::start().await;
    let publisher = bus.node(1).announce(&HEAT.with_etag(Etag::new(5000).unwrap())).unwrap();
    publisher.bound().await;
    let tasks = || tokio::runtime::Handle::current().metrics().num_alive_tasks();
    let before = tasks();
    for stops in [true, false] {
        let listen = port();
        let (connect, more, channels) = (&[], "etags = { heat = 5000, gateways = 5001 }", HEAT_TABLE);
        let setup = Setup { segment: "plant", bus: &bus, tx_node: 100, listen, connect, more, channels };
        let gateway = setup.start().await;
        // Somebody subscribes, so the gateway reads the channel, and has a clock to ask.
        let stranger = Stranger::start(listen, "stranger").await;
        let events = stranger.keys.events(HEAT.subject());
        let subscriber = stranger.session.declare_subscriber(events).await.unwrap();
        settled(&[(&gateway, "plant")]).await;
        until("it forwards", || {
            let _ = publisher.publish(1);
            count(&gateway, "plant", Direction::Out, Outcome::Forwarded) > 0
        })
        .await;
        assert!(tasks() > before && TcpListener::bind(("127.0.0.1", listen)).is_err());
        if stops {
            gateway.stop().await;
        } else {
            drop(gateway);
        }
        until("its tasks are gone", || tasks() <= before).await;
        until("it listens no longer", || TcpListener::bind(("127.0.0.1", listen)).is_ok()).await;
        drop(subscriber);
        let _ = stranger.session.close().await;
        tokio::time::sleep(Span::from_millis(10)).await;
    }
}
