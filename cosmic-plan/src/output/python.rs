//! The segment as a module of Python: a dataclass for each content, and what tells which frame is whose.
//!
//! The module needs nothing but Python itself. Fields with a scale hold what they mean, not the number on the wire: a
//! float, or an exact `Decimal` where the number has more digits than a float.

use crate::cluster::{Cluster, PlannedClass};
use crate::contents::{ByteOrder, FieldLayout, FieldType, Layout};
use cosmic_core::can::Priority;
use std::fmt::Write as _;

/// The text of the module.
pub fn render(cluster: &Cluster, source_name: &str) -> String {
    let mut out = String::new();
    // Writing into a string does not fail.
    let _ = write_head(&mut out, cluster, source_name);
    for layout in &cluster.contents {
        for field in layout.fields.iter().filter(|field| !field.labels.is_empty()) {
            let _ = write_enum(&mut out, layout, field);
        }
        let _ = write_class(&mut out, layout);
    }
    let _ = write_tables(&mut out, cluster);
    out + TAIL
}

fn write_head(out: &mut String, cluster: &Cluster, source_name: &str) -> std::fmt::Result {
    writeln!(out, "\"\"\"Events of the COSMIC segment {}.\n", cluster.name)?;
    writeln!(out, "Made by cosmic-plan of {}. Change that file, not this one.\n", safe(source_name))?;
    out.push_str(HEAD);
    Ok(())
}

fn write_enum(out: &mut String, layout: &Layout, field: &FieldLayout) -> std::fmt::Result {
    writeln!(out, "class {}(enum.IntEnum):", layout.label_type_name(field))?;
    writeln!(out, "    \"\"\"What `{}` of {} can be.\"\"\"\n", field.name, layout.type_name())?;
    for label in &field.labels {
        writeln!(out, "    {} = {}", label.name.to_uppercase(), label.raw)?;
    }
    writeln!(out, "\n")
}

fn write_class(out: &mut String, layout: &Layout) -> std::fmt::Result {
    let name = layout.type_name();
    writeln!(out, "@dataclasses.dataclass\nclass {name}:")?;
    writeln!(
        out,
        "    \"\"\"{}\"\"\"\n",
        safe(layout.doc.as_deref().unwrap_or(&format!("Content {}.", layout.name)))
    )?;
    for field in &layout.fields {
        let notes = [field.doc.clone(), field.unit.as_ref().map(|unit| format!("In {unit}."))];
        for note in notes.iter().flatten() {
            for line in note.lines() {
                writeln!(out, "    # {}", safe(line))?;
            }
        }
        writeln!(out, "    {}: {}", identifier(&field.name), annotation(layout, field))?;
    }
    writeln!(out, "\n    LENGTH: typing.ClassVar[int] = {}", layout.len)?;
    writeln!(out, "    LAYOUT: typing.ClassVar[int] = {:#010x}", layout.layout_hash().get())?;
    let units =
        layout.fields.iter().filter_map(|field| Some((identifier(&field.name), field.unit.as_ref()?)));
    let units: Vec<String> = units.map(|(name, unit)| format!("\"{name}\": \"{}\"", safe(unit))).collect();
    writeln!(out, "    UNITS: typing.ClassVar[dict] = {{{}}}\n", units.join(", "))?;
    let order = order_name(layout.order);
    writeln!(out, "    @classmethod\n    def decode(cls, data: bytes) -> {name}:")?;
    writeln!(out, "        \"\"\"The event that these bytes say; Malformed if they say none.\"\"\"")?;
    writeln!(out, "        bits = _Bits.of(data, {}, \"{order}\")", layout.len)?;
    writeln!(out, "        return cls(")?;
    for field in &layout.fields {
        writeln!(out, "            {}={},", identifier(&field.name), reading(layout, field))?;
    }
    writeln!(out, "        )\n")?;
    writeln!(out, "    def encode(self) -> bytes:")?;
    writeln!(out, "        \"\"\"The bytes of this event; Malformed if a value does not fit.\"\"\"")?;
    writeln!(out, "        bits = _Bits({}, \"{order}\")", layout.len)?;
    for field in &layout.fields {
        writeln!(out, "        {}", writing(layout, field))?;
    }
    writeln!(out, "        return bits.data()\n\n")
}

