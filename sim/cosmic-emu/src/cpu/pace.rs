//! The common clock of a node: HCLK cycles and executed instructions.
//!
//! The core calls it before each instruction, so the time of a peripheral access is exact to the
//! instruction. Interior mutability is what lets the core's hook, the peripherals and the run loop share
//! it; all of one node runs on one thread.

use core::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};

use super::masking::{MaskedAt, Masking};

/// Cycles that a taken branch costs on top: the pipeline is refilled (Cortex-M4 TRM, table 3-1: P = 1..=3).
const REFILL: u64 = 2;

/// An instruction that was watched for was reached.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct ProbeHit {
    /// Where.
    pub(crate) pc: u32,
    /// When.
    pub(crate) cycle: u64,
    /// Instructions executed before it.
    pub(crate) instructions: u64,
}

/// The clock of one node.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    cycle: Cell<u64>,
    limit: Cell<u64>,
    /// Cycles that passed in sleep.
    slept: Cell<u64>,
    instructions: Cell<u64>,
    pc: Cell<u32>,
    /// An interrupt is pending, so a change of the masks matters.
    pending: Cell<bool>,
    probes: RefCell<BTreeSet<u32>>,
    watching: Cell<bool>,
    hits: RefCell<Vec<ProbeHit>>,
    masking: Masking,
}

impl Pace {
    /// HCLK cycles since power-on; sleep included.
    #[inline]
    pub(crate) fn cycle(&self) -> u64 {
        self.cycle.get()
    }

    /// HCLK cycles since power-on in which the core did not sleep.
    pub(crate) fn awake(&self) -> u64 {
        self.cycle.get() - self.slept.get()
    }

    /// Instructions executed since power-on. Those that an IT block skips count, as they take a cycle.
    pub(crate) fn instructions(&self) -> u64 {
        self.instructions.get()
    }

    /// The instruction being executed.
    pub(crate) fn pc(&self) -> u32 {
        self.pc.get()
    }

    /// The core stops before an instruction that would begin at this cycle or later.
    pub(crate) fn set_limit(&self, cycle: u64) {
        self.limit.set(cycle);
    }

    /// The core stops before the next instruction.
    pub(crate) fn stop_soon(&self) {
        self.limit.set(0);
    }

    /// Says whether a change of PRIMASK, BASEPRI or FAULTMASK could let an interrupt in.
    pub(crate) fn set_pending(&self, pending: bool) {
        self.pending.set(pending);
    }

    /// Time passes without instructions: sleep, exception entry.
    pub(crate) fn skip_to(&self, cycle: u64) {
        self.cycle.set(self.cycle.get().max(cycle));
    }

    /// Watch for an instruction.
    pub(crate) fn add_probe(&self, pc: u32) {
        self.probes.borrow_mut().insert(pc);
        self.watching.set(true);
    }

    /// What is watched for.
    pub(crate) fn probes(&self) -> BTreeSet<u32> {
        self.probes.borrow().clone()
    }

    pub(crate) fn take_hits(&self) -> Vec<ProbeHit> {
        self.hits.take()
    }

    /// The core reached an instruction. Returns whether it may be executed.
    #[inline]
    pub(crate) fn reach(&self, pc: u32) -> bool {
        self.pc.set(pc);
        let runs = self.cycle.get() < self.limit.get();
        if runs && self.watching.get() {
            self.watch(pc);
        }
        runs
    }

    /// The core executes an instruction that takes `cycles`.
    #[inline]
    pub(crate) fn execute(&self, cycles: u64) {
        self.instructions.set(self.instructions.get() + 1);
        self.cycle.set(self.cycle.get() + cycles);
    }

    /// Returns whether the instruction that was executed last was a taken branch.
    #[inline]
    pub(crate) fn branch(&self, is_taken: bool) {
        self.cycle.set(self.cycle.get() + u64::from(is_taken) * REFILL);
    }

    /// The instruction that was begun last is not executed after all. Its cycles have passed.
    pub(crate) fn take_back(&self) {
        self.instructions.set(self.instructions.get() - 1);
    }

    /// The instruction that was begun last is the first of an endless loop that does nothing, with so many
    /// instructions and cycles a turn: as many turns as would begin before the limit pass at once.
    pub(crate) fn spin(&self, instructions: u64, cycles: u64) {
        let turns = self.limit.get().saturating_sub(self.cycle.get()) / cycles;
        self.cycle.set(self.cycle.get() + turns * cycles);
        self.instructions.set(self.instructions.get() + turns * instructions);
    }

    /// The core executes an instruction that changes interrupt masks, in this exception. `ceiling` is the
    /// smallest priority that they hold back from then on, above 255 for none.
    pub(crate) fn masks_change(&self, ceiling: u16, exception: u16) {
        self.masking.change(ceiling, self.cycle.get(), MaskedAt { pc: self.pc.get(), exception });
        if self.pending.get() {
            self.stop_soon();
        }
    }

    /// Nothing happens until this cycle: the core sleeps.
    pub(crate) fn sleep_until(&self, cycle: u64) {
        self.slept.set(self.slept.get() + cycle.saturating_sub(self.cycle.get()));
        self.skip_to(cycle);
        self.masking.sleep_until(self.cycle.get());
    }

    /// Measure for how long interrupts of this priority are masked.
    pub(crate) fn watch_masks(&self, priority: u8) {
        self.masking.watch(priority);
    }

    /// The priority that [`watch_masks`](Self::watch_masks) named.
    pub(crate) fn watched_priority(&self) -> Option<u8> {
        self.masking.watched()
    }

    /// For how long they were masked at most, by the place that masked them.
    pub(crate) fn longest_masked(&self) -> BTreeMap<MaskedAt, u64> {
        self.masking.longest()
    }

    fn watch(&self, pc: u32) {
        if self.probes.borrow().contains(&pc) {
            let (cycle, instructions) = (self.cycle.get(), self.instructions.get());
            self.hits.borrow_mut().push(ProbeHit { pc, cycle, instructions });
        }
    }
}
