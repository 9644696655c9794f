//! What the sets have in common: means and spreads, as text and as JSON.

use super::{Options, POLICIES, Policy};
use crate::output::Conclusion;
use serde::Serialize;
use std::fmt;

/// The last load at which a policy met all deadlines of a message set.
///
/// Each policy gives the frames other identifiers, so other stuff bits: up to one bit a frame on average. That
/// a policy makes its frames longer must not count in its favour, so the load takes each frame at its mean
/// length over all identifiers.
#[derive(Clone, Copy, Default, Serialize)]
pub(super) struct Breakdown {
    /// The share of the bus that the messages take in frames of mean length.
    pub(super) load: f64,
    /// The share of the bus that the frames took as they were.
    pub(super) on_the_wire: f64,
}

/// The breakdown utilisation of one message set.
#[derive(Clone, Serialize)]
pub(super) struct SetResult {
    pub(super) seed: u64,
    pub(super) messages: usize,
    /// In the order of [`POLICIES`].
    pub(super) breakdown: [Breakdown; POLICIES.len()],
}

/// All results.
#[derive(Serialize)]
pub(super) struct Report<'o> {
    options: &'o Options,
    pub(super) policies: Vec<Summary>,
    pub(super) sets: Vec<SetResult>,
}

/// The breakdown utilisation of a policy over all sets.
#[derive(Serialize)]
pub(super) struct Summary {
    pub(super) policy: String,
    pub(super) mean: f64,
    least: f64,
    median: f64,
    greatest: f64,
    /// The mean share of the bus that the frames took as they were.
    mean_on_the_wire: f64,
}

impl Summary {
    fn of(at: usize, sets: &[SetResult]) -> Self {
        let mut sorted: Vec<f64> = sets.iter().map(|set| set.breakdown[at].load).collect();
        sorted.sort_by(f64::total_cmp);
        let nth = |share: f64| sorted.get((share * (sorted.len() - 1) as f64).round() as usize);
        let nth = |share: f64| nth(share).copied().unwrap_or(0.0);
        Self {
            policy: POLICIES[at].to_string(),
            mean: sorted.iter().sum::<f64>() / sorted.len() as f64,
            least: nth(0.0),
            median: nth(0.5),
            greatest: nth(1.0),
            mean_on_the_wire: sets.iter().map(|set| set.breakdown[at].on_the_wire).sum::<f64>()
                / sets.len() as f64,
        }
    }
}

impl fmt::Display for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ideal => f.write_str("ideal EDF"),
            Self::Mapped { step } => write!(f, "EDF, \u{394}t_p = {} \u{b5}s", step.as_micros()),
            Self::DeadlineMonotonic => f.write_str("fixed priorities (DM)"),
        }
    }
}

impl<'o> Report<'o> {
    pub(super) fn new(options: &'o Options, sets: Vec<SetResult>) -> Self {
        let policies = (0..POLICIES.len()).map(|at| Summary::of(at, &sets)).collect();
        Self { options, policies, sets }
    }

    /// The mapping is worth its effort if it breaks later than fixed priorities do.
    pub(super) fn verdict(&self) -> Conclusion {
        let mean = |wanted: fn(&Policy) -> bool| {
            let found = POLICIES.iter().zip(&self.policies).find(|(policy, _)| wanted(policy));
            found.map_or(0.0, |(_, summary)| summary.mean)
        };
        let mapped = mean(|policy| matches!(policy, Policy::Mapped { .. }));
        let fixed = mean(|policy| *policy == Policy::DeadlineMonotonic);
        if mapped > fixed {
            return Conclusion::Holds;
        }
        Conclusion::Fails(format!(
            "on average EDF breaks at {:.1} %, not later than fixed priorities at {:.1} %",
            mapped * 100.0,
            fixed * 100.0
        ))
    }
}

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let messages = self.sets.iter().map(|set| set.messages).sum::<usize>() / self.sets.len().max(1);
        writeln!(
            f,
            "{} message sets from seed {}, {messages} messages each on average, on {} nodes at 1 Mbit/s",
            self.sets.len(),
            self.options.seed,
            self.options.shape.nodes
        )?;
        writeln!(f, "breakdown utilisation in %          mean   least  median  greatest  mean on the wire")?;
        for summary in &self.policies {
            let &Summary { mean, least, median, greatest, mean_on_the_wire, .. } = summary;
            let percent = [mean, least, median, greatest, mean_on_the_wire].map(|share| share * 100.0);
            let [mean, least, median, greatest, wire] = percent;
            let policy = &summary.policy;
            writeln!(f, "  {policy:<32}{mean:6.1}  {least:6.1}  {median:6.1}  {greatest:8.1}  {wire:16.1}")?;
        }
        Ok(())
    }
}
