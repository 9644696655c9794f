//! What is to be placed, without anything of CAN: windows that recur, and what holds between them.
//!
//! The unit of time here is the nanosecond, in `i64`: differences have signs. A *position* is the ready
//! instant of an item's first occurrence.

use cosmic_core::time::Duration;

/// Nanoseconds from [`Duration`]'s.
pub(super) fn ticks(span: Duration) -> i64 {
    i64::try_from(span.as_ticks()).unwrap_or(i64::MAX / 4)
}

/// A window that recurs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Item {
    /// The distance of its occurrences.
    pub period: i64,
    /// Its length.
    pub window: i64,
    /// The first position that is allowed.
    pub earliest: i64,
    /// The last position that is allowed.
    pub latest: i64,
    /// Items of one group are occurrences of one channel that are placed one by one; see [`Spacing`].
    pub spacing: Option<Spacing>,
}

/// An occurrence that is placed by itself, so that the spacing of the channel varies.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Spacing {
    /// The channel's item whose position is the reference.
    pub reference: usize,
    /// The nominal distance from the reference.
    pub offset: i64,
    /// How much more or less it may be.
    pub jitter: i64,
}

/// One item behind another: the ready instant of `then` is at most `within` behind the end of a window
/// of `first`, both taken modulo the shorter period.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Link {
    /// The item in front.
    pub first: usize,
    /// The item behind.
    pub then: usize,
    /// The longest distance.
    pub within: i64,
}

/// Everything that is to be placed.
#[derive(Clone, PartialEq, Eq, Default, Debug)]
pub struct Request {
    /// The windows.
    pub items: Vec<Item>,
    /// What follows what.
    pub links: Vec<Link>,
}

impl Request {
    /// Do these positions keep every rule? Written for the planner's own assertions; the independent
    /// check of a plan is [`crate::verify`].
    pub fn accepts(&self, positions: &[i64]) -> bool {
        let bounded =
            self.items.iter().zip(positions).all(|(item, x)| (item.earliest..=item.latest).contains(x));
        let spaced = self.items.iter().zip(positions).all(|(item, x)| {
            item.spacing.is_none_or(|s| (x - positions[s.reference] - s.offset).abs() <= s.jitter)
        });
        let apart = (0..self.items.len()).all(|i| {
            (0..i).all(|j| {
                let (a, b) = (&self.items[i], &self.items[j]);
                let grid = gcd(a.period, b.period);
                let behind = (positions[i] - positions[j]).rem_euclid(grid);
                behind >= b.window && grid - behind >= a.window
            })
        });
        let linked = self.links.iter().all(|link| {
            let (first, then) = (&self.items[link.first], &self.items[link.then]);
            let grid = first.period.min(then.period);
            let behind = positions[link.then] - positions[link.first] - first.window;
            behind.rem_euclid(grid) <= link.within
        });
        bounded && spaced && apart && linked
    }

    /// The request in which every window is longer by a gap; `None` if a link leaves no room for it.
    pub fn with_gaps(&self, gap: i64) -> Option<Self> {
        let mut wider = self.clone();
        for item in &mut wider.items {
            item.window += gap;
            if item.window > item.period {
                return None;
            }
        }
        for link in &mut wider.links {
            link.within = link.within.checked_sub(gap).filter(|within| *within >= 0)?;
        }
        Some(wider)
    }

    /// The request with only some of its items, and the links between them.
    pub fn restricted(&self, keep: &[usize]) -> Self {
        let place = |old: usize| keep.iter().position(|k| *k == old);
        let items = keep.iter().map(|k| {
            let item = self.items[*k];
            let spacing = item.spacing.and_then(|s| Some(Spacing { reference: place(s.reference)?, ..s }));
            Item { spacing, ..item }
        });
        let links = self.links.iter().filter_map(|link| {
            Some(Link { first: place(link.first)?, then: place(link.then)?, within: link.within })
        });
        Self { items: items.collect(), links: links.collect() }
    }

    /// The share of time that the windows take.
    pub fn utilisation(&self) -> f64 {
        self.items.iter().map(|item| item.window as f64 / item.period as f64).sum()
    }
}

/// The greatest common divisor.
pub(super) fn gcd(mut a: i64, mut b: i64) -> i64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}
