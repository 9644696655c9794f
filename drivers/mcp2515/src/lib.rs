//! MCP2515, a CAN controller on SPI, as a [`Controller`] of COSMIC.
//!
//! Its three transmit buffers are the mailboxes of the classes: TXB0 hard, TXB1 soft, TXB2 non real-time,
//! with descending priority inside the chip. RXB0 takes urgent frames, RXB1 the others, without roll-over from
//! one to the other, so that frames of one channel keep their order.
//!
//! # Withdrawal
//! A frame is withdrawn by clearing its TXREQ. The chip sets no flag when it has gone (ABTF belongs to the
//! request that withdraws *all* frames, data sheet section 3.6), and a frame that was on the wire is still sent.
//! So the driver waits, without blocking, for as long as such a frame may take: if it has not been sent by then,
//! its outcome is [`Outcome::Withdrawn`]. That is one longest frame, and another one for the time of
//! the SPI transfer: 320 bit times. [`Controller::next_wakeup`] says when.
//!
//! # Limits
//! * Tested against a model of the chip's registers, over a simulated bus. Driver and model follow the data sheet
//!   DS20001801 as its author remembers it; they were not compared with a copy line by line. It was **not tried
//!   on hardware**; the errata of the chip were not studied.
//! * Time-stamps are taken by the host when it is interrupted. The transfer of a frame over SPI follows after
//!   that, but two frames in one interrupt share a stamp: clock synchronisation is less accurate than with a
//!   controller in the processor.
//! * A chip that is reset behind the driver's back (brown-out) is not noticed.
//! * One-shot mode, sleep, the RXnBF and TXnRTS pins are not used.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)
)]

#[cfg(test)]
extern crate std;

mod bit_timing;
mod filters;
mod registers;

pub use bit_timing::BitTiming;
pub use filters::Filters;

use core::fmt;
use cosmic_core::can::{BitRate, Controller, ErrorCounters, Frame, LONGEST_FRAME_BITS, Mailbox, Outcome};
use cosmic_core::can::{Payload, Status};
use cosmic_core::time::{Duration, Instant};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{Operation, SpiDevice};
use registers::*;

/// How the chip is to be set up.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Config {
    /// The frequency of its crystal.
    pub oscillator_hz: u32,
    /// The bit rate of the segment.
    pub bit_rate: BitRate,
    /// What it is to accept. It stays so: a node that is [named at run
    /// time](cosmic_core::plan::NodePlan::named_at_run_time) takes [`Filters::ALL`].
    pub filters: Filters,
}

/// Why the chip was not set up.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum SetUpError<E> {
    /// The SPI bus failed.
    Spi(E),
    /// The oscillator does not give this bit rate exactly.
    BitRate,
    /// The chip is not in configuration mode after its reset, or does not keep what is written into it.
    NoChip,
}

impl<E: fmt::Debug> fmt::Display for SetUpError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Spi(error) => write!(f, "the SPI bus failed ({error:?}): look at its pins and clock"),
            Self::BitRate => {
                f.write_str("the oscillator does not give this bit rate: use another crystal or a lower rate")
            }
            Self::NoChip => f.write_str(
                "no MCP2515 answers: look at chip select, SPI mode (0,0 or 1,1), clock (at most 10 MHz), power",
            ),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for SetUpError<E> {}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum MailboxState {
    Empty,
    Loaded,
    /// It has gone by then, if it is not sent.
    Withdrawing(Instant),
}

/// The chip, on the bus.
#[derive(Debug)]
pub struct Mcp2515<SPI> {
    spi: SPI,
    /// How long a withdrawn frame may still be on its way.
    on_the_wire: Duration,
    states: [MailboxState; 3],
    lost: u32,
    foreign: u32,
}

