//! All services together, as a node of a cluster that configures itself needs them.

mod admitting;
mod names;

use names::configuration_of;

use super::{Declaration, Hosted, News, NodeConfig, NodeView, Request, Services, Timekeeper, TooMany};
use crate::admission::AdmissionPlan;
use crate::calendar::Calendar;
use crate::can::{Etag, Frame, Id, Priority, TxNode, TxNodes};
use crate::client::{AdmissionClient, Binding, Configuration};
use crate::event_layer::{AnnounceError, ExceptionKind, Gate};
use crate::membership::{Declarations, Health, Interests, MemberEvent, Members, StatusReport};
use crate::protocol::{Class, LayoutHash, NodeState, Output, ResetCause, Side};
use crate::ring::Ring;
use crate::seal::{Contradiction, Refusals, Warden};
use crate::sync::SyncConfigError;
use crate::time::{Duration, GlobalClock, Instant};
use crate::uid::{NodeUid, Subject};

/// A channel of this node, as far as the services are concerned.
#[derive(Clone, Copy, Debug)]
struct KnownChannel {
    subject: Subject,
    etag: Option<Etag>,
    class: Class,
    layout: LayoutHash,
    publishes: bool,
    subscribes: bool,
    /// The declarations are to be brought up to date.
    changed: bool,
}

/// All services of a node: clock, configuration, binding, interest, status, and a broker if it hosts one.
///
/// `CHANNELS` as in [`EventHalf`](crate::EventHalf); `DECLARATIONS` is twice that, for both sides of each;
/// `PEERS` are the other nodes that it keeps track of, and `INTERESTS` what they want and offer. `ADMISSIONS` are the soft
/// real-time channels that it asks for because the plan does not know them. A node without `SEALS` takes no part in a
/// sealed cluster: it is silent there. One that is no `CANDIDATE` never becomes time master. `NEWS` are kept until the
/// application fetches them; of none nothing is told. An image has no code for what is zero or `false`: see
/// [`PlannedServices`] and [`FollowingServices`].
///
/// Every call is O(`CHANNELS` + `PEERS` + `INTERESTS`), and what the broker needs; but [`Services::poll`] and
/// [`Services::next_wakeup`] are O(1) while nothing is to be done, for they are called after each event of
/// the application, too.
#[derive(Clone, Debug)]
pub struct NodeServices<
    const CHANNELS: usize,
    const DECLARATIONS: usize,
    const PEERS: usize,
    const INTERESTS: usize,
    B = (),
    const ADMISSIONS: usize = CHANNELS,
    const SEALS: usize = 1,
    const CANDIDATE: bool = true,
    const NEWS: usize = 16,
