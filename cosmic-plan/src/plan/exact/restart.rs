//! When the complete search starts again, with all that it has learned.

/// The sequence 1 1 2 1 1 2 4 ..., with which restarts are optimal up to a constant.
pub(super) fn luby(mut at: u64) -> u64 {
    loop {
        let power = u64::BITS - at.leading_zeros();
        if at == (1 << power) - 1 {
            return 1 << (power - 1);
        }
        at -= (1 << (power - 1)) - 1;
    }
}

#[cfg(test)]
mod tests {
    use super::luby;

    #[test]
    fn the_sequence() {
        let sequence: Vec<u64> = (1..=15).map(luby).collect();
        assert_eq!(sequence, [1, 1, 2, 1, 1, 2, 4, 1, 1, 2, 1, 1, 2, 4, 8]);
    }
}
