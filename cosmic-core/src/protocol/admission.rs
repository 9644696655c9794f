//! Admission: a node asks for a soft real-time channel that the plan does not know, and the broker's node answers.
//!
//! Both messages are one frame each, so that none of them can be half lost. The spans of time have 14 bits; each is
//! rounded so that more is asked for than will be used. Old nodes know neither etag and ignore both.

use super::{Lease, control_data, control_frame, etag_of, tx_node_of};
use crate::can::{Etag, Frame, Payload, TxNode};
use crate::time::Duration;

/// A span of time in 14 bits: in microseconds up to 1023, and beyond that with an error of 0.2 % at most, up to
/// [`CoarseSpan::MAX`], which is twelve days.
///
/// Five bits are an exponent e and nine a mantissa m: m µs if e is 0, and (512 + m) · 2^(e − 1) µs otherwise.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CoarseSpan(u16);

impl CoarseSpan {
    /// No time.
    pub const ZERO: Self = Self(0);
    /// The longest span.
    pub const MAX: Self = Self(0x3FFF);

    /// The longest that is not longer than `span`.
    pub const fn floor(span: Duration) -> Self {
        let mantissa = span.as_micros();
        let bits = u64::BITS.saturating_sub(mantissa.leading_zeros()) as u16;
        let halvings = bits.saturating_sub(MANTISSA_BITS.saturating_add(1));
        if halvings > MOST_HALVINGS { Self::MAX } else { Self::of(mantissa >> halvings, halvings) }
    }

    /// The shortest that is not shorter than `span`; `None` if `span` is longer than [`Self::MAX`].
    pub const fn ceil(span: Duration) -> Option<Self> {
        let floor = Self::floor(span);
        if floor.duration().as_ticks() >= span.as_ticks() {
            Some(floor)
        } else if floor.0 < Self::MAX.0 {
            // The codes are in the order of the spans.
            Some(Self(floor.0.saturating_add(1)))
        } else {
            None
        }
    }

    /// The span.
    pub const fn duration(self) -> Duration {
        let (exponent, mantissa) = (self.0 >> MANTISSA_BITS, (self.0 as u64) & (HIDDEN - 1));
        let micros = match exponent.checked_sub(1) {
            None => mantissa,
            Some(halvings) => (HIDDEN | mantissa) << halvings,
        };
        // It fits; the compiler need not know.
        Duration::from_ticks(micros.saturating_mul(Duration::from_micros(1).as_ticks()))
    }

    /// Returns whether it is no time.
    pub const fn is_zero(self) -> bool {
        self.0 == 0
    }

    /// `mantissa` below twice the hidden bit, halved so often.
    const fn of(mantissa: u64, halvings: u16) -> Self {
        if mantissa < HIDDEN {
            return Self(mantissa as u16);
        }
        Self(halvings.saturating_add(1) << MANTISSA_BITS | (mantissa & (HIDDEN - 1)) as u16)
    }

    const fn from_bits(bits: u64) -> Self {
        Self((bits & Self::MAX.0 as u64) as u16)
    }
}

/// Which of its questions about a channel a node means: counted from 0 to 7, over and over.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AskNumber(u8);

impl AskNumber {
    /// The low three bits of `number`.
    pub const fn new(number: u8) -> Self {
        Self(number & MOST_ASK)
    }

    /// The value, 0..=7.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The one behind it.
    #[must_use]
    pub const fn next(self) -> Self {
        Self::new(self.0.wrapping_add(1))
    }
}

/// "May I publish on this soft real-time channel, so often and with this deadline?" Or, of one that was admitted: "I
/// still do."
///
/// `[held (1 bit), number (3 bits), length (4 bits), etag, interval, tolerance, deadline (14 bits each)]`, the sender in
/// the identifier.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AdmissionRequest {
    /// The node that will publish.
    pub tx_node: TxNode,
    /// The channel.
    pub etag: Etag,
    /// Which question this is. An answer has the same.
    pub number: AskNumber,
    /// It was admitted, and is being published.
    pub held: bool,
    /// Bytes of an event at most: 0..=8.
    pub len: u8,
    /// The period, or the least distance of two events; not zero.
    pub interval: CoarseSpan,
    /// How far before its nominal instant an event may come: jitter, and what a burst takes.
    pub tolerance: CoarseSpan,
    /// From publication until an event is to be sent; not zero.
    pub deadline: CoarseSpan,
}

