//! When a node that went off the bus asks to take part again.
//!
//! A controller that recovers by itself is back after 128 times 11 recessive bits: 1.4 ms at 1 Mbit/s. If what took it off
//! the bus persists, such as a line that is shorted, it destroys 32 frames of its own, with an error flag each, is back, and
//! so on: most of the bus is lost to all. So the node lets a time pass, and asks then. The time is doubled with each time
//! off the bus, up to a second, and is short again once the node was on the bus for long enough.

use cosmic_core::time::{Duration, Instant};

/// The way back to the bus.
#[derive(Debug)]
pub(crate) struct Rejoin {
    phase: Phase,
    /// When something is to be done; [`NEVER`] on the bus.
    acts_at: Instant,
    /// Before the next request.
    pause: Duration,
    /// When it was last found to be on the bus again.
    on_since: Instant,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Phase {
    On,
    /// The pause passes, or the request is being made.
    Pausing,
    /// The controller counts recessive bits.
    Recovering,
}

impl Rejoin {
    /// On the bus.
    pub(crate) const fn new() -> Self {
        Self { phase: Phase::On, acts_at: NEVER, pause: SHORTEST, on_since: Instant::EPOCH }
    }

    /// Does what is due, and says when something will be. `is_off` is the state of the controller, `went_off` says that it
    /// has left the bus since the last call. `ask` takes a step of the request, and returns whether it was the last.
    pub(crate) fn attend(
        &mut self,
        now: Instant,
        is_off: bool,
        went_off: bool,
        ask: impl FnOnce() -> bool,
    ) -> Instant {
        let is_due = now >= self.acts_at;
        match self.phase {
            Phase::On if is_off => {
                if now >= self.on_since + CALM {
                    self.pause = SHORTEST;
                }
                self.begin_pause(now);
            }
            Phase::Pausing if is_due => {
                if ask() {
                    (self.phase, self.acts_at) = (Phase::Recovering, now + LONGEST);
                } else {
                    self.acts_at = now + STEP;
                }
            }
            Phase::Recovering if !is_off => {
                (self.phase, self.acts_at, self.on_since) = (Phase::On, NEVER, now);
            }
            // Off again before it was seen to be on, or it was not heard.
            Phase::Recovering if went_off || is_due => self.begin_pause(now),
            Phase::On | Phase::Pausing | Phase::Recovering => {}
        }
        self.acts_at
    }

    fn begin_pause(&mut self, now: Instant) {
        (self.phase, self.acts_at) = (Phase::Pausing, now + self.pause);
        self.pause = if self.pause < LONGEST / 2 { self.pause * 2 } else { LONGEST };
    }
}

const NEVER: Instant = Instant::FAR_FUTURE;
const SHORTEST: Duration = Duration::from_millis(10);
/// A recovery is over before: 128 frames of 160 bits are 0.41 s at 50 kbit/s.
const LONGEST: Duration = Duration::from_secs(1);
/// From one step of a request to the next: many bits.
const STEP: Duration = Duration::from_millis(1);
/// So long on the bus, and all is well again.
const CALM: Duration = Duration::from_secs(2);

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn ms(milliseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(milliseconds))
    }

    /// Off the bus at `at`: when it asks, with a request of two steps.
    fn asks_at(rejoin: &mut Rejoin, at: u64) -> u64 {
        let first = rejoin.attend(ms(at), true, true, || panic!("not at once"));
        let second = rejoin.attend(first, true, false, || false);
        assert_eq!(second, first + STEP);
        assert_eq!(rejoin.attend(first, true, false, || panic!("not yet")), second);
        assert_eq!(rejoin.attend(second, true, false, || true), second + LONGEST);
        second.since_epoch().as_ticks() / 1_000_000
    }

    #[test]
    fn the_pause_doubles_up_to_a_second() {
        let mut rejoin = Rejoin::new();
        let mut at = 5_000;
        let mut pauses = Vec::new();
        for _ in 0..9 {
            let asked = asks_at(&mut rejoin, at);
            pauses.push(asked - at - 1);
            // It is back after two milliseconds, and off again after three more.
            assert_eq!(rejoin.attend(ms(asked + 2), false, false, || panic!("it is on")), NEVER);
            at = asked + 5;
        }
        assert_eq!(pauses, [10, 20, 40, 80, 160, 320, 640, 1000, 1000]);
        // Two seconds on the bus, and it begins anew.
        assert_eq!(asks_at(&mut rejoin, at + 2_000) - at, 2_011);
    }

    #[test]
    fn what_was_not_seen_does_not_end_it() {
        let mut rejoin = Rejoin::new();
        let asked = asks_at(&mut rejoin, 0);
        // It was on the bus between two looks.
        assert_eq!(rejoin.attend(ms(asked + 5), true, true, || panic!("not at once")), ms(asked + 25));
        let asked = {
            assert_eq!(rejoin.attend(ms(asked + 25), true, false, || true), ms(asked + 1_025));
            asked + 25
        };
        // Nobody said so, and it is still off: it asks again.
        assert_eq!(rejoin.attend(ms(asked + 1_000), true, false, || panic!("later")), ms(asked + 1_040));
    }
}
