//! Conflict-driven search over the order of windows.
//!
//! A *separation* says that the difference of two positions avoids the open intervals
//! `(low, up) + n · modulus`. Each such interval becomes one truth value: behind it (`x_i - x_j >= up +
//! n · modulus`) or in front of it. A full choice is a set of difference constraints, so the search
//! decides truth values, draws the consequences from [`Differences`], learns a clause from every
//! contradiction and jumps back (as satisfiability solvers do). It ends with positions, or with the proof
//! that there are none: no granularity of time is assumed, and nothing is left out.

use super::difference::{Differences, Mark};
use super::literal::Literal;
use super::restart::luby;

/// `x_i - x_j` avoids `(low, up) + n · modulus` for every `n`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Separation {
    pub(super) i: usize,
    pub(super) j: usize,
    pub(super) modulus: i64,
    pub(super) low: i64,
    pub(super) up: i64,
}

#[derive(Clone, Copy, Debug)]
struct Variable {
    separation: u32,
    lap: i64,
}

/// Why a literal is true.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Reason {
    /// It was decided.
    Decision,
    /// A learned clause says so.
    Clause(u32),
    /// The difference constraints say so; the clause is among the explanations.
    Explanation(u32),
}

/// Where the state stood when a decision was made.
#[derive(Clone, Copy, Debug)]
struct Level {
    trail: usize,
    explanations: usize,
    mark: Mark,
}

/// Where the laps of a separation stand among the variables.
#[derive(Clone, Copy, Debug)]
struct Laps {
    first_variable: usize,
    first: i64,
    last: i64,
}

/// How a search ended.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Verdict {
    /// Positions that keep every rule.
    Found(Vec<i64>),
    /// There are none.
    Impossible,
    /// The budget was used up.
    GaveUp,
}

/// The search. Variable 0 of the difference constraints is the origin.
#[derive(Debug)]
pub(super) struct Search {
    n: usize,
    separations: Vec<Separation>,
    /// Steps taken since the budget was last asked.
    steps: u64,
    laps: Vec<Laps>,
    of_pair: Vec<Vec<u32>>,
    variables: Vec<Variable>,
    differences: Differences<Literal>,
    value: Vec<Option<bool>>,
    level: Vec<u32>,
    reason: Vec<Reason>,
    explanations: Vec<Vec<Literal>>,
    trail: Vec<Literal>,
    handled: usize,
    levels: Vec<Level>,
    clauses: Vec<Vec<Literal>>,
    watches: Vec<Vec<u32>>,
    activity: Vec<f64>,
    increment: f64,
    preferred: Vec<Option<bool>>,
    changed: Vec<(usize, usize)>,
    seen: Vec<bool>,
}

impl Search {
    /// A search with `n` variables (the origin included), `x_v - x_u <= c` for each of `always`.
    /// `None` if these alone contradict each other.
    pub(super) fn new(
        n: usize,
        always: &[(usize, usize, i64)],
        separations: Vec<Separation>,
    ) -> Option<Self> {
        let mut differences = Differences::new(n);
        let mut changed = Vec::new();
        for &edge in always {
            differences.add(edge, None, &mut changed).ok()?;
        }
        let mut search = Self {
            n,
            laps: Vec::new(),
            of_pair: vec![Vec::new(); n * n],
            variables: Vec::new(),
            differences,
            value: Vec::new(),
            level: Vec::new(),
            reason: Vec::new(),
            explanations: Vec::new(),
            trail: Vec::new(),
            handled: 0,
            levels: Vec::new(),
            clauses: Vec::new(),
            watches: Vec::new(),
            activity: Vec::new(),
            increment: 1.0,
            preferred: Vec::new(),
            changed: Vec::new(),
            seen: Vec::new(),
            separations,
            steps: 0,
        };
        search.make_variables();
        Some(search)
    }

