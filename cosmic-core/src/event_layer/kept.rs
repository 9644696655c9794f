//! What a node does for its channels, by the type in which it keeps them.

use super::channel::Declared;
use core::borrow::Borrow;

/// How a node keeps the channels that it knows, and what it does for them. What it does not do it has no code for.
pub trait Kept: Borrow<Declared> + Copy {
    /// It has channels whose events carry attributes of context; a node without refuses them, and filters.
    const CONTEXTS: bool = true;
    /// It holds publishers to the rates of their channels, and tells subscribers of events that do not come.
    const RATES: bool = true;
}

impl Kept for Declared {}

/// A channel that is a constant of the program: a node keeps no copy.
#[derive(Clone, Copy, Debug)]
pub struct Constant<const CONTEXTS: bool, const RATES: bool>(&'static Declared);

impl<const CONTEXTS: bool, const RATES: bool> Borrow<Declared> for Constant<CONTEXTS, RATES> {
    #[inline]
    fn borrow(&self) -> &Declared {
        self.0
    }
}

impl<const CONTEXTS: bool, const RATES: bool> From<&'static Declared> for Constant<CONTEXTS, RATES> {
    fn from(declared: &'static Declared) -> Self {
        Self(declared)
    }
}

impl<const CONTEXTS: bool, const RATES: bool> Kept for Constant<CONTEXTS, RATES> {
    const CONTEXTS: bool = CONTEXTS;
    const RATES: bool = RATES;
}
