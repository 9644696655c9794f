//! The course of a transmission: what happens to a frame that has won the bus, bit by bit, worked out at
//! its start.
//!
//! Offsets are in bits behind the start of frame: offset n is the *end* of bit n - 1 and the start of
//! bit n. An error seen in bit p is signalled from bit p + 1 on. The error flags of the stations
//! overlap: whoever sees the error first sends six dominant bits, and the others see a violation of the
//! stuffing rule in them at the latest, so that the bus stays dominant for 6 to 12 bits. Eight recessive
//! bits of delimiter and three of intermission follow (ISO 11898-1, error frame).
//!
//! One simplification: all stations see the end of an error frame at the same bit. In truth an error
//! passive station may need some bits more.

use crate::bits::{
    ERROR_DELIMITER_BITS, FLAG_BITS, Field, INTERMISSION_BITS, Level, RUN, TAIL_BITS, WireBit, WireBits,
};
use crate::event::ErrorCause;
use crate::trace::Origin;

/// Which counter of the sender an error touches.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum SenderCounts {
    /// The transmit error counter.
    Transmit,
    /// The receive error counter: the sender believed it had lost arbitration.
    Receive,
    /// Neither (ISO 11898-1, the two exceptions of fault confinement).
    Nothing,
}

/// An error that ends a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Disturbance {
    pub(crate) bit: u32,
    pub(crate) field: Field,
    pub(crate) cause: ErrorCause,
    pub(crate) origin: Origin,
    pub(crate) sender_counts: SenderCounts,
    /// Whether the receivers took the frame for failed, too.
    pub(crate) receivers_count: bool,
}

/// Something to do during a transmission.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Milestone {
    /// The receivers accept.
    Accept,
    /// The error is seen.
    Disturb,
    /// The senders are done.
    Complete,
    /// The error frame is over; the senders will try again.
    Fail,
}

/// The steps of a transmission, each at its offset, and the offset at which the bus is free again.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Course {
    pub(crate) steps: [Option<(u32, Milestone)>; 3],
    pub(crate) disturbance: Option<Disturbance>,
    pub(crate) free: u32,
}

impl Course {
    /// The frame is sent and acknowledged.
    pub(crate) const fn undisturbed(bits: u32) -> Self {
        Self {
            steps: [Some((bits - 1, Milestone::Accept)), Some((bits, Milestone::Complete)), None],
            disturbance: None,
            free: bits + INTERMISSION_BITS,
        }
    }

    /// A frame that ends in an error frame, whose last flag ends before offset `flags_end`.
    pub(crate) const fn broken(disturbance: Disturbance, flags_end: u32) -> Self {
        let end = flags_end + ERROR_DELIMITER_BITS;
        Self {
            steps: [Some((disturbance.bit + 1, Milestone::Disturb)), Some((end, Milestone::Fail)), None],
            disturbance: Some(disturbance),
            free: end + INTERMISSION_BITS,
        }
    }

    /// Nobody acknowledges.
    pub(crate) const fn unacknowledged(bits: u32, sender_is_active: bool) -> Self {
        let bit = bits - TAIL_BITS + 1;
        // An error passive station that is alone does not count on: it would end bus-off by itself.
        let sender_counts = if sender_is_active { SenderCounts::Transmit } else { SenderCounts::Nothing };
        let disturbance = Disturbance {
            bit,
            field: Field::AcknowledgeSlot,
            cause: ErrorCause::Acknowledgement,
            origin: Origin::NoReceiver,
            sender_counts,
            receivers_count: false,
        };
        Self::broken(disturbance, bit + 1 + FLAG_BITS)
    }

    /// Some receivers see an error in the last but one bit, and signal it in the last. The transmitter sees
    /// that and fails. Those who had accepted take it for an overload flag and answer with one.
    pub(crate) const fn omitted(bits: u32) -> Self {
        let disturbance = Disturbance {
            bit: bits - 1,
            field: Field::EndOfFrame,
            cause: ErrorCause::Form,
            origin: Origin::Fault,
            sender_counts: SenderCounts::Transmit,
            receivers_count: false,
        };
        let end = bits + FLAG_BITS + ERROR_DELIMITER_BITS;
        Self {
            steps: [
                Some((bits - 1, Milestone::Accept)),
                Some((bits, Milestone::Disturb)),
                Some((end, Milestone::Fail)),
            ],
            disturbance: Some(disturbance),
            free: end + INTERMISSION_BITS,
        }
    }

    /// The same, but the transmitter does not see the flags in the last bit, only their rest in its
    /// intermission, which to it is an overload flag: it answers one bit later than the others.
    pub(crate) const fn omitted_unseen(bits: u32) -> Self {
        Self {
            free: bits + 1 + FLAG_BITS + ERROR_DELIMITER_BITS + INTERMISSION_BITS,
            ..Self::undisturbed(bits)
        }
    }
}

/// Who is there to signal an error.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Parties {
    /// Whether any sender is error active.
    pub(crate) active_sender: bool,
    /// Whether there is any receiver.
    pub(crate) receiver: bool,
    /// Whether any receiver is error active.
    pub(crate) active_receiver: bool,
}