fn order_name(order: ByteOrder) -> &'static str {
    match order {
        ByteOrder::Big => "big",
        ByteOrder::Little => "little",
    }
}

fn annotation(layout: &Layout, field: &FieldLayout) -> String {
    let one = match field.kind {
        FieldType::Bool | FieldType::Bit => "bool".to_owned(),
        FieldType::Single | FieldType::Double => "float".to_owned(),
        _ if !field.labels.is_empty() => layout.label_type_name(field),
        _ if field.scaling.is_some() && is_exact(field) => "decimal.Decimal".to_owned(),
        _ if field.scaling.is_some() => "float".to_owned(),
        _ => "int".to_owned(),
    };
    if field.count.is_some() { format!("typing.Tuple[{one}, ...]") } else { one }
}

/// Returns whether a float has too few digits for it.
fn is_exact(field: &FieldLayout) -> bool {
    field.kind.bits() > 53
}

/// The arguments by which the bits of a field are read and written: where, how wide, what they mean.
fn arguments(layout: &Layout, field: &FieldLayout, position: &str) -> (String, String) {
    let width = field.kind.bits();
    let at = match field.count {
        Some(_) => format!("{} + {width} * {position}", field.at),
        None => field.at.to_string(),
    };
    let name = format!("\"{}\"", field.name);
    let pair = |(least, greatest): (String, String)| format!("({least}, {greatest})");
    let signed = if matches!(field.kind, FieldType::Signed(_)) { "True" } else { "False" };
    match field.kind {
        FieldType::Bool | FieldType::Bit => ("boolean".to_owned(), format!("{name}, {at}, {width}")),
        FieldType::Single | FieldType::Double => {
            let range = field.range.map_or("None".to_owned(), |(least, greatest)| {
                pair((format!("{:?}", least.as_f64()), format!("{:?}", greatest.as_f64())))
            });
            ("real".to_owned(), format!("{name}, {at}, {width}, {range}"))
        }
        _ if !field.labels.is_empty() => (
            "label".to_owned(),
            format!("{name}, {at}, {width}, {signed}, {}", layout.label_type_name(field)),
        ),
        _ => {
            let range = pair((field.raw_range.0.to_string(), field.raw_range.1.to_string()));
            match field.scaling {
                None => ("integer".to_owned(), format!("{name}, {at}, {width}, {signed}, {range}")),
                Some(scaling) => {
                    let exact = if is_exact(field) { "True" } else { "False" };
                    let scaling = format!("({}, {}, {})", scaling.factor, scaling.offset, scaling.exponent);
                    (
                        "scaled".to_owned(),
                        format!("{name}, {at}, {width}, {signed}, {range}, {scaling}, {exact}"),
                    )
                }
            }
        }
    }
}

fn reading(layout: &Layout, field: &FieldLayout) -> String {
    let (method, arguments) = arguments(layout, field, "n");
    let one = format!("bits.{method}({arguments})");
    field.count.map_or(one.clone(), |count| format!("tuple({one} for n in range({count}))"))
}

fn writing(layout: &Layout, field: &FieldLayout) -> String {
    let (method, arguments) = arguments(layout, field, "n");
    let name = identifier(&field.name);
    match field.count {
        None => format!("bits.put_{method}(self.{name}, {arguments})"),
        Some(count) => format!(
            "for n, value in enumerate(_of_length(self.{name}, {count}, \"{}\")):\n            \
             bits.put_{method}(value, {arguments})",
            field.name
        ),
    }
}

