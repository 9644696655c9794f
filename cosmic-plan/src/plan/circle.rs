//! One period as a circle, with the arcs that are taken.

use super::request::gcd;

/// The circle of one period. Arcs are half open, sorted and never touch each other.
#[derive(Clone, Debug)]
pub(super) struct Circle {
    period: i64,
    taken: Vec<(i64, i64)>,
}

impl Circle {
    pub(super) fn new(period: i64) -> Self {
        Self { period, taken: Vec::new() }
    }

    /// Takes the arcs in which a window that recurs with `other_period` meets this circle. Says how many steps it took.
    pub(super) fn take(&mut self, position: i64, window: i64, other_period: i64) -> u64 {
        let grid = gcd(self.period, other_period);
        let start = position.rem_euclid(grid);
        for turn in 0..self.period / grid {
            let (from, to) = (start + turn * grid, start + turn * grid + window);
            if to <= self.period {
                self.insert(from, to);
            } else {
                self.insert(from, self.period);
                self.insert(0, to - self.period);
            }
        }
        (self.period / grid).unsigned_abs() * (20 + self.taken.len() as u64 / 4)
    }

    fn insert(&mut self, from: i64, to: i64) {
        let first = self.taken.partition_point(|arc| arc.1 < from);
        let behind = self.taken.partition_point(|arc| arc.0 <= to);
        let merged = self.taken[first..behind]
            .iter()
            .fold((from, to), |merged, arc| (merged.0.min(arc.0), merged.1.max(arc.1)));
        self.taken.splice(first..behind, [merged]);
    }

    /// The free arcs, the one across the end of the period last and whole: it then ends behind it.
    pub(super) fn free(&self) -> Vec<(i64, i64)> {
        let Some(first) = self.taken.first() else { return vec![(0, self.period)] };
        let starts = self.taken.iter().map(|arc| arc.1);
        let ends = self.taken[1..].iter().map(|arc| arc.0).chain([first.0 + self.period]);
        starts.zip(ends).filter(|(from, to)| from < to).collect()
    }

    /// The ranges (both ends included) of positions within `earliest..=latest` at which a window fits.
    pub(super) fn places(&self, window: i64, earliest: i64, latest: i64) -> Vec<(i64, i64)> {
        let mut places = Vec::new();
        if self.taken.is_empty() {
            return if window <= self.period { vec![(earliest, latest)] } else { places };
        }
        for (from, to) in self.free() {
            let last = to - window;
            // The arc across the end may hold positions behind the end and at the start.
            for shift in [0, self.period] {
                let (low, high) = ((from - shift).max(earliest), (last - shift).min(latest));
                if low <= high {
                    places.push((low, high));
                }
            }
        }
        places.sort_unstable();
        places
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arcs_merge_and_wrap() {
        let mut circle = Circle::new(20);
        circle.take(8, 4, 10);
        assert_eq!(circle.free(), [(2, 8), (12, 18)]);
        circle.take(2, 6, 20);
        assert_eq!(circle.free(), [(12, 18)]);
        assert_eq!(circle.places(4, 0, 19), [(12, 14)]);
        assert_eq!(circle.places(7, 0, 19), []);
        circle.take(12, 6, 20);
        assert_eq!(circle.free(), []);
    }

    #[test]
    fn a_place_may_reach_across_the_end() {
        let mut circle = Circle::new(20);
        circle.take(5, 10, 20);
        assert_eq!(circle.places(8, 0, 19), [(15, 17)]);
        assert_eq!(circle.places(3, 0, 19), [(0, 2), (15, 19)]);
    }
}
