//! Contents: what stands in the bytes of a channel's events, as the description of the cluster says.
//!
//! A tool on a host that sees frames or events asks the [`Cluster`](crate::cluster::Cluster) for the channel, and for
//! the [`Layout`] of its events:
//!
//! ```
//! use cosmic_plan::cluster::Cluster;
//! use cosmic_plan::document::Source;
//!
//! # let text = include_str!("../../examples/rover.toml");
//! let cluster = Cluster::read(&Source::new("rover.toml", text)).expect("the example is well formed");
//! let subject = 0xB0A0_1C00_0000_0007;
//! let channel = cluster.channels.iter().find(|channel| channel.subject == subject).expect("it is the battery");
//! let layout = cluster.layout_of(channel).expect("its content is described");
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
