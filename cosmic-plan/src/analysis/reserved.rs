//! What a plan reserves, for a node that [admits](cosmic_core::admission) soft channels at run time.

use super::bus::Stream;
use super::errors::ErrorModel;
use super::segment::Traffic;
use crate::cluster::Cluster;
use crate::plan::found::Plan;
use cosmic_core::Subject;
use cosmic_core::admission::{CalendarDemand, Faults, Guarded, Load, Reservations, SoftLoad};
use cosmic_core::time::Duration;

/// What [`Reservations`] refer to.
#[derive(Clone, Debug)]
pub struct Reserved {
    like: Reservations<'static>,
    steps: Vec<(Duration, Duration)>,
    calendar: CalendarDemand<'static>,
    above: Vec<Load>,
    soft: Vec<SoftLoad>,
    guarded: Vec<Guarded>,
}

impl Reserved {
    /// Of this cluster with this plan.
    pub fn of(cluster: &Cluster, plan: &Plan) -> Self {
        let traffic = Traffic::of(cluster, plan);
        let (cycle, total, slack, steps) = traffic.bus.calendar.demand();
        let soft = traffic.soft.iter().filter_map(|(channel, _, soft)| {
            let subject = Subject::new(cluster.channels[*channel].subject)?;
            Some(SoftLoad { load: load(&soft.stream), deadline: ticks(soft.deadline), subject })
        });
        let guarded = traffic.guarded(cluster);
        Self {
            like: Reservations {
                bit_rate: cluster.segment.bit_rate,
                priority_step: cluster.priority_step,
                reload: cluster.segment.release_jitter,
                slow_refill: cluster.slow_refill,
                faults: faults(cluster.errors),
                calendar: CalendarDemand::NONE,
                above: &[],
                soft: &[],
                guarded: &[],
            },
            steps: steps.iter().map(|(span, load)| (ticks(*span), ticks(*load))).collect(),
            calendar: CalendarDemand {
                cycle: ticks(cycle),
                total: ticks(total),
                slack: ticks(slack),
                steps: &[],
            },
            above: traffic.above_soft().iter().map(load).collect(),
            soft: soft.collect(),
            guarded: guarded
                .iter()
                .map(|(span, room)| Guarded { span: ticks(*span), room: ticks(*room) })
                .collect(),
        }
    }

    /// As a node takes them.
    pub fn reservations(&self) -> Reservations<'_> {
        Reservations {
            calendar: CalendarDemand { steps: &self.steps, ..self.calendar },
            above: &self.above,
            soft: &self.soft,
            guarded: &self.guarded,
            ..self.like
        }
    }
}

fn load(stream: &Stream) -> Load {
    let Stream { transmission, period, jitter } = *stream;
    Load { transmission: ticks(transmission), interval: ticks(period), tolerance: ticks(jitter) }
}

fn faults(model: ErrorModel) -> Faults {
    match model {
        ErrorModel::None => Faults::None,
        ErrorModel::Burst { burst, interval } => Faults::Burst(burst, interval),
        ErrorModel::Window { count, window } => Faults::Window(count, window),
    }
}

fn ticks(ticks: u64) -> Duration {
    Duration::from_ticks(ticks)
}
