//! What a node hosts for others: a broker, one that admits channels, too, or nothing.

use crate::admission::{AdmissionControl, AdmissionPlan, AdmissionTiming};
use crate::broker::{Broker, BrokerEvent};
use crate::can::{Frame, Id, TxNode};
use crate::protocol::Output;
use crate::time::Instant;

/// A broker that a node hosts, or `()`.
pub trait Hosted {
    /// Whether [`on_event`](Self::on_event) does anything.
    const WATCHES_EVENTS: bool;
    /// As [`Broker::on_event`].
    fn on_event(&mut self, now: Instant, id: Id) -> bool;
    /// As [`Broker::set_tx_node`].
    fn set_tx_node(&mut self, now: Instant, tx_node: Option<TxNode>);
    /// As [`Broker::on_frame`].
    fn on_frame(&mut self, frame: &Frame, now: Instant);
    /// As [`Broker::poll`].
    fn poll(&mut self, now: Instant) -> Option<Output<BrokerEvent>>;
    /// As [`Broker::next_wakeup`].
    fn next_wakeup(&self) -> Instant;
}

impl Hosted for () {
    const WATCHES_EVENTS: bool = false;

    fn on_event(&mut self, _: Instant, _: Id) -> bool {
        false
    }

    fn set_tx_node(&mut self, _: Instant, _: Option<TxNode>) {}

    fn on_frame(&mut self, _: &Frame, _: Instant) {}

    fn poll(&mut self, _: Instant) -> Option<Output<BrokerEvent>> {
        None
    }

    fn next_wakeup(&self) -> Instant {
        Instant::FAR_FUTURE
    }
}

impl<const NODES: usize, const SUBJECTS: usize> Hosted for Broker<NODES, SUBJECTS> {
    const WATCHES_EVENTS: bool = true;

    fn on_event(&mut self, now: Instant, id: Id) -> bool {
        Broker::on_event(self, now, id)
    }

    fn set_tx_node(&mut self, now: Instant, tx_node: Option<TxNode>) {
        Broker::set_tx_node(self, now, tx_node);
    }

    fn on_frame(&mut self, frame: &Frame, now: Instant) {
        Broker::on_frame(self, frame, now);
    }

    fn poll(&mut self, now: Instant) -> Option<Output<BrokerEvent>> {
        Broker::poll(self, now)
    }

    fn next_wakeup(&self) -> Instant {
        Broker::next_wakeup(self)
    }
}

/// `None` hosts no broker, so one program can decide at start.
impl<B: Hosted> Hosted for Option<B> {
    const WATCHES_EVENTS: bool = B::WATCHES_EVENTS;

    fn on_event(&mut self, now: Instant, id: Id) -> bool {
        self.as_mut().is_some_and(|broker| broker.on_event(now, id))
    }

    fn set_tx_node(&mut self, now: Instant, tx_node: Option<TxNode>) {
        if let Some(broker) = self {
            broker.set_tx_node(now, tx_node);
        }
    }

    fn on_frame(&mut self, frame: &Frame, now: Instant) {
        if let Some(broker) = self {
            broker.on_frame(frame, now);
        }
    }

    fn poll(&mut self, now: Instant) -> Option<Output<BrokerEvent>> {
        self.as_mut()?.poll(now)
    }

    fn next_wakeup(&self) -> Instant {
        self.as_ref().map_or(Instant::FAR_FUTURE, B::next_wakeup)
    }
}

/// A broker for `NODES` nodes and `SUBJECTS` subjects, whose node also [admits](crate::admission) up to `ADMITTED` soft
/// real-time channels that the plan does not know.
#[derive(Clone, Debug)]
pub struct AdmittingBroker<const NODES: usize, const SUBJECTS: usize, const ADMITTED: usize> {
    broker: Broker<NODES, SUBJECTS>,
    control: Option<AdmissionControl<ADMITTED>>,
}

impl<const NODES: usize, const SUBJECTS: usize, const ADMITTED: usize>
    AdmittingBroker<NODES, SUBJECTS, ADMITTED>
{
    /// Both are off until their node has a TxNode. Without a plan, which says what there is to be weighed, it admits nothing.
    pub fn new(
        broker: Broker<NODES, SUBJECTS>,
        plan: Option<&'static AdmissionPlan>,
        timing: AdmissionTiming,
    ) -> Self {
        let control = plan.map(|plan| AdmissionControl::new(&plan.reservations, timing));
        Self { broker, control }
    }

    /// The broker.
    pub const fn broker(&self) -> &Broker<NODES, SUBJECTS> {
        &self.broker
    }

    /// Admission control, if its plan is known.
    pub const fn control(&self) -> Option<&AdmissionControl<ADMITTED>> {
        self.control.as_ref()
    }

    fn tell_role(&mut self, now: Instant) {
        if let Some(control) = &mut self.control {
            control.set_role(now, self.broker.role());
        }
    }
}

impl<const NODES: usize, const SUBJECTS: usize, const ADMITTED: usize> Hosted
    for AdmittingBroker<NODES, SUBJECTS, ADMITTED>
{
    const WATCHES_EVENTS: bool = true;

    fn on_event(&mut self, now: Instant, id: Id) -> bool {
        self.broker.on_event(now, id)
    }

    fn set_tx_node(&mut self, now: Instant, tx_node: Option<TxNode>) {
        self.broker.set_tx_node(now, tx_node);
        self.tell_role(now);
    }

    fn on_frame(&mut self, frame: &Frame, now: Instant) {
        self.broker.on_frame(frame, now);
        self.tell_role(now);
        if let Some(control) = &mut self.control {
            control.on_frame(frame);
        }
    }

    fn poll(&mut self, now: Instant) -> Option<Output<BrokerEvent>> {
        let output = self.broker.poll(now);
        self.tell_role(now);
        let subjects = self.broker.subjects();
        output.or_else(|| self.control.as_mut()?.poll(now, |subject| subjects.etag_of(subject)))
    }

    fn next_wakeup(&self) -> Instant {
        let control = self.control.as_ref().map_or(Instant::FAR_FUTURE, AdmissionControl::next_wakeup);
        self.broker.next_wakeup().min(control)
    }
}
