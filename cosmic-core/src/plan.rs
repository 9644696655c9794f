//! What a node is built from: the plan of its cluster, as constants.
//!
//! `cosmic-plan` makes them of the description of the cluster, in the build script of the program:
//!
//! ```ignore
//! // build.rs
//! fn main() {
//!     cosmic_plan::compile("cluster.toml");
//! }
//! ```
//!
//! [`include_plan!`](crate::include_plan) brings them into the program, as the module `plan`:
//!
//! | item | is |
//! |---|---|
//! | `plan::CALENDAR` | the calendar; a program with one that was changed by hand does not compile |
//! | `plan::SYNC` | the settings of the clock synchronisation, without a rank |
//! | `plan::channels::wheel_speed::channel::<WheelSpeed>()` | the channel, with subject, etag and quality |
//! | `plan::contents::WheelSpeed` | the type of a content that the description states |
//! | `plan::channels::wheel_speed::CHANNEL` | the channel of such a content |
//! | `plan::nodes::sensor::NODE` | what is this node's own, a [`NodePlan`] |
//! | `plan::NODES`, `plan::CHANNELS` | all of them, in the order of the description |
//! | `plan::ADMISSION` | what becomes of soft real-time channels that the plan does not know, an [`AdmissionPlan`] |
//! | `plan::SEAL` | what a node believes of others, if the cluster is sealed, a [`Seal`] |
//! | `plan::Capacities` | how much a node has room for, a [`Capacity`](crate::event_half::Capacity) |

use crate::admission::AdmissionPlan;
use crate::calendar::Calendar;
use crate::can::filter_banks::FilterBank;
use crate::can::{Etag, TxNode};
use crate::protocol::LayoutHash;
use crate::seal::Seal;
use crate::sync::SyncConfig;
use crate::uid::{NodeUid, Subject};

/// A node as the plan of its cluster has it: all that a runtime wants to know of it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NodePlan {
    /// Its name.
    pub name: &'static str,
    /// Its name in the world.
    pub uid: NodeUid,
    /// Its short id on the segment; `None`: it asks the broker for one.
    pub tx_node: Option<TxNode>,
    /// The settings of its clock, with its place in the succession of masters and the digest of the calendar;
    /// `None` in a cluster without clock synchronisation.
    pub sync: Option<SyncConfig>,
    /// Which frames its controller is to accept: what it subscribes to, the protocol's own as far as they
    /// concern it, and all frames with its own TxNode, which nobody else should send.
    pub filters: &'static [FilterBank],
    /// A broker gives the node its TxNode, or etags of what it subscribes to. Then `filters` has only what is known without
    /// them, and the controller accepts all else until the runtime says [what is wanted](crate::EventHalf::wanted).
    pub named_at_run_time: bool,
    /// The calendar of the segment.
    pub calendar: &'static Calendar,
    /// What it believes of others; `None` if the cluster is not sealed.
    pub seal: Option<&'static Seal>,
    /// What becomes of soft real-time channels that the plan does not know; `None`: any may be published, unproven.
    pub admission: Option<&'static AdmissionPlan>,
    /// The channels that it publishes on.
    pub publishes: &'static [Subject],
    /// The channels that it subscribes to.
    pub subscribes: &'static [Subject],
}

/// A channel as the plan of its cluster has it, without quality and content.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ChannelPlan {
    /// Its name.
    pub name: &'static str,
    /// Its name in the world.
    pub subject: Subject,
    /// Its name on the segment; `None` where the broker gives one.
    pub etag: Option<Etag>,
    /// Bytes of an event at most.
    pub len: usize,
}

/// Returns whether a content of this layout is the one that the plan describes: by the types of its fields (`wire`), or
/// by these and what they mean (`layout`). Content that states no layout is taken as plain bytes.
pub const fn content_fits(content: LayoutHash, wire: LayoutHash, layout: LayoutHash) -> bool {
    let content = content.get();
    content == LayoutHash::UNSTATED.get() || content == wire.get() || content == layout.get()
}

/// Declares the module `plan` with all that `cosmic_plan::compile` has made in the build script; see the
/// [module](crate::plan) for what is in it.
#[macro_export]
macro_rules! include_plan {
    () => {
        /// What the planner has made of the description of the cluster.
        #[allow(dead_code, unreachable_pub, reason = "no program uses all of the plan of its cluster")]
        pub mod plan {
            ::core::include!(::core::concat!(::core::env!("OUT_DIR"), "/plan.rs"));
        }
    };
}
