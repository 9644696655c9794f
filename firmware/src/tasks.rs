//! What the tasks of every application do. [The crate](crate) says which runs at which priority.

use boards::bxcan_rx::{FIFO_DEPTH, OtherFrames, UrgentFrames};
use boards::bxcan_tx::{HardMailbox, TxOutcomes};
use boards::clock::{self, Mono};
use boards::stm32f4::MeasuringPoint;
use cosmic_core::can::{Command, Mailbox};
use cosmic_core::event_half::{HardAccess as _, Input, outcome, receive};
use cosmic_core::network::hard::Step;
use rtic::Mutex;
use rtic_monotonics::Timebase as _;
use rtic_sync::signal::SignalReader;

use crate::inbox::{Inbox, Item, Sender};
use crate::node::{Calendar, Node};
use crate::shared::Locked;

/// What the calendar task owns.
pub struct CalendarParts {
    /// The time-triggered half.
    pub dispatcher: Calendar,
    /// Its mailbox.
    pub mailbox: HardMailbox,
    /// High while the task runs.
    pub running: MeasuringPoint<12>,
    /// Changes when the event layer is told of an event that has become visible, or of an omission.
    pub notified: MeasuringPoint<14>,
    /// Towards the event layer.
    pub notices: Sender,
    /// Wakes the task when slots were attached or detached.
    pub wakes: SignalReader<'static, ()>,
}

/// What `CAN1_RX0` owns.
pub struct UrgentParts {
    /// FIFO 0.
    pub fifo: UrgentFrames,
    /// Towards the event layer, for what is not hard real-time.
    pub frames: Sender,
}

/// What `CAN1_RX1` owns.
pub struct OtherParts {
    /// FIFO 1.
    pub fifo: OtherFrames,
    /// Towards the event layer.
    pub frames: Sender,
}

/// What `CAN1_TX` owns.
pub struct OutcomeParts {
    /// Of all mailboxes.
    pub outcomes: TxOutcomes,
    /// Towards the event layer.
    pub left: Sender,
}

/// The calendar dispatcher and the TTCH: from one instant of the calendar to the next.
pub async fn calendar(parts: &mut CalendarParts) -> ! {
    loop {
        parts.running.set();
        let next = loop {
            let now = clock::now();
            match Locked.with(|buffers| parts.dispatcher.poll(now, buffers)) {
                Step::Command(Command::Load(_, frame)) => parts.mailbox.load(&frame),
                Step::Command(Command::Withdraw(_)) => parts.mailbox.withdraw(),
                Step::Notify(buffer) => {
                    parts.notified.toggle();
                    parts.notices.send(Input::Notice(buffer), now);
                }
                Step::Continue => {}
                Step::SleepUntil(instant) => break instant,
            }
        };
        parts.running.clear();
        // Either will do: the instant has come, or there is another slot.
        let _ = Mono::timeout_at(clock::timer(next), parts.wakes.wait()).await;
    }
}

/// Frames of FIFO 0: hard real-time frames go into their buffers, others to the event layer.
pub fn receive_urgent(parts: &mut UrgentParts) {
    for _ in 0..FIFO_DEPTH {
        // Before anything else, since this is the time-stamp.
        let received_at = clock::now();
        let Some(frame) = parts.fifo.read() else { break };
        if let Some(input) = receive(&frame, received_at, &mut Locked) {
            parts.frames.send(input, received_at);
        }
    }
    parts.frames.count_lost(parts.fifo.take_losses().overruns);
}

/// Frames of FIFO 1: all go to the event layer.
pub fn receive_other(parts: &mut OtherParts) {
    for _ in 0..FIFO_DEPTH {
        let received_at = clock::now();
        let Some(frame) = parts.fifo.read() else { break };
        if let Some(input) = receive(&frame, received_at, &mut Locked) {
            parts.frames.send(input, received_at);
        }
    }
    parts.frames.count_lost(parts.fifo.take_losses().overruns);
}

/// What became of loaded frames.
pub fn report_outcomes(parts: &mut OutcomeParts) {
    let at = clock::now();
    for _ in Mailbox::ALL {
        let Some((mailbox, what)) = parts.outcomes.take() else { return };
        if let Some(input) = outcome(mailbox, what, at, &mut Locked) {
            parts.left.send(input, at);
        }
    }
}

/// The event-triggered half: takes in what has arrived, and keeps the mailboxes filled.
pub async fn etch(inbox: &mut Inbox, mut node: impl Mutex<T = Node>) -> ! {
    loop {
        // One lock for each item, so that the application waits for one only.
        while let Some(item) = inbox.take() {
            node.lock(|node| node.take_in(&item));
        }
        let lost = inbox.take_lost();
        if lost > 0 {
            let item = Item { input: Input::Lost(lost), at: clock::now() };
            node.lock(|node| node.take_in(&item));
        }
        let next = node.lock(|node| node.attend(clock::now()));
        // Either will do: the instant has come, or something has arrived.
        let _ = Mono::timeout_at(clock::timer(next), inbox.wait()).await;
    }
}
