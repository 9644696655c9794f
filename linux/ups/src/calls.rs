//! The calls. What they do, and which errors they give, stands in the header.
//!
//! # Safety, of all of them
//! A pointer is null, or as the header says: aligned, at a value or a place for one that no other thread writes to
//! during the call; a text ends with a zero.

use std::ffi::{c_char, c_int};
use std::os::fd::AsRawFd as _;
use std::time::Duration;

use cosmic_core::event_layer::{Delivered, PublishError};
use cosmic_session::{Failure, Session, Settings, Times};

use crate::arguments::{self, place, pointee, queue, span_of_event, subject, text};
use crate::error::{self, Error, guarded};
use crate::handles::{self, Subscribed};
use crate::layout::{DATA_MAX, MsgObj, OK, UpsCounts, UpsQuality, UpsSettings};

/// # Safety
/// As [above](self).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ups_open(
    link: *const c_char,
    settings: *const UpsSettings,
    node: *mut u64,
) -> c_int {
    guarded(|| {
        let node = place(node, "node")?;
        // SAFETY: the caller keeps to the header.
        let link = unsafe { text(link, "link") }?;
        let choice = link.parse().map_err(|why| Error::argument(format!("{link:?}: {why}")))?;
        let mut chosen = Settings::new(choice);
        if !settings.is_null() {
            // SAFETY: the caller keeps to the header.
            let given = unsafe { pointee(settings, "settings") }?;
            chosen = arguments::settings(chosen, given)?;
            if !given.cluster.is_null() {
                // SAFETY: the caller keeps to the header.
                chosen.cluster = Some(unsafe { text(given.cluster, "cluster") }?.into());
            }
        }
        let handle = handles::add_node(Session::open(&chosen)?);
        // SAFETY: not null, and by the header a place for a handle.
        unsafe { node.write(handle) };
        Ok(OK)
    })
}

/// Takes no pointers.
#[unsafe(no_mangle)]
pub extern "C" fn ups_close(node: u64) -> c_int {
    guarded(|| {
        handles::remove_node(node)?.close();
        Ok(OK)
    })
}

/// # Safety
/// As [above](self).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ups_subject(node: u64, name: *const c_char, subject: *mut u64) -> c_int {
    guarded(|| {
        let session = handles::node(node)?;
        let subject = place(subject, "subject")?;
        // SAFETY: the caller keeps to the header.
        let name = unsafe { text(name, "name") }?;
        let found = session.subject_of(name).ok_or_else(|| {
            let remedy = match session.plan() {
                Some(_) => "it stands not in the cluster's file",
                None => "the node was started without the cluster's file",
            };
            Error::argument(format!("there is no channel {name:?}: {remedy}"))
        })?;
        // SAFETY: not null, and by the header a place for a subject.
        unsafe { subject.write(found.get()) };
        Ok(OK)
    })
}

/// # Safety
/// As [above](self).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ups_announce(node: u64, channel: u64, quality: *const UpsQuality) -> c_int {
    guarded(|| {
        let session = handles::node(node)?;
        // SAFETY: the caller keeps to the header.
        let quality = unsafe { given_quality(quality) }?;
        session.announce(subject(channel)?, quality.as_ref())?;
        Ok(OK)
    })
}

/// Takes no pointers.
#[unsafe(no_mangle)]
pub extern "C" fn ups_withdraw(node: u64, channel: u64) -> c_int {
    guarded(|| {
        if handles::node(node)?.withdraw(subject(channel)?) {
            Ok(OK)
        } else {
            Err(Error::argument(format!("no channel with subject {channel:#X} has been announced")))
        }
    })
}

/// # Safety
/// As [above](self).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ups_publish(node: u64, msg: *const MsgObj) -> c_int {
    guarded(|| {
        let session = handles::node(node)?;
        // SAFETY: the caller keeps to the header.
        let msg = unsafe { pointee(msg, "msg") }?;
        let content = msg.data.get(..usize::from(msg.length));
        let content = content.ok_or(Failure::NotPublished(PublishError::TooLong))?;
        let times =
            Times { deadline: span_of_event(msg.deadline_ns)?, validity: span_of_event(msg.validity_ns)? };
        session.publish(subject(msg.subject)?, content, times)?;
        Ok(OK)
    })
}

