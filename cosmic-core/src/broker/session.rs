//! One search for a UID, seen from the broker: sixteen stages.

use crate::can::Frame;
use crate::protocol::{ConfigurationReply, ConfigurationRequest, Prefix, Stage};
use crate::time::{Duration, Instant};

/// The state of the search.
#[derive(Clone, Debug)]
pub(super) struct Session {
    /// The nibbles heard so far, at their places.
    bits: u64,
    /// The stage whose nibble comes next.
    expected: Stage,
    last_heard_at: Instant,
    /// The last request that was answered, and its answer: sent again if it is asked again.
    answered: Option<(ConfigurationRequest, Frame)>,
}

/// What a request leads to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Turn {
    /// Nothing: it is of another stage, from a node that has lost or from a search before this.
    Ignored,
    /// Send this.
    Reply(Frame),
    /// These are the 64 bits of a UID; the reply is left to the caller, who calls [`Session::conclude`].
    Whole(u64),
}

impl Session {
    /// How long an answer may be under way until the same question is taken for a repeated one. Before
    /// that it comes from another node that has the same nibbles and has not heard the answer yet.
    const REPEAT_AFTER: Duration = Duration::from_millis(10);

    pub(super) const fn new() -> Self {
        Self { bits: 0, expected: Stage::FIRST, last_heard_at: Instant::EPOCH, answered: None }
    }

    /// Returns whether no search is going on.
    pub(super) fn is_idle(&self) -> bool {
        self.expected == Stage::FIRST
    }

    /// Constant time.
    pub(super) fn on_request(&mut self, now: Instant, request: ConfigurationRequest) -> Turn {
        if request.stage() != self.expected {
            return self.repeat(now, request);
        }
        self.last_heard_at = now;
        self.bits |= u64::from(request.nibble()) << request.stage().shift();
        let Some(prefix) = Prefix::new(self.bits, request.stage()) else {
            return Turn::Whole(self.bits);
        };
        self.expected = request.stage().next().unwrap_or(Stage::FIRST);
        let reply = ConfigurationReply::Prefix(prefix).encode();
        self.answered = Some((request, reply));
        Turn::Reply(reply)
    }

    /// Ends the search, with the reply to the request of the last stage.
    pub(super) fn conclude(&mut self, request: ConfigurationRequest, reply: Option<Frame>) {
        let answered = reply.map(|reply| (request, reply));
        *self = Self { answered, last_heard_at: self.last_heard_at, ..Self::new() };
    }

    /// Gives the search up if nobody went on with it for `patience`.
    pub(super) fn has_expired(&mut self, now: Instant, patience: Duration) -> bool {
        let expired = !self.is_idle() && now >= self.last_heard_at + patience;
        if expired {
            *self = Self::new();
        }
        expired
    }

    /// When [`Session::has_expired`] has to be asked.
    pub(super) fn expires_at(&self, patience: Duration) -> Option<Instant> {
        (!self.is_idle()).then_some(self.last_heard_at + patience)
    }

    fn repeat(&mut self, now: Instant, request: ConfigurationRequest) -> Turn {
        match self.answered {
            Some((answered, reply))
                if answered == request && now >= self.last_heard_at + Self::REPEAT_AFTER =>
            {
                self.last_heard_at = now;
                Turn::Reply(reply)
            }
            _ => Turn::Ignored,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uid::NodeUid;

    const UID: NodeUid = NodeUid::new(0xFEDC_BA98_7654_3210).unwrap();

    fn at(milliseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(milliseconds))
    }

    fn ask(session: &mut Session, now: Instant, stage: u8) -> Turn {
        session.on_request(now, ConfigurationRequest::new(UID, Stage::new(stage).unwrap()))
    }

    #[test]
    fn sixteen_stages_make_a_uid() {
        let mut session = Session::new();
        for stage in (1..=15).rev() {
            let prefix = Prefix::new(UID.get(), Stage::new(stage).unwrap()).unwrap();
            assert_eq!(
                ask(&mut session, at(0), stage),
                Turn::Reply(ConfigurationReply::Prefix(prefix).encode())
            );
        }
        assert_eq!(ask(&mut session, at(0), 0), Turn::Whole(UID.get()));
    }

    #[test]
    fn a_lost_reply_is_repeated_and_a_late_request_ignored() {
        let mut session = Session::new();
        let first = ask(&mut session, at(0), 15);
        assert_eq!(ask(&mut session, at(1), 15), Turn::Ignored, "another node with this nibble");
        assert_eq!(ask(&mut session, at(20), 15), first);
        assert_eq!(ask(&mut session, at(20), 13), Turn::Ignored);
        assert!(matches!(ask(&mut session, at(21), 14), Turn::Reply(_)));
    }

    #[test]
    fn a_search_that_nobody_continues_ends() {
        let mut session = Session::new();
        let patience = Duration::from_millis(100);
        assert!(!session.has_expired(at(1000), patience));
        let _ = ask(&mut session, at(1000), 15);
        assert_eq!(session.expires_at(patience), Some(at(1100)));
        assert!(!session.has_expired(at(1099), patience));
        assert!(session.has_expired(at(1100), patience));
        assert!(session.is_idle());
    }
}
