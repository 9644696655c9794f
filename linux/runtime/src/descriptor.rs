//! File descriptors that tokio waits for.

use std::io;
use std::os::fd::OwnedFd;

use tokio::io::unix::AsyncFd;

/// Has tokio watch a descriptor, which must be non-blocking.
pub(crate) fn watched(descriptor: OwnedFd) -> io::Result<AsyncFd<OwnedFd>> {
    // SAFETY: the descriptor is owned by what is returned, which takes it out of the poll before it closes it, and an
    // `OwnedFd` always shows the same descriptor.
    unsafe { AsyncFd::register(descriptor) }.map_err(Into::into)
}
