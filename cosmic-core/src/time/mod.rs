//! Instants and durations.
//!
//! Two time scales exist on a node and must never be mixed:
//!
//! * [`Instant`]: *local* time, a free-running monotonic timer that is never stepped. Deadlines,
//!   time-outs and everything of the event-triggered half live here.
//! * [`GlobalInstant`]: *global* time, agreed on by the cluster. The calendar and the time of
//!   occurrence of an event live here.
//!
//! Both count nanoseconds in 64 bits, which wrap after 584 years, so their arithmetic wraps and has
//! no panic path. [`Duration`] is `fugit`'s, and converts to and from any other unit.

mod clock;
pub(crate) mod rate;

pub use clock::{GlobalClock, Uncertainty};
pub use rate::{Rate, RateChange};

/// A span of time, in nanoseconds.
pub type Duration = fugit::NanosDurationU64;

type Ticks = fugit::MonotonicTimerInstantU64<1_000_000_000>;

macro_rules! instant {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name(Ticks);

        impl $name {
            /// The origin of the time scale.
            pub const EPOCH: Self = Self(Ticks::from_ticks(0));
            /// Later than every instant that will occur.
            pub const FAR_FUTURE: Self = Self(Ticks::from_ticks(u64::MAX));

            /// The instant `since_epoch` after the origin of the time scale.
            #[inline]
            pub const fn from_epoch(since_epoch: Duration) -> Self {
                Self(Ticks::from_ticks(since_epoch.as_ticks()))
            }

            /// The span from the origin of the time scale to this instant.
            #[inline]
            pub const fn since_epoch(self) -> Duration {
                Duration::from_ticks(self.0.as_ticks())
            }

            /// The span since `earlier`, or zero if `earlier` is in fact later.
            #[inline]
            pub const fn saturating_since(self, earlier: Self) -> Duration {
                Duration::from_ticks(self.0.as_ticks().saturating_sub(earlier.0.as_ticks()))
            }

            /// This instant less `span`, or the epoch if that would be before it.
            #[inline]
            pub const fn saturating_sub(self, span: Duration) -> Self {
                Self(Ticks::from_ticks(self.0.as_ticks().saturating_sub(span.as_ticks())))
            }

            /// `self - other` in nanoseconds, with its sign.
            #[inline]
            pub const fn signed_since(self, other: Self) -> i64 {
                self.0.as_ticks().wrapping_sub(other.0.as_ticks()).cast_signed()
            }

            /// This instant moved by a signed number of nanoseconds.
            #[inline]
            pub const fn offset_by(self, nanoseconds: i64) -> Self {
                Self(Ticks::from_ticks(self.0.as_ticks().wrapping_add_signed(nanoseconds)))
            }
        }

        impl core::ops::Add<Duration> for $name {
            type Output = Self;
            #[inline]
            fn add(self, span: Duration) -> Self {
                Self(Ticks::from_ticks(self.0.as_ticks().wrapping_add(span.as_ticks())))
            }
        }
    };
}

instant! {
    /// An instant of the node's local time: monotonic, never stepped, known to this node only.
    Instant
}

instant! {
    /// An instant of the cluster's global time.
    GlobalInstant
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_keep_their_sign() {
        let early = Instant::from_epoch(Duration::from_ticks(100));
        let late = early + Duration::from_ticks(50);
        assert_eq!(late.signed_since(early), 50);
        assert_eq!(early.signed_since(late), -50);
        assert_eq!(early.saturating_since(late), Duration::from_ticks(0));
        assert_eq!(late.offset_by(-50), early);
        assert_eq!(early.saturating_sub(Duration::from_ticks(200)), Instant::EPOCH);
    }
}
