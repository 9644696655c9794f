//! The distances of events.

use cosmic_core::time::Instant;

/// The distances of the events of one publisher on one channel.
#[derive(Clone, Default, Debug)]
pub(crate) struct Distances {
    pub(crate) events: u64,
    last: Option<Instant>,
    pub(crate) shortest: Option<u64>,
    pub(crate) longest: u64,
    pub(crate) mean: f64,
    /// The sum of the squares of the deviations from the mean (Welford).
    squares: f64,
}

impl Distances {
    pub(crate) fn add(&mut self, at: Instant) {
        self.events += 1;
        let Some(before) = self.last.replace(at) else { return };
        let distance = at.saturating_since(before).as_ticks();
        self.shortest = Some(self.shortest.map_or(distance, |shortest| shortest.min(distance)));
        self.longest = self.longest.max(distance);
        let delta = distance as f64 - self.mean;
        self.mean += delta / (self.events - 1) as f64;
        self.squares += delta * (distance as f64 - self.mean);
    }

    pub(crate) fn deviation(&self) -> f64 {
        if self.events > 2 { (self.squares / (self.events - 2) as f64).sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::time::Duration;

    #[test]
    fn mean_and_deviation_are_those_of_the_distances() {
        let mut distances = Distances::default();
        for us in [0, 900, 2_000, 3_100] {
            distances.add(Instant::from_epoch(Duration::from_micros(us)));
        }
        assert_eq!((distances.shortest, distances.longest), (Some(900_000), 1_100_000));
        assert!((distances.mean - 1_033_333.3).abs() < 1.0, "{}", distances.mean);
        assert!((distances.deviation() - 115_470.0).abs() < 1.0, "{}", distances.deviation());
    }
}
