//! The binding client: from subjects to the etags of their channels.
//!
//! One subject is asked for at a time; the others wait their turn. An answer counts no matter who asked,
//! because a subject has one etag on the whole segment. The broker may bind a subject anew, when two
//! parts of a bus that was cut come together again; then the node is told both etags. If it binds another
//! subject to an etag of this node, the node drops the etag at once and asks for a new one. An etag that is
//! fixed is not given up, whoever says what; the node is told.

use crate::can::{Etag, Frame, TxNode};
use crate::jitter::{Jitter, doubled};
use crate::protocol::{Answer, GetEtag, Half, Output, Probe, SupplyEtag};
use crate::time::{Duration, Instant};
use crate::uid::Subject;

/// The spans of the binding client.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BindingTiming {
    /// How long an answer of the broker may take; doubled by each failure, up to 32 times.
    pub reply: Duration,
    /// How long a node waits after a refusal until it asks again.
    pub refused: Duration,
    /// Between two answers to probes, at least; each tells all bindings.
    pub between_claims: Duration,
}

impl BindingTiming {
    /// For a segment of 125 kbit/s and faster.
    pub const DEFAULT: Self = Self {
        reply: Duration::from_millis(30),
        refused: Duration::from_secs(2),
        between_claims: Duration::from_millis(200),
    };
}

/// What the node is told.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum BindingEvent {
    /// The channel of this subject has this etag.
    Bound {
        /// The subject.
        subject: Subject,
        /// Its etag.
        etag: Etag,
    },
    /// The channel has a new etag; the old one may belong to another subject.
    Rebound {
        /// The subject.
        subject: Subject,
        /// Its etag until now.
        old: Etag,
        /// Its etag from now on.
        new: Etag,
    },
    /// The etag belongs to another subject; the node asks for another one.
    Withdrawn {
        /// The subject.
        subject: Subject,
        /// Its etag until now.
        old: Etag,
    },
    /// The broker has no etag left; if the subject had one, it belongs to another subject now. The node
    /// asks again after [`BindingTiming::refused`].
    Refused {
        /// The subject.
        subject: Subject,
    },
    /// The etag of this subject is fixed, and stays; but the broker gives the subject another one, or the etag
    /// to another subject. Told once in [`BindingTiming::refused`] at most.
    Contradicted {
        /// The subject.
        subject: Subject,
        /// Its etag.
        etag: Etag,
    },
}

/// There is no room for another subject.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BindingFull;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    Wanted,
    Refused,
    Bound(Etag),
    /// By the application.
    Fixed(Etag),
}

impl State {
    const fn etag(self) -> Option<Etag> {
        match self {
            Self::Bound(etag) | Self::Fixed(etag) => Some(etag),
            Self::Wanted | Self::Refused => None,
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    subject: Subject,
    state: State,
    /// After a refusal it is not asked for again before then; that a fixed etag is contradicted is not told again.
    quiet_until: Instant,
    untold: Option<Untold>,
}

/// What the node has not been told yet. The etag that it has is in its state.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Untold {
    Bound,
    Rebound { old: Etag },
    Withdrawn { old: Etag },
    Refused,
    Contradicted,
}

/// The request that is out.
#[derive(Clone, Copy, Debug)]
struct Asked {
    request: GetEtag,
    until: Instant,
    /// Nobody has fetched it yet.
    is_unsent: bool,
}

/// The binding client of one node, for up to `N` subjects; its contract is that of [`crate::client`].
///
/// Every call takes O(`N`).
#[derive(Clone, Debug)]
pub struct Binding<const N: usize> {
    entries: [Option<Entry>; N],
    tx_node: Option<TxNode>,
    timing: &'static BindingTiming,
    jitter: Jitter,
    /// The broker's two halves of an answer follow each other: of one the second is still to come.
    first_half: Option<SupplyEtag>,
    asked: Option<Asked>,
    /// The entry whose turn is next.
    turn: usize,
    failures: u8,
    void: Option<GetEtag>,
    /// A probe is to be answered, but not before `claim_at`.
    probed: bool,
    claim_at: Instant,
    /// The entry whose binding is claimed next, after a probe.
    claim: Option<usize>,
    /// The etag of the one before it, if its second half is still to be sent.
    half_claimed: Option<Etag>,
}

impl<const N: usize> Binding<N> {
    /// A client that knows no subject yet. It is silent until it has a TxNode. `noise` as in
    /// [`Configuration::new`](super::Configuration::new).
    pub const fn new(noise: u64, timing: &'static BindingTiming) -> Self {
        const { assert!(N > 0, "room for at least one subject") };
        Self {
            entries: [None; N],
            tx_node: None,
            timing,
            jitter: Jitter::new(noise),
            first_half: None,
            asked: None,
            turn: 0,
            failures: 0,
            void: None,
            probed: false,
            claim_at: Instant::EPOCH,
            claim: None,
            half_claimed: None,
        }
    }

