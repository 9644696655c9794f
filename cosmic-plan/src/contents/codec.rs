//! From bytes to values and back, on a host.
//!
//! The type that the planner generates for firmware does the same; a test holds the two equal.

use super::decimal::Decimal;
use super::layout::{ByteOrder, FieldLayout, FieldType, Layout};
use std::fmt;

/// The value of a field.
#[derive(Clone, PartialEq, Debug)]
pub enum Value {
    /// A truth value.
    Boolean(bool),
    /// A whole number.
    Integer(i128),
    /// A whole number with a scale: what it means.
    Scaled(Decimal),
    /// A floating-point number of 32 bits.
    Single(f32),
    /// A floating-point number of 64 bits.
    Double(f64),
    /// A value with a name.
    Label {
        /// The name.
        name: String,
        /// The number on the wire.
        raw: i128,
    },
    /// Several of them.
    List(Vec<Value>),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Boolean(value) => value.fmt(f),
            Self::Integer(value) => value.fmt(f),
            Self::Scaled(value) => value.fmt(f),
            Self::Single(value) => value.fmt(f),
            Self::Double(value) => value.fmt(f),
            Self::Label { name, .. } => name.fmt(f),
            Self::List(values) => {
                f.write_str("[")?;
                for (at, value) in values.iter().enumerate() {
                    if at > 0 {
                        f.write_str(", ")?;
                    }
                    value.fmt(f)?;
                }
                f.write_str("]")
            }
        }
    }
}

/// A decoded field.
#[derive(Clone, PartialEq, Debug)]
pub struct Field<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its value.
    pub value: Value,
    /// The unit of the value.
    pub unit: Option<&'a str>,
}

impl fmt::Display for Field<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {}", self.name, self.value)?;
        self.unit.map_or(Ok(()), |unit| write!(f, " {unit}"))
    }
}

/// Why bytes are no value of a content.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum NotDecoded {
    /// There are too few or too many.
    Length {
        /// So many there are.
        found: usize,
        /// So many there should be.
        expected: usize,
    },
    /// A field has a value that the description does not allow.
    Value {
        /// The field.
        field: String,
        /// What it says.
        what: String,
    },
}

impl fmt::Display for NotDecoded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length { found, expected } => write!(f, "{found} bytes instead of {expected}"),
            Self::Value { field, what } => write!(f, "{field} {what}"),
        }
    }
}

impl std::error::Error for NotDecoded {}

/// Why values are no content.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum NotEncoded {
    /// A field is given twice, or does not exist.
    Unexpected(String),
    /// A field is not given.
    Missing(String),
    /// A field cannot have the value.
    Value {
        /// The field.
        field: String,
        /// What is wrong, and what would be right.
        what: String,
    },
}

impl fmt::Display for NotEncoded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unexpected(field) => write!(f, "{field} is given twice, or is no field of the content"),
            Self::Missing(field) => write!(f, "{field} is missing"),
            Self::Value { field, what } => write!(f, "{field}: {what}"),
        }
    }
}

impl std::error::Error for NotEncoded {}

