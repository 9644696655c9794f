//! The names that COSMIC has in zenoh.
//!
//! | key | what |
//! |---|---|
//! | `cosmic/1/NETWORK/event/SUBJECT/SEGMENT` | events of the subject, 16 hexadecimal digits, that were published in the segment |
//! | `cosmic/1/NETWORK/clock/SEGMENT/SENDER` | a query here is answered with what the sender's [clock](crate::clock) says, eight bytes |
//! | `cosmic/1/NETWORK/live/SEGMENT/SENDER` | a token of liveliness: the sender speaks for the segment |
//!
//! `1` is the version of the scheme and of the [encoding](crate::encoding). A *network* is what gateways join; two
//! networks on one router do not see each other. A node on IP alone is a segment with one node, under its own name. Since
//! the segment of origin stands in the key, access control can bind it to a certificate: nobody speaks for the segment of
//! another.

use std::fmt;

use cosmic_core::Subject;

use crate::encoding::Sender;

/// The name of a network or of a segment: 1 to 32 of `a`–`z`, `0`–`9`, `-` and `_`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Name(Box<str>);

impl Name {
    /// `None` for a text that is no name.
    pub fn new(text: &str) -> Option<Self> {
        let is_one = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-' | b'_');
        let fits = (1..=32).contains(&text.len()) && text.bytes().all(is_one);
        fits.then(|| Self(text.into()))
    }

    /// Its text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// What stands in the key of an event.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct EventKey {
    /// Its subject.
    pub subject: Subject,
    /// The segment in which it was published.
    pub segment: Name,
}

/// What stands in the key of a token, or of a clock.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SenderKey {
    /// The segment for which it speaks.
    pub segment: Name,
    /// The sender.
    pub sender: Sender,
}

/// The keys of a network.
#[derive(Clone, Debug)]
pub struct Keys {
    prefix: String,
}

impl Keys {
    /// Those of this network.
    pub fn new(network: &Name) -> Self {
        Self { prefix: format!("cosmic/1/{network}") }
    }

    /// Where events of a subject are published that come from this segment.
    pub fn event(&self, subject: Subject, segment: &Name) -> String {
        format!("{}/event/{:016x}/{segment}", self.prefix, subject.get())
    }

    /// Events of a subject from all segments.
    pub fn events(&self, subject: Subject) -> String {
        format!("{}/event/{:016x}/*", self.prefix, subject.get())
    }

    /// Events of all subjects from all segments.
    pub fn all_events(&self) -> String {
        format!("{}/event/*/*", self.prefix)
    }

    /// Where the clock of a sender is asked for.
    pub fn clock(&self, of: &SenderKey) -> String {
        format!("{}/clock/{}/{}", self.prefix, of.segment, of.sender)
    }

    /// The token of a sender.
    pub fn live(&self, of: &SenderKey) -> String {
        format!("{}/live/{}/{}", self.prefix, of.segment, of.sender)
    }

    /// All tokens.
    pub fn all_live(&self) -> String {
        format!("{}/live/*/*", self.prefix)
    }

    /// Whatever has to do with a segment: what a certificate may say that speaks for it.
    pub fn of_segment(&self, segment: &Name) -> [String; 3] {
        let prefix = &self.prefix;
        [
            format!("{prefix}/event/*/{segment}"),
            format!("{prefix}/clock/{segment}/*"),
            format!("{prefix}/live/{segment}/*"),
        ]
    }

    /// Whatever belongs to the network.
    pub fn all(&self) -> String {
        format!("{}/**", self.prefix)
    }

    /// Reads the key of an event.
    pub fn read_event(&self, key: &str) -> Option<EventKey> {
        let [subject, segment] = self.parts(key, "/event/")?;
        Some(EventKey { subject: Subject::new(digits(subject)?)?, segment: Name::new(segment)? })
    }

    /// Reads the key of a token.
    pub fn read_live(&self, key: &str) -> Option<SenderKey> {
        let [segment, sender] = self.parts(key, "/live/")?;
        Some(SenderKey { segment: Name::new(segment)?, sender: Sender(digits(sender)?) })
    }

    fn parts<'a>(&self, key: &'a str, kind: &str) -> Option<[&'a str; 2]> {
        let (first, second) = key.strip_prefix(&self.prefix)?.strip_prefix(kind)?.split_once('/')?;
        Some([first, second])
    }
}

/// Sixteen hexadecimal digits as they are written here, so that nothing has two keys.
fn digits(text: &str) -> Option<u64> {
    let is_digit = |byte: u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
    let fits = text.len() == 16 && text.bytes().all(is_digit);
    fits.then(|| u64::from_str_radix(text, 16).ok())?
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn keys() -> Keys {
        Keys::new(&Name::new("plant").unwrap())
    }

    #[test]
    fn keys_are_written_and_read() {
        let (subject, segment) = (Subject::new(0xC05A).unwrap(), Name::new("line-1").unwrap());
        let key = keys().event(subject, &segment);
        assert_eq!(key, "cosmic/1/plant/event/000000000000c05a/line-1");
        assert_eq!(keys().read_event(&key), Some(EventKey { subject, segment: segment.clone() }));
        let sender = SenderKey { segment, sender: Sender(0xAB) };
        assert_eq!(keys().live(&sender), "cosmic/1/plant/live/line-1/00000000000000ab");
        assert_eq!(keys().read_live(&keys().live(&sender)), Some(sender));
    }

    #[test]
    fn what_is_no_key_is_refused() {
        for key in [
            "cosmic/1/plant/event/000000000000c05a",
            "cosmic/1/plant/event/0000000000000000/a",
            "cosmic/1/plant/event/c05a/a",
            "cosmic/1/plant/event/000000000000c05a/a/b",
            "cosmic/1/plant/event/000000000000c05a/A",
            "cosmic/1/plants/event/000000000000c05a/a",
            "cosmic/2/plant/event/000000000000c05a/a",
        ] {
            assert_eq!(keys().read_event(key), None, "{key}");
        }
        for name in ["", "a/b", "*", "Line", "überall", "123456789012345678901234567890123"] {
            assert_eq!(Name::new(name), None, "{name}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_a_key_or_none(text in "(cosmic/1/plant/(event|live)/)?[0-9a-fA-F+]{0,17}/?[ -~]{0,40}") {
            let _ = keys().read_live(&text);
            if let Some(key) = keys().read_event(&text) {
                prop_assert_eq!(keys().event(key.subject, &key.segment), text);
            }
        }
    }
}
