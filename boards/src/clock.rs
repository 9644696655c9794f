//! The monotonic timer: TIM2, 32 bits, extended to 64 by software.
//!
//! It counts at 4 MHz, which divides the timer's clock of 84 MHz, and is a whole number of nanoseconds, so
//! that conversion to the middleware's local time is one multiplication and loses nothing.
//!
//! The upper bits are counted twice in a turn of the counter, in the middle and at the end, so that a reader sees from
//! the two together which half it is in, also when the interrupt that counts has not run yet. So reading needs no
//! lock, and may be done at any priority. (The idea is that of `rtic_time::half_period_counter`, which masks
//! interrupts between the two reads: with a turn of 18 minutes a reader may be interrupted there.)
//!
//! Waiting is done by the timer queue of `rtic-time`, and for the calendar by an alarm of its own. The driver of
//! `rtic-monotonics` is not used: its upper bits are of 64 bits, behind a lock that spins and takes 2 KB of RAM, and its
//! interrupt can panic.

use core::future::pending;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use crate::alarm::{Alarm, Compare};
use cortex_m::peripheral::NVIC;
use cosmic_core::time::{Duration, Instant};
use rtic_time::timer_queue::{TimerQueue, TimerQueueBackend};
use stm32f4xx_hal::pac::{Interrupt, TIM2, tim2::RegisterBlock};

const TICKS_PER_SECOND: u32 = 4_000_000;
const NANOSECONDS_PER_TICK: u32 = 1_000_000_000 / TICKS_PER_SECOND;

/// The resolution of local time.
pub const RESOLUTION: Duration = Duration::from_ticks(NANOSECONDS_PER_TICK as u64);

/// Local time, now.
#[inline]
pub fn now() -> Instant {
    Instant::from_epoch(Duration::from_ticks(ticks().wrapping_mul(NANOSECONDS_PER_TICK as u64)))
}

/// Waits until local time has reached `instant`; returns at once if it has.
#[inline]
pub fn delay_until(instant: Instant) -> impl Future<Output = ()> {
    until(instant, pending())
}

/// Waits until local time has reached `instant` or `other` has ended.
#[inline]
pub async fn until(instant: Instant, other: impl Future<Output = ()>) {
    // Either will do.
    let _ = QUEUE.timeout_at(timer(instant), other).await;
}

/// As [`until`], for the calendar task, which alone may call it: by a compare channel of its own.
#[inline]
pub async fn calendar_until(instant: Instant, other: impl Future<Output = ()>) {
    CALENDAR.until::<Channel3>(timer(instant), other).await;
}

/// Starts the timer, behind a clock of this frequency, with its interrupt at a priority of RTIC's. Once.
pub(crate) fn start(timer: TIM2, clock: u32, priority: u8) {
    timer.psc().write(|w| w.psc().set((clock / TICKS_PER_SECOND).saturating_sub(1) as u16));
    timer.ccr1().write(|w| w.ccr().set(HALF));
    // Takes the prescaler over, and clears the counter; that is no end of a turn.
    timer.cr1().write(|w| w.urs().set_bit());
    timer.egr().write(|w| w.ug().set_bit());
    timer.sr().write(|w| w);
    timer.dier().write(|w| w.uie().set_bit().cc1ie().set_bit().cc3ie().set_bit());
    timer.cr1().modify(|_, w| w.cen().set_bit());
    let levels = 1 << PRIORITY_BITS;
    let priority = (levels - priority.clamp(1, levels)) << (8 - PRIORITY_BITS);
    // SAFETY: nothing relies on this interrupt being masked or at another priority.
    unsafe {
        cortex_m::Peripherals::steal().NVIC.set_priority(Interrupt::TIM2, priority);
        NVIC::unmask(Interrupt::TIM2);
    }
}

/// The first tick that is not before `instant`.
#[inline]
fn timer(instant: Instant) -> u64 {
    let ticks = ticks();
    let now = ticks.wrapping_mul(NANOSECONDS_PER_TICK.into());
    let ahead = instant.since_epoch().as_ticks().saturating_sub(now);
    // Hardly ever is it further than four seconds, and 32 bits are divided in a tenth of the time.
    let ahead = match u32::try_from(ahead) {
        Ok(ahead) => ahead.div_ceil(NANOSECONDS_PER_TICK).into(),
        Err(_) => ahead.div_ceil(NANOSECONDS_PER_TICK.into()),
    };
    ticks.wrapping_add(ahead)
}

