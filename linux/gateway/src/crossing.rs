//! What whoever watches a gateway is told of each event.

use cosmic_core::can::TxNode;
use cosmic_core::time::Duration;

use crate::config::ChannelConfig;
use crate::counters::Outcome;
use crate::keys::Name;

/// An event that has come to a gateway, on one of its ways.
#[derive(Clone, Copy, Debug)]
pub struct Crossing<'a> {
    /// Its channel.
    pub channel: &'a ChannelConfig,
    /// The segment that it comes from; `None`: nobody knows.
    pub from: Option<&'a Name>,
    /// Its publisher there; `None`: it is no node of a segment, or nobody knows.
    pub node: Option<TxNode>,
    /// The segment that it was for; `None`: it was for IP, or for none of the gateway's.
    pub to: Option<&'a Name>,
    /// What was left to its deadline.
    pub to_deadline: Option<Duration>,
}

impl<'a> Crossing<'a> {
    /// An event of the channel, of which nothing else is known.
    pub(crate) const fn of(channel: &'a ChannelConfig) -> Self {
        Self { channel, from: None, node: None, to: None, to_deadline: None }
    }

    pub(crate) const fn from(self, segment: &'a Name, node: Option<TxNode>) -> Self {
        Self { from: Some(segment), node, ..self }
    }

    pub(crate) const fn to(self, segment: &'a Name) -> Self {
        Self { to: Some(segment), ..self }
    }

    pub(crate) const fn left(self, to_deadline: Option<Duration>) -> Self {
        Self { to_deadline, ..self }
    }
}

/// Whoever watches. It is called for each event with what became of it, and must not wait.
pub type Watch = dyn Fn(&Crossing<'_>, Outcome) + Send + Sync;
