//! The calendar: when which hard real-time frame may be on the bus.
//!
//! A calendar is a constant in the image of every node, the same in all of them. It lists slots; a slot
//! recurs with its period, and within the cycle no windows of different occurrences overlap:
//!
//! ```text
//!  ready            LST                                   deadline      delivery
//!   |--- ΔT_wait ----|-- C(s) --|- k · (C(s) + E) ---------|-- gap -------|
//!   load mailbox     surely on the bus by now              last retry     notify subscribers
//! ```
//!
//! `C(s)` is the longest frame of `s` bytes, `E` the error recovery time, `k` the omission degree.
//! ΔT_wait covers the longest lower-priority frame, which cannot be pre-empted, and a fault on it. The
//! gap of at least 2ε + release jitter keeps windows apart when clocks differ by up to ε from global
//! time.
//!
//! Slots of different nodes with the same period, phase and omission degree form a *pool*: their frames
//! are loaded together, so that only one lower-priority frame can hold them up, follow each other, and share
//! one budget of `k` faults. Their window is `ΔT_wait + Σ C(s) + k · (max C(s) + E) + gap`, for all of them.

use crate::can::{BitRate, ERROR_RECOVERY_BITS, Etag, LONGEST_FRAME_BITS, Payload, TxNode};
use crate::time::Duration;

/// One hard real-time transmission, recurring with its period.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Slot {
    /// The channel that is sent here.
    pub etag: Etag,
    /// The node that sends it.
    pub publisher: TxNode,
    /// How many bytes the frame carries at most, 0..=8.
    pub len: u8,
    /// How many omissions the window tolerates (k).
    pub omission_degree: u8,
    /// Whether every period carries an event. Then a period without one is an error.
    pub periodic: bool,
    /// The span between two occurrences; divides the cycle.
    pub period: Duration,
    /// The ready instant of the first occurrence, from the start of the cycle; less than the period.
    pub phase: Duration,
}

impl Slot {
    /// Returns whether each occurrence of one begins with one of the other.
    const fn is_ready_with(&self, other: &Self) -> bool {
        self.period.as_ticks() == other.period.as_ticks() && self.phase.as_ticks() == other.phase.as_ticks()
    }
}

/// Instants of a slot relative to its ready instant, each not before the one above it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SlotTimes {
    /// Latest start time: surely on the bus by now, if there was no fault. Of a pool: one of its frames.
    pub latest_start: Duration,
    /// The last retransmission has ended.
    pub deadline: Duration,
    /// Subscribers are notified; the window ends.
    pub delivery: Duration,
}

/// What holds for all slots of a calendar.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Segment {
    /// The bit rate of the bus.
    pub bit_rate: BitRate,
    /// ε: how far any node's clock may be from global time. Beyond it a node keeps silent.
    pub accuracy: Duration,
    /// How late the dispatcher may act on an instant that has come.
    pub release_jitter: Duration,
}

impl Segment {
    /// ΔT_wait: the longest frame of any class, which may just have started, and recovery from a fault
    /// on it.
    pub const fn wait(&self) -> Duration {
        self.bit_rate.bits(LONGEST_FRAME_BITS + ERROR_RECOVERY_BITS)
    }

    /// The span between a deadline and the earliest ready instant of the next slot: 2ε + release jitter.
    pub const fn gap(&self) -> Duration {
        Duration::from_ticks(
            self.accuracy.as_ticks().saturating_mul(2).saturating_add(self.release_jitter.as_ticks()),
        )
    }

    /// The instants of a slot with a frame of `len` bytes and omission degree `k`.
    #[expect(clippy::arithmetic_side_effects, reason = "256 frames of the slowest rate are a few seconds")]
    pub const fn slot_times(&self, len: u8, omission_degree: u8) -> SlotTimes {
        let frame = self.bit_rate.longest_frame(len as usize).as_ticks();
        let recovery = self.bit_rate.bits(ERROR_RECOVERY_BITS).as_ticks();
        let latest_start = self.wait().as_ticks();
        let deadline = latest_start + frame + omission_degree as u64 * (frame + recovery);
        SlotTimes {
            latest_start: Duration::from_ticks(latest_start),
            deadline: Duration::from_ticks(deadline),
            delivery: Duration::from_ticks(deadline.saturating_add(self.gap().as_ticks())),
        }
    }
}