impl Layout {
    /// The fields that the bytes of an event say, in the order of the description.
    ///
    /// # Errors
    /// The first field that is not as described: the same bytes that firmware refuses as malformed.
    pub fn decode(&self, bytes: &[u8]) -> Result<Vec<Field<'_>>, NotDecoded> {
        if bytes.len() != self.len {
            return Err(NotDecoded::Length { found: bytes.len(), expected: self.len });
        }
        self.fields.iter().map(|field| self.decode_field(field, bytes)).collect()
    }

    fn decode_field<'a>(&self, field: &'a FieldLayout, bytes: &[u8]) -> Result<Field<'a>, NotDecoded> {
        let one = |position: usize| {
            let bits = get(bytes, field.bit_of(position), field.kind.bits(), self.order);
            field.value_of(bits).map_err(|what| NotDecoded::Value { field: field.name.clone(), what })
        };
        let value = match field.count {
            None => one(0)?,
            Some(count) => Value::List((0..count).map(one).collect::<Result<_, _>>()?),
        };
        Ok(Field { name: &field.name, value, unit: field.unit.as_deref() })
    }

    /// The bytes of an event with these values, each field once, in any order. Bits that belong to no field are 0.
    ///
    /// # Errors
    /// The first field that is missing, unknown or cannot have its value.
    pub fn encode(&self, values: &[(&str, Value)]) -> Result<Vec<u8>, NotEncoded> {
        for (at, (name, _)) in values.iter().enumerate() {
            if self.field(name).is_none() || values[..at].iter().any(|(other, _)| other == name) {
                return Err(NotEncoded::Unexpected((*name).to_owned()));
            }
        }
        let mut bytes = vec![0; self.len];
        for field in &self.fields {
            let value = values.iter().find(|(name, _)| *name == field.name);
            let (_, value) = value.ok_or_else(|| NotEncoded::Missing(field.name.clone()))?;
            self.encode_field(field, value, &mut bytes)?;
        }
        Ok(bytes)
    }

    /// As [`Layout::encode`], from values as people write them: `("speed", "13.5")`, `("state", "on")`,
    /// `("valid", "true")`, `("data", "1, 2, 3")`.
    ///
    /// # Errors
    /// As [`Layout::encode`].
    pub fn encode_text(&self, values: &[(&str, &str)]) -> Result<Vec<u8>, NotEncoded> {
        let parsed = values.iter().map(|(name, text)| {
            let field = self.field(name).ok_or_else(|| NotEncoded::Unexpected((*name).to_owned()))?;
            let value = field.parse(text);
            let value = value.map_err(|what| NotEncoded::Value { field: field.name.clone(), what })?;
            Ok((*name, value))
        });
        self.encode(&parsed.collect::<Result<Vec<_>, NotEncoded>>()?)
    }

    fn encode_field(&self, field: &FieldLayout, value: &Value, bytes: &mut [u8]) -> Result<(), NotEncoded> {
        let wrong = |what: String| NotEncoded::Value { field: field.name.clone(), what };
        let one = std::slice::from_ref(value);
        let values = match (field.count, value) {
            (None, _) => one,
            (Some(count), Value::List(values)) if values.len() == count => values,
            (Some(count), _) => return Err(wrong(format!("write a list of {count} values"))),
        };
        for (position, value) in values.iter().enumerate() {
            let bits = field.bits_of(value).map_err(wrong)?;
            put(bytes, field.bit_of(position), field.kind.bits(), self.order, bits);
        }
        Ok(())
    }
}

impl FieldLayout {
    /// What the bits of a value say, or why they say nothing.
    pub(super) fn value_of(&self, bits: u64) -> Result<Value, String> {
        let raw = match self.kind {
            FieldType::Signed(width) => i128::from((bits << (64 - width)).cast_signed() >> (64 - width)),
            _ => i128::from(bits),
        };
        let value = match self.kind {
            FieldType::Bit => Value::Boolean(bits == 1),
            FieldType::Bool if bits > 1 => return Err(format!("is {bits}, neither 0 nor 1")),
            FieldType::Bool => Value::Boolean(bits == 1),
            FieldType::Single => Value::Single(f32::from_bits(bits as u32)),
            FieldType::Double => Value::Double(f64::from_bits(bits)),
            FieldType::Unsigned(_) | FieldType::Signed(_) => self.number(raw)?,
        };
        match value {
            Value::Single(value) if !self.allows(f64::from(value)) => Err(self.outside(value)),
            Value::Double(value) if !self.allows(value) => Err(self.outside(value)),
            value => Ok(value),
        }
    }

    fn number(&self, raw: i128) -> Result<Value, String> {
        if !self.labels.is_empty() {
            let label = self.labels.iter().find(|label| label.raw == raw);
            let label = label.ok_or_else(|| format!("is {raw}, which has no name"))?;
            return Ok(Value::Label { name: label.name.clone(), raw });
        }
        let scaled = self.scaling_or_none().value(raw);
        if raw < self.raw_range.0 || raw > self.raw_range.1 {
            return Err(self.outside(scaled));
        }
        Ok(if self.scaling.is_some() { Value::Scaled(scaled) } else { Value::Integer(raw) })
    }

    fn outside(&self, value: impl fmt::Display) -> String {
        let (least, greatest) = self.range.map_or_else(
            || (self.raw_range.0.to_string(), self.raw_range.1.to_string()),
            |(least, greatest)| (least.to_string(), greatest.to_string()),
        );
        format!("is {value}, outside {least} to {greatest}")
    }

    /// Returns whether a floating-point field may have this value.
    fn allows(&self, value: f64) -> bool {
        self.range.is_none_or(|(least, greatest)| value >= least.as_f64() && value <= greatest.as_f64())
    }

