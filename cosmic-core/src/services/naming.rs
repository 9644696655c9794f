//! Names alone: the node's TxNode and the etags of its channels, as a broker gives them.

use super::{Declaration, NodeView, Request, Services, TooMany};
use crate::can::{Etag, Frame, TxNode};
use crate::client::{
    Binding, BindingEvent, BindingTiming, Configuration, ConfigurationEvent, ConfigurationTiming,
};
use crate::event_layer::ExceptionKind;
use crate::protocol::Output;
use crate::time::{GlobalClock, Instant};
use crate::uid::{NodeUid, Subject};

/// Configuration and binding: for a small node that publishes and subscribes, and has no clock.
///
/// Such a node takes no part in hard real-time, and tells nobody that it is there or what it wants: a remote event
/// channel, of which a gateway hears by interest, is not brought to it. `CHANNELS` as in
/// [`EventHalf`](crate::EventHalf). Every call is O(`CHANNELS`).
#[derive(Clone, Debug)]
pub struct NamingService<const CHANNELS: usize> {
    configuration: Configuration,
    binding: Binding<CHANNELS>,
    /// A subject that was refused is to be unbound, too: the next request.
    refused: Option<Subject>,
}

impl<const CHANNELS: usize> NamingService<CHANNELS> {
    /// A node that asks the broker for its TxNode from now on. `noise` as in [`Configuration::new`].
    pub fn new(uid: NodeUid, noise: u64, now: Instant) -> Self {
        Self::of(Configuration::new(now, uid, noise, &ConfigurationTiming::DEFAULT), noise)
    }

    /// A node with this TxNode, which it claims.
    pub fn fixed(uid: NodeUid, tx_node: TxNode, noise: u64, now: Instant) -> Self {
        Self::of(Configuration::fixed(now, uid, tx_node, noise, &ConfigurationTiming::DEFAULT), noise)
    }

    const fn of(configuration: Configuration, noise: u64) -> Self {
        let binding = Binding::new(configuration.uid().get() ^ noise, &BindingTiming::DEFAULT);
        Self { configuration, binding, refused: None }
    }

    /// The node's TxNode, if it has one.
    pub const fn tx_node(&self) -> Option<TxNode> {
        self.configuration.tx_node()
    }

    /// The node's TxNode, or the one that it claims.
    pub fn claimed(&self) -> Option<TxNode> {
        self.configuration.claimed()
    }

    /// The etag of a subject, if it is known.
    pub fn etag_of(&self, subject: Subject) -> Option<Etag> {
        self.binding.etag_of(subject)
    }

    fn set_tx_node(&mut self, tx_node: Option<TxNode>) -> Request {
        self.binding.set_tx_node(tx_node);
        Request::TxNode(tx_node)
    }

    fn on_configuration(&mut self, event: ConfigurationEvent) -> Request {
        match event {
            ConfigurationEvent::Configured(tx_node) => self.set_tx_node(Some(tx_node)),
            ConfigurationEvent::Lost(_) => self.set_tx_node(None),
            ConfigurationEvent::Conflict { .. } => Request::Exception(None, ExceptionKind::DuplicateTxNode),
            ConfigurationEvent::Refused => Request::Exception(None, ExceptionKind::ConfigurationRefused),
        }
    }

    fn on_binding(&mut self, event: BindingEvent) -> Request {
        match event {
            BindingEvent::Bound { subject, etag } | BindingEvent::Rebound { subject, new: etag, .. } => {
                Request::Bound(subject, etag)
            }
            BindingEvent::Withdrawn { subject, .. } => Request::Unbound(subject),
            BindingEvent::Refused { subject } => {
                self.refused = Some(subject);
                Request::Exception(Some(subject), ExceptionKind::BindingRefused)
            }
            BindingEvent::Contradicted { subject, .. } => {
                Request::Exception(Some(subject), ExceptionKind::BindingRefused)
            }
        }
    }
}

impl<const CHANNELS: usize> Services for NamingService<CHANNELS> {
    const GIVES_TX_NODE: bool = true;
    const SENDS_URGENT: bool = false;
    const HEARS_CLOCK: bool = false;

    fn on_frame(&mut self, frame: &Frame, received_at: Instant) {
        self.configuration.on_frame(frame, received_at);
        self.binding.on_frame(frame, received_at);
    }

    fn on_sent(&mut self, _: &Frame, _: Instant) {}

