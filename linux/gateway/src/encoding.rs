//! An event between segments: what must survive the way, and its bytes.
//!
//! The subject and the segment of origin stand in the [key](crate::keys), so that access control looks at them. All else
//! stands in the payload, big-endian, version 1:
//!
//! | bytes | what |
//! |---|---|
//! | 0 | version, 1 |
//! | 1 | class at its origin: 0 hard, 1 soft, 2 non real-time |
//! | 2 | TxNode of the publisher in its segment; 0xFF: it is no node of a segment |
//! | 3 | zero |
//! | 4..8 | hash of the content's layout; 0: not stated |
//! | 8..16 | the sender: a number that a gateway or a node draws at its start |
//! | 16..24 | number of the event among those of this sender, segment and subject |
//! | 24..32 | when it was sent, in nanoseconds of the [sender's clock](crate::clock) |
//! | 32..40 | nanoseconds from then to its deadline; all ones: it has none |
//! | 40..48 | nanoseconds from then until it expires; all ones: it keeps for ever |
//! | 48.. | attributes of context and content, as its frame carries them: at most 1024 bytes |

use std::fmt;

use cosmic_core::can::TxNode;
use cosmic_core::protocol::{Class, LayoutHash};
use cosmic_core::time::Duration;

use crate::clock::Reading;

/// Who sent an event: a gateway or a node on IP, from its start on.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Sender(pub u64);

impl Sender {
    /// One that nobody else has drawn.
    pub fn draw() -> Self {
        use std::hash::{BuildHasher as _, RandomState};
        Self(RandomState::new().hash_one(std::process::id()))
    }
}

impl fmt::Display for Sender {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

/// An event on its way between segments.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Envelope {
    /// Its class where it was published. It never arrives as a hard real-time event.
    pub class: Class,
    /// Its publisher in the segment of origin; `None` if that is no node of a segment.
    pub node: Option<TxNode>,
    /// How its content is laid out.
    pub layout: LayoutHash,
    /// Who sent it.
    pub sender: Sender,
    /// Its number among the events of this sender, segment and subject.
    pub sequence: u64,
    /// When it was sent, by the sender's clock.
    pub sent_at: Reading,
    /// From then to its deadline.
    pub to_deadline: Option<Duration>,
    /// From then until it is of no use any more.
    pub to_expiry: Option<Duration>,
    /// Attributes of context and content.
    pub content: Vec<u8>,
}

/// Why bytes are no event.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[non_exhaustive]
pub enum NoEnvelope {
    /// They are of another version.
    Version(u8),
    /// They are too few, too many, or contradict themselves.
    Malformed,
}

impl fmt::Display for NoEnvelope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(version) => {
                write!(f, "an event of version {version}, not {VERSION}: run the same version on both sides")
            }
            Self::Malformed => f.write_str("bytes that are no event"),
        }
    }
}

impl std::error::Error for NoEnvelope {}

/// The version of the encoding.
pub const VERSION: u8 = 1;
/// The longest content.
pub const MAX_CONTENT: usize = 1024;

