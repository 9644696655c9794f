//! What nobody can guess: tokens, nonces, the name of a run.

use std::fs::File;
use std::io::Read as _;

/// 128 bits that nobody can guess, as hexadecimal digits.
///
/// # Panics
/// The system gives no random bytes: then nothing here would be safe.
pub(crate) fn unpredictable() -> String {
    let mut bytes = [0_u8; 16];
    let read = File::open("/dev/urandom").and_then(|mut source| source.read_exact(&mut bytes));
    assert!(read.is_ok(), "the system gives no random bytes at /dev/urandom");
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_drawn_twice() {
        assert_ne!(unpredictable(), unpredictable());
    }
}
