//! The types that fields of a cluster file have.

use crate::contents::Decimal;
use crate::document::{FromNode, Kind, Mismatch, Node};
use crate::units;
use cosmic_core::Subject;
use cosmic_core::can::{BitRate, TxNode};
use cosmic_core::protocol::Rank;
use cosmic_core::time::Duration;
#[cfg(feature = "cli")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
#[cfg(feature = "cli")]
use std::borrow::Cow;

#[cfg(feature = "cli")]
impl<T: JsonSchema> JsonSchema for crate::document::At<T> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        T::schema_name()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        generator.subschema_for::<T>()
    }
}

macro_rules! described {
    ($type:ty, $name:expr, $schema:tt) => {
        #[cfg(feature = "cli")]
        impl JsonSchema for $type {
            fn schema_name() -> Cow<'static, str> {
                $name.into()
            }

            fn json_schema(_: &mut SchemaGenerator) -> Schema {
                json_schema!($schema)
            }
        }
    };
}

/// A span of time with its unit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Span(pub Duration);

described!(Span, "Span", {
    "type": "string",
    "pattern": r"^[0-9_]+(\.[0-9]+)? ?(ns|us|µs|ms|s)$",
    "description": "A span of time with its unit: \"10 ms\", \"2.5 ms\", \"250 us\"."
});

impl FromNode for Span {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        let help = "write a number and ns, us, ms or s in quotes, such as \"10 ms\"";
        match &node.kind {
            Kind::Text(text) => units::parse_span(text).map(Self).ok_or_else(|| {
                if units::is_too_fine(text) {
                    let what = format!("{text:?} is finer than a nanosecond");
                    return Mismatch::new(what, "round it to whole nanoseconds");
                }
                Mismatch::new(format!("{text:?} is not a span of time"), help)
            }),
            Kind::Number(text, _) => Err(Mismatch::new(
                format!("{text} has no unit"),
                format!("write \"{text} ms\" or \"{text} us\""),
            )),
            _ => Err(Mismatch::new(format!("{} is not a span of time", node.describe()), help)),
        }
    }
}

/// A span of time that is not zero.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PositiveSpan(pub Duration);

described!(PositiveSpan, "PositiveSpan", {
    "type": "string",
    "pattern": r"^[0-9_]+(\.[0-9]+)? ?(ns|us|µs|ms|s)$",
    "description": "A span of time, not zero, with its unit: \"10 ms\", \"2.5 ms\", \"250 us\"."
});

impl FromNode for PositiveSpan {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        match Span::from_node(node)?.0 {
            span if span.is_zero() => Err(Mismatch::new("is zero", "write a span above zero")),
            span => Ok(Self(span)),
        }
    }
}

/// A bit rate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Rate(pub BitRate);

described!(Rate, "Rate", {
    "description": "A bit rate: \"1 Mbit/s\", \"500 kbit/s\", or bits per second.",
    "anyOf": [
        { "type": "string", "pattern": r"^[0-9_]+(\.[0-9]+)? ?(bit/s|kbit/s|Mbit/s)?$" },
        { "type": "integer", "minimum": 10_000, "maximum": 1_000_000 }
    ]
});

impl FromNode for Rate {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        let bits = match &node.kind {
            Kind::Text(text) | Kind::Number(text, 10) => units::parse_bits_per_second(text),
            _ => None,
        };
        let usual = "write 1 Mbit/s, 800, 500, 250, 125, 100, 50, 20 or 10 kbit/s";
        let bits =
            bits.ok_or_else(|| Mismatch::new(format!("{} is not a bit rate", node.describe()), usual))?;
        BitRate::new(bits).map(Self).ok_or_else(|| {
            let what = format!(
                "{bits} bit/s is outside 10 kbit/s..1 Mbit/s, or its bit time is no whole number of nanoseconds"
            );
            Mismatch::new(what, usual)
        })
    }
}

/// A 64-bit UID other than zero.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Uid(pub u64);

described!(Uid, "Uid", {
    "description": "A 64-bit number other than zero, in hexadecimal: \"0x1122334455667788\".",
    "anyOf": [
        { "type": "string", "pattern": "^(0[xX][0-9a-fA-F_]+|[0-9_]+)$" },
        { "type": "integer", "minimum": 1 }
    ]
});

impl FromNode for Uid {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        let help = "write a 64-bit number other than zero, such as \"0x1122334455667788\"";
        let wrong = |what: String| Mismatch::new(what, help);
        match u64::from_node(node).map_err(|_| wrong(format!("{} is not a UID", node.describe())))? {
            0 => Err(wrong("UID 0 is not valid".to_owned())),
            uid => Ok(Self(uid)),
        }
    }
}

/// The subject of a channel: a 64-bit UID other than zero that the protocol does not keep for itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ChannelSubject(pub u64);

described!(ChannelSubject, "ChannelSubject", {
    "description": "A 64-bit number other than zero, below 0xFFFFFFFFFFFFFFFF: \"0x1122334455667788\".",
    "anyOf": [
        { "type": "string", "pattern": "^(0[xX][0-9a-fA-F_]+|[0-9_]+)$" },
        { "type": "integer", "minimum": 1 }
    ]
});

impl FromNode for ChannelSubject {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        let subject = Uid::from_node(node)?.0;
        if Subject::new(subject) == Some(Subject::RESERVED) {
            let what = format!("{subject:#x} is reserved for brokers");
            return Err(Mismatch::new(what, "choose another subject"));
        }
        Ok(Self(subject))
    }
}

/// A node's place in the succession of time masters, or none.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Succession(pub Option<Rank>);

