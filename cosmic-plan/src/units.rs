//! Spans of time, bit rates and numbers as people write them.
//!
//! Time is written with its unit (`"2.5 ms"`, `"250us"`), so that no bare number is ever misread. All
//! values are exact: decimals are scaled to nanoseconds without floating point.

use cosmic_core::can::BitRate;
use cosmic_core::time::Duration;

const UNITS: [(&str, u32); 6] = [("ns", 0), ("us", 3), ("µs", 3), ("μs", 3), ("ms", 6), ("s", 9)];

/// The power of ten of nanoseconds in a unit of time (`"us"` is 3); `None` for an unknown unit.
pub fn unit_exponent(unit: &str) -> Option<u32> {
    UNITS.iter().find(|(name, _)| *name == unit).map(|&(_, exponent)| exponent)
}

/// The span that `text` says, a decimal with a unit: `"10 ms"`, `"2.5ms"`, `"250 us"`.
///
/// `None` if it is none, finer than a nanosecond, or longer than [`LONGEST_SPAN`].
pub fn parse_span(text: &str) -> Option<Duration> {
    let (number, unit) = split_number(text.trim())?;
    parse_ticks(number, unit_exponent(unit.trim())?).map(Duration::from_ticks)
}

/// The longest span that is read, about eleven days: far beyond any period, and sums of such spans do not
/// overflow.
pub const LONGEST_SPAN: Duration = Duration::from_secs(1_000_000);

/// A span in nanoseconds, from a number and the power of ten of its unit; `None` as for [`parse_span`].
pub fn parse_ticks(number: &str, exponent: u32) -> Option<u64> {
    parse_decimal(number, exponent).filter(|ticks| *ticks <= LONGEST_SPAN.as_ticks())
}

/// `number`, a decimal without sign, times ten to the `exponent`; `None` if that is no whole number.
pub fn parse_decimal(number: &str, exponent: u32) -> Option<u64> {
    let (digits, places) = decimal_digits(number)?;
    let missing = u32::try_from(i64::from(exponent).checked_sub(places)?).ok()?;
    digits.parse::<u64>().ok()?.checked_mul(10_u64.checked_pow(missing)?)
}

/// A span in nanoseconds, from a number as programs print it: exponents are read, and what is finer than a nanosecond
/// is rounded to the nearest. `None` as for [`parse_span`].
pub fn parse_rounded_ticks(number: &str, exponent: u32) -> Option<u64> {
    let (digits, places) = decimal_digits(number)?;
    let spare = usize::try_from(places.checked_sub(i64::from(exponent))?.max(0)).ok()?;
    if spare == 0 {
        return parse_ticks(number, exponent);
    }
    let kept =
        digits.get(..digits.len().saturating_sub(spare)).filter(|kept| !kept.is_empty()).unwrap_or("0");
    let first_cut = digits.len().checked_sub(spare).and_then(|at| digits.as_bytes().get(at));
    let up = u64::from(first_cut.is_some_and(|digit| *digit >= b'5'));
    kept.parse::<u64>().ok()?.checked_add(up).filter(|ticks| *ticks <= LONGEST_SPAN.as_ticks())
}

/// The digits of a decimal without sign, and how many of them stand behind the point. Zeros at the end are cut off.
fn decimal_digits(number: &str) -> Option<(String, i64)> {
    let number: String = number.chars().filter(|c| *c != '_').collect();
    let (number, power) = match number.split_once(['e', 'E']) {
        Some((number, power)) => (number, power.parse::<i16>().ok()?),
        None => (number.as_str(), 0),
    };
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    let fraction = fraction.trim_end_matches('0');
    let digits_only = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if whole.is_empty() || !digits_only(whole) || !digits_only(fraction) {
        return None;
    }
    let digits = format!("{whole}{fraction}");
    let cut = digits.trim_end_matches('0');
    let places = i64::try_from(fraction.len()).ok()? - i64::try_from(digits.len() - cut.len()).ok()?;
    if cut.is_empty() { Some(("0".to_owned(), 0)) } else { Some((cut.to_owned(), places - i64::from(power))) }
}

/// Whether a text is a span of time that is finer than a nanosecond, so that something else is to be said of it than
/// that it is none.
pub fn is_too_fine(text: &str) -> bool {
    let Some((number, unit)) = split_number(text.trim()) else { return false };
    let parts = (decimal_digits(number), unit_exponent(unit.trim()));
    matches!(parts, (Some((_, places)), Some(exponent)) if places > i64::from(exponent))
}

/// The number in front and what stands behind it.
fn split_number(text: &str) -> Option<(&str, &str)> {
    let is_number = |at: usize, c: char| {
        let power = matches!(c, 'e' | 'E')
            && text[at + 1..].starts_with(|c: char| c.is_ascii_digit() || c == '-' || c == '+');
        let sign = matches!(c, '-' | '+') && text[..at].ends_with(['e', 'E']);
        c.is_ascii_digit() || c == '.' || c == '_' || power || sign
    };
    let split = text.char_indices().find(|&(at, c)| !is_number(at, c))?.0;
    Some(text.split_at(split))
}

