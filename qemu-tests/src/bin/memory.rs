//! `cosmic-mem` copies, moves and sets as byte by byte: each length, alignment and overlap that has a case of its own.
#![no_std]
#![no_main]

use core::hint::black_box;
use core::ptr::read_volatile;

use cosmic_mem as _;
use qemu_tests::mono::Mono;
use qemu_tests::{pass, println};

const ROOM: usize = 64;
const LONGEST: usize = 21;

#[cortex_m_rt::entry]
fn main() -> ! {
    Mono::start();
    println!("copied: {} cases", moved(|to, from| to.abs_diff(from) >= LONGEST));
    println!("moved: {} cases", moved(|to, from| to.abs_diff(from) < LONGEST));
    println!("set: {} cases", set());
    pass()
}

/// No two neighbours are equal.
fn numbered() -> [u8; ROOM] {
    core::array::from_fn(|at| at as u8 ^ 0xA5)
}

fn moved(wanted: impl Fn(usize, usize) -> bool) -> u32 {
    let mut cases = 0;
    for to in 0..ROOM - LONGEST {
        for from in 0..ROOM - LONGEST {
            for len in (0..=LONGEST).filter(|_| wanted(to, from)) {
                let (before, mut now) = (numbered(), numbered());
                let base = black_box(now.as_mut_ptr());
                // SAFETY: both ranges are within the array, which nothing else uses.
                unsafe {
                    if to.abs_diff(from) >= LONGEST {
                        core::ptr::copy_nonoverlapping(base.add(from), base.add(to), black_box(len));
                    } else {
                        core::ptr::copy(base.add(from), base.add(to), black_box(len));
                    }
                }
                for at in 0..ROOM {
                    let is_copied = (to..to + len).contains(&at);
                    let expected = if is_copied { before[at - to + from] } else { before[at] };
                    assert!(seen(&now, at) == expected, "{} bytes from {} to {}: byte {}", len, from, to, at);
                }
                cases += 1;
            }
        }
    }
    cases
}

fn set() -> u32 {
    let mut cases = 0;
    for to in 0..8 {
        for len in 0..=LONGEST {
            for value in [0, 0xC3] {
                let mut now = numbered();
                // SAFETY: the range is within the array.
                unsafe {
                    core::ptr::write_bytes(
                        black_box(now.as_mut_ptr()).add(to),
                        black_box(value),
                        black_box(len),
                    )
                };
                for (at, before) in numbered().into_iter().enumerate() {
                    let expected = if (to..to + len).contains(&at) { value } else { before };
                    assert!(seen(&now, at) == expected, "{} bytes of {} at {}: byte {}", len, value, to, at);
                }
                cases += 1;
            }
        }
    }
    cases
}

fn seen(bytes: &[u8; ROOM], at: usize) -> u8 {
    // SAFETY: a reference to a byte.
    unsafe { read_volatile(&raw const bytes[at]) }
}
