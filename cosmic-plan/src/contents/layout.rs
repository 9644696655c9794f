//! Where the fields of a content stand, and what their values mean.

use super::decimal::Decimal;
use cosmic_core::event_layer::layout_of;
use cosmic_core::protocol::LayoutHash;

/// How bits and bytes follow each other.
///
/// Bits are counted from the start of the content. With [`ByteOrder::Big`] bit 0 is the highest of byte 0, and a
/// field's highest bit comes first; that is what DBC files call Motorola. With [`ByteOrder::Little`] bit 0 is the
/// lowest of byte 0, and a field's lowest bit comes first: Intel.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ByteOrder {
    /// The most significant first, as in all messages of the protocol.
    Big,
    /// The least significant first.
    Little,
}

/// The type of a field on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FieldType {
    /// A number from 0, of 1 to 64 bits.
    Unsigned(u8),
    /// A number in two's complement, of 2 to 64 bits.
    Signed(u8),
    /// A truth value that takes a byte, 0 or 1.
    Bool,
    /// A truth value that takes a bit.
    Bit,
    /// IEEE 754, 32 bits.
    Single,
    /// IEEE 754, 64 bits.
    Double,
}

impl FieldType {
    /// The type of this name; `None` if there is none.
    pub fn parse(name: &str) -> Option<Self> {
        let bits = |digits: &str, least: u8| {
            let plain = !digits.starts_with(['0', '+']);
            digits.parse::<u8>().ok().filter(|bits| plain && (least..=64).contains(bits))
        };
        match name {
            "bool" => Some(Self::Bool),
            "bit" => Some(Self::Bit),
            "f32" => Some(Self::Single),
            "f64" => Some(Self::Double),
            _ => match (name.strip_prefix('u'), name.strip_prefix('i')) {
                (Some(digits), _) => bits(digits, 1).map(Self::Unsigned),
                (_, Some(digits)) => bits(digits, 2).map(Self::Signed),
                _ => None,
            },
        }
    }

    /// Its name.
    pub fn name(self) -> String {
        match self {
            Self::Unsigned(bits) => format!("u{bits}"),
            Self::Signed(bits) => format!("i{bits}"),
            Self::Bool => "bool".to_owned(),
            Self::Bit => "bit".to_owned(),
            Self::Single => "f32".to_owned(),
            Self::Double => "f64".to_owned(),
        }
    }

    /// How many bits it takes.
    pub fn bits(self) -> usize {
        match self {
            Self::Unsigned(bits) | Self::Signed(bits) => usize::from(bits),
            Self::Bool => 8,
            Self::Bit => 1,
            Self::Single => 32,
            Self::Double => 64,
        }
    }

    /// Returns whether it is a whole number, so that it can have a scale or named values.
    pub fn is_integer(self) -> bool {
        matches!(self, Self::Unsigned(_) | Self::Signed(_))
    }

    /// Returns whether it is a floating-point number.
    pub fn is_float(self) -> bool {
        matches!(self, Self::Single | Self::Double)
    }

    /// The least and the greatest whole number that its bits can say.
    pub fn limits(self) -> (i128, i128) {
        match self {
            Self::Signed(bits) => (-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
            Self::Unsigned(bits) => (0, (1 << bits) - 1),
            Self::Bool | Self::Bit => (0, 1),
            Self::Single | Self::Double => (0, (1 << self.bits()) - 1),
        }
    }
}

/// From a raw number to what it means: `(raw * factor + offset) / 10^exponent`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Scaling {
    /// What one step of the raw number is, in `10^-exponent`.
    pub factor: i128,
    /// What the raw number zero is, in `10^-exponent`.
    pub offset: i128,
    /// The digits behind the point.
    pub exponent: u32,
}

impl Scaling {
    /// The value is the raw number.
    pub const NONE: Self = Self { factor: 1, offset: 0, exponent: 0 };

    /// The scaling by `scale`, which is above zero, and `offset`, for raw numbers of this type. `None` if its values
    /// have too many digits.
    pub fn new(scale: Decimal, offset: Decimal, of: FieldType) -> Option<Self> {
        let exponent = scale.exponent().max(offset.exponent());
        let (factor, offset) = (scale.scaled_to(exponent)?, offset.scaled_to(exponent)?);
        let scaling = Self { factor, offset, exponent };
        let (least, greatest) = of.limits();
        let fits = |raw: i128| {
            let value = raw.checked_mul(factor)?.checked_add(offset)?;
            (value.unsigned_abs() < 10_u128.pow(36)).then_some(())
        };
        fits(least).and(fits(greatest)).map(|()| scaling)
    }

