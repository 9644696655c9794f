//! The power controller (RM0090, chapter 5) as far as its voltage detector, and line 16 of EXTI (12.3), which is the
//! detector's. Other lines of EXTI are not modelled.

pub(crate) const PWR: u32 = 0x4000_7000;
pub(crate) const EXTI: u32 = 0x4001_3C00;
/// Of the detector (RM0090, table 62).
pub(crate) const INTERRUPT: u16 = 1;

/// The regulator is in its first scale (VOS).
const CONTROL_AT_RESET: u32 = 0x0000_C000;
const PVDE: u32 = 1 << 4;
const PVDO: u32 = 1 << 2;
const VOSRDY: u32 = 1 << 14;
const LINE: u32 = 1 << 16;

/// IMR, EMR, RTSR, FTSR, SWIER, PR.
const REGISTERS: usize = 6;
const IMR: usize = 0;
const RTSR: usize = 2;
const FTSR: usize = 3;
const SWIER: usize = 4;
const PR: usize = 5;

/// Power controller and EXTI.
#[derive(Clone, Debug)]
pub(crate) struct Power {
    control: u32,
    /// The supply is below the threshold, whichever was chosen.
    supply_is_low: bool,
    exti: [u32; REGISTERS],
}

impl Power {
    pub(crate) const fn new(supply_is_low: bool) -> Self {
        Self { control: CONTROL_AT_RESET, supply_is_low, exti: [0; REGISTERS] }
    }

    /// The supply sinks below the threshold, or rises above it.
    pub(crate) fn set_supply(&mut self, is_low: bool) {
        let before = self.output();
        self.supply_is_low = is_low;
        self.edge(before);
    }

    const fn output(&self) -> bool {
        self.supply_is_low && self.control & PVDE != 0
    }

    fn edge(&mut self, before: bool) {
        let selected = match (before, self.output()) {
            (false, true) => self.exti[RTSR],
            (true, false) => self.exti[FTSR],
            _ => 0,
        };
        self.exti[PR] |= selected & LINE;
    }

    pub(crate) const fn interrupt(&self) -> bool {
        self.exti[PR] & self.exti[IMR] & LINE != 0
    }

    pub(crate) fn read(&self, address: u32) -> Option<u32> {
        match address {
            PWR => Some(self.control),
            // The regulator's output is ready.
            0x4000_7004 => Some(VOSRDY | if self.output() { PVDO } else { 0 }),
            _ => self.exti.get(register(address)?).copied(),
        }
    }

    pub(crate) fn write(&mut self, address: u32, value: u32) -> Option<()> {
        match address {
            PWR => {
                let before = self.output();
                self.control = value;
                self.edge(before);
            }
            // Read-only, as far as it is modelled.
            0x4000_7004 => {}
            _ => match register(address)? {
                // A 1 clears.
                PR => self.exti[PR] &= !value,
                SWIER => self.exti[PR] |= value & LINE,
                at => self.exti[at] = value & LINE,
            },
        }
        Some(())
    }
}

fn register(address: u32) -> Option<usize> {
    let at = address.checked_sub(EXTI)? as usize / 4;
    (at < REGISTERS).then_some(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_detector_tells_of_a_supply_that_sinks() {
        let mut power = Power::new(false);
        power.write(EXTI, LINE).unwrap();
        power.write(EXTI + 8, LINE).unwrap();
        // Off, it sees nothing.
        power.set_supply(true);
        assert_eq!((power.read(PWR + 4), power.interrupt()), (Some(VOSRDY), false));
        // Switched on below the threshold, its output rises.
        power.write(PWR, CONTROL_AT_RESET | PVDE).unwrap();
        assert_eq!((power.read(PWR + 4), power.interrupt()), (Some(VOSRDY | PVDO), true));
        power.write(EXTI + 0x14, LINE).unwrap();
        assert!(!power.interrupt());
        // The falling edge is not selected.
        power.set_supply(false);
        assert_eq!((power.read(PWR + 4), power.interrupt()), (Some(VOSRDY), false));
        power.set_supply(true);
        assert!(power.interrupt());
        // Other lines, and what lies behind.
        power.write(EXTI, 1).unwrap();
        assert_eq!(
            (power.read(EXTI), power.read(EXTI + 0x18), power.write(EXTI + 0x18, 0)),
            (Some(0), None, None)
        );
    }
}
