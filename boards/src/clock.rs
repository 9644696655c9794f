//! The monotonic timer: TIM2, 32 bits, extended to 64 by software.
//!
//! It counts at 4 MHz, which divides the timer's clock of 84 MHz, and is a whole number of nanoseconds, so
//! that conversion to the middleware's local time is one multiplication and loses nothing.

use cosmic_core::time::{Duration, Instant};
use rtic_monotonics::Timebase as _;
use rtic_monotonics::stm32::prelude::*;

stm32_tim2_monotonic!(Mono, 4_000_000);

/// An instant of the timer.
pub type MonoInstant = <Mono as Timebase>::Instant;

const TICKS_PER_SECOND: u64 = 4_000_000;
const NANOSECONDS_PER_TICK: u64 = 1_000_000_000 / TICKS_PER_SECOND;

/// The resolution of local time.
pub const RESOLUTION: Duration = Duration::from_ticks(NANOSECONDS_PER_TICK);

/// Local time, now.
#[inline]
pub fn now() -> Instant {
    local(Mono::now())
}

/// Waits until local time has reached `instant`; returns at once if it has.
#[inline]
pub async fn delay_until(instant: Instant) {
    Mono::delay_until(timer(instant)).await;
}

/// The timer's instant in local time.
#[inline]
pub fn local(instant: MonoInstant) -> Instant {
    Instant::from_epoch(Duration::from_ticks(
        instant.duration_since_epoch().as_ticks().wrapping_mul(NANOSECONDS_PER_TICK),
    ))
}

/// The first instant of the timer that is not before `instant`.
#[inline]
pub fn timer(instant: Instant) -> MonoInstant {
    MonoInstant::from_ticks(instant.since_epoch().as_ticks().div_ceil(NANOSECONDS_PER_TICK))
}
