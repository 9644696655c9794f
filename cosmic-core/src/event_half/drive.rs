//! What the driver and the dispatcher call: frames, outcomes, notices, and what is to be done next.

use super::{EventHalf, HardAccess, Input, Own, PUBLISHES, SERVICES, Step};
use crate::calendar::Slot;
use crate::can::{Command, Frame, Mailbox, Outcome, Priority, TxNode};
use crate::event_layer::{Accepted, Exception, ExceptionKind, Listed, Received};
use crate::network::hard::{BufferId, HrtBuffers};
use crate::network::soft::{self, Tag, Unsent};
use crate::services::{NodeView, Request, Services};
use crate::time::Instant;

impl<
    const SLOTS: usize,
    const CHANNELS: usize,
    const SUBSCRIPTIONS: usize,
    const EVENTS: usize,
    const SOFT: usize,
    const NRT: usize,
    S: Services,
    H: HardAccess<HrtBuffers<SLOTS>>,
    D: Listed,
    const EXCEPTIONS: usize,
> EventHalf<SLOTS, CHANNELS, SUBSCRIPTIONS, EVENTS, SOFT, NRT, S, H, D, EXCEPTIONS>
{
    /// Takes in what has happened since the last call, at this instant. Returns whether something may be due now, or earlier
    /// than [`poll`](Self::poll) has said: an event that went to its subscribers, or one that was foreign, leaves that as it
    /// was.
    ///
    /// | input | work |
    /// |---|---|
    /// | [`Frame`](Input::Frame) | one map look-up, then O(1) for each subscriber of its channel, or O(EVENTS) for one who wants the earliest deadline first |
    /// | [`Outcome`](Input::Outcome) | O(log SOFT) or O(log NRT) |
    /// | the others | O(1), and as a frame for an event that has become visible |
    // In the task of the event half, where it is called once.
    #[inline(always)]
    pub fn on_input(&mut self, input: &Input, at: Instant) -> bool {
        match input {
            Input::Frame(frame) => self.on_frame(frame, at),
            Input::Notice(buffer) if SLOTS > 0 => self.on_notice(*buffer, at),
            other => self.on_other(other, at),
        }
    }

    /// Out of line, so that the way of a frame is short.
    #[inline(never)]
    fn on_other(&mut self, input: &Input, at: Instant) -> bool {
        match *input {
            // Taken by the caller.
            Input::Frame(_) | Input::Notice(_) => {}
            Input::Outcome(mailbox, outcome) => self.on_outcome(mailbox, outcome, at),
            Input::Lost(times) => self.raise_times(None, ExceptionKind::InputLost, times, at),
            Input::Overrun(times) => self.raise_times(None, ExceptionKind::ReceiveOverrun, times, at),
            Input::BusOff => self.raise(None, ExceptionKind::BusOff, at),
            Input::Errors(errors) => self.view.errors = errors,
        }
        true
    }

    /// As [`on_input`](Self::on_input) with [`Input::Frame`], for a host that has not put the frame into a queue:
    /// saves looking what it is.
    #[inline(always)]
    pub fn on_frame(&mut self, frame: &Frame, received_at: Instant) -> bool {
        let due = match self.layer.receive(frame, received_at) {
            Received::Delivered => false,
            Received::Foreign => return self.reject(frame, received_at),
            Received::Undelivered(tag) => self.deliver(tag, frame, received_at),
        };
        if self.is_mine(frame) {
            // No node hears itself: another one uses this TxNode.
            self.services.on_frame(frame, received_at);
            return true;
        }
        if S::WATCHES_EVENTS {
            self.services.on_event(frame.id, received_at);
        }
        due || S::WATCHES_EVENTS
    }

    /// As [`on_input`](Self::on_input), for a hard real-time frame at a host whose clock is not good enough for the
    /// calendar, and which therefore runs no dispatcher: the event is visible at once, not at its delivery instant.
    /// Returns whether the frame is one of the calendar; any other is left alone.
    ///
    /// Such a host hands in each event once: a frame that was repeated on the bus is its to recognise. O(slots of
    /// the calendar), and as for [`Input::Notice`].
    pub fn on_early_frame(&mut self, frame: &Frame, received_at: Instant) -> bool {
        let id = frame.id;
        let is_of = |slot: &Slot| slot.etag == id.etag() && slot.publisher == id.tx_node();
        if id.priority() != Priority::HARD || !self.calendar.slots().iter().any(is_of) {
            return false;
        }
        match self.layer.receive_hard(frame, received_at) {
            Received::Delivered => {}
            Received::Foreign => self.foreign = self.foreign.wrapping_add(1),
            Received::Undelivered(tag) => _ = self.deliver(tag, frame, received_at),
        }
        true
    }

    /// A frame has left the soft or non real-time mailbox.
    fn on_outcome(&mut self, mailbox: Mailbox, outcome: Outcome, at: Instant) {
        let departure = self.etch.on_outcome(mailbox, outcome, at);
        match departure.sent {
            Some(sent) if sent.tag == SERVICES => self.services.on_sent(&sent.frame, at),
            Some(sent) => self.layer.note_departure(sent.tag, true),
            None => {}
        }
        if let Some(exception) = departure.incident {
            self.raise_soft(&exception, at);
        }
    }

    /// Something has happened to an HRT message buffer. Returns whether something may be due.
    #[inline(never)]
    fn on_notice(&mut self, buffer: BufferId, now: Instant) -> bool {
        let (frame, exceptional) =
            self.hard.with(|buffers| (buffers.take(buffer), buffers.is_exceptional(buffer)));
        let mut due = false;
        if let Some(frame) = frame
            && let Received::Undelivered(tag) = self.layer.receive_hard(&frame, now)
        {
            // A copy, so that the frame need not be in memory otherwise.
            due = self.deliver(tag, &{ frame }, now);
        }
        if exceptional {
            self.raise_hard(buffer, now);
        }
        due || exceptional
    }

    /// Raises what has happened in the slots of a buffer.
    #[inline(never)]
    fn raise_hard(&mut self, buffer: BufferId, at: Instant) {
        let (exceptional, mismatch) =
            self.hard.with(|buffers| (buffers.take_exceptional(buffer), buffers.is_inhibited()));
        let Some((etag, after)) = exceptional else { return };
        let Some(seen) = self.seen.get_mut(buffer.index()) else { return };
        let before = core::mem::replace(seen, after);
        let subject = self.layer.subject_of(etag);
        let silence = if mismatch { ExceptionKind::CalendarMismatch } else { ExceptionKind::ClockOutOfBound };
        let kinds = [
            ExceptionKind::OmissionDegreeExceeded,
            ExceptionKind::NothingPublished,
            ExceptionKind::SlotSkipped,
            ExceptionKind::MissedEvent,
            ExceptionKind::EventOverwritten,
            ExceptionKind::ContradictoryEvent,
            silence,
        ];
        for (kind, (before, after)) in kinds.into_iter().zip(before.into_iter().zip(after)) {
            self.exceptions.raise_times(Exception { subject, kind, at }, after.wrapping_sub(before));
        }
        self.wake_exception_handler();
    }

    /// What is to be done now; at most one command a call. O(SOFT + NRT), what the services need, and O(CHANNELS)
    /// for each channel of which an event is overdue.
    pub fn poll(&mut self, now: Instant) -> Step {
        // Ends: each turn moves a channel's instant beyond now.
        while let Some((subject, missed)) = self.layer.take_overdue(now) {
            self.raise_times(Some(subject), ExceptionKind::EventOverdue, missed, now);
        }
        loop {
            while let Some(request) = self.next_request(now) {
                if let Some(command) = self.carry_out(request, now) {
                    return Step::Command(command);
                }
            }
            match self.etch.poll(now) {
                soft::EtchStep::Command(command) => return Step::Command(command),
                // What was discarded has left room for the services.
                soft::EtchStep::Incident(incident) => self.raise_soft(&incident, now),
                soft::EtchStep::SleepUntil(instant) => {
                    let due = self.services_wakeup().min(self.layer.next_overdue());
                    return Step::SleepUntil(instant.min(due));
                }
            }
        }
    }

    /// What has no room now is asked for again when a frame has left. If only the non real-time queue is
    /// full, because more urgent events of others fill the bus, the clock must go on.
    fn next_request(&mut self, now: Instant) -> Option<Request> {
        let view = NodeView { exceptions: self.exceptions.total(), ..self.view };
        if self.etch.has_room_for_services() {
            self.services.poll(now, &view)
        } else if self.etch.has_room_for_urgent() {
            self.services.poll_urgent(now, &view)
        } else {
            None
        }
    }

    fn services_wakeup(&self) -> Instant {
        if self.etch.has_room_for_services() {
            self.services.next_wakeup()
        } else if self.etch.has_room_for_urgent() {
            self.services.next_urgent_wakeup()
        } else {
            Instant::FAR_FUTURE
        }
    }

    fn carry_out(&mut self, request: Request, now: Instant) -> Option<Command> {
        let submitted = match request {
            Request::SendUrgent(frame, expires_at) => {
                self.etch.submit_urgent(now, SERVICES, frame, expires_at)
            }
            Request::Send(frame) => self.etch.queue_for_services(frame).map(|()| None),
            Request::Withdraw(frame) => {
                let [_, command] = self.etch.recall(&Unsent::Frame(SERVICES, frame));
                Ok(command)
            }
            Request::Clock => {
                if SLOTS > 0 {
                    let clock = self.services.global_clock();
                    self.hard.with(|buffers| buffers.set_clock(clock));
                }
                Ok(None)
            }
            Request::Inhibit(inhibited) => {
                if SLOTS > 0 {
                    self.hard.with(|buffers| buffers.inhibit(inhibited));
                }
                if inhibited {
                    self.raise(None, ExceptionKind::CalendarMismatch, now);
                }
                Ok(None)
            }
            Request::TxNode(tx_node) => {
                if S::GIVES_TX_NODE {
                    self.set_tx_node(tx_node, now);
                }
                Ok(None)
            }
            Request::Bound(subject, etag) => {
                if self.layer.bind(subject, etag).is_err() {
                    self.raise(Some(subject), ExceptionKind::BindingRefused, now);
                }
                let named = self.layer.route_of(etag).map(|route| self.etch.rename(route.tag, etag));
                Ok(named.flatten())
            }
            Request::Unbound(subject) => {
                self.layer.unbind(subject);
                if let Some(tag) = self.layer.tag_of(subject) {
                    // Under the old etag they would be another channel's.
                    self.etch.revoke(now, &Unsent::Of(tag));
                }
                Ok(None)
            }
            Request::Gate(subject, gate) => {
                self.layer.set_gate(subject, gate);
                Ok(None)
            }
            Request::Exception(subject, kind) => {
                self.raise(subject, kind, now);
                Ok(None)
            }
        };
        submitted.unwrap_or_else(|soft::Full| {
            self.raise(None, ExceptionKind::TransmitQueueFull, now);
            None
        })
    }

    /// The services have given the node its TxNode, or taken it. O(SOFT + NRT), O(CHANNELS), and if it was another one,
    /// O(SLOTS) for each hard real-time channel that is published.
    #[inline(never)]
    fn set_tx_node(&mut self, tx_node: Option<TxNode>, now: Instant) {
        if self.own.get() != tx_node {
            // The frames that wait bear an id that is another node's.
            self.etch.revoke(now, &Unsent::OfOthersThan(SERVICES));
            if SLOTS > 0 {
                self.revoke_hard(tx_node, now);
            }
        }
        self.own = Own::new(tx_node);
        self.layer.set_tx_node(tx_node);
    }

    /// As `revoke` of the ETCH, for the events that wait for their slot; one that is in the mailbox has until the end
    /// of its window. Slots that the calendar gives to another TxNode than the new one are given up.
    fn revoke_hard(&mut self, tx_node: Option<TxNode>, now: Instant) {
        for at in 0..CHANNELS {
            let tag = Tag(at as u8);
            let Some(buffer) = self.layer.buffer_of(tag) else { continue };
            let (waited, publisher) = self.hard.with(|buffers| buffers.recall(buffer));
            let is_other = tx_node.is_some_and(|tx_node| publisher != Some(tx_node));
            if is_other {
                self.layer.forget_buffer(tag);
                self.detach(Some(buffer), PUBLISHES);
            }
            if waited {
                self.layer.note_departure(tag, false);
            }
            if waited || is_other {
                self.raise(self.layer.subject(tag), ExceptionKind::IdentifierLost, now);
            }
        }
    }

    #[inline]
    fn is_mine(&self, frame: &Frame) -> bool {
        self.own.is(frame.id.tx_node())
    }

    #[inline]
    fn reject(&mut self, frame: &Frame, received_at: Instant) -> bool {
        if frame.id.etag().is_reserved() || self.is_mine(frame) {
            self.services.on_frame(frame, received_at);
            return true;
        }
        if S::WATCHES_EVENTS {
            self.services.on_event(frame.id, received_at);
        }
        self.foreign = self.foreign.wrapping_add(1);
        S::WATCHES_EVENTS
    }

    /// The long way: out of line, so that the short one needs fewer registers. Returns whether something may be due: an
    /// exception, or the next event is awaited earlier.
    #[inline(never)]
    fn deliver(&mut self, tag: Tag, frame: &Frame, received_at: Instant) -> bool {
        let awaited = self.layer.next_overdue();
        let accepted = self.layer.deliver(tag, frame, received_at);
        if accepted == Accepted::Delivered {
            return self.layer.next_overdue() < awaited;
        }
        self.note(accepted, received_at);
        true
    }
}
