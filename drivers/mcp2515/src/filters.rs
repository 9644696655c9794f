//! Acceptance filters: two masks, two filters for RXB0 and four for RXB1 (data sheet, section 4.5).

use crate::registers::EXIDE;
use cosmic_core::can::Id;
use cosmic_core::can::filter_banks::{Fifo, FilterBank, FilterBanks};

/// What the chip accepts: urgent frames into RXB0, others into RXB1, extended frames only.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Filters {
    urgent: Buffer<2>,
    other: Buffer<4>,
}

impl Filters {
    /// Every extended frame goes into RXB1, which holds one. For a slow bus or a fast host.
    pub const ALL: Self = Self { urgent: Buffer::NONE, other: Buffer { mask: 0, ids: [0; 4] } };

    /// Filters that accept whatever the plan accepts. Since each buffer has one mask only, they may accept more.
    pub fn of<const BANKS: usize>(banks: &FilterBanks<BANKS>) -> Self {
        Self { urgent: Buffer::of(banks, Fifo::Urgent), other: Buffer::of(banks, Fifo::Other) }
    }

    /// Whether a buffer accepts extended frames of this identifier: RXB0, else RXB1.
    pub fn accepts(&self, id: Id) -> bool {
        self.urgent.accepts(id) || self.other.accepts(id)
    }

    /// RXF0 to RXF2, and RXF3 to RXF5.
    pub(crate) fn filter_registers(&self) -> [[u8; 12]; 2] {
        let [a, b] = self.urgent.ids;
        let [c, d, e, f] = self.other.ids;
        [[a, b, c], [d, e, f]].map(|ids| {
            let mut bytes = [0; 12];
            for (place, id) in bytes.chunks_exact_mut(4).zip(ids) {
                let mut registers = identifier_registers(id);
                registers[1] |= EXIDE;
                place.copy_from_slice(&registers);
            }
            bytes
        })
    }

    /// RXM0 and RXM1.
    pub(crate) fn mask_registers(&self) -> [u8; 8] {
        let mut bytes = [0; 8];
        for (place, mask) in bytes.chunks_exact_mut(4).zip([self.urgent.mask, self.other.mask]) {
            place.copy_from_slice(&identifier_registers(mask));
        }
        bytes
    }
}

/// The filters of one receive buffer and their mask.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Buffer<const FILTERS: usize> {
    mask: u32,
    /// Zero where the mask is zero; repeated if there are fewer.
    ids: [u32; FILTERS],
}

impl<const FILTERS: usize> Buffer<FILTERS> {
    /// The identifier of all ones is that of no COSMIC frame: least priority, broker, last etag. A buffer
    /// always accepts something.
    const NONE: Self = Self { mask: ID_BITS, ids: [ID_BITS; FILTERS] };

    /// Takes the identifiers one by one. When there is no filter left, the mask gives up the bits in which the
    /// new one differs from the filter that is most alike.
    fn of<const BANKS: usize>(banks: &FilterBanks<BANKS>, fifo: Fifo) -> Self {
        let wanted = || banks.iter().filter(|bank| bank.fifo() == fifo);
        let mut mask = ID_BITS;
        for bank in wanted() {
            if let FilterBank::Mask { mask: its, .. } = bank {
                mask &= its;
            }
        }
        let mut ids = [None::<u32>; FILTERS];
        for bank in wanted() {
            let pair = match bank {
                FilterBank::Mask { id, .. } => [*id, *id],
                FilterBank::List { ids, .. } => ids.map(Id::raw),
            };
            for id in pair {
                mask = take(&mut ids, mask, id);
            }
        }
        let Some(first) = ids.iter().flatten().next().copied() else { return Self::NONE };
        Self { mask, ids: ids.map(|id| id.unwrap_or(first) & mask) }
    }

    fn accepts(&self, id: Id) -> bool {
        self.ids.iter().any(|wanted| (id.raw() ^ wanted) & self.mask == 0)
    }
}

