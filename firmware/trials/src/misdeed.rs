//! Ways to hang.

use core::future::pending;

use cosmic_rtic::prelude::*;

/// What a node does wrong.
#[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
pub enum Misdeed {
    /// Nothing.
    None,
    /// The application waits for what never comes.
    Waits,
    /// The application turns in circles.
    Spins,
    /// The application keeps the node locked, so that the event task stands still.
    Locks,
    /// All interrupts are masked, for good.
    Masks,
    /// A fault.
    Faults,
    /// The stack outgrows its place.
    Overflows,
    /// All interrupts are masked, for so many microseconds.
    Pauses(u32),
}

impl Misdeed {
    /// As the first byte of the part's unique identifier says (RM0090, 39.1).
    pub fn of_this_part() -> Self {
        // SAFETY: the identifier is in the system memory of each part.
        match unsafe { UNIQUE_ID.read_volatile() } {
            b'W' => Self::Waits,
            b'S' => Self::Spins,
            b'L' => Self::Locks,
            b'M' => Self::Masks,
            b'F' => Self::Faults,
            b'O' => Self::Overflows,
            // Short of, and beyond, what a FIFO of three holds of frames of a tenth of a millisecond.
            b'3' => Self::Pauses(280),
            b'4' => Self::Pauses(900),
            _ => Self::None,
        }
    }

    /// Does it.
    pub async fn commit<T: System>(self, node: &mut impl Mutex<T = Node<T>>) {
        if self != Self::None {
            defmt::info!("misbehaves: {}", self);
        }
        match self {
            Self::None => {}
            Self::Waits => pending().await,
            Self::Spins => turn_in_circles(),
            Self::Locks => node.lock(|_| turn_in_circles()),
            Self::Masks => {
                cortex_m::interrupt::disable();
                turn_in_circles()
            }
            Self::Faults => cortex_m::asm::udf(),
            Self::Overflows => overflow(0),
            Self::Pauses(us) => {
                let end = T::Board::now() + Duration::from_micros(us.into());
                cortex_m::interrupt::free(|_| while T::Board::now() < end {});
            }
        }
    }
}

fn turn_in_circles() -> ! {
    loop {
        cortex_m::asm::nop();
    }
}

/// Calls itself without end.
#[inline(never)]
#[expect(unconditional_recursion, reason = "that is the misdeed")]
fn overflow(depth: u32) {
    let mut place = [depth; 64];
    // What it puts on the stack is seen from outside, so that it must be there, and after the call, too.
    core::hint::black_box(&mut place);
    overflow(depth + 1);
    core::hint::black_box(&mut place);
}

const UNIQUE_ID: *const u8 = 0x1FFF_7A10 as *const u8;
