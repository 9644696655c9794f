//! Reception against a second, small model of it that is written from the words of RM0090 (filter banks, identifier
//! filtering, receive mailboxes): random filters, then random frames of every kind the bus can carry.
//!
//! The model has no packed registers: a filter is what the manual's figure shows, a list of named fields.

use cosmic_bus::WireFrame;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};

use super::BxCan;
use super::random::Random;

/// A frame as its fields.
#[derive(Clone, Copy, Debug)]
struct Fields {
    /// The eleven bits, or the first eleven of 29.
    standard: u16,
    /// The other eighteen; zero in a standard frame.
    extension: u32,
    extended: bool,
    remote: bool,
    code: u8,
    data: [u8; 8],
}

impl Fields {
    fn random(random: &mut Random) -> Self {
        let (extended, remote) = (random.below(2) == 1, random.below(4) == 0);
        // Few identifiers, so that filters hit.
        let pick = |random: &mut Random, all: u32| [0, 1, 2, all, all - 1][random.below(5) as usize];
        let standard = pick(random, 0x7FF) as u16;
        let extension = if extended { pick(random, 0x3_FFFF) } else { 0 };
        let data = core::array::from_fn(|_| random.below(256) as u8);
        Self { standard, extension, extended, remote, code: random.below(16) as u8, data }
    }

    fn wire(&self) -> WireFrame {
        let id = if self.extended {
            Id::Extended(ExtendedId::new(u32::from(self.standard) << 18 | self.extension).unwrap())
        } else {
            Id::Standard(StandardId::new(self.standard).unwrap())
        };
        let length = usize::from(self.code.min(8));
        let frame = if self.remote {
            WireFrame::new_remote(id, length)
        } else {
            WireFrame::new(id, &self.data[..length])
        };
        frame.unwrap().with_length_code(self.code).unwrap()
    }

    /// As the receive mailbox shows it: CAN_RIxR, the length code of CAN_RDTxR, CAN_RDLxR, CAN_RDHxR. "STID", or the
    /// high bits of the extended identifier, stand at 21; EXID at 3, IDE at 2, RTR at 1.
    fn mailbox(&self) -> (u32, u32, u64) {
        let rir = u32::from(self.standard) << 21
            | self.extension << 3
            | u32::from(self.extended) << 2
            | u32::from(self.remote) << 1;
        let length = if self.remote { 0 } else { usize::from(self.code.min(8)) };
        let data = (0..length).map(|n| u64::from(self.data[n]) << (8 * n)).sum();
        (rir, self.code.into(), data)
    }

    /// The bits that a filter of 32 bits looks at, by figure "filter bank scale configuration": STID, EXID, IDE, RTR.
    fn wide(&self) -> Vec<bool> {
        let mut bits = bits_of(self.standard.into(), 11);
        bits.extend(bits_of(self.extension, 18));
        bits.extend([self.extended, self.remote]);
        bits
    }

    /// Of one of 16 bits: STID, RTR, IDE, and the three highest bits of EXID.
    fn narrow(&self) -> Vec<bool> {
        let mut bits = bits_of(self.standard.into(), 11);
        bits.extend([self.remote, self.extended]);
        bits.extend(bits_of(self.extension >> 15, 3));
        bits
    }
}

/// The highest first.
fn bits_of(value: u32, count: u32) -> Vec<bool> {
    (0..count).rev().map(|bit| value >> bit & 1 == 1).collect()
}

/// A filter bank as it is set.
#[derive(Clone, Copy, Debug)]
struct Bank {
    is_wide: bool,
    is_list: bool,
    to_fifo_1: bool,
    is_active: bool,
    words: [u32; 2],
}

impl Bank {
    fn random(random: &mut Random) -> Self {
        let mut flag = || random.below(2) == 1;
        let (is_wide, is_list, to_fifo_1, is_active) = (flag(), flag(), flag(), flag() || flag());
        let mut bank = Self { is_wide, is_list, to_fifo_1, is_active, words: [0; 2] };
        // Identifiers of the frames, and masks of few bits.
        bank.words = core::array::from_fn(|_| match random.below(4) {
            0 => 0,
            1 => 1 << (1 + random.below(31)),
            _ if is_wide => Fields::random(random).mailbox().0,
            _ => {
                let mut half = || {
                    let bits = Fields::random(random).narrow();
                    bits.iter().fold(0, |word, bit| word << 1 | u32::from(*bit))
                };
                half() << 16 | half()
            }
        });
        bank
    }

    /// What its filters want of a frame, in the order of their numbers: pairs of the bit wanted, and whether it matters.
    fn filters(&self) -> Vec<Vec<(bool, bool)>> {
        let exact = |bits: Vec<bool>| bits.into_iter().map(|bit| (bit, true)).collect();
        let masked = |id: Vec<bool>, mask: Vec<bool>| id.into_iter().zip(mask).collect();
        // Bit 0 of a filter of 32 bits is mapped to nothing.
        let wide = |word: u32| bits_of(word >> 1, 31);
        let halves = |word: u32| (bits_of(word & 0xFFFF, 16), bits_of(word >> 16, 16));
        let [first, second] = self.words;
        match (self.is_wide, self.is_list) {
            (true, true) => vec![exact(wide(first)), exact(wide(second))],
            (true, false) => vec![masked(wide(first), wide(second))],
            (false, true) => {
                let ((a, b), (c, d)) = (halves(first), halves(second));
                vec![exact(a), exact(b), exact(c), exact(d)]
            }
            (false, false) => {
                let ((id, mask), (other_id, other_mask)) = (halves(first), halves(second));
                vec![masked(id, mask), masked(other_id, other_mask)]
            }
        }
    }

