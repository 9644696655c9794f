use super::*;
use crate::registers::Memory;
use cosmic_core::can::{Etag, Id, TxNode};
use proptest::prelude::*;
use std::vec::Vec;

fn mask(fifo: Fifo) -> FilterBank {
    FilterBank::Mask { id: 0x0020_0012, mask: 0x1FE0_3FFF, fifo }
}

fn first(memory: &mut Memory) -> Banks {
    Banks { registers: memory.registers(), first: 0 }
}

#[test]
fn filters_are_extended_data_frames_only() {
    let mut memory = Memory::new();
    memory.set(FMR, 0x2A1C_0E01);
    // The other controller's, and an old one of ours.
    for register in [FM1R, FS1R, FFA1R, FA1R] {
        memory.set(register, 0x0F00_0020);
    }
    let ids = [0x1234, 0x1FFF_FFFF].map(|raw| Id::from_raw(raw).unwrap());
    let filters = [mask(Fifo::Other), FilterBank::List { ids, fifo: Fifo::Urgent }];
    assert!(first(&mut memory).apply(filters.iter(), false).is_ok());
    assert_eq!(memory.at(FMR), 0x2A1C_0E00);
    assert_eq!([FM1R, FS1R].map(|at| memory.at(at)), [0x0F00_0002, 0x0F00_0003]);
    assert_eq!([FFA1R, FA1R].map(|at| memory.at(at)), [0x0F00_0001, 0x0F00_0003]);
    let banks = [0x240, 0x244, 0x248, 0x24C].map(|at| memory.at(at));
    assert_eq!(banks, [0x0100_0094, 0xFF01_FFFE, 0x91A4, 0xFFFF_FFFC]);
}

#[test]
fn more_filters_than_banks_are_refused() {
    let filters = [const { FilterBank::Mask { id: 0, mask: 0, fifo: Fifo::Urgent } }; BANKS + 1];
    for (leaves_spare, most, active) in [(false, BANKS, 0x3FFF), (true, BANKS - 2, 0x2FFF)] {
        let mut memory = Memory::new();
        assert!(first(&mut memory).apply(filters[..most].iter(), leaves_spare).is_ok());
        assert_eq!(memory.at(FA1R), active);
        let refused = first(&mut memory).apply(filters[..=most].iter(), leaves_spare);
        assert_eq!(refused.err(), Some(TooManyFilters));
        assert_eq!((memory.at(FA1R), memory.at(BANK_0 + 8 * BANKS)), ((1 << most) - 1, 0));
    }
}

#[test]
fn without_spare_banks_nothing_is_written_later() {
    let mut memory = Memory::new();
    let mut spare = first(&mut memory).apply([mask(Fifo::Other)].iter(), false).unwrap();
    spare.set([Wanted::ALL].into_iter());
    assert_eq!((memory.at(FA1R), memory.at(FS1R), memory.at(BANK_0 + 8)), (1, 1, 0));
}

#[test]
fn literal_registers_of_spare_banks_of_both_controllers() {
    for bank in [0, BANKS] {
        let mut memory = Memory::new();
        memory.set(FA1R, 0x0800_0021);
        let other_active = 0x0800_0021 & !(OWN_BANKS << bank);
        let banks = Banks { registers: memory.registers(), first: bank };
        let mut spare = banks.apply([mask(Fifo::Urgent)].iter(), true).unwrap();
        assert_eq!([FM1R, FS1R, FFA1R].map(|at| memory.at(at)), [0, 0x3FFF << bank, 0x3FFE << bank]);
        assert_eq!(memory.at(FA1R), other_active | 0x2001 << bank);
        // Extended data frames, whatever their identifier.
        let at = |number: usize| [0, 4].map(|second| memory.at(BANK_0 + 8 * (bank + number) + second));
        assert_eq!(at(13), [0b100, 0b110]);

        let tx_node = TxNode::new(5).unwrap();
        let of_etag = Wanted::etag(Fifo::Other, Etag::new(0x3FFF).unwrap());
        spare.set([Wanted::tx_node(Fifo::Other, tx_node), of_etag].into_iter());
        let at = |number: usize| [0, 4].map(|second| memory.at(BANK_0 + 8 * (bank + number) + second));
        assert_eq!((at(1), at(2)), ([5 << 17 | 0b100, 0x7F << 17 | 0b110], [0x1_FFFC, 0x1_FFFE]));
        assert_eq!(memory.at(FA1R), other_active | 0b111 << bank);
        spare.set([].into_iter());
        assert_eq!(memory.at(FA1R), other_active | 1 << bank);
    }
}

#[test]
fn neighbours_share_a_bank_when_there_are_not_enough() {
    let mut memory = Memory::new();
    let filters = [mask(Fifo::Urgent); BANKS - 4];
    let mut spare = first(&mut memory).apply(filters.iter(), true).unwrap();
    // As a broker hands them out, from the last one down. The same one twice takes no room.
    let etags = [0x1000, 0x3FFF, 0x1000, 0x3FFE, 0x3FFD, 0x3FFF];
    let of_etags = etags.map(|etag| Wanted::etag(Fifo::Other, Etag::new(etag).unwrap()));
    let own = Wanted::tx_node(Fifo::Other, TxNode::new(9).unwrap());
    spare.set([own].into_iter().chain(of_etags));
    let masks = [10, 11, 12].map(|bank| memory.at(BANK_0 + 8 * bank + 4) >> 3);
    assert_eq!(masks, [0x7F << 14, 0x3FFF, 0x3FFC]);
    assert_eq!(memory.at(FA1R), 0x1FFF);
    // Four wishes in three banks.
    spare.set(Wanted::BOUND.into_iter());
    for etag in [0x400, 0x800, 0x1000, 0x2000, 0x3FFF] {
        assert!(Model::of(&memory).accepts(Id::from_raw(etag).unwrap()), "{etag:#x}");
    }
}