/// What is wrong with a calendar. The numbers are positions in the list of slots.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum CalendarError {
    /// The cycle is zero, or longer than [`Calendar::LONGEST_CYCLE`].
    Cycle,
    /// The etag of the slot is not one of the hard real-time etags (100..=1023).
    Etag(usize),
    /// The slot belongs to the broker's TxNode, which sends no hard real-time events.
    Publisher(usize),
    /// The slot's frame is longer than eight bytes.
    Length(usize),
    /// The slot's period is zero or does not divide the cycle.
    Period(usize),
    /// The slot's phase is not less than its period.
    Phase(usize),
    /// The slot's window is longer than its period.
    Window(usize),
    /// Some occurrences of the two slots overlap. (Or they are ready together, but are of one node or have
    /// different omission degrees, and so form no pool.)
    Overlap(usize, usize),
}

/// A list of slots whose windows never overlap. See the [module](self) for the instants of a slot.
///
/// ```
/// use cosmic_core::calendar::{Calendar, Segment, Slot};
/// use cosmic_core::can::{BitRate, Etag, TxNode};
/// use cosmic_core::time::Duration;
///
/// const SLOTS: [Slot; 1] = [Slot {
///     etag: Etag::HARD_FIRST,
///     publisher: TxNode::MIN,
///     len: 8,
///     omission_degree: 1,
///     periodic: true,
///     period: Duration::from_millis(10),
///     phase: Duration::from_micros(0),
/// }];
/// // A calendar that is none does not compile.
/// const CALENDAR: Calendar = Calendar::checked(
///     Segment {
///         bit_rate: BitRate::MAX,
///         accuracy: Duration::from_micros(5),
///         release_jitter: Duration::from_micros(10),
///     },
///     Duration::from_millis(10),
///     &SLOTS,
/// );
/// assert_eq!(CALENDAR.slot_times(&SLOTS[0]).deadline, Duration::from_micros(191 + 160 + 191));
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Calendar {
    segment: Segment,
    cycle: Duration,
    slots: &'static [Slot],
    digest: u32,
    priority_step: Duration,
}

impl Calendar {
    /// The longest cycle.
    pub const LONGEST_CYCLE: Duration = Duration::from_secs(3600);
    /// The longest Δt_p, so that the 249 priorities of soft real-time fit in 32 bits of nanoseconds.
    pub const LONGEST_PRIORITY_STEP: Duration = Duration::from_millis(17);

    /// Checks the slots, at compile time where it is called in a constant. O(n²) in the number of slots.
    ///
    /// # Errors
    /// The first thing that is wrong with the calendar.
    #[expect(clippy::arithmetic_side_effects, reason = "within the length, by the loop")]
    pub const fn new(
        segment: Segment,
        cycle: Duration,
        slots: &'static [Slot],
    ) -> Result<Self, CalendarError> {
        if cycle.is_zero() || cycle.as_ticks() > Self::LONGEST_CYCLE.as_ticks() {
            return Err(CalendarError::Cycle);
        }
        let mut at = 0;
        while at < slots.len() {
            if let Err(error) = check_slot(&segment, cycle, slots, at) {
                return Err(error);
            }
            at += 1;
        }
        let digest = digest(&segment, cycle, slots);
        let priority_step = segment.bit_rate.longest_frame(Payload::MAX_LEN);
        Ok(Self { segment, cycle, slots, digest, priority_step })
    }

    /// As [`Calendar::new`], for a constant: a calendar with an error does not compile.
    ///
    /// # Panics
    /// With the name of the error, if there is one.
    #[allow(clippy::panic, reason = "in a constant, where it stops the compiler")]
    pub const fn checked(segment: Segment, cycle: Duration, slots: &'static [Slot]) -> Self {
        match Self::new(segment, cycle, slots) {
            Ok(calendar) => calendar,
            Err(CalendarError::Cycle) => panic!("calendar: the cycle is zero or over an hour"),
            Err(CalendarError::Etag(_)) => panic!("calendar: a slot's etag is not in 100..=1023"),
            Err(CalendarError::Publisher(_)) => panic!("calendar: a slot belongs to the broker"),
            Err(CalendarError::Length(_)) => panic!("calendar: a slot's frame is over 8 bytes"),
            Err(CalendarError::Period(_)) => panic!("calendar: a period does not divide the cycle"),
            Err(CalendarError::Phase(_)) => panic!("calendar: a phase is not less than its period"),
            Err(CalendarError::Window(_)) => panic!("calendar: a window is longer than its period"),
            Err(CalendarError::Overlap(..)) => panic!("calendar: the windows of two slots overlap"),
        }
    }

