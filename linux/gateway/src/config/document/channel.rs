//! `[[channel]]`: what may cross.

use cosmic_core::Subject;
use cosmic_core::can::Payload;
use cosmic_core::event_layer::{EventRate, Importance};
use cosmic_core::network::fragments::MAX_MESSAGE_LEN;
use cosmic_core::protocol::Class;
use cosmic_core::time::Duration;
use cosmic_plan::document::{At, Table};

use super::super::{ChannelConfig, GATEWAYS};
use super::values::{self, WRITE_NAME, WRITE_SPAN};
use crate::keys::Name;
use crate::rules::Reach;

/// A channel as it stands in a configuration.
pub(super) struct Read {
    pub(super) name: Option<At<String>>,
    pub(super) subject: Option<At<Subject>>,
    /// `None` if anything is wrong with it.
    pub(super) channel: Option<ChannelConfig>,
    /// The segments that are named, to be looked at when they are known.
    pub(super) from: Vec<At<Name>>,
    pub(super) to: Vec<At<Name>>,
    pub(super) path: String,
}

pub(super) fn read(table: &Table<'_>) -> Read {
    let name = table.required::<String>("name", "write what it is called in logs and metrics");
    let is_free = |text: &str| {
        let subject = Subject::new(values::hexadecimal(text)?)?;
        (subject != Subject::RESERVED && subject != GATEWAYS).then_some(subject)
    };
    let write = "write up to 16 hexadecimal digits, not zero and none of the middleware's own";
    let subject = values::required_text(table, "subject", is_free, write);
    let class =
        values::required_text(table, "class", read_class, "write \"soft\", \"non-real-time\" or \"hard\"");
    let times = read_times(table, class.as_ref());
    let importance =
        values::optional(table, "importance", |rank: &u8| Importance::new(*rank), "write 0 (the most) to 4");
    let interval = values::required_text(table, "interval", values::read_span, WRITE_SPAN);
    let burst =
        values::optional(table, "burst", |burst: &u8| Some(*burst).filter(|it| *it > 0), "write 1 to 255");
    let longest_message = read_longest_message(table, class.as_ref());
    let longest_wait = values::span(table, "longest-wait").map(|at| at.value);
    let (from, to, unasked) = (names(table, "from"), names(table, "to"), names(table, "unasked"));
    let class_of = class.as_ref().map(|at| at.value);
    let reach = |list: &[At<Name>], field: &str| match class_of {
        _ if table.stands(field) => Reach::Only(list.iter().map(|at| at.value.clone()).collect()),
        // A hard real-time channel leaves and enters only the segments that are named.
        Some(Class::Hard) => Reach::NONE,
        _ => Reach::All,
    };
    let (leaves, enters) = (reach(&from, "from"), reach(&to, "to"));
    for at in unasked.iter().filter(|at| !enters.has(&at.value)) {
        let what = "the channel may not enter this segment";
        table.problem("unasked", at.place.clone(), what, "name it in `to`, too");
    }
    if class_of == Some(Class::Hard) && !table.stands("from") {
        let help = "name the segments in whose calendars the channel stands";
        let _ = table.required::<String>("from", help);
    }
    table.finish();
    let path = table.path().to_owned();
    let channel = (|| {
        Some(ChannelConfig {
            name: name.as_ref()?.value.clone(),
            subject: subject.as_ref()?.value,
            class: class_of?,
            deadline: times.deadline,
            validity: times.validity,
            importance: importance.map_or(Importance::LEAST, |at| at.value),
            rate: EventRate::sporadic(interval?.value).with_burst(burst.map_or(1, |at| at.value)),
            longest_wait,
            longest_message,
            from: leaves,
            to: enters,
            unasked: unasked.into_iter().map(|at| at.value).collect(),
        })
    })();
    Read { name, subject, channel, from, to, path }
}

fn read_class(text: &str) -> Option<Class> {
    match text {
        "hard" => Some(Class::Hard),
        "soft" => Some(Class::Soft),
        "non-real-time" => Some(Class::NonRealTime),
        _ => None,
    }
}

fn names(table: &Table<'_>, field: &'static str) -> Vec<At<Name>> {
    values::list(table, field, values::name, WRITE_NAME)
}

struct Times {
    deadline: Option<Duration>,
    validity: Option<Duration>,
}

fn read_times(table: &Table<'_>, class: Option<&At<Class>>) -> Times {
    let (deadline, validity) = (values::span(table, "deadline"), values::span(table, "validity"));
    let is_real_time = class.is_none_or(|class| class.value != Class::NonRealTime);
    match (&deadline, &validity) {
        (Some(at), _) if !is_real_time => {
            table.problem("deadline", at.place.clone(), "a non real-time channel has none", "leave it out");
        }
        (None, _) if is_real_time && class.is_some() && !table.stands("deadline") => {
            let help = "write how long after its publication an event is to be sent on the far segment at the latest, \
                        such as deadline = \"20 ms\"";
            let _ = table.required::<String>("deadline", help);
        }
        (Some(deadline), Some(validity)) if validity.value < deadline.value => {
            let what = "an event must not expire before its deadline";
            table.problem("validity", validity.place.clone(), what, "write a longer one");
        }
        _ => {}
    }
    let deadline = deadline.map(|at| at.value).filter(|_| is_real_time);
    Times { deadline, validity: validity.map(|at| at.value).or(deadline) }
}

/// Messages of several frames.
fn read_longest_message(table: &Table<'_>, class: Option<&At<Class>>) -> Option<usize> {
    let fits = |len: &u16| {
        let len = usize::from(*len);
        (len > Payload::MAX_LEN && len <= MAX_MESSAGE_LEN).then_some(len)
    };
    let at = values::optional(table, "longest-message", fits, "write its bytes, 9 to 1024")?;
    if class.is_some_and(|class| class.value != Class::NonRealTime) {
        let what = "only a non real-time channel carries messages of several frames";
        table.problem("longest-message", at.place, what, "leave it out, or write class = \"non-real-time\"");
    }
    Some(at.value)
}
