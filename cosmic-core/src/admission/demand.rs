//! The test itself; its reason stands in the [module above](super).

use super::reservations::{Load, Reservations, WHOLE};
use super::{Admission, Admitted, Ask, Objection, OtherChannel};
use crate::can::Payload;
use crate::event_layer::EventRate;

/// What is on the bus, without one of the admitted channels that may be asked for anew.
pub(super) struct Demand<'a> {
    reservations: &'a Reservations<'a>,
    admitted: &'a [Option<Admitted>],
    except: Option<usize>,
}

/// A soft channel, with what slips in behind its frames.
#[derive(Clone, Copy)]
struct Stream {
    load: Load,
    deadline: u64,
    /// `None`: that of the channel which is asked for.
    whose: Option<OtherChannel>,
}

/// How far the walk over the points has come at which the work with earlier deadlines grows.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Walk {
    /// `None`: it has not begun.
    next: Option<u64>,
    looked_at: u16,
}

/// What was seen at a point.
enum Seen {
    /// All that comes later is sent in time, too.
    Enough,
    Late(Objection),
    Next(u64),
}

impl<'a> Demand<'a> {
    pub(super) const fn new(
        reservations: &'a Reservations<'a>,
        admitted: &'a [Option<Admitted>],
        except: Option<usize>,
    ) -> Self {
        Self { reservations, admitted, except }
    }

