//! Files that are there whole or not at all.
//!
//! Each is written under another name beside its place and renamed when everything is done. What is not
//! finished is removed. What is no regular file, such as `/dev/null` or a pipe, is written where it stands.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};

use thiserror::Error;

/// A file cannot be written.
#[derive(Error, Debug)]
#[error("{}: cannot be written ({error}); {remedy}", path.display())]
pub struct OutputError {
    path: PathBuf,
    error: io::Error,
    remedy: &'static str,
}

/// A file that is being written.
#[derive(Debug)]
pub struct Pending {
    path: PathBuf,
    /// Its name until then, if it has one of its own.
    unfinished: Option<PathBuf>,
    writer: Option<BufWriter<File>>,
}

/// Makes a directory, with those above it, unless it is there.
///
/// # Errors
/// [`OutputError`], if it cannot be made.
pub fn directory(path: &Path) -> Result<(), OutputError> {
    let fail = |error| OutputError { path: path.into(), error, remedy: "name another directory with --out" };
    fs::create_dir_all(path).map_err(fail)
}

impl Pending {
    /// Starts a file that is to stand at `path`. `remedy` says what to do if that cannot be.
    ///
    /// # Errors
    /// [`OutputError`], if it cannot be created.
    pub fn create(path: impl Into<PathBuf>, remedy: &'static str) -> Result<Self, OutputError> {
        let path = path.into();
        let fail = |path: &Path, error| OutputError { path: path.into(), error, remedy };
        let Some(name) = path.file_name().filter(|_| !path.is_dir()) else {
            return Err(fail(&path, io::Error::from(io::ErrorKind::IsADirectory)));
        };
        let is_special = path.metadata().is_ok_and(|metadata| !metadata.is_file());
        let unfinished = (!is_special).then(|| {
            let mut unfinished = name.to_owned();
            unfinished.push(".unfinished");
            path.with_file_name(unfinished)
        });
        let file = File::create(unfinished.as_ref().unwrap_or(&path)).map_err(|error| fail(&path, error))?;
        Ok(Self { path, unfinished, writer: Some(BufWriter::new(file)) })
    }

    /// Where it will stand.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All has been written: gives the file its name.
    ///
    /// # Errors
    /// [`OutputError`], if the disk is full, or the file cannot be renamed.
    pub fn finish(mut self) -> Result<PathBuf, OutputError> {
        let done = self.flush().and_then(|()| {
            self.writer = None;
            self.unfinished.as_ref().map_or(Ok(()), |unfinished| fs::rename(unfinished, &self.path))
        });
        let remedy = "make room, or choose another place";
        done.map_err(|error| OutputError { path: self.path.clone(), error, remedy })?;
        Ok(self.path.clone())
    }
}

impl io::Write for Pending {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.as_mut().map_or(Ok(0), |writer| writer.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.as_mut().map_or(Ok(()), BufWriter::flush)
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        self.writer = None;
        // After `finish` it is not there any more. There is nobody left to hear of another failure.
        if let Some(unfinished) = &self.unfinished {
            let _ = fs::remove_file(unfinished);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An empty directory of this test's own.
    fn fresh(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("cosmic-output-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        directory(&path).unwrap();
        path
    }

    #[test]
    fn a_finished_file_is_there_and_nothing_else() {
        let at = fresh("finished");
        let mut file = Pending::create(at.join("a.txt"), "").unwrap();
        file.write_all(b"whole").unwrap();
        assert!(!at.join("a.txt").exists());
        file.finish().unwrap();
        assert_eq!(fs::read(at.join("a.txt")).unwrap(), b"whole");
        assert_eq!(fs::read_dir(&at).unwrap().count(), 1);
        fs::remove_dir_all(at).unwrap();
    }

    #[test]
    fn an_unfinished_file_leaves_nothing() {
        let at = fresh("unfinished");
        fs::write(at.join("a.txt"), "before").unwrap();
        let mut file = Pending::create(at.join("a.txt"), "").unwrap();
        file.write_all(b"half").unwrap();
        drop(file);
        assert_eq!(fs::read(at.join("a.txt")).unwrap(), b"before");
        assert_eq!(fs::read_dir(&at).unwrap().count(), 1);
        fs::remove_dir_all(at).unwrap();
    }

    #[test]
    #[cfg(unix)]
    fn a_device_is_written_and_not_replaced() {
        use std::os::unix::fs::FileTypeExt as _;
        let mut file = Pending::create("/dev/null", "").unwrap();
        file.write_all(b"text").unwrap();
        assert_eq!(file.unfinished, None);
        file.finish().unwrap();
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    }

    #[test]
    fn a_place_that_is_none_is_named_in_one_line() {
        let at = fresh("none");
        fs::write(at.join("file"), "").unwrap();
        let error = directory(&at.join("file/below")).unwrap_err().to_string();
        assert!(error.contains("file/below") && error.contains("--out"), "{error}");
        let error = Pending::create(&at, "choose a file").unwrap_err().to_string();
        assert!(error.contains("choose a file") && !error.contains('\n'), "{error}");
        fs::remove_dir_all(at).unwrap();
    }
}