    /// The calendar of a segment with another Δt_p than one longest frame, for a constant: a step out of
    /// range does not compile.
    ///
    /// The step does not count in the digest: it changes the order of soft real-time frames, and a node that
    /// has another one is no danger to anybody's slot.
    ///
    /// # Panics
    /// If the step is zero or longer than [`Calendar::LONGEST_PRIORITY_STEP`].
    #[must_use]
    pub const fn with_priority_step(self, step: Duration) -> Self {
        assert!(
            !step.is_zero() && step.as_ticks() <= Self::LONGEST_PRIORITY_STEP.as_ticks(),
            "calendar: the priority step is zero or over 17 ms"
        );
        Self { priority_step: step, ..self }
    }

    /// What holds for all slots.
    pub const fn segment(&self) -> &Segment {
        &self.segment
    }

    /// Δt_p: the span of deadlines that one priority of soft real-time stands for.
    pub const fn priority_step(&self) -> Duration {
        self.priority_step
    }

    /// After this span everything repeats.
    pub const fn cycle(&self) -> Duration {
        self.cycle
    }

    /// The slots, in the order in which they were given.
    pub const fn slots(&self) -> &'static [Slot] {
        self.slots
    }

    /// CRC-32 of everything in it that hard real-time depends on. Travels in sync frames.
    pub const fn digest(&self) -> u32 {
        self.digest
    }

    /// The instants of a slot, relative to its ready instant. O(n) in the number of slots.
    pub const fn slot_times(&self, slot: &Slot) -> SlotTimes {
        window(&self.segment, self.slots, slot)
    }
}

/// The instants of a slot, or of the pool that it belongs to.
#[allow(clippy::indexing_slicing, reason = "within the length, by the loop")]
#[expect(clippy::arithmetic_side_effects, reason = "the longest frame of all is at least this one")]
const fn window(segment: &Segment, slots: &[Slot], slot: &Slot) -> SlotTimes {
    let mut longest = slot.len;
    let mut others = 0;
    let mut at = 0;
    while at < slots.len() {
        let other = &slots[at];
        if other.is_ready_with(slot) && other.publisher.get() != slot.publisher.get() {
            others += segment.bit_rate.longest_frame(other.len as usize).as_ticks();
            if other.len > longest {
                longest = other.len;
            }
        }
        at += 1;
    }
    // Each fault costs the longest frame again; the frames themselves are sent once each.
    let alone = segment.slot_times(longest, slot.omission_degree);
    let spared = segment.bit_rate.longest_frame(longest as usize).as_ticks()
        - segment.bit_rate.longest_frame(slot.len as usize).as_ticks();
    SlotTimes {
        latest_start: alone.latest_start,
        deadline: Duration::from_ticks(alone.deadline.as_ticks() + others - spared),
        delivery: Duration::from_ticks((alone.delivery.as_ticks() - spared).saturating_add(others)),
    }
}

