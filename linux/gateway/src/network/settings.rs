//! What zenoh is told.

use serde_json::{Value, json};
use zenoh::Config;

use super::NetworkError;
use crate::config::{Ip, Mode};
use crate::keys::{Keys, Name};

/// The settings of a session.
pub(super) fn of(ip: &Ip, network: &Name) -> Result<Config, NetworkError> {
    let mode = match ip.mode {
        Mode::Router => "router",
        Mode::Peer => "peer",
        Mode::Client => "client",
    };
    let mut settings = vec![
        ("mode", json!(mode)),
        ("listen/endpoints", json!(ip.listen)),
        ("connect/endpoints", json!(ip.connect)),
        // For ever: who is not there yet will come.
        ("connect/timeout_ms", json!(-1)),
        ("connect/exit_on_failure", json!(false)),
        (
            "connect/retry",
            json!({ "period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2 }),
        ),
        ("listen/exit_on_failure", json!(true)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        // Events bear stamps of their own.
        ("timestamping/enabled", json!(false)),
        // A connection that says nothing for so long is gone.
        ("transport/link/tx/lease", json!(2000)),
    ];
    if let Some(tls) = &ip.tls {
        let settings_of_tls = json!({
            "root_ca_certificate": tls.authority,
            "listen_certificate": tls.certificate,
            "listen_private_key": tls.key,
            "connect_certificate": tls.certificate,
            "connect_private_key": tls.key,
            "enable_mtls": true,
            "verify_name_on_connect": true,
            "close_link_on_expiration": true,
        });
        settings.push(("transport/link/tls", settings_of_tls));
    }
    if !ip.peers.is_empty() {
        settings.push(("access_control", access_control(ip, network)));
    }
    let mut config = Config::default();
    for (key, value) in settings {
        let set = config.insert_json5(key, &value.to_string());
        set.map_err(|error| NetworkError::new(format!("zenoh does not take {key}: {error}")))?;
    }
    Ok(config)
}

/// Everybody whose certificate is named may listen to the network, and send for the segments that it is named with.
/// Whatever else comes is dropped.
fn access_control(ip: &Ip, network: &Name) -> Value {
    let keys = Keys::new(network);
    let listen = json!({
        "id": "listen",
        "permission": "allow",
        "flows": ["ingress"],
        "messages": ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"],
        "key_exprs": [keys.all()],
    });
    let tell = json!({
        "id": "tell",
        "permission": "allow",
        "flows": ["egress"],
        "messages": MESSAGES,
        "key_exprs": [keys.all()],
    });
    let (mut rules, mut subjects, mut policies) = (vec![listen, tell], Vec::new(), Vec::new());
    for (number, peer) in ip.peers.iter().enumerate() {
        let (rule, subject) = (format!("speak {number}"), format!("peer {number}"));
        let spoken_for: Vec<_> = peer.segments.iter().flat_map(|segment| keys.of_segment(segment)).collect();
        let mut of_peer = vec!["listen".to_owned(), "tell".to_owned()];
        if !spoken_for.is_empty() {
            rules.push(json!({
                "id": rule,
                "permission": "allow",
                "flows": ["ingress"],
                "messages": ["put", "declare_queryable", "reply", "liveliness_token"],
                "key_exprs": spoken_for,
            }));
            of_peer.push(rule);
        }
        subjects.push(json!({ "id": subject, "cert_common_names": [peer.certificate] }));
        policies.push(json!({ "id": format!("policy {number}"), "rules": of_peer, "subjects": [subject] }));
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}

const MESSAGES: [&str; 9] = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
];

/// What went wrong at the start of a session, in words of the configuration.
pub(super) fn explain(ip: &Ip, error: &str) -> NetworkError {
    let error = error.lines().next().unwrap_or_default();
    if let Some(tls) = &ip.tls {
        for file in [&tls.authority, &tls.certificate, &tls.key] {
            if let Err(why) = std::fs::read(file) {
                let file = file.display();
                return NetworkError::new(format!(
                    "the certificate {file} cannot be read: {why}; look at [ip.tls]"
                ));
            }
        }
    }
    let in_use = ["Address already in use", "in use", "os error 98"].iter().any(|text| error.contains(text));
    let listen = ip.listen.join(", ");
    NetworkError::new(if in_use {
        format!("another program listens at {listen} already: stop it, or choose another port in `listen`")
    } else {
        format!(
            "no session on IP: {error}; look at [ip] (listen: {listen}; connect: {})",
            ip.connect.join(", ")
        )
    })
}