    fn passes(&self, filter: &[(bool, bool)], frame: &Fields) -> bool {
        let bits = if self.is_wide { frame.wide() } else { frame.narrow() };
        assert_eq!(bits.len(), filter.len());
        filter.iter().zip(bits).all(|((wanted, matters), bit)| !matters || *wanted == bit)
    }
}

/// The FIFO and the filter match index of a frame: "a 32-bit filter takes precedence over a 16-bit one; among filters of
/// equal scale, identifier list mode over mask mode; among filters of equal scale and mode, the lower number". Numbers
/// count for each FIFO, whether the banks are active or not.
fn stored(banks: &[Bank], frame: &Fields) -> Option<(bool, u32)> {
    let mut numbers = [0; 2];
    let mut found = Vec::new();
    for bank in banks {
        for filter in bank.filters() {
            let number = &mut numbers[usize::from(bank.to_fifo_1)];
            if bank.is_active && bank.passes(&filter, frame) {
                found.push((!bank.is_wide, !bank.is_list, *number, bank.to_fifo_1));
            }
            *number += 1;
        }
    }
    found.iter().min_by_key(|(narrow, mask, number, _)| (*narrow, *mask, *number)).map(|it| (it.3, it.2))
}

/// A FIFO of three.
#[derive(Debug, Default)]
struct Pending {
    messages: Vec<(Fields, u32)>,
    full: bool,
    overrun: bool,
}

impl Pending {
    fn store(&mut self, frame: Fields, index: u32, is_locked: bool) {
        if self.messages.len() == 3 {
            self.overrun = true;
            // "The last message stored in the FIFO will be overwritten", or with RFLM "the most recent message will be
            // discarded".
            if !is_locked {
                self.messages[2] = (frame, index);
            }
            return;
        }
        self.messages.push((frame, index));
        self.full |= self.messages.len() == 3;
    }

    fn status(&self) -> u32 {
        self.messages.len() as u32 | u32::from(self.full) << 3 | u32::from(self.overrun) << 4
    }
}

fn set_up(can: &mut BxCan, banks: &[Bank], is_locked: bool) {
    let collect =
        |is: fn(&Bank) -> bool| (0..).zip(banks).fold(0, |bits, (n, bank)| bits | u32::from(is(bank)) << n);
    can.write(0, 0x00, 1).unwrap();
    for (offset, value) in [
        (0x204, collect(|bank| bank.is_list)),
        (0x20C, collect(|bank| bank.is_wide)),
        (0x214, collect(|bank| bank.to_fifo_1)),
        (0x21C, collect(|bank| bank.is_active)),
    ] {
        can.write(0, offset, value).unwrap();
    }
    for (n, bank) in (0..).zip(banks) {
        can.write(0, 0x240 + 8 * n, bank.words[0]).unwrap();
        can.write(0, 0x244 + 8 * n, bank.words[1]).unwrap();
    }
    can.write(0, 0x200, 0x0E00).unwrap();
    can.write(0, 0x00, u32::from(is_locked) << 3).unwrap();
    can.advance(u64::MAX);
}

#[test]
fn two_hundred_random_filters_store_random_frames_as_the_manual_says() {
    let (mut overruns, mut accepted, mut rejected) = (0, 0, 0);
    for seed in 0..200 {
        let mut random = Random(seed);
        let banks: Vec<_> = (0..14).map(|_| Bank::random(&mut random)).collect();
        let is_locked = random.below(2) == 1;
        let mut can = BxCan::new();
        set_up(&mut can, &banks, is_locked);
        let mut fifos = [Pending::default(), Pending::default()];
        for step in 0..100 {
            let frame = Fields::random(&mut random);
            can.receive(0, &frame.wire());
            match stored(&banks, &frame) {
                Some((fifo, index)) => fifos[usize::from(fifo)].store(frame, index, is_locked),
                None => rejected += 1,
            }
            for (n, fifo) in (0..).zip(&mut fifos) {
                let story = format!("seed {seed}, step {step}, FIFO {n}, {frame:?}");
                assert_eq!(can.read(0x0C + 4 * n), Some(fifo.status()), "RFR, {story}");
                if let Some((frame, index)) = fifo.messages.first() {
                    let [rir, rdtr, low, high] =
                        [0, 4, 8, 12].map(|offset| can.read(0x1B0 + 0x10 * n + offset).unwrap());
                    let (expected, code, data) = frame.mailbox();
                    assert_eq!(rir, expected, "RIR, {story}");
                    assert_eq!(rdtr & 0xFFFF, index << 8 | code, "RDTR, {story}");
                    assert_eq!(u64::from(high) << 32 | u64::from(low), data, "data, {story}");
                }
                // Software reads now and then, and acknowledges what it saw, or not.
                let value = if random.below(2) == 0 { 0 } else { random.below(64) };
                can.write(0, 0x0C + 4 * n, value).unwrap();
                fifo.full &= value & 1 << 3 == 0;
                overruns += u32::from(fifo.overrun && value & 1 << 4 != 0);
                fifo.overrun &= value & 1 << 4 == 0;
                if value & 1 << 5 != 0 && !fifo.messages.is_empty() {
                    fifo.messages.remove(0);
                    accepted += 1;
                }
            }
        }
    }
    assert!(overruns > 100 && accepted > 1_000 && rejected > 100, "{overruns}, {accepted}, {rejected}");
}
