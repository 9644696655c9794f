//! The part of a node's services that asks for channels which the plan does not know.

use super::NodeServices;
use crate::can::Etag;
use crate::client::{AdmissionClient, AdmissionEvent, AdmissionState};
use crate::event_layer::{AnnounceError, ExceptionKind, Gate};
use crate::protocol::Output;
use crate::services::{Declaration, Hosted, News, Request, TooMany};
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
    /// Where a soft real-time channel stands that this node has announced and the plan does not know; `None` for any other.
    pub fn admission_of(&self, subject: Subject) -> Option<AdmissionState> {
        self.admission.state(subject)
    }

    /// By the plan, and by what was admitted.
    pub(super) fn gate_now(&self, declaration: &Declaration) -> Result<Gate, AnnounceError> {
        match (self.gate_of(declaration)?, declaration.offer) {
            (Gate::Closed, Some(_)) if ADMISSIONS == 0 => Err(AnnounceError::NotAskable),
            (Gate::Closed, Some(offer)) => {
                AdmissionClient::<ADMISSIONS>::can_ask(&offer).map_err(|_| AnnounceError::NotAskable)?;
                let state = self.admission.state(declaration.subject);
                let held = matches!(state, Some(AdmissionState::Admitted(_)));
                Ok(if held { Gate::Open } else { Gate::Closed })
            }
            (gate, _) => Ok(gate),
        }
    }

    pub(super) fn poll_admission(&mut self, now: Instant) -> Option<Request> {
        match self.admission.poll(now)? {
            Output::Send(frame) => {
                // As for the frames of the binding client.
                self.broker.on_frame(&frame, now);
                Some(Request::Send(frame))
            }
            // It withdraws nothing: a question that comes late has a number of its own.
            Output::Withdraw(frame) => Some(Request::Withdraw(frame)),
            Output::Event(event) => {
                self.tell(News::Admission(event));
                Some(match event {
                    AdmissionEvent::Admitted(subject) => Request::Gate(subject, Gate::Open),
                    AdmissionEvent::Refused(subject, _) | AdmissionEvent::Lapsed(subject) => {
                        self.ask(Request::Exception(Some(subject), ExceptionKind::NotAdmitted));
                        Request::Gate(subject, Gate::Closed)
                    }
                })
            }
        }
    }

    /// A channel is asked for from now on, if it has to be and is published, or not any more.
    pub(super) fn ask_for(&mut self, declaration: &Declaration, etag: Option<Etag>) -> Result<(), TooMany> {
        let &Declaration { subject, offer, .. } = declaration;
        let now = Instant::EPOCH;
        match (offer, self.gate_of(declaration)) {
            (Some(offer), Ok(Gate::Closed)) => {
                self.admission.announce(now, subject, &offer).map_err(|_| TooMany)?;
                self.admission.bind(now, subject, etag);
            }
            _ => self.admission.forget(subject),
        }
        Ok(())
    }

    /// By the plan, whatever was admitted.
    fn gate_of(&self, declaration: &Declaration) -> Result<Gate, AnnounceError> {
        self.admission_plan.map_or(Ok(Gate::Open), |(plan, uid)| plan.permits(uid, declaration))
    }
}
