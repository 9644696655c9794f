//! The contents as a header of C99: a struct for each, functions that read and write its bytes, and the identifiers
//! of channels and nodes. It needs no other file and no heap.

use crate::cluster::Cluster;
use crate::contents::{ByteOrder, FieldLayout, FieldType, Layout, Scaling};
use std::fmt::Write as _;

/// The text of the header.
pub fn render(cluster: &Cluster, source_name: &str) -> String {
    let mut out = String::new();
    // Writing into a string does not fail.
    let _ = write_all(&mut out, cluster, source_name);
    out
}

fn write_all(out: &mut String, cluster: &Cluster, source_name: &str) -> std::fmt::Result {
    let segment = &cluster.name;
    let guard = format!("COSMIC_{}_H", segment.to_uppercase());
    writeln!(out, "/* Events of the COSMIC segment {segment}, in C99.")?;
    writeln!(out, "   Made by cosmic-plan of {}. Change that file, not this one. */", safe(source_name))?;
    writeln!(out, "#ifndef {guard}\n#define {guard}\n")?;
    out.push_str(HEAD);
    writeln!(out, "/* Nodes: the TxNode of each. */")?;
    for node in cluster.nodes.iter().filter(|node| !node.asks) {
        writeln!(
            out,
            "#define {}_NODE_{} {}u",
            segment.to_uppercase(),
            node.name.to_uppercase(),
            node.tx_node.get()
        )?;
    }
    writeln!(out, "\n/* Channels: the subject of each, and its etag unless a broker gives it. */")?;
    for channel in &cluster.channels {
        let name = format!("{}_CHANNEL_{}", segment.to_uppercase(), channel.name.to_uppercase());
        writeln!(out, "#define {name}_SUBJECT UINT64_C({:#018x})", channel.subject)?;
        if let Some(etag) = channel.etag {
            writeln!(out, "#define {name}_ETAG {}u", etag.get())?;
        }
    }
    for layout in &cluster.contents {
        let prefix = format!("{segment}_{}", layout.name);
        write_type(out, layout, &prefix)?;
        write_decode(out, layout, &prefix)?;
        write_encode(out, layout, &prefix)?;
        write_values(out, layout, &prefix)?;
    }
    writeln!(out, "\n#ifdef __cplusplus\n}}\n#endif\n#endif")
}

fn write_type(out: &mut String, layout: &Layout, prefix: &str) -> std::fmt::Result {
    let upper = prefix.to_uppercase();
    writeln!(out, "\n/* {} */", safe(layout.doc.as_deref().unwrap_or(&format!("Content {}.", layout.name))))?;
    writeln!(out, "#define {upper}_LENGTH {}u", layout.len)?;
    writeln!(out, "#define {upper}_LAYOUT UINT32_C({:#010x})", layout.layout_hash().get())?;
    for field in &layout.fields {
        for label in &field.labels {
            let name = format!("{upper}_{}_{}", field.name.to_uppercase(), label.name.to_uppercase());
            writeln!(out, "#define {name} ({})", constant(label.raw, field))?;
        }
    }
    writeln!(out, "typedef struct {{")?;
    for field in &layout.fields {
        let count = field.count.map_or(String::new(), |count| format!("[{count}]"));
        writeln!(out, "    {} {}{count};{}", c_type(field.kind), identifier(&field.name), note(field))?;
    }
    writeln!(out, "}} {prefix}_t;\n")
}

/// What the number of a field means, as a comment.
fn note(field: &FieldLayout) -> String {
    let unit = field.unit.as_ref().map_or(String::new(), |unit| format!(" {unit}"));
    let mut parts: Vec<String> = field.doc.iter().map(|doc| doc.trim_end_matches('.').to_owned()).collect();
    match field.scaling {
        Some(scaling) if scaling.offset == 0 => parts.push(format!("{}{unit} for each 1", scaling.scale())),
        Some(scaling) => parts.push(format!("{} + {}{unit} for each 1", scaling.offset(), scaling.scale())),
        None if !unit.is_empty() => parts.push(format!("in{unit}")),
        None => {}
    }
    if parts.is_empty() { String::new() } else { format!(" /* {} */", safe(&parts.join("; "))) }
}

