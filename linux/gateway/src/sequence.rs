//! An event once: what has come already, and what is missing.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use cosmic_core::time::Duration;

use crate::clock::Reading;
use crate::counters::Outcome;
use crate::encoding::{Envelope, Sender};
use crate::keys::EventKey;

/// What a number says.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Seen {
    /// It is new. So many before it did not come; −1: it was missing, and has come late.
    New {
        /// How many more are missing now.
        missing: i64,
    },
    /// It has come already.
    Duplicate,
    /// It is so far behind that nobody knows.
    TooOld,
}

/// The numbers that have come of one sender, segment and subject.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    latest: u64,
    /// Bit n: `latest − n` has come.
    come: u128,
}

impl Window {
    /// Numbers that are remembered.
    pub const LEN: u64 = 128;

    /// After the first number.
    pub const fn new(first: u64) -> Self {
        // What was before it was not for us.
        Self { latest: first, come: u128::MAX }
    }

    /// A number has come. O(1).
    pub fn note(&mut self, number: u64) -> Seen {
        if let Some(ahead) = number.checked_sub(self.latest).filter(|ahead| *ahead > 0) {
            self.come = if ahead < Self::LEN { self.come << ahead } else { 0 } | 1;
            self.latest = number;
            return Seen::New { missing: i64::try_from(ahead - 1).unwrap_or(i64::MAX) };
        }
        let behind = self.latest - number;
        if behind >= Self::LEN {
            return Seen::TooOld;
        }
        if self.come >> behind & 1 == 1 {
            return Seen::Duplicate;
        }
        self.come |= 1 << behind;
        Seen::New { missing: -1 }
    }
}

/// The windows of all senders, segments and subjects whose events come in at one place.
#[derive(Debug, Default)]
pub(crate) struct Windows(Mutex<HashMap<(EventKey, Sender), (Window, Reading)>>);

impl Windows {
    /// An event has come: so many before it are missing, or why it is discarded. O(1); when there is no room, those that
    /// are of no use any more are looked for.
    pub(crate) fn note(&self, key: &EventKey, envelope: &Envelope, now: Reading) -> Result<u64, Outcome> {
        let mut windows = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (key.clone(), envelope.sender);
        if let Some((window, heard_at)) = windows.get_mut(&key) {
            *heard_at = now;
            return match window.note(envelope.sequence) {
                // One that comes late was counted as missing.
                Seen::New { missing } => Ok(u64::try_from(missing).unwrap_or(0)),
                Seen::Duplicate => Err(Outcome::Duplicate),
                Seen::TooOld => Err(Outcome::OutOfWindow),
            };
        }
        if windows.len() >= MOST_WINDOWS {
            windows.retain(|_, (_, heard_at)| now.since(*heard_at) < MEMORY);
        }
        if windows.len() >= MOST_WINDOWS {
            return Err(Outcome::TooManySenders);
        }
        windows.insert(key, (Window::new(envelope.sequence), now));
        Ok(0)
    }
}

/// Senders, segments and subjects at once, at most: some megabytes.
const MOST_WINDOWS: usize = 65_536;
/// One that was silent for so long begins anew.
const MEMORY: Duration = Duration::from_secs(60);

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashSet;

    #[test]
    fn numbers_are_new_once() {
        let mut window = Window::new(10);
        let seen: Vec<_> = [10, 11, 14, 12, 12, 9, 200, 14, 201].map(|number| window.note(number)).into();
        let new = |missing| Seen::New { missing };
        assert_eq!(
            seen,
            [
                Seen::Duplicate,
                new(0),
                new(2),
                new(-1),
                Seen::Duplicate,
                Seen::Duplicate,
                new(185),
                Seen::TooOld,
                new(0)
            ]
        );
        assert_eq!(window.note(u64::MAX), new(i64::MAX));
    }

    proptest! {
        /// Nothing is new twice, and what is missing adds up.
        #[test]
        fn against_a_set(steps in proptest::collection::vec(-140_i64..140, 0..200)) {
            let (mut window, mut at) = (Window::new(1000), 1000_u64);
            let (mut come, mut missing, mut latest) = (HashSet::from([1000]), 0, 1000);
            for step in steps {
                at = at.saturating_add_signed(step).max(1000);
                match window.note(at) {
                    Seen::New { missing: more } => {
                        prop_assert!(come.insert(at));
                        missing += more;
                        latest = latest.max(at);
                    }
                    Seen::Duplicate => prop_assert!(come.contains(&at)),
                    Seen::TooOld => prop_assert!(latest - at >= Window::LEN),
                }
                prop_assert_eq!(missing, (latest - 1000 + 1) as i64 - come.len() as i64);
            }
        }
    }
}
