//! Why a channel cannot be announced or subscribed to.

/// Why a channel cannot be announced.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum AnnounceError {
    /// The node knows as many channels as it has room for: make `CHANNELS` larger; or it was to publish in soft real-time,
    /// and `SOFT` is zero.
    TooManyChannels,
    /// The node uses this subject with other attributes, another etag, or another layout of content.
    Contradiction,
    /// Another channel of this node has this etag.
    EtagInUse,
    /// The node has no TxNode. A publisher of hard real-time events needs a fixed one, since the calendar
    /// names it.
    NoTxNode,
    /// The calendar has no slot of this node with the etag, period and omission degree.
    NotInCalendar,
    /// The node takes part in as many slots as it has room for: make `SLOTS` larger.
    TooManySlots,
    /// The plan of the cluster does not have this channel, or not this node as its publisher, and is sealed or lets nothing
    /// be published that it does not know.
    OutsidePlan,
    /// The plan does not have this soft real-time channel, so it has to be asked for, and it states no rate to ask for.
    NoRate,
    /// The plan does not have this soft real-time channel, and its rate or deadline is out of the range that can be asked
    /// for.
    NotAskable,
    /// The events of the channel carry attributes of context, or there is a filter of such: the node does without
    /// ([`Listed::CONTEXTS`](super::Listed::CONTEXTS)).
    NoContexts,
    /// The subject is [reserved](crate::Subject::RESERVED) for brokers.
    ReservedSubject,
}

/// Why a channel cannot be subscribed to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SubscribeError {
    /// As for announcing.
    Channel(AnnounceError),
    /// The node has as many subscriptions as it has room for: make `SUBSCRIPTIONS` larger.
    TooManySubscriptions,
}
