//! A model of the MCP2515 (data sheet DS20001801): what its SPI instructions do to its registers, and what a station
//! of the simulated bus does to them. It knows nothing of the driver.

use cosmic_bus::{Bus, ErrorLevel, Event, EventKind, FaultModel, StationId, VirtualInstant, WireFrame};
use cosmic_core::can::BitRate;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

/// The bus and the chips on it; time is that of the last [`World::run`].
pub(crate) struct World {
    pub(crate) bus: Bus,
    pub(crate) now: VirtualInstant,
    pub(crate) chips: Vec<Chip>,
    /// SPI transactions so far, of all chips.
    pub(crate) transactions: usize,
}

pub(crate) type Shared = Rc<RefCell<World>>;

impl World {
    pub(crate) fn new(bit_rate: BitRate, faults: FaultModel) -> Shared {
        let bus = Bus::new(bit_rate, faults);
        let now = bus.now();
        Rc::new(RefCell::new(Self { bus, now, chips: Vec::new(), transactions: 0 }))
    }

    /// Lets time pass.
    pub(crate) fn run(&mut self, to: VirtualInstant) {
        let mut events = Vec::new();
        self.bus.advance(to, &mut events);
        self.now = to;
        for event in &events {
            let chip = self.chips.iter_mut().find(|chip| chip.station == event.station);
            if let Some(chip) = chip {
                chip.on_event(event);
            }
        }
    }
}

/// A new chip on the bus, and its SPI device.
pub(crate) fn attach(world: &Shared, name: &str) -> Spi {
    let mut borrowed = world.borrow_mut();
    let station = borrowed.bus.attach(name);
    borrowed.chips.push(Chip { registers: [0; 128], station });
    Spi { world: world.clone(), chip: borrowed.chips.len() - 1 }
}

pub(crate) struct Chip {
    pub(crate) registers: [u8; 128],
    pub(crate) station: StationId,
}

/// What an instruction did to the transmit buffers.
enum Request {
    Send(usize),
    Abort(usize),
}

impl Chip {
    fn reset(&mut self) {
        self.registers = [0; 128];
        // Configuration mode, CLKOUT on.
        self.registers[CANSTAT] = 0x80;
        self.registers[CANCTRL] = 0x87;
    }

    fn is_configuring(&self) -> bool {
        self.registers[CANSTAT] & 0xE0 == 0x80
    }

    /// Writes the bits of `mask` of a register.
    fn write(&mut self, register: usize, mask: u8, value: u8, requests: &mut Vec<Request>) {
        let filters = matches!(register, 0x00..=0x0B | 0x10..=0x1B | 0x20..=0x2A);
        if filters && !self.is_configuring() {
            return;
        }
        let before = self.registers[register];
        let after = before & !mask | value & mask;
        match register {
            // Read only.
            CANSTAT | TEC | REC => {}
            CANCTRL => {
                self.registers[CANCTRL] = after;
                self.registers[CANSTAT] = after & 0xE0;
            }
            // Only the overflow flags can be written.
            EFLG => self.registers[EFLG] = before & 0x3F | after & 0xC0,
            0x30 | 0x40 | 0x50 => {
                let buffer = (register - 0x30) / 0x10;
                self.registers[register] = before & 0x70 | after & 0x0B;
                if after & TXREQ != 0 && before & TXREQ == 0 {
                    self.request(buffer, requests);
                } else if after & TXREQ == 0 && before & TXREQ != 0 {
                    requests.push(Request::Abort(buffer));
                }
            }
            0x31..=0x3D | 0x41..=0x4D | 0x51..=0x5D => {
                let control = register & 0xF0;
                assert!(self.registers[control] & TXREQ == 0, "a buffer is written while it is to be sent");
                self.registers[register] = after;
            }
            _ => self.registers[register] = after,
        }
    }

    fn request(&mut self, buffer: usize, requests: &mut Vec<Request>) {
        let control = &mut self.registers[0x30 + 0x10 * buffer];
        // ABTF, MLOA and TXERR belong to the request before.
        *control = *control & !0x70 | TXREQ;
        requests.push(Request::Send(buffer));
    }

