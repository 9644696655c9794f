//! The two controllers of a part (RM0090, dual CAN): one of them is wired to the bus.
//!
//! The filters of both stand in the registers of CAN1: the banks from `CAN2SB` on are CAN2's.

use cosmic_bus::WireFrame;

use super::{BxCan, Command, INTERRUPTS};
use crate::soc::timer::NotModelled;

/// The offset of the filter registers, which only CAN1 has.
const FILTERS: u32 = 0x200;

/// A controller of a part.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum CanController {
    /// CAN1.
    #[default]
    Can1,
    /// CAN2.
    Can2,
}

impl CanController {
    pub(crate) const BOTH: [Self; 2] = [Self::Can1, Self::Can2];
}

/// Both controllers.
#[derive(Clone, Debug)]
pub(crate) struct CanPair {
    controllers: [BxCan; 2],
    wired: CanController,
}

impl CanPair {
    /// After reset, with the transceiver at one of them.
    pub(crate) fn new(wired: CanController) -> Self {
        Self { controllers: [BxCan::new(), BxCan::new()], wired }
    }

    /// The one that is on the bus.
    pub(crate) fn wired(&self) -> &BxCan {
        &self.controllers[self.wired as usize]
    }

    pub(crate) fn wired_mut(&mut self) -> &mut BxCan {
        &mut self.controllers[self.wired as usize]
    }

    pub(crate) fn reset(&mut self, which: CanController, now: u64) {
        self.controllers[which as usize].reset(now);
    }

    pub(crate) fn set_clock_period(&mut self, cycles: u64) {
        self.controllers.iter_mut().for_each(|it| it.set_clock_period(cycles));
    }

    /// What is wanted of the bus since the last call. A controller that is not wired talks to nobody.
    pub(crate) fn take_commands(&mut self) -> Vec<(u64, Command)> {
        let [first, second] = &mut self.controllers;
        let (of_first, of_second) = (first.take_commands(), second.take_commands());
        if self.wired == CanController::Can1 { of_first } else { of_second }
    }

    /// A frame whose start of frame was at the cycle `started` was received.
    pub(crate) fn receive(&mut self, started: u64, frame: &WireFrame) {
        if let Some(found) = self.controllers[0].accept(self.wired, frame) {
            self.wired_mut().store(started, frame, found);
        }
    }

    /// The interrupts, by number, and whether they are asserted.
    pub(crate) fn interrupts(&self) -> impl Iterator<Item = (u16, bool)> {
        let lines = |(it, numbers): (&BxCan, [u16; 4])| numbers.into_iter().zip(it.interrupts());
        self.controllers.iter().zip(INTERRUPTS).flat_map(lines)
    }

    pub(crate) fn deadline(&self) -> Option<u64> {
        self.controllers.iter().filter_map(BxCan::deadline).min()
    }

    pub(crate) fn advance(&mut self, now: u64) {
        self.controllers.iter_mut().for_each(|it| it.advance(now));
    }

    /// Reads a register. `None` if there is none.
    pub(crate) fn read(&self, which: CanController, offset: u32) -> Option<u32> {
        if which == CanController::Can2 && offset >= FILTERS {
            return None;
        }
        self.controllers[which as usize].read(offset)
    }

    /// Writes a register at the cycle `now`. `Err` if there is none, or for what is not modelled.
    pub(crate) fn write(
        &mut self,
        which: CanController,
        now: u64,
        offset: u32,
        value: u32,
    ) -> Result<(), NotModelled> {
        if which == CanController::Can2 && offset >= FILTERS {
            return Err(NotModelled);
        }
        self.controllers[which as usize].write(now, offset, value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, Frame as _};

    fn frame() -> WireFrame {
        WireFrame::new(ExtendedId::new(5).unwrap(), &[1]).unwrap()
    }

    /// Both in normal mode; bank 0 passes everything to FIFO 0, and bank 14 to FIFO 1.
    fn pair(wired: CanController) -> CanPair {
        let mut pair = CanPair::new(wired);
        for (offset, value) in [(0x20C, 1 | 1 << 14), (0x214, 1 << 14), (0x21C, 1 | 1 << 14), (0x200, 0x0E00)]
        {
            pair.write(CanController::Can1, 0, offset, value).unwrap();
        }
        for which in CanController::BOTH {
            pair.write(which, 0, 0x00, 1).unwrap();
            pair.write(which, 0, 0x14, 1 << 1 | 1 << 4).unwrap();
            pair.write(which, 0, 0x00, 0).unwrap();
        }
        pair.advance(u64::MAX);
        pair
    }

    #[test]
    fn each_has_its_banks_its_fifos_and_its_interrupts() {
        for (wired, other, interrupt) in
            [(CanController::Can1, CanController::Can2, 20), (CanController::Can2, CanController::Can1, 65)]
        {
            let mut pair = pair(wired);
            pair.receive(0, &frame());
            let fifo = if wired == CanController::Can1 { 0x0C } else { 0x10 };
            assert_eq!(pair.read(wired, fifo), Some(1), "{wired:?}");
            assert_eq!((pair.read(other, 0x0C), pair.read(other, 0x10)), (Some(0), Some(0)), "{wired:?}");
            let asserted: Vec<_> =
                pair.interrupts().filter(|(_, is)| *is).map(|(number, _)| number).collect();
            assert_eq!(asserted, [interrupt]);
        }
    }

    #[test]
    fn can2_has_no_filter_registers_and_one_that_is_not_wired_has_no_bus() {
        let mut pair = pair(CanController::Can1);
        assert_eq!(pair.read(CanController::Can2, 0x200), None);
        assert_eq!(pair.write(CanController::Can2, 0, 0x21C, 1), Err(NotModelled));
        pair.take_commands();
        pair.write(CanController::Can2, 0, 0x180, 5 << 3 | 0b101).unwrap();
        assert_eq!(pair.take_commands(), []);
    }
}