/// What the controller makes of the registers.
#[derive(Clone)]
struct Model([u32; crate::registers::SIZE / 4]);

impl Model {
    fn of(memory: &Memory) -> Self {
        Self(core::array::from_fn(|word| memory.at(4 * word)))
    }

    /// Takes a write as RM0090 has it for filters that are not being initialised.
    fn write(&mut self, (at, value): (usize, u32)) {
        if at >= BANK_0 {
            let bank = (at - BANK_0) / BANK_STRIDE;
            assert_eq!(self.0[FA1R / 4] >> bank & 1, 0, "bank {bank} is active");
        } else {
            assert_eq!(at, FA1R, "this needs filter initialisation mode");
        }
        self.0[at / 4] = value;
    }

    /// Whether it stores extended data frames of this identifier, by masks of 32 bits.
    fn accepts(&self, id: Id) -> bool {
        let frame = id.raw() << 3 | 1 << 2;
        let matches = |bank: usize| {
            let [id, mask] = [0, 1].map(|second| self.0[(BANK_0 + BANK_STRIDE * bank) / 4 + second]);
            (frame ^ id) & mask == 0
        };
        (0..28).any(|bank| self.0[FA1R / 4] >> bank & 1 != 0 && matches(bank))
    }
}

/// What a node wants: its TxNode, and the etags of its channels, or all.
#[derive(Clone, Debug)]
struct Wishes {
    tx_node: Option<u8>,
    etags: Vec<u16>,
    all: bool,
}

impl Wishes {
    fn wanted(&self) -> Vec<Wanted> {
        let of_all = if self.all { Wanted::BOUND.as_slice() } else { &[] };
        let own = self.tx_node.map(|own| Wanted::tx_node(Fifo::Other, TxNode::new(own).unwrap()));
        let etags = self.etags.iter().map(|etag| Wanted::etag(Fifo::Other, Etag::new(*etag).unwrap()));
        of_all.iter().copied().chain(own).chain(etags).collect()
    }

    fn count(&self) -> usize {
        let mut etags = self.etags.clone();
        etags.sort_unstable();
        etags.dedup();
        etags.len() + usize::from(self.tx_node.is_some()) + if self.all { 4 } else { 0 }
    }
}

/// One of the identifiers that a wish is for: these bits are where it does not care.
fn some_id(wish: &Wanted, bits: u32) -> Id {
    let FilterBank::Mask { id, mask, .. } = wish.bank() else { unreachable!() };
    Id::from_raw(id | bits & !mask & ((1 << 29) - 1)).unwrap()
}

/// Etags of a few neighbours and of any, more than there are banks, also the same one twice and that of 0.
fn wishes() -> impl Strategy<Value = Wishes> {
    let etag = prop_oneof![16_370..16_384_u16, 0..16_384_u16, Just(0)];
    let etags = prop::collection::vec(etag, 0..24);
    (prop::option::of(0..128_u8), etags, prop::bool::weighted(0.1)).prop_map(|(tx_node, etags, all)| Wishes {
        tx_node,
        etags,
        all,
    })
}

proptest! {
    /// The banks that the plan takes, the controller, what is wanted one after the other, and the other bits of frames.
    #[test]
    fn what_is_wanted_is_accepted_at_every_moment(
        fixed in 0..=BANKS - 2,
        first in prop_oneof![Just(0), Just(BANKS)],
        sequence in prop::collection::vec(wishes(), 1..8),
        bits: u32,
        stranger in 0..1_u32 << 29,
    ) {
        let mut memory = Memory::new();
        // Those of the plan accept nothing that is looked at.
        let none = FilterBank::Mask { id: (1 << 29) - 1, mask: (1 << 29) - 1, fifo: Fifo::Other };
        let plan = core::iter::repeat_n(&none, fixed);
        let mut spare = Banks { registers: memory.registers(), first }.apply(plan, true).unwrap();
        prop_assume!(stranger != (1 << 29) - 1);
        let stranger = Id::from_raw(stranger).unwrap();
        // Everything, until something is set.
        let mut before = Vec::from([Wanted::ALL]);
        for wishes in sequence {
            let wanted = wishes.wanted();
            let some = |wish: &Wanted| [0, bits, u32::MAX].map(|bits| some_id(wish, bits));
            let stays: Vec<_> = wanted
                .iter()
                .flat_map(some)
                .filter(|id| before.iter().any(|wish| wish.contains(*id)))
                .collect();
            let mut model = Model::of(&memory);
            crate::registers::WRITTEN.take();
            spare.set(wanted.iter().copied());
            for write in crate::registers::WRITTEN.take() {
                model.write(write);
                for id in &stays {
                    prop_assert!(model.accepts(*id), "{:?} is lost by {:x?}", id, write);
                }
            }
            prop_assert_eq!(model.0, Model::of(&memory).0);
            for id in wanted.iter().flat_map(some) {
                prop_assert!(model.accepts(id), "{:?}", id);
            }
            if wishes.count() < BANKS - fixed {
                let is_wanted = wanted.iter().any(|wish| wish.contains(stranger));
                prop_assert_eq!(model.accepts(stranger), is_wanted);
            }
            before = wanted;
        }
    }
}
