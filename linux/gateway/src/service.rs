//! A gateway as a service: metrics, signs of life for systemd, an end in order.

use std::fmt;
use std::net::SocketAddr;
use std::time::Duration as Span;

use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;
use sd_notify::NotifyState;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio::task::JoinSet;

use crate::config::Config;
use crate::crossing::Crossing;
use crate::error::StartError;
use crate::gateway::Gateway;
use crate::page;

/// Why a service has ended that should not.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ServiceError(String);

impl ServiceError {
    /// With this text.
    pub fn new(what: impl Into<String>) -> Self {
        Self(what.into())
    }
}

impl fmt::Display for ServiceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for ServiceError {}

impl From<StartError> for ServiceError {
    fn from(error: StartError) -> Self {
        Self(error.to_string())
    }
}

/// Runs a gateway until SIGTERM or SIGINT.
///
/// # Errors
/// It cannot start, or cannot go on.
pub async fn run(config: &Config) -> Result<(), ServiceError> {
    let signals = |kind| signal(kind).map_err(|error| ServiceError(format!("no signals: {error}")));
    let (mut terminate, mut interrupt) =
        (signals(SignalKind::terminate())?, signals(SignalKind::interrupt())?);
    let listener = match config.metrics {
        Some(address) => Some(listen(address, "metrics").await?),
        None => None,
    };
    let (mut gateway, page) = start(config).await?;
    let text = gateway.metrics_later();
    let served = listener.map(|listener| tokio::spawn(serve(listener, text)));
    let ready = format!("{} segments of network {}", config.segments.len(), config.network);
    tracing::info!("running: {ready}");
    tell(&[NotifyState::Ready, NotifyState::Status(&ready)]);
    let mut watchdog = watchdog();
    let ended = loop {
        tokio::select! {
            error = gateway.ended() => break Err(error.into()),
            _ = terminate.recv() => break Ok(()),
            _ = interrupt.recv() => break Ok(()),
            () = watchdog.due() => tell(&[NotifyState::Watchdog]),
        }
    };
    tell(&[NotifyState::Stopping]);
    if let Some(served) = served {
        served.abort();
    }
    drop(page);
    if tokio::time::timeout(LONGEST_END, gateway.stop()).await.is_err() {
        tracing::warn!("the session on IP did not close within {} s", LONGEST_END.as_secs());
    }
    if ended.is_ok() {
        tracing::info!("ended in order");
    }
    ended
}

/// Starts the gateway, and its page if it has one: what serves it, as long as that lives.
async fn start(config: &Config) -> Result<(Gateway, JoinSet<()>), ServiceError> {
    let Some(of_page) = &config.page else { return Ok((Gateway::start(config).await?, JoinSet::new())) };
    let listener = listen(of_page.listen, "page").await?;
    let hub = page::hub(config, &of_page.hosts);
    let teller = hub.clone();
    let watch = move |crossing: &Crossing<'_>, outcome| teller.crossed(page::shown(crossing, outcome));
    let gateway = Gateway::start_watched(config, Box::new(watch)).await?;
    let mut tasks = page::show(&hub, config)?;
    if let Ok(address) = listener.local_addr() {
        tracing::info!("the page: http://{address}/");
        if !address.ip().is_loopback() {
            tracing::warn!("whoever reaches {address} sees these segments; nothing is encrypted");
        }
    }
    tasks.spawn(async move {
        if let Err(error) = cosmic_page::serve(hub, listener).await {
            tracing::error!("the page is served no longer: {error}");
        }
    });
    Ok((gateway, tasks))
}

async fn listen(address: SocketAddr, what: &str) -> Result<TcpListener, ServiceError> {
    TcpListener::bind(address).await.map_err(|error| {
        ServiceError(format!(
            "the {what} cannot be served at {address}: {error}; choose another address in `{what}`"
        ))
    })
}

async fn serve(listener: TcpListener, text: impl Fn() -> String + Clone + Send + Sync + 'static) {
    let metrics = move || async move { ([(CONTENT_TYPE, EXPOSITION)], text()) };
    let router = Router::new().route("/metrics", get(metrics));
    if let Err(error) = axum::serve(listener, router).await {
        tracing::error!("metrics are served no longer: {error}");
    }
}

/// Outside systemd nobody listens.
fn tell(state: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(false, state) {
        tracing::debug!("systemd cannot be told: {error}");
    }
}

/// When systemd wants a sign of life.
struct Watchdog(Option<tokio::time::Interval>);

fn watchdog() -> Watchdog {
    let mut microseconds = 0;
    let wanted = sd_notify::watchdog_enabled(false, &mut microseconds);
    Watchdog(wanted.then(|| tokio::time::interval(Span::from_micros((microseconds / 3).max(1000)))))
}

impl Watchdog {
    async fn due(&mut self) {
        match &mut self.0 {
            Some(interval) => {
                interval.tick().await;
            }
            None => std::future::pending().await,
        }
    }
}

const LONGEST_END: Span = Span::from_secs(5);
const EXPOSITION: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
