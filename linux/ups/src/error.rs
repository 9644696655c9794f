//! Errors as C sees them: a number, and a text for each thread.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CString, c_char, c_int};
use std::panic::{AssertUnwindSafe, catch_unwind};

use cosmic_core::event_layer::PublishError;
use cosmic_session::Failure;

use crate::layout;

/// Why a call did not do what it was asked for.
#[derive(Debug)]
pub(crate) struct Error {
    code: c_int,
    text: String,
}

impl Error {
    pub(crate) fn argument(text: impl Into<String>) -> Self {
        Self { code: layout::ERR_ARGUMENT, text: text.into() }
    }

    pub(crate) fn handle(what: &str, handle: u64) -> Self {
        Self { code: layout::ERR_HANDLE, text: format!("there is no {what} {handle}, or it has been closed") }
    }

    pub(crate) fn timeout() -> Self {
        Self { code: layout::ERR_TIMEOUT, text: "no event has come within the time".to_owned() }
    }
}

impl From<Failure> for Error {
    fn from(failure: Failure) -> Self {
        let code = match &failure {
            Failure::Input(_) => layout::ERR_ARGUMENT,
            Failure::Link(_) => layout::ERR_LINK,
            Failure::NotBound(_) | Failure::NotPublished(PublishError::NotBound) => layout::ERR_NOT_BOUND,
            Failure::NotPublished(PublishError::TooLong) => layout::ERR_TOO_LONG,
            Failure::NotPublished(PublishError::Deadline) => layout::ERR_DEADLINE,
            Failure::NotPublished(PublishError::QueueFull) => layout::ERR_QUEUE_FULL,
            Failure::NotPublished(PublishError::TooFast) => layout::ERR_TOO_FAST,
            Failure::Closed => layout::ERR_CLOSED,
            _ => layout::ERR_REFUSED,
        };
        Self { code, text: failure.to_string() }
    }
}

/// Does what a call is for. Keeps the text of an error; a panic is one.
pub(crate) fn guarded(call: impl FnOnce() -> Result<c_int, Error>) -> c_int {
    // What a panic leaves behind is locked by mutexes that are looked at as they are, and holds no invariants over
    // several values.
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(result)) => result,
        Ok(Err(error)) => {
            keep(&error.text);
            error.code
        }
        Err(panic) => {
            keep(&format!("a mistake in this library, please report it: {}", text_of(panic.as_ref())));
            layout::ERR_INTERNAL
        }
    }
}

fn text_of(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no reason was given")
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

fn keep(text: &str) {
    let text = CString::new(text.replace('\0', " ")).unwrap_or_default();
    // Of a thread that is ending nobody asks.
    let _ = LAST.try_with(|last| last.replace(text));
}

/// The text of the last error in this thread.
pub(crate) fn last() -> *const c_char {
    LAST.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

#[cfg(test)]
mod tests {
    use std::ffi::CStr;

    use super::*;

    fn last_text() -> String {
        // SAFETY: the pointer is that of this thread's text, which nothing has replaced yet.
        unsafe { CStr::from_ptr(last()) }.to_str().unwrap().to_owned()
    }

    #[test]
    fn a_panic_ends_here() {
        assert_eq!(guarded(|| panic!("a seeded {}", "fault")), layout::ERR_INTERNAL);
        assert!(last_text().ends_with("a seeded fault"), "{}", last_text());
    }

    #[test]
    fn each_thread_has_its_text() {
        assert_eq!(guarded(|| Err(Error::argument("mine\0 own"))), layout::ERR_ARGUMENT);
        std::thread::spawn(|| assert_eq!(last_text(), "")).join().unwrap();
        assert_eq!(last_text(), "mine  own");
        assert_eq!(guarded(|| Ok(5)), 5);
    }
}
