//! One channel: its class, its length and content, how its events follow each other, where its slot should be.

use super::{Checker, LONGEST_EVENT, Names, ZERO, name_of, recurrence, start_of};
use crate::cluster::format::ChannelTable;
use crate::cluster::values::{ClassName, Span};
use crate::cluster::{After, Channel, PlannedClass, Wishes};
use crate::contents::Layout;
use crate::document::At;
use crate::units::show;
use cosmic_core::can::Payload;
use cosmic_core::time::Duration;

impl Checker<'_> {
    pub(super) fn channel(&self, table: &ChannelTable, names: &Names<'_>, contents: &[Layout]) -> Channel {
        let name = name_of(&table.name);
        let field = |field: &str| format!("channel.{name}.{field}");
        let class_name = table.class.as_ref().map_or(ClassName::Soft, |at| at.value);
        self.fields_of_class(table, class_name);
        let recurrence = self.recurrence(table, &field);
        let deadline = table.deadline.as_ref().map(|at| at.value.0);
        let missing = deadline.is_none() && !table.malformed.contains(&"deadline");
        if class_name == ClassName::Soft && table.class.is_some() && missing {
            let help = "soft real-time channels need one: deadline = \"20 ms\"";
            self.problem(&start_of(&table.place), field("deadline"), "is missing", help);
        }
        let class = match class_name {
            ClassName::Hard => PlannedClass::Hard {
                omission_degree: table.omission_degree.as_ref().map_or(1, |at| at.value),
                wishes: self.wishes(table, names, recurrence.span()),
            },
            ClassName::Soft => PlannedClass::Soft,
            ClassName::NonRealTime => {
                PlannedClass::NonRealTime { importance: self.importance(table, &field) }
            }
        };
        let most = if class_name == ClassName::NonRealTime { LONGEST_EVENT } else { Payload::MAX_LEN as u16 };
        let (length, content) = self.length(table, contents, most, &field);
        Channel {
            name: name.to_owned(),
            subject: table.subject.as_ref().map_or(1, |at| at.value.0),
            etag: None,
            length,
            content,
            burst: self.burst(table, &field),
            allowed_jitter: recurrence::allowed_jitter(table, recurrence),
            recurrence,
            jitter: table.jitter.as_ref().map_or(ZERO, |at| at.value.0),
            deadline,
            validity: table.validity.as_ref().map(|at| at.value.0),
            class,
        }
    }

    /// Bytes of an event, and what stands in them.
    fn length(
        &self,
        table: &ChannelTable,
        contents: &[Layout],
        most: u16,
        field: &dyn Fn(&str) -> String,
    ) -> (u16, Option<usize>) {
        let content = table.content.as_ref().and_then(|at| {
            let names = Names::of(contents.iter().map(|layout| layout.name.as_str()));
            self.resolve(at, &names, field("content"), "content")
        });
        let of_content = content.map(|at| contents[at].len).and_then(|len| u16::try_from(len).ok());
        let help = format!("write at most {most}; longer events (up to {LONGEST_EVENT}) are NRT");
        match (&table.length, of_content) {
            (Some(at), _) if at.value > most => {
                self.problem(&at.place, field("length"), format!("{} bytes are too many", at.value), help);
            }
            (Some(at), Some(len)) if at.value != len => {
                let what = format!("{} is not the length of the content, {len}", at.value);
                self.problem(&at.place, field("length"), what, "leave it out: the content says it");
            }
            // A content that is too long for any event is a problem of its own.
            (None, Some(len)) if len > most && len <= LONGEST_EVENT => {
                let place = table.content.as_ref().map_or(0..0, |at| at.place.clone());
                let help = format!("take fields out; longer events (up to {LONGEST_EVENT}) are NRT");
                self.problem(&place, field("content"), format!("its {len} bytes are more than {most}"), help);
            }
            (None, None) if table.content.is_none() && !self.is_malformed(table, &["length", "content"]) => {
                let help = "write how many bytes an event has at most: length = 4; or its content";
                self.problem(&start_of(&table.place), field("length"), "is missing", help);
            }
            _ => {}
        }
        (table.length.as_ref().map(|at| at.value).or(of_content).unwrap_or(0), content)
    }

    pub(super) fn is_malformed(&self, table: &ChannelTable, fields: &[&str]) -> bool {
        table.malformed.iter().any(|field| fields.contains(field))
    }

    fn importance(&self, table: &ChannelTable, field: &dyn Fn(&str) -> String) -> u8 {
        let Some(at) = &table.importance else { return PlannedClass::LEAST_IMPORTANT };
        if at.value > PlannedClass::LEAST_IMPORTANT {
            let what = format!("{} is above {}", at.value, PlannedClass::LEAST_IMPORTANT);
            let help = format!("write 0 (most important) to {} (least)", PlannedClass::LEAST_IMPORTANT);
            self.problem(&at.place, field("importance"), what, help);
        }
        at.value
    }

    /// Fields that mean nothing in the class, and spans that contradict each other.
    fn fields_of_class(&self, table: &ChannelTable, class: ClassName) {
        let name = name_of(&table.name);
        let hard = [
            ("omission_degree", table.omission_degree.as_ref().map(|at| &at.place)),
            ("phase", table.phase.as_ref().map(|at| &at.place)),
            ("earliest", table.earliest.as_ref().map(|at| &at.place)),
            ("after", table.after.as_ref().and_then(|after| after.channel.as_ref()).map(|at| &at.place)),
        ];
        let important = [("importance", table.importance.as_ref().map(|at| &at.place))];
        let misplaced = hard.iter().filter(|_| class != ClassName::Hard).map(|field| (field, "HRT"));
        let other = important.iter().filter(|_| class != ClassName::NonRealTime).map(|field| (field, "NRT"));
        for (&(field, place), owner) in misplaced.chain(other) {
            if let (Some(place), true) = (place, table.class.is_some()) {
                let help = format!("leave it out, or make the channel {owner}");
                let what = format!("means something for {owner} channels only");
                self.problem(place, format!("channel.{name}.{field}"), what, help);
            }
        }
        if let (Some(deadline), Some(validity)) = (&table.deadline, &table.validity)
            && validity.value.0 < deadline.value.0
        {
            let what = "an event would expire before its deadline";
            let help = format!("write at least the deadline, {}", show(deadline.value.0));
            self.problem(&validity.place, format!("channel.{name}.validity"), what, help);
        }
    }

    fn wishes(&self, table: &ChannelTable, names: &Names<'_>, period: Duration) -> Wishes {
        let name = name_of(&table.name);
        let within_period = |at: &Option<At<Span>>, field: &str| {
            let at = at.as_ref()?;
            if at.value.0 >= period {
                let what = format!("{} is not less than the period, {}", show(at.value.0), show(period));
                let help = "write an instant within the period";
                self.problem(&at.place, format!("channel.{name}.{field}"), what, help);
            }
            Some(at.value.0)
        };
        let is_periodic = table.period.is_some();
        if let Some(at) = table.deadline.as_ref().filter(|at| is_periodic && at.value.0 > period) {
            let what = format!("{} is longer than the period, {}", show(at.value.0), show(period));
            let help = "a slot delivers within its period: write at most the period, or leave it out";
            self.problem(&at.place, format!("channel.{name}.deadline"), what, help);
        }
        let after = table.after.as_ref().and_then(|after| {
            let at = after.channel.as_ref()?;
            let channel = self.resolve(at, names, format!("channel.{name}.after.channel"), "channel")?;
            if names.list[channel] == name {
                let help = "name another channel";
                self.problem(
                    &at.place,
                    format!("channel.{name}.after.channel"),
                    "is the channel itself",
                    help,
                );
                return None;
            }
            Some(After { channel, within: after.within.as_ref()?.value.0 })
        });
        Wishes {
            phase: within_period(&table.phase, "phase"),
            earliest: within_period(&table.earliest, "earliest"),
            after,
        }
    }
}
