//! How values of a configuration are read: what is none is told with its place, its field and what to write.

use std::fmt::Debug;

use cosmic_core::time::Duration;
use cosmic_plan::document::{At, FromNode, Table};
use cosmic_plan::units;

use crate::keys::Name;

/// What a field says, if it stands there.
pub(super) fn optional<T: FromNode + Debug, R>(
    table: &Table<'_>,
    field: &'static str,
    read: impl FnOnce(&T) -> Option<R>,
    write: &str,
) -> Option<At<R>> {
    checked(table, field, table.optional(field)?, read, write)
}

/// What a text says, if it stands there.
pub(super) fn optional_text<R>(
    table: &Table<'_>,
    field: &'static str,
    read: impl FnOnce(&str) -> Option<R>,
    write: &str,
) -> Option<At<R>> {
    optional(table, field, |text: &String| read(text), write)
}

/// What a text says, which must stand there.
pub(super) fn required_text<R>(
    table: &Table<'_>,
    field: &'static str,
    read: impl FnOnce(&str) -> Option<R>,
    write: &str,
) -> Option<At<R>> {
    checked(table, field, table.required(field, write)?, |text: &String| read(text), write)
}

/// What the items of a list say; empty if it does not stand there.
pub(super) fn list<R>(
    table: &Table<'_>,
    field: &'static str,
    read: impl Fn(&str) -> Option<R>,
    write: &str,
) -> Vec<At<R>> {
    table
        .list(field)
        .into_iter()
        .filter_map(|at| checked(table, field, at, |text: &String| read(text), write))
        .collect()
}

/// What stands there as it is to be used, or a problem.
pub(super) fn checked<T: Debug, R>(
    table: &Table<'_>,
    field: &str,
    at: At<T>,
    read: impl FnOnce(&T) -> Option<R>,
    write: &str,
) -> Option<At<R>> {
    let value = read(&at.value);
    if value.is_none() {
        table.problem(field, at.place.clone(), format!("{:?} is none", at.value), write);
    }
    value.map(|value| At { value, place: at.place })
}

pub(super) fn name(text: &str) -> Option<Name> {
    Name::new(text)
}

pub(super) const WRITE_NAME: &str = "write 1 to 32 of a-z, 0-9, '-' and '_', such as \"line-1\"";

/// A span that is not zero.
pub(super) fn span(table: &Table<'_>, field: &'static str) -> Option<At<Duration>> {
    optional_text(table, field, read_span, WRITE_SPAN)
}

pub(super) fn read_span(text: &str) -> Option<Duration> {
    units::parse_span(text).filter(|span| !span.is_zero())
}

pub(super) const WRITE_SPAN: &str = "write a number with its unit: \"10 ms\", \"2.5 s\"";

/// A number of up to 64 bits, in hexadecimal digits.
pub(super) fn hexadecimal(text: &str) -> Option<u64> {
    let digits = text.strip_prefix("0x").unwrap_or(text);
    digits.bytes().all(|byte| byte.is_ascii_hexdigit()).then(|| u64::from_str_radix(digits, 16).ok())?
}