impl AdmissionRequest {
    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        let held = if self.held { HELD } else { 0 };
        let head = held | self.number.0 << NUMBER_SHIFT | self.len & MOST_LEN;
        let fields = [self.etag.get(), self.interval.0, self.tolerance.0, self.deadline.0];
        let bits = fields.iter().fold(u64::from(head), |bits, field| bits << FIELD_BITS | u64::from(*field));
        control_frame(self.tx_node, Etag::ADMISSION_REQUEST, bits.to_be_bytes())
    }

    /// The message in `frame`, if it is one: only a node asks, for an etag that is bound at run time, with an interval
    /// and a deadline that are not zero.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let data = control_data(frame, Etag::ADMISSION_REQUEST)?;
        let [head, ..] = data;
        let bits = u64::from_be_bytes(data);
        // From the last to the first.
        let [deadline, tolerance, interval, etag] =
            [0, 14, 28, 42].map(|at| CoarseSpan::from_bits(bits >> at));
        let request = Self {
            tx_node: frame.id.tx_node(),
            etag: etag_of(etag.0),
            number: AskNumber::new(head >> NUMBER_SHIFT),
            held: head & HELD != 0,
            len: head & MOST_LEN,
            interval,
            tolerance,
            deadline,
        };
        let is_sound = request.tx_node != TxNode::BROKER
            && request.etag >= Etag::BOUND_FIRST
            && usize::from(request.len) <= Payload::MAX_LEN
            && !request.interval.is_zero()
            && !request.deadline.is_zero();
        is_sound.then_some(request)
    }
}

/// What the broker's node says to an [`AdmissionRequest`].
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AdmissionVerdict {
    /// It may, for so long; then it is to have asked again.
    Admitted(Lease),
    /// It may not, or not any more.
    Refused(AdmissionRefusal),
}

/// Why a channel may not be published.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AdmissionRefusal {
    /// Why.
    pub reason: RefusalReason,
    /// At this longer interval, with all else as it was asked for, it would have been admitted.
    pub fits_at: Option<CoarseSpan>,
    /// The channel that would be late, if it is another one and has an etag.
    pub suffers: Option<Etag>,
}

/// Why a channel is not admitted, as it stands in a frame.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RefusalReason {
    /// All channels together would take more than the bus has, or so nearly that it cannot be told.
    Utilisation = 1,
    /// The deadline is too short for what can be before it on the bus, whatever the rate.
    Blocking = 2,
    /// The channel itself might be late.
    Late = 3,
    /// Another soft real-time channel might be late.
    OtherLate = 4,
    /// A non real-time or foreign frame with a deadline might be late, which is planned.
    LessUrgentLate = 5,
    /// The broker's node holds as many admitted channels as it has room for.
    Full = 6,
}

impl RefusalReason {
    const ALL: [Self; 6] =
        [Self::Utilisation, Self::Blocking, Self::Late, Self::OtherLate, Self::LessUrgentLate, Self::Full];
}

/// The answer to an [`AdmissionRequest`].
///
/// `[requester, verdict (4 bits) 0 (1 bit) number (3 bits), etag (16 bits), lease in 0.1 s or interval that would fit (16
/// bits), etag that suffers (16 bits)]`; etag 0 is none, and so is an interval of 0. The sender is [`TxNode::BROKER`].
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AdmissionReply {
    /// Who asked.
    pub requester: TxNode,
    /// The channel that was asked for.
    pub etag: Etag,
    /// Which question is answered.
    pub number: AskNumber,
    /// The answer.
    pub verdict: AdmissionVerdict,
}