impl<SPI: SpiDevice> Mcp2515<SPI> {
    /// Resets the chip, sets it up and lets it take part in the traffic. Waits 128 cycles of the oscillator
    /// or a little longer (data sheet, section 8.1).
    ///
    /// # Errors
    /// [`SetUpError`]
    pub fn new(spi: SPI, delay: &mut impl DelayNs, config: &Config) -> Result<Self, SetUpError<SPI::Error>> {
        let timing = BitTiming::new(config.oscillator_hz, config.bit_rate).ok_or(SetUpError::BitRate)?;
        let on_the_wire = config.bit_rate.bits(2 * LONGEST_FRAME_BITS);
        let mut chip = Self { spi, on_the_wire, states: [MailboxState::Empty; 3], lost: 0, foreign: 0 };
        chip.spi.write(&[RESET]).map_err(SetUpError::Spi)?;
        delay.delay_us(START_UP_CYCLES * 1_000_000 / config.oscillator_hz + 1);
        let is_there = chip.set_up(timing, &config.filters).map_err(SetUpError::Spi)?;
        if is_there { Ok(chip) } else { Err(SetUpError::NoChip) }
    }

    /// Returns whether the chip is there. 14 transactions.
    fn set_up(&mut self, timing: BitTiming, filters: &Filters) -> Result<bool, SPI::Error> {
        let [mode] = self.read(CANSTAT)?;
        if mode & OPMOD != OPMOD_CONFIGURATION {
            return Ok(false);
        }
        self.write(CNF3, &timing.registers())?;
        if self.read(CNF3)? != timing.registers() {
            return Ok(false);
        }
        let [first, last] = filters.filter_registers();
        self.write(RXF0SIDH, &first)?;
        self.write(RXF3SIDH, &last)?;
        self.write(RXM0SIDH, &filters.mask_registers())?;
        // Filters on, no roll-over.
        self.write(RXB0CTRL, &[0])?;
        self.write(RXB1CTRL, &[0])?;
        for (mailbox, priority) in Mailbox::ALL.into_iter().zip([3, 2, 1]) {
            self.write(control(mailbox), &[priority])?;
        }
        self.write(CANINTE, &[INTERRUPTS, 0])?;
        // Normal mode, no clock output.
        self.write(CANCTRL, &[0])?;
        Ok(true)
    }

    /// Gives the SPI device back.
    pub fn release(self) -> SPI {
        self.spi
    }

    fn read<const N: usize>(&mut self, register: u8) -> Result<[u8; N], SPI::Error> {
        let mut values = [0; N];
        self.spi.transaction(&mut [Operation::Write(&[READ, register]), Operation::Read(&mut values)])?;
        Ok(values)
    }

    fn write(&mut self, register: u8, values: &[u8]) -> Result<(), SPI::Error> {
        self.spi.transaction(&mut [Operation::Write(&[WRITE, register]), Operation::Write(values)])
    }

    fn clear(&mut self, register: u8, bits: u8) -> Result<(), SPI::Error> {
        self.spi.write(&[BIT_MODIFY, register, bits, 0])
    }

    fn read_status(&mut self) -> Result<u8, SPI::Error> {
        let mut status = [0];
        self.spi.transaction(&mut [Operation::Write(&[READ_STATUS]), Operation::Read(&mut status)])?;
        let [status] = status;
        Ok(status)
    }

    /// What a receive buffer holds, which is empty then; `None` if it is foreign.
    fn fetch(&mut self, buffer: u8) -> Result<Option<Frame>, SPI::Error> {
        let mut header = [0; 5];
        let mut data = [0; Payload::MAX_LEN];
        self.spi.transaction(&mut [
            Operation::Write(&[READ_RX + 4 * buffer]),
            Operation::Read(&mut header),
            Operation::Read(&mut data),
        ])?;
        let [sidh, sidl, eid8, eid0, dlc] = header;
        if sidl & EXIDE == 0 || dlc & RTR != 0 {
            self.foreign = self.foreign.wrapping_add(1);
            return Ok(None);
        }
        // A length above eight is eight on the wire (ISO 11898-1).
        let payload = Payload::truncated(data, usize::from(dlc & DLC));
        Ok(Some(Frame::new(filters::identifier(sidh, sidl, eid8, eid0), payload)))
    }
}

