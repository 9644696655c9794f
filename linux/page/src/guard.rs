//! Who may ask, and what the page may do in a browser.

use std::net::{IpAddr, Ipv6Addr};

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

use crate::hub::Hub;

/// Refuses requests under a name that is not ours, and says to the browser what answers may do.
pub(crate) async fn guard(State(hub): State<Hub>, request: Request, next: Next) -> Response {
    let asked = request.headers().get(header::HOST).and_then(|host| host.to_str().ok());
    let mut response = if asked.is_some_and(|host| is_ours(host, &hub.shared.config.hosts)) {
        next.run(request).await
    } else {
        let why = "this page is not known under the name you asked for: use its address, or start it with that name\n";
        (StatusCode::MISDIRECTED_REQUEST, why).into_response()
    };
    say_what_it_may(response.headers_mut());
    response
}

fn say_what_it_may(headers: &mut HeaderMap) {
    headers.entry(header::CONTENT_SECURITY_POLICY).or_insert(NOTHING);
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
}

const NOTHING: HeaderValue = HeaderValue::from_static("default-src 'none'; frame-ancestors 'none'");

/// Returns whether a host, as a browser names it, is an address, `localhost`, or one of these names. A site elsewhere can
/// make its own name point to this server, but not an address.
fn is_ours(host: &str, names: &[String]) -> bool {
    let (name, port) = match host.strip_prefix('[') {
        Some(rest) => match rest.split_once(']') {
            Some((address, port)) if address.parse::<Ipv6Addr>().is_ok() => (address, port),
            _ => return false,
        },
        None => host.split_at(host.find(':').unwrap_or(host.len())),
    };
    let is_port = |text: &str| text.strip_prefix(':').is_some_and(|digits| digits.parse::<u16>().is_ok());
    let is_known = name.parse::<IpAddr>().is_ok()
        || name.eq_ignore_ascii_case("localhost")
        || names.iter().any(|known| known.eq_ignore_ascii_case(name));
    is_known && (port.is_empty() || is_port(port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_and_known_names_are_ours() {
        let names = ["bench.example".to_owned()];
        for host in
            ["127.0.0.1:8117", "[::1]:8117", "localhost", "LOCALHOST:1", "192.168.0.7", "Bench.example:80"]
        {
            assert!(is_ours(host, &names), "{host}");
        }
        for host in [
            "evil.example",
            "localhost.evil.example:8117",
            "",
            "127.0.0.1.evil.example",
            "[::1",
            "[::1]evil.example",
            "[evil.example]",
            "::1",
            "localhost:evil.example",
        ] {
            assert!(!is_ours(host, &names), "{host}");
        }
    }
}
