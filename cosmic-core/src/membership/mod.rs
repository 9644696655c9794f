//! Who is on the bus, and who wants what.
//!
//! * [`Members`]: the nodes that are alive, told from their status frames; events when one joins, leaves,
//!   falls silent or has restarted.
//! * [`StatusReport`]: this node's own status, once a period.
//! * [`Interests`]: which node subscribes to or announces which etag; for gateways and for publishers
//!   that want to know whether anybody listens.
//! * [`Declarations`]: this node's own interest, refreshed at a third of its lease; it also hears when
//!   another node lays out the content of a channel differently.
//!
//! All of it is soft state: what is not refreshed ends by itself, so a node that dies leaves nothing
//! behind, and a lost frame costs at most one period. None of it needs a broker.
//!
//! # Contract
//! As in [`crate::client`]: feed received frames to `on_frame`, call `poll` until it returns `None` after
//! that and when `next_wakeup` is due. `now` is local time and never goes back.

mod declarations;
mod interests;
mod members;
mod report;

pub use declarations::{Declarations, DeclarationsFull, LayoutMismatch};
pub use interests::{InterestEvent, Interests};
pub use members::{MemberEvent, Members};
pub use report::{Health, StatusReport};