> {
    clock: Timekeeper<CANDIDATE>,
    configuration: Configuration,
    binding: Binding<CHANNELS>,
    wanted: [Option<KnownChannel>; CHANNELS],
    declarations: Declarations<DECLARATIONS>,
    interests: Interests<INTERESTS>,
    members: Members<PEERS>,
    report: StatusReport,
    admission: AdmissionClient<ADMISSIONS>,
    admission_plan: Option<(&'static AdmissionPlan, NodeUid)>,
    broker: B,
    /// The plan does not keep this node from it.
    may_be_broker: bool,
    warden: [Option<Warden>; SEALS],
    requests: Ring<Request, 4>,
    news: Ring<News, NEWS>,
    news_dropped: u16,
    /// Nothing is to be done before this instant, if nothing happens. Any call from outside that changes
    /// something sets it back to the epoch.
    idle_until: Instant,
}

/// The services of a node whose channels are all planned, in a cluster that is not sealed.
pub type PlannedServices<
    const CHANNELS: usize,
    const DECLARATIONS: usize,
    const PEERS: usize,
    const INTERESTS: usize,
    const NEWS: usize = 16,
> = NodeServices<CHANNELS, DECLARATIONS, PEERS, INTERESTS, (), 0, 0, true, NEWS>;

/// As [`PlannedServices`], of a node that never becomes time master: its rank in the plan is `"never"`.
pub type FollowingServices<
    const CHANNELS: usize,
    const DECLARATIONS: usize,
    const PEERS: usize,
    const INTERESTS: usize,
    const NEWS: usize = 16,
> = NodeServices<CHANNELS, DECLARATIONS, PEERS, INTERESTS, (), 0, 0, false, NEWS>;

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
    /// Services that start now.
    ///
    /// # Errors
    /// The first setting of the clock that is refused.
    pub fn new(
        config: &NodeConfig,
        calendar: &Calendar,
        broker: B,
        now: Instant,
    ) -> Result<Self, SyncConfigError> {
        const { assert!(DECLARATIONS >= 2 * CHANNELS, "two declarations for each channel") };
        let &NodeConfig { uid, noise, status_period, .. } = config;
        let configuration = configuration_of::<SEALS>(config, calendar, now);
        let mut warden = config.seal.filter(|_| SEALS > 0).map(Warden::new);
        if let Some(warden) = warden.as_mut().filter(|warden| warden.seal().node_of(uid).is_none()) {
            // The node itself: it has no id, and the one of the broker stands in.
            let id = Id::new(Priority::CONFIGURATION, TxNode::BROKER, Etag::NODE_IDENTITY);
            warden.refuse(Contradiction::Node, id, now);
        }
        let silence = Duration::from_ticks(status_period.as_ticks().saturating_mul(7) / 2);
        Ok(Self {
            clock: Timekeeper::new(config.clock, calendar, now)?,
            configuration,
            binding: Binding::new(uid.get() ^ noise, config.binding),
            wanted: [None; CHANNELS],
            declarations: Declarations::new(config.lease),
            interests: Interests::new(),
            members: Members::new(silence),
            report: StatusReport::new(now, status_period),
            admission: AdmissionClient::new(uid.get() ^ noise, config.admission_timing),
            admission_plan: config.admission.map(|plan| (plan, uid)),
            broker,
            may_be_broker: config.seal.is_none_or(|seal| SEALS > 0 && seal.may_be_broker(uid)),
            warden: core::array::from_fn(|_| warden.take()),
            requests: Ring::new(),
            news: Ring::new(),
            news_dropped: 0,
            idle_until: Instant::EPOCH,
        })
    }

    /// The oldest piece of news that has not been fetched. `NEWS` are kept.
    pub fn take_news(&mut self) -> Option<News> {
        const { assert!(NEWS > 0, "services that keep no news have none to be fetched") };
        self.news.pop()
    }

    /// Returns whether there is a piece of news to be fetched.
    pub const fn has_news(&self) -> bool {
        !self.news.is_empty()
    }

    /// News that were lost because nobody fetched them.
    pub const fn news_dropped(&self) -> u16 {
        self.news_dropped
    }

    /// The clock.
    pub const fn clock(&self) -> &Timekeeper<CANDIDATE> {
        &self.clock
    }

    /// The node's TxNode, or the one that it claims.
    pub fn claimed(&self) -> Option<TxNode> {
        self.configuration.claimed()
    }

    /// The node's TxNode, if it has one.
    pub const fn tx_node(&self) -> Option<TxNode> {
        self.configuration.tx_node()
    }

    /// The etag of a subject, if it is known.
    pub fn etag_of(&self, subject: Subject) -> Option<Etag> {
        self.binding.etag_of(subject)
    }

    /// The other nodes that are alive.
    pub const fn members(&self) -> &Members<PEERS> {
        &self.members
    }

    /// What the other nodes want and offer.
    pub const fn interests(&self) -> &Interests<INTERESTS> {
        &self.interests
    }

    /// The broker that this node hosts.
    pub const fn broker(&self) -> &B {
        &self.broker
    }

    /// What a sealed node has refused; `None` in an open cluster.
    pub fn refusals(&self) -> Option<&Refusals> {
        self.warden().map(Warden::refusals)
    }

    /// Why the node has started, for its status.
    pub const fn set_reset_cause(&mut self, cause: ResetCause) {
        self.report.set_reset_cause(cause);
    }

    /// Gives the TxNode back to the broker, for good: the node falls silent.
    pub fn release(&mut self) {
        self.idle_until = Instant::EPOCH;
        self.configuration.release();
    }

    fn warden(&self) -> Option<&Warden> {
        self.warden.first()?.as_ref()
    }

    fn warden_mut(&mut self) -> Option<&mut Warden> {
        self.warden.first_mut()?.as_mut()
    }

    fn tell(&mut self, news: News) {
        if NEWS > 0 && !self.news.push(news) {
            self.news_dropped = self.news_dropped.saturating_add(1);
        }
    }

    /// What is wanted of the node besides, in the order of the calls; there are never more than four.
    fn ask(&mut self, request: Request) {
        let _ = self.requests.push(request);
    }

    fn poll_broker(&mut self, now: Instant) -> Option<Request> {
        loop {
            match self.broker.poll(now)? {
                Output::Send(frame) => {
                    self.binding.on_frame(&frame, now);
                    self.admission.on_frame(&frame, now);
                    return Some(Request::Send(frame));
                }
                Output::Withdraw(frame) => return Some(Request::Withdraw(frame)),
                Output::Event(event) => self.tell(News::Broker(event)),
            }
        }
    }

    /// Brings the declarations up to date with what is wanted.
    fn declare_changed(&mut self, now: Instant) {
        for place in &mut self.wanted {
            let Some(wanted) = place else { continue };
            let Some(etag) = wanted.etag.filter(|_| wanted.changed) else { continue };
            wanted.changed = false;
            let sides = [(Side::Publisher, wanted.publishes), (Side::Subscriber, wanted.subscribes)];
            for (side, declared) in sides {
                if declared {
                    let told = self.declarations.declare(now, etag, side, wanted.class, wanted.layout);
                    // While withdrawals wait to be sent there may be no room; it is tried again.
                    wanted.changed |= told.is_err();
                } else {
                    self.declarations.withdraw(now, etag, side);
                }
            }
            if !wanted.publishes && !wanted.subscribes {
                self.binding.forget(wanted.subject);
                *place = None;
            }
        }
    }

    fn set_wanted(&mut self, at: usize, channel: Option<KnownChannel>) {
        if let Some(place) = self.wanted.get_mut(at) {
            *place = channel;
        }
    }

    fn health(&self, now: Instant, view: &NodeView) -> Health {
        let bound = self.wanted.iter().flatten().all(|wanted| wanted.etag.is_some());
        let is_silent = self.clock.is_inhibited() || !self.clock.clock().is_synchronised(now);
        let state = if !bound {
            NodeState::Starting
        } else if is_silent {
            NodeState::HardInhibited
        } else {
            NodeState::Operational
        };
        Health {
            state,
            transmit_errors: view.errors.transmit,
            receive_errors: view.errors.receive,
            exceptions: view.exceptions as u16,
        }
    }

    fn poll_membership(&mut self, now: Instant, view: &NodeView) -> Option<Request> {
        if let Some(frame) = self.declarations.poll(now) {
            // As for the frames of the binding client.
            self.broker.on_frame(&frame, now);
            return Some(Request::Send(frame));
        }
        while let Some(event) = self.members.poll(now) {
            self.on_member(event, now);
        }
        while let Some(event) = self.interests.poll(now) {
            self.tell(News::Interest(event));
        }
        let health = self.health(now, view);
        self.report.poll(now, self.tx_node()?, &health).map(Request::Send)
    }

    /// When the first of the services has something to do.
    fn due_at(&self) -> Instant {
        let report = self.tx_node().map_or(Instant::FAR_FUTURE, |_| self.report.next_wakeup());
        let wakeups = [
            self.configuration.next_wakeup(),
            self.binding.next_wakeup(),
            self.admission.next_wakeup(),
            self.broker.next_wakeup(),
            self.declarations.next_wakeup(),
            self.interests.next_wakeup(),
            self.members.next_wakeup(),
            report,
        ];
        wakeups.into_iter().fold(self.clock.next_wakeup(), Instant::min)
    }

    fn on_member(&mut self, event: MemberEvent, now: Instant) {
        if let MemberEvent::Left(tx_node) | MemberEvent::Silent(tx_node) = event {
            self.interests.on_node_left(now, tx_node);
        }
        self.tell(News::Member(event));
    }
}

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
> Services for NodeServices<CHANNELS, DECLARATIONS, PEERS, INTERESTS, B, ADMISSIONS, SEALS, CANDIDATE, NEWS>
{
    const WATCHES_EVENTS: bool = B::WATCHES_EVENTS;
    const SENDS_URGENT: bool = CANDIDATE;
    const GIVES_TX_NODE: bool = true;

    fn on_event(&mut self, id: Id, received_at: Instant) {
        if self.broker.on_event(received_at, id) {
            self.idle_until = Instant::EPOCH;
        }
    }

    fn on_frame(&mut self, frame: &Frame, received_at: Instant) {
        self.idle_until = Instant::EPOCH;
        let own = self.configuration.claimed();
        if self.warden_mut().is_some_and(|warden| !warden.admits(frame, received_at, own)) {
            return;
        }
        self.configuration.on_frame(frame, received_at);
        match frame.id.etag() {
            Etag::SYNC | Etag::FOLLOW_UP => return self.clock.on_frame(frame, received_at),
            Etag::NODE_STATUS => {
                if let Some(event) = self.members.on_frame(frame, received_at) {
                    self.on_member(event, received_at);
                }
            }
            Etag::INTEREST => {
                if let Some(event) = self.interests.on_frame(frame, received_at) {
                    self.tell(News::Interest(event));
                }
            }
            _ => {}
        }
        self.binding.on_frame(frame, received_at);
        self.admission.on_frame(frame, received_at);
        self.broker.on_frame(frame, received_at);
        if let Some(mismatch) = self.declarations.on_frame(frame, received_at) {
            let of_etag = |wanted: &&KnownChannel| wanted.etag == Some(mismatch.etag);
            let subject = self.wanted.iter().flatten().find(of_etag).map(|wanted| wanted.subject);
            self.ask(Request::Exception(subject, ExceptionKind::LayoutMismatch));
        }
    }

    fn on_sent(&mut self, frame: &Frame, sent_at: Instant) {
        self.idle_until = Instant::EPOCH;
        self.clock.on_sent(frame, sent_at);
    }

    fn on_late(&mut self, subject: Subject, now: Instant) {
        if self.admission.on_late(now, subject) {
            self.idle_until = Instant::EPOCH;
        }
    }

    fn permits(&self, declaration: &Declaration) -> Result<Gate, AnnounceError> {
        if let Some(warden) = self.warden() {
            warden.seal().permits(self.configuration.claimed(), declaration)?;
        }
        self.gate_now(declaration)
    }

    fn publishers(&self, subject: Subject) -> Option<&'static TxNodes> {
        self.warden().map(|warden| warden.seal().publishers(subject))
    }

    fn declare(&mut self, declaration: &Declaration) -> Result<(), TooMany> {
        self.idle_until = Instant::EPOCH;
        let &Declaration { subject, etag, class, layout, publishes, subscribes, .. } = declaration;
        let known = |place: &Option<KnownChannel>| place.is_some_and(|wanted| wanted.subject == subject);
        let at = (self.wanted.iter().position(known))
            .or_else(|| self.wanted.iter().position(Option::is_none))
            .ok_or(TooMany)?;
        let fixed = etag;
        let etag = etag.or_else(|| self.binding.etag_of(subject));
        let wanted = publishes || subscribes;
        match etag {
            Some(etag) if wanted && fixed.is_some() => {
                self.binding.fix(subject, etag).map_err(|_| TooMany)?;
            }
            Some(etag) if wanted => self.binding.assume(subject, etag).map_err(|_| TooMany)?,
            None if wanted => self.binding.bind(subject).map_err(|_| TooMany)?,
            Some(_) => {}
            // It was never bound, so nobody was told of it.
            None => {
                self.binding.forget(subject);
                self.admission.forget(subject);
                self.set_wanted(at, None);
                return Ok(());
            }
        }
        self.ask_for(declaration, etag)?;
        let changed = KnownChannel { subject, etag, class, layout, publishes, subscribes, changed: true };
        self.set_wanted(at, Some(changed));
        Ok(())
    }

    fn poll(&mut self, now: Instant, view: &NodeView) -> Option<Request> {
        if now < self.idle_until {
            return None;
        }
        if let Some(request) = self.requests.pop() {
            return Some(request);
        }
        if let Some(kind) = self.warden_mut().and_then(Warden::take) {
            return Some(Request::Exception(None, kind));
        }
        self.declare_changed(now);
        let request = (self.poll_configuration(now))
            .or_else(|| self.clock.poll(now))
            .or_else(|| self.poll_binding(now))
            .or_else(|| self.poll_broker(now))
            .or_else(|| self.poll_membership(now, view))
            // Behind the membership, so that a withdrawal goes before.
            .or_else(|| self.poll_admission(now));
        if let Some(event) = self.clock.take_event() {
            self.tell(News::Clock(event));
        }
        if request.is_none() && self.requests.is_empty() {
            self.idle_until = self.due_at();
        }
        request
    }

    fn next_wakeup(&self) -> Instant {
        if self.idle_until > Instant::EPOCH { self.idle_until } else { self.due_at() }
    }

    fn global_clock(&self) -> GlobalClock {
        self.clock.clock()
    }

    fn poll_urgent(&mut self, now: Instant, _: &NodeView) -> Option<Request> {
        self.idle_until = Instant::EPOCH;
        let request = self.clock.poll(now);
        if let Some(event) = self.clock.take_event() {
            self.tell(News::Clock(event));
        }
        request
    }

    fn next_urgent_wakeup(&self) -> Instant {
        self.clock.next_wakeup()
    }
}
