//! A GPIO port (RM0090, chapter 8). Output levels are what measuring points are made of.
//!
//! Inputs without a pull-up read low; alternate functions drive nothing.

/// One port of 16 pins.
#[derive(Clone, Debug)]
pub(crate) struct Port {
    mode: u32,
    /// OTYPER, OSPEEDR.
    drive: [u32; 2],
    pull: u32,
    output: u16,
    lock: u32,
    alternate: [u32; 2],
}

/// Pins whose output level changed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Edges {
    pub(crate) pins: u16,
    pub(crate) levels: u16,
}

impl Port {
    /// After reset; `mode` and `pull` differ from 0 at the debug pins of ports A and B.
    pub(crate) const fn new(mode: u32, pull: u32) -> Self {
        Self { mode, drive: [0; 2], pull, output: 0, lock: 0, alternate: [0; 2] }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.mode,
            0x04 | 0x08 => self.drive[(offset as usize - 4) / 4],
            0x0C => self.pull,
            0x10 => u32::from(self.input()),
            0x14 => u32::from(self.output),
            0x18 => 0,
            0x1C => self.lock,
            0x20 | 0x24 => self.alternate[(offset as usize - 0x20) / 4],
            _ => return None,
        })
    }

    /// Writes a register and tells which outputs changed. `None` if there is no such register.
    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<Edges> {
        let before = self.driven();
        match offset {
            0x00 => self.mode = value,
            0x04 | 0x08 => self.drive[(offset as usize - 4) / 4] = value,
            0x0C => self.pull = value,
            0x10 => {}
            0x14 => self.output = value as u16,
            // Setting wins over resetting.
            0x18 => self.output = self.output & !(value >> 16) as u16 | value as u16,
            0x1C => self.lock = value,
            0x20 | 0x24 => self.alternate[(offset as usize - 0x20) / 4] = value,
            _ => return None,
        }
        let levels = self.driven();
        Some(Edges { pins: before ^ levels, levels })
    }

    /// Levels of the pins that are outputs; others count as low.
    fn driven(&self) -> u16 {
        self.output & pins_with(self.mode, 0b01)
    }

    fn input(&self) -> u16 {
        let outputs = pins_with(self.mode, 0b01);
        self.output & outputs | pins_with(self.pull, 0b01) & !outputs
    }
}

/// The pins whose two-bit field has this value.
fn pins_with(fields: u32, value: u32) -> u16 {
    (0..16).filter(|pin| fields >> (2 * pin) & 0b11 == value).fold(0, |pins, pin| pins | 1 << pin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_outputs_have_edges() {
        let mut port = Port::new(0xA800_0000, 0x6400_0000);
        let none = Edges { pins: 0, levels: 0 };
        assert_eq!(port.write(0x18, 1 << 3), Some(none));
        assert_eq!(port.write(0x00, 1 << 6 | 1 << 4), Some(Edges { pins: 8, levels: 8 }));
        assert_eq!(port.write(0x18, 1 << 19 | 1 << 2), Some(Edges { pins: 12, levels: 4 }));
        assert_eq!(port.read(0x14), Some(4));
        // Pull-ups on 13 and 15, of the debug port.
        assert_eq!(port.read(0x10), Some(1 << 13 | 1 << 15 | 4));
        assert_eq!(port.write(0x28, 0), None);
    }
}