impl AdmissionReply {
    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        let (code, span, suffers) = match self.verdict {
            AdmissionVerdict::Admitted(lease) => (0, lease.steps(), 0),
            AdmissionVerdict::Refused(AdmissionRefusal { reason, fits_at, suffers }) => {
                (reason as u8, fits_at.map_or(0, |span| span.0), suffers.map_or(0, Etag::get))
            }
        };
        let ([a, b], [c, d], [e, f]) =
            (self.etag.get().to_be_bytes(), span.to_be_bytes(), suffers.to_be_bytes());
        let verdict = code << NUMBER_SHIFT | self.number.0;
        control_frame(
            TxNode::BROKER,
            Etag::ADMISSION_REPLY,
            [self.requester.get(), verdict, a, b, c, d, e, f],
        )
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let [requester, verdict, a, b, c, d, e, f] = control_data(frame, Etag::ADMISSION_REPLY)?;
        let [etag, span, suffers] = [[a, b], [c, d], [e, f]].map(u16::from_be_bytes);
        let is_sound = frame.id.tx_node() == TxNode::BROKER
            && requester < TxNode::BROKER.get()
            && verdict & RESERVED == 0
            && [etag, span, suffers].iter().all(|field| *field <= Etag::BOUND_LAST.get())
            && etag >= Etag::BOUND_FIRST.get();
        if !is_sound {
            return None;
        }
        let code = verdict >> NUMBER_SHIFT;
        let verdict_of = |reason: RefusalReason| {
            let fits_at = Some(CoarseSpan(span)).filter(|span| !span.is_zero());
            let suffers = Some(etag_of(suffers)).filter(|etag| etag.get() != 0);
            AdmissionVerdict::Refused(AdmissionRefusal { reason, fits_at, suffers })
        };
        let verdict_with = match RefusalReason::ALL.into_iter().find(|reason| *reason as u8 == code) {
            Some(reason) => verdict_of(reason),
            None if code == 0 && span != 0 && suffers == 0 => {
                AdmissionVerdict::Admitted(Lease::from_steps(span))
            }
            None => return None,
        };
        Some(Self {
            requester: tx_node_of(requester),
            etag: etag_of(etag),
            number: AskNumber::new(verdict),
            verdict: verdict_with,
        })
    }
}

/// The bit of the mantissa that is not sent.
const HIDDEN: u64 = 1 << MANTISSA_BITS;

const MANTISSA_BITS: u16 = 9;

/// The most often that a mantissa of ten bits is doubled: the exponent has five bits.
const MOST_HALVINGS: u16 = 30;

/// Bits of an etag and of a span.
const FIELD_BITS: u32 = 14;

const MOST_ASK: u8 = 7;
const MOST_LEN: u8 = 0xF;
const HELD: u8 = 0x80;
const RESERVED: u8 = 0x08;
const NUMBER_SHIFT: u32 = 4;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn spans_at_the_ends_of_their_steps() {
        let floor = |us| CoarseSpan::floor(Duration::from_micros(us)).duration().as_micros();
        let ceil = |us| CoarseSpan::ceil(Duration::from_micros(us)).map(|span| span.duration().as_micros());
        for exact in [0, 1, 511, 512, 1023, 1024, 1026, 10_000, 20_480] {
            assert_eq!((floor(exact), ceil(exact)), (exact, Some(exact)));
        }
        assert_eq!((floor(1025), ceil(1025)), (1024, Some(1026)));
        assert_eq!((floor(2047), ceil(2047)), (2046, Some(2048)));
        let longest = CoarseSpan::MAX.duration().as_micros();
        assert_eq!(longest, 1023 << 30);
        assert_eq!(
            (floor(longest), ceil(longest), floor(u64::MAX / 1000)),
            (longest, Some(longest), longest)
        );
        assert_eq!(ceil(longest + 1), None);
    }

    proptest! {
        #[test]
        fn spans_are_rounded_by_two_thousandths_at_most(ticks in 0..=CoarseSpan::MAX.duration().as_ticks()) {
            let span = Duration::from_ticks(ticks);
            let (floor, ceil) = (CoarseSpan::floor(span).duration(), CoarseSpan::ceil(span).unwrap().duration());
            prop_assert!(floor <= span && span <= ceil);
            prop_assert!((ceil.as_ticks() - floor.as_ticks()) <= 1000 + ticks / 500);
        }

        #[test]
        fn each_code_is_the_span_that_it_stands_for(code in 0..=0x3FFFu16) {
            let span = CoarseSpan(code).duration();
            prop_assert_eq!(CoarseSpan::floor(span), CoarseSpan(code));
            prop_assert_eq!(CoarseSpan::ceil(span), Some(CoarseSpan(code)));
        }
    }
}
