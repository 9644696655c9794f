//! Contents: what stands in the bytes of a channel's events, as the description of the cluster says.
//!
//! A tool on a host that sees frames or events asks [`Contents`] for the channel, and the channel's [`Layout`] for
//! the fields:
//!
//! ```
//! use cosmic_plan::contents::Contents;
//! use cosmic_plan::document::Source;
//!
//! # let text = include_str!("../../examples/rover.toml");
//! let source = Source::new("rover.toml", text);
//! let contents = Contents::read(&source).expect("the example is well formed");
//! let channel = contents.of_subject(0xB0A0_1C00_0000_0007).expect("it is the battery");
//! let layout = channel.layout.expect("its content is described");
//! let fields = layout.decode(&[0x2E, 0xE0, 0xFF, 0x9C, 65, 80 << 1]).expect("that is one");
//! let text: Vec<String> = fields.iter().map(ToString::to_string).collect();
//! assert_eq!(text, ["voltage = 12 V", "current = -1 A", "temperature = 25 °C", "charge = 80 %"]);
//! let values = [("voltage", "12"), ("current", "-1"), ("charge", "80"), ("temperature", "25")];
//! assert_eq!(layout.encode_text(&values), Ok(vec![0x2E, 0xE0, 0xFF, 0x9C, 65, 80 << 1]));
//! ```
//!
//! Etags of channels that a broker binds at run time are not in the file; such a channel is found by its subject.

mod codec;
mod decimal;
mod layout;

pub use codec::{Field, NotDecoded, NotEncoded, Value};
pub use decimal::Decimal;
pub use layout::{ByteOrder, FieldLayout, FieldType, Label, Layout, Scaling, camel_case};

use crate::cluster::{Channel, Cluster};
use crate::document::{Problems, Source};
use cosmic_core::can::Etag;

/// The contents of a cluster's channels.
#[derive(Clone, Debug)]
pub struct Contents {
    cluster: Cluster,
}

/// A channel with its content.
#[derive(Clone, Copy, Debug)]
pub struct Described<'a> {
    /// The channel.
    pub channel: &'a Channel,
    /// What stands in its events; `None` if the file does not say.
    pub layout: Option<&'a Layout>,
}

impl Contents {
    /// Reads the description of a cluster. It is not planned: this takes no time.
    ///
    /// # Errors
    /// All that is wrong with the description.
    pub fn read(source: &Source) -> Result<Self, Problems> {
        Cluster::read(source).map(Self::of)
    }

    /// The contents of a cluster that has been read.
    pub fn of(cluster: Cluster) -> Self {
        Self { cluster }
    }

    /// The cluster.
    pub fn cluster(&self) -> &Cluster {
        &self.cluster
    }

    /// All channels, in the order of the file.
    pub fn channels(&self) -> impl Iterator<Item = Described<'_>> {
        self.cluster.channels.iter().map(|channel| self.described(channel))
    }

    /// The channel of this subject.
    pub fn of_subject(&self, subject: u64) -> Option<Described<'_>> {
        self.channels().find(|described| described.channel.subject == subject)
    }

    /// The channel to which the file gives this etag.
    pub fn of_etag(&self, etag: Etag) -> Option<Described<'_>> {
        self.channels().find(|described| described.channel.etag == Some(etag))
    }

    /// The channel of this name.
    pub fn named(&self, name: &str) -> Option<Described<'_>> {
        self.channels().find(|described| described.channel.name == name)
    }

    fn described<'a>(&'a self, channel: &'a Channel) -> Described<'a> {
        Described { channel, layout: self.cluster.layout_of(channel) }
    }
}