fn c_type(kind: FieldType) -> &'static str {
    match kind {
        FieldType::Bool | FieldType::Bit => "bool",
        FieldType::Single => "float",
        FieldType::Double => "double",
        FieldType::Unsigned(1..=8) => "uint8_t",
        FieldType::Unsigned(9..=16) => "uint16_t",
        FieldType::Unsigned(17..=32) => "uint32_t",
        FieldType::Unsigned(_) => "uint64_t",
        FieldType::Signed(1..=8) => "int8_t",
        FieldType::Signed(9..=16) => "int16_t",
        FieldType::Signed(17..=32) => "int32_t",
        FieldType::Signed(_) => "int64_t",
    }
}

/// A number of the type of a field's numbers, as C writes it.
fn constant(number: i128, field: &FieldLayout) -> String {
    match field.kind {
        // The least number cannot be written as a negated one.
        FieldType::Signed(_) if number == i128::from(i64::MIN) => "INT64_MIN".to_owned(),
        FieldType::Signed(_) => format!("INT64_C({number})"),
        _ => format!("UINT64_C({number})"),
    }
}

/// The name of a value: of a list, that of position `n`.
fn value(field: &FieldLayout) -> String {
    let name = identifier(&field.name);
    field.count.map_or(format!("event->{name}"), |_| format!("event->{name}[n]"))
}

/// The statements of a value, in a loop if it is a list.
fn repeated(out: &mut String, field: &FieldLayout, statements: &[String]) -> std::fmt::Result {
    match field.count {
        None => statements.iter().try_for_each(|statement| writeln!(out, "    {statement}")),
        Some(count) => {
            writeln!(out, "    for (unsigned n = 0; n < {count}u; n++) {{")?;
            statements.iter().try_for_each(|statement| writeln!(out, "        {statement}"))?;
            writeln!(out, "    }}")
        }
    }
}

fn place(field: &FieldLayout) -> String {
    let width = field.kind.bits();
    match field.count {
        None => format!("{}u, {width}u", field.at),
        Some(_) => format!("{}u + {width}u * n, {width}u", field.at),
    }
}

fn order(layout: &Layout) -> &'static str {
    match layout.order {
        ByteOrder::Big => "big",
        ByteOrder::Little => "little",
    }
}

fn write_decode(out: &mut String, layout: &Layout, prefix: &str) -> std::fmt::Result {
    writeln!(out, "/* Reads an event. Returns whether the bytes say one. */")?;
    writeln!(
        out,
        "static inline bool {prefix}_decode({prefix}_t *event, const uint8_t *data, size_t length) {{"
    )?;
    writeln!(out, "    if (length != {}_LENGTH) return false;", prefix.to_uppercase())?;
    for field in &layout.fields {
        let (value, width) = (value(field), field.kind.bits());
        let bits = format!("cosmic_get_{}(data, {})", order(layout), place(field));
        let refuse = |unless: String| format!("if (!({unless})) return false;");
        let statements = match field.kind {
            FieldType::Bit => vec![format!("{value} = {bits} != 0;")],
            FieldType::Bool => {
                vec![refuse(format!("{bits} <= 1")), format!("{value} = {bits} != 0;")]
            }
            FieldType::Single => vec![
                format!("{{ uint32_t bits = (uint32_t){bits}; memcpy(&{value}, &bits, 4); }}"),
                refuse(check(field, &value)),
            ],
            FieldType::Double => vec![
                format!("{{ uint64_t bits = {bits}; memcpy(&{value}, &bits, 8); }}"),
                refuse(check(field, &value)),
            ],
            FieldType::Unsigned(_) => {
                vec![format!("{value} = ({}){bits};", c_type(field.kind)), refuse(check(field, &value))]
            }
            FieldType::Signed(_) => vec![
                format!("{value} = ({})cosmic_signed({bits}, {width}u);", c_type(field.kind)),
                refuse(check(field, &value)),
            ],
        };
        repeated(out, field, &without_nothing(statements))?;
    }
    writeln!(out, "    return true;\n}}\n")
}

