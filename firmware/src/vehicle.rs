//! A node of the vehicle: its board, its size, and the observer who shows what happens.

use boards::stm32f4::{MeasuringPoint, MeasuringPoints, Resources};
use cosmic_core::Subject;
use cosmic_core::can::TxNode;
use cosmic_core::event_layer::{Content, Delivered, Exception, Filter, Policy, PublishError};
use cosmic_core::plan::NodePlan;
use cosmic_core::services::ClockService;
use cosmic_core::time::Instant;
use cosmic_records::Recorder;
use cosmic_rtic::{CalendarObserver, Observer, Observes, Parts, Storage, System, start_observed};

use crate::cluster::plan::{self, Capacities};
use crate::records;

/// What a node of the vehicle is made of.
pub struct Vehicle;

/// The board that is built for.
#[cfg(not(board))]
pub type Board = boards::Stm32F405;
/// The board that is built for.
#[cfg(board = "nucleo-f446re")]
pub type Board = boards::Stm32F4<boards::wiring::NucleoF446Re>;
/// The board that is built for.
#[cfg(board = "feather-f405")]
pub type Board = boards::Stm32F4<boards::wiring::FeatherF405>;

impl System for Vehicle {
    type Board = Board;
    type Capacity = Capacities;
    type Services = ClockService;
    type Observer = Reporter;
}

/// Brings up the node of this plan. For RTIC's `init`; a mistake in the settings ends there, with a log.
pub fn start(resources: Resources, node: NodePlan, storage: &'static mut Storage<Vehicle>) -> Parts<Vehicle> {
    records::start(cosmic_rtic::EVENT_PRIORITY);
    let records = defmt::unwrap!(cosmic_records::rtt::recorder(&plan::CHANNELS));
    let mut board = match Board::start(resources, &node) {
        Ok(board) => board,
        Err(error) => defmt::panic!("the board cannot be brought up: {}", defmt::Debug2Format(&error)),
    };
    let points = defmt::unwrap!(board.points.take(), "nobody else takes the measuring points");
    let MeasuringPoints { calendar, published, delivered, exception } = points;
    let observer = Reporter { records, published, exception };
    let of_calendar = CalendarReporter { running: calendar, notified: delivered };
    let parts = defmt::unwrap!(start_observed(board, &node, storage, observer, of_calendar));
    let tx_node = node.tx_node.unwrap_or(TxNode::BROKER);
    defmt::info!("node {} is up, calendar {=u32:08X}", tx_node.get(), node.calendar.digest());
    parts
}

/// What the plan has room for. If it has not, the log says so, and the task ends: the others go on.
pub fn planned<T, E: defmt::Format>(result: Result<T, E>) -> Option<T> {
    if let Err(error) = &result {
        defmt::error!("a task ends: {}", error);
    }
    result.ok()
}

/// Shows what happens to events: by records, logs and measuring points.
pub struct Reporter {
    records: Recorder<cosmic_rtt::Channel, CalendarReporter>,
    published: MeasuringPoint<13>,
    exception: MeasuringPoint<15>,
}

/// Shows by measuring points what the calendar task does.
pub struct CalendarReporter {
    running: MeasuringPoint<12>,
    notified: MeasuringPoint<14>,
}

impl Observer for Reporter {
    type Calendar = CalendarReporter;

    fn exception(&mut self, exception: &Exception) {
        self.exception.toggle();
        self.records.exception(exception);
        defmt::warn!("{}", exception);
    }

    fn subscribed(&mut self, subject: Subject, filter: Filter, policy: Policy, at: Instant) {
        self.records.subscribed(subject, filter, policy, at);
    }

    fn cancelled(&mut self, subject: Subject, at: Instant) {
        self.records.cancelled(subject, at);
    }
}

impl<C: Content> Observes<C> for Reporter {
    fn published(&mut self, subject: Subject, content: &C, at: Instant, result: Result<(), PublishError>) {
        self.published.toggle();
        self.records.published(subject, content, at, result);
        if let Err(error) = result {
            defmt::warn!("an event of {} was not published: {}", subject, error);
        }
    }

    fn delivered(&mut self, subject: Subject, event: &Delivered<C>, at: Instant) {
        self.records.delivered(subject, event, at);
    }
}

impl CalendarObserver for CalendarReporter {
    #[inline]
    fn running(&mut self, runs: bool) {
        if runs {
            self.running.set();
        } else {
            self.running.clear();
        }
    }

    #[inline]
    fn notified(&mut self) {
        self.notified.toggle();
    }
}
