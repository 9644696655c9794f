//! The receive FIFOs, acceptance filters and error state of bxCAN.
//!
//! FIFO 0 takes what must be read at once: hard real-time and synchronisation frames. FIFO 1 takes the
//! rest. Each has an interrupt of its own, so the first can have the higher priority.

use bxcan::filter::{ListEntry32, Mask32};
use bxcan::{ExtendedId, Fifo, Rx0, Rx1};
use cosmic_core::can::filter_banks::{self, FilterBank};
use cosmic_core::can::{Frame, Id, Payload};
use stm32f4xx_hal::can::Can1;

/// Frames that a FIFO holds before it loses one.
pub const FIFO_DEPTH: usize = 3;

/// More filters than the peripheral has banks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct TooManyFilters;

/// Writes the filters to banks 0, 1, ... and switches all others off. Reception pauses for that time.
///
/// # Errors
/// If there are more than [`BANKS`]; those that have a bank are written then.
pub(crate) fn apply_filters<'a>(
    can: &mut bxcan::Can<Can1>,
    filters: impl Iterator<Item = &'a FilterBank>,
) -> Result<(), TooManyFilters> {
    let mut banks = can.modify_filters();
    banks.clear();
    for (bank, filter) in (0..).zip(filters) {
        if bank >= BANKS as u8 {
            return Err(TooManyFilters);
        }
        let fifo = match filter.fifo() {
            filter_banks::Fifo::Urgent => Fifo::Fifo0,
            filter_banks::Fifo::Other => Fifo::Fifo1,
        };
        match filter {
            FilterBank::Mask { id, mask, .. } => {
                let mut mask = Mask32::frames_with_ext_id(extended(*id), extended(*mask));
                mask.data_frames_only();
                banks.enable_bank(bank, fifo, mask);
            }
            FilterBank::List { ids, .. } => {
                let entry = |id: &Id| ListEntry32::data_frames_with_id(extended(id.raw()));
                banks.enable_bank(bank, fifo, ids.each_ref().map(entry));
            }
        }
    }
    Ok(())
}

/// How many frames a FIFO did not hand over.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct RxLosses {
    /// Times that the FIFO was full and a frame was lost.
    pub overruns: u32,
    /// Frames that were no extended data frames.
    pub foreign: u32,
}

/// A receive FIFO: read by its own interrupt only.
pub struct RxFrames<R> {
    fifo: R,
    losses: RxLosses,
}

/// FIFO 0.
pub type UrgentFrames = RxFrames<Rx0<Can1>>;
/// FIFO 1.
pub type OtherFrames = RxFrames<Rx1<Can1>>;

impl<R: Receive> RxFrames<R> {
    pub(crate) fn new(fifo: R) -> Self {
        Self { fifo, losses: RxLosses::default() }
    }

    /// The next frame, if there is one. The interrupt stays pending while there are more.
    ///
    /// Bounded: takes at most [`FIFO_DEPTH`] frames out, if all but the last are foreign.
    pub fn read(&mut self) -> Option<Frame> {
        // One turn more than the FIFO is deep, since an overrun is reported in a turn of its own.
        for _ in 0..=FIFO_DEPTH {
            match self.fifo.receive() {
                Ok(received) => match frame(&received) {
                    Some(frame) => return Some(frame),
                    None => self.losses.foreign = self.losses.foreign.saturating_add(1),
                },
                Err(nb::Error::WouldBlock) => return None,
                Err(nb::Error::Other(_)) => self.losses.overruns = self.losses.overruns.saturating_add(1),
            }
        }
        None
    }

    /// What was not handed over since the last call.
    pub fn take_losses(&mut self) -> RxLosses {
        core::mem::take(&mut self.losses)
    }
}

/// What both FIFOs of the driver can do.
pub trait Receive {
    /// The next frame, or that one was lost.
    fn receive(&mut self) -> nb::Result<bxcan::Frame, bxcan::OverrunError>;
}

impl Receive for Rx0<Can1> {
    #[inline]
    fn receive(&mut self) -> nb::Result<bxcan::Frame, bxcan::OverrunError> {
        Rx0::receive(self)
    }
}

impl Receive for Rx1<Can1> {
    #[inline]
    fn receive(&mut self) -> nb::Result<bxcan::Frame, bxcan::OverrunError> {
        Rx1::receive(self)
    }
}

/// The frame, if it is an extended data frame.
fn frame(received: &bxcan::Frame) -> Option<Frame> {
    let bxcan::Id::Extended(id) = received.id() else { return None };
    let data = received.data()?;
    Some(Frame::new(Id::from_raw(id.as_raw())?, Payload::new(data)?))
}

fn extended(raw: u32) -> ExtendedId {
    // Bits above the identifier do not exist; a filter cannot ask for them.
    ExtendedId::new(raw & ExtendedId::MAX.as_raw()).unwrap_or(ExtendedId::ZERO)
}

/// Filter banks: of the 28 that both controllers share, those before the reset value of `CAN2SB`.
pub const BANKS: usize = 14;

/// How the controller stands towards the bus (ISO 11898-1, fault confinement).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ErrorState {
    /// Takes part in everything.
    Active,
    /// Over 127 errors: signals errors passively.
    Passive,
    /// Over 255 transmit errors: off the bus, until 128 times 11 recessive bits were seen.
    BusOff,
}

/// The error counters of the controller.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ErrorCounters {
    /// Transmit error counter.
    pub transmit: u8,
    /// Receive error counter.
    pub receive: u8,
    /// What follows from them.
    pub state: ErrorState,
}

/// Reads the error state.
pub struct BusStatus(());

impl BusStatus {
    pub(crate) const fn new() -> Self {
        Self(())
    }

    /// The error counters as they are now.
    pub fn errors(&self) -> ErrorCounters {
        // SAFETY: CAN_ESR is only read, and reading it changes nothing.
        let errors = unsafe { &*stm32f4xx_hal::pac::CAN1::ptr() }.esr().read();
        let state = match (errors.boff().bit_is_set(), errors.epvf().bit_is_set()) {
            (true, _) => ErrorState::BusOff,
            (false, true) => ErrorState::Passive,
            (false, false) => ErrorState::Active,
        };
        ErrorCounters { transmit: errors.tec().bits(), receive: errors.rec().bits(), state }
    }
}
