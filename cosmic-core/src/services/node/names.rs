//! The part of a node's services that gets its names: its TxNode, and the etags of its channels.

use super::{KnownChannel, NodeServices};
use crate::calendar::Calendar;
use crate::can::{Etag, TxNode};
use crate::client::{BindingEvent, Configuration, ConfigurationEvent, OnDuplicate};
use crate::event_layer::ExceptionKind;
use crate::protocol::{Output, Side};
use crate::services::{Hosted, News, NodeConfig, Request};
use crate::time::Instant;
use crate::uid::Subject;

impl<
    const CHANNELS: usize,
    const DECLARATIONS: usize,
    const PEERS: usize,
    const INTERESTS: usize,
    B: Hosted,
    const ADMISSIONS: usize,
    const SEALS: usize,
    const CANDIDATE: bool,
    const NEWS: usize,
> NodeServices<CHANNELS, DECLARATIONS, PEERS, INTERESTS, B, ADMISSIONS, SEALS, CANDIDATE, NEWS>
{
    fn set_tx_node(&mut self, now: Instant, tx_node: Option<TxNode>) {
        self.clock.set_tx_node(tx_node);
        self.binding.set_tx_node(tx_node);
        self.declarations.set_tx_node(now, tx_node);
        self.admission.set_tx_node(now, tx_node);
        self.broker.set_tx_node(now, tx_node.filter(|_| self.may_be_broker));
        self.ask(Request::TxNode(tx_node));
    }

    pub(super) fn poll_configuration(&mut self, now: Instant) -> Option<Request> {
        match self.configuration.poll(now)? {
            Output::Send(frame) => Some(Request::Send(frame)),
            Output::Withdraw(frame) => Some(Request::Withdraw(frame)),
            Output::Event(event) => {
                match event {
                    ConfigurationEvent::Configured(tx_node) => self.set_tx_node(now, Some(tx_node)),
                    ConfigurationEvent::Lost(_) => self.set_tx_node(now, None),
                    ConfigurationEvent::Conflict { .. } => {
                        self.ask(Request::Exception(None, ExceptionKind::DuplicateTxNode));
                    }
                    ConfigurationEvent::Refused => {
                        self.ask(Request::Exception(None, ExceptionKind::ConfigurationRefused));
                    }
                }
                self.tell(News::Configuration(event));
                self.requests.pop()
            }
        }
    }

    pub(super) fn poll_binding(&mut self, now: Instant) -> Option<Request> {
        match self.binding.poll(now)? {
            Output::Send(frame) => {
                // A node does not hear itself, so a broker that it hosts must be told.
                self.broker.on_frame(&frame, now);
                Some(Request::Send(frame))
            }
            Output::Withdraw(frame) => Some(Request::Withdraw(frame)),
            Output::Event(event) => match event {
                BindingEvent::Bound { subject, etag } => Some(self.on_bound(subject, None, etag, now)),
                BindingEvent::Rebound { subject, old, new } => {
                    Some(self.on_bound(subject, Some(old), new, now))
                }
                BindingEvent::Withdrawn { subject, .. } => Some(self.on_unbound(subject, now)),
                BindingEvent::Refused { subject } => {
                    self.ask(Request::Exception(Some(subject), ExceptionKind::BindingRefused));
                    Some(self.on_unbound(subject, now))
                }
                BindingEvent::Contradicted { subject, .. } => {
                    Some(Request::Exception(Some(subject), ExceptionKind::BindingRefused))
                }
            },
        }
    }

    fn on_bound(&mut self, subject: Subject, old: Option<Etag>, etag: Etag, now: Instant) -> Request {
        self.admission.bind(now, subject, Some(etag));
        if let Some(old) = old {
            self.withdraw_both_sides(now, old);
            // Another subject may have been given the old etag just before.
            self.wanted.iter_mut().flatten().for_each(|wanted| wanted.changed = true);
        }
        let of_subject = |wanted: &&mut KnownChannel| wanted.subject == subject;
        if let Some(wanted) = self.wanted.iter_mut().flatten().find(of_subject) {
            wanted.etag = Some(etag);
            wanted.changed = true;
        }
        Request::Bound(subject, etag)
    }

    fn withdraw_both_sides(&mut self, now: Instant, etag: Etag) {
        for side in [Side::Publisher, Side::Subscriber] {
            self.declarations.withdraw(now, etag, side);
        }
    }

    /// The subject has no etag; if it had one, that is another's now.
    fn on_unbound(&mut self, subject: Subject, now: Instant) -> Request {
        self.admission.bind(now, subject, None);
        let of_subject = |wanted: &&mut KnownChannel| wanted.subject == subject;
        let wanted = self.wanted.iter_mut().flatten().find(of_subject);
        if let Some(old) = wanted.and_then(|wanted| wanted.etag.take()) {
            self.withdraw_both_sides(now, old);
        }
        Request::Unbound(subject)
    }
}

/// How a node gets its TxNode. One that a sealed plan does not know gets none, nor does one that cannot keep to the seal.
pub(super) fn configuration_of<const SEALS: usize>(
    config: &NodeConfig,
    calendar: &Calendar,
    now: Instant,
) -> Configuration {
    let &NodeConfig { uid, noise, configuration: timing, .. } = config;
    let fixed = |tx_node| Configuration::fixed(now, uid, tx_node, noise, timing);
    match (config.seal, config.tx_node) {
        (Some(seal), _) => match if SEALS > 0 { seal.node_of(uid) } else { None } {
            Some(node) => fixed(node.tx_node).on_duplicate(OnDuplicate::Stay),
            None => {
                let mut silent = Configuration::new(now, uid, noise, timing);
                silent.release();
                silent
            }
        },
        (None, Some(tx_node)) => fixed(tx_node).on_duplicate(config.on_duplicate(tx_node, calendar)),
        (None, None) => Configuration::new(now, uid, noise, timing),
    }
}