fn write_encode(out: &mut String, layout: &Layout, prefix: &str) -> std::fmt::Result {
    let upper = prefix.to_uppercase();
    writeln!(out, "/* Writes an event of {upper}_LENGTH bytes. Returns whether all values fit. */")?;
    writeln!(out, "static inline bool {prefix}_encode(const {prefix}_t *event, uint8_t *data) {{")?;
    writeln!(out, "    memset(data, 0, {upper}_LENGTH);")?;
    for field in &layout.fields {
        let value = value(field);
        let put = |bits: &str| format!("cosmic_put_{}(data, {}, {bits});", order(layout), place(field));
        let refuse = format!("if (!({})) return false;", check(field, &value));
        let statements = match field.kind {
            FieldType::Bit | FieldType::Bool => vec![put(&format!("{value} ? 1u : 0u"))],
            FieldType::Single => {
                vec![refuse, format!("{{ uint32_t bits; memcpy(&bits, &{value}, 4); {} }}", put("bits"))]
            }
            FieldType::Double => {
                vec![refuse, format!("{{ uint64_t bits; memcpy(&bits, &{value}, 8); {} }}", put("bits"))]
            }
            FieldType::Unsigned(_) => vec![refuse, put(&value)],
            FieldType::Signed(_) => vec![refuse, put(&format!("(uint64_t){value}"))],
        };
        repeated(out, field, &without_nothing(statements))?;
    }
    writeln!(out, "    return true;\n}}")
}

fn without_nothing(statements: Vec<String>) -> Vec<String> {
    statements.into_iter().filter(|statement| statement != "if (!(true)) return false;").collect()
}

/// The condition that a value must hold.
fn check(field: &FieldLayout, value: &str) -> String {
    if !field.labels.is_empty() {
        let equal = |label: &crate::contents::Label| format!("{value} == {}", constant(label.raw, field));
        return field.labels.iter().map(equal).collect::<Vec<_>>().join(" || ");
    }
    if let (true, Some((least, greatest))) = (field.kind.is_float(), field.range) {
        return format!("{value} >= {:?} && {value} <= {:?}", least.as_f64(), greatest.as_f64());
    }
    if !field.kind.is_integer() {
        return "true".to_owned();
    }
    // Conditions that the type holds by itself would make compilers complain.
    let room = match c_type(field.kind) {
        "uint8_t" => FieldType::Unsigned(8),
        "uint16_t" => FieldType::Unsigned(16),
        "uint32_t" => FieldType::Unsigned(32),
        "uint64_t" => FieldType::Unsigned(64),
        "int8_t" => FieldType::Signed(8),
        "int16_t" => FieldType::Signed(16),
        "int32_t" => FieldType::Signed(32),
        _ => FieldType::Signed(64),
    };
    let ((least, greatest), limits) = (field.raw_range, room.limits());
    let mut conditions = Vec::new();
    if least > limits.0 {
        conditions.push(format!("{value} >= {}", constant(least, field)));
    }
    if greatest < limits.1 {
        conditions.push(format!("{value} <= {}", constant(greatest, field)));
    }
    if conditions.is_empty() { "true".to_owned() } else { conditions.join(" && ") }
}

