//! A live page of COSMIC segments, for a browser.
//!
//! A [`Hub`] holds what is known of each [`Segment`] and tells it to all browsers. Whoever has links hands in what
//! crosses them ([`Segment::follow`]); [`router`] is what an HTTP server of tokio's axum mounts, [`serve`] is such a server.
//!
//! ```no_run
//! use cosmic_core::can::BitRate;
//! use cosmic_core::time::Instant;
//! use cosmic_linux::Tap;
//! use cosmic_linux::link::segment::SegmentLink;
//! use cosmic_monitor::Monitor;
//! use cosmic_page::{Config, Hub};
//!
//! # async fn run() -> std::io::Result<()> {
//! let hub = Hub::new(Config::default());
//! let segment = hub.segment("front", "sim:/run/cosmic/front", Monitor::new(BitRate::MAX, Instant::EPOCH));
//! tokio::spawn(segment.follow(Tap::start(SegmentLink::new("/run/cosmic/front"))));
//! let listener = tokio::net::TcpListener::bind("127.0.0.1:8117").await?;
//! cosmic_page::serve(hub, listener).await
//! # }
//! ```
//!
//! A gateway that has a hub tells it of the events that come to it: [`Hub::crossed`].
//!
//! # What a browser gets
//! | path | what |
//! |---|---|
//! | `/` | the page: one file, which needs nothing from elsewhere |
//! | `/events` | Server-Sent Events: `hello`, `state` (once a second), `frames` (ten times a second), `notices`, `crossings` (once a second, if there are any), `lost` |
//! | `/api/state` | the same as one JSON value, for programs |
//! | `/api/publish` | publishes an event, if the hub [allows it](Config::publishing), for who has the token |
//!
//! # Bounds
//! Nothing here waits for a browser. Each has a queue of [`QUEUE`] messages; when it is full, messages are dropped, their
//! frames are counted, and the browser is told how many as soon as it reads again. [`MOST_BROWSERS`] may watch at once.
//! Of each segment [`MOST_FRAMES`] are told in a tenth of a second; loads and counts include those beyond. [`MOST_WAYS`]
//! ways between segments are kept; events of others are counted.
//!
//! # Who may see and do what
//! Who reaches the server's address sees the segments: listen on loopback, or behind something that asks who is there.
//! Requests for a host name that the server does not know are refused ([`Config::hosts`]), so that no page of another
//! site reads this one through a name that it points here. The page loads nothing and may not be framed. Publishing
//! is off; if it is on, each request needs the token.
#![forbid(unsafe_code)]

mod assets;
mod browsers;
mod crossings;
mod guard;
mod hub;
mod messages;
mod publishing;
mod routes;
mod secret;
mod segment;

pub use browsers::{MOST_BROWSERS, QUEUE};
pub use crossings::{Crossing, MOST_WAYS, Way};
pub use hub::{Config, Hub};
pub use publishing::{Answer, PublishRequest, Publishing, Token};
pub use routes::{router, serve};
pub use segment::{MOST_FRAMES, Segment};
