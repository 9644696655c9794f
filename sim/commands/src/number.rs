//! Numbers of the command line, with bounds that a refusal names.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Takes a number within these bounds, for clap's `value_parser`.
pub fn within<T>(bounds: RangeInclusive<T>) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync
where
    T: FromStr + PartialOrd + Display + Clone + Send + Sync,
{
    move |text| {
        let number = text.parse().ok().filter(|number| bounds.contains(number));
        number.ok_or_else(|| format!("must be from {} to {}", bounds.start(), bounds.end()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_named_whatever_is_wrong() {
        assert_eq!(within(1..=100_u8)("100"), Ok(100));
        for wrong in ["0", "101", "-1", "1.5", "x", "", "99999999999999999999"] {
            assert_eq!(within(1..=100_u8)(wrong).unwrap_err(), "must be from 1 to 100");
        }
        assert_eq!(within(0.0..=1.0)("1e-3"), Ok(1e-3));
        for wrong in ["-0.5", "1.1", "nan", "inf"] {
            assert_eq!(within(0.0..=1.0)(wrong).unwrap_err(), "must be from 0 to 1");
        }
    }
}
