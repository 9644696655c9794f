//! The contents as Rust types. What each does with bytes is what [`crate::contents`] does on a host.
//!
//! Every value is read from the whole bytes that it touches, as one number that is shifted and masked; the compiler
//! makes of that what one would write by hand. Nothing indexes out of range: contents are arrays of known length.

use super::CORE;
use crate::cluster::Cluster;
use crate::contents::{ByteOrder, FieldLayout, FieldType, Layout, Scaling, camel_case};
use std::fmt::Write as _;

pub(super) fn write(out: &mut String, cluster: &Cluster, derives: &[String]) -> std::fmt::Result {
    if cluster.contents.is_empty() {
        return Ok(());
    }
    writeln!(out, "/// What stands in the events of the channels.")?;
    let reason = "reason = \"no hand has written it\"";
    writeln!(out, "#[allow(clippy::all, clippy::pedantic, clippy::restriction, unused_parens, {reason})]")?;
    writeln!(out, "pub mod contents {{")?;
    for layout in &cluster.contents {
        for field in layout.fields.iter().filter(|field| !field.labels.is_empty()) {
            write_labels(out, layout, field, derives)?;
        }
        write_struct(out, layout, derives)?;
        write_methods(out, layout)?;
        write_content(out, layout)?;
    }
    writeln!(out, "}}\n")
}

fn write_doc(out: &mut String, indent: &str, text: &str) -> std::fmt::Result {
    text.lines()
        .try_for_each(|line| writeln!(out, "{indent}///{}{line}", if line.is_empty() { "" } else { " " }))
}

fn write_derives(out: &mut String, derives: &[String], eq: bool) -> std::fmt::Result {
    let eq = if eq { ", Eq" } else { "" };
    let more: String = derives.iter().map(|derive| format!(", {derive}")).collect();
    writeln!(out, "    #[derive(Clone, Copy, PartialEq{eq}, Debug{more})]")
}

fn write_labels(
    out: &mut String,
    layout: &Layout,
    field: &FieldLayout,
    derives: &[String],
) -> std::fmt::Result {
    let name = layout.label_type_name(field);
    write_doc(out, "    ", &format!("What `{}` of [`{}`] can be.", field.name, layout.type_name()))?;
    write_derives(out, derives, true)?;
    writeln!(out, "    pub enum {name} {{")?;
    for label in &field.labels {
        writeln!(out, "        /// `{}`: {} on the wire.", label.name, label.raw)?;
        writeln!(out, "        {},", camel_case(&label.name))?;
    }
    writeln!(out, "    }}\n")
}

fn write_struct(out: &mut String, layout: &Layout, derives: &[String]) -> std::fmt::Result {
    let name = &layout.name;
    match &layout.doc {
        Some(doc) => write_doc(out, "    ", doc)?,
        None => writeln!(out, "    /// Content `{name}`.")?,
    }
    let exact = layout.fields.iter().all(|field| !field.kind.is_float());
    write_derives(out, derives, exact)?;
    writeln!(out, "    pub struct {} {{", layout.type_name())?;
    for field in &layout.fields {
        match &field.doc {
            Some(doc) => write_doc(out, "        ", doc)?,
            None => writeln!(out, "        /// Field `{}`.", field.name)?,
        }
        if let Some(note) = note(field) {
            writeln!(out, "        ///")?;
            write_doc(out, "        ", &note)?;
        }
        writeln!(out, "        pub {}: {},", field.name, rust_type(layout, field))?;
    }
    writeln!(out, "    }}\n")
}

/// Unit, scale and range, in words.
fn note(field: &FieldLayout) -> Option<String> {
    let mut parts = Vec::new();
    match (&field.scaling, &field.unit) {
        (Some(scaling), unit) => {
            let unit = unit.as_ref().map_or(String::new(), |unit| format!(" {unit}"));
            let offset = if scaling.offset == 0 { String::new() } else { format!("{} + ", scaling.offset()) };
            parts.push(format!("The number on the wire: {offset}{}{unit} for each 1.", scaling.scale()));
        }
        (None, Some(unit)) => parts.push(format!("In {unit}.")),
        (None, None) => {}
    }
    if let Some((least, greatest)) = &field.range {
        let unit = field.unit.as_ref().map_or(String::new(), |unit| format!(" {unit}"));
        parts.push(format!("From {least} to {greatest}{unit}."));
    }
    (!parts.is_empty()).then(|| parts.join(" "))
}