impl Envelope {
    /// Its bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + self.content.len());
        let node = self.node.map_or(NO_NODE, TxNode::get);
        bytes.extend([VERSION, self.class as u8, node, 0]);
        bytes.extend(self.layout.get().to_be_bytes());
        let span = |span: Option<Duration>| span.map_or(NONE, |span| span.as_ticks());
        let numbers =
            [self.sender.0, self.sequence, self.sent_at.0, span(self.to_deadline), span(self.to_expiry)];
        for number in numbers {
            bytes.extend(number.to_be_bytes());
        }
        bytes.extend(&self.content);
        bytes
    }

    /// The event that these bytes are.
    ///
    /// # Errors
    /// [`NoEnvelope`]
    pub fn decode(bytes: &[u8]) -> Result<Self, NoEnvelope> {
        match bytes.first() {
            Some(&VERSION) => Self::decode_this(bytes).ok_or(NoEnvelope::Malformed),
            Some(&version) => Err(NoEnvelope::Version(version)),
            None => Err(NoEnvelope::Malformed),
        }
    }

    fn decode_this(bytes: &[u8]) -> Option<Self> {
        let ([_, class, node, 0], rest) = bytes.split_first_chunk::<4>()? else { return None };
        let (layout, rest) = rest.split_first_chunk::<4>()?;
        let (numbers, content) = rest.split_at_checked(HEADER - 8)?;
        let mut numbers =
            numbers.chunks_exact(8).filter_map(|bytes| Some(u64::from_be_bytes(bytes.try_into().ok()?)));
        let class = match class {
            0 => Class::Hard,
            1 => Class::Soft,
            2 => Class::NonRealTime,
            _ => return None,
        };
        let node = match *node {
            NO_NODE => None,
            node => Some(TxNode::new(node)?),
        };
        let span = |ticks: u64| (ticks != NONE).then(|| Duration::from_ticks(ticks));
        let envelope = Self {
            class,
            node,
            layout: LayoutHash::new(u32::from_be_bytes(*layout)),
            sender: Sender(numbers.next()?),
            sequence: numbers.next()?,
            sent_at: Reading(numbers.next()?),
            to_deadline: span(numbers.next()?),
            to_expiry: span(numbers.next()?),
            content: content.to_vec(),
        };
        let in_order = match (envelope.to_deadline, envelope.to_expiry) {
            (Some(deadline), Some(expiry)) => deadline <= expiry,
            _ => true,
        };
        (content.len() <= MAX_CONTENT && in_order).then_some(envelope)
    }
}

const HEADER: usize = 48;
const NO_NODE: u8 = 0xFF;
const NONE: u64 = u64::MAX;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn heat() -> Envelope {
        Envelope {
            class: Class::Soft,
            node: TxNode::new(9),
            layout: LayoutHash::new(0x0102_0304),
            sender: Sender(0xA0),
            sequence: 7,
            sent_at: Reading(0x1122),
            to_deadline: Some(Duration::from_millis(5)),
            to_expiry: None,
            content: vec![0xCA, 0xFE],
        }
    }

    #[test]
    fn an_event_has_its_bytes() {
        let mut bytes = vec![1, 1, 9, 0, 1, 2, 3, 4];
        bytes.extend([0, 0, 0, 0, 0, 0, 0, 0xA0]);
        bytes.extend([0, 0, 0, 0, 0, 0, 0, 7]);
        bytes.extend([0, 0, 0, 0, 0, 0, 0x11, 0x22]);
        bytes.extend([0, 0, 0, 0, 0, 0x4C, 0x4B, 0x40]);
        bytes.extend([0xFF; 8]);
        bytes.extend([0xCA, 0xFE]);
        assert_eq!(heat().encode(), bytes);
        assert_eq!(Envelope::decode(&bytes), Ok(heat()));
    }

    #[test]
    fn what_is_no_event_is_refused() {
        let good = heat().encode();
        let with = |at: usize, byte: u8| {
            let mut bytes = good.clone();
            bytes[at] = byte;
            Envelope::decode(&bytes)
        };
        assert_eq!(with(0, 2), Err(NoEnvelope::Version(2)));
        for (at, byte) in [(1, 3), (2, 0x80), (3, 1)] {
            assert_eq!(with(at, byte), Err(NoEnvelope::Malformed), "byte {at}");
        }
        assert_eq!(Envelope::decode(&[]), Err(NoEnvelope::Malformed));
        assert_eq!(Envelope::decode(&good[..47]), Err(NoEnvelope::Malformed));
        let expires_first = Envelope { to_expiry: Some(Duration::from_millis(4)), ..heat() };
        assert_eq!(Envelope::decode(&expires_first.encode()), Err(NoEnvelope::Malformed));
        let long = Envelope { content: vec![0; MAX_CONTENT + 1], ..heat() };
        assert_eq!(Envelope::decode(&long.encode()), Err(NoEnvelope::Malformed));
    }

    proptest! {
        #[test]
        fn any_bytes_are_an_event_or_none(mut bytes in proptest::collection::vec(any::<u8>(), 0..80), version in any::<bool>()) {
            if version && bytes.len() > 3 {
                let start = [VERSION, bytes[1] % 3, bytes[2] % 128, 0];
                bytes[..4].copy_from_slice(&start);
            }
            if let Ok(envelope) = Envelope::decode(&bytes) {
                prop_assert_eq!(envelope.encode(), bytes);
            }
        }
    }
}
