//! A COSMIC node on Linux: the core of the microcontrollers, driven by tokio.
//!
//! A [`Node`] announces, publishes and subscribes as a node of RTIC does, on the same channels, with the same types. It
//! reaches its segment through a [`Link`]: a [simulated or emulated segment](link::segment), [slcan](link::slcan),
//! [socketcand](link::socketcand), [SocketCAN](link::socketcan), or a [log](link::candump).
//!
//! ```no_run
//! use cosmic_core::{NodeUid, Subject};
//! use cosmic_core::event_layer::{Channel, Policy, SoftAttributes};
//! use cosmic_core::time::Duration;
//! use cosmic_linux::link::segment::SegmentLink;
//! use cosmic_linux::{Config, Node};
//!
//! const HEAT: Channel<i16> = Channel::soft(
//!     Subject::new(0x2A).unwrap(),
//!     SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) },
//! );
//!
//! # async fn run() -> Result<(), Box<dyn std::error::Error>> {
//! let node = Node::start(Config::new(NodeUid::new(0x1234).ok_or("zero is no UID")?), SegmentLink::new("/run/cosmic/segment"))?;
//! let heat = node.announce(&HEAT)?;
//! heat.bound().await;
//! heat.publish(21)?;
//! let subscriber = node.subscribe(&HEAT, Policy::Latest)?;
//! println!("{} degrees", subscriber.next().await.content);
//! # Ok(())
//! # }
//! ```
//!
//! A [`Tap`] is no node: it tells what crosses a link, for tools that listen, and sends frames as they are.
//!
//! # What holds here, and what does not
//! * Soft and non real-time channels: deadlines, expiry and exceptions are those of the core. The timer has a
//!   resolution of a millisecond, so an event may be promoted or discarded that much late. It is never handed to the
//!   link after it has expired: that is looked at once more at that moment.
//! * Messages of up to 1024 bytes, on non real-time channels ([`Node::announce_messages`],
//!   [`Node::subscribe_messages`]).
//! * Hard real-time channels are received, as soon as their frames arrive, not at their delivery instants; a frame that
//!   was repeated on the bus is one event. Publishing on them needs a clock as good as the calendar's, which Linux
//!   behind a serial line or a socket has not: [`Node::announce`] refuses it.
//! * Each class has one place towards the link, as a controller has one mailbox. What waits there can be withdrawn.
//!   What a link has been handed cannot, but for a simulated segment; so a link is handed one frame at a time, and an
//!   urgent frame waits for at most one other of this node.
//! * While a link is down its frames wait in their places, and expire there. It re-connects by itself.
//!
//! # Where events can be lost, and who says so
//! | where | told by |
//! |---|---|
//! | a subscriber does not keep up | exception *queue full* |
//! | more is published than the bus takes | [`PublishError::QueueFull`](cosmic_core::event_layer::PublishError), and an exception |
//! | expired before it was sent | exception *validity expired* |
//! | the link or the kernel dropped received frames | exception *input lost*, [`LinkCounters::lost`] |
//! | the connection broke behind a frame that had been handed over | it is sent again, [`LinkCounters::repeated`]: the others may see it twice |
//! | frames that COSMIC does not use, and lines that mean nothing | [`LinkCounters::foreign`], [`LinkCounters::malformed`] |

mod application;
mod bytes;
pub mod candump;
mod config;
mod descriptor;
mod half;
pub mod link;
mod message_queues;
mod messages;
mod node;
mod places;
mod shared;
mod tap;

pub use application::{AnnounceError, Publisher, Subscriber};
pub use config::{BrokerTables, Config, StartError, calendar_without_slots, drawn_uid};
pub use half::{BROKER_ADMITS, BROKER_NODES, BROKER_SUBJECTS, Broker};
pub use link::{Link, LinkCounters, LinkError, Port};
pub use message_queues::{MESSAGES_AT_ONCE, WAITING_MESSAGES};
pub use messages::{MessagePublisher, MessageSubscriber};
pub use node::Node;
pub use tap::{NotSent, Tap, Tapped, What};
