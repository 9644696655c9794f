//! What the search decides on.

/// A truth value or its negation: twice its number, plus one if negated.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Literal(u32);

impl Literal {
    /// The first truth value.
    pub(super) const FIRST: Self = Self(0);

    pub(super) fn new(variable: usize, truth: bool) -> Self {
        Self((variable as u32) << 1 | u32::from(!truth))
    }
    pub(super) fn variable(self) -> usize {
        (self.0 >> 1) as usize
    }
    pub(super) fn truth(self) -> bool {
        self.0 & 1 == 0
    }
    pub(super) fn negated(self) -> Self {
        Self(self.0 ^ 1)
    }
    pub(super) fn index(self) -> usize {
        self.0 as usize
    }
}
