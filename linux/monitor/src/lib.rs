//! What a listener knows of a segment, from nothing but the frames on its bus.
//!
//! A [`Monitor`] is handed every frame with the instant at which it arrived. It learns which nodes and channels there
//! are, who publishes and subscribes, how full the bus is, what the clock of the cluster says, and what goes wrong.
//! With the [plan](SegmentPlan) of the cluster it also knows names, contents, deadlines and slots. It sends nothing:
//! a segment does not notice that it is watched.
//!
//! ```
//! use cosmic_core::can::{BitRate, TxNode};
//! use cosmic_core::protocol::{NodeState, NodeStatus};
//! use cosmic_core::time::Instant;
//! use cosmic_monitor::Monitor;
//!
//! let mut monitor = Monitor::new(BitRate::MAX, Instant::EPOCH);
//! let status = NodeStatus::first(TxNode::MIN, NodeState::Operational).encode();
//! monitor.on_frame(&status, Instant::EPOCH);
//! let snapshot = monitor.snapshot(Instant::EPOCH);
//! assert_eq!(snapshot.nodes[0].tx_node, 0);
//! println!("{}", monitor.decode(&status));
//! ```
//!
//! # Calling order
//! Call [`Monitor::on_frame`], [`on_foreign`](Monitor::on_foreign), [`on_lost`](Monitor::on_lost),
//! [`on_errors`](Monitor::on_errors) and [`on_bus_off`](Monitor::on_bus_off) as the link tells of them, with instants
//! that do not go back; one that does counts as the latest of them. [`Monitor::snapshot`], [`Monitor::doctor`] and
//! [`Monitor::notices`] may be called at any time.
//!
//! A frame takes time logarithmic in the channels that are known, and linear in who publishes and subscribes on its own, at
//! most 256; a hard frame and a node's status time linear in the slots of the plan, too. The frame by which a node leaves,
//! and once a second any frame, takes time linear in what is known.
//!
//! # Bounds
//! Whatever the bus sends, memory is bounded: 128 nodes, [`MOST_CHANNELS`] channels, [`MOST_PARTICIPANTS`] entries of
//! who publishes and who subscribes: what found no place there is counted ([`Snapshot::overlooked`]), and channels that
//! nobody has used for a minute make room. Of notices the last [`MOST_NOTICES`] are kept, of suspicious senders the last 16
//! of each kind: the older ones make room, and are not counted. Messages of several frames that are on their way at once
//! beyond 32 are dropped, and counted ([`MessagesView`]).
//!
//! # What a listener cannot know
//! * *Which* exceptions a node counted: its status carries only how many. The monitor says what it has seen on the bus
//!   meanwhile that explains them, and otherwise that it does not know.
//! * When an event was published. A soft real-time frame says by its priority how much of its deadline was left when it
//!   was loaded, to one step of the priorities; see [`LatencyView`].
//! * Global time better than the stamps of its link. How well, it says ([`ClockView::uncertainty_ns`]).
//! * What was lost before it arrived here, unless the link tells.
#![forbid(unsafe_code)]

mod brokers;
mod channels;
mod clock;
mod control;
mod decode;
mod digits;
mod doctor;
mod feed;
mod latency;
mod load;
mod messages;
mod monitor;
mod nodes;
mod plan;
mod slots;
mod snapshot;
mod suspects;
mod view;

pub use channels::{MOST_CHANNELS, MOST_PARTICIPANTS};
pub use decode::{Decoded, DecodedField, Meaning, class_name};
pub use digits::{hex_text, hexadecimal};
pub use doctor::{Finding, Rule, Severity};
pub use feed::{Explanation, MOST_NOTICES, Notice, NoticeKind};
pub use monitor::Monitor;
pub use plan::{ByteMessages, PlanRefused, SegmentPlan};
pub use snapshot::{
    ChannelClass, ChannelView, ClockView, ContentView, LatencyView, LinkView, LoadView, MessagesView,
    NodeView, PublisherView, Share, SlotView, Snapshot, SubscriberView,
};
