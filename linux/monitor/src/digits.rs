//! Numbers as a person writes and reads them.

/// A number of up to 16 hexadecimal digits, behind `0x` or alone. Nothing else than digits: no sign, no space.
///
/// ```
/// use cosmic_monitor::hexadecimal;
///
/// assert_eq!([hexadecimal("0x2A"), hexadecimal("2a"), hexadecimal("0x+5")], [Some(0x2A), Some(0x2A), None]);
/// ```
pub fn hexadecimal(text: &str) -> Option<u64> {
    let digits = text.strip_prefix("0x").unwrap_or(text);
    digits.bytes().all(|byte| byte.is_ascii_hexdigit()).then(|| u64::from_str_radix(digits, 16).ok())?
}

/// Bytes as pairs of hexadecimal digits.
pub fn hex_text(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}
