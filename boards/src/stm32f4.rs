//! Boards with an STM32F405, F407 or F446: what is the same on all of them. What is not is their [`Wiring`].
//!
//! The core runs at 168 MHz, APB1 with the CAN controllers at 42 MHz, the timers behind it at 84 MHz. A transceiver is
//! needed. Between two tasks the core sleeps; an app with an `#[idle]` task calls [`stay_awake`]. PB12 to PB15 are
//! measuring points. All other pins and peripherals are the application's.
//!
//! An F446 has what is used here of an F405: the same registers at the same addresses with the same meaning, the same
//! numbers of interrupts (RM0390), and as much RAM.

use cosmic_core::can::BitRate;
use cosmic_core::can::filter_banks::FilterBank;
use cosmic_core::plan::NodePlan;
use cosmic_core::time::Instant;
use cosmic_rtic::CALENDAR_PRIORITY;
use cosmic_rtic::board::{Board, BoardParts};
use stm32f4xx_hal::gpio::{GpioExt as _, Output, Pin};
use stm32f4xx_hal::pac;
use stm32f4xx_hal::rcc::{Config, Enable as _, Rcc, RccExt as _, Reset as _};
use stm32f4xx_hal::time::Hertz;

use crate::bit_timing::{APB1, BitTiming};
use crate::bxcan::{Parts, SetUpError};
use crate::bxcan_filters::SpareBanks;
use crate::bxcan_rx::RxFrames;
use crate::bxcan_status::{BusStatus, Recovery, StatusChanges};
use crate::bxcan_tx::{HardMailbox, NonRealTimeMailbox, SoftMailbox, TxOutcomes};
use crate::clock;
use crate::failure;
use crate::pll;
use crate::wiring::{Can, PinsOfBoth, Stm32H405, Wiring};

/// A board with an 8 MHz crystal and its transceiver at CAN1, such as the Olimex STM32-H405.
pub type Stm32F405 = Stm32F4<Stm32H405>;

/// A board that takes part in the traffic, and its parts, each for one owner. As a [`Board`] it is run by
/// `cosmic-rtic`.
pub struct Stm32F4<W: Wiring> {
    /// Transmit mailbox of the time-triggered half.
    pub hard: HardMailbox,
    /// Transmit mailbox of the EDF queue.
    pub soft: SoftMailbox,
    /// Transmit mailbox of the non real-time queue.
    pub non_real_time: NonRealTimeMailbox,
    /// For the interrupt `CAN1_TX`.
    pub outcomes: TxOutcomes,
    /// For the interrupt `CAN1_RX0`.
    pub urgent: RxFrames,
    /// For the interrupt `CAN1_RX1`.
    pub other: RxFrames,
    /// For the interrupt `CAN1_SCE`.
    pub changes: StatusChanges,
    /// The error state of the controller.
    pub bus: BusStatus,
    /// The filters that change as the node runs.
    pub filters: SpareBanks,
    /// Pins for an oscilloscope, for whoever takes them.
    pub points: Option<MeasuringPoints>,
    /// The pins of port B that the board does not use.
    pub pins: <W::Can as Can>::FreePins,
    /// Switches the clocks of further peripherals on, as their drivers in [`hal`](crate::hal) want it.
    pub rcc: Rcc,
}

/// What a board takes of the chip: [`resources!`](crate::resources) takes it. All else is the application's.
pub struct Resources<C = pac::CAN1> {
    /// Clocks.
    pub rcc: pac::RCC,
    /// The port of the CAN pins and of the measuring points.
    pub port: pac::GPIOB,
    /// The CAN controller; with CAN2 both, since it needs the other's clock and filters.
    pub can: C,
    /// The monotonic timer.
    pub timer: pac::TIM2,
}

/// Takes from the peripherals, such as `cx.device` in RTIC's `init`, what a board needs: its [`Resources`]. The others
/// stay where they are. For a board with its transceiver at CAN2: `resources!(cx.device, CAN2)`.
///
/// ```ignore
/// let mut board = Stm32F405::start(boards::resources!(cx.device), &NODE)?;
/// let led = cx.device.GPIOD.split(&mut board.rcc).pd12.into_push_pull_output();
/// ```
#[macro_export]
macro_rules! resources {
    ($peripherals:expr) => {
        $crate::resources!(@ $peripherals, $peripherals.CAN1)
    };
    ($peripherals:expr, CAN2) => {
        $crate::resources!(@ $peripherals, ($peripherals.CAN1, $peripherals.CAN2))
    };
    (@ $peripherals:expr, $can:expr) => {
        $crate::stm32f4::Resources {
            rcc: $peripherals.RCC,
            port: $peripherals.GPIOB,
            can: $can,
            timer: $peripherals.TIM2,
        }
    };
}