    fn make_variables(&mut self) {
        for at in 0..self.separations.len() {
            let s = self.separations[at];
            let (low, high) = (-self.differences.bound(s.i, s.j), self.differences.bound(s.j, s.i));
            // Only intervals that the difference can meet.
            let first = (low - s.up).div_euclid(s.modulus) + 1;
            let last = (high - s.low - 1).div_euclid(s.modulus);
            self.laps.push(Laps { first_variable: self.variables.len(), first, last });
            for lap in first..=last {
                self.variables.push(Variable { separation: at as u32, lap });
            }
            self.of_pair[s.i * self.n + s.j].push(at as u32);
            self.of_pair[s.j * self.n + s.i].push(at as u32);
        }
        let count = self.variables.len();
        self.value = vec![None; count];
        self.level = vec![0; count];
        self.reason = vec![Reason::Decision; count];
        self.preferred = vec![None; count];
        self.activity = vec![0.0; count];
        self.seen = vec![false; count];
        self.watches = vec![Vec::new(); 2 * count];
    }

    /// Runs until it is decided, or `proceed`, which is told how many steps were taken, says no.
    pub(super) fn run(&mut self, proceed: &mut dyn FnMut(u64) -> bool) -> Verdict {
        self.changed = (0..self.n * self.n).map(|at| (at / self.n, at % self.n)).collect();
        if self.consequences().is_err() {
            return Verdict::Impossible;
        }
        let mut restart = 1;
        let mut until_restart = RESTART_UNIT * luby(restart);
        loop {
            if self.steps >= STEPS_BETWEEN && !proceed(std::mem::take(&mut self.steps)) {
                return Verdict::GaveUp;
            }
            match self.propagate() {
                Err(conflict) => {
                    self.steps += 20 * (self.trail.len() + conflict.len()) as u64;
                    if self.levels.is_empty() || !self.learn(conflict) {
                        return Verdict::Impossible;
                    }
                    until_restart = until_restart.saturating_sub(1);
                }
                Ok(()) if until_restart == 0 => {
                    restart += 1;
                    until_restart = RESTART_UNIT * luby(restart);
                    self.back_to(0);
                    self.forget();
                }
                Ok(()) => match self.choose() {
                    Some(literal) => {
                        self.levels.push(Level {
                            trail: self.trail.len(),
                            explanations: self.explanations.len(),
                            mark: self.differences.mark(),
                        });
                        self.assign(literal, Reason::Decision);
                    }
                    None => return Verdict::Found(self.positions()),
                },
            }
        }
    }

    /// The earliest positions that the constraints so far allow.
    fn positions(&self) -> Vec<i64> {
        (0..self.n).map(|v| -self.differences.bound(v, 0)).collect()
    }

    fn choose(&mut self) -> Option<Literal> {
        self.steps += 4 * self.separations.len() as u64;
        self.decide()
    }

    /// An undecided truth value whose separation the earliest positions break; `None` if they break none.
    fn decide(&self) -> Option<Literal> {
        let x = self.positions();
        let mut best: Option<(f64, i64, Literal)> = None;
        for (s, laps) in self.separations.iter().zip(&self.laps) {
            let d = x[s.i] - x[s.j];
            let lap = (d - s.low - 1).div_euclid(s.modulus);
            let (low, up) = (s.low + lap * s.modulus, s.up + lap * s.modulus);
            if d >= up || lap < laps.first || lap > laps.last {
                continue;
            }
            let variable = laps.first_variable + (lap - laps.first) as usize;
            let (behind, front) = (up - d, d - low);
            let truth = self.preferred[variable].unwrap_or(behind <= front);
            let candidate = (self.activity[variable], behind.max(front), Literal::new(variable, truth));
            if best.is_none_or(|(activity, shift, _)| (candidate.0, candidate.1) > (activity, shift)) {
                best = Some(candidate);
            }
        }
        best.map(|(_, _, literal)| literal)
    }

    fn assign(&mut self, literal: Literal, reason: Reason) {
        self.steps += 10;
        let variable = literal.variable();
        self.value[variable] = Some(literal.truth());
        self.level[variable] = self.levels.len() as u32;
        self.reason[variable] = reason;
        self.trail.push(literal);
    }

    fn is_true(&self, literal: Literal) -> bool {
        self.value[literal.variable()] == Some(literal.truth())
    }

    fn is_false(&self, literal: Literal) -> bool {
        self.value[literal.variable()] == Some(!literal.truth())
    }

    /// Draws all consequences of what was assigned. On a contradiction: a clause that is false.
    fn propagate(&mut self) -> Result<(), Vec<Literal>> {
        while self.handled < self.trail.len() {
            let literal = self.trail[self.handled];
            self.handled += 1;
            self.constrain(literal)?;
            self.visit_watches(literal)?;
        }
        Ok(())
    }

