//! The machine as a board of the runtime: the model of a controller stands for hardware.

use core::cell::RefCell;

use cosmic_core::can::{BitRate, Command, ErrorCounters, Frame, Mailbox, Outcome};
use cosmic_core::time::Instant;
use cosmic_rtic::Board;
use cosmic_rtic::board::{BoardParts, BusChanges, BusStatus, RxFifo, TxMailbox, TxOutcomes};
use critical_section::Mutex;
use rtic_sync::signal::{Signal, SignalReader};

use crate::hardware::{CanHardware, FIFO_DEPTH};
use crate::mono::{self, Mono, Timebase as _};

/// The board.
pub struct Machine;

static HARDWARE: Mutex<RefCell<CanHardware>> = Mutex::new(RefCell::new(CanHardware::new(BitRate::MAX)));
/// The bus has something to do before the instant that it named last.
static BUS: Signal<()> = Signal::new();

/// Calls `access` with the controller.
pub fn with_hardware<R>(access: impl FnOnce(&mut CanHardware) -> R) -> R {
    critical_section::with(|section| access(&mut HARDWARE.borrow_ref_mut(section)))
}

/// The bus: frames end at their instants. For a task above all of the node's.
pub async fn run_bus() -> ! {
    let mut changed: SignalReader<'static, ()> = BUS.take_reader();
    loop {
        let next = with_hardware(|hardware| {
            hardware.advance(mono::now());
            hardware.next_event()
        });
        let _ = Mono::timeout_at(mono::instant(next), changed.wait()).await;
    }
}

/// The peer on the bus wants to send a frame.
pub fn peer_sends(frame: Frame) {
    with_hardware(|hardware| hardware.peer_sends(frame, mono::now()));
    BUS.writer().write(());
}

/// One transmit mailbox, by its number.
pub struct Transmit<const MAILBOX: usize>;

/// One receive FIFO, by its number.
pub struct Receive<const FIFO: usize>;

impl<const MAILBOX: usize> Transmit<MAILBOX> {
    fn execute(command: Command) {
        with_hardware(|hardware| hardware.execute(command, mono::now()));
        BUS.writer().write(());
    }
}

impl<const MAILBOX: usize> TxMailbox for Transmit<MAILBOX> {
    fn load(&mut self, frame: &Frame) {
        Self::execute(Command::Load(Mailbox::ALL[MAILBOX], *frame));
    }

    fn withdraw(&mut self) {
        Self::execute(Command::Withdraw(Mailbox::ALL[MAILBOX]));
    }
}

impl TxOutcomes for Machine {
    fn take(&mut self) -> Option<(Mailbox, Outcome)> {
        let taken = |mailbox| with_hardware(|hardware| Some((mailbox, hardware.take_outcome(mailbox)?)));
        Mailbox::ALL.into_iter().find_map(taken)
    }
}

impl<const FIFO: usize> RxFifo for Receive<FIFO> {
    const AT_ONCE: usize = FIFO_DEPTH;

    fn read(&mut self) -> Option<Frame> {
        with_hardware(|hardware| hardware.receive(FIFO))
    }

    fn take_losses(&mut self) -> u32 {
        with_hardware(|hardware| hardware.take_losses(FIFO))
    }
}

impl BusStatus for Machine {
    fn errors(&self) -> ErrorCounters {
        ErrorCounters::NONE
    }
}

impl BusChanges for Machine {
    fn take_bus_off(&mut self) -> bool {
        false
    }
}

impl Board for Machine {
    type Hard = Transmit<0>;
    type Soft = Transmit<1>;
    type NonRealTime = Transmit<2>;
    type Outcomes = Self;
    type Urgent = Receive<0>;
    type Other = Receive<1>;
    type Status = Self;
    type Changes = Self;
    type Filters = ();

    fn now() -> Instant {
        mono::now()
    }

    async fn delay_until(instant: Instant) {
        Mono::delay_until(mono::instant(instant)).await;
    }

    async fn until(instant: Instant, other: impl Future<Output = ()>) {
        let _ = Mono::timeout_at(mono::instant(instant), other).await;
    }

    fn split(self) -> BoardParts<Self> {
        BoardParts {
            hard: Transmit,
            soft: Transmit,
            non_real_time: Transmit,
            outcomes: Self,
            urgent: Receive,
            other: Receive,
            status: Self,
            changes: Self,
            filters: (),
        }
    }
}