/// What a board is brought up with.
#[derive(Clone, Copy, Debug)]
pub struct Settings<F> {
    /// The bit rate of the bus; one that 42 MHz can give exactly.
    pub bit_rate: BitRate,
    /// Which frames to receive, and where; at most [`BANKS`](crate::bxcan_filters::BANKS).
    pub filters: F,
    /// What else to receive is said as the node runs; everything until then. Two banks at least are left for it.
    pub leaves_spare: bool,
}

/// Why a board cannot be brought up.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum BoardError {
    /// The controller's clock cannot give the bit rate exactly.
    BitRate,
    /// More filters than banks.
    Filters,
    /// The CAN controller does not enter its initialisation mode.
    Controller,
    /// The crystal does not oscillate, or the PLL does not follow it.
    Crystal,
}

impl<W: Wiring> Stm32F4<W> {
    /// Returns whether the board gives this bit rate exactly: `const _: () = assert!(Stm32F405::gives(RATE));`
    pub const fn gives(bit_rate: BitRate) -> bool {
        BitTiming::new(APB1, bit_rate).is_some()
    }

    /// Brings a board up for a node, whose plan says bit rate and filters, with the timer's interrupt at the
    /// priority of the runtime's calendar task; see [`new`](Self::new).
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn start(resources: OfBoard<W>, node: &NodePlan) -> Result<Self, BoardError> {
        let bit_rate = node.calendar.segment().bit_rate;
        let settings =
            Settings { bit_rate, filters: node.filters.iter(), leaves_spare: node.named_at_run_time };
        Self::new(resources, settings, CALENDAR_PRIORITY)
    }

    /// Sets the clocks, starts the timer, and joins the bus.
    ///
    /// Waits until the crystal runs and the bus has been recessive for 11 bits; call it before interrupts
    /// are enabled, as RTIC's `init` does. It waits for neither for longer than a tenth of a second: without a crystal
    /// it returns an error, and on a bus that is held dominant the node starts, and joins when the bus is free. But after a
    /// crystal has failed while the node ran it waits until that oscillates again, and it waits for a supply above 2.8 V at most.
    ///
    /// `timer` is the priority of the timer's interrupt, as RTIC counts. A task of a higher one must not wait for
    /// the clock: it would be woken by a lower one.
    ///
    /// # Errors
    /// If the settings ask for what the controller cannot do, or crystal or controller do not run.
    pub fn new<'a>(
        resources: OfBoard<W>,
        settings: Settings<impl Iterator<Item = &'a FilterBank>>,
        timer: u8,
    ) -> Result<Self, BoardError> {
        let timing = BitTiming::new(APB1, settings.bit_rate).ok_or(BoardError::BitRate)?;
        let is_clock = W::OSCILLATOR.is_clock;
        // Why it is told so: see `pll`.
        let source = Config::hse(Hertz::from_raw(pll::CORE));
        let source = if is_clock { source.bypass_hse_oscillator() } else { source };
        let clocks = source.pclk1(Hertz::from_raw(APB1)).pclk2(Hertz::from_raw(APB2));
        let Resources { rcc, port, can, timer: tim2 } = resources;
        sleep_between_tasks();
        if !failure::start_crystal(&rcc, is_clock) {
            return Err(BoardError::Crystal);
        }
        let mut rcc = rcc.freeze(clocks);
        if !pll::switch_to(&rcc, const { pll::factors(W::OSCILLATOR.hertz) }) {
            return Err(BoardError::Crystal);
        }
        failure::watch_crystal(&rcc);
        failure::watch_supply(&rcc);
        pac::TIM2::enable(&mut rcc);
        pac::TIM2::reset(&mut rcc);
        clock::start(tim2, TIMERS, timer);

        let port = port.split(&mut rcc);
        let points = MeasuringPoints {
            calendar: MeasuringPoint { pin: port.pb12.into_push_pull_output() },
            published: MeasuringPoint { pin: port.pb13.into_push_pull_output() },
            delivered: MeasuringPoint { pin: port.pb14.into_push_pull_output() },
            exception: MeasuringPoint { pin: port.pb15.into_push_pull_output() },
        };

        let pins = W::Can::wire(PinsOfBoth {
            pb0: port.pb0,
            pb1: port.pb1,
            pb2: port.pb2,
            pb5: port.pb5,
            pb6: port.pb6,
            pb7: port.pb7,
            pb8: port.pb8,
            pb9: port.pb9,
            pb10: port.pb10,
            pb11: port.pb11,
        });
        let mut can = W::Can::take(can, &mut rcc);
        let set_up = can.set_up(timing, W::RECOVERY, settings.filters, settings.leaves_spare);
        let filters = set_up.map_err(|error| match error {
            SetUpError::TooManyFilters => BoardError::Filters,
            SetUpError::NoAnswer => BoardError::Controller,
        })?;
        // A bus that is stuck now may be free later: the node says in its status what it counts of errors.
        let _ = can.join();
        let Parts { hard, soft, non_real_time, outcomes, urgent, other, changes, bus } = can.split();
        let points = Some(points);
        Ok(Self {
            hard,
            soft,
            non_real_time,
            outcomes,
            urgent,
            other,
            changes,
            bus,
            filters,
            points,
            pins,
            rcc,
        })
    }
}

