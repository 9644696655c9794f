//! How much time an event has left when it leaves its segment.
//!
//! A frame has no stamp. But the priority of a soft real-time frame says what was left to its deadline when it was sent:
//! at least `(priority − 1) · Δt_p`. The event is then not older than the channel's deadline less that. Only the least
//! urgent priority, 249, says no more than that much is left; how long an event waited at its publisher before, nobody on
//! the bus can tell. The age is then taken for the longest that it can be, unless the configuration states the channel's
//! `longest-wait`: the response time from the analysis of the segment.
//!
//! A hard real-time event is as old as its calendar says, and begins its time on the far side when it is received. A non
//! real-time frame says nothing: its age on the segment is taken for its `longest-wait`, or for none.

use cosmic_core::can::Priority;
use cosmic_core::protocol::Class;
use cosmic_core::time::Duration;

use crate::config::ChannelConfig;

/// What an event has left.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Left {
    pub(crate) to_deadline: Option<Duration>,
    pub(crate) to_expiry: Option<Duration>,
}

impl Left {
    /// When its frame was sent with this priority on a segment with this Δt_p, where events of the channel have that
    /// deadline.
    pub(crate) fn of_frame(
        channel: &ChannelConfig,
        at_origin: Option<Duration>,
        priority: Priority,
        step: Duration,
    ) -> Self {
        let whole = Self { to_deadline: channel.deadline, to_expiry: channel.validity };
        let longest_wait = channel.longest_wait;
        match (channel.class, at_origin) {
            (Class::Soft, Some(deadline)) => {
                let steps = u64::from(priority.get().saturating_sub(1));
                let shown = Duration::from_ticks(steps.saturating_mul(step.as_ticks()));
                let age = Duration::from_ticks(deadline.as_ticks().saturating_sub(shown.as_ticks()));
                let age = longest_wait.map_or(age, |longest| age.min(longest));
                let left = whole.after_any(age);
                // An event may have had a deadline of its own, and then had less left than its age says. It shows where
                // the channel has one deadline everywhere.
                let is_exact = priority < Priority::SOFT_LEAST_URGENT && channel.deadline == at_origin;
                let to_deadline = left.to_deadline.map(|left| if is_exact { left.min(shown) } else { left });
                Self { to_deadline, ..left }
            }
            (Class::NonRealTime, _) => whole.after_any(longest_wait.unwrap_or(Duration::from_ticks(0))),
            _ => whole,
        }
    }

    fn after_any(self, age: Duration) -> Self {
        let less = |span: Duration| Duration::from_ticks(span.as_ticks().saturating_sub(age.as_ticks()));
        Self { to_deadline: self.to_deadline.map(less), to_expiry: self.to_expiry.map(less) }
    }

    /// What is left after a while; `None` if it may have expired.
    pub(crate) fn after(self, age: Duration) -> Option<Self> {
        if self.to_expiry.is_some_and(|left| left <= age) { None } else { Some(self.after_any(age)) }
    }

    /// Not more than an event of the channel has at its publication.
    pub(crate) fn at_most(self, channel: &ChannelConfig) -> Self {
        let less = |left: Option<Duration>, most: Option<Duration>| match (left, most) {
            (Some(left), Some(most)) => Some(left.min(most)),
            (left, most) => left.or(most),
        };
        Self {
            to_deadline: less(self.to_deadline, channel.deadline),
            to_expiry: less(self.to_expiry, channel.validity),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rules::Reach;
    use cosmic_core::Subject;
    use cosmic_core::event_layer::{EventRate, Importance};

    const STEP: Duration = Duration::from_micros(160);

    fn ms(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    fn channel(class: Class, deadline: Option<Duration>, validity: Option<Duration>) -> ChannelConfig {
        ChannelConfig {
            name: "heat".to_owned(),
            subject: Subject::new(1).unwrap(),
            class,
            deadline,
            validity,
            importance: Importance::LEAST,
            rate: EventRate::sporadic(ms(1)),
            longest_wait: None,
            longest_message: None,
            from: Reach::All,
            to: Reach::All,
            unasked: Vec::new(),
        }
    }

    #[test]
    fn the_priority_says_what_is_left() {
        let soft = channel(Class::Soft, Some(ms(16)), Some(ms(20)));
        let left = |priority| Left::of_frame(&soft, soft.deadline, Priority::new(priority), STEP);
        // A priority of 101 has at least 100 steps left.
        assert_eq!(left(101), Left { to_deadline: Some(ms(16)), to_expiry: Some(ms(20)) });
        assert_eq!(left(51), Left { to_deadline: Some(ms(8)), to_expiry: Some(ms(12)) });
        assert_eq!(left(1), Left { to_deadline: Some(ms(0)), to_expiry: Some(ms(4)) });
        assert_eq!(left(1).after(ms(4)), None);
        assert_eq!(left(51).after(ms(10)), Some(Left { to_deadline: Some(ms(0)), to_expiry: Some(ms(2)) }));
    }

    #[test]
    fn the_least_urgent_priority_says_less() {
        let soft = channel(Class::Soft, Some(ms(500)), Some(ms(1000)));
        let left = Left::of_frame(&soft, soft.deadline, Priority::SOFT_LEAST_URGENT, STEP);
        let shown = Duration::from_micros(248 * 160);
        assert_eq!(left, Left { to_deadline: Some(shown), to_expiry: Some(ms(500) + shown) });
        let soft = ChannelConfig { longest_wait: Some(ms(2)), ..soft };
        let left = Left::of_frame(&soft, soft.deadline, Priority::SOFT_LEAST_URGENT, STEP);
        assert_eq!(left, Left { to_deadline: Some(ms(498)), to_expiry: Some(ms(998)) });
    }

    #[test]
    fn an_event_with_a_deadline_of_its_own_has_what_its_priority_says() {
        let soft = channel(Class::Soft, Some(ms(16)), Some(ms(20)));
        let soft = ChannelConfig { longest_wait: Some(ms(1)), ..soft };
        let left = Left::of_frame(&soft, soft.deadline, Priority::new(11), STEP);
        assert_eq!(left, Left { to_deadline: Some(Duration::from_micros(1600)), to_expiry: Some(ms(19)) });
    }

    #[test]
    fn a_deadline_that_is_longer_across_segments_than_on_one() {
        // 10 ms on its segment, of which it waited 2; 100 ms in all.
        let soft = channel(Class::Soft, Some(ms(100)), Some(ms(200)));
        let left = Left::of_frame(&soft, Some(ms(10)), Priority::new(51), STEP);
        assert_eq!(left, Left { to_deadline: Some(ms(98)), to_expiry: Some(ms(198)) });
    }

    #[test]
    fn the_other_classes() {
        let hard = channel(Class::Hard, Some(ms(5)), Some(ms(5)));
        assert_eq!(Left::of_frame(&hard, hard.deadline, Priority::HARD, STEP).to_deadline, Some(ms(5)));
        let text = channel(Class::NonRealTime, None, None);
        let left = Left::of_frame(&text, None, Priority::LEAST, STEP);
        assert_eq!(left.after(ms(1_000_000)), Some(Left { to_deadline: None, to_expiry: None }));
        // Nobody makes it fresher than the channel is.
        let much = Left { to_deadline: Some(ms(1000)), to_expiry: None };
        let least = Left { to_deadline: Some(ms(5)), to_expiry: Some(ms(5)) };
        assert_eq!(much.at_most(&hard), least);
    }
}