/// For each field with a scale: what its number means.
fn write_values(out: &mut String, layout: &Layout, prefix: &str) -> std::fmt::Result {
    for field in layout.fields.iter().filter(|field| field.scaling.is_some() && field.count.is_none()) {
        let Scaling { factor, offset, exponent } = field.scaling_or_none();
        let name = &field.name;
        let unit = field.unit.as_ref().map_or(String::new(), |unit| format!(", in {unit}"));
        writeln!(out, "\n/* What {name} means{}. */", safe(&unit))?;
        writeln!(out, "static inline double {prefix}_{name}_value(const {prefix}_t *event) {{")?;
        let divisor = 10_i128.pow(exponent);
        let value = identifier(name);
        writeln!(out, "    return ((double)event->{value} * {factor}.0 + {offset}.0) / {divisor}.0;\n}}")?;
    }
    Ok(())
}

/// A name that is no word of C or C++.
fn identifier(name: &str) -> String {
    const WORDS: [&str; 46] = [
        "and",
        "asm",
        "auto",
        "bool",
        "case",
        "catch",
        "char",
        "class",
        "compl",
        "default",
        "delete",
        "do",
        "double",
        "explicit",
        "export",
        "float",
        "friend",
        "goto",
        "inline",
        "int",
        "long",
        "mutable",
        "namespace",
        "new",
        "not",
        "operator",
        "or",
        "private",
        "protected",
        "public",
        "register",
        "restrict",
        "short",
        "signed",
        "sizeof",
        "switch",
        "template",
        "this",
        "throw",
        "typedef",
        "typename",
        "union",
        "unsigned",
        "using",
        "void",
        "volatile",
    ];
    if WORDS.contains(&name) || name == "xor" { format!("{name}_") } else { name.to_owned() }
}

/// Text that ends no comment.
fn safe(text: &str) -> String {
    text.replace("*/", "* /").replace(['\n', '\r'], " ")
}

const HEAD: &str = r#"#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef COSMIC_BITS
#define COSMIC_BITS
/* The etag in an identifier of 29 bits; the rest is priority and sender. */
#define COSMIC_ETAG(id) ((id) & 0x3FFFu)
#define COSMIC_TX_NODE(id) ((id) >> 14 & 0x7Fu)
#define COSMIC_PRIORITY(id) ((id) >> 21 & 0xFFu)

/* Bit 0 is the highest of the first byte. */
static inline uint64_t cosmic_get_big(const uint8_t *data, unsigned at, unsigned width) {
    uint64_t value = 0;
    for (unsigned bit = at; bit < at + width; bit++) {
        value = value << 1 | (uint64_t)(data[bit / 8] >> (7 - bit % 8) & 1);
    }
    return value;
}

static inline void cosmic_put_big(uint8_t *data, unsigned at, unsigned width, uint64_t value) {
    for (unsigned bit = at; bit < at + width; bit++) {
        unsigned set = (unsigned)(value >> (at + width - 1 - bit) & 1);
        data[bit / 8] = (uint8_t)(data[bit / 8] | set << (7 - bit % 8));
    }
}

/* Bit 0 is the lowest of the first byte. */
static inline uint64_t cosmic_get_little(const uint8_t *data, unsigned at, unsigned width) {
    uint64_t value = 0;
    for (unsigned bit = at; bit < at + width; bit++) {
        value |= (uint64_t)(data[bit / 8] >> bit % 8 & 1) << (bit - at);
    }
    return value;
}

static inline void cosmic_put_little(uint8_t *data, unsigned at, unsigned width, uint64_t value) {
    for (unsigned bit = at; bit < at + width; bit++) {
        unsigned set = (unsigned)(value >> (bit - at) & 1);
        data[bit / 8] = (uint8_t)(data[bit / 8] | set << bit % 8);
    }
}

/* Two's complement of this width. */
static inline int64_t cosmic_signed(uint64_t value, unsigned width) {
    uint64_t sign = UINT64_C(1) << (width - 1);
    uint64_t wide = (value ^ sign) - sign;
    int64_t result;
    memcpy(&result, &wide, sizeof result);
    return result;
}
#endif

"#;