    /// The node has this TxNode from now on, or none.
    pub fn set_tx_node(&mut self, tx_node: Option<TxNode>) {
        if self.tx_node != tx_node {
            self.tx_node = tx_node;
            self.end_request();
            (self.probed, self.claim, self.half_claimed) = (false, None, None);
        }
    }

    /// Asks for the etag of `subject`; the answer comes as an event, also if it is known already.
    ///
    /// # Errors
    /// When `N` other subjects are in use.
    pub fn bind(&mut self, subject: Subject) -> Result<(), BindingFull> {
        let entry = self.entry(subject)?;
        if entry.state.etag().is_some() {
            entry.untold = Some(Untold::Bound);
        }
        Ok(())
    }

    /// The etag of `subject` was learned before; nobody is asked.
    ///
    /// # Errors
    /// When `N` other subjects are in use.
    pub fn assume(&mut self, subject: Subject, etag: Etag) -> Result<(), BindingFull> {
        self.entry(subject)?.state = State::Bound(etag);
        Ok(())
    }

    /// The etag of `subject` is fixed: nobody is asked, and nobody changes it.
    ///
    /// # Errors
    /// When `N` other subjects are in use.
    pub fn fix(&mut self, subject: Subject, etag: Etag) -> Result<(), BindingFull> {
        let entry = self.entry(subject)?;
        (entry.state, entry.quiet_until) = (State::Fixed(etag), Instant::EPOCH);
        Ok(())
    }

    /// The node no longer uses `subject`.
    pub fn forget(&mut self, subject: Subject) {
        if self.asked.is_some_and(|asked| asked.request.subject == subject) {
            self.end_request();
        }
        for place in &mut self.entries {
            if place.is_some_and(|entry| entry.subject == subject) {
                *place = None;
            }
        }
    }

    /// The etag of `subject`, if it is known.
    pub fn etag_of(&self, subject: Subject) -> Option<Etag> {
        self.entries.iter().flatten().find(|entry| entry.subject == subject)?.state.etag()
    }

    /// Takes a received frame.
    // Out of line, as `poll` is, a field is reached by its distance from here: instructions of two bytes, not four.
    #[inline(never)]
    pub fn on_frame(&mut self, frame: &Frame, now: Instant) {
        match frame.id.etag() {
            Etag::SUPPLY_ETAG => {
                // Other nodes' claims are for the broker.
                if let Some(half) = SupplyEtag::decode(frame).filter(|half| !half.is_claim()) {
                    self.on_half(now, half);
                }
            }
            Etag::PROBE if Probe::decode(frame).is_some() && self.tx_node.is_some() => self.probed = true,
            _ => {}
        }
    }

    /// What is to be done now; call until it returns `None`.
    #[inline(never)]
    pub fn poll(&mut self, now: Instant) -> Option<Output<BindingEvent>> {
        if self.asked.is_some_and(|asked| now >= asked.until) {
            self.failures = self.failures.saturating_add(1);
            self.end_request();
        }
        if let Some(request) = self.void.take() {
            return Some(Output::Withdraw(request.encode()));
        }
        if let Some(event) = self.next_event() {
            return Some(Output::Event(event));
        }
        let tx_node = self.tx_node?;
        if self.asked.is_none() {
            self.ask_next(now, tx_node);
        }
        if let Some(asked) = &mut self.asked
            && core::mem::take(&mut asked.is_unsent)
        {
            return Some(Output::Send(asked.request.encode()));
        }
        self.next_claim(now, tx_node).map(Output::Send)
    }

