//! Difference constraints `x_v - x_u <= c`, added and taken back, with all their consequences.
//!
//! The matrix of shortest paths holds the tightest bound that the constraints imply for every pair, so
//! that any literal they decide is seen at once. Adding one costs O(n²) at worst and only the pairs
//! that change are written down for taking it back. Every entry knows the newest constraint on its path;
//! the constraints that imply a bound are found by following these.

/// No bound.
pub(super) const NONE: i64 = i64::MAX / 4;

/// A constraint: `x_v - x_u <= bound`, true because of a literal or always.
#[derive(Clone, Copy, Debug)]
struct Edge<L> {
    u: usize,
    v: usize,
    literal: Option<L>,
}

/// Constraints over `n` variables.
#[derive(Debug)]
pub(super) struct Differences<L> {
    n: usize,
    bounds: Vec<i64>,
    newest: Vec<u32>,
    edges: Vec<Edge<L>>,
    undo: Vec<(u32, i64, u32)>,
}

/// A state to come back to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mark {
    edges: usize,
    undo: usize,
}

impl<L: Copy> Differences<L> {
    pub(super) fn new(n: usize) -> Self {
        let mut bounds = vec![NONE; n * n];
        for at in 0..n {
            bounds[at * n + at] = 0;
        }
        Self { n, bounds, newest: vec![0; n * n], edges: Vec::new(), undo: Vec::new() }
    }

    /// The tightest bound on `x_v - x_u`.
    pub(super) fn bound(&self, u: usize, v: usize) -> i64 {
        self.bounds[u * self.n + v]
    }

    pub(super) fn mark(&self) -> Mark {
        Mark { edges: self.edges.len(), undo: self.undo.len() }
    }

    pub(super) fn take_back(&mut self, mark: Mark) {
        while self.undo.len() > mark.undo {
            if let Some((at, bound, newest)) = self.undo.pop() {
                self.bounds[at as usize] = bound;
                self.newest[at as usize] = newest;
            }
        }
        self.edges.truncate(mark.edges);
    }

    /// Adds `x_v - x_u <= bound`; the pairs whose bound became tighter are appended to `changed`.
    ///
    /// # Errors
    /// It contradicts the others: the literals of a contradiction, this one's among them.
    pub(super) fn add(
        &mut self,
        (u, v, bound): (usize, usize, i64),
        literal: Option<L>,
        changed: &mut Vec<(usize, usize)>,
    ) -> Result<(), Vec<L>> {
        let n = self.n;
        if self.bound(u, v) <= bound {
            return Ok(());
        }
        if self.bound(v, u) < NONE && self.bound(v, u) + bound < 0 {
            let mut reasons = self.explain(v, u);
            reasons.extend(literal);
            return Err(reasons);
        }
        self.edges.push(Edge { u, v, literal });
        let newest = self.edges.len() as u32;
        let ends: Vec<(usize, i64)> = (0..n)
            .map(|b| (b, self.bound(v, b)))
            .filter(|&(b, rest)| rest < NONE && bound + rest < self.bound(u, b))
            .collect();
        for a in 0..n {
            let first = self.bound(a, u);
            if first >= NONE || first + bound >= self.bound(a, v) {
                continue;
            }
            for &(b, rest) in &ends {
                let at = a * n + b;
                if first + bound + rest < self.bounds[at] {
                    self.undo.push((at as u32, self.bounds[at], self.newest[at]));
                    self.bounds[at] = first + bound + rest;
                    self.newest[at] = newest;
                    changed.push((a, b));
                }
            }
        }
        Ok(())
    }

    /// The literals that imply the bound on `x_v - x_u`.
    pub(super) fn explain(&self, u: usize, v: usize) -> Vec<L> {
        let mut literals = Vec::new();
        let mut open = vec![(u, v)];
        while let Some((a, b)) = open.pop() {
            if a == b {
                continue;
            }
            // Entries that were tightened later are on paths of newer constraints only, so this ends.
            let Some(edge) = (self.newest[a * self.n + b] as usize).checked_sub(1).map(|at| self.edges[at])
            else {
                continue;
            };
            literals.extend(edge.literal);
            open.push((a, edge.u));
            open.push((edge.v, b));
        }
        literals
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_follow_paths_and_are_taken_back() {
        let mut d = Differences::new(3);
        let mut changed = Vec::new();
        d.add((0, 1, 5), Some('a'), &mut changed).unwrap();
        let mark = d.mark();
        d.add((1, 2, -2), Some('b'), &mut changed).unwrap();
        assert_eq!(d.bound(0, 2), 3);
        assert!(changed.contains(&(0, 2)));
        let mut reasons = d.explain(0, 2);
        reasons.sort_unstable();
        assert_eq!(reasons, ['a', 'b']);
        d.take_back(mark);
        assert_eq!(d.bound(0, 2), NONE);
    }

    #[test]
    fn a_contradiction_names_its_constraints() {
        let mut d = Differences::new(4);
        let mut changed = Vec::new();
        d.add((0, 3, 1), Some('x'), &mut changed).unwrap();
        d.add((0, 1, 5), Some('a'), &mut changed).unwrap();
        d.add((1, 2, -2), Some('b'), &mut changed).unwrap();
        let mut reasons = d.add((2, 0, -4), Some('c'), &mut changed).unwrap_err();
        reasons.sort_unstable();
        assert_eq!(reasons, ['a', 'b', 'c']);
    }
}