    /// Goes on with the question whether this one fits besides, by so many points of time; `None`: not decided yet. See
    /// [`Admission::step`] for the work.
    pub(super) fn advance(&self, ask: &Ask, walk: &mut Walk, points: u16) -> Option<Result<(), Objection>> {
        let Some(new) = self.asked(ask, None) else { return Some(Err(Objection::Blocking)) };
        let streams = || self.streams().chain([new]);
        if walk.next.is_none() {
            let first = self.passes_at_a_glance(&new, &streams).map(|()| self.firsts(&streams).min());
            match first {
                Err(why) => return Some(Err(why)),
                Ok(None) => return Some(Ok(())),
                Ok(first) => walk.next = first,
            }
        }
        for _ in 0..points {
            let point = walk.next?;
            walk.looked_at = walk.looked_at.saturating_add(1);
            match self.look_at(point, &streams) {
                Seen::Enough => return Some(Ok(())),
                Seen::Late(why) => return Some(Err(why)),
                Seen::Next(next) => walk.next = Some(next),
            }
            if walk.looked_at >= Admission::<'_, 0>::MOST_POINTS {
                return Some(Err(Objection::Utilisation));
            }
        }
        None
    }

    /// What needs no walk.
    fn passes_at_a_glance<I: Iterator<Item = Stream>>(
        &self,
        new: &Stream,
        streams: &impl Fn() -> I,
    ) -> Result<(), Objection> {
        self.leaves_the_bus_idle_now_and_then(streams)?;
        self.leaves_room_for_less_urgent(new)?;
        self.sends_what_is_beyond_the_band(streams)
    }

    /// `None` if nothing with such a deadline or length can be sent.
    fn asked(&self, ask: &Ask, whose: Option<OtherChannel>) -> Option<Stream> {
        let len = usize::from(ask.len);
        let transmission = self.reservations.bit_rate.longest_frame(len);
        let load = Load { transmission, interval: ask.rate.enforced(), tolerance: ask.rate.tolerance() };
        let fits = len <= Payload::MAX_LEN && !ask.deadline.is_zero() && ask.deadline <= EventRate::LONGEST;
        fits.then_some(Stream {
            load: self.reservations.with_slip(load),
            deadline: ask.deadline.as_ticks(),
            whose,
        })
    }

    fn streams(&self) -> impl Iterator<Item = Stream> + '_ {
        let planned = self.reservations.soft.iter().map(|of| Stream {
            load: self.reservations.with_slip(of.load),
            deadline: of.deadline.as_ticks(),
            whose: Some(OtherChannel::Planned(of.subject)),
        });
        let others = self.admitted.iter().enumerate().filter(|(at, _)| Some(*at) != self.except);
        let admitted = others.filter_map(|(_, place)| {
            let ask = &place.as_ref()?.ask;
            self.asked(ask, Some(OtherChannel::Admitted(ask.etag)))
        });
        planned.chain(admitted)
    }

    /// All together take less than the whole bus, and so much less that it is idle soon enough for the analysis: that looks
    /// at each point at which work grows as long as the bus may be busy, or, where there are too many, at a few of them
    /// with a margin that this test has not.
    fn leaves_the_bus_idle_now_and_then<I: Iterator<Item = Stream>>(
        &self,
        streams: &impl Fn() -> I,
    ) -> Result<(), Objection> {
        let share = streams().map(|stream| stream.load.share()).fold(0, u64::saturating_add);
        let share = share.saturating_add(self.reservations.others_share());
        let idle = WHOLE.checked_sub(share).filter(|idle| *idle > 0).ok_or(Objection::Utilisation)?;
        let bit = self.reservations.bit();
        let fronts = streams().map(|stream| stream.load.line(bit)).fold(0, u64::saturating_add);
        let front = fronts
            .saturating_add(self.reservations.blocking())
            .saturating_add(self.reservations.others_line(0));
        let busy = front.saturating_mul(WHOLE).checked_div(idle).unwrap_or(u64::MAX);
        let points = streams().map(|stream| stream.load.within(busy).saturating_add(1));
        if points.fold(0, u64::saturating_add) > MOST_BUSY_POINTS {
            Err(Objection::Utilisation)
        } else {
            Ok(())
        }
    }

    fn leaves_room_for_less_urgent(&self, new: &Stream) -> Result<(), Objection> {
        let planned = self.reservations.soft.len();
        let bit = self.reservations.bit();
        for (at, guarded) in self.reservations.guarded.iter().enumerate() {
            let span = guarded.span.as_ticks().saturating_add(bit);
            let besides = self.streams().skip(planned).chain([*new]);
            let taken = besides.map(|it| it.load.times(it.load.within(span))).fold(0, u64::saturating_add);
            if taken > guarded.room.as_ticks() {
                return Err(Objection::LessUrgent(u16::try_from(at).unwrap_or(u16::MAX)));
            }
        }
        Ok(())
    }

    /// All that can be pending with deadlines in the band is sent within it.
    fn sends_what_is_beyond_the_band<I: Iterator<Item = Stream>>(
        &self,
        streams: &impl Fn() -> I,
    ) -> Result<(), Objection> {
        let horizon = self.reservations.horizon();
        let Some(beyond) = streams().find(|stream| stream.deadline >= horizon) else { return Ok(()) };
        let window = horizon.saturating_add(self.reservations.step());
        let pending = streams().map(|it| it.load.times(it.load.within(window))).fold(0, u64::saturating_add);
        let all = pending.saturating_add(self.reservations.blocking());
        if all.saturating_add(self.reservations.others(horizon)) <= horizon {
            return Ok(());
        }
        Err(beyond.whose.map_or(Objection::Late, Objection::Suffers))
    }

    /// The deadlines in the band.
    fn firsts<I: Iterator<Item = Stream>>(&self, streams: &impl Fn() -> I) -> impl Iterator<Item = u64> {
        let (step, horizon) = (self.reservations.step(), self.reservations.horizon());
        let near = streams().filter(move |stream| stream.deadline < horizon);
        near.map(move |stream| stream.deadline.saturating_add(step))
    }

    /// A point, and which is the next at which the work with earlier deadlines grows.
    fn look_at<I: Iterator<Item = Stream>>(&self, point: u64, streams: &impl Fn() -> I) -> Seen {
        let room = point.saturating_sub(self.reservations.step());
        let mut demand = self.reservations.blocking().saturating_add(self.reservations.others(room));
        let mut line = self.reservations.blocking().saturating_add(self.reservations.others_line(room));
        let mut next = self.firsts(streams).filter(|first| *first > point).min().unwrap_or(u64::MAX);
        for stream in streams() {
            demand = demand.saturating_add(stream.work(point, room, self.reservations.bit()));
            line = line.saturating_add(stream.line(point));
            next = next.min(stream.grows_after(point));
        }
        if demand > room {
            Seen::Late(self.late_at(point, streams))
        } else if line <= room {
            // The line grows no faster than time.
            Seen::Enough
        } else {
            Seen::Next(next)
        }
    }

    /// Who is late at this point: the one with the latest deadline that is not behind it.
    fn late_at<I: Iterator<Item = Stream>>(&self, point: u64, streams: &impl Fn() -> I) -> Objection {
        let room = point.saturating_sub(self.reservations.step());
        let late = streams().filter(|stream| stream.deadline <= room).max_by_key(|stream| stream.deadline);
        match late {
            Some(Stream { whose: Some(other), .. }) => Objection::Suffers(other),
            // Alone it would not fit either.
            Some(own) if self.is_too_short(&own) => Objection::Blocking,
            _ => Objection::Late,
        }
    }

    fn is_too_short(&self, own: &Stream) -> bool {
        let least = self.reservations.blocking().saturating_add(own.load.transmission.as_ticks());
        least.saturating_add(self.reservations.others(own.deadline)) > own.deadline
    }
}

impl Stream {
    /// The work with deadlines before `point` that is published within `room`.
    fn work(&self, point: u64, room: u64, bit: u64) -> u64 {
        match point.checked_sub(self.deadline) {
            Some(before) if before > 0 => {
                self.load.times(self.load.within(before).min(self.load.within(room.saturating_add(bit))))
            }
            _ => 0,
        }
    }

    /// A line that the work never exceeds from `point` on. It begins at the deadline.
    fn line(&self, point: u64) -> u64 {
        self.load.line(point.saturating_sub(self.deadline))
    }

    /// The first point behind this one at which more work has its deadline before it.
    fn grows_after(&self, point: u64) -> u64 {
        let Some(before) = point.checked_sub(self.deadline).filter(|before| *before > 0) else {
            return self.deadline.saturating_add(1);
        };
        let intervals = self.load.within(before).saturating_mul(self.load.interval.as_ticks());
        let from_deadline = intervals.saturating_sub(self.load.tolerance.as_ticks()).saturating_add(1);
        self.deadline.saturating_add(from_deadline)
    }
}

/// How many points the analysis of the planner looks at one by one.
const MOST_BUSY_POINTS: u64 = 2_000;