described!(Succession, "Succession", {
    "description": "A place in the succession of time masters, 0 the first; or \"never\".",
    "anyOf": [
        { "type": "integer", "minimum": 0, "maximum": 15 },
        { "type": "string", "enum": ["never"] }
    ]
});

impl FromNode for Succession {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        if matches!(&node.kind, Kind::Text(text) if text == "never") {
            return Ok(Self(None));
        }
        let rank = u8::from_node(node).ok().and_then(Rank::new);
        rank.map(|rank| Self(Some(rank))).ok_or_else(|| {
            let help = format!("write 0 (the first) to {} (the last), or \"never\"", Rank::LAST.get());
            Mismatch::new(format!("{} is no place in the succession of time masters", node.describe()), help)
        })
    }
}

/// A short id that a file gives a node: a number, or the word for a node that asks the broker for one, `None`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ShortId(pub Option<u8>);

described!(ShortId, "ShortId", {
    "description": "A short id, 0 to 126; or \"ask\": the node asks the broker for one.",
    "anyOf": [
        { "type": "integer", "minimum": 0, "maximum": 126 },
        { "type": "string", "enum": ["ask"] }
    ]
});

impl FromNode for ShortId {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        if matches!(&node.kind, Kind::Text(text) if text == "ask") {
            return Ok(Self(None));
        }
        u8::from_node(node).map(|id| Self(Some(id))).map_err(|_| {
            let help = format!("write a number from 0 to {}, or \"ask\"", TxNode::MAX.get());
            Mismatch::new(format!("{} is no short id", node.describe()), help)
        })
    }
}

/// A name that can become a name in Rust.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Name(pub String);

described!(Name, "Name", {
    "type": "string",
    "pattern": "^[a-z][a-z0-9_]*$",
    "description": "Lower-case letters, digits and underscores, a letter first."
});

/// Words that a generated module cannot be called.
const KEYWORDS: [&str; 50] = [
    "abstract", "as", "async", "await", "become", "box", "break", "const", "continue", "crate", "do", "dyn",
    "else", "enum", "extern", "false", "final", "fn", "for", "gen", "if", "impl", "in", "let", "loop",
    "macro", "match", "mod", "move", "mut", "override", "priv", "pub", "ref", "return", "self", "static",
    "struct", "super", "trait", "true", "try", "type", "typeof", "unsafe", "unsized", "use", "virtual",
    "where", "while",
];

impl FromNode for Name {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        Self::check(&String::from_node(node)?).map(Self)
    }
}

impl Name {
    /// The name, if it is one.
    pub(super) fn check(text: &str) -> Result<String, Mismatch> {
        let help = "write lower-case letters, digits and underscores, a letter first, no word of Rust";
        let legal = text.starts_with(|c: char| c.is_ascii_lowercase())
            && text.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
            && !KEYWORDS.contains(&text);
        if legal {
            Ok(text.to_owned())
        } else {
            Err(Mismatch::new(format!("{text:?} cannot be a name"), help))
        }
    }
}

macro_rules! choice {
    ($(#[$doc:meta])* $type:ident { $($(#[$variant_doc:meta])* $variant:ident = $word:literal),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        pub enum $type {
            $($(#[$variant_doc])* $variant,)*
        }

        described!($type, stringify!($type), { "type": "string", "enum": [$($word),*] });

        impl FromNode for $type {
            fn from_node(node: &Node) -> Result<Self, Mismatch> {
                let text = match &node.kind {
                    Kind::Text(text) => text.as_str(),
                    _ => "",
                };
                match text {
                    $($word => Ok(Self::$variant),)*
                    _ => Err(Mismatch::new(
                        format!("{} is not one of the choices", node.describe()),
                        format!("write one of {}", [$($word),*].join(", ")),
                    )),
                }
            }
        }
    };
}

/// An exact decimal.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DecimalNumber(pub Decimal);

described!(DecimalNumber, "DecimalNumber", {
    "type": "number",
    "description": "A decimal number, which is taken exactly: 0.01, -40."
});

impl FromNode for DecimalNumber {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        let number = match &node.kind {
            Kind::Number(text, 10) => Decimal::parse(text),
            Kind::Number(text, base) => {
                i128::from_str_radix(&text.replace('_', ""), *base).ok().map(|number| Decimal::new(number, 0))
            }
            _ => None,
        };
        number.map(Self).ok_or_else(|| {
            let what = format!("{} is not a decimal number of at most 18 digits", node.describe());
            Mismatch::new(what, "write a number without quotes, such as 0.01 or -40")
        })
    }
}

choice! {
    /// How bits and bytes follow each other.
    OrderName {
        /// The most significant first (Motorola).
        Big = "big",
        /// The least significant first (Intel).
        Little = "little",
    }
}

choice! {
    /// The class of a channel.
    ClassName {
        /// Hard real-time.
        Hard = "HRT",
        /// Soft real-time.
        Soft = "SRT",
        /// Non real-time.
        NonRealTime = "NRT",
    }
}

choice! {
    /// What becomes of a soft real-time channel that a node announces and that is not in the file.
    UnplannedName {
        /// It is published, unproven.
        Allow = "allow",
        /// The node asks the broker's node, and publishes when that has admitted it.
        Ask = "ask",
        /// It cannot be announced.
        Refuse = "refuse",
        /// It is sent as a non real-time channel of the least importance.
        NonRealTime = "non-real-time",
    }
}

choice! {
    /// How etags of soft and non real-time channels are found.
    BindingName {
        /// Fixed in the plan.
        Static = "static",
        /// By the broker at run time.
        Broker = "broker",
    }
}