    /// When `poll` must be called even if no frame arrives.
    pub fn next_wakeup(&self) -> Instant {
        if self.tx_node.is_none() {
            return Instant::FAR_FUTURE; // nothing can be asked
        }
        let claim = if self.probed { self.claim_at } else { Instant::FAR_FUTURE };
        if let Some(asked) = &self.asked {
            return claim.min(asked.until);
        }
        let refused = self.entries.iter().flatten().filter(|entry| entry.state == State::Refused);
        refused.map(|entry| entry.quiet_until).fold(claim, Instant::min)
    }

    /// An etag is withdrawn from its old subject before the new one is told of it.
    fn next_event(&mut self) -> Option<BindingEvent> {
        let withdrawn = |entry: &Entry| matches!(entry.untold, Some(Untold::Withdrawn { .. }));
        let any = self.entries.iter().flatten().any(withdrawn);
        let is_next = |entry: &&mut Entry| if any { withdrawn(entry) } else { entry.untold.is_some() };
        self.entries.iter_mut().flatten().find(is_next)?.tell()
    }

    fn entry(&mut self, subject: Subject) -> Result<&mut Entry, BindingFull> {
        let known = self.entries.iter().position(|place| place.is_some_and(|entry| entry.subject == subject));
        let at = known.or_else(|| self.entries.iter().position(Option::is_none)).ok_or(BindingFull)?;
        let place = self.entries.get_mut(at).ok_or(BindingFull)?;
        Ok(place.get_or_insert(Entry {
            subject,
            state: State::Wanted,
            quiet_until: Instant::EPOCH,
            untold: None,
        }))
    }

    fn on_half(&mut self, now: Instant, half: SupplyEtag) {
        if half.half() == Half::First {
            self.first_half = Some(half);
        } else if let Some(subject) = self.first_half.and_then(|first| first.joined(&half)) {
            self.first_half = None;
            self.on_supply(now, subject, half.requester(), half.answer());
        }
    }

    fn on_supply(&mut self, now: Instant, subject: Subject, requester: TxNode, answer: Answer) {
        if self.asked.is_some_and(|asked| asked.request.subject == subject) {
            self.failures = 0;
            if Some(requester) == self.tx_node {
                self.asked = None;
            } else {
                self.end_request(); // answered already, before ours was sent
            }
        }
        let tell_again_at = now + self.timing.refused;
        if let Answer::Bound(etag) = answer {
            for entry in self.entries.iter_mut().flatten() {
                entry.check_fixed(subject, etag, now, tell_again_at);
                if entry.subject != subject {
                    entry.lose(etag);
                }
            }
        }
        let until = now + self.jitter.around(self.timing.refused);
        if let Some(entry) = self.entries.iter_mut().flatten().find(|entry| entry.subject == subject) {
            entry.take(answer, until);
        }
    }

    #[expect(clippy::arithmetic_side_effects, reason = "positions below `N`, which is not zero")]
    fn ask_next(&mut self, now: Instant, tx_node: TxNode) {
        let is_due = |at: &usize| {
            let entry = self.entries.get(*at).and_then(Option::as_ref);
            entry.is_some_and(|entry| match entry.state {
                State::Wanted => true,
                State::Refused => now >= entry.quiet_until,
                State::Bound(_) | State::Fixed(_) => false,
            })
        };
        let Some(at) = (0..N).map(|step| (self.turn + step) % N).find(is_due) else { return };
        let Some(Some(entry)) = self.entries.get(at) else { return };
        let subject = entry.subject;
        self.turn = (at + 1) % N;
        let request = GetEtag { requester: tx_node, subject };
        // Of many nodes that got no answer not all ask again at once.
        let patience = doubled(self.timing.reply, self.failures.min(5));
        let patience = if self.failures == 0 { patience } else { self.jitter.around(patience) };
        self.asked = Some(Asked { request, until: now + patience, is_unsent: true });
    }

    /// The request that is out, if any, has become void.
    fn end_request(&mut self) {
        if let Some(asked) = self.asked.take()
            && !asked.is_unsent
        {
            self.void = Some(asked.request);
        }
    }