/// The course of a frame in which the level of the bus is inverted in one bit, for all stations.
pub(crate) fn inverted(bits: &WireBits, bit: u32, parties: Parties) -> Course {
    let len = bits.len();
    let acknowledge_slot = len - TAIL_BITS + 1;
    if !parties.receiver && bit >= acknowledge_slot {
        // The inverted slot itself looks like an acknowledgement.
        return if bit == acknowledge_slot {
            Course::undisturbed(len)
        } else {
            Course::unacknowledged(len, parties.active_sender)
        };
    }
    let hit = bits.as_slice()[bit as usize];
    match hit.field {
        Field::EndOfFrame if bit == len - 1 => Course::omitted(len),
        Field::Arbitration if hit.level == Level::Recessive => inverted_in_arbitration(hit, bit),
        Field::AcknowledgeSlot => {
            let seen = disturbance(hit, bit, ErrorCause::Acknowledgement, SenderCounts::Transmit);
            Course::broken(seen, bit + 1 + FLAG_BITS)
        }
        Field::CrcDelimiter | Field::AcknowledgeDelimiter | Field::EndOfFrame => {
            // The receivers see a form error in the same bit.
            let seen = disturbance(hit, bit, ErrorCause::Bit, SenderCounts::Transmit);
            Course::broken(seen, bit + 1 + FLAG_BITS)
        }
        Field::StartOfFrame | Field::Arbitration | Field::Control | Field::Data | Field::Crc => {
            let seen = disturbance(hit, bit, ErrorCause::Bit, SenderCounts::Transmit);
            let mut levels: Vec<Level> = bits.levels().take(bit as usize).collect();
            levels.push(hit.level.inverted());
            Course::broken(seen, flags_end(&levels, parties))
        }
    }
}

/// A recessive bit of the arbitration field became dominant: no bit error there.
fn inverted_in_arbitration(hit: WireBit, bit: u32) -> Course {
    if hit.is_stuff_bit {
        // The sixth equal bit, for everybody at once; the sender does not count it.
        let seen = disturbance(hit, bit, ErrorCause::Stuff, SenderCounts::Nothing);
        return Course::broken(seen, bit + 1 + FLAG_BITS);
    }
    // The sender believes it has lost and falls silent; six recessive bits later all see the violation.
    let bit = bit + RUN + 1;
    let seen = disturbance(hit, bit, ErrorCause::Stuff, SenderCounts::Receive);
    Course::broken(seen, bit + 1 + FLAG_BITS)
}

const fn disturbance(hit: WireBit, bit: u32, cause: ErrorCause, sender_counts: SenderCounts) -> Disturbance {
    Disturbance { bit, field: hit.field, cause, origin: Origin::Fault, sender_counts, receivers_count: true }
}

/// The end of the last error flag after a bit error in the stuffed part of a frame: `levels` are those on
/// the bus up to and including the bit in which the first station saw the error.
pub(crate) fn flags_end(levels: &[Level], parties: Parties) -> u32 {
    let first_flag_end = levels.len() as u32 + FLAG_BITS;
    let run_of = |level| {
        let run = levels.iter().rev().take_while(|seen| **seen == level).count();
        (run as u32).min(FLAG_BITS)
    };
    let seen_by_all = run_of(Level::Dominant).max(run_of(Level::Recessive)) == FLAG_BITS;
    let only_passive_receivers = parties.active_sender && !parties.active_receiver;
    if seen_by_all || !parties.receiver || only_passive_receivers {
        return first_flag_end;
    }
    // The receivers see the sixth equal bit so much later: dominant ones of an active sender's flag, or
    // the recessive bus that a passive sender leaves behind.
    let flag_level = if parties.active_sender { Level::Dominant } else { Level::Recessive };
    first_flag_end + FLAG_BITS - run_of(flag_level)
}

#[cfg(test)]
mod tests {
    use super::*;
    use Level::{Dominant as D, Recessive as R};

    const ALL_ACTIVE: Parties = Parties { active_sender: true, receiver: true, active_receiver: true };

    #[test]
    fn flags_overlap_by_the_run_before_them() {
        assert_eq!(flags_end(&[D, R], ALL_ACTIVE), 2 + 12);
        assert_eq!(flags_end(&[R, D], ALL_ACTIVE), 2 + 11);
        assert_eq!(flags_end(&[R, D, D, D, D, D], ALL_ACTIVE), 6 + 7);
        assert_eq!(flags_end(&[D, D, D, D, D, D], ALL_ACTIVE), 6 + 6);
        assert_eq!(flags_end(&[R, R, R, R, R, R], ALL_ACTIVE), 6 + 6);
    }

    #[test]
    fn a_passive_sender_leaves_a_recessive_bus_behind() {
        let passive_sender = Parties { active_sender: false, ..ALL_ACTIVE };
        assert_eq!(flags_end(&[D, R, R], passive_sender), 3 + 6 - 2 + 6);
        let alone = Parties { active_sender: true, receiver: false, active_receiver: false };
        assert_eq!(flags_end(&[D, R, R], alone), 3 + 6);
    }
}
