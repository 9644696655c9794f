//! Counts the instructions that a piece of code executes, exactly.
//!
//! Under `-icount shift=3` an instruction takes 8 ns of virtual time and a tick of the timer 40 ns: five
//! instructions. One reading before and one after therefore say how many instructions lay between to
//! within five only. But the readings are taken five times, each time one instruction later in the tick;
//! and for every whole `n`
//!
//! ```text
//! ⌊n/5⌋ + ⌊(n+1)/5⌋ + ⌊(n+2)/5⌋ + ⌊(n+3)/5⌋ + ⌊(n+4)/5⌋ = n        (Hermite's identity)
//! ```
//!
//! so the sum of the five is the count. It holds if the code does the same in each run, and that can be
//! seen: the five then differ by at most one tick, and a second series has the same sum.
//!
//! On hardware an instruction takes more or less than one cycle; these are counts, not times.

use crate::device::Timer;

/// How many instructions a piece of code took.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Count {
    /// Instructions, without those of the call and the return.
    pub instructions: u32,
    /// Whether all runs took the same. If not, `instructions` is their mean.
    pub exact: bool,
}

/// Counts the instructions of `code`, which is called [`RUNS`] times, with interrupts off. The monotonic
/// must have been started.
///
/// What is not used again afterwards, and what is known before, may be optimised away: pass values through
/// [`core::hint::black_box`].
pub fn instructions<F: FnMut()>(mut code: F) -> Count {
    series_of_two(|phase| ticks(&mut code, phase))
}

/// As [`instructions`], for code that changes what it works on: each run has an item of its own. Handing
/// the item over is not counted, but for the two loads with which the code gets at it.
pub fn each<T>(items: &mut [T; RUNS as usize], mut code: impl FnMut(&mut T)) -> Count {
    let mut fresh = items.iter_mut();
    series_of_two(|phase| match fresh.next() {
        Some(item) => ticks(&mut || code(item), phase),
        None => 0,
    })
}

/// How often [`instructions`] runs the code.
pub const RUNS: u32 = 2 * INSTRUCTIONS_PER_TICK;

/// A tick of 25 MHz is five times 8 ns.
const INSTRUCTIONS_PER_TICK: u32 = 5;

/// `run` runs the code once, from the phase that it is given, and says how many ticks that took.
fn series_of_two(run: impl FnMut(u32) -> u32) -> Count {
    let code = series(run);
    let nothing = series(|phase| ticks(&mut || (), phase));
    Count { instructions: code.instructions - nothing.instructions, exact: code.exact && nothing.exact }
}

fn series(mut run: impl FnMut(u32) -> u32) -> Count {
    let runs: [[u32; INSTRUCTIONS_PER_TICK as usize]; 2] = cortex_m::interrupt::free(|_| {
        core::array::from_fn(|_| core::array::from_fn(|phase| run(phase as u32)))
    });
    let [first, second] = runs.map(|ticks| ticks.iter().sum::<u32>());
    let fewest = runs.as_flattened().iter().min().unwrap_or(&0);
    let most = runs.as_flattened().iter().max().unwrap_or(&0);
    Count { instructions: first.midpoint(second), exact: first == second && most - fewest <= 1 }
}

/// The ticks of one run that starts at a place in the tick that only depends on `phase`: another one for
/// each of 0..=4.
fn ticks<F: FnMut()>(code: &mut F, phase: u32) -> u32 {
    unsafe extern "C" fn run<F: FnMut()>(code: *mut F) {
        // SAFETY: `ticks` passes its exclusive reference.
        unsafe { (*code)() }
    }

    let run: unsafe extern "C" fn(*mut F) = run::<F>;
    let (start, end): (u32, u32);
    // SAFETY: reads the count of the timer, which has no effect, and calls `run` with its own argument as
    // the calling convention asks.
    unsafe {
        core::arch::asm!(
            // A round has six instructions, 1.2 ticks: the count goes down by 1, 1, 1, 1 and then, when
            // the reading is the first instruction of a tick, by 2.
            "ldr r3, [r4]",
            "2:",
            "mov r2, r3",
            "ldr r3, [r4]",
            "sub r2, r2, r3",
            "cmp r2, #2",
            "nop",
            "bne 2b",
            // Twice the phase: modulo 5, each of the five is reached once.
            "3:",
            "subs r5, r5, #1",
            "bne 3b",
            "ldr r5, [r4]",
            "blx r1",
            "ldr r4, [r4]",
            inout("r0") code => _,
            inout("r1") run => _,
            out("r2") _,
            out("r3") _,
            inout("r4") &raw const Timer::timer0().value => end,
            inout("r5") phase + 1 => start,
            // What a call may change. (`clobber_abi` would name registers that this FPU has not.)
            out("r12") _, out("lr") _,
            out("d0") _, out("d1") _, out("d2") _, out("d3") _,
            out("d4") _, out("d5") _, out("d6") _, out("d7") _,
        );
    }
    start.wrapping_sub(end)
}