    /// The next frame of an answer to a probe.
    #[expect(clippy::arithmetic_side_effects, reason = "a position below `N`")]
    fn next_claim(&mut self, now: Instant, tx_node: TxNode) -> Option<Frame> {
        // If it has been given up in between, what follows it is another one.
        if let Some(etag) = self.half_claimed.take()
            && let Some(claimed) = self.claim.and_then(|next| self.bound_from(next.checked_sub(1)?))
            && claimed.etag == etag
        {
            let [_, second] = claimed.halves(tx_node);
            return Some(second.encode());
        }
        // Twice at most: the end of one answer, and the begin of the next.
        loop {
            if self.claim.is_none() {
                if !self.probed || now < self.claim_at {
                    return None;
                }
                (self.probed, self.claim) = (false, Some(0));
                self.claim_at = now + self.timing.between_claims;
            }
            let from = self.claim.take().unwrap_or(0);
            if let Some(bound) = self.bound_from(from) {
                (self.claim, self.half_claimed) = (Some(bound.at + 1), Some(bound.etag));
                let [first, _] = bound.halves(tx_node);
                return Some(first.encode());
            }
        }
    }

    /// The first entry from this place on that has an etag of a broker.
    #[inline(never)]
    fn bound_from(&self, from: usize) -> Option<Bound> {
        self.entries.iter().enumerate().skip(from).find_map(|(at, place)| {
            let entry = place.as_ref()?;
            let etag = entry.state.etag().filter(|etag| *etag >= Etag::BOUND_FIRST)?;
            Some(Bound { at, subject: entry.subject, etag })
        })
    }
}

/// A binding that this node uses.
struct Bound {
    at: usize,
    subject: Subject,
    etag: Etag,
}

impl Bound {
    /// That this node claims it.
    fn halves(&self, tx_node: TxNode) -> [SupplyEtag; 2] {
        SupplyEtag::pair(tx_node, tx_node, self.subject, Answer::Bound(self.etag))
    }
}

impl Entry {
    /// What the node is to be told.
    fn tell(&mut self) -> Option<BindingEvent> {
        let (subject, etag) = (self.subject, self.state.etag());
        Some(match self.untold.take()? {
            Untold::Bound => BindingEvent::Bound { subject, etag: etag? },
            Untold::Rebound { old } => BindingEvent::Rebound { subject, old, new: etag? },
            Untold::Withdrawn { old } => BindingEvent::Withdrawn { subject, old },
            Untold::Refused => BindingEvent::Refused { subject },
            Untold::Contradicted => BindingEvent::Contradicted { subject, etag: etag? },
        })
    }

    /// `etag` belongs to `subject`, the broker says.
    fn check_fixed(&mut self, subject: Subject, etag: Etag, now: Instant, tell_again_at: Instant) {
        if let State::Fixed(fixed) = self.state
            && (self.subject == subject) != (fixed == etag)
            && now >= self.quiet_until
        {
            self.quiet_until = tell_again_at;
            self.untold = Some(Untold::Contradicted);
        }
    }

    /// `etag` belongs to another subject.
    fn lose(&mut self, etag: Etag) {
        if self.state != State::Bound(etag) {
            return;
        }
        self.state = State::Wanted;
        self.untold = match self.untold {
            // The node knows nothing of this etag.
            Some(Untold::Bound) => None,
            Some(Untold::Rebound { old } | Untold::Withdrawn { old }) => Some(Untold::Withdrawn { old }),
            Some(Untold::Refused | Untold::Contradicted) | None => Some(Untold::Withdrawn { old: etag }),
        };
    }

    fn take(&mut self, answer: Answer, retry_at: Instant) {
        let Answer::Bound(new) = answer else {
            if !matches!(self.state, State::Fixed(_)) {
                (self.state, self.quiet_until) = (State::Refused, retry_at);
                self.untold = Some(Untold::Refused);
            }
            return;
        };
        let known = match self.state {
            State::Fixed(_) => return,
            State::Bound(old) if old == new => return,
            State::Bound(old) => Some(old),
            State::Wanted | State::Refused => None,
        };
        self.state = State::Bound(new);
        self.untold = match (self.untold, known) {
            // If the node has not even heard of the old one, the new one is the first.
            (Some(Untold::Bound), Some(_)) => Some(Untold::Bound),
            (Some(Untold::Rebound { old }), Some(_)) => Some(Untold::Rebound { old }),
            (_, Some(old)) => Some(Untold::Rebound { old }),
            // It comes back before the node was told that it was gone.
            (Some(Untold::Withdrawn { old }), None) if old == new => None,
            (Some(Untold::Withdrawn { old }), None) => Some(Untold::Rebound { old }),
            (_, None) => Some(Untold::Bound),
        };
    }
}