/// # Safety
/// As [above](self).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ups_subscribe(
    node: u64,
    channel: u64,
    quality: *const UpsQuality,
    depth: u8,
    subscription: *mut u64,
) -> c_int {
    guarded(|| {
        let session = handles::node(node)?;
        let place = place(subscription, "subscription")?;
        // SAFETY: the caller keeps to the header.
        let quality = unsafe { given_quality(quality) }?;
        let subscription = session.subscribe(subject(channel)?, quality.as_ref(), queue(depth))?;
        let subscribed = Subscribed { subject: channel, subscription };
        let handle = handles::add_subscription(node, subscribed)?;
        // SAFETY: not null, and by the header a place for a handle.
        unsafe { place.write(handle) };
        Ok(OK)
    })
}

/// Takes no pointers.
#[unsafe(no_mangle)]
pub extern "C" fn ups_unsubscribe(subscription: u64) -> c_int {
    guarded(|| {
        handles::remove_subscription(subscription)?.subscription.close();
        Ok(OK)
    })
}

/// # Safety
/// As [above](self).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ups_get_msg(subscription: u64, msg: *mut MsgObj, timeout_ms: i32) -> c_int {
    guarded(|| {
        let subscribed = handles::subscription(subscription)?;
        let place = place(msg, "msg")?;
        let patience = u64::try_from(timeout_ms).ok().map(Duration::from_millis);
        let event = subscribed.subscription.next(patience).map_err(Failure::from)?;
        let event = event.ok_or_else(Error::timeout)?;
        let msg = received(&subscribed, &event);
        // SAFETY: not null, and by the header a place for an event.
        unsafe { place.write(msg) };
        Ok(OK)
    })
}

/// Takes no pointers.
#[unsafe(no_mangle)]
pub extern "C" fn ups_descriptor(subscription: u64) -> c_int {
    guarded(|| Ok(handles::subscription(subscription)?.subscription.descriptor().as_raw_fd()))
}

/// # Safety
/// As [above](self).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ups_counters(node: u64, channel: u64, counts: *mut UpsCounts) -> c_int {
    guarded(|| {
        let session = handles::node(node)?;
        let place = place(counts, "counts")?;
        let counters = session.counters(subject(channel)?).ok_or_else(|| {
            Error::argument(format!("this node does not use a channel with subject {channel:#X}"))
        })?;
        let counts = UpsCounts {
            published: counters.published,
            refused: counters.refused,
            sent: counters.sent,
            expired: counters.discarded,
            delivered: counters.delivered,
            overflowed: counters.overflowed,
            replaced: counters.replaced,
            malformed: counters.malformed,
        };
        // SAFETY: not null, and by the header a place for counts.
        unsafe { place.write(counts) };
        Ok(OK)
    })
}

/// Takes no pointers.
#[unsafe(no_mangle)]
pub extern "C" fn ups_last_error() -> *const c_char {
    error::last()
}

/// # Safety
/// As [above](self).
unsafe fn given_quality(quality: *const UpsQuality) -> Result<Option<cosmic_session::Quality>, Error> {
    if quality.is_null() {
        return Ok(None);
    }
    // SAFETY: by the contract of this function.
    unsafe { pointee(quality, "quality") }.and_then(arguments::quality).map(Some)
}

fn received(subscribed: &Subscribed, event: &Delivered<Vec<u8>>) -> MsgObj {
    let mut data = [0; DATA_MAX];
    data.iter_mut().zip(&event.content).for_each(|(place, byte)| *place = *byte);
    MsgObj {
        subject: subscribed.subject,
        deadline_ns: 0,
        validity_ns: 0,
        received_at_ns: subscribed.subscription.received_ns(event),
        publisher: event.publisher.get().into(),
        length: event.content.len().min(DATA_MAX) as u16,
        reserved: [0; 4],
        data,
    }
}
