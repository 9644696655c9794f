//! Reading files of which nobody knows how long they are.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

/// No description is longer: a file that goes on behind this is none, such as a device without an end.
pub const LONGEST: u64 = 64 << 20;

/// The bytes of a file.
///
/// # Errors
/// It cannot be read, or has more than [`LONGEST`] bytes.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(LONGEST + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LONGEST {
        let what = format!("it has more than {} MiB", LONGEST >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, what));
    }
    Ok(bytes)
}

/// The text of a file.
///
/// # Errors
/// As [`read`], or it is no text.
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read(path)?;
    String::from_utf8(bytes).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is no text in UTF-8"))
}

/// Text of which the character set is not known: UTF-8 if it can be, else Windows-1252, as DBC files have it.
pub fn decode(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|byte| char::from(*byte)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_an_end_is_refused() {
        let error = read(Path::new("/dev/zero")).unwrap_err();
        assert_eq!(error.to_string(), "it has more than 64 MiB");
        assert!(read_text(Path::new("/no/such/file")).is_err());
    }

    #[test]
    fn both_character_sets_are_read() {
        assert_eq!(decode(&[0xB0, b'C']), "°C");
        assert_eq!(decode("°C".as_bytes()), "°C");
    }
}
