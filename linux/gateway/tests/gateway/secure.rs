//! Certificates and access control: who may speak for which segment.

use std::path::Path;
use std::time::Duration as Span;

use cosmic_core::can::Etag;
use cosmic_gateway::Gateway;
use cosmic_gateway::config::{Config, Ip, Mode, Tls};
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_gateway::ip::Node;

use crate::authority::Authority;
use crate::bed::{HEAT, HEAT_TABLE, Segment, Setup, Stranger, count, fifo, name, port, until};

/// A gateway that lets `desk` speak for the desk, and `guest` listen.
async fn gateway(bus: &Segment, listen: u16, tls: &Tls) -> Gateway {
    let more = "etags = { heat = 5000, gateways = 5001 }";
    let setup =
        Setup { segment: "plant", bus, tx_node: 100, listen, connect: &[], more, channels: HEAT_TABLE };
    let Tls { authority, certificate, key } = tls;
    let tables = format!(
        r#"[ip.tls]
authority = {authority:?}
certificate = {certificate:?}
key = {key:?}
[[ip.peer]]
certificate = "desk"
segments = ["desk"]
[[ip.peer]]
certificate = "guest"
segments = []
[[segment]]"#
    );
    let text = setup.text().replace("tcp/", "tls/").replacen("[[segment]]", &tables, 1);
    let config = Config::parse("secure.toml", &text, Path::new(".")).unwrap();
    Gateway::start(&config).await.unwrap()
}

fn at(port: u16, tls: Tls) -> Ip {
    let connect = vec![format!("tls/127.0.0.1:{port}")];
    Ip { mode: Mode::Peer, connect, tls: Some(tls), ..Ip::default() }
}

fn settings(tls: &Tls) -> Vec<(&'static str, String)> {
    let Tls { authority, certificate, key } = tls;
    let of_tls = format!(
        r#"{{"root_ca_certificate":{authority:?},"connect_certificate":{certificate:?},"connect_private_key":{key:?},"enable_mtls":true}}"#
    );
    vec![("transport/link/tls", of_tls)]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_may_speak_is_heard_and_nobody_else() {
    let authority = Authority::new();
    let bus = Segment::start().await;
    let listen = port();
    let gateway = gateway(&bus, listen, &authority.sign("plant")).await;
    let heat = HEAT.with_etag(Etag::new(5000).unwrap());
    let on_bus = bus.node(1);
    let subscriber = on_bus.subscribe(&heat, fifo(200)).unwrap();
    let from_bus = on_bus.announce(&heat).unwrap();
    from_bus.bound().await;
    // The desk speaks for itself.
    let desk = Node::start(&at(listen, authority.sign("desk")), &name("test"), &name("desk")).await.unwrap();
    let from_desk = desk.announce(&HEAT).await.unwrap();
    tokio::time::timeout(crate::bed::PATIENCE, from_desk.wanted()).await.unwrap();
    until("the desk's clock is known", || gateway.others().1 == 1).await;
    let mut number = 0;
    until("the desk is heard", || {
        number += 1;
        from_desk.publish(number).unwrap();
        subscriber.try_next().is_some()
    })
    .await;
    // The guest hears, but is not heard, for whatever segment it speaks.
    let guest =
        Node::start(&at(listen, authority.sign("guest")), &name("test"), &name("guest")).await.unwrap();
    let heard = guest.subscribe(&HEAT, fifo(200)).await.unwrap();
    until("the guest hears", || {
        number += 1;
        from_bus.publish(number).unwrap();
        heard.try_next().is_some()
    })
    .await;
    tokio::time::sleep(Span::from_millis(200)).await;
    while subscriber.try_next().is_some() {}
    let before = count(&gateway, "plant", Direction::In, Outcome::Forwarded);
    let liars = [
        Stranger::with(listen, "desk", &settings(&authority.sign("guest"))).await,
        Stranger::with(listen, "guest", &settings(&authority.sign("guest"))).await,
        // The desk may not speak for the plant, nor a stranger for anybody.
        Stranger::with(listen, "other", &settings(&authority.sign("desk"))).await,
        Stranger::with(listen, "desk", &settings(&authority.sign("stranger"))).await,
        Stranger::with(listen, "desk", &settings(&Authority::new().sign("desk"))).await,
    ];
    for number in 1..20 {
        for liar in &liars {
            liar.put(HEAT.subject(), &liar.envelope(number, &[0, 99])).await;
        }
        tokio::time::sleep(Span::from_millis(20)).await;
    }
    // The honest one still is heard, and so would those have been.
    until("the desk is heard", || {
        from_desk.publish(7).unwrap();
        std::iter::from_fn(|| subscriber.try_next()).any(|event| event.content == 7)
    })
    .await;
    let honest = count(&gateway, "plant", Direction::In, Outcome::Forwarded) - before;
    assert!(honest >= 1);
    let refused: Vec<_> = Outcome::ALL.iter().filter(|it| gateway.unassigned().get(**it) > 0).collect();
    assert!(
        refused.iter().all(|it| matches!(it, Outcome::AgeUnknown | Outcome::Expired | Outcome::Missing)),
        "what the liars sent did not even arrive: {refused:?}"
    );
    assert!(subscriber.try_next().is_none_or(|event| event.content != 99));
}