#[allow(clippy::indexing_slicing, reason = "the caller and the loop stay within the length")]
#[expect(clippy::arithmetic_side_effects, reason = "no divisor is zero, and `other` stays below the length")]
const fn check_slot(
    segment: &Segment,
    cycle: Duration,
    slots: &[Slot],
    at: usize,
) -> Result<(), CalendarError> {
    let slot = &slots[at];
    if !slot.etag.is_hard() {
        return Err(CalendarError::Etag(at));
    }
    if slot.publisher.get() == TxNode::BROKER.get() {
        return Err(CalendarError::Publisher(at));
    }
    if slot.len as usize > Payload::MAX_LEN {
        return Err(CalendarError::Length(at));
    }
    if slot.period.is_zero() || cycle.as_ticks() % slot.period.as_ticks() != 0 {
        return Err(CalendarError::Period(at));
    }
    if slot.phase.as_ticks() >= slot.period.as_ticks() {
        return Err(CalendarError::Phase(at));
    }
    let own = window(segment, slots, slot).delivery.as_ticks();
    if own > slot.period.as_ticks() {
        return Err(CalendarError::Window(at));
    }
    let mut other = 0;
    while other < slots.len() {
        if other != at && overlaps(slot, own, &slots[other]) {
            let (first, second) = if other < at { (other, at) } else { (at, other) };
            return Err(CalendarError::Overlap(first, second));
        }
        other += 1;
    }
    Ok(())
}

/// Returns whether some occurrence of `other` begins within one of the windows of `slot`, and not as part of
/// its pool.
#[expect(clippy::arithmetic_side_effects, reason = "periods are not zero, and within a cycle")]
const fn overlaps(slot: &Slot, window: u64, other: &Slot) -> bool {
    if slot.is_ready_with(other) {
        return slot.publisher.get() == other.publisher.get()
            || slot.omission_degree != other.omission_degree;
    }
    // Occurrences of two periodic slots come as close as their distance modulo the common divisor.
    let grid = greatest_common_divisor(slot.period.as_ticks(), other.period.as_ticks());
    let behind = (other.phase.as_ticks() % grid + grid - slot.phase.as_ticks() % grid) % grid;
    behind < window
}

