//! The gateway: segments of CAN joined over IP, with deadlines kept; and a [node on IP alone](ip).
//!
//! What crosses is decided by a [configuration](config) and by [rules]; how an event looks on its way, by
//! [its encoding](encoding) and [its keys](keys). Between the sides stands [zenoh](https://zenoh.io), whose declarations
//! and liveliness are the lists of subscribers. `docs/gateway.md` tells how to set up a gateway and what it promises.
//!
//! * **Deadlines survive.** An event carries what is left to its deadline and its expiry. The receiver [bounds its
//!   age](clock) without a common clock, and discards what may have expired: nothing stale reaches a bus, not after a cut
//!   either.
//! * **No flood.** The rate of each channel and the ceiling of each segment bound what a bus gets.
//! * **Once.** Of several gateways of a segment one speaks; [numbers](sequence) tell what has come and what is missing; a
//!   gateway does not forward what a gateway has published.

pub mod clock;
pub mod config;
pub mod counters;
mod crossing;
pub mod encoding;
mod error;
mod gateway;
pub mod ip;
pub mod keys;
mod leader;
mod network;
mod page;
pub mod program;
pub mod rules;
mod segment;
pub mod sequence;
pub mod service;
pub mod table;

pub use crossing::{Crossing, Watch};
pub use error::StartError;
pub use gateway::Gateway;
pub use network::NetworkError;
pub use page::shown;