    /// Adds the difference constraint that a literal stands for.
    fn constrain(&mut self, literal: Literal) -> Result<(), Vec<Literal>> {
        let Variable { separation, lap } = self.variables[literal.variable()];
        let s = self.separations[separation as usize];
        let edge = if literal.truth() {
            (s.i, s.j, -(s.up + lap * s.modulus))
        } else {
            (s.j, s.i, s.low + lap * s.modulus)
        };
        let added = self.differences.add(edge, Some(literal), &mut self.changed);
        self.steps += 4 * self.n as u64 + 10 * self.changed.len() as u64;
        match added {
            Ok(()) => self.consequences(),
            Err(literals) => {
                self.changed.clear();
                Err(literals.into_iter().map(Literal::negated).collect())
            }
        }
    }

    /// Assigns every truth value that the changed bounds decide.
    fn consequences(&mut self) -> Result<(), Vec<Literal>> {
        let mut changed = std::mem::take(&mut self.changed);
        let mut result = Ok(());
        'pairs: for &(u, v) in &changed {
            // The bound on x_v - x_u.
            let bound = self.differences.bound(u, v);
            for at in 0..self.of_pair[u * self.n + v].len() {
                self.steps += 8;
                let separation = self.of_pair[u * self.n + v][at] as usize;
                let (s, laps) = (self.separations[separation], self.laps[separation]);
                // x_i - x_j <= bound rules "behind" out from some lap on; x_j - x_i <= bound rules "in
                // front" out up to some lap.
                let (laps_decided, truth) = if v == s.i {
                    (((bound - s.up).div_euclid(s.modulus) + 1).max(laps.first)..=laps.last, false)
                } else {
                    (laps.first..=((-bound - s.low - 1).div_euclid(s.modulus)).min(laps.last), true)
                };
                for lap in laps_decided {
                    let variable = laps.first_variable + (lap - laps.first) as usize;
                    let literal = Literal::new(variable, truth);
                    if self.is_true(literal) {
                        continue;
                    }
                    let mut clause = vec![literal];
                    clause.extend(self.differences.explain(u, v).into_iter().map(Literal::negated));
                    self.steps += 60 + 20 * clause.len() as u64;
                    if self.is_false(literal) {
                        result = Err(clause);
                        break 'pairs;
                    }
                    self.explanations.push(clause);
                    self.assign(literal, Reason::Explanation(self.explanations.len() as u32 - 1));
                }
            }
        }
        changed.clear();
        self.changed = changed;
        result
    }

    /// Clauses that watch the negation of a literal that became true.
    fn visit_watches(&mut self, literal: Literal) -> Result<(), Vec<Literal>> {
        let false_literal = literal.negated();
        let mut watching = std::mem::take(&mut self.watches[false_literal.index()]);
        self.steps += 10 * watching.len() as u64;
        let mut at = 0;
        let mut result = Ok(());
        while at < watching.len() {
            let clause = watching[at] as usize;
            if self.clauses[clause][0] == false_literal {
                self.clauses[clause].swap(0, 1);
            }
            let first = self.clauses[clause][0];
            if self.is_true(first) {
                at += 1;
                continue;
            }
            let other = (2..self.clauses[clause].len()).find(|&k| !self.is_false(self.clauses[clause][k]));
            if let Some(k) = other {
                self.clauses[clause].swap(1, k);
                let watch = self.clauses[clause][1].index();
                self.watches[watch].push(clause as u32);
                watching.swap_remove(at);
            } else if self.is_false(first) {
                result = Err(self.clauses[clause].clone());
                break;
            } else {
                self.assign(first, Reason::Clause(clause as u32));
                at += 1;
            }
        }
        // Nothing was added to this list meanwhile: a false literal is no new watch.
        self.watches[false_literal.index()] = watching;
        result
    }

    /// Learns the first unique implication point of a conflict and goes back. `false`: there is no way out.
    fn learn(&mut self, conflict: Vec<Literal>) -> bool {
        // A conflict of the past levels only is one of the latest of them.
        let newest = conflict.iter().map(|l| self.level[l.variable()]).max().unwrap_or(0);
        if newest == 0 {
            return false;
        }
        self.back_to(newest as usize);
        let (clause, back) = self.analyse(&conflict, newest);
        self.increment *= 1.0 / 0.95;
        if self.increment > 1e100 {
            self.activity.iter_mut().for_each(|activity| *activity *= 1e-100);
            self.increment *= 1e-100;
        }
        self.back_to(back as usize);
        let asserting = clause[0];
        if clause.len() == 1 {
            self.assign(asserting, Reason::Decision);
            return true;
        }
        let at = self.clauses.len() as u32;
        self.watches[clause[0].index()].push(at);
        self.watches[clause[1].index()].push(at);
        self.clauses.push(clause);
        self.assign(asserting, Reason::Clause(at));
        true
    }

    /// The learned clause, the literal that it asserts first, one of the level to go back to second.
    fn analyse(&mut self, conflict: &[Literal], newest: u32) -> (Vec<Literal>, u32) {
        let mut clause = vec![Literal::FIRST];
        let mut open = 0;
        let mut at = self.trail.len();
        let mut pending: Vec<Literal> = conflict.to_vec();
        loop {
            for literal in pending.drain(..) {
                let variable = literal.variable();
                if self.seen[variable] || self.level[variable] == 0 {
                    continue;
                }
                self.seen[variable] = true;
                self.activity[variable] += self.increment;
                if self.level[variable] == newest {
                    open += 1;
                } else {
                    clause.push(literal);
                }
            }
            let literal = loop {
                at -= 1;
                if self.seen[self.trail[at].variable()] && self.level[self.trail[at].variable()] == newest {
                    break self.trail[at];
                }
            };
            self.seen[literal.variable()] = false;
            open -= 1;
            if open == 0 {
                clause[0] = literal.negated();
                break;
            }
            let reason: &[Literal] = match self.reason[literal.variable()] {
                Reason::Decision => &[],
                Reason::Clause(at) => &self.clauses[at as usize],
                Reason::Explanation(at) => &self.explanations[at as usize],
            };
            pending.extend(reason.iter().filter(|l| **l != literal));
        }
        for literal in &clause[1..] {
            self.seen[literal.variable()] = false;
        }
        let level = |literal: &Literal| self.level[literal.variable()];
        let second = (1..clause.len()).max_by_key(|&k| level(&clause[k]));
        let back = second.map_or(0, |k| level(&clause[k]));
        if let Some(k) = second {
            clause.swap(1, k);
        }
        (clause, back)
    }

    fn back_to(&mut self, level: usize) {
        let Some(&past) = self.levels.get(level) else { return };
        for literal in self.trail.drain(past.trail..) {
            let variable = literal.variable();
            self.preferred[variable] = Some(literal.truth());
            self.value[variable] = None;
        }
        self.handled = past.trail;
        self.explanations.truncate(past.explanations);
        self.differences.take_back(past.mark);
        self.levels.truncate(level);
    }

    /// Drops long clauses if there are many, and what is true for good; called with no decision standing.
    fn forget(&mut self) {
        for literal in &self.trail {
            self.reason[literal.variable()] = Reason::Decision;
        }
        self.explanations.clear();
        let mut kept = std::mem::take(&mut self.clauses);
        if kept.len() > CLAUSE_LIMIT {
            // Short clauses prune most; among equals the younger stay.
            kept.reverse();
            kept.sort_by_key(Vec::len);
            kept.truncate(CLAUSE_LIMIT / 2);
        }
        kept.retain(|clause| !clause.iter().any(|literal| self.is_true(*literal)));
        for clause in &mut kept {
            clause.retain(|literal| self.value[literal.variable()].is_none());
        }
        self.watches.iter_mut().for_each(Vec::clear);
        for clause in kept {
            match clause[..] {
                [] => {}
                [only] => self.assign(only, Reason::Decision),
                [first, second, ..] => {
                    let at = self.clauses.len() as u32;
                    self.watches[first.index()].push(at);
                    self.watches[second.index()].push(at);
                    self.clauses.push(clause);
                }
            }
        }
    }
}

/// So many steps are taken before the budget is asked.
const STEPS_BETWEEN: u64 = 100_000;

const RESTART_UNIT: u64 = 100;
const CLAUSE_LIMIT: usize = 20_000;
