//! The logger that defmt's macros call.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use cortex_m::register::{basepri, basepri_max};

use crate::control::{CONTROL, LOG};
use crate::line::Lines;

/// Starts the log. Tasks of RTIC up to the priority `ceiling` may log, and no line holds up a task above it.
/// A second call does nothing.
pub fn start(log: &'static mut [u8], ceiling: u8) {
    let Some(channel) = CONTROL.channel(LOG, c"defmt", log) else { return };
    // RTIC's highest priority is NVIC's lowest number, in the upper bits. 0 would mask nothing.
    let levels = 1_u8 << PRIORITY_BITS;
    let ceiling = (levels - ceiling.clamp(1, levels - 1)) << (8 - PRIORITY_BITS);
    CEILING.store(ceiling, Ordering::Relaxed);
    let masked = mask();
    // SAFETY: all others who may log are masked, and this one has no other reference.
    unsafe { &mut *LINES.0.get() }.set_channel(channel);
    unmask(masked);
    CONTROL.publish();
}

/// How many lines were not written: there was no room, or somebody logged who may not.
pub fn lost() -> u32 {
    let masked = mask();
    // SAFETY: as in `start`.
    let lost = unsafe { &*LINES.0.get() }.lost();
    unmask(masked);
    lost.wrapping_add(NOT_ALLOWED.load(Ordering::Relaxed))
}

#[defmt::global_logger]
struct Logger;

// SAFETY: between `acquire` and `release` all others who may log are masked; who may not touches nothing.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        if !may_log() {
            NOT_ALLOWED.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let masked = mask();
        with_lines(|lines| {
            lines.begin();
            if !ACQUIRED.load(Ordering::Relaxed) {
                ACQUIRED.store(true, Ordering::Relaxed);
                BEFORE.store(masked, Ordering::Relaxed);
            }
        });
    }

    unsafe fn flush() {
        // Nobody waits for a probe.
    }

    unsafe fn release() {
        if may_log() && with_lines(Lines::end) {
            ACQUIRED.store(false, Ordering::Relaxed);
            unmask(BEFORE.load(Ordering::Relaxed));
        }
    }

    unsafe fn write(bytes: &[u8]) {
        if may_log() {
            with_lines(|lines| lines.write(bytes));
        }
    }
}

/// For a panic, after which nobody else runs: whatever was being logged, this one gets a line.
#[cfg(feature = "panic-handler")]
pub(crate) fn take_over() {
    cortex_m::interrupt::disable();
    IS_LAST.store(true, Ordering::Relaxed);
    ACQUIRED.store(false, Ordering::Relaxed);
    with_lines(Lines::give_up);
}

/// Between `acquire` and `release` of a line only, or with everybody masked.
fn with_lines<R>(access: impl FnOnce(&mut Lines) -> R) -> R {
    // SAFETY: whoever may log has masked all others who may, so no other context is in here. Nothing that `access`
    // calls comes back to the logger: it copies bytes.
    access(unsafe { &mut *LINES.0.get() })
}

/// Masks all who may log. Returns what was masked before.
fn mask() -> u8 {
    let before = basepri::read();
    basepri_max::write(CEILING.load(Ordering::Relaxed));
    before
}

fn unmask(before: u8) {
    // SAFETY: no critical section is ended by it: the value is that of before `mask`, to which calls are paired.
    unsafe { basepri::write(before) };
}

/// Returns whether the running task or handler may log.
fn may_log() -> bool {
    if IS_LAST.load(Ordering::Relaxed) {
        return true;
    }
    // SAFETY: ICSR; reading it has no effect.
    let exception = unsafe { ICSR.read_volatile() } & VECTACTIVE;
    match exception {
        // `init` and `idle`.
        0 => true,
        // Above all that can be masked.
        1..=3 => false,
        // SAFETY: SHPR has a byte for each of them (ARMv7-M ARM, B3.2.10); reading it has no effect.
        4..=15 => unsafe { SHPR.add(exception as usize - 4).read_volatile() >= ceiling() },
        // SAFETY: NVIC_IPR has a byte for each interrupt (B3.4.9); reading it has no effect.
        _ => unsafe { IPR.add(exception as usize - 16).read_volatile() >= ceiling() },
    }
}

fn ceiling() -> u8 {
    CEILING.load(Ordering::Relaxed)
}

/// Touched only by those who may log, with all others masked.
struct Shared(UnsafeCell<Lines>);

// SAFETY: see the type.
unsafe impl Sync for Shared {}

static LINES: Shared = Shared(UnsafeCell::new(Lines::new()));
/// BASEPRI while a line is written; 0 before the log is started.
static CEILING: AtomicU8 = AtomicU8::new(0);
/// BASEPRI before it.
static BEFORE: AtomicU8 = AtomicU8::new(0);
/// `BEFORE` holds a value.
static ACQUIRED: AtomicBool = AtomicBool::new(false);
/// Nobody runs after this one.
static IS_LAST: AtomicBool = AtomicBool::new(false);
/// Lines of those who may not log.
static NOT_ALLOWED: AtomicU32 = AtomicU32::new(0);

/// Of the STM32F4.
const PRIORITY_BITS: u32 = 4;
const ICSR: *const u32 = 0xE000_ED04 as *const u32;
const VECTACTIVE: u32 = 0x1FF;
const SHPR: *const u8 = 0xE000_ED18 as *const u8;
const IPR: *const u8 = 0xE000_E400 as *const u8;
