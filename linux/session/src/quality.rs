//! The quality of a channel that no file describes, and of one event.

use cosmic_core::Subject;
use cosmic_core::can::{Etag, Payload};
use cosmic_core::event_layer::{Channel, Importance, NonRealTimeAttributes, SoftAttributes};
use cosmic_core::network::fragments::MAX_MESSAGE_LEN;
use cosmic_core::time::Duration;
use cosmic_monitor::{ByteMessages, SegmentPlan};

use crate::failure::Failure;

/// Bytes of a message at most.
pub const LONGEST_MESSAGE: usize = MAX_MESSAGE_LEN;

/// A class in which a session can publish.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Class {
    /// Soft real-time.
    Soft {
        /// From publication until an event should have been sent; not zero.
        deadline: Duration,
        /// From publication until an event is of no use any more; not shorter than the deadline.
        validity: Duration,
    },
    /// Non real-time.
    NonRealTime {
        /// 0 the most, 4 the least.
        importance: Importance,
        /// From publication until an event is of no use any more; `None` if it keeps for ever.
        validity: Option<Duration>,
    },
    /// Non real-time, and each event is a message of up to [`LONGEST_MESSAGE`] bytes in as many frames as it takes.
    Messages {
        /// As for [`Class::NonRealTime`].
        importance: Importance,
        /// As for [`Class::NonRealTime`].
        validity: Option<Duration>,
    },
}

/// A channel as a program declares it that takes its content as bytes.
#[derive(Clone, Copy, Debug)]
pub enum Declared {
    /// Of events of a frame.
    Events(Channel<Payload>),
    /// Of messages.
    Messages(ByteMessages),
}

impl Declared {
    /// The channel as the plan has it; `None` if the description contradicts the protocol.
    pub fn by_plan(plan: &SegmentPlan, at: usize) -> Option<Self> {
        let messages = plan.declare_messages(at).map(Self::Messages);
        messages.or_else(|| plan.declare(at).map(Self::Events))
    }

    /// The channel with a fixed etag.
    pub fn with_etag(self, etag: Etag) -> Self {
        match self {
            Self::Events(channel) => Self::Events(channel.with_etag(etag)),
            Self::Messages(channel) => Self::Messages(channel.with_etag(etag)),
        }
    }

    /// Its subject.
    pub const fn subject(&self) -> Subject {
        match self {
            Self::Events(channel) => channel.subject(),
            Self::Messages(channel) => channel.subject(),
        }
    }
}

/// The quality of a channel that no file describes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Quality {
    /// Its class.
    pub class: Class,
    /// Its etag, in a cluster without broker.
    pub etag: Option<Etag>,
}

impl Quality {
    /// What a channel has of which nothing is known: soft real-time, and the broker gives the etag.
    pub const DEFAULT: Self = Self {
        class: Class::Soft { deadline: Duration::from_millis(20), validity: Duration::from_millis(80) },
        etag: None,
    };

    pub(crate) fn channel(&self, subject: Subject) -> Result<Declared, Failure> {
        let wrong = |what: &str| Err(Failure::Input(what.to_owned()));
        let channel = match self.class {
            Class::Soft { deadline, .. } if deadline.is_zero() => {
                return wrong("a deadline of zero cannot be met: give a longer one");
            }
            Class::Soft { deadline, validity } if validity < deadline => {
                return wrong(
                    "the validity is shorter than the deadline: an event must not expire before it",
                );
            }
            Class::Soft { deadline, validity } => {
                Declared::Events(Channel::soft(subject, SoftAttributes { deadline, validity }))
            }
            Class::NonRealTime { importance, validity } => Declared::Events(Channel::non_real_time(
                subject,
                NonRealTimeAttributes { importance, validity },
            )),
            Class::Messages { importance, validity } => {
                Declared::Messages(ByteMessages::new(subject, NonRealTimeAttributes { importance, validity }))
            }
        };
        match self.etag {
            Some(etag) if etag.is_reserved() || etag.is_hard() => wrong(
                "an etag below 1024 is the protocol's or a hard real-time channel's: give one of 1024 to 16383",
            ),
            Some(etag) => Ok(channel.with_etag(etag)),
            None => Ok(channel),
        }
    }
}

/// The times of one event, from now.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Times {
    /// Until it should have been sent; `None`: as the channel says.
    pub deadline: Option<Duration>,
    /// Until it is of no use any more; `None`: as the channel says.
    pub validity: Option<Duration>,
}

impl Times {
    /// As the channel says.
    pub const fn of_channel() -> Self {
        Self { deadline: None, validity: None }
    }
}
