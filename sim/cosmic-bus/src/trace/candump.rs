//! The log format of `candump -l` (can-utils), one line for each frame and each error.
//!
//! ```text
//! (1.000128) can0 00004064#1122334455667788
//! (1.000300) can0 20000008#0000080A00000000
//! ```
//!
//! A data frame stands at the end of its end of frame, an error at its detection. Errors are written as
//! Linux reports them: identifier 0x2000_0000 plus the error class, eight bytes that say more
//! (`linux/can/error.h`).

use super::{TraceEvent, TraceKind};
use crate::bits::Field;
use crate::confinement::ErrorLevel;
use crate::event::ErrorCause;
use crate::frame::WireFrame;
use crate::time::VirtualInstant;
use embedded_can::Frame as _;
use std::io;

/// Writes a trace as a candump log.
#[derive(Debug)]
pub struct Candump<W> {
    out: W,
    interface: String,
}

impl<W: io::Write> Candump<W> {
    /// A log of the interface `can0`, written to `out`.
    pub fn new(out: W) -> Self {
        Self::with_interface(out, "can0")
    }

    /// A log of an interface of another name.
    pub fn with_interface(out: W, interface: impl Into<String>) -> Self {
        Self { out, interface: interface.into() }
    }

    /// Writes what is to be written of an event; of many there is nothing.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn write(&mut self, event: &TraceEvent) -> io::Result<()> {
        match &event.kind {
            TraceKind::FrameEnd { frame, .. } => self.line(event.at, &FrameText(frame)),
            TraceKind::Error(error) => {
                self.line(event.at, &ErrorText::of_bus_error(error.cause, error.field))
            }
            TraceKind::ErrorState { state, .. } => match state.level() {
                ErrorLevel::BusOff => self.line(event.at, &ErrorText { class: class::BUS_OFF, data: [0; 8] }),
                _ => Ok(()),
            },
            _ => Ok(()),
        }
    }

    /// The writer, for example to flush it.
    pub fn into_inner(self) -> W {
        self.out
    }

    fn line(&mut self, at: VirtualInstant, text: &dyn core::fmt::Display) -> io::Result<()> {
        let microseconds = at.as_ticks() / 1_000;
        let (seconds, fraction) = (microseconds / 1_000_000, microseconds % 1_000_000);
        writeln!(self.out, "({seconds}.{fraction:06}) {} {text}", self.interface)
    }
}

struct FrameText<'a>(&'a WireFrame);

impl core::fmt::Display for FrameText<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let frame = self.0;
        let width = if frame.is_extended() { 8 } else { 3 };
        write!(f, "{:0width$X}#", frame.arbitration().raw_id())?;
        if frame.is_remote_frame() {
            return write!(f, "R{}", frame.dlc());
        }
        frame.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))?;
        // can-utils: a length code above 8 is written behind the eight bytes.
        if frame.length_code() > 8 { write!(f, "_{:X}", frame.length_code()) } else { Ok(()) }
    }
}

struct ErrorText {
    class: u32,
    data: [u8; 8],
}

impl ErrorText {
    fn of_bus_error(cause: ErrorCause, field: Field) -> Self {
        let (class, violation) = match cause {
            ErrorCause::Acknowledgement => (class::NO_ACKNOWLEDGEMENT, violation::UNSPECIFIED),
            ErrorCause::Bit => (class::PROTOCOL, violation::BIT),
            ErrorCause::Stuff => (class::PROTOCOL, violation::STUFF),
            ErrorCause::Form => (class::PROTOCOL, violation::FORM),
            // Linux knows a CRC error by its place.
            ErrorCause::Crc => (class::PROTOCOL, violation::UNSPECIFIED),
        };
        Self { class, data: [0, 0, violation, location(field), 0, 0, 0, 0] }
    }
}

impl core::fmt::Display for ErrorText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:08X}#", class::ERROR_FRAME | self.class)?;
        self.data.iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

/// `CAN_ERR_PROT_LOC_*`: the first location in the field.
const fn location(field: Field) -> u8 {
    match field {
        Field::StartOfFrame => 0x03,
        Field::Arbitration => 0x02,
        Field::Control => 0x0B,
        Field::Data => 0x0A,
        Field::Crc => 0x08,
        Field::CrcDelimiter => 0x18,
        Field::AcknowledgeSlot => 0x19,
        Field::AcknowledgeDelimiter => 0x1B,
        Field::EndOfFrame => 0x1A,
    }
}

/// Error classes, bits of the identifier.
mod class {
    pub(super) const ERROR_FRAME: u32 = 0x2000_0000;
    pub(super) const PROTOCOL: u32 = 0x08;
    pub(super) const NO_ACKNOWLEDGEMENT: u32 = 0x20;
    pub(super) const BUS_OFF: u32 = 0x40;
}

/// `CAN_ERR_PROT_*`, byte 2.
mod violation {
    pub(super) const UNSPECIFIED: u8 = 0x00;
    pub(super) const BIT: u8 = 0x01;
    pub(super) const FORM: u8 = 0x02;
    pub(super) const STUFF: u8 = 0x04;
}
