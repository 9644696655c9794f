//! Paths of the server.

use std::convert::Infallible;
use std::io;
use std::time::Duration;

use axum::extract::{DefaultBodyLimit, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router, middleware};
use tokio::net::TcpListener;
use tokio_stream::StreamExt as _;
use tokio_stream::wrappers::ReceiverStream;

use crate::assets;
use crate::guard;
use crate::hub::Hub;
use crate::publishing::{Answer, PublishRequest};

/// The page and what it asks for, to be mounted in a server; below a path, that ends with `/`. [`Hub::run`] must run
/// beside it.
pub fn router(hub: Hub) -> Router {
    Router::new()
        .route("/", get(page))
        .route("/events", get(events))
        .route("/api/state", get(state))
        .route("/api/publish", post(publish))
        .layer(DefaultBodyLimit::max(LARGEST_REQUEST))
        .layer(middleware::from_fn_with_state(hub.clone(), guard::guard))
        .with_state(hub)
}

/// Serves the page, for ever.
///
/// # Errors
/// The listener cannot accept.
pub async fn serve(hub: Hub, listener: TcpListener) -> io::Result<()> {
    let router = router(hub.clone());
    tokio::select! {
        served = axum::serve(listener, router) => served,
        () = hub.run() => Ok(()),
    }
}

async fn page() -> impl IntoResponse {
    let (page, policy) = assets::page();
    ([(header::CONTENT_SECURITY_POLICY, policy)], Html(page))
}

async fn events(State(hub): State<Hub>) -> Response {
    let Some(messages) = hub.watch() else {
        let why = "too many browsers watch; close one of them\n";
        return (StatusCode::SERVICE_UNAVAILABLE, why).into_response();
    };
    let events = ReceiverStream::new(messages)
        .map(|message| Ok::<_, Infallible>(Event::default().event(message.kind).data(&*message.text)));
    Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response()
}

/// Everything that a browser is told first, as one value.
async fn state(State(hub): State<Hub>) -> Response {
    let (mut hello, mut states, mut notices) = (String::new(), Vec::new(), Vec::new());
    let mut crossings = "null".to_owned();
    for message in hub.everything() {
        match message.kind {
            "hello" => hello = message.text.to_string(),
            "state" => states.push(message.text.to_string()),
            "crossings" => crossings = message.text.to_string(),
            _ => notices.push(message.text.to_string()),
        }
    }
    let text = format!(
        "{{\"hello\":{hello},\"states\":[{}],\"notices\":[{}],\"crossings\":{crossings}}}\n",
        states.join(","),
        notices.join(",")
    );
    ([(header::CONTENT_TYPE, "application/json")], text).into_response()
}

async fn publish(
    State(hub): State<Hub>,
    headers: HeaderMap,
    request: Result<Json<PublishRequest>, axum::extract::rejection::JsonRejection>,
) -> Response {
    let refused = |status: StatusCode, why: &str| {
        (status, Json(Answer { published: false, why: Some(why.to_owned()) })).into_response()
    };
    let Some(publishing) = &hub.shared.config.publishing else {
        return refused(
            StatusCode::FORBIDDEN,
            "this page only shows; one of `cosmic serve --allow-publish` publishes",
        );
    };
    let given = headers.get(header::AUTHORIZATION).and_then(|given| given.to_str().ok());
    let given = given.and_then(|given| given.strip_prefix("Bearer "));
    if !given.is_some_and(|given| publishing.token.is(given)) {
        let why = "the token is wrong: it was printed when this page was started";
        return refused(StatusCode::UNAUTHORIZED, why);
    }
    let request = match request {
        Ok(Json(request)) => request,
        Err(why) => return refused(StatusCode::BAD_REQUEST, &why.body_text()),
    };
    match publishing.publish(request).await {
        Ok(()) => Json(Answer { published: true, why: None }).into_response(),
        Err(why) => refused(StatusCode::UNPROCESSABLE_ENTITY, &why),
    }
}

/// In bytes.
const LARGEST_REQUEST: usize = 4_096;
/// When nothing is to be told, that is said, so that a browser knows a quiet bus from a dead connection.
const KEEP_ALIVE: Duration = Duration::from_secs(5);
