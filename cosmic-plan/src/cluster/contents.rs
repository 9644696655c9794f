//! Contents as the file describes them: tables, and the layout that they say.

use super::values::{DecimalNumber, Name, OrderName};
use crate::contents::{ByteOrder, Decimal, FieldLayout, FieldType, Label, Layout, Scaling, camel_case};
use crate::document::{At, FromNode, Kind, Log, Place, Problem, Table};
use cosmic_core::network::fragments::MAX_MESSAGE_LEN;
#[cfg(feature = "cli")]
use schemars::JsonSchema;
#[cfg(feature = "cli")]
use std::collections::BTreeMap;
use std::collections::HashMap;

/// What stands in the bytes of an event. Several channels may have the same content.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct ContentTable {
    /// Its name; `wheel_speed` becomes the type `WheelSpeed`.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub name: Option<At<Name>>,
    /// What it is, for people.
    pub doc: Option<At<String>>,
    /// 1 if not given. Raise it when the meaning changes though the fields do not: nodes of different versions then
    /// notice that they would misread each other.
    #[cfg_attr(feature = "cli", schemars(range(min = 1)))]
    pub version: Option<At<u8>>,
    /// How bits and bytes follow each other; "big" if not given. "big": bit 0 is the highest of byte 0, and a field
    /// begins with its highest bit (Motorola). "little": bit 0 is the lowest of byte 0, and a field begins with its
    /// lowest bit (Intel).
    pub byte_order: Option<At<OrderName>>,
    /// Bytes of an event, if there are more than the fields take.
    #[cfg_attr(feature = "cli", schemars(range(min = 1, max = 1024)))]
    pub length: Option<At<u16>>,
    /// The fields.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub field: Vec<FieldTable>,
    /// Where the table stands.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub place: Place,
}

/// A field of a content.
#[derive(Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(deny_unknown_fields))]
pub struct FieldTable {
    /// Its name.
    #[cfg_attr(feature = "cli", schemars(required))]
    pub name: Option<At<Name>>,
    /// What it is, for people.
    pub doc: Option<At<String>>,
    /// u8 to u64, i8 to i64, f32, f64; bool, which takes a byte; bit, a truth value in one bit; u1 to u63 and i2 to
    /// i63 for bit fields.
    #[cfg_attr(feature = "cli", schemars(required))]
    #[cfg_attr(
        feature = "cli",
        schemars(with = "Option<String>", regex(pattern = r"^(bool|bit|f32|f64|[ui][1-9][0-9]?)$"))
    )]
    pub r#type: Option<At<String>>,
    /// So many of them, one behind the other.
    #[cfg_attr(feature = "cli", schemars(range(min = 1, max = 1024)))]
    pub count: Option<At<u16>>,
    /// Its first bit. If not given it stands behind the field before it: at once if its width is no whole number of
    /// bytes, else from the next byte on.
    #[cfg_attr(feature = "cli", schemars(range(min = 0, max = 8191)))]
    pub at: Option<At<u16>>,
    /// Its value is the number on the wire times `scale`, plus `offset`.
    pub scale: Option<At<DecimalNumber>>,
    /// See `scale`.
    pub offset: Option<At<DecimalNumber>>,
    /// The unit of its value.
    pub unit: Option<At<String>>,
    /// The least value; events with a lower one are refused as malformed.
    pub min: Option<At<DecimalNumber>>,
    /// The greatest value; events with a higher one are refused as malformed.
    pub max: Option<At<DecimalNumber>>,
    /// The names of its values: `{ off = 0, on = 1 }`. It has no others.
    pub values: Option<At<Labels>>,
    /// Where the table stands.
    #[cfg_attr(feature = "cli", schemars(skip))]
    pub place: Place,
}

