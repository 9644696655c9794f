//! Fault confinement (ISO 11898-1): each station counts errors, and falls silent when it causes too many.

/// How far a station is trusted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum ErrorLevel {
    /// Both counters are below 96.
    Active,
    /// Error active, but a counter has reached 96: the warning limit of most controllers.
    Warning,
    /// A counter has reached 128: the station signals errors by recessive flags, which disturb nobody,
    /// and pauses eight bits after each of its transmissions.
    Passive,
    /// The transmit error counter has passed 255: the station takes no part in the traffic.
    BusOff,
}

/// The error counters of a station.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct ErrorState {
    /// Transmit error counter (TEC). Above 255 the station is bus-off.
    pub transmit_errors: u16,
    /// Receive error counter (REC), at most 255.
    pub receive_errors: u16,
}

impl ErrorState {
    /// A station as it comes out of reset.
    pub const NEW: Self = Self { transmit_errors: 0, receive_errors: 0 };

    /// What the counters amount to.
    pub const fn level(self) -> ErrorLevel {
        if self.transmit_errors > BUS_OFF_LIMIT {
            return ErrorLevel::BusOff;
        }
        let worse = if self.transmit_errors > self.receive_errors {
            self.transmit_errors
        } else {
            self.receive_errors
        };
        match worse {
            PASSIVE_LIMIT.. => ErrorLevel::Passive,
            WARNING_LIMIT.. => ErrorLevel::Warning,
            _ => ErrorLevel::Active,
        }
    }

    /// Returns whether the station signals errors by dominant flags.
    pub(crate) fn is_error_active(self) -> bool {
        self.level() < ErrorLevel::Passive
    }

    /// A frame was sent.
    pub(crate) const fn sent(&mut self) {
        self.transmit_errors = self.transmit_errors.saturating_sub(1);
    }

    /// A frame was received without error. A counter above the passive limit falls below it; to which of
    /// 119..=127 is the controller's choice: 120 is bxCAN's (RM0090, bxCAN error management).
    pub(crate) const fn received(&mut self) {
        if self.receive_errors >= PASSIVE_LIMIT {
            self.receive_errors = 120;
        } else {
            self.receive_errors = self.receive_errors.saturating_sub(1);
        }
    }

    /// An own transmission failed.
    pub(crate) const fn transmit_error(&mut self) {
        self.transmit_errors += STEP;
    }

    /// A foreign frame failed.
    pub(crate) const fn receive_error(&mut self) {
        self.count_receive_errors(1);
    }

    /// The bus was still dominant after the station's own error flag: it was the first to see the error,
    /// so it may itself be the faulty one.
    pub(crate) const fn first_to_see_receive_error(&mut self) {
        self.count_receive_errors(STEP);
    }

    const fn count_receive_errors(&mut self, by: u16) {
        self.receive_errors += by;
        if self.receive_errors > RECEIVE_LIMIT {
            self.receive_errors = RECEIVE_LIMIT;
        }
    }
}

/// What a station does once it is bus-off.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum BusOffRecovery {
    /// It counts the 128 sequences of 11 recessive bits at once, without being asked (bxCAN: ABOM = 1).
    #[default]
    Automatic,
    /// It waits for a request (bxCAN: ABOM = 0, the software leaves initialization mode).
    OnRequest,
}

/// Sequences of 11 recessive bits that end bus-off.
pub(crate) const RECOVERY_SEQUENCES: u32 = 128;
/// Recessive bits that make one such sequence, and that a station must see before it takes part.
pub(crate) const INTEGRATION_BITS: u32 = 11;

const WARNING_LIMIT: u16 = 96;
const PASSIVE_LIMIT: u16 = 128;
const BUS_OFF_LIMIT: u16 = 255;
const RECEIVE_LIMIT: u16 = 255;
const STEP: u16 = 8;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_follow_the_counters() {
        let level = |transmit_errors, receive_errors| ErrorState { transmit_errors, receive_errors }.level();
        assert_eq!(level(0, 0), ErrorLevel::Active);
        assert_eq!(level(95, 95), ErrorLevel::Active);
        assert_eq!(level(96, 0), ErrorLevel::Warning);
        assert_eq!(level(0, 127), ErrorLevel::Warning);
        assert_eq!(level(128, 0), ErrorLevel::Passive);
        assert_eq!(level(0, 255), ErrorLevel::Passive);
        assert_eq!(level(255, 0), ErrorLevel::Passive);
        assert_eq!(level(256, 0), ErrorLevel::BusOff);
    }

    #[test]
    fn thirty_two_failures_in_a_row_are_bus_off() {
        let mut state = ErrorState::NEW;
        for _ in 0..31 {
            state.transmit_error();
        }
        assert_eq!(state.level(), ErrorLevel::Passive);
        state.transmit_error();
        assert_eq!(state.level(), ErrorLevel::BusOff);
    }

    #[test]
    fn reception_counts_down_and_leaves_the_passive_range() {
        let mut state = ErrorState::NEW;
        state.received();
        assert_eq!(state, ErrorState::NEW);
        for _ in 0..60 {
            state.first_to_see_receive_error();
        }
        assert_eq!(state.receive_errors, 255);
        state.received();
        assert_eq!(state.receive_errors, 120);
        state.received();
        assert_eq!(state.receive_errors, 119);
    }
}
