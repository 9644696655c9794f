//! Admission at run time: how long it takes, whether what is admitted ever misses a deadline, and how often a channel is
//! refused that the exact test would admit.
//!
//! Each sequence draws a segment with a plan, simulates its nodes with the core's own code, and lets them announce and
//! withdraw channels that the plan does not know. What is admitted is published as early and as often as its rate lets it;
//! now and then the broker falls silent and the standby takes over. A judge reads deadlines from the bus.

mod planned;
mod segment;
mod sequence;

use crate::output::{self, Conclusion, Results};
use cosmic_commands::experiment::Admission as Options;
use sequence::Outcome;
use serde::Serialize;
use std::fmt;

#[derive(Serialize)]
struct Report<'o> {
    options: &'o Options,
    asked: u64,
    acceptable_to_the_exact_test: u64,
    admitted: u64,
    /// Of those that the exact test would admit, the share that was refused.
    false_refusals: f64,
    admitted_against_the_exact_test: u64,
    unanswered: u64,
    withdrawn: u64,
    fail_overs: u64,
    lost_in_fail_overs: u64,
    events_sent: u64,
    events_late: u64,
    events_refused: u64,
    milliseconds_to_admit: Times,
}

/// From announcing to being admitted, etag included, in virtual milliseconds.
#[derive(Serialize)]
struct Times {
    median: f64,
    of_99_in_100: f64,
    longest: f64,
}

/// Does what `experiment admission` is to do.
pub(crate) fn run(options: &Options) -> anyhow::Result<Conclusion> {
    let results = Results::open(options.json.as_deref())?;
    let progress = output::progress(options.sequences, "sequences");
    let mut outcome = Outcome::default();
    for seed in options.seed..options.seed.saturating_add(options.sequences) {
        outcome.add(sequence::run(seed, options.unasked)?);
        progress.inc(1);
    }
    progress.finish_and_clear();
    let report = Report::new(options, outcome);
    results.show(&report)?;
    Ok(report.verdict())
}

impl<'o> Report<'o> {
    fn new(options: &'o Options, mut outcome: Outcome) -> Self {
        outcome.times.sort_unstable();
        let share = |hundredths: usize| {
            let last = outcome.times.len().saturating_sub(1);
            outcome.times.get(last * hundredths / 100).map_or(0.0, |us| *us as f64 / 1e3)
        };
        let safely = outcome.admitted - outcome.unsafe_ones;
        let false_refusals = match outcome.acceptable {
            0 => 0.0,
            acceptable => 1.0 - safely as f64 / acceptable as f64,
        };
        Self {
            options,
            asked: outcome.asked,
            acceptable_to_the_exact_test: outcome.acceptable,
            admitted: outcome.admitted,
            false_refusals,
            admitted_against_the_exact_test: outcome.unsafe_ones,
            unanswered: outcome.unanswered,
            withdrawn: outcome.withdrawn,
            fail_overs: outcome.fail_overs,
            lost_in_fail_overs: outcome.lost,
            events_sent: outcome.seen.sent,
            events_late: outcome.seen.late,
            events_refused: outcome.seen.refused,
            milliseconds_to_admit: Times { median: share(50), of_99_in_100: share(99), longest: share(100) },
        }
    }

    fn verdict(&self) -> Conclusion {
        let fails = |reason: String| Conclusion::Fails(reason);
        if self.events_late > 0 {
            fails(format!("{} of {} events were late", self.events_late, self.events_sent))
        } else if self.admitted_against_the_exact_test > 0 {
            fails(format!(
                "{} channels were admitted that the exact test refuses",
                self.admitted_against_the_exact_test
            ))
        } else if self.lost_in_fail_overs > 0 {
            fails(format!("{} channels were lost in fail-overs", self.lost_in_fail_overs))
        } else if self.events_refused > 0 {
            fails(format!("{} events of admitted channels were not taken", self.events_refused))
        } else if self.unanswered > 0 {
            fails(format!("{} questions were not answered", self.unanswered))
        } else if self.false_refusals > MOST_FALSE_REFUSALS {
            fails(format!("{:.1} % of what the exact test admits was refused", self.false_refusals * 100.0))
        } else {
            Conclusion::Holds
        }
    }
}

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { options, milliseconds_to_admit: times, .. } = self;
        writeln!(
            f,
            "{} sequences from seed {}: {} channels asked for, {} withdrawn, {} fail-overs",
            options.sequences, options.seed, self.asked, self.withdrawn, self.fail_overs
        )?;
        writeln!(
            f,
            "  {} admitted of {} that the exact test admits: {:.1} % false refusals, {} admitted wrongly",
            self.admitted,
            self.acceptable_to_the_exact_test,
            self.false_refusals * 100.0,
            self.admitted_against_the_exact_test
        )?;
        writeln!(
            f,
            "  {} events sent, {} late; {} of admitted channels not taken; {} channels lost in fail-overs",
            self.events_sent, self.events_late, self.events_refused, self.lost_in_fail_overs
        )?;
        writeln!(
            f,
            "  from announcing to admitted, etag included: {:.2} ms in the median, {:.2} ms in 99 of 100, {:.2} ms at worst",
            times.median, times.of_99_in_100, times.longest
        )
    }
}

/// The share of what the exact test would admit that may be refused.
const MOST_FALSE_REFUSALS: f64 = 0.1;