    /// What a raw number means.
    pub fn value(self, raw: i128) -> Decimal {
        Decimal::new(raw * self.factor + self.offset, self.exponent)
    }

    /// The raw number whose value is nearest, and of two the one farther from zero; `None` if the numbers are too
    /// large.
    pub fn nearest_raw(self, value: Decimal) -> Option<i128> {
        let (numerator, denominator) = self.quotient(value)?;
        let half = if numerator < 0 { -denominator } else { denominator };
        Some(numerator.checked_mul(2)?.checked_add(half)? / denominator.checked_mul(2)?)
    }

    /// The least raw number whose value is not below this one.
    pub fn least_raw(self, value: Decimal) -> Option<i128> {
        let (numerator, denominator) = self.quotient(value)?;
        Some(-(-numerator).div_euclid(denominator))
    }

    /// The greatest raw number whose value is not above this one.
    pub fn greatest_raw(self, value: Decimal) -> Option<i128> {
        let (numerator, denominator) = self.quotient(value)?;
        Some(numerator.div_euclid(denominator))
    }

    /// The raw number as a quotient; the denominator is above zero.
    fn quotient(self, value: Decimal) -> Option<(i128, i128)> {
        let exponent = self.exponent.max(value.exponent());
        let more = 10_i128.checked_pow(exponent - self.exponent)?;
        let numerator = value.scaled_to(exponent)?.checked_sub(self.offset.checked_mul(more)?)?;
        Some((numerator, self.factor.checked_mul(more)?))
    }

    /// What one step is.
    pub fn scale(self) -> Decimal {
        Decimal::new(self.factor, self.exponent)
    }

    /// What zero is.
    pub fn offset(self) -> Decimal {
        Decimal::new(self.offset, self.exponent)
    }
}

/// A value with a name.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Label {
    /// The name, in lower case.
    pub name: String,
    /// The raw number.
    pub raw: i128,
}

/// A field of a content.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FieldLayout {
    /// Its name.
    pub name: String,
    /// What it is, for people.
    pub doc: Option<String>,
    /// Its type on the wire.
    pub kind: FieldType,
    /// How many of them follow each other; `None` for a single one.
    pub count: Option<usize>,
    /// Its first bit, counted as [`ByteOrder`] says.
    pub at: usize,
    /// Whether [`FieldLayout::at`] was stated, and is not where the field would stand anyway.
    pub moved: bool,
    /// From raw numbers to values.
    pub scaling: Option<Scaling>,
    /// The unit of its values.
    pub unit: Option<String>,
    /// The least and the greatest value, as stated.
    pub range: Option<(Decimal, Decimal)>,
    /// The least and the greatest raw number, of a whole number: by its range or by its type.
    pub raw_range: (i128, i128),
    /// The names of its values; if there are any, it has no others.
    pub labels: Vec<Label>,
}

impl FieldLayout {
    /// How many values it has: one, or as many as its list.
    pub fn values(&self) -> usize {
        self.count.unwrap_or(1)
    }

    /// Where its value of this position begins.
    pub fn bit_of(&self, position: usize) -> usize {
        self.at + position * self.kind.bits()
    }

    /// The bits of all its values.
    pub fn span(&self) -> std::ops::Range<usize> {
        self.at..self.bit_of(self.values())
    }

    /// The scaling, or that of a plain number.
    pub fn scaling_or_none(&self) -> Scaling {
        self.scaling.unwrap_or(Scaling::NONE)
    }

    /// Returns whether the range says more than the type.
    pub fn has_raw_range(&self) -> bool {
        self.kind.is_integer() && self.labels.is_empty() && self.raw_range != self.kind.limits()
    }

    /// The type as the hash of the layout has it: that of Rust, as far as there is one.
    fn on_the_wire(&self) -> String {
        let mut text = match self.count {
            Some(count) => format!("[{}; {count}]", self.kind.name()),
            None => self.kind.name(),
        };
        if self.moved {
            text += &format!("@{}", self.at);
        }
        text
    }

    /// What its values mean, for the hash; empty if they are plain numbers.
    fn meaning(&self) -> String {
        let mut text = String::new();
        if let Some(scaling) = self.scaling {
            text += &format!("*{}+{}", scaling.scale(), scaling.offset());
        }
        if let Some(unit) = &self.unit {
            text += &format!(" {unit}");
        }
        for label in &self.labels {
            text += &format!("|{}={}", label.name, label.raw);
        }
        text
    }
}

