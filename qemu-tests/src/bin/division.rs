//! `cosmic-mem` divides: what it gives is right for each pair of numbers at whose bits something begins or ends.
#![no_std]
#![no_main]

use core::hint::black_box;

use cosmic_mem as _;
use qemu_tests::mono::Mono;
use qemu_tests::{pass, println};

#[cortex_m_rt::entry]
fn main() -> ! {
    Mono::start();
    println!("unsigned: {} cases", unsigned());
    println!("signed: {} cases", signed());
    pass()
}

/// Each power of two, what is beside it, and that with all bits flipped.
fn numbers() -> impl Iterator<Item = u64> + Clone {
    let near = |shift: u32| {
        let power = 1_u64 << shift;
        [power.wrapping_sub(1), power, power.wrapping_add(1)]
    };
    (0..u64::BITS).flat_map(near).flat_map(|number| [number, !number])
}

fn unsigned() -> u32 {
    let mut cases = 0;
    for dividend in numbers() {
        for divisor in numbers().filter(|divisor| *divisor != 0) {
            let (by, of) = (black_box(divisor), black_box(dividend));
            let (quotient, rest) = (of / by, of % by);
            let whole = quotient.checked_mul(divisor).and_then(|part| part.checked_add(rest));
            assert!(whole == Some(dividend) && rest < divisor, "{} / {}: {}", dividend, divisor, quotient);
            cases += 1;
        }
    }
    cases
}

fn signed() -> u32 {
    let mut cases = 0;
    for dividend in numbers().map(u64::cast_signed) {
        for divisor in numbers().map(u64::cast_signed).filter(|divisor| *divisor != 0) {
            let Some(quotient) = black_box(dividend).checked_div(black_box(divisor)) else { continue };
            let Some(rest) = black_box(dividend).checked_rem(black_box(divisor)) else { continue };
            let whole = quotient.checked_mul(divisor).and_then(|part| part.checked_add(rest));
            let is_rest =
                rest.unsigned_abs() < divisor.unsigned_abs() && (rest == 0 || (rest < 0) == (dividend < 0));
            assert!(whole == Some(dividend) && is_rest, "{} / {}: {}", dividend, divisor, quotient);
            cases += 1;
        }
    }
    cases
}
