//! The parts of a bxCAN controller as the runtime wants them: [`cosmic_rtic::board`].

use cosmic_core::can::{ErrorCounters, Frame, Mailbox, Outcome};
use cosmic_rtic::board;

use crate::bxcan_rx::RxFrames;
use crate::bxcan_status::{BusStatus, ErrorState, StatusChanges};
use crate::bxcan_tx::{Class, TxMailbox, TxOutcomes};

impl<C: Class> board::TxMailbox for TxMailbox<C> {
    #[inline]
    fn load(&mut self, frame: &Frame) {
        self.load(frame);
    }

    #[inline]
    fn withdraw(&mut self) {
        self.withdraw();
    }
}

impl board::TxOutcomes for TxOutcomes {
    #[inline]
    fn take(&mut self) -> Option<(Mailbox, Outcome)> {
        self.take()
    }
}

impl board::RxFifo for RxFrames {
    // The interrupt stays pending while there are more: to come again costs less than to look.
    const AT_ONCE: usize = 1;

    #[inline]
    fn read(&mut self) -> Option<Frame> {
        self.read()
    }

    #[inline]
    fn take_losses(&mut self) -> u32 {
        // Foreign frames are none of ours, and not lost.
        self.take_losses().overruns
    }
}

impl board::BusStatus for BusStatus {
    #[inline]
    fn errors(&self) -> ErrorCounters {
        self.errors()
    }

    #[inline]
    fn is_off(&self) -> bool {
        self.state() == ErrorState::BusOff
    }

    #[inline]
    fn ask_to_rejoin(&mut self) -> bool {
        self.ask_to_rejoin()
    }
}

impl board::BusChanges for StatusChanges {
    #[inline]
    fn take_bus_off(&mut self) -> bool {
        self.take().is_some_and(|change| change.went_off)
    }
}
