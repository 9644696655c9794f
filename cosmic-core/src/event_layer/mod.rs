//! The event layer: subjects, channels, publications and subscriptions.

mod attributes;
mod bytes;
mod channel;
mod content;
mod declared;
mod delivery;
mod error;
mod exception;
mod filter;
mod gate;
mod layer;
mod messages;
mod pool;
mod protection;
mod publish;
mod rate;
pub use messages::{MessageChannel, MessagePublisher, MessageSubscriber};

pub use crate::protocol::Class;
pub use attributes::{Attributes, HardAttributes, Importance, NonRealTimeAttributes, SoftAttributes};
pub use bytes::Bytes;
pub use channel::{Channel, ChannelCounters, Depth, Policy, Publication, Subscription};
pub use content::{Content, layout_of};
pub use declared::{Constant, Declared, Listed};
pub use delivery::Delivered;
pub use error::{AnnounceError, SubscribeError};
pub use exception::{Exception, ExceptionKind};
pub use filter::{Attribute, Context, Filter, NoRoom};
pub use gate::Gate;
pub use layer::EventLayer;
pub use publish::{Event, PublishError, Published};
pub use rate::EventRate;

pub(crate) use delivery::{Accepted, Received};
pub(crate) use exception::Exceptions;
pub(crate) use publish::{Quality, encode};
