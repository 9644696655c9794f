//! Contents to test with, and one set of vectors for all languages.

use cosmic_plan::cluster::Cluster;
use cosmic_plan::contents::{FieldLayout, FieldType, Layout, Value};
use cosmic_plan::document::Source;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// A folder of its own for each test.
pub(crate) fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("contents").join(name);
    std::fs::create_dir_all(&folder).expect("it can be made");
    folder
}

/// The contents that were written by hand.
pub(crate) fn zoo() -> String {
    include_str!("zoo.toml").to_owned()
}

pub(crate) fn read(text: &str) -> Cluster {
    Cluster::read(&Source::new("zoo.toml", text)).unwrap_or_else(|problems| panic!("{problems}"))
}

/// The layout of the channel of this name.
pub(crate) fn layout<'a>(cluster: &'a Cluster, channel: &str) -> &'a Layout {
    let channel = cluster.channel_named(channel).expect("there is such a channel");
    cluster.layout_of(&cluster.channels[channel]).expect("its content is described")
}

/// Numbers that look random and are the same in every run.
pub(crate) struct Dice(pub(crate) u64);

impl Dice {
    pub(crate) fn next(&mut self) -> u64 {
        // Marsaglia's xorshift, then a multiplication for its low bits.
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 11
    }

    pub(crate) fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }
}

/// The contents written by hand, and so many more of random fields.
pub(crate) fn grown_zoo(more: u64) -> String {
    let mut text = zoo();
    let mut dice = Dice(0x5EED);
    let mut names = String::new();
    for number in 0..more {
        let order = ["big", "little"][dice.below(2) as usize];
        write!(names, "\"random_{number}\", ").unwrap();
        write!(
            text,
            "\n[[channel]]\nname = 'random_{number}'\nsubject = {}\nclass = 'NRT'\ncontent = 'random_{number}'\n\
             min_interarrival = '1 s'\n[[content]]\nname = 'random_{number}'\nbyte_order = '{order}'\n",
            100 + number
        )
        .unwrap();
        let mut bits = 0;
        for field in 0..=dice.below(9) {
            let width = 1 + dice.below(64);
            let kind = match dice.below(4) {
                0 if width > 1 => format!("i{width}"),
                1 => ["bit", "bool", "f32", "f64"][dice.below(4) as usize].to_owned(),
                _ => format!("u{width}"),
            };
            let of = FieldType::parse(&kind).expect("it is a type");
            // Fields at any bit, so that they need not begin with a byte.
            let at = bits + dice.below(12);
            bits = at + of.bits() as u64;
            write!(text, "[[content.field]]\nname = 'f{field}'\ntype = '{kind}'\nat = {at}\n").unwrap();
            if of.is_integer() && width > 8 && dice.below(3) == 0 {
                write!(text, "scale = 0.02\nmin = 0.1\nmax = {}\n", width / 4).unwrap();
            }
        }
    }
    text.replace("publishes = [\"plain\",", &format!("publishes = [{names}\"plain\","))
}

/// Bytes of events: random, all zero, all one, of a wrong length. About as many are well formed as malformed.
pub(crate) fn events(layout: &Layout, count: u64) -> Vec<Vec<u8>> {
    let mut dice = Dice(0xC0FFEE + layout.len as u64);
    let mut all = vec![vec![0; layout.len], vec![0xFF; layout.len]];
    if layout.len <= 8 {
        all.push(vec![0; layout.len - 1]);
        all.push(vec![0; layout.len + 1]);
    }
    for _ in 0..count {
        let random: Vec<u8> = (0..layout.len).map(|_| dice.next() as u8).collect();
        // With values that the description allows, for most fields.
        let values: Vec<(&str, Value)> =
            layout.fields.iter().map(|field| (field.name.as_str(), some_value(field, &mut dice))).collect();
        all.push(
            layout.encode(&values).unwrap_or_else(|error| panic!("{}: {error}: {values:?}", layout.name)),
        );
        all.push(random);
    }
    all
}

fn some_value(field: &FieldLayout, dice: &mut Dice) -> Value {
    let mut one = || match field.kind {
        FieldType::Bool | FieldType::Bit => Value::Boolean(dice.below(2) == 1),
        FieldType::Single => Value::Single(dice.below(2500) as f32 * 0.001 - 1.5),
        FieldType::Double => Value::Double(dice.next() as f64 * 1e-9),
        _ if !field.labels.is_empty() => {
            let label = &field.labels[dice.below(field.labels.len() as u64) as usize];
            Value::Label { name: label.name.clone(), raw: label.raw }
        }
        _ => {
            let (least, greatest) = field.raw_range;
            let width = greatest - least + 1;
            let raw = match dice.below(8) {
                0 => least,
                1 => greatest,
                _ => least + (i128::from(dice.next()) << 12 | i128::from(dice.below(1 << 12))) % width,
            };
            match field.scaling {
                Some(scaling) => Value::Scaled(scaling.value(raw)),
                None => Value::Integer(raw),
            }
        }
    };
    match field.count {
        None => one(),
        Some(count) => Value::List((0..count).map(|_| one()).collect()),
    }
}

/// What an event says, as the programs of all languages print it: the bytes that come from encoding it again and the
/// numbers on the wire, or that it is malformed.
pub(crate) fn answer(layout: &Layout, bytes: &[u8]) -> String {
    let Ok(fields) = layout.decode(bytes) else { return "malformed".to_owned() };
    let values: Vec<(&str, Value)> = fields.iter().map(|field| (field.name, field.value.clone())).collect();
    let again = layout.encode(&values).expect("it was decoded");
    let numbers: Vec<String> = fields
        .iter()
        .map(|field| raw(layout.field(field.name).expect("it is there"), &field.value))
        .collect();
    format!("{} {}", hex(&again), numbers.join(" "))
}

fn raw(field: &FieldLayout, value: &Value) -> String {
    match value {
        Value::Boolean(value) => u8::from(*value).to_string(),
        Value::Integer(raw) | Value::Label { raw, .. } => raw.to_string(),
        Value::Scaled(value) => field.scaling_or_none().nearest_raw(*value).expect("it has one").to_string(),
        Value::Single(value) => value.to_bits().to_string(),
        Value::Double(value) => value.to_bits().to_string(),
        Value::List(values) => values.iter().map(|value| raw(field, value)).collect::<Vec<_>>().join(","),
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The questions, a line each (content and bytes), and the answers.
pub(crate) fn vectors(cluster: &Cluster, count: u64, wanted: impl Fn(&Layout) -> bool) -> (String, String) {
    let (mut questions, mut answers) = (String::new(), String::new());
    for layout in cluster.contents.iter().filter(|layout| wanted(layout)) {
        for event in events(layout, count) {
            writeln!(questions, "{} {}", layout.name, hex(&event)).unwrap();
            writeln!(answers, "{} {} {}", layout.name, hex(&event), answer(layout, &event)).unwrap();
        }
    }
    (questions, answers)
}

/// Compares what a program printed with the answers, line by line.
pub(crate) fn compare(printed: &str, answers: &str) {
    for (printed, answer) in printed.lines().zip(answers.lines()) {
        assert_eq!(printed.trim_end(), answer.trim_end());
    }
    assert_eq!(printed.lines().count(), answers.lines().count());
}
