//! Exact decimals: scales, offsets and ranges as people write them.

use std::fmt;

/// A decimal number: `mantissa / 10^exponent`, with no more zeros than it needs.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Decimal {
    mantissa: i128,
    exponent: u32,
}

impl Decimal {
    /// Zero.
    pub const ZERO: Self = Self { mantissa: 0, exponent: 0 };
    /// One.
    pub const ONE: Self = Self { mantissa: 1, exponent: 0 };
    /// So many digits stand behind the point at most.
    pub const MOST_PLACES: u32 = 18;

    /// `mantissa / 10^exponent`.
    pub fn new(mantissa: i128, exponent: u32) -> Self {
        let (mut mantissa, mut exponent) = (mantissa, exponent);
        while exponent > 0 && mantissa % 10 == 0 {
            mantissa /= 10;
            exponent -= 1;
        }
        Self { mantissa, exponent }
    }

    /// The number that `text` says: `"-40"`, `"0.01"`, `"1e-3"`, `"1_000"`. `None` if it is none, has more than
    /// 18 digits, or more than [`Decimal::MOST_PLACES`] behind the point.
    pub fn parse(text: &str) -> Option<Self> {
        let text: String = text.trim().chars().filter(|c| *c != '_').collect();
        let (number, power) = match text.split_once(['e', 'E']) {
            Some((number, power)) => (number, power.parse::<i32>().ok().filter(|p| p.abs() <= 40)?),
            None => (text.as_str(), 0),
        };
        let (negative, digits) = match number.strip_prefix('-') {
            Some(digits) => (true, digits),
            None => (false, number.strip_prefix('+').unwrap_or(number)),
        };
        let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
        let all = format!("{whole}{fraction}");
        if whole.is_empty() || !all.bytes().all(|b| b.is_ascii_digit()) {
            return None;
        }
        let significant = all.trim_start_matches('0').trim_end_matches('0');
        let trailing = all.len() - all.trim_end_matches('0').len();
        if significant.is_empty() {
            return Some(Self::ZERO);
        }
        if significant.len() > 18 {
            return None;
        }
        let mantissa: i128 = significant.parse().ok()?;
        let mantissa = if negative { -mantissa } else { mantissa };
        let power = power + i32::try_from(trailing).ok()? - i32::try_from(fraction.len()).ok()?;
        match u32::try_from(power) {
            Ok(power) if power <= 18 => Some(Self::new(mantissa * 10_i128.pow(power), 0)),
            Ok(_) => None,
            Err(_) => Some(Self::new(mantissa, power.unsigned_abs()))
                .filter(|decimal| decimal.exponent <= Self::MOST_PLACES),
        }
    }

    /// The mantissa.
    pub fn mantissa(self) -> i128 {
        self.mantissa
    }

    /// How many digits stand behind the point.
    pub fn exponent(self) -> u32 {
        self.exponent
    }

    /// The number times `10^exponent`; `None` if that is no whole number, or too large.
    pub fn scaled_to(self, exponent: u32) -> Option<i128> {
        let missing = exponent.checked_sub(self.exponent)?;
        self.mantissa.checked_mul(10_i128.checked_pow(missing)?)
    }

    /// The nearest number in floating point.
    pub fn as_f64(self) -> f64 {
        if self.exponent == 0 || self.mantissa.unsigned_abs() < 1 << 53 && self.exponent <= 22 {
            // Both numbers are exact, so the quotient is rounded once.
            self.mantissa as f64 / 10_f64.powi(self.exponent as i32)
        } else {
            self.to_string().parse().unwrap_or(f64::NAN)
        }
    }
}

impl fmt::Display for Decimal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = self.mantissa.unsigned_abs().to_string();
        let places = self.exponent as usize;
        let text = if places == 0 {
            digits
        } else {
            let digits = format!("{digits:0>width$}", width = places + 1);
            let (whole, fraction) = digits.split_at(digits.len() - places);
            format!("{whole}.{fraction}")
        };
        f.pad_integral(self.mantissa >= 0, "", &text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_are_exact() {
        for (text, shown) in [
            ("0.01", "0.01"),
            ("-40", "-40"),
            ("1e-3", "0.001"),
            ("2.50", "2.5"),
            ("1_000", "1000"),
            ("-0.5", "-0.5"),
            ("12e2", "1200"),
            ("0.0", "0"),
            ("+7", "7"),
        ] {
            let decimal = Decimal::parse(text).unwrap_or_else(|| panic!("{text}"));
            assert_eq!(decimal.to_string(), shown);
            assert_eq!(decimal.as_f64(), text.replace('_', "").parse::<f64>().unwrap());
        }
        for wrong in ["", "-", ".5", "1.2.3", "abc", "1e99", "0x10", "1234567890123456789", "inf", "1e-19"] {
            assert_eq!(Decimal::parse(wrong), None, "{wrong}");
        }
        assert_eq!(Decimal::new(3, 1).as_f64(), 0.3);
    }
}