/// The content of a channel: what stands where in the bytes of its events.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Layout {
    /// Its name.
    pub name: String,
    /// What it is, for people.
    pub doc: Option<String>,
    /// Raised when the meaning changes and the fields do not.
    pub version: u8,
    /// How bits and bytes follow each other.
    pub order: ByteOrder,
    /// Bytes of an event.
    pub len: usize,
    /// The fields, in the order of the file.
    pub fields: Vec<FieldLayout>,
}

impl Layout {
    /// The field of this name.
    pub fn field(&self, name: &str) -> Option<&FieldLayout> {
        self.fields.iter().find(|field| field.name == name)
    }

    /// The hash of where what stands. It is that of a type that [`content!`](cosmic_core::content) declares with the
    /// same types in the same order.
    pub fn wire_hash(&self) -> LayoutHash {
        self.hash(|field| field.on_the_wire(), &[])
    }

    /// The hash that nodes compare: of where what stands, what it means, and the version. It is
    /// [`Layout::wire_hash`] as long as only types are stated.
    pub fn layout_hash(&self) -> LayoutHash {
        let version: &[String] = if self.version == 1 { &[] } else { &[format!("v{}", self.version)] };
        self.hash(|field| field.on_the_wire() + &field.meaning(), version)
    }

    fn hash(&self, of_field: impl Fn(&FieldLayout) -> String, more: &[String]) -> LayoutHash {
        let mut words: Vec<String> = self.fields.iter().map(of_field).collect();
        if self.order == ByteOrder::Little {
            words.push("little".to_owned());
        }
        // Bytes behind the last field, of which the types do not tell.
        let needed = self.fields.iter().map(|field| field.span().end).max().unwrap_or(0).div_ceil(8);
        if needed < self.len {
            words.push(format!("#{}", self.len));
        }
        words.extend_from_slice(more);
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        layout_of(&words)
    }

    /// The name of the type in Rust, C and Python: `wheel_speed` is `WheelSpeed`.
    pub fn type_name(&self) -> String {
        camel_case(&self.name)
    }

    /// The name of the type of a field with named values.
    pub fn label_type_name(&self, field: &FieldLayout) -> String {
        self.type_name() + &camel_case(&field.name)
    }
}

/// `wheel_speed` as `WheelSpeed`.
pub fn camel_case(name: &str) -> String {
    let words = name.split('_').filter(|word| !word.is_empty());
    words.map(|word| word[..1].to_ascii_uppercase() + &word[1..]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_by_name() {
        for (name, kind) in [
            ("u8", FieldType::Unsigned(8)),
            ("u1", FieldType::Unsigned(1)),
            ("i64", FieldType::Signed(64)),
            ("bit", FieldType::Bit),
            ("f64", FieldType::Double),
        ] {
            assert_eq!(FieldType::parse(name), Some(kind));
            assert_eq!(kind.name(), name);
        }
        for wrong in ["u0", "i1", "u65", "u08", "u+8", "u", "int", "U8", "f16", ""] {
            assert_eq!(FieldType::parse(wrong), None, "{wrong}");
        }
        assert_eq!(FieldType::Unsigned(64).limits(), (0, i128::from(u64::MAX)));
        assert_eq!(FieldType::Signed(8).limits(), (-128, 127));
    }

    #[test]
    fn scaling_both_ways() {
        let decimal = |text| Decimal::parse(text).unwrap();
        let scaling = Scaling::new(decimal("0.5"), decimal("-40"), FieldType::Unsigned(8)).unwrap();
        assert_eq!(scaling.value(81).to_string(), "0.5");
        assert_eq!(scaling.nearest_raw(decimal("0.5")), Some(81));
        assert_eq!(scaling.nearest_raw(decimal("0.26")), Some(81));
        assert_eq!(scaling.nearest_raw(decimal("0.24")), Some(80));
        assert_eq!(scaling.nearest_raw(decimal("-40.25")), Some(-1));
        assert_eq!(
            (scaling.least_raw(decimal("0.3")), scaling.greatest_raw(decimal("0.3"))),
            (Some(81), Some(80))
        );
        let fine =
            Scaling::new(decimal("0.000000000000000001"), decimal("999999999"), FieldType::Unsigned(64));
        assert!(fine.is_some());
        assert_eq!(
            Scaling::new(decimal("1e18"), decimal("0.000000000000000001"), FieldType::Unsigned(64)),
            None
        );
    }

    #[test]
    fn names_of_types() {
        assert_eq!(camel_case("wheel_speed"), "WheelSpeed");
        assert_eq!(camel_case("a__2b_"), "A2b");
    }
}
