//! A node for programs in other languages: channels are known at run time only, by their subjects, contents are bytes,
//! and calls block. The interface in C and the one in Python stand on it.
//!
//! A [`Session`] is one node with a thread of its own. It knows the quality of channels from the file that describes
//! the cluster, or is told ([`Quality`]). A [`Subscription`] has a file descriptor that is readable while an event
//! waits, for loops that wait for many things. Who drives a node itself gets its [configuration](node_config) here.
//!
//! ```no_run
//! use cosmic_core::Subject;
//! use cosmic_session::{Queue, Session, Settings, Times};
//!
//! # fn run() -> Result<(), Box<dyn std::error::Error>> {
//! let mut settings = Settings::new("sim:/run/cosmic/segment".parse()?);
//! settings.cluster = Some("rover.toml".into());
//! let session = Session::open(&settings)?;
//! let joint = session.subject_of("joint").ok_or("the file has no such channel")?;
//! session.publish(joint, &[0, 0x2A, 0, 0], Times::of_channel())?;
//! let attitude = session.subject_of("attitude").ok_or("the file has no such channel")?;
//! let subscription = session.subscribe(attitude, None, Queue::Latest)?;
//! while let Some(event) = subscription.next(Some(std::time::Duration::from_secs(1)))? {
//!     println!("{:02X?} from {}", event.content.as_slice(), event.publisher);
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Nothing of this is to be called inside a task of tokio, for it blocks; nor in the child of a `fork`, where the
//! thread of the session does not run.

mod config;
mod events;
mod failure;
mod quality;
mod session;
mod subscription;

pub use config::node_config;
pub use events::Events;
pub use failure::{Closed, Failure};
pub use quality::{Class, Declared, LONGEST_MESSAGE, Quality, Times};
pub use session::{PATIENCE, Session, Settings};
pub use subscription::{Queue, Subscription};
