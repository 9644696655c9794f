//! What is told to browsers, as the page reads it.

use cosmic_monitor::{Finding, Notice, Snapshot};
use serde::Serialize;

/// The first message of a stream.
#[derive(Serialize)]
pub(crate) struct Hello<'a> {
    /// Another one after the server was started anew: what a browser still knows is of no use then.
    pub(crate) instance: &'a str,
    pub(crate) version: &'static str,
    pub(crate) title: &'a str,
    pub(crate) may_publish: bool,
    pub(crate) segments: Vec<SegmentHead<'a>>,
}

#[derive(Serialize)]
pub(crate) struct SegmentHead<'a> {
    pub(crate) name: &'a str,
    pub(crate) link: &'a str,
}

/// All that is known of a segment.
#[derive(Serialize)]
pub(crate) struct State<'a> {
    pub(crate) segment: usize,
    /// The instant that this holds for, by the clock of the segment's link.
    pub(crate) now_ns: u64,
    /// What is wrong with the link; `None` if it is up.
    pub(crate) trouble: Option<&'a str>,
    pub(crate) snapshot: &'a Snapshot,
    pub(crate) findings: &'a [Finding],
}

/// What has crossed the bus since the last of these.
#[derive(Serialize)]
pub(crate) struct Frames<'a> {
    pub(crate) segment: usize,
    /// Frames of the segment since the hub knows it, these included.
    pub(crate) total: u64,
    /// Frames since the last message that are not told, for there were too many.
    pub(crate) untold: u64,
    pub(crate) frames: &'a [Line],
}

/// A frame, as an array. `None` where a frame that is not COSMIC's has no such thing.
#[derive(Serialize)]
pub(crate) struct Line(
    /// When it ended, in microseconds of the link's clock.
    pub(crate) f64,
    /// How long it took on the bus, in microseconds; 0 if the link did not say what it was.
    pub(crate) f64,
    /// Its class: 0 hard, 1 soft, 2 non real-time, 3 foreign.
    pub(crate) u8,
    /// Its priority.
    pub(crate) Option<u8>,
    /// Its TxNode.
    pub(crate) Option<u8>,
    /// Its etag.
    pub(crate) Option<u16>,
    /// Its bytes, hexadecimal.
    pub(crate) String,
    /// What they mean.
    pub(crate) Said,
);

/// What the bytes of a frame mean.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum Said {
    Nothing,
    /// The values of the fields, in the order of the channel's content.
    Values(Vec<String>),
    Words(String),
}

/// What happened.
#[derive(Serialize)]
pub(crate) struct Notices<'a> {
    pub(crate) segment: usize,
    pub(crate) notices: &'a [Notice],
}

/// What this browser was not told, for it did not keep up.
#[derive(Serialize)]
pub(crate) struct Lost {
    pub(crate) messages: u64,
    pub(crate) frames: u64,
}