    /// One transaction, from the fall of chip select to its rise.
    fn instruct(&mut self, operations: &mut [Operation<'_, u8>]) -> Vec<Request> {
        let written: Vec<u8> = operations
            .iter()
            .filter_map(|operation| match operation {
                Operation::Write(bytes) => Some(bytes.to_vec()),
                _ => None,
            })
            .flatten()
            .collect();
        let mut requests = Vec::new();
        let read: Box<dyn Fn(usize) -> u8> = match written[..] {
            [0xC0] => {
                self.reset();
                Box::new(|_| 0)
            }
            [0x03, register] => {
                let registers = self.registers;
                Box::new(move |at| registers[(usize::from(register) + at) % 128])
            }
            [0x02, register, ref values @ ..] => {
                for (at, value) in values.iter().enumerate() {
                    self.write((usize::from(register) + at) % 128, 0xFF, *value, &mut requests);
                }
                Box::new(|_| 0)
            }
            [0x05, register, mask, value] => {
                // Other registers ignore the mask; the driver must not rely on it there.
                assert!(
                    matches!(register, 0x0C..=0x0F | 0x1F | 0x28..=0x2D | 0x30 | 0x40 | 0x50 | 0x60 | 0x70)
                );
                self.write(usize::from(register), mask, value, &mut requests);
                Box::new(|_| 0)
            }
            [command @ (0x40 | 0x42 | 0x44), ref values @ ..] => {
                let first = 0x31 + 0x10 * usize::from((command - 0x40) / 2);
                assert!(values.len() <= 13);
                for (at, value) in values.iter().enumerate() {
                    self.write(first + at, 0xFF, *value, &mut requests);
                }
                Box::new(|_| 0)
            }
            [command @ 0x80..=0x87] => {
                for buffer in (0..3).filter(|buffer| command & 1 << buffer != 0) {
                    self.request(buffer, &mut requests);
                }
                Box::new(|_| 0)
            }
            [command @ (0x90 | 0x94)] => {
                let buffer = usize::from((command - 0x90) / 4);
                let first = 0x61 + 0x10 * buffer;
                let registers = self.registers;
                // The rise of chip select clears the flag.
                self.registers[CANINTF] &= !(1 << buffer);
                Box::new(move |at| registers[first + at])
            }
            [0xA0] => {
                let flags = self.registers[CANINTF];
                let mut status = flags & 0x03;
                for buffer in 0..3 {
                    let requested = self.registers[0x30 + 0x10 * buffer] & TXREQ != 0;
                    status |= u8::from(requested) << (2 + 2 * buffer);
                    status |= (flags >> (2 + buffer) & 1) << (3 + 2 * buffer);
                }
                Box::new(move |_| status)
            }
            ref other => panic!("no such instruction: {other:02X?}"),
        };
        let mut at = 0;
        for operation in operations {
            if let Operation::Read(bytes) = operation {
                for byte in bytes.iter_mut() {
                    *byte = read(at);
                    at += 1;
                }
            }
        }
        requests
    }

    /// The frame in a transmit buffer.
    fn frame(&self, buffer: usize) -> WireFrame {
        let first = 0x31 + 0x10 * buffer;
        let [sidh, sidl, eid8, eid0, dlc] = self.registers[first..first + 5].try_into().unwrap();
        let standard = u32::from(sidh) << 3 | u32::from(sidl) >> 5;
        let id: Id = if sidl & 0x08 != 0 {
            let extension = u32::from(sidl & 3) << 16 | u32::from(eid8) << 8 | u32::from(eid0);
            ExtendedId::new(standard << 18 | extension).unwrap().into()
        } else {
            StandardId::new(standard as u16).unwrap().into()
        };
        let len = usize::from(dlc & 0x0F).min(8);
        WireFrame::new(id, &self.registers[first + 5..first + 5 + len]).unwrap()
    }

    fn on_event(&mut self, event: &Event) {
        match event.kind {
            EventKind::Received(frame) => self.receive(&frame),
            EventKind::Sent { mailbox } => {
                self.registers[0x30 + 0x10 * mailbox] &= !TXREQ;
                self.registers[CANINTF] |= 0x04 << mailbox;
            }
            // Clearing TXREQ sets no flag.
            EventKind::Withdrawn { .. } => {}
            EventKind::Failed { mailbox, .. } => self.registers[0x30 + 0x10 * mailbox] |= 0x10,
            EventKind::ErrorState(state) => {
                self.registers[TEC] = state.transmit_errors.min(255) as u8;
                self.registers[REC] = state.receive_errors.min(255) as u8;
                let flags = match state.level() {
                    ErrorLevel::Active => 0,
                    ErrorLevel::Warning => 0x01,
                    ErrorLevel::Passive => 0x11,
                    ErrorLevel::BusOff => 0x31,
                };
                self.registers[EFLG] = self.registers[EFLG] & 0xC0 | flags;
                self.registers[CANINTF] |= 0x20;
            }
        }
    }

    /// The message assembly buffer holds a frame: which receive buffer takes it (data sheet, figure 4-3)?
    fn receive(&mut self, frame: &WireFrame) {
        if self.is_configuring() {
            return;
        }
        let raw = frame.arbitration().raw_id();
        let extended = frame.is_extended();
        let mut header = if extended {
            [
                (raw >> 21) as u8,
                (raw >> 13) as u8 & 0xE0 | 0x08 | (raw >> 16) as u8 & 3,
                (raw >> 8) as u8,
                raw as u8,
            ]
        } else {
            [(raw >> 3) as u8, (raw << 5) as u8, 0, 0]
        };
        let takes = |filters: &[usize], mask: usize, control: usize| {
            let any = self.registers[control] & 0x60 == 0x60;
            any || filters.iter().any(|filter| {
                let wanted = &self.registers[*filter..filter + 4];
                let masks = &self.registers[mask..mask + 4];
                let bits = [0xFF, 0xE3, 0xFF, 0xFF];
                let equal = (0..4).all(|at| (wanted[at] ^ header[at]) & masks[at] & bits[at] == 0);
                equal && (wanted[1] & 0x08 != 0) == extended
            })
        };
        let into_first = takes(&[0x00, 0x04], 0x20, 0x60);
        let into_second = takes(&[0x08, 0x10, 0x14, 0x18], 0x24, 0x70);
        let buffer = match (into_first, into_second) {
            (true, _) => 0,
            (_, true) => 1,
            _ => return,
        };
        if self.registers[CANINTF] & 1 << buffer != 0 {
            self.registers[EFLG] |= 0x40 << buffer;
            self.registers[CANINTF] |= 0x20;
            return;
        }
        if !extended && frame.is_remote_frame() {
            header[1] |= 0x10;
        }
        let first = 0x61 + 0x10 * buffer;
        self.registers[first..first + 4].copy_from_slice(&header);
        let remote = if extended && frame.is_remote_frame() { 0x40 } else { 0 };
        self.registers[first + 4] = remote | frame.dlc() as u8;
        self.registers[first + 5..first + 5 + frame.data().len()].copy_from_slice(frame.data());
        self.registers[CANINTF] |= 1 << buffer;
    }
}

/// The SPI device of one chip.
pub(crate) struct Spi {
    world: Shared,
    pub(crate) chip: usize,
}

impl ErrorType for Spi {
    type Error = Infallible;
}

impl SpiDevice for Spi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut world = self.world.borrow_mut();
        let world = &mut *world;
        world.transactions += 1;
        let chip = &mut world.chips[self.chip];
        for request in chip.instruct(operations) {
            match request {
                Request::Send(buffer) => {
                    let loaded = world.bus.load(world.now, chip.station, buffer, chip.frame(buffer));
                    loaded.expect("the frame before it has left the chip");
                }
                Request::Abort(buffer) => world.bus.withdraw(world.now, chip.station, buffer),
            }
        }
        Ok(())
    }
}

/// Takes no time.
pub(crate) struct NoDelay;

impl DelayNs for NoDelay {
    fn delay_ns(&mut self, _: u32) {}
}

const CANSTAT: usize = 0x0E;
const CANCTRL: usize = 0x0F;
const TEC: usize = 0x1C;
const REC: usize = 0x1D;
const CANINTF: usize = 0x2C;
const EFLG: usize = 0x2D;
const TXREQ: u8 = 0x08;
