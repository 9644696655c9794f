//! A random sequence of announcements and withdrawals on one segment.

use super::planned::{BROKERS, NODES, Offered, PUBLISHER, Planned};
use super::segment::{ADMITTED, Seen, Segment};
use crate::random::Random;
use anyhow::bail;
use cosmic_core::client::AdmissionState;
use cosmic_core::time::Duration;

/// What came of one or more sequences.
#[derive(Default)]
pub(super) struct Outcome {
    pub(super) asked: u64,
    /// The exact test would have admitted so many.
    pub(super) acceptable: u64,
    pub(super) admitted: u64,
    /// Admitted, though the exact test would not.
    pub(super) unsafe_ones: u64,
    /// Nobody answered in time.
    pub(super) unanswered: u64,
    pub(super) withdrawn: u64,
    /// Brokers that fell silent.
    pub(super) fail_overs: u64,
    /// Admitted channels that were not held over a fail-over.
    pub(super) lost: u64,
    pub(super) seen: Seen,
    /// From announcing to being admitted, in virtual microseconds.
    pub(super) times: Vec<u64>,
}

impl Outcome {
    pub(super) fn add(&mut self, other: Self) {
        self.asked += other.asked;
        self.acceptable += other.acceptable;
        self.admitted += other.admitted;
        self.unsafe_ones += other.unsafe_ones;
        self.unanswered += other.unanswered;
        self.withdrawn += other.withdrawn;
        self.fail_overs += other.fail_overs;
        self.lost += other.lost;
        self.seen.sent += other.seen.sent;
        self.seen.late += other.seen.late;
        self.seen.refused += other.seen.refused;
        self.times.extend(other.times);
    }
}

struct Sequence {
    random: Random,
    planned: Planned,
    segment: Segment,
    held: Vec<(usize, Offered)>,
    next_subject: u64,
    unasked: bool,
    outcome: Outcome,
}

/// Runs the sequence of this seed; `unasked`: whatever is announced is published.
pub(super) fn run(seed: u64, unasked: bool) -> anyhow::Result<Outcome> {
    let mut random = Random::new(seed);
    let planned = Planned::drawn(&mut random)?;
    let segment = Segment::new(&planned, random.bits(), !unasked);
    let mut sequence = Sequence {
        random,
        planned,
        segment,
        held: Vec::new(),
        next_subject: FIRST_SUBJECT,
        unasked,
        outcome: Outcome::default(),
    };
    // A broker listens, and hears what is held, before it answers.
    sequence.segment.run(Duration::from_millis(2_000));
    sequence.segment.begin();
    let steps = 8 + sequence.random.below(25);
    let fails_at = sequence.random.below(3 * steps);
    for step in 0..steps {
        if step == fails_at {
            sequence.fail_over();
        }
        if sequence.random.below(4) == 0 {
            sequence.withdraw();
        } else {
            sequence.ask()?;
        }
        sequence.all_at_once();
    }
    sequence.check_held("at the end");
    let Sequence { outcome, segment, .. } = sequence;
    Ok(Outcome { seen: segment.seen(), ..outcome })
}

impl Sequence {
    fn scaled(&self, milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds * self.planned.scale)
    }

    fn ask(&mut self) -> anyhow::Result<()> {
        if self.held.len() == ADMITTED {
            return Ok(());
        }
        let asking = NODES.len() - PUBLISHER - 1;
        let node = PUBLISHER + 1 + self.random.below(asking as u64) as usize;
        let offered = Offered::drawn(&mut self.random, self.next_subject, self.planned.scale)?;
        self.next_subject += 1;
        let held = self.held.iter().map(|(_, offered)| offered);
        let acceptable = self.planned.holds_with(held.chain([&offered]));
        if let Err(error) = self.segment.announce(node, &offered) {
            bail!("{offered:?} cannot be announced: {error}");
        }
        self.outcome.asked += 1;
        self.outcome.acceptable += u64::from(acceptable);
        for waited in 1..=MOST_STEPS {
            self.segment.run(STEP);
            match self.segment.state(node, offered.subject) {
                Some(AdmissionState::Admitted(_)) => {
                    self.outcome.times.push(waited * STEP.as_micros());
                    self.publish(node, offered, acceptable);
                    return Ok(());
                }
                None if self.unasked && self.segment.is_bound(node, offered.subject) => {
                    self.publish(node, offered, acceptable);
                    return Ok(());
                }
                Some(AdmissionState::Waiting) | None => {}
                Some(AdmissionState::Refused(_)) => {
                    self.segment.cancel(offered.subject);
                    return Ok(());
                }
            }
        }
        self.outcome.unanswered += 1;
        self.segment.cancel(offered.subject);
        Ok(())
    }

    fn publish(&mut self, node: usize, offered: Offered, acceptable: bool) {
        self.outcome.admitted += 1;
        self.outcome.unsafe_ones += u64::from(!acceptable);
        self.segment.let_publish(offered.subject, true);
        self.held.push((node, offered));
    }

    fn withdraw(&mut self) {
        if self.held.is_empty() {
            return;
        }
        let at = self.random.below(self.held.len() as u64) as usize;
        let (_, offered) = self.held.swap_remove(at);
        // What waits is sent before, so that it can be judged.
        self.segment.let_publish(offered.subject, false);
        self.segment.run(offered.deadline);
        self.segment.cancel(offered.subject);
        self.outcome.withdrawn += 1;
    }

    /// The worst that can happen to all that is admitted: full bursts at one instant, and what follows.
    fn all_at_once(&mut self) {
        let rest = self.scaled(20);
        self.segment.synchronise(rest);
        self.segment.run(rest + self.scaled(25));
    }

    fn fail_over(&mut self) {
        self.outcome.fail_overs += 1;
        self.segment.switch_off(0);
        self.segment.run(Duration::from_millis(3_500));
        self.check_held("over a fail-over");
    }

    fn check_held(&mut self, when: &str) {
        for (node, offered) in self.held.iter().filter(|_| !self.unasked) {
            let state = self.segment.state(*node, offered.subject);
            if !matches!(state, Some(AdmissionState::Admitted(_))) {
                self.outcome.lost += 1;
                eprintln!("{} was lost {when}: {state:?}", offered.subject);
            }
        }
    }
}

const _: () = assert!(BROKERS >= 2, "one takes over from the other");

/// How often it is looked whether there is an answer.
const STEP: Duration = Duration::from_micros(250);

/// How often at most: two seconds.
const MOST_STEPS: u64 = 8_000;

/// The subjects of the plan are smaller.
const FIRST_SUBJECT: u64 = 1_000;