/// The bit rate that `text` says: `"1 Mbit/s"`, `"500 kbit/s"`, `"125000"` (bits per second).
pub fn parse_bits_per_second(text: &str) -> Option<u32> {
    let text = text.trim();
    let (number, unit) = split_number(text).unwrap_or((text, ""));
    let exponent = match unit.trim() {
        "" | "bit/s" | "bps" => 0,
        "kbit/s" | "kbps" | "k" => 3,
        "Mbit/s" | "Mbps" | "M" => 6,
        _ => return None,
    };
    u32::try_from(parse_decimal(number, exponent)?).ok()
}

/// A span in the unit that suits it: `"10 ms"`, `"573 µs"`, `"1.25 s"`.
pub fn show(span: Duration) -> String {
    let ticks = span.as_ticks();
    let (unit, exponent) = match ticks {
        0 => return "0".to_owned(),
        1_000_000_000.. => ("s", 9),
        1_000_000.. => ("ms", 6),
        1_000.. => ("µs", 3),
        _ => ("ns", 0),
    };
    format!("{} {unit}", decimal(ticks, exponent))
}

/// A span in microseconds, for tables.
pub fn microseconds(span: Duration) -> String {
    decimal(span.as_ticks(), 3)
}

/// A span in microseconds, for machine-readable reports: exact up to 2^53 ns (104 days).
pub fn as_microseconds(span: Duration) -> f64 {
    span.as_ticks() as f64 / 1000.0
}

/// A bit rate in the unit that suits it.
pub fn show_rate(rate: BitRate) -> String {
    let bits = rate.bits_per_second();
    if bits.is_multiple_of(1_000_000) {
        format!("{} Mbit/s", bits / 1_000_000)
    } else {
        format!("{} kbit/s", decimal(u64::from(bits), 3))
    }
}

fn decimal(value: u64, exponent: u32) -> String {
    let scale = 10_u64.pow(exponent);
    let fraction = format!("{:0width$}", value % scale, width = exponent as usize);
    let fraction = if exponent == 0 { "" } else { fraction.trim_end_matches('0') };
    if fraction.is_empty() { format!("{}", value / scale) } else { format!("{}.{fraction}", value / scale) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_exact() {
        assert_eq!(parse_span("2.5 ms"), Some(Duration::from_micros(2500)));
        assert_eq!(parse_span("250us"), Some(Duration::from_micros(250)));
        assert_eq!(parse_span("1_000 µs"), Some(Duration::from_millis(1)));
        assert_eq!(parse_span("0 s"), Some(Duration::from_ticks(0)));
        assert_eq!(parse_span("1e3 ms"), Some(Duration::from_secs(1)));
        assert_eq!(parse_span("2.5E-3 s"), Some(Duration::from_micros(2500)));
        assert_eq!(parse_span("1500e-3 us"), Some(Duration::from_ticks(1500)));
        assert!(is_too_fine("1.5 ns") && is_too_fine("0.1234567 ms") && is_too_fine("1e-10 s"));
        assert!(!is_too_fine("1.5 us") && !is_too_fine("-1 ms") && !is_too_fine("ns"));
        assert_eq!(parse_rounded_ticks("0.30000000000000004", 6), Some(300_000));
        assert_eq!(parse_rounded_ticks("1.0000005", 6), Some(1_000_001));
        assert_eq!(parse_rounded_ticks("2.5e-3", 6), Some(2500));
        assert_eq!(parse_rounded_ticks("1e-9", 6), Some(0));
        assert_eq!(parse_rounded_ticks("12", 6), Some(12_000_000));
        for wrong in [
            "",
            "10",
            "ms",
            "-1 ms",
            "1.5 ns",
            "1e99 ms",
            "1e-1 ns",
            "e3 ms",
            "10 min",
            "2000000 s",
            "1.2.3 ms",
        ] {
            assert_eq!(parse_span(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn bit_rates() {
        assert_eq!(parse_bits_per_second("1 Mbit/s"), Some(1_000_000));
        assert_eq!(parse_bits_per_second("83.3 kbit/s"), Some(83_300));
        assert_eq!(parse_bits_per_second("125000"), Some(125_000));
        assert_eq!(parse_bits_per_second("fast"), None);
    }

    #[test]
    fn spans_are_shown_in_their_unit() {
        assert_eq!(show(Duration::from_micros(2500)), "2.5 ms");
        assert_eq!(show(Duration::from_ticks(573_040)), "573.04 µs");
        assert_eq!(show(Duration::from_ticks(0)), "0");
        assert_eq!(show(Duration::from_ticks(7)), "7 ns");
        assert_eq!(microseconds(Duration::from_millis(3)), "3000");
        assert_eq!(show_rate(BitRate::MAX), "1 Mbit/s");
    }
}