fn rust_type(layout: &Layout, field: &FieldLayout) -> String {
    let one = value_type(layout, field);
    field.count.map_or(one.clone(), |count| format!("[{one}; {count}]"))
}

fn value_type(layout: &Layout, field: &FieldLayout) -> String {
    if field.labels.is_empty() { number_type(field.kind).to_owned() } else { layout.label_type_name(field) }
}

/// The smallest type of Rust that has room for it.
fn number_type(kind: FieldType) -> &'static str {
    match kind {
        FieldType::Bool | FieldType::Bit => "bool",
        FieldType::Single => "f32",
        FieldType::Double => "f64",
        FieldType::Unsigned(1..=8) => "u8",
        FieldType::Unsigned(9..=16) => "u16",
        FieldType::Unsigned(17..=32) => "u32",
        FieldType::Unsigned(_) => "u64",
        FieldType::Signed(1..=8) => "i8",
        FieldType::Signed(9..=16) => "i16",
        FieldType::Signed(17..=32) => "i32",
        FieldType::Signed(_) => "i64",
    }
}

/// For each field with a scale: from the number on the wire to its value, and back.
fn write_methods(out: &mut String, layout: &Layout) -> std::fmt::Result {
    let scaled = |field: &&FieldLayout| field.scaling.is_some() && field.count.is_none();
    if !layout.fields.iter().any(|field| scaled(&field)) {
        return Ok(());
    }
    writeln!(out, "    impl {} {{", layout.type_name())?;
    for field in layout.fields.iter().filter(scaled) {
        let scaling = field.scaling_or_none();
        let unit = field.unit.as_ref().map_or(String::new(), |unit| format!(", in {unit}"));
        // Beyond 24 bits a float of 32 bits loses digits.
        let float = if field.kind.bits() <= 24 { "f32" } else { "f64" };
        let (raw, name) = (number_type(field.kind), &field.name);
        let Scaling { factor, offset, exponent } = scaling;
        let divisor = 10_i128.pow(exponent);
        writeln!(out, "        /// What `{name}` means{unit}.\n        #[inline]")?;
        writeln!(out, "        pub fn {name}_value(&self) -> {float} {{")?;
        writeln!(
            out,
            "            (self.{name} as {float} * {factor}_{float} + {}) / {divisor}_{float}",
            literal(offset, float)
        )?;
        writeln!(out, "        }}\n")?;
        let (least, greatest) = field.raw_range;
        writeln!(
            out,
            "        /// The number on the wire that is nearest to a value{unit}; `None` if it is out of range."
        )?;
        writeln!(
            out,
            "        #[inline]\n        pub fn {name}_of(value: {float}) -> ::core::option::Option<{raw}> {{"
        )?;
        writeln!(
            out,
            "            let steps = (value * {divisor}_{float} - {}) / {factor}_{float};",
            literal(offset, float)
        )?;
        writeln!(out, "            let steps = if steps < 0.0 {{ steps - 0.5 }} else {{ steps + 0.5 }};")?;
        writeln!(out, "            // A number that is none is in no range.")?;
        let inside =
            format!("steps > {} && steps < {}", literal(least - 1, float), literal(greatest + 1, float));
        writeln!(
            out,
            "            if {inside} {{ ::core::option::Option::Some(steps as {raw}) }} else {{ ::core::option::Option::None }}"
        )?;
        writeln!(out, "        }}\n")?;
    }
    writeln!(out, "    }}\n")
}

fn literal(number: i128, of: &str) -> String {
    if number < 0 { format!("({number}_{of})") } else { format!("{number}_{of}") }
}

