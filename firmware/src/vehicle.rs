//! A node of the vehicle: its board, its size, and the observer who shows what happens.

use boards::Stm32F405;
use boards::stm32f4::{MeasuringPoint, MeasuringPoints, Resources};
use cosmic_core::event_layer::{Channel, Delivered, Exception, PublishError};
use cosmic_core::plan::NodePlan;
use cosmic_core::services::ClockService;
use cosmic_core::time::Instant;
use cosmic_rtic::{CalendarObserver, Observer, Observes, Parts, Storage, System, start_observed};

use crate::cluster::Sequenced;
use crate::cluster::plan::Capacities;
use crate::records::Records;

/// What a node of the vehicle is made of.
pub struct Vehicle;

impl System for Vehicle {
    type Board = Stm32F405;
    type Capacity = Capacities;
    type Services = ClockService;
    type Observer = Reporter;
}

/// Brings up the node of this plan. For RTIC's `init`; a mistake in the settings ends there, with a log.
pub fn start(resources: Resources, plan: NodePlan, storage: &'static mut Storage<Vehicle>) -> Parts<Vehicle> {
    let records = Records::start(cosmic_rtic::EVENT_PRIORITY);
    let mut board = match Stm32F405::start(resources, &plan) {
        Ok(board) => board,
        Err(error) => defmt::panic!("the board cannot be brought up: {}", defmt::Debug2Format(&error)),
    };
    let points = defmt::unwrap!(board.points.take(), "nobody else takes the measuring points");
    let MeasuringPoints { calendar, published, delivered, exception } = points;
    let observer = Reporter { records, published, exception };
    let of_calendar = CalendarReporter { running: calendar, notified: delivered };
    let parts = defmt::unwrap!(start_observed(board, &plan, storage, observer, of_calendar));
    defmt::info!("node {} is up, calendar {=u32:08X}", plan.tx_node.get(), plan.calendar.digest());
    parts
}

/// Shows what happens to events: by records, logs and measuring points.
pub struct Reporter {
    records: Records,
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
}

impl<C: Sequenced> Observes<C> for Reporter {
    fn published(
        &mut self,
        channel: &Channel<C>,
        content: &C,
        at: Instant,
        result: Result<(), PublishError>,
    ) {
        let sequence = content.sequence();
        self.published.toggle();
        self.records.published(channel, sequence, at, result.is_ok());
        if let Err(error) = result {
            defmt::warn!("event {} of {} was not published: {}", sequence, channel.subject(), error);
        }
    }

    fn delivered(&mut self, channel: &Channel<C>, event: &Delivered<C>, at: Instant) {
        self.records.delivered(channel, event, at);
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
