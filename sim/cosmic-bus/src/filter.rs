//! Acceptance filters: which frames a station's controller hands on to its processor.

use crate::frame::{Arbitration, WireFrame};
use embedded_can::Id;

/// One mask filter over the arbitration field: identifier, IDE and RTR, as a bxCAN filter bank in
/// 32-bit mask mode (RM0090, identifier filtering).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Filter {
    value: u32,
    mask: u32,
}

impl Filter {
    /// Every frame matches.
    pub const ANY: Self = Self { value: 0, mask: 0 };

    /// Frames of the same kind (standard or extended, data or remote) whose identifier equals `id` in the
    /// bits that are set in `mask`.
    pub fn new(id: Id, remote: bool, mask: u32) -> Self {
        let value = Arbitration::new(id, remote);
        // SRR is always recessive in an extended frame, so it may stand in the mask of both kinds.
        let kind_and_rtr = if value.is_extended() { 0b11 << 19 | 1 } else { 0b11 << 19 };
        let mask = if value.is_extended() {
            kind_and_rtr | (mask >> 18 & 0x7FF) << 21 | (mask & 0x3_FFFF) << 1
        } else {
            kind_and_rtr | (mask & 0x7FF) << 21
        };
        Self { value: value.raw() & mask, mask }
    }

    /// The filter over the raw [`Arbitration`] field: it matches if both agree in the bits of `mask`.
    pub const fn from_raw(value: u32, mask: u32) -> Self {
        Self { value: value & mask, mask }
    }

    /// Data frames with exactly this identifier.
    pub fn exactly(id: Id) -> Self {
        Self::new(id, false, u32::MAX)
    }

    /// Returns whether `frame` passes.
    #[inline]
    pub const fn matches(&self, frame: &WireFrame) -> bool {
        frame.arbitration().raw() & self.mask == self.value
    }
}

/// All filters of a station: a frame passes if any of them matches. No filters, no frames.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Filters(Vec<Filter>);

impl Filters {
    /// Accepts every frame; what a station has at first.
    pub fn accept_all() -> Self {
        Self(vec![Filter::ANY])
    }

    /// Accepts none.
    pub const fn accept_none() -> Self {
        Self(Vec::new())
    }

    /// Returns whether `frame` passes. Looks at the filters in turn, some at once, until one matches.
    #[inline]
    pub fn accept(&self, frame: &WireFrame) -> bool {
        // Without a branch for each the compiler compares several in one instruction.
        let any = |some: &[Filter]| some.iter().fold(false, |any, filter| any | filter.matches(frame));
        self.0.chunks(AT_ONCE).any(any)
    }
}

impl FromIterator<Filter> for Filters {
    fn from_iter<I: IntoIterator<Item = Filter>>(filters: I) -> Self {
        Self(filters.into_iter().collect())
    }
}

const AT_ONCE: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, Frame as _, StandardId};

    #[test]
    fn masks_select_by_identifier_kind_and_rtr() {
        let id = ExtendedId::new(0x1234_5678).unwrap();
        let near = ExtendedId::new(0x1234_5679).unwrap();
        let frame = |id| WireFrame::new(id, &[]).unwrap();
        let exact = Filter::exactly(id.into());
        assert!(exact.matches(&frame(Id::Extended(id))));
        assert!(!exact.matches(&frame(Id::Extended(near))));
        assert!(Filter::new(id.into(), false, !1).matches(&frame(Id::Extended(near))));
        assert!(!exact.matches(&WireFrame::new_remote(id, 0).unwrap()));
        let base = StandardId::new((0x1234_5678 >> 18) as u16).unwrap();
        assert!(!Filter::new(id.into(), false, 0x7FF << 18).matches(&frame(Id::Standard(base))));
        assert!(Filter::exactly(base.into()).matches(&frame(Id::Standard(base))));
        assert!(!Filter::exactly(base.into()).matches(&WireFrame::new_remote(base, 3).unwrap()));
    }

    #[test]
    fn any_filter_suffices_and_none_accepts_nothing() {
        let frame = WireFrame::new(StandardId::MAX, &[]).unwrap();
        let other = Filter::exactly(StandardId::ZERO.into());
        assert!(Filters::accept_all().accept(&frame));
        assert!(!Filters::accept_none().accept(&frame));
        assert!(!Filters::from_iter([other]).accept(&frame));
        assert!(Filters::from_iter([other, Filter::exactly(StandardId::MAX.into())]).accept(&frame));
    }
}
