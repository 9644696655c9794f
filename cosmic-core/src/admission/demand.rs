//! The test itself; its reason stands in the [module above](super).

use super::reservations::{Load, Reservations, SoftLoad, WHOLE};
use super::{Admission, Admitted, Ask, Objection};
use crate::can::Payload;
use crate::event_layer::EventRate;
use crate::time::Duration;

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
    whose: Option<crate::Subject>,
}

impl<'a> Demand<'a> {
    pub(super) const fn new(
        reservations: &'a Reservations<'a>,
        admitted: &'a [Option<Admitted>],
        except: Option<usize>,
    ) -> Self {
        Self { reservations, admitted, except }
    }

    /// Whether this one fits besides. See [`Admission::ask`] for the work.
    pub(super) fn admits(&self, ask: &Ask) -> Result<(), Objection> {
        let own = self.soft_load(ask).ok_or(Objection::Blocking)?;
        let new = self.stream(&own, None);
        let streams = || self.streams().chain([new]);
        self.leaves_the_bus_idle_now_and_then(&streams)?;
        self.leaves_room_for_less_urgent(&new)?;
        self.sends_what_is_beyond_the_band(&streams)?;
        self.walk(&streams)
    }

    /// The shortest longer interval found at which it fits.
    pub(super) fn fits_at(&self, ask: &Ask, why: Objection) -> Option<Duration> {
        if matches!(why, Objection::Blocking | Objection::Full) {
            return None;
        }
        let with = |ticks: u64| {
            let rate = ask.rate.with_interval(Duration::from_ticks(ticks))?;
            self.admits(&Ask { rate, ..*ask }).is_ok().then_some(ticks)
        };
        let mut refused = ask.rate.interval().as_ticks();
        let mut fits = (0..DOUBLINGS).find_map(|_| {
            let longer = refused.saturating_mul(2);
            let fits = with(longer);
            if fits.is_none() {
                refused = longer;
            }
            fits
        })?;
        for _ in 0..HALVINGS {
            let middle = refused.midpoint(fits);
            match with(middle) {
                Some(middle) => fits = middle,
                None => refused = middle,
            }
        }
        Some(Duration::from_ticks(fits))
    }

    fn soft_load(&self, ask: &Ask) -> Option<SoftLoad> {
        let len = usize::from(ask.len);
        let transmission = self.reservations.bit_rate.longest_frame(len);
        let load = Load { transmission, interval: ask.rate.enforced(), tolerance: ask.rate.tolerance() };
        let fits = len <= Payload::MAX_LEN && !ask.deadline.is_zero() && ask.deadline <= EventRate::LONGEST;
        fits.then_some(SoftLoad { load, deadline: ask.deadline, subject: ask.subject })
    }

    fn streams(&self) -> impl Iterator<Item = Stream> + '_ {
        let planned = self.reservations.soft.iter().copied();
        let others = self.admitted.iter().enumerate().filter(|(at, _)| Some(*at) != self.except);
        let admitted = others.filter_map(|(_, place)| self.soft_load(&place.as_ref()?.ask));
        planned.chain(admitted).map(|load| self.stream(&load, Some(load.subject)))
    }

    fn stream(&self, of: &SoftLoad, whose: Option<crate::Subject>) -> Stream {
        Stream { load: self.reservations.with_slip(of.load), deadline: of.deadline.as_ticks(), whose }
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

    /// From one point to the next at which the work with earlier deadlines grows.
    fn walk<I: Iterator<Item = Stream>>(&self, streams: &impl Fn() -> I) -> Result<(), Objection> {
        let (step, horizon) = (self.reservations.step(), self.reservations.horizon());
        let firsts = || {
            let near = streams().filter(|stream| stream.deadline < horizon);
            near.map(|stream| stream.deadline.saturating_add(step))
        };
        let Some(mut point) = firsts().min() else { return Ok(()) };
        for _ in 0..Admission::<'_, 0>::MOST_POINTS {
            let room = point.saturating_sub(step);
            let mut demand = self.reservations.blocking().saturating_add(self.reservations.others(room));
            let mut line = self.reservations.blocking().saturating_add(self.reservations.others_line(room));
            let mut next = firsts().filter(|first| *first > point).min().unwrap_or(u64::MAX);
            for stream in streams() {
                demand = demand.saturating_add(stream.work(point, room, self.reservations.bit()));
                line = line.saturating_add(stream.line(point));
                next = next.min(stream.grows_after(point));
            }
            if demand > room {
                return Err(self.late_at(point, streams));
            }
            // The line grows no faster than time.
            if line <= room {
                return Ok(());
            }
            point = next;
        }
        Err(Objection::Utilisation)
    }

    /// Who is late at this point: the one with the latest deadline that is not behind it.
    fn late_at<I: Iterator<Item = Stream>>(&self, point: u64, streams: &impl Fn() -> I) -> Objection {
        let room = point.saturating_sub(self.reservations.step());
        let late = streams().filter(|stream| stream.deadline <= room).max_by_key(|stream| stream.deadline);
        match late {
            Some(Stream { whose: Some(subject), .. }) => Objection::Suffers(subject),
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

/// How often the interval is doubled to find one that fits.
pub(super) const DOUBLINGS: u8 = 6;

/// How often the span between one that fits and one that does not is halved.
pub(super) const HALVINGS: u8 = 3;

/// How many points the analysis of the planner looks at one by one.
const MOST_BUSY_POINTS: u64 = 2_000;