fn write_tables(out: &mut String, cluster: &Cluster) -> std::fmt::Result {
    writeln!(out, "# The channels, by name.\nCHANNELS = {{")?;
    for channel in &cluster.channels {
        let etag = channel.etag.map_or("None".to_owned(), |etag| etag.get().to_string());
        let content = cluster.layout_of(channel).map_or("None".to_owned(), Layout::type_name);
        writeln!(
            out,
            "    \"{0}\": Channel(\"{0}\", {1:#018x}, {etag}, \"{2}\", {3}, {content}),",
            channel.name,
            channel.subject,
            channel.class.abbreviation(),
            channel.length
        )?;
    }
    writeln!(out, "}}\n\n# The nodes, by TxNode.\nNODES = {{")?;
    for node in cluster.nodes.iter().filter(|node| !node.asks) {
        writeln!(out, "    {}: \"{}\",", node.tx_node.get(), node.name)?;
    }
    writeln!(out, "}}\n\n# Of each channel the priority under which the DBC file lists it.\n_LISTED = {{")?;
    for channel in &cluster.channels {
        let priority = match &channel.class {
            PlannedClass::Hard { .. } => Priority::HARD,
            PlannedClass::Soft => Priority::SOFT_MOST_URGENT,
            PlannedClass::NonRealTime { importance } => PlannedClass::priority_of(*importance),
        };
        writeln!(out, "    \"{}\": {},", channel.name, priority.get())?;
    }
    writeln!(out, "}}\n\n")
}

/// A name that is no word of Python.
fn identifier(name: &str) -> String {
    const WORDS: [&str; 17] = [
        "and", "assert", "class", "def", "del", "elif", "except", "exec", "finally", "from", "global",
        "import", "is", "lambda", "nonlocal", "pass", "raise",
    ];
    const MORE: [&str; 9] = ["not", "or", "with", "print", "none", "cls", "decode", "encode", "bits"];
    if WORDS.contains(&name) || MORE.contains(&name) { format!("{name}_") } else { name.to_owned() }
}

/// Text that ends no string and no comment.
fn safe(text: &str) -> String {
    text.replace('\\', "/").replace('"', "'").replace(['\n', '\r'], " ")
}

const HEAD: &str = r#"Nothing but Python 3.8 is needed.

    for frame in can.LogReader("candump.log"):
        print(decode(frame.arbitration_id, frame.data))
