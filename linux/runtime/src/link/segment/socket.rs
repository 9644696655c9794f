//! The socket of a segment: bound once, and removed again by whoever has bound it.

use std::fmt;
use std::fs;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};

use tokio::net::{UnixListener, UnixStream};

/// A socket at which a segment can be [served](Socket::serve). Its file goes with it, if it is still the same one.
#[derive(Debug)]
pub struct Socket {
    pub(super) listener: UnixListener,
    path: PathBuf,
    /// Device and number of the file.
    file: Option<(u64, u64)>,
}

/// Why a segment cannot be served.
#[derive(Debug)]
pub struct ServeError {
    path: PathBuf,
    why: String,
}

impl fmt::Display for ServeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "segment at {}: {}", self.path.display(), self.why)
    }
}

impl std::error::Error for ServeError {}

impl Socket {
    /// Makes the socket, inside a runtime of tokio; whoever connects from now on is served as soon as a segment is. What
    /// was left there by a server that is gone is replaced; a server that still answers is not.
    ///
    /// # Errors
    /// Somebody else serves there, or the socket cannot be made.
    pub async fn bind(path: impl Into<PathBuf>) -> Result<Self, ServeError> {
        let path = path.into();
        match bind(&path).await {
            Ok(listener) => Ok(Self { listener, file: file_at(&path), path }),
            Err(why) => Err(ServeError { path, why }),
        }
    }

    pub(super) fn failed(&self, why: String) -> ServeError {
        ServeError { path: self.path.clone(), why }
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        // Another server may have taken the place meanwhile.
        if self.file.is_some() && file_at(&self.path) == self.file {
            let _ = fs::remove_file(&self.path);
        }
    }
}

fn file_at(path: &Path) -> Option<(u64, u64)> {
    fs::symlink_metadata(path).ok().map(|data| (data.dev(), data.ino()))
}

async fn bind(path: &Path) -> Result<UnixListener, String> {
    if let Ok(there) = fs::symlink_metadata(path) {
        if UnixStream::connect(path).await.is_ok() {
            return Err("another server answers there: stop it, or choose another path".to_owned());
        }
        if !there.file_type().is_socket() {
            return Err("there is a file that is no socket: choose another path".to_owned());
        }
        fs::remove_file(path).map_err(|error| format!("the old socket cannot be removed: {error}"))?;
    }
    UnixListener::bind(path).map_err(|error| format!("the socket cannot be made: {error}"))
}