#[expect(clippy::arithmetic_side_effects, reason = "`b` is not zero")]
const fn greatest_common_divisor(mut a: u64, mut b: u64) -> u64 {
    if a == b {
        return a;
    }
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[allow(clippy::indexing_slicing, reason = "within the length, by the loop")]
#[expect(clippy::arithmetic_side_effects, reason = "within the length, by the loop")]
const fn digest(segment: &Segment, cycle: Duration, slots: &[Slot]) -> u32 {
    const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = CRC.digest();
    digest.update(&segment.bit_rate.bits_per_second().to_be_bytes());
    digest.update(&segment.accuracy.as_ticks().to_be_bytes());
    digest.update(&segment.release_jitter.as_ticks().to_be_bytes());
    digest.update(&cycle.as_ticks().to_be_bytes());
    let mut at = 0;
    while at < slots.len() {
        let slot = &slots[at];
        digest.update(&slot.etag.get().to_be_bytes());
        digest.update(&[slot.publisher.get(), slot.len, slot.omission_degree, slot.periodic as u8]);
        digest.update(&slot.period.as_ticks().to_be_bytes());
        digest.update(&slot.phase.as_ticks().to_be_bytes());
        at += 1;
    }
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEGMENT: Segment = Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    };

    const fn slot(etag: u16, period_ms: u64, phase_us: u64) -> Slot {
        Slot {
            etag: Etag::new(etag).unwrap(),
            publisher: TxNode::MIN,
            len: 8,
            omission_degree: 1,
            periodic: true,
            period: Duration::from_millis(period_ms),
            phase: Duration::from_micros(phase_us),
        }
    }

    fn calendar(cycle_ms: u64, slots: &[Slot]) -> Result<Calendar, CalendarError> {
        Calendar::new(SEGMENT, Duration::from_millis(cycle_ms), slots.to_vec().leak())
    }

    #[test]
    fn instants_of_a_slot() {
        let times = SEGMENT.slot_times(8, 2);
        assert_eq!(times.latest_start, Duration::from_micros(160 + 31));
        assert_eq!(times.deadline, Duration::from_micros(191 + 160 + 2 * 191));
        assert_eq!(times.delivery, times.deadline + Duration::from_micros(20));
    }

    #[test]
    fn a_gap_that_does_not_fit_does_not_wrap_to_none() {
        const SLOTS: &[Slot] = &[slot(100, 10, 0)];
        for accuracy in [u64::MAX, 1 << 63, (1 << 63) + 1] {
            let segment = Segment { accuracy: Duration::from_ticks(accuracy), ..SEGMENT };
            let calendar = Calendar::new(segment, Duration::from_millis(10), SLOTS);
            assert_eq!(calendar, Err(CalendarError::Window(0)));
        }
    }

    #[test]
    fn touching_windows_are_accepted_and_overlapping_ones_are_not() {
        let window = 191 + 160 + 191 + 20;
        assert!(calendar(10, &[slot(100, 10, 0), slot(101, 10, window)]).is_ok());
        assert_eq!(
            calendar(10, &[slot(100, 10, 0), slot(101, 10, window - 1)]),
            Err(CalendarError::Overlap(0, 1))
        );
        // The window at the end of the cycle meets the one at the start of the next.
        assert_eq!(
            calendar(10, &[slot(100, 10, 0), slot(101, 10, 10_000 - window + 1)]),
            Err(CalendarError::Overlap(0, 1))
        );
    }

    #[test]
    fn a_pool_shares_one_window_and_one_budget_of_faults() {
        let other = TxNode::new(1).unwrap();
        let short = Slot { publisher: other, len: 4, ..slot(101, 10, 0) };
        let pooled = calendar(10, &[slot(100, 10, 0), short]).unwrap();
        for member in pooled.slots() {
            let times = pooled.slot_times(member);
            assert_eq!(times.latest_start, Duration::from_micros(191));
            assert_eq!(times.deadline, Duration::from_micros(191 + 160 + 120 + 191));
            assert_eq!(times.delivery, times.deadline + Duration::from_micros(20));
        }
        // What follows must keep clear of the whole window.
        let window = 191 + 160 + 120 + 191 + 20;
        let members = [slot(100, 10, 0), short];
        assert!(calendar(10, &[members[0], members[1], slot(102, 10, window)]).is_ok());
        let close = calendar(10, &[members[0], members[1], slot(102, 10, window - 1)]);
        assert_eq!(close, Err(CalendarError::Overlap(0, 2)));
        // One node has one mailbox for hard real-time frames, and a pool one budget.
        let same_node = calendar(10, &[slot(100, 10, 0), slot(101, 10, 0)]);
        assert_eq!(same_node, Err(CalendarError::Overlap(0, 1)));
        let other_degree = Slot { omission_degree: 2, ..short };
        assert_eq!(calendar(10, &[slot(100, 10, 0), other_degree]), Err(CalendarError::Overlap(0, 1)));
    }

    #[test]
    fn occurrences_in_different_periods_are_compared() {
        // Periods 4 ms and 6 ms meet every 2 ms of phase difference.
        assert_eq!(calendar(12, &[slot(100, 4, 0), slot(101, 6, 2_000)]), Err(CalendarError::Overlap(0, 1)));
        assert!(calendar(12, &[slot(100, 4, 0), slot(101, 6, 1_000)]).is_ok());
    }

    #[test]
    fn each_wrong_field_is_named() {
        let good = slot(100, 10, 0);
        let wrong = [
            (Slot { etag: Etag::BOUND_FIRST, ..good }, CalendarError::Etag(0)),
            (Slot { publisher: TxNode::BROKER, ..good }, CalendarError::Publisher(0)),
            (Slot { len: 9, ..good }, CalendarError::Length(0)),
            (slot(100, 7, 0), CalendarError::Period(0)),
            (slot(100, 10, 10_000), CalendarError::Phase(0)),
            (Slot { omission_degree: 200, ..good }, CalendarError::Window(0)),
        ];
        for (slot, error) in wrong {
            assert_eq!(calendar(10, &[slot]), Err(error));
        }
        assert_eq!(calendar(0, &[]), Err(CalendarError::Cycle));
    }

    #[test]
    fn the_digest_covers_every_field() {
        let good = slot(100, 10, 0);
        let digest = calendar(10, &[good]).unwrap().digest();
        let others = [
            slot(101, 10, 0),
            slot(100, 5, 0),
            slot(100, 10, 1),
            Slot { publisher: TxNode::MAX, ..good },
            Slot { len: 7, ..good },
            Slot { omission_degree: 2, ..good },
            Slot { periodic: false, ..good },
        ];
        for other in others {
            assert_ne!(calendar(10, &[other]).unwrap().digest(), digest);
        }
        assert_ne!(calendar(20, &[good]).unwrap().digest(), digest);
    }
}