/// SPI transactions at most: `load` 2, `withdraw` 1, `outcome` 2, `receive` 3, `status` 4.
impl<SPI: SpiDevice> Controller for Mcp2515<SPI> {
    type Error = SPI::Error;

    fn load(&mut self, mailbox: Mailbox, frame: &Frame) -> Result<(), Self::Error> {
        let buffer = mailbox as u8;
        let [sidh, sidl, eid8, eid0] = filters::identifier_registers(frame.id.raw());
        let len = frame.payload.len() as u8;
        let header = [LOAD_TX + 2 * buffer, sidh, sidl | EXIDE, eid8, eid0, len];
        let mut operations = [Operation::Write(&header), Operation::Write(frame.payload.as_slice())];
        self.spi.transaction(&mut operations)?;
        self.spi.write(&[REQUEST_TO_SEND | 1 << buffer])?;
        self.set_state(mailbox, MailboxState::Loaded);
        Ok(())
    }

    fn withdraw(&mut self, mailbox: Mailbox, now: Instant) -> Result<(), Self::Error> {
        if self.states.get(mailbox as usize) == Some(&MailboxState::Loaded) {
            self.clear(control(mailbox), TXREQ)?;
            self.set_state(mailbox, MailboxState::Withdrawing(now + self.on_the_wire));
        }
        Ok(())
    }

    fn outcome(&mut self, now: Instant) -> Result<Option<(Mailbox, Outcome)>, Self::Error> {
        if self.states == [MailboxState::Empty; 3] {
            return Ok(None);
        }
        let status = self.read_status()?;
        let mailboxes = Mailbox::ALL.into_iter().zip(STATUS_TX).zip(self.states);
        for ((mailbox, sent), content) in mailboxes {
            let outcome = match content {
                MailboxState::Loaded | MailboxState::Withdrawing(_) if status & sent != 0 => {
                    self.clear(CANINTF, TX0IF << mailbox as u8)?;
                    Outcome::Sent
                }
                MailboxState::Withdrawing(gone_by) if now >= gone_by => Outcome::Withdrawn,
                _ => continue,
            };
            self.set_state(mailbox, MailboxState::Empty);
            return Ok(Some((mailbox, outcome)));
        }
        Ok(None)
    }

    fn receive(&mut self) -> Result<Option<Frame>, Self::Error> {
        let status = self.read_status()?;
        for (buffer, full) in (0..).zip(STATUS_RX) {
            if status & full != 0
                && let Some(frame) = self.fetch(buffer)?
            {
                return Ok(Some(frame));
            }
        }
        Ok(None)
    }

    fn status(&mut self) -> Result<Status, Self::Error> {
        let [transmit, receive] = self.read(TEC)?;
        // First, so that what changes meanwhile raises the interrupt again.
        self.clear(CANINTF, ERRIF)?;
        let [flags] = self.read(EFLG)?;
        let overruns = flags & (RX0OVR | RX1OVR);
        if overruns != 0 {
            self.clear(EFLG, overruns)?;
            self.lost = self.lost.wrapping_add(overruns.count_ones());
        }
        let errors = ErrorCounters { transmit, receive };
        Ok(Status { errors, is_bus_off: flags & TXBO != 0, lost: self.lost, foreign: self.foreign })
    }

    fn next_wakeup(&self) -> Instant {
        let waits = self.states.iter().filter_map(|state| match state {
            MailboxState::Withdrawing(gone_by) => Some(*gone_by),
            MailboxState::Empty | MailboxState::Loaded => None,
        });
        waits.min().unwrap_or(Instant::FAR_FUTURE)
    }
}

impl<SPI> Mcp2515<SPI> {
    fn set_state(&mut self, mailbox: Mailbox, state: MailboxState) {
        if let Some(place) = self.states.get_mut(mailbox as usize) {
            *place = state;
        }
    }
}

/// The control register of a transmit buffer.
const fn control(mailbox: Mailbox) -> u8 {
    TXB0CTRL + 0x10 * mailbox as u8
}

/// The oscillator start-up timer.
const START_UP_CYCLES: u32 = 128;