/// All that an RTIC app does is done in interrupts: when the last one ends, the core sleeps until the next, where RTIC by
/// itself turns in circles. A debug probe that attaches then finds no core unless its clock stays on (RM0090, debug support
/// for low-power modes); it reads the logs in memory as before.
fn sleep_between_tasks() {
    // SAFETY: bits that nobody else changes, but for `stay_awake`, before interrupts are enabled as this is.
    unsafe {
        (*pac::DBGMCU::ptr()).cr().modify(|_, w| w.dbg_sleep().set_bit());
        cortex_m::Peripherals::steal().SCB.set_sleeponexit();
    }
}

/// The core does not sleep between tasks. For `init`, after the board has started, of an app with an `#[idle]` task: that
/// would not get on otherwise.
pub fn stay_awake() {
    // SAFETY: a bit that only the start of the board changes.
    unsafe { cortex_m::Peripherals::steal().SCB.clear_sleeponexit() };
}

/// What a board takes of the chip.
pub type OfBoard<W> = Resources<<<W as Wiring>::Can as Can>::Peripherals>;

impl<W: Wiring> Board for Stm32F4<W> {
    type Hard = HardMailbox;
    type Soft = SoftMailbox;
    type NonRealTime = NonRealTimeMailbox;
    type Outcomes = TxOutcomes;
    type Urgent = RxFrames;
    type Other = RxFrames;
    type Status = BusStatus;
    type Changes = StatusChanges;
    type Filters = SpareBanks;

    const REJOINS_ON_REQUEST: bool = matches!(W::RECOVERY, Recovery::Paced);

    #[inline]
    fn now() -> Instant {
        clock::now()
    }

    #[inline]
    // A future that another one holds would be kept beside what it was made of.
    fn delay_until(instant: Instant) -> impl Future<Output = ()> {
        clock::delay_until(instant)
    }

    #[inline]
    fn until(instant: Instant, other: impl Future<Output = ()>) -> impl Future<Output = ()> {
        clock::until(instant, other)
    }

    #[inline]
    fn calendar_until(instant: Instant, other: impl Future<Output = ()>) -> impl Future<Output = ()> {
        clock::calendar_until(instant, other)
    }

    fn split(self) -> BoardParts<Self> {
        let Self { hard, soft, non_real_time, outcomes, urgent, other, changes, bus, filters, .. } = self;
        BoardParts { hard, soft, non_real_time, outcomes, urgent, other, status: bus, changes, filters }
    }
}

/// Pins that show on an oscilloscope what the node does. Each changes when the event occurs.
pub struct MeasuringPoints {
    /// PB12: high while the calendar task runs.
    pub calendar: MeasuringPoint<12>,
    /// PB13: changes when an event is published.
    pub published: MeasuringPoint<13>,
    /// PB14: changes when an event is delivered.
    pub delivered: MeasuringPoint<14>,
    /// PB15: changes when an exception is raised.
    pub exception: MeasuringPoint<15>,
}

/// A pin of port B for an oscilloscope. It owns its pin only, so no two contend.
pub struct MeasuringPoint<const N: u8> {
    pin: Pin<'B', N, Output>,
}

impl<const N: u8> MeasuringPoint<N> {
    /// High.
    #[inline]
    pub fn set(&mut self) {
        self.pin.set_high();
    }

    /// Low.
    #[inline]
    pub fn clear(&mut self) {
        self.pin.set_low();
    }

    /// The other level.
    #[inline]
    pub fn toggle(&mut self) {
        self.pin.toggle();
    }
}

/// The timers behind APB1 run at twice its frequency (RM0090, 7.2).
const TIMERS: u32 = 2 * APB1;
const APB2: u32 = 84_000_000;
