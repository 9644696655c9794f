//! The monotonic timer of the tests, on the two CMSDK timers of the board.
//!
//! Timer 0 runs freely over its 32 bits, and its interrupt counts the periods: 64-bit instants that do
//! not wrap in 23,000 years. Timer 1 runs once, from now to the instant at which the timer queue wants
//! to wake up; a longer way is walked in several steps.
//!
//! # The race at the end of a period
//!
//! The count and the number of periods cannot be read together. With interrupts off, the interrupt flag
//! of timer 0 tells whether a period has ended that is not counted yet, and a count read *after* the
//! flag belongs to the new period. The timer counts down and sets the flag as it reaches 0, so a period
//! begins with the count 0: the ticks in it are the negated count. In the tick of the 0 itself it
//! depends on the emulator whether the flag can be seen already; that one tick is waited out.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use rtic_time::monotonic::TimerQueueBasedMonotonic;
use rtic_time::timer_queue::{TimerQueue, TimerQueueBackend};

use crate::device::{Interrupt, NVIC_PRIO_BITS, SYSTEM_CLOCK_HZ, Timer};

pub use rtic_time::{Monotonic, Timebase};

/// The monotonic timer. One tick is 40 ns.
pub struct Mono;

/// An instant of [`Mono`].
pub type Instant = fugit::MonotonicTimerInstantU64<{ SYSTEM_CLOCK_HZ as u64 }>;
/// A span of [`Mono`].
pub type Duration = fugit::TimerDurationU64<{ SYSTEM_CLOCK_HZ as u64 }>;

impl Mono {
    /// Starts the timer, once. Its interrupts get the highest priority of the machine, as nothing may
    /// keep an instant from being noticed.
    pub fn start() {
        let [counter, alarm] = [Timer::timer0(), Timer::timer1()];
        Timer::write(&counter.control, Timer::STOP);
        Timer::write(&alarm.control, Timer::STOP);
        Timer::write(&alarm.reload, 0);
        Timer::write(&counter.reload, u32::MAX);
        Timer::write(&counter.control, Timer::RUN_WITH_INTERRUPT);
        QUEUE.initialize(Backend);
        for interrupt in [Interrupt::TIMER0, Interrupt::TIMER1] {
            // SAFETY: the interrupts are masked until the next line, and no critical section by
            // priority relies on them: handlers of the timer share nothing but atomics.
            unsafe {
                let mut core = cortex_m::Peripherals::steal();
                core.NVIC.set_priority(interrupt, rtic::export::cortex_logical2hw(HIGHEST, NVIC_PRIO_BITS));
                NVIC::unmask(interrupt);
            }
        }
    }
}

/// The time, as the core wants it.
pub fn now() -> cosmic_core::time::Instant {
    let nanoseconds = Mono::now().as_ticks() * NANOSECONDS_PER_TICK;
    cosmic_core::time::Instant::from_epoch(cosmic_core::time::Duration::from_ticks(nanoseconds))
}

/// The first instant of the timer that is not before one of the core's.
pub fn instant(of_core: cosmic_core::time::Instant) -> Instant {
    Instant::from_ticks(of_core.since_epoch().as_ticks().div_ceil(NANOSECONDS_PER_TICK))
}

impl TimerQueueBasedMonotonic for Mono {
    type Backend = Backend;
    type Instant = Instant;
    type Duration = Duration;
}

/// What the timer queue of RTIC asks of the two timers.
pub struct Backend;

impl TimerQueueBackend for Backend {
    type Ticks = u64;

    fn now() -> u64 {
        let counter = Timer::timer0();
        critical_section::with(|_| {
            let (ended, count) = loop {
                let ended = counter.interrupt.read() & Timer::INTERRUPT_SET;
                let count = counter.value.read();
                // If the period ended between the two reads, the flag is stale: read again.
                if count != 0 && ended == counter.interrupt.read() & Timer::INTERRUPT_SET {
                    break (ended, count);
                }
            };
            let periods = u64::from(PERIODS.load(Ordering::Relaxed)) + u64::from(ended);
            periods << u32::BITS | u64::from(count.wrapping_neg())
        })
    }

    fn set_compare(instant: u64) {
        let alarm = Timer::timer1();
        let ticks = instant.saturating_sub(Self::now());
        // At least 1, for 0 would never ring; at most the whole width, and then on from there.
        let ticks = u32::try_from(ticks).unwrap_or(u32::MAX).max(1);
        Timer::write(&alarm.control, Timer::STOP);
        Timer::write(&alarm.value, ticks);
        Timer::write(&alarm.control, Timer::RUN_WITH_INTERRUPT);
    }

    fn clear_compare_flag() {
        Timer::write(&Timer::timer1().interrupt, Timer::INTERRUPT_SET);
    }

    fn pend_interrupt() {
        NVIC::pend(Interrupt::TIMER1);
    }

    fn disable_timer() {
        Timer::write(&Timer::timer1().control, Timer::STOP);
    }

    fn timer_queue() -> &'static TimerQueue<Self> {
        &QUEUE
    }
}

/// Ends a test that has lost its way: a program that sleeps for ever would otherwise run for ever. In
/// an idle machine virtual time leaps, so the host does not wait for it.
const LONGEST_TEST_PERIODS: u32 = 100;

const NANOSECONDS_PER_TICK: u64 = 1_000_000_000 / SYSTEM_CLOCK_HZ as u64;

const HIGHEST: u8 = 1 << NVIC_PRIO_BITS;

static QUEUE: TimerQueue<Backend> = TimerQueue::new();
static PERIODS: AtomicU32 = AtomicU32::new(0);

// The end of a period.
#[unsafe(no_mangle)]
extern "C" fn TIMER0() {
    Timer::write(&Timer::timer0().interrupt, Timer::INTERRUPT_SET);
    let periods = PERIODS.load(Ordering::Relaxed) + 1;
    PERIODS.store(periods, Ordering::Relaxed);
    assert!(periods < LONGEST_TEST_PERIODS, "the test does not end");
}

// The alarm, or a new head of the timer queue.
#[unsafe(no_mangle)]
extern "C" fn TIMER1() {
    // SAFETY: this is the interrupt of the monotonic.
    unsafe { Backend::timer_queue().on_monotonic_interrupt() }
}
