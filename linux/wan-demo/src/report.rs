//! What the demo found, in words and in JSON.

use std::fmt;

use serde::Serialize;

use crate::commands::Story;
use crate::round_trips::RoundTrips;

/// What the demo found.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Report {
    /// Where the gateways stood.
    pub network: String,
    /// Table 5 of Kaiser and Brudna, for ours.
    pub round_trips: Vec<RoundTrips>,
    /// What became of events, by gateway and direction; outcomes that did not happen are left out.
    pub outcomes: Vec<(String, u64)>,
    /// What the commands did.
    pub story: Story,
    /// For how many seconds each segment's time stood still, because the machine could not follow.
    pub stood: Vec<(String, f64)>,
    /// One-way delay of the way between the gateways, in milliseconds.
    pub delay: f64,
    /// What was promised and is not so.
    pub broken: Vec<String>,
}

impl Report {
    /// Judges.
    pub fn new(
        network: &str,
        round_trips: Vec<RoundTrips>,
        outcomes: Vec<(String, u64)>,
        story: Story,
        stood: Vec<(String, f64)>,
        delay: f64,
    ) -> Self {
        let mut broken = Vec::new();
        let stale = story.stale();
        if !stale.is_empty() {
            broken.push(format!("{} stale commands reached the far bus: {stale:?}", stale.len()));
        }
        if story.twice > 0 {
            broken.push(format!("{} commands came twice", story.twice));
        }
        let [before, _, after] = story.arrived();
        if before.0 == 0 || after.0 == 0 {
            broken.push("no command crossed before the cut, or none after it".to_owned());
        }
        if story.temperatures.0 == 0 || story.temperatures.1 == 0 {
            broken.push("no temperature of the emulated sensor reached the emulated brake's bus".to_owned());
        }
        if round_trips.iter().any(|path| path.count < path.lost) {
            broken.push("most round trips of a path did not come back".to_owned());
        }
        Self { network: network.to_owned(), round_trips, outcomes, story, stood, delay, broken }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Between the gateways: {}\n", self.network)?;
        writeln!(
            f,
            "Round trips in milliseconds, the way between the gateways {:.1} ms each way",
            self.delay
        )?;
        writeln!(
            f,
            "  {:<44} {:>6} {:>8} {:>8} {:>8} {:>8} {:>5}",
            "path", "count", "min", "mean", "median", "max", "lost"
        )?;
        for RoundTrips { path, count, lost, min, mean, median, max } in &self.round_trips {
            writeln!(f, "  {path:<44} {count:>6} {min:>8.3} {mean:>8.3} {median:>8.3} {max:>8.3} {lost:>5}")?;
        }
        writeln!(f, "\nEvents by what became of them")?;
        for (what, count) in &self.outcomes {
            writeln!(f, "  {count:>8}  {what}")?;
        }
        let Story { cut: (from, until), temperatures, .. } = &self.story;
        writeln!(f, "\nThe cut, from {from:.1} s to {until:.1} s; commands from west to east all the time")?;
        let parts = ["before", "during", "after"];
        for (part, (arrived, all)) in parts.iter().zip(self.story.arrived()) {
            writeln!(f, "  {part:<7} {all:>5} published, {arrived:>5} on the far bus")?;
        }
        if let Some(back) = self.story.back_after() {
            writeln!(f, "  the first one crosses {:.0} ms after the way has healed", back * 1e3)?;
        }
        writeln!(
            f,
            "  {} stale commands on the far bus, {} twice",
            self.story.stale().len(),
            self.story.twice
        )?;
        let (before, after) = temperatures;
        writeln!(
            f,
            "  temperatures from the emulated sensor in the west to the brake in the east: {before} before, {after} since"
        )?;
        for (segment, seconds) in self.stood.iter().filter(|(_, seconds)| *seconds > 0.001) {
            writeln!(
                f,
                "  the machine could not follow: the time of {segment} stood for {seconds:.2} s in all"
            )?;
        }
        writeln!(f)?;
        for broken in &self.broken {
            writeln!(f, "NOT AS PROMISED: {broken}")?;
        }
        if self.broken.is_empty() {
            writeln!(f, "All as promised.")?;
        }
        Ok(())
    }
}
