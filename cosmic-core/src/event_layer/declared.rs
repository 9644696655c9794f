//! A channel as a node lists it, and what the node does for it.

use super::attributes::{Attributes, SoftAttributes};
use super::rate::EventRate;
use crate::admission::Offer;
use crate::can::Etag;
use crate::protocol::LayoutHash;
use crate::uid::Subject;
use core::borrow::Borrow;

/// A channel without the type of its content: what a node knows of it.
///
/// A node whose channels are constants, as those of firmware are, lists each as a [`Constant`]: it takes no copy.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Declared {
    pub(crate) subject: Subject,
    pub(crate) attributes: Attributes,
    pub(crate) etag: Option<Etag>,
    pub(crate) context: bool,
    pub(crate) layout: LayoutHash,
    /// Bytes of an event, with the byte of presence of a channel with context.
    pub(crate) len: usize,
    /// How often events come, if that is stated.
    pub(crate) rate: Option<EventRate>,
}

impl From<&Self> for Declared {
    fn from(declared: &Self) -> Self {
        *declared
    }
}

impl Declared {
    /// What it is to be, if it is a soft real-time channel.
    pub(crate) fn offer(&self) -> Option<Offer> {
        match self.attributes {
            Attributes::Soft(SoftAttributes { deadline, .. }) => {
                Some(Offer { rate: self.rate, deadline, len: self.len })
            }
            Attributes::Hard(_) | Attributes::NonRealTime(_) => None,
        }
    }
}

/// How a node lists the channels that it knows, and what it does for them. What it does not do it has no code for.
pub trait Listed: Borrow<Declared> + Copy {
    /// It has channels whose events carry attributes of context; a node without refuses them, and filters.
    const CONTEXTS: bool = true;
    /// It holds publishers to the rates of their channels, and tells subscribers of events that do not come.
    const RATES: bool = true;
}

impl Listed for Declared {}

/// A channel that is a constant of the program: a node lists it without a copy.
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

impl<const CONTEXTS: bool, const RATES: bool> Listed for Constant<CONTEXTS, RATES> {
    const CONTEXTS: bool = CONTEXTS;
    const RATES: bool = RATES;
}