fn write_content(out: &mut String, layout: &Layout) -> std::fmt::Result {
    let name = layout.type_name();
    let len = layout.len;
    writeln!(out, "    impl {CORE}::event_layer::Content for {name} {{")?;
    writeln!(out, "        const LEN: usize = {len};")?;
    let hash = layout.layout_hash().get();
    writeln!(out, "        const LAYOUT: {LAYOUT_HASH} = {LAYOUT_HASH}::new({hash:#010x});\n")?;
    writeln!(out, "        #[inline]\n        fn encode(&self, bytes: &mut [u8]) {{")?;
    writeln!(
        out,
        "            let ::core::option::Option::Some(bytes) = bytes.first_chunk_mut::<{len}>() else {{ return }};"
    )?;
    writeln!(out, "            *bytes = [0; {len}];")?;
    for field in &layout.fields {
        write_encode(out, layout, field)?;
    }
    writeln!(out, "        }}\n")?;
    writeln!(out, "        #[inline]\n        fn decode(bytes: &[u8]) -> ::core::option::Option<Self> {{")?;
    writeln!(out, "            let bytes: &[u8; {len}] = bytes.try_into().ok()?;")?;
    for field in &layout.fields {
        write_decode(out, layout, field)?;
    }
    let names: Vec<&str> = layout.fields.iter().map(|field| field.name.as_str()).collect();
    writeln!(out, "            ::core::option::Option::Some(Self {{ {} }})", names.join(", "))?;
    writeln!(out, "        }}\n    }}\n")
}

/// The whole bytes that a value touches, and the type in which they are one number.
struct Window {
    first: usize,
    bytes: usize,
    /// Bits of the number's type.
    number: usize,
    shift: usize,
}

impl Window {
    fn of(layout: &Layout, at: usize, bits: usize) -> Self {
        let (first, behind) = (at / 8, (at + bits).div_ceil(8));
        let bytes = behind - first;
        let number = [8, 16, 32, 64].into_iter().find(|number| *number >= 8 * bytes).unwrap_or(128);
        let shift = match layout.order {
            ByteOrder::Big => 8 * behind - (at + bits),
            ByteOrder::Little => at - 8 * first,
        };
        Self { first, bytes, number, shift }
    }

    /// Where the byte of this position stands among those of the number.
    fn place(&self, order: ByteOrder, position: usize) -> usize {
        match order {
            ByteOrder::Big => self.number / 8 - self.bytes + position,
            ByteOrder::Little => position,
        }
    }
}

fn order_name(order: ByteOrder) -> &'static str {
    match order {
        ByteOrder::Big => "be",
        ByteOrder::Little => "le",
    }
}

fn write_encode(out: &mut String, layout: &Layout, field: &FieldLayout) -> std::fmt::Result {
    for position in 0..field.values() {
        let bits = field.kind.bits();
        let window = Window::of(layout, field.bit_of(position), bits);
        let number = format!("u{}", window.number);
        let value = match field.count {
            Some(_) => format!("self.{}[{position}]", field.name),
            None => format!("self.{}", field.name),
        };
        let raw = match field.kind {
            FieldType::Bool | FieldType::Bit => format!("{number}::from({value})"),
            FieldType::Single | FieldType::Double => format!("{value}.to_bits() as {number}"),
            _ if !field.labels.is_empty() => label_number(layout, field, &value, &number),
            _ => format!("{value} as {number}"),
        };
        let whole = bits == window.number;
        let masked = if whole { raw } else { format!("({raw}) & {:#x}", mask(bits)) };
        let shifted = if window.shift == 0 { masked } else { format!("({masked}) << {}", window.shift) };
        writeln!(out, "            let number: {number} = {shifted};")?;
        writeln!(out, "            let parts = number.to_{}_bytes();", order_name(layout.order))?;
        // Bytes that it has for itself are set, the others are shared.
        let assign = if bits == 8 * window.bytes { "=" } else { "|=" };
        for at in 0..window.bytes {
            let place = window.place(layout.order, at);
            writeln!(out, "            bytes[{}] {assign} parts[{place}];", window.first + at)?;
        }
    }
    Ok(())
}

fn mask(bits: usize) -> u128 {
    (1 << bits) - 1
}