"""

from __future__ import annotations

import dataclasses
import decimal
import enum
import fractions
import struct
import typing


class Malformed(ValueError):
    """Bytes that are no event of the content, or a value that does not fit into it."""


@dataclasses.dataclass(frozen=True)
class Channel:
    """An event channel. Its etag is None where a broker gives one."""

    name: str
    subject: int
    etag: typing.Optional[int]
    quality: str
    length: int
    content: typing.Any


@dataclasses.dataclass(frozen=True)
class Event:
    """An event as a frame carries it; `content` is bytes where the description states no content, or a part of an
    event that is longer than a frame."""

    channel: Channel
    publisher: str
    priority: int
    content: typing.Any


class _Bits:
    """The bits of an event as one number."""

    def __init__(self, length: int, order: str, value: int = 0):
        self._length = length
        self._order = order
        self._value = value

    @classmethod
    def of(cls, data: bytes, length: int, order: str) -> _Bits:
        if len(data) != length:
            raise Malformed(f"{len(data)} bytes instead of {length}")
        return cls(length, order, int.from_bytes(data, order))

    def data(self) -> bytes:
        return self._value.to_bytes(self._length, self._order)

    def _shift(self, at: int, width: int) -> int:
        return 8 * self._length - at - width if self._order == "big" else at

    def _get(self, at: int, width: int, signed: bool = False) -> int:
        value = self._value >> self._shift(at, width) & ((1 << width) - 1)
        return value - (1 << width) if signed and value >> (width - 1) else value

    def _put(self, value: int, at: int, width: int) -> None:
        self._value |= (value & ((1 << width) - 1)) << self._shift(at, width)

    def integer(self, name, at, width, signed, limits):
        return _within(self._get(at, width, signed), limits, name)

    def put_integer(self, value, name, at, width, signed, limits):
        self._put(_within(int(value), limits, name), at, width)

    def scaled(self, name, at, width, signed, limits, scaling, exact):
        factor, offset, places = scaling
        steps = self.integer(name, at, width, signed, limits) * factor + offset
        return decimal.Decimal(f"{steps}E-{places}") if exact else steps / 10**places

    def put_scaled(self, value, name, at, width, signed, limits, scaling, exact):
        factor, offset, places = scaling
        try:
            steps = (fractions.Fraction(value) * 10**places - offset) / factor
        except (ValueError, OverflowError) as error:
            raise Malformed(f"{name} is {value}") from error
        half = fractions.Fraction(1, 2)
        self.put_integer(int(steps + half if steps >= 0 else steps - half), name, at, width, signed, limits)

    def label(self, name, at, width, signed, names):
        return _named(self._get(at, width, signed), names, name)

    def put_label(self, value, name, at, width, signed, names):
        self._put(int(_named(value, names, name)), at, width)

    def boolean(self, name, at, width):
        return _within(self._get(at, width), (0, 1), name) == 1

    def put_boolean(self, value, name, at, width):
        self._put(int(bool(value)), at, width)

    def real(self, name, at, width, limits):
        packed = self._get(at, width).to_bytes(width // 8, "big")
        value = struct.unpack(">f" if width == 32 else ">d", packed)[0]
        return value if limits is None else _within(value, limits, name)

    def put_real(self, value, name, at, width, limits):
        try:
            packed = struct.pack(">f" if width == 32 else ">d", value)
        except OverflowError as error:
            raise Malformed(f"{name} is {value}") from error
        if limits is not None:
            _within(struct.unpack(">f" if width == 32 else ">d", packed)[0], limits, name)
        self._put(int.from_bytes(packed, "big"), at, width)


def _within(value, limits, name):
    # A number that is none is in no range.
    if not limits[0] <= value <= limits[1]:
        raise Malformed(f"{name} is {value}, outside {limits[0]} to {limits[1]} on the wire")
    return value


def _named(value, names, name):
    try:
        return names(value)
    except ValueError as error:
        raise Malformed(f"{name} is {value}, which has no name") from error


def _of_length(values, count, name):
    if len(values) != count:
        raise Malformed(f"{name} has {len(values)} values instead of {count}")
    return values


"#;

const TAIL: &str = r#"_BY_SUBJECT = {channel.subject: channel for channel in CHANNELS.values()}


def fields_of_id(can_id: int) -> typing.Tuple[int, int, int]:
    """Priority, TxNode and etag of an identifier of 29 bits."""
    return can_id >> 21 & 0xFF, can_id >> 14 & 0x7F, can_id & 0x3FFF


class Decoder:
    """Decodes frames. It learns from the frames of the broker which etag a channel has, where the description fixes
    none."""

    def __init__(self) -> None:
        self.channels = {c.etag: c for c in CHANNELS.values() if c.etag is not None}
        self._halves: typing.Dict[int, bytes] = {}

    def channel_of(self, can_id: int) -> typing.Optional[Channel]:
        """The channel of a frame with this identifier, whatever its priority and sender; None if there is none."""
        return self.channels.get(fields_of_id(can_id)[2])

    def decode(self, can_id: int, data: bytes) -> typing.Optional[Event]:
        """The event in an extended data frame; None for frames that are no events of the segment's channels.

        Malformed if the frame is one of a channel, and its bytes are not what its content says.
        """
        priority, tx_node, etag = fields_of_id(can_id)
        data = bytes(data)
        if etag == 4:
            self._learn(data)
        channel = self.channels.get(etag)
        if channel is None:
            return None
        whole = channel.content is not None and channel.length <= 8
        content = channel.content.decode(data) if whole else data
        return Event(channel, NODES.get(tx_node, f"TxNode {tx_node}"), priority, content)

    def _learn(self, data: bytes) -> None:
        if len(data) != 8 or data[1] not in (0, 1, 4, 5):
            return
        etag = int.from_bytes(data[2:4], "big")
        if data[1] % 2 == 0:
            self._halves[etag] = data[4:]
        elif etag in self._halves:
            channel = _BY_SUBJECT.get(int.from_bytes(self._halves.pop(etag) + data[4:], "big"))
            if channel is not None and channel.etag is None:
                self.channels[etag] = channel


_DECODER = Decoder()


def decode(can_id: int, data: bytes) -> typing.Optional[Event]:
    """As Decoder.decode, with one decoder for all."""
    return _DECODER.decode(can_id, data)


def dbc_id(can_id: int) -> int:
    """The identifier under which the DBC file lists a frame: a soft one varies in its priority.

    With cantools: database.decode_message(dbc_id(frame.arbitration_id), frame.data)
    """
    channel = _DECODER.channel_of(can_id)
    return can_id if channel is None else can_id & 0x1FFFFF | _LISTED[channel.name] << 21
"#;