    /// The bits of a value, or why it has none.
    fn bits_of(&self, value: &Value) -> Result<u64, String> {
        let bits = match (self.kind, value) {
            (FieldType::Bool | FieldType::Bit, Value::Boolean(value)) => u64::from(*value),
            (FieldType::Single, Value::Single(value)) => u64::from(value.to_bits()),
            (FieldType::Double, Value::Double(value)) => value.to_bits(),
            (FieldType::Unsigned(_) | FieldType::Signed(_), value) => {
                let raw = self
                    .raw_of(value)
                    .ok_or_else(|| format!("{value} is no value of it; {}", self.choice()))?;
                let (least, greatest) = self.kind.limits();
                if raw < least || raw > greatest {
                    return Err(format!("{value} does not fit; {}", self.choice()));
                }
                raw as u64 & (u64::MAX >> (64 - self.kind.bits()))
            }
            _ => return Err(format!("{value} is not of its type, {}", self.kind.name())),
        };
        self.value_of(bits).map(|_| bits)
    }

    fn raw_of(&self, value: &Value) -> Option<i128> {
        match value {
            Value::Label { name, .. } => {
                self.labels.iter().find(|label| label.name == *name).map(|label| label.raw)
            }
            Value::Integer(raw) if self.scaling.is_none() => Some(*raw),
            Value::Integer(value) => self.scaling_or_none().nearest_raw(Decimal::new(*value, 0)),
            Value::Scaled(value) => self.scaling_or_none().nearest_raw(*value),
            _ => None,
        }
    }

    /// What may be written.
    fn choice(&self) -> String {
        if !self.labels.is_empty() {
            let names: Vec<&str> = self.labels.iter().map(|label| label.name.as_str()).collect();
            return format!("write one of {}", names.join(", "));
        }
        let scaling = self.scaling_or_none();
        format!("write {} to {}", scaling.value(self.raw_range.0), scaling.value(self.raw_range.1))
    }

    /// The value that a text says.
    fn parse(&self, text: &str) -> Result<Value, String> {
        let Some(count) = self.count else { return self.parse_one(text.trim()) };
        let inner = text.trim();
        let inner = inner.strip_prefix('[').and_then(|inner| inner.strip_suffix(']')).unwrap_or(inner);
        let values: Vec<Value> =
            inner.split(',').map(|text| self.parse_one(text.trim())).collect::<Result<_, _>>()?;
        if values.len() == count {
            Ok(Value::List(values))
        } else {
            Err(format!("{} values instead of {count}; write all, with commas between", values.len()))
        }
    }

    fn parse_one(&self, text: &str) -> Result<Value, String> {
        match self.kind {
            FieldType::Bool | FieldType::Bit => match text {
                "true" | "1" => Ok(Value::Boolean(true)),
                "false" | "0" => Ok(Value::Boolean(false)),
                _ => Err(format!("{text:?} is neither true nor false")),
            },
            FieldType::Single => {
                text.parse().map(Value::Single).map_err(|_| format!("{text:?} is no number"))
            }
            FieldType::Double => {
                text.parse().map(Value::Double).map_err(|_| format!("{text:?} is no number"))
            }
            _ if !self.labels.is_empty() => Ok(Value::Label { name: text.to_owned(), raw: 0 }),
            FieldType::Unsigned(_) | FieldType::Signed(_) => {
                if let Some(digits) = text.strip_prefix("0x").filter(|_| self.scaling.is_none()) {
                    let number = i128::from_str_radix(digits, 16);
                    return number.map(Value::Integer).map_err(|_| format!("{text:?} is no number"));
                }
                if self.scaling.is_none() {
                    return text
                        .parse()
                        .map(Value::Integer)
                        .map_err(|_| format!("{text:?} is no whole number; {}", self.choice()));
                }
                let number = Decimal::parse(text);
                number.map(Value::Scaled).ok_or_else(|| format!("{text:?} is no number; {}", self.choice()))
            }
        }
    }
}

/// `width` bits from bit `at` on; 0 where there are none.
fn get(bytes: &[u8], at: usize, width: usize, order: ByteOrder) -> u64 {
    let mut value = 0;
    for position in 0..width {
        let bit = at + position;
        let byte = u64::from(bytes.get(bit / 8).copied().unwrap_or(0));
        match order {
            ByteOrder::Big => value = value << 1 | byte >> (7 - bit % 8) & 1,
            ByteOrder::Little => value |= (byte >> (bit % 8) & 1) << position,
        }
    }
    value
}

/// Writes `width` bits from bit `at` on; those behind the end are lost.
fn put(bytes: &mut [u8], at: usize, width: usize, order: ByteOrder, value: u64) {
    for position in 0..width {
        let bit = at + position;
        let (taken, shift) = match order {
            ByteOrder::Big => (value >> (width - 1 - position) & 1, 7 - bit % 8),
            ByteOrder::Little => (value >> position & 1, bit % 8),
        };
        if let Some(byte) = bytes.get_mut(bit / 8) {
            *byte = *byte & !(1 << shift) | (taken as u8) << shift;
        }
    }
}