/// Names of values.
#[derive(Clone, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "cli", derive(JsonSchema))]
#[cfg_attr(feature = "cli", schemars(transparent, inline))]
pub struct Labels(#[cfg_attr(feature = "cli", schemars(with = "BTreeMap<String, i64>"))] pub Vec<Label>);

impl FromNode for Labels {
    fn from_node(node: &crate::document::Node) -> Result<Self, crate::document::Mismatch> {
        let help = "write the names with their numbers: values = { off = 0, on = 1 }";
        let wrong = |what: String| crate::document::Mismatch::new(what, help);
        let Kind::Table(entries) = &node.kind else {
            return Err(wrong(format!("{} is no table of names", node.describe())));
        };
        let label = |(key, value): &(At<String>, crate::document::Node)| {
            let name = Name::check(&key.value)?;
            let raw = match &value.kind {
                Kind::Number(text, base) => whole_number(text, *base),
                _ => None,
            };
            let raw =
                raw.ok_or_else(|| wrong(format!("{} of {name} is no whole number", value.describe())))?;
            Ok(Label { name, raw })
        };
        entries.iter().map(label).collect::<Result<_, _>>().map(Self)
    }
}

fn whole_number(text: &str, base: u32) -> Option<i128> {
    let digits: String = text.chars().filter(|c| *c != '_').collect();
    i128::from_str_radix(&digits, base).ok()
}

pub(super) fn read(table: &Table<'_>) -> ContentTable {
    let content = ContentTable {
        name: table.required("name", "give the content a name: name = \"wheel_speed\""),
        doc: table.optional("doc"),
        version: table.optional("version"),
        byte_order: table.optional("byte_order"),
        length: table.optional("length"),
        field: table.entries("field", read_field),
        place: table.place(),
    };
    if content.field.is_empty() && !table.stands("field") {
        let start = table.place().start;
        table.problem(
            "field",
            start..start,
            "is missing",
            "write at least one [[content.field]] with name and type",
        );
    }
    table.finish();
    content
}

fn read_field(table: &Table<'_>) -> FieldTable {
    let field = FieldTable {
        name: table.required("name", "give the field a name: name = \"speed\""),
        doc: table.optional("doc"),
        r#type: table.required("type", TYPES),
        count: table.optional("count"),
        at: table.optional("at"),
        scale: table.optional("scale"),
        offset: table.optional("offset"),
        unit: table.optional("unit"),
        min: table.optional("min"),
        max: table.optional("max"),
        values: table.optional("values"),
        place: table.place(),
    };
    table.finish();
    field
}

/// Turns tables into layouts.
pub(super) struct Contents<'a> {
    pub(super) log: &'a Log,
}

