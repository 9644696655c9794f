//! The places from which frames go to the link: one for each class, as a controller has mailboxes.

use cosmic_core::can::{Command, Frame, Mailbox, Outcome};

/// What stands in a place.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Place {
    Empty,
    /// It can still be withdrawn.
    Waiting(Frame),
    /// The link has it. `withdraw`: it should not be sent any more. `told`: the link has heard that.
    Handed {
        frame: Frame,
        withdraw: bool,
        told: bool,
    },
}

/// What a link is to do next.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Handover {
    /// Send this frame, and say when that is done.
    Send(Mailbox, Frame),
    /// Do not send the frame of this mailbox any more, if that is still possible, and say what became of it.
    Withdraw(Mailbox),
}

/// One place for each class.
#[derive(Debug)]
pub(crate) struct Places([Place; 3]);

impl Places {
    pub(crate) const fn new() -> Self {
        Self([Place::Empty; 3])
    }

    /// Carries out a command of the core. Returns the outcome, if it is known at once.
    pub(crate) fn execute(&mut self, command: &Command) -> Option<(Mailbox, Outcome)> {
        match *command {
            Command::Load(mailbox, frame) => {
                *self.place(mailbox) = Place::Waiting(frame);
                None
            }
            Command::Withdraw(mailbox) => match self.place(mailbox) {
                Place::Empty => None,
                place @ Place::Waiting(_) => {
                    *place = Place::Empty;
                    Some((mailbox, Outcome::Withdrawn))
                }
                Place::Handed { withdraw, .. } => {
                    *withdraw = true;
                    None
                }
            },
        }
    }

    /// Returns whether there is something for the link to do; a withdrawal, only for one that can withdraw.
    pub(crate) fn any_due(&self) -> bool {
        let is_due = |place: &Place| {
            matches!(place, Place::Waiting(_) | Place::Handed { withdraw: true, told: false, .. })
        };
        self.0.iter().any(is_due)
    }

    /// What the link is to do next: the most urgent frame that waits, but first a withdrawal, for a link that can.
    pub(crate) fn hand_over(&mut self, link_withdraws: bool) -> Option<Handover> {
        for mailbox in Mailbox::ALL {
            if let Place::Handed { withdraw: true, told, .. } = self.place(mailbox)
                && link_withdraws
                && !core::mem::replace(told, true)
            {
                return Some(Handover::Withdraw(mailbox));
            }
        }
        let waiting = Mailbox::ALL.into_iter().filter_map(|mailbox| match *self.place(mailbox) {
            Place::Waiting(frame) => Some((frame.id.raw(), mailbox, frame)),
            _ => None,
        });
        let (_, mailbox, frame) = waiting.min_by_key(|(id, ..)| *id)?;
        *self.place(mailbox) = Place::Handed { frame, withdraw: false, told: false };
        Some(Handover::Send(mailbox, frame))
    }

    /// The link says what became of a frame. Returns whether it had one.
    pub(crate) fn conclude(&mut self, mailbox: Mailbox) -> bool {
        let place = self.place(mailbox);
        let handed = matches!(place, Place::Handed { .. });
        if handed {
            *place = Place::Empty;
        }
        handed
    }

    /// Returns whether nothing stands in the place.
    pub(crate) fn is_empty(&mut self, mailbox: Mailbox) -> bool {
        *self.place(mailbox) == Place::Empty
    }

    /// The connection is gone, and with it whatever the link would have said. What is still wanted waits again;
    /// returns how many frames these are, and which are not wanted any more.
    pub(crate) fn disconnect(&mut self) -> (u32, Vec<Mailbox>) {
        let (mut again, mut withdrawn) = (0, Vec::new());
        for mailbox in Mailbox::ALL {
            let place = self.place(mailbox);
            match *place {
                Place::Handed { withdraw: true, .. } => {
                    *place = Place::Empty;
                    withdrawn.push(mailbox);
                }
                Place::Handed { frame, .. } => {
                    *place = Place::Waiting(frame);
                    again += 1;
                }
                Place::Empty | Place::Waiting(_) => {}
            }
        }
        (again, withdrawn)
    }

    fn place(&mut self, mailbox: Mailbox) -> &mut Place {
        &mut self.0[mailbox as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::{Etag, Id, Payload, Priority, TxNode};

    fn frame(priority: u8) -> Frame {
        Frame::new(Id::new(Priority::new(priority), TxNode::MIN, Etag::BOUND_LAST), Payload::EMPTY)
    }

    fn loaded() -> Places {
        let mut places = Places::new();
        for (mailbox, priority) in [(Mailbox::NonRealTime, 252), (Mailbox::Soft, 9)] {
            assert_eq!(places.execute(&Command::Load(mailbox, frame(priority))), None);
        }
        places
    }

    #[test]
    fn the_most_urgent_goes_first_and_each_once() {
        let mut places = loaded();
        assert_eq!(places.hand_over(false), Some(Handover::Send(Mailbox::Soft, frame(9))));
        assert_eq!(places.hand_over(false), Some(Handover::Send(Mailbox::NonRealTime, frame(252))));
        assert_eq!(places.hand_over(false), None);
        assert!(places.conclude(Mailbox::Soft));
        assert!(!places.conclude(Mailbox::Soft), "it is gone already");
    }

    #[test]
    fn what_waits_is_withdrawn_at_once_and_what_was_handed_over_by_a_link_that_can() {
        let mut places = loaded();
        let withdraw = Command::Withdraw(Mailbox::Soft);
        let withdrawn = Some((Mailbox::Soft, Outcome::Withdrawn));
        assert_eq!(places.execute(&withdraw), withdrawn);
        assert_eq!(places.execute(&withdraw), None, "empty");
        let _ = places.execute(&Command::Load(Mailbox::Soft, frame(3)));
        let _ = places.hand_over(true);
        assert_eq!(places.execute(&withdraw), None);
        assert_eq!(places.hand_over(true), Some(Handover::Withdraw(Mailbox::Soft)));
        assert!(places.any_due());
        assert_eq!(
            places.hand_over(true),
            Some(Handover::Send(Mailbox::NonRealTime, frame(252))),
            "told once"
        );
        assert!(!places.any_due());
    }

    #[test]
    fn after_a_break_what_is_wanted_waits_again() {
        let mut places = loaded();
        let _ = (places.hand_over(false), places.hand_over(false));
        let _ = places.execute(&Command::Withdraw(Mailbox::NonRealTime));
        assert_eq!(places.disconnect(), (1, vec![Mailbox::NonRealTime]));
        assert_eq!(places.hand_over(false), Some(Handover::Send(Mailbox::Soft, frame(9))));
        assert_eq!(places.hand_over(false), None);
    }
}