/// Makes the filters accept one more identifier. Returns the mask, which may have become smaller.
fn take<const FILTERS: usize>(ids: &mut [Option<u32>; FILTERS], mask: u32, id: u32) -> u32 {
    if ids.iter().flatten().any(|taken| (taken ^ id) & mask == 0) {
        return mask;
    }
    if let Some(free) = ids.iter_mut().find(|place| place.is_none()) {
        *free = Some(id);
        return mask;
    }
    let differences = ids.iter().flatten().map(|taken| (taken ^ id) & mask);
    let least = differences.min_by_key(|bits| bits.count_ones());
    mask & !least.unwrap_or(0)
}

/// SIDH, SIDL, EID8 and EID0 of 29 bits, with EXIDE clear.
pub(crate) const fn identifier_registers(id: u32) -> [u8; 4] {
    let sidl = ((id >> 13) as u8 & 0xE0) | ((id >> 16) as u8 & 0x03);
    [(id >> 21) as u8, sidl, (id >> 8) as u8, id as u8]
}

/// The 29 bits in SIDH, SIDL, EID8 and EID0.
pub(crate) const fn identifier(sidh: u8, sidl: u8, eid8: u8, eid0: u8) -> Id {
    let standard = (sidh as u32) << 3 | (sidl as u32) >> 5;
    let extension = (sidl as u32 & 0x03) << 16 | (eid8 as u32) << 8 | eid0 as u32;
    Id::masked(standard << 18 | extension)
}

const ID_BITS: u32 = (1 << 29) - 1;

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::filter_banks::Wanted;
    use cosmic_core::can::{Etag, Priority, TxNode};

    #[test]
    fn identifiers_round_trip() {
        let registers = identifier_registers(0x1F5F_C004);
        assert_eq!(registers, [0xFA, 0xE3, 0xC0, 0x04]);
        for bit in 0..29 {
            let [sidh, sidl, eid8, eid0] = identifier_registers(1 << bit);
            assert_eq!(identifier(sidh, sidl | EXIDE, eid8, eid0).raw(), 1 << bit);
        }
    }

    #[test]
    fn whatever_is_wanted_is_accepted() {
        let etag = |value| Etag::new(value).unwrap();
        let wanted = [
            Wanted::hard(etag(100), TxNode::MIN),
            Wanted::hard(etag(101), TxNode::MAX),
            Wanted::hard(etag(777), TxNode::MIN),
            Wanted::etag(Fifo::Urgent, Etag::SYNC),
            Wanted::etag(Fifo::Other, etag(5_000)),
            Wanted::etag(Fifo::Other, etag(5_001)),
            Wanted::etag(Fifo::Other, etag(6_002)),
            Wanted::etag(Fifo::Other, etag(7_003)),
            Wanted::etag(Fifo::Other, etag(8_004)),
            Wanted::etag(Fifo::Other, etag(9_005)),
        ];
        for count in 0..=wanted.len() {
            let wanted = &wanted[..count];
            let filters = Filters::of(&FilterBanks::<6>::plan::<16>(wanted).unwrap());
            for raw in [0, 0x1FFF_FFFF, 0x1555_5555, 0x0AAA_AAAA] {
                for etag in (0..0x4000).filter_map(Etag::new) {
                    let base = Id::from_raw(raw).unwrap();
                    let id = Id::new(base.priority(), base.tx_node(), etag);
                    let is_wanted = wanted.iter().any(|wish| wish.contains(id));
                    assert!(filters.accepts(id) || !is_wanted, "{id}");
                }
            }
        }
        let few = Filters::of(&FilterBanks::<6>::plan::<16>(&wanted[..1]).unwrap());
        assert!(few.accepts(Id::new(Priority::HARD, TxNode::MIN, etag(100))));
        assert!(!few.accepts(Id::new(Priority::HARD, TxNode::MIN, etag(101))));
    }
}
