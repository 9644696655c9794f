//! What C hands in, looked at before it is used.

use std::ffi::{CStr, c_char};
use std::time::Duration;

use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::Importance;
use cosmic_core::time;
use cosmic_core::{NodeUid, Subject};
use cosmic_session::{Class, Quality, Queue, Settings};

use crate::error::Error;
use crate::layout::{self, TEXT_MAX, UpsQuality, UpsSettings};

/// What a pointer of C points at.
///
/// # Safety
/// It is null, or points at an aligned value that nobody writes to for the time of `'a`.
pub(crate) unsafe fn pointee<'a, T>(pointer: *const T, name: &str) -> Result<&'a T, Error> {
    // SAFETY: by the contract of this function.
    unsafe { pointer.as_ref() }.ok_or_else(|| null(name))
}

/// Where a result is to be written.
pub(crate) fn place<T>(pointer: *mut T, name: &str) -> Result<*mut T, Error> {
    if pointer.is_null() { Err(null(name)) } else { Ok(pointer) }
}

/// A text of C.
///
/// # Safety
/// The pointer is null, or points at bytes of which one is zero, and which nobody writes to for the time of `'a`.
pub(crate) unsafe fn text<'a>(pointer: *const c_char, name: &str) -> Result<&'a str, Error> {
    if pointer.is_null() {
        return Err(null(name));
    }
    // SAFETY: not null, and ends with a zero by the contract of this function.
    let text = unsafe { CStr::from_ptr(pointer) };
    if text.count_bytes() >= TEXT_MAX {
        return Err(Error::argument(format!("`{name}` is longer than {} bytes", TEXT_MAX - 1)));
    }
    text.to_str().map_err(|_| Error::argument(format!("`{name}` is no UTF-8")))
}

fn null(name: &str) -> Error {
    Error::argument(format!("`{name}` is NULL: give a pointer"))
}

pub(crate) fn subject(number: u64) -> Result<Subject, Error> {
    Subject::new(number).ok_or_else(|| Error::argument("the subject is 0, which is none"))
}

/// Settings, but for the cluster's file.
pub(crate) fn settings(mut settings: Settings, given: &UpsSettings) -> Result<Settings, Error> {
    settings.uid = NodeUid::new(given.uid);
    settings.tx_node = match given.tx_node {
        -1 => None,
        number => {
            let node = u8::try_from(number).ok().and_then(TxNode::new).filter(|node| *node != TxNode::BROKER);
            Some(node.ok_or_else(|| {
                Error::argument(format!("`tx_node` is {number}: give one from 0 to 126, or -1"))
            })?)
        }
    };
    if given.bit_rate != 0 {
        settings.bit_rate = BitRate::new(given.bit_rate).ok_or_else(|| {
            Error::argument(format!(
                "`bit_rate` is {}: give one from 10000 to 1000000 whose bit takes whole nanoseconds",
                given.bit_rate
            ))
        })?;
    }
    if given.patience_ms != 0 {
        settings.patience = Duration::from_millis(given.patience_ms.into());
    }
    Ok(settings)
}

pub(crate) fn quality(given: &UpsQuality) -> Result<Quality, Error> {
    let (deadline, validity) = (span(given.deadline_ns)?, span(given.validity_ns)?);
    let class = match given.channel_class {
        layout::SOFT => Class::Soft { deadline, validity },
        layout::NON_REAL_TIME | layout::MESSAGES => {
            let importance = Importance::new(given.importance).ok_or_else(|| {
                Error::argument(format!("`importance` is {}: give one from 0 to 4", given.importance))
            })?;
            let validity = Some(validity).filter(|span| !span.is_zero());
            if given.channel_class == layout::MESSAGES {
                Class::Messages { importance, validity }
            } else {
                Class::NonRealTime { importance, validity }
            }
        }
        other => {
            let what =
                format!("`channel_class` is {other}: give UPS_SOFT, UPS_NON_REAL_TIME or UPS_MESSAGES");
            return Err(Error::argument(what));
        }
    };
    let etag = match given.etag {
        0 => None,
        number => Some(Etag::new(number).ok_or_else(|| {
            Error::argument(format!("`etag` is {number}: give one from 1024 to 16383, or 0"))
        })?),
    };
    Ok(Quality { class, etag })
}

/// The span of an event; 0 is none.
pub(crate) fn span_of_event(nanoseconds: u64) -> Result<Option<time::Duration>, Error> {
    Ok(Some(span(nanoseconds)?).filter(|span| !span.is_zero()))
}

/// A span after which an instant can still be stated.
fn span(nanoseconds: u64) -> Result<time::Duration, Error> {
    if nanoseconds > LONGEST_NS {
        return Err(Error::argument(format!("a span of {nanoseconds} ns is longer than a year")));
    }
    Ok(time::Duration::from_ticks(nanoseconds))
}

pub(crate) fn queue(depth: u8) -> Queue {
    cosmic_core::event_layer::Depth::new(depth).map_or(Queue::Latest, Queue::InOrder)
}

const LONGEST_NS: u64 = 366 * 24 * 3_600 * 1_000_000_000;