    fn declare(&mut self, declaration: &Declaration) -> Result<(), TooMany> {
        let &Declaration { subject, etag, publishes, subscribes, .. } = declaration;
        match etag {
            _ if !publishes && !subscribes => {
                self.binding.forget(subject);
                Ok(())
            }
            Some(etag) => self.binding.fix(subject, etag).map_err(|_| TooMany),
            None => self.binding.bind(subject).map_err(|_| TooMany),
        }
    }

    fn poll(&mut self, now: Instant, _: &NodeView) -> Option<Request> {
        if let Some(subject) = self.refused.take() {
            return Some(Request::Unbound(subject));
        }
        if let Some(output) = self.configuration.poll(now) {
            return Some(match output {
                Output::Send(frame) => Request::Send(frame),
                Output::Withdraw(frame) => Request::Withdraw(frame),
                Output::Event(event) => self.on_configuration(event),
            });
        }
        Some(match self.binding.poll(now)? {
            Output::Send(frame) => Request::Send(frame),
            Output::Withdraw(frame) => Request::Withdraw(frame),
            Output::Event(event) => self.on_binding(event),
        })
    }

    fn global_clock(&self) -> GlobalClock {
        GlobalClock::unsynchronised()
    }

    fn next_wakeup(&self) -> Instant {
        self.configuration.next_wakeup().min(self.binding.next_wakeup())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{Answer, Class, LayoutHash, SupplyEtag};
    use crate::time::Duration;
    use std::vec::Vec;

    const UID: NodeUid = NodeUid::new(0xC0FF_EE00).unwrap();
    const ME: TxNode = TxNode::new(9).unwrap();
    const HEAT: Subject = Subject::new(0xAB).unwrap();

    fn declaration(etag: Option<Etag>, subscribes: bool) -> Declaration {
        let (class, layout) = (Class::NonRealTime, LayoutHash::UNSTATED);
        Declaration { subject: HEAT, etag, class, layout, offer: None, publishes: false, subscribes }
    }

    fn all(services: &mut NamingService<2>, now: Instant) -> Vec<Request> {
        core::iter::from_fn(|| services.poll(now, &NodeView::default())).collect()
    }

    /// The node, once it has its TxNode and has asked for an etag.
    fn asking() -> (NamingService<2>, Instant) {
        let mut services = NamingService::fixed(UID, ME, 0, Instant::EPOCH);
        services.declare(&declaration(None, true)).unwrap();
        let mut now = Instant::EPOCH;
        let mut requests = Vec::new();
        while services.tx_node().is_none() {
            now = services.next_wakeup();
            assert!(now < Instant::EPOCH + Duration::from_secs(1), "it does not claim its TxNode");
            requests = all(&mut services, now);
        }
        assert_eq!(requests.first(), Some(&Request::TxNode(Some(ME))));
        let asked =
            |request: &Request| matches!(request, Request::Send(frame) if frame.id.etag() == Etag::GET_ETAG);
        assert!(requests.iter().any(asked), "{requests:?}");
        (services, now)
    }

    fn answered(answer: Answer) -> Vec<Request> {
        let (mut services, now) = asking();
        for half in SupplyEtag::pair(TxNode::BROKER, ME, HEAT, answer) {
            services.on_frame(&half.encode(), now);
        }
        all(&mut services, now)
    }

    #[test]
    fn a_node_gets_its_names_and_binds_its_channel() {
        let etag = Etag::BOUND_LAST;
        assert_eq!(answered(Answer::Bound(etag)), [Request::Bound(HEAT, etag)]);
    }

    #[test]
    fn a_refusal_is_told_and_leaves_the_channel_without_etag() {
        let refused = Request::Exception(Some(HEAT), ExceptionKind::BindingRefused);
        assert_eq!(answered(Answer::Refused), [refused, Request::Unbound(HEAT)]);
    }

    #[test]
    fn nobody_is_asked_for_an_etag_that_is_fixed_or_no_longer_used() {
        let (mut services, now) = asking();
        services.declare(&declaration(None, false)).unwrap();
        services.declare(&declaration(Some(Etag::BOUND_FIRST), true)).unwrap();
        assert_eq!(services.etag_of(HEAT), Some(Etag::BOUND_FIRST));
        let later = now + Duration::from_secs(10);
        let sends = |request: &Request| matches!(request, Request::Send(_));
        assert!(!all(&mut services, later).iter().any(sends));
    }
}
