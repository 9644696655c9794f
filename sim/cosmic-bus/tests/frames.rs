//! The bits of frames: literal ones, and all against a second implementation that goes bit by bit.

mod common;

use common::{extended, remote, standard};
use cosmic_bus::{Field, WireFrame};
use cosmic_core::can::longest_frame_bits;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use proptest::prelude::*;

/// CRC delimiter, acknowledge slot as the transmitter sends it, acknowledge delimiter, end of frame.
const TAIL: &str = "1111111111";

#[test]
fn the_frame_of_zeros() {
    // 19 bits of zeros up to the data length code, and the CRC-15 of zeros is zero: 34 zeros, so six runs
    // of five, each with its stuff bit, and four more.
    let frame = standard(0, &[]);
    let bits = format!("{}0000{TAIL}", "000001".repeat(6));
    assert_eq!(frame.wire_bits().to_string(), bits);
    assert_eq!(frame.bit_count(), 50);
}

#[test]
fn a_standard_data_frame() {
    // SOF 0, identifier 000000(1)10100 with a stuff bit behind the fifth zero, RTR IDE r0 000, length
    // code 0001, data 00000001, CRC 001001111011101 plus its stuff bits.
    let frame = standard(0x014, &[0x01]);
    let bits = "000001001010000010001000001001111011101010011";
    assert_eq!(frame.wire_bits().to_string(), format!("{bits}{TAIL}"));
    assert_eq!(frame.bit_count(), 55);
}

#[test]
fn the_shortest_frame_has_no_stuff_bits() {
    // 0 01010101010 1 0 0 0101 and the CRC.
    let frame = remote(StandardId::new(0x2AA).unwrap(), 5);
    assert_eq!(frame.wire_bits().to_string(), format!("0010101010101000101010111011110000{TAIL}"));
    assert_eq!(frame.bit_count(), 44);
}

#[test]
fn an_extended_data_frame() {
    let frame = extended(0x1F5F_C004, &[1, 2, 3, 4, 5, 6, 7, 8]);
    let bits = "011111001011111011110000010000010100000110000010000011000001010000010011000001100000\
                10010100000111000001011100001000111011110101001";
    assert_eq!(frame.wire_bits().to_string(), format!("{bits}{TAIL}"));
    assert_eq!(frame.bit_count(), 141);
}

#[test]
fn a_frame_that_refutes_the_formula_of_1994() {
    // That formula allows 154 bits, the three of intermission included.
    let frame = extended(0x000D_F0F4, &[0x3C; 8]);
    assert_eq!(frame.bit_count() + 3, 157);
}

#[test]
fn a_length_code_above_eight_is_on_the_wire() {
    let eight = extended(0x1F5F_C004, &[1, 2, 3, 4, 5, 6, 7, 8]);
    let fifteen = eight.with_length_code(15).unwrap();
    let [eight, fifteen] = [eight, fifteen].map(|frame| frame.wire_bits().to_string());
    // Arbitration and reserved bits, the last five of them zeros.
    let head = "01111100101111101111000001000001010000";
    let (eight, fifteen) = (eight.strip_prefix(head).unwrap(), fifteen.strip_prefix(head).unwrap());
    // Zero, a stuff bit, the code, and the first byte; the ones of the code have a stuff bit too.
    assert!(eight.starts_with("0110000010"), "{eight}");
    assert!(fifteen.starts_with("011111000001000"), "{fifteen}");
}

#[test]
fn fields_stand_where_the_standard_puts_them() {
    let bits = standard(0x014, &[0x01]).wire_bits();
    let field = |bit| bits.field(bit);
    assert_eq!(field(0), Some(Field::StartOfFrame));
    assert_eq!(field(1), Some(Field::Arbitration));
    assert_eq!(field(13), Some(Field::Arbitration));
    assert_eq!(field(14), Some(Field::Control));
    assert_eq!(bits.len(), 55);
    assert_eq!(field(44), Some(Field::Crc));
    assert_eq!(field(45), Some(Field::CrcDelimiter));
    assert_eq!(field(46), Some(Field::AcknowledgeSlot));
    assert_eq!(field(47), Some(Field::AcknowledgeDelimiter));
    assert_eq!(field(48), Some(Field::EndOfFrame));
    assert_eq!(field(54), Some(Field::EndOfFrame));
    assert_eq!(field(55), None);
}

/// The frame bit by bit, as the standard describes it.
fn by_the_book(frame: &WireFrame) -> String {
    let mut bits = vec![0];
    let mut push = |value: u64, width: u32| bits.extend((0..width).rev().map(|bit| (value >> bit & 1) as u8));
    let rtr = u64::from(frame.is_remote_frame());
    match frame.id() {
        Id::Standard(id) => {
            push(u64::from(id.as_raw()), 11);
            push(rtr << 2, 3);
        }
        Id::Extended(id) => {
            push(u64::from(id.as_raw() >> 18), 11);
            push(0b11, 2);
            push(u64::from(id.as_raw()) & 0x3_FFFF, 18);
            push(rtr << 2, 3);
        }
    }
    push(u64::from(frame.length_code()), 4);
    frame.data().iter().for_each(|byte| push(u64::from(*byte), 8));
    let crc = bits.iter().fold(0_u16, |crc, bit| {
        let shifted = crc << 1 & 0x7FFF;
        if u16::from(*bit) ^ crc >> 14 == 1 { shifted ^ 0x4599 } else { shifted }
    });
    bits.extend((0..15).rev().map(|bit| (crc >> bit & 1) as u8));
    let mut stuffed = String::new();
    for bit in bits {
        stuffed.push(if bit == 1 { '1' } else { '0' });
        if stuffed.ends_with("00000") {
            stuffed.push('1');
        } else if stuffed.ends_with("11111") {
            stuffed.push('0');
        }
    }
    stuffed + TAIL
}

/// Frames of every kind, with many long runs of equal bits.
fn any_frame() -> impl Strategy<Value = WireFrame> {
    let runs = prop_oneof![any::<u8>(), Just(0x00), Just(0xFF), Just(0x0F), Just(0x3C), Just(0x87)];
    let id = prop_oneof![
        (0..=0x7FF_u16).prop_map(|id| Id::Standard(StandardId::new(id).unwrap())),
        (0..=0x1FFF_FFFF_u32).prop_map(|id| Id::Extended(ExtendedId::new(id).unwrap())),
        prop::sample::select(vec![0, 0x1FFF_FFFF, 0x000D_F0F4, 0x0FC0_F83E])
            .prop_map(|id| Id::Extended(ExtendedId::new(id).unwrap())),
    ];
    let data = prop::collection::vec(runs, 0..=8);
    let code = 9..=15_u8;
    (id, data, prop::bool::weighted(0.1), code).prop_map(|(id, data, is_remote, code)| {
        let frame = if is_remote { WireFrame::new_remote(id, data.len()) } else { WireFrame::new(id, &data) };
        let frame = frame.unwrap();
        // Eight bytes may have another code.
        if data[..].first() < Some(&0x80) { frame } else { frame.with_length_code(code).unwrap_or(frame) }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]

    #[test]
    fn bits_and_length_are_those_of_the_standard(frame in any_frame()) {
        let bits = by_the_book(&frame);
        prop_assert_eq!(frame.wire_bits().to_string(), &bits[..]);
        prop_assert_eq!(frame.bit_count() as usize, bits.len());
    }

    #[test]
    fn no_frame_is_longer_than_the_core_plans_for(frame in any_frame()) {
        // The formula is that of extended data frames; the others are shorter.
        prop_assert!(frame.bit_count() + 3 <= longest_frame_bits(frame.data().len()));
    }
}