fn label_number(layout: &Layout, field: &FieldLayout, value: &str, number: &str) -> String {
    let of = layout.label_type_name(field);
    let arms = field.labels.iter().map(|label| {
        let raw = (label.raw as u128) & mask(field.kind.bits());
        format!("{of}::{} => {raw}_{number}", camel_case(&label.name))
    });
    format!("match {value} {{ {} }}", arms.collect::<Vec<_>>().join(", "))
}

fn write_decode(out: &mut String, layout: &Layout, field: &FieldLayout) -> std::fmt::Result {
    let name = &field.name;
    let values: Vec<String> = (0..field.values()).map(|position| decoded(layout, field, position)).collect();
    match field.count {
        None => writeln!(out, "            let {name} = {};", values.join("")),
        Some(_) => writeln!(
            out,
            "            let {name} = [\n                {},\n            ];",
            values.join(",\n                ")
        ),
    }
}

/// The expression of a value.
fn decoded(layout: &Layout, field: &FieldLayout, position: usize) -> String {
    const NONE: &str = "return ::core::option::Option::None";
    let bits = field.kind.bits();
    let window = Window::of(layout, field.bit_of(position), bits);
    let bytes: Vec<String> = (0..window.number / 8)
        .map(|place| {
            let at = (0..window.bytes).find(|at| window.place(layout.order, *at) == place);
            at.map_or("0".to_owned(), |at| format!("bytes[{}]", window.first + at))
        })
        .collect();
    let mut number =
        format!("u{}::from_{}_bytes([{}])", window.number, order_name(layout.order), bytes.join(", "));
    if window.shift > 0 {
        number = format!("({number} >> {})", window.shift);
    }
    if bits != window.number {
        number = format!("({number} & {:#x})", mask(bits));
    }
    match field.kind {
        FieldType::Bit => format!("{number} == 1"),
        FieldType::Bool => format!("match {number} {{ 0 => false, 1 => true, _ => {NONE} }}"),
        FieldType::Single => ranged(field, format!("f32::from_bits({number} as u32)")),
        FieldType::Double => ranged(field, format!("f64::from_bits({number} as u64)")),
        FieldType::Unsigned(_) if field.labels.is_empty() => {
            ranged(field, format!("{number} as {}", number_type(field.kind)))
        }
        FieldType::Unsigned(_) => labelled(layout, field, &number),
        FieldType::Signed(_) => {
            let of = number_type(field.kind);
            let unsigned = of.replace('i', "u");
            let spare = of[1..].parse::<usize>().unwrap_or(64) - bits;
            let signed = match spare {
                0 => format!("{number} as {unsigned} as {of}"),
                spare => format!("(({number} as {unsigned}) << {spare}) as {of} >> {spare}"),
            };
            if field.labels.is_empty() {
                ranged(field, signed)
            } else {
                labelled(layout, field, &format!("({signed})"))
            }
        }
    }
}

fn labelled(layout: &Layout, field: &FieldLayout, number: &str) -> String {
    let of = layout.label_type_name(field);
    let arms = field.labels.iter().map(|label| format!("{} => {of}::{}", label.raw, camel_case(&label.name)));
    let arms = arms.collect::<Vec<_>>().join(", ");
    let all = field.labels.len() as u128 == 1 << field.kind.bits() && [8, 16].contains(&field.kind.bits());
    let rest = if all { "" } else { ", _ => return ::core::option::Option::None" };
    format!("match {number} {{ {arms}{rest} }}")
}

/// The value, if it is in its range.
fn ranged(field: &FieldLayout, value: String) -> String {
    let inside = match field.range {
        Some((least, greatest)) if field.kind.is_float() => {
            let wide = if field.kind == FieldType::Single { "f64::from(value)" } else { "value" };
            format!("{wide} >= {:?}_f64 && {wide} <= {:?}_f64", least.as_f64(), greatest.as_f64())
        }
        _ if field.has_raw_range() => {
            let (least, greatest) = field.raw_range;
            format!("({least}..={greatest}).contains(&value)")
        }
        _ => return value,
    };
    let none = "return ::core::option::Option::None";
    format!("{{ let value = {value}; if {inside} {{ value }} else {{ {none} }} }}")
}

const LAYOUT_HASH: &str = "::cosmic_core::protocol::LayoutHash";