#[inline]
fn ticks() -> u64 {
    // In this order: see the module.
    let halves = HALVES.load(Ordering::Acquire);
    let count = registers().cnt().read().cnt().bits();
    // The half that the counter is in has the parity of its highest bit. If it differs, the counter is one ahead.
    (u64::from(halves) << 31) + u64::from(count ^ (halves & 1) << 31)
}

/// The timer, to the queue of those who wait for it.
struct Timer;

impl TimerQueueBackend for Timer {
    type Ticks = u64;

    #[inline]
    fn now() -> u64 {
        ticks()
    }

    #[inline]
    fn set_compare(instant: u64) {
        // What is more than a turn away comes by too early, and is set again then.
        registers().ccr2().write(|w| w.ccr().set(instant as u32));
    }

    #[inline]
    fn clear_compare_flag() {
        clear(CC2IF);
    }

    #[inline]
    fn pend_interrupt() {
        PENDED.store(true, Ordering::Release);
        NVIC::pend(Interrupt::TIM2);
    }

    #[inline]
    fn enable_timer() {
        registers().dier().modify(|_, w| w.cc2ie().set_bit());
    }

    #[inline]
    fn disable_timer() {
        registers().dier().modify(|_, w| w.cc2ie().clear_bit());
    }

    #[inline]
    fn on_interrupt() {
        let flags = registers().sr().read().bits();
        for flag in [UIF, CC1IF] {
            if flags & flag != 0 {
                clear(flag);
                // Nobody else writes it.
                HALVES.store(HALVES.load(Ordering::Relaxed).wrapping_add(1), Ordering::Release);
            }
        }
    }

    #[inline]
    fn timer_queue() -> &'static TimerQueue<Self> {
        &QUEUE
    }
}

#[allow(non_snake_case, reason = "the name of the vector")]
#[unsafe(no_mangle)]
extern "C" fn TIM2() {
    let flags = registers().sr().read().bits();
    let is_pended = PENDED.swap(false, Ordering::Acquire);
    if flags & CC3IF != 0 {
        clear(CC3IF);
        CALENDAR.ring();
        if !is_of_queue(flags) && !is_pended {
            return;
        }
    }
    // SAFETY: this is the interrupt of the timer.
    unsafe { QUEUE.on_monotonic_interrupt() };
}

/// Returns whether any of these flags is one that the timer's queue clears. Channels that nobody uses match, too, for the
/// first time when the counter begins anew, and nobody clears their flags.
const fn is_of_queue(flags: u32) -> bool {
    flags & (UIF | CC1IF | CC2IF) != 0
}

const _: () = assert!(!is_of_queue(CC3IF | CC4IF) && is_of_queue(CC2IF | CC3IF) && is_of_queue(UIF));

/// The compare channel of the calendar.
struct Channel3;

impl Compare for Channel3 {
    #[inline]
    fn ticks() -> u64 {
        ticks()
    }

    #[inline]
    fn set(low: u32) {
        registers().ccr3().write(|w| w.ccr().set(low));
    }
}

/// Clears a flag, and leaves the others as they are.
#[inline]
fn clear(flag: u32) {
    // SAFETY: a 1 has no effect (RM0090, TIMx_SR).
    registers().sr().write(|w| unsafe { w.bits(!flag) });
}

#[inline]
fn registers() -> &'static RegisterBlock {
    // SAFETY: the timer was given up for this module, and each access here is one read or one write that acts on
    // no other context's bits, but for DIER, which only the interrupt changes.
    unsafe { &*TIM2::ptr() }
}

static QUEUE: TimerQueue<Timer> = TimerQueue::new();
static CALENDAR: Alarm = Alarm::new();
/// The queue wants to be looked through.
static PENDED: AtomicBool = AtomicBool::new(false);
/// Halves of turns that the counter has gone through.
static HALVES: AtomicU32 = AtomicU32::new(0);

const HALF: u32 = 1 << 31;
const PRIORITY_BITS: u32 = 4;
const UIF: u32 = 1 << 0;
const CC1IF: u32 = 1 << 1;
const CC2IF: u32 = 1 << 2;
const CC3IF: u32 = 1 << 3;
const CC4IF: u32 = 1 << 4;
