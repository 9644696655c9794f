//! `[ip]`: how the others are reached, and who may speak.

use cosmic_plan::document::Table;

use super::super::{Ip, Mode, Peer, Tls};
use super::Reader;
use super::values::{self, WRITE_NAME};

pub(super) fn read(reader: &Reader<'_>, table: &Table<'_>) -> Ip {
    let mode = |text: &str| match text {
        "router" => Some(Mode::Router),
        "peer" => Some(Mode::Peer),
        "client" => Some(Mode::Client),
        _ => None,
    };
    let mode = values::optional_text(table, "mode", mode, "write \"router\", \"peer\" or \"client\"");
    let tls = table.node("tls").map(|node| reader.table(node, table.path_of("tls")));
    let tls = tls.map(|table| read_tls(reader, &table));
    let (listen, connect) =
        (endpoints(table, "listen", tls.is_some()), endpoints(table, "connect", tls.is_some()));
    let peers = table.entries("peer", |table| read_peer(table, tls.is_some()));
    table.finish();
    let peers = peers.into_iter().flatten().collect();
    Ip { mode: mode.map(|at| at.value).unwrap_or_default(), listen, connect, tls: tls.flatten(), peers }
}

fn endpoints(table: &Table<'_>, field: &'static str, has_certificates: bool) -> Vec<String> {
    let is_one = |text: &str| {
        let known = text.starts_with("tls/") || text.starts_with("tcp/");
        let has_port = text.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok());
        (known && has_port).then(|| text.to_owned())
    };
    let all = values::list(table, field, is_one, "write \"tcp/HOST:PORT\" or \"tls/HOST:PORT\"");
    for at in all.iter().filter(|at| !has_certificates && at.value.starts_with("tls/")) {
        let help = "add [ip.tls] with authority, certificate and key";
        table.problem(field, at.place.clone(), "\"tls/\" needs certificates", help);
    }
    all.into_iter().map(|at| at.value).collect()
}

fn read_tls(reader: &Reader<'_>, table: &Table<'_>) -> Option<Tls> {
    let path = |field, what: &str| {
        let at = table.required::<String>(field, what)?;
        Some(reader.folder.join(at.value))
    };
    let authority = path("authority", "name the file with the certificate that has signed the others");
    let certificate = path("certificate", "name the file with this gateway's certificate");
    let key = path("key", "name the file with the key of the certificate");
    table.finish();
    Some(Tls { authority: authority?, certificate: certificate?, key: key? })
}

fn read_peer(table: &Table<'_>, has_certificates: bool) -> Option<Peer> {
    let certificate = table.required::<String>("certificate", "write the common name of a certificate");
    if table.node("segments").is_none() {
        let _ = table.required::<String>("segments", "name the segments that it may speak for, or write []");
    }
    let segments = values::list(table, "segments", values::name, WRITE_NAME);
    table.finish();
    let certificate = certificate?;
    if !has_certificates {
        let what = "peers are told apart by certificates";
        table.problem("certificate", certificate.place, what, "add [ip.tls]");
    }
    let segments = segments.into_iter().map(|at| at.value).collect();
    Some(Peer { certificate: certificate.value, segments })
}
