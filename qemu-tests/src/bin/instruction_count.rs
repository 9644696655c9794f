//! The instruction counter counts exactly, and says so when it cannot.
//!
//! What is counted here is written in assembly, so the numbers are the same with every compiler. The
//! counts of the core's own calls go to standard error.
#![no_std]
#![no_main]

use core::arch::asm;
use core::hint::black_box;

use cosmic_core::can::{BitRate, Etag, Id, Payload, Priority, TxNode};
use qemu_tests::count::{self, Count};
use qemu_tests::mono::Mono;
use qemu_tests::{measured, pass, println};

macro_rules! nops {
    ($count:literal) => {
        // SAFETY: does nothing.
        unsafe { asm!(concat!(".rept ", $count), "nop", ".endr") }
    };
}

#[cortex_m_rt::entry]
fn main() -> ! {
    Mono::start();
    print("nothing", count::instructions(|| ()));
    print("1 nop", count::instructions(|| nops!(1)));
    print("4 nops", count::instructions(|| nops!(4)));
    print("5 nops", count::instructions(|| nops!(5)));
    print("203 nops", count::instructions(|| nops!(203)));
    print("loop of 100000 * 2 + 3", count::instructions(loop_200_003));
    let mut runs = 0;
    let uneven = count::instructions(|| {
        runs += 1;
        if runs % 3 == 0 {
            loop_200_003();
        }
    });
    println!("uneven: exact {}", uneven.exact);
    println!("runs: {}", runs == count::RUNS);
    core_calls();
    pass()
}

fn print(name: &str, Count { instructions, exact }: Count) {
    println!("{name}: {instructions}, exact {exact}");
}

fn loop_200_003() {
    // SAFETY: changes nothing but the register. (100,000 is 0x186A0.)
    unsafe {
        asm!("movw {n}, #0x86A0", "movt {n}, #1", "2:", "subs {n}, {n}, #1", "bne 2b", "nop", n = out(reg) _)
    }
}

fn core_calls() {
    measure("put an identifier together", || {
        black_box(Id::new(black_box(Priority::LEAST), black_box(TxNode::MAX), black_box(Etag::SYNC)));
    });
    let bytes = [1, 2, 3, 4, 5, 6, 7, 8];
    measure("copy a payload", || {
        black_box(Payload::new(black_box(&bytes)));
    });
    measure("longest frame time", || {
        black_box(black_box(BitRate::MAX).longest_frame(black_box(8)));
    });
}

fn measure(name: &str, code: impl FnMut()) {
    let Count { instructions, exact } = count::instructions(code);
    measured!("{name}: {instructions} instructions, exact {exact}");
}