impl Contents<'_> {
    fn problem(&self, place: &Place, field: String, what: impl Into<String>, help: impl Into<String>) {
        self.log.add(Problem { place: Some(place.clone()), field, what: what.into(), help: help.into() });
    }

    pub(super) fn layouts(&self, tables: &[ContentTable]) -> Vec<Layout> {
        let layouts: Vec<Layout> = tables.iter().map(|table| self.layout(table)).collect();
        self.types_are_different(tables, &layouts);
        layouts
    }

    fn layout(&self, table: &ContentTable) -> Layout {
        let name = name_of(&table.name);
        let order = match table.byte_order.as_ref().map(|at| at.value) {
            Some(OrderName::Little) => ByteOrder::Little,
            _ => ByteOrder::Big,
        };
        let mut fields: Vec<FieldLayout> = Vec::new();
        for field in &table.field {
            let behind = fields.last().map_or(0, |before| before.span().end);
            let path = format!("content.{name}.field.{}", name_of(&field.name));
            let layout = self.field(field, behind, &path);
            self.is_apart(field, &layout, &fields, &path);
            fields.push(layout);
        }
        let needed = fields.iter().map(|field| field.span().end).max().unwrap_or(0).div_ceil(8);
        let len = self.length(table, needed);
        let version = table.version.as_ref().map_or(1, |at| at.value);
        if let Some(at) = table.version.as_ref().filter(|at| at.value == 0) {
            self.problem(&at.place, format!("content.{name}.version"), "is zero", "count versions from 1");
        }
        Layout {
            name: name.to_owned(),
            doc: table.doc.as_ref().map(|at| at.value.clone()),
            version,
            order,
            len,
            fields,
        }
    }

    fn length(&self, table: &ContentTable, needed: usize) -> usize {
        let name = name_of(&table.name);
        if let Some(at) = &table.length {
            let stated = usize::from(at.value);
            if stated < needed && stated <= MAX_MESSAGE_LEN {
                let help = format!("leave it out, or write at least {needed}");
                let what = format!("the fields take {needed} bytes");
                self.problem(&at.place, format!("content.{name}.length"), what, help);
            }
            if stated > MAX_MESSAGE_LEN {
                let what = format!("{stated} bytes are too many");
                self.problem(
                    &at.place,
                    format!("content.{name}.length"),
                    what,
                    format!("write at most {MAX_MESSAGE_LEN}"),
                );
            }
            return stated.max(needed);
        }
        if needed > MAX_MESSAGE_LEN {
            let what = format!("the fields take {needed} bytes");
            let help = format!(
                "an event has at most {MAX_MESSAGE_LEN} bytes: leave fields out, or split the content"
            );
            self.problem(&start_of(&table.place), format!("content.{name}"), what, help);
        }
        needed
    }

    fn field(&self, table: &FieldTable, behind: usize, path: &str) -> FieldLayout {
        let kind = table.r#type.as_ref().map_or(FieldType::Unsigned(8), |at| {
            FieldType::parse(&at.value).unwrap_or_else(|| {
                let what = format!("there is no type {:?}", at.value);
                self.problem(&at.place, format!("{path}.type"), what, TYPES);
                FieldType::Unsigned(8)
            })
        });
        if let Some(at) = table.count.as_ref().filter(|at| at.value == 0) {
            self.problem(&at.place, format!("{path}.count"), "is zero", "write at least 1, or leave it out");
        }
        let usual = if kind.bits().is_multiple_of(8) { behind.next_multiple_of(8) } else { behind };
        let at = table.at.as_ref().map_or(usual, |at| usize::from(at.value));
        self.fits_its_type(table, kind, path);
        let scaling = self.scaling(table, kind, path);
        let range = self.range(table, kind, path);
        let raw_range = self.raw_range(table, kind, scaling, range, path);
        FieldLayout {
            name: name_of(&table.name).to_owned(),
            doc: table.doc.as_ref().map(|at| at.value.clone()),
            kind,
            count: table.count.as_ref().map(|at| usize::from(at.value.max(1))),
            at,
            moved: at != usual,
            scaling,
            unit: table.unit.as_ref().map(|at| at.value.clone()),
            range,
            raw_range,
            labels: self.labels(table, kind, path),
        }
    }

    /// Fields that mean nothing for the type, or beside named values.
    fn fits_its_type(&self, table: &FieldTable, kind: FieldType, path: &str) {
        let number = [
            ("scale", table.scale.as_ref().map(|at| &at.place)),
            ("offset", table.offset.as_ref().map(|at| &at.place)),
        ];
        let range = [
            ("min", table.min.as_ref().map(|at| &at.place)),
            ("max", table.max.as_ref().map(|at| &at.place)),
        ];
        let unit = [("unit", table.unit.as_ref().map(|at| &at.place))];
        let values = [("values", table.values.as_ref().map(|at| &at.place))];
        let name = kind.name();
        let refused: Vec<_> = match kind {
            FieldType::Bool | FieldType::Bit => [&number[..], &range, &unit, &values].concat(),
            _ if kind.is_float() => [&number[..], &values].concat(),
            _ => Vec::new(),
        };
        for (field, place) in refused {
            let Some(place) = place else { continue };
            let help = "leave it out, or make the field a whole number such as u16";
            self.problem(place, format!("{path}.{field}"), format!("means nothing for {name}"), help);
        }
        if kind.is_integer() && table.values.is_some() {
            for (field, place) in [&number[..], &range, &unit].concat() {
                let Some(place) = place else { continue };
                let help = "leave it out, or leave out values";
                self.problem(place, format!("{path}.{field}"), "means nothing beside values", help);
            }
        }
    }

    fn scaling(&self, table: &FieldTable, kind: FieldType, path: &str) -> Option<Scaling> {
        let first = table.scale.as_ref().or(table.offset.as_ref())?;
        let scale = table.scale.as_ref().map_or(Decimal::ONE, |at| at.value.0);
        let offset = table.offset.as_ref().map_or(Decimal::ZERO, |at| at.value.0);
        if scale.mantissa() <= 0 {
            let what = format!("{scale} is not above zero");
            self.problem(&first.place, format!("{path}.scale"), what, "write what one step is: scale = 0.01");
            return None;
        }
        let scaling = Scaling::new(scale, offset, kind);
        if scaling.is_none() {
            let help = "write fewer digits";
            self.problem(&first.place, format!("{path}.scale"), "its values have too many digits", help);
        }
        scaling
    }

    fn range(&self, table: &FieldTable, kind: FieldType, path: &str) -> Option<(Decimal, Decimal)> {
        match (&table.min, &table.max) {
            (None, None) => None,
            (Some(min), Some(max)) => Some((min.value.0, max.value.0)),
            (Some(one), None) | (None, Some(one)) if kind.is_float() => {
                let help = "write both min and max";
                self.problem(
                    &one.place,
                    path.to_owned(),
                    "min and max of floating-point numbers go together",
                    help,
                );
                None
            }
            (min, max) => {
                let scaling = self.scaling_quietly(table, kind);
                let (least, greatest) = kind.limits();
                let least = min.as_ref().map_or(scaling.value(least), |at| at.value.0);
                Some((least, max.as_ref().map_or(scaling.value(greatest), |at| at.value.0)))
            }
        }
    }

    fn scaling_quietly(&self, table: &FieldTable, kind: FieldType) -> Scaling {
        let scale = table.scale.as_ref().map_or(Decimal::ONE, |at| at.value.0);
        let offset = table.offset.as_ref().map_or(Decimal::ZERO, |at| at.value.0);
        Some(scale)
            .filter(|scale| scale.mantissa() > 0)
            .and_then(|scale| Scaling::new(scale, offset, kind))
            .unwrap_or(Scaling::NONE)
    }

    /// The raw numbers whose values are in the range.
    fn raw_range(
        &self,
        table: &FieldTable,
        kind: FieldType,
        scaling: Option<Scaling>,
        range: Option<(Decimal, Decimal)>,
        path: &str,
    ) -> (i128, i128) {
        let limits = kind.limits();
        let Some((min, max)) = range else { return limits };
        let place = table.min.as_ref().or(table.max.as_ref()).map_or(0..0, |at| at.place.clone());
        if kind.is_float() {
            if min.as_f64() > max.as_f64() {
                self.problem(
                    &place,
                    format!("{path}.min"),
                    "is above max",
                    "write the smaller number as min",
                );
            }
            return limits;
        }
        let scaling = scaling.unwrap_or(Scaling::NONE);
        let raw = (scaling.least_raw(min), scaling.greatest_raw(max));
        let (least, greatest) = (scaling.value(limits.0), scaling.value(limits.1));
        match raw {
            (Some(low), Some(high)) if low > high => {
                let help = "write a greater max: at least one value of the scale must lie between";
                self.problem(&place, format!("{path}.min"), "no value lies between min and max", help);
                limits
            }
            (Some(low), Some(high)) if low >= limits.0 && high <= limits.1 => (low, high),
            _ => {
                let what = format!("{min} to {max} is more than {} can say", kind.name());
                let help = format!("write numbers from {least} to {greatest}, or choose a wider type");
                self.problem(&place, format!("{path}.min"), what, help);
                limits
            }
        }
    }

    fn labels(&self, table: &FieldTable, kind: FieldType, path: &str) -> Vec<Label> {
        let Some(at) = table.values.as_ref().filter(|_| kind.is_integer()) else { return Vec::new() };
        let labels = &at.value.0;
        let (least, greatest) = kind.limits();
        let wrong = |what: String, help: &str| self.problem(&at.place, format!("{path}.values"), what, help);
        if labels.is_empty() {
            wrong("is empty".to_owned(), "write the names with their numbers: values = { off = 0, on = 1 }");
        }
        for (position, label) in labels.iter().enumerate() {
            if label.raw < least || label.raw > greatest {
                let help = format!("write numbers from {least} to {greatest}, or choose a wider type");
                wrong(format!("{} does not fit into {}", label.name, kind.name()), &help);
            }
            let same =
                |other: &&Label| other.raw == label.raw || camel_case(&other.name) == camel_case(&label.name);
            if let Some(other) = labels[..position].iter().find(same) {
                let help = "give every value a name and a number of its own";
                wrong(format!("{} is too much like {}", label.name, other.name), help);
            }
            if camel_case(&label.name) == "Self" {
                wrong(format!("{} cannot be a name", label.name), "choose another");
            }
        }
        labels.clone()
    }

    fn is_apart(&self, table: &FieldTable, field: &FieldLayout, others: &[FieldLayout], path: &str) {
        let place = table.at.as_ref().map_or(start_of(&table.place), |at| at.place.clone());
        for other in others {
            let (a, b) = (field.span(), other.span());
            if a.start < b.end && b.start < a.end {
                let what =
                    format!("overlaps {}, which has the bits {} to {}", other.name, b.start, b.end - 1);
                let help = "leave out `at`, or choose bits that no other field has";
                self.problem(&place, format!("{path}.at"), what, help);
            }
            if other.name == field.name && table.name.is_some() {
                let place = table.name.as_ref().map_or(place.clone(), |at| at.place.clone());
                self.problem(
                    &place,
                    path.to_owned(),
                    "stands here a second time",
                    "every field needs its own name",
                );
            }
        }
    }

    /// Types of contents and of their fields with named values have names of their own.
    fn types_are_different(&self, tables: &[ContentTable], layouts: &[Layout]) {
        let mut seen: HashMap<String, String> = HashMap::new();
        for (table, layout) in tables.iter().zip(layouts) {
            let Some(name) = &table.name else { continue };
            let fields = layout.fields.iter().zip(&table.field);
            let of_labels = fields.filter(|(field, _)| !field.labels.is_empty()).map(|(field, table)| {
                let place = table.name.as_ref().map_or(name.place.clone(), |at| at.place.clone());
                (
                    layout.label_type_name(field),
                    format!("content.{}.field.{}", layout.name, field.name),
                    place,
                )
            });
            let own = (layout.type_name(), format!("content.{}", layout.name), name.place.clone());
            for (type_name, path, place) in std::iter::once(own).chain(of_labels) {
                if type_name == "Self" {
                    self.problem(
                        &place,
                        path.clone(),
                        "its type would be called Self",
                        "choose another name",
                    );
                }
                if let Some(other) = seen.insert(type_name.clone(), path.clone()) {
                    let what = format!("its type would be called {type_name}, as that of {other}");
                    self.problem(&place, path, what, "choose another name");
                }
            }
        }
    }
}

fn name_of(name: &Option<At<Name>>) -> &str {
    name.as_ref().map_or("", |at| &at.value.0)
}

fn start_of(place: &Place) -> Place {
    place.start..place.start
}

const TYPES: &str = "write type = \"u16\", or another of u1 to u64, i2 to i64, bool, bit, f32, f64";
