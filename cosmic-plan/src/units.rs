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
    let text = text.trim();
    let split = text.find(|c: char| !(c.is_ascii_digit() || c == '.' || c == '_'))?;
    let (number, unit) = text.split_at(split);
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
    let number: String = number.chars().filter(|c| *c != '_').collect();
    let (whole, fraction) = number.split_once('.').unwrap_or((&number, ""));
    let fraction = fraction.trim_end_matches('0');
    let digits_only = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if whole.is_empty() || !digits_only(whole) || !digits_only(fraction) {
        return None;
    }
    let missing = exponent.checked_sub(u32::try_from(fraction.len()).ok()?)?;
    format!("{whole}{fraction}").parse::<u64>().ok()?.checked_mul(10_u64.checked_pow(missing)?)
}

/// The bit rate that `text` says: `"1 Mbit/s"`, `"500 kbit/s"`, `"125000"` (bits per second).
pub fn parse_bits_per_second(text: &str) -> Option<u32> {
    let text = text.trim();
    let split = text.find(|c: char| !(c.is_ascii_digit() || c == '.' || c == '_')).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
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
        for wrong in ["", "10", "ms", "-1 ms", "1.5 ns", "1e3 ms", "10 min", "2000000 s", "1.2.3 ms"] {
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
