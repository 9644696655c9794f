//! Contents in the file: what they may say, and that all that is generated from them does the same with bytes.

mod exported;
mod generated_rust;
mod tools;
mod wireshark;
mod zoo;

use cosmic_core::can::Etag;
use cosmic_core::event_layer::{Content, layout_of};
use cosmic_plan::cluster::Cluster;
use cosmic_plan::contents::{NotDecoded, NotEncoded, Value};
use cosmic_plan::document::Source;
use proptest::prelude::*;
use zoo::{Dice, answer, events, layout, read, zoo};

const ROVER: &str = include_str!("../../examples/rover.toml");

#[test]
fn fields_have_names_values_and_units() {
    let cluster = read(&zoo());
    let packed = layout(&cluster, "packed");
    assert_eq!(packed.len, 6);
    // fast, ready, -90.0 degrees, 42 %, flags 1 and 4, the rest.
    let bytes = [0x5C, 0x7C, 0x68, 0x90, 0x00, 0x07];
    let fields = packed.decode(&bytes).unwrap();
    let text: Vec<String> = fields.iter().map(ToString::to_string).collect();
    let expected = [
        "mode = fast",
        "ready = true",
        "angle = -90 °",
        "level = 42 %",
        "flags = [true, false, false, true, false]",
        "rest = 7",
    ];
    assert_eq!(text, expected);
    let values = [
        ("rest", "7"),
        ("mode", "fast"),
        ("ready", "true"),
        ("level", "42.1"),
        ("flags", "1, 0, 0, 1, 0"),
        ("angle", "-90"),
    ];
    assert_eq!(packed.encode_text(&values).unwrap(), bytes);
}

#[test]
fn little_endian_bits_stand_as_intel_has_them() {
    let cluster = read(&zoo());
    let intel = layout(&cluster, "intel");
    // The pressure 513 in bits 0 to 9, the trim -2 in 10 to 15; the torque -1; the gear -1; 0x1234.
    let bytes = [0x01, 0b1111_1010, 0xFF, 0xFF, 0xFF, 0x34, 0x12];
    let text: Vec<String> = intel.decode(&bytes).unwrap().iter().map(ToString::to_string).collect();
    assert_eq!(
        text,
        ["pressure = 128.25 kPa", "trim = -2", "torque = -0.01 N m", "gear = reverse", "class = 4660"]
    );
}

#[test]
fn what_the_description_does_not_allow_is_malformed() {
    let cluster = read(&zoo());
    let of = |name: &str| layout(&cluster, name);
    let refused = |name: &str, bytes: &[u8]| of(name).decode(bytes).unwrap_err().to_string();
    assert_eq!(of("plain").decode(&[0; 6]), Err(NotDecoded::Length { found: 6, expected: 7 }));
    assert_eq!(refused("plain", &[0, 0, 0, 0, 0, 0, 2]), "valid is 2, neither 0 nor 1");
    assert_eq!(refused("packed", &[0x60, 0, 0, 0, 0, 0]), "mode is 3, which has no name");
    assert_eq!(refused("packed", &[0x07, 0x09, 0, 0, 0, 0]), "angle is 180.1, outside -180 to 180");
    let three = 3.0_f32.to_be_bytes();
    assert_eq!(of("floats").decode(&[three, three].concat()).map(|fields| fields.len()), Ok(2));
    let minus = (-3.0_f32).to_be_bytes();
    assert_eq!(refused("floats", &[three, minus].concat()), "y is -3, outside -1.5 to 1000");
    let none = f32::NAN.to_be_bytes();
    assert!(refused("floats", &[three, none].concat()).starts_with("y is NaN"));
}

#[test]
fn values_that_do_not_fit_are_not_written() {
    let cluster = read(&zoo());
    let of = |name: &str| layout(&cluster, name);
    let refused = |name: &str, values: &[(&str, &str)]| of(name).encode_text(values).unwrap_err().to_string();
    let plain = [("count", "1"), ("speed", "-1"), ("valid", "true")];
    assert!(of("plain").encode_text(&plain).is_ok());
    assert_eq!(refused("plain", &plain[..2]), "valid is missing");
    assert_eq!(
        of("plain").encode_text(&[("valid", "true"), ("valid", "true")]),
        Err(NotEncoded::Unexpected("valid".to_owned()))
    );
    assert_eq!(refused("plain", &[("weight", "1")]), "weight is given twice, or is no field of the content");
    assert_eq!(
        refused("plain", &[("count", "1"), ("speed", "40000"), ("valid", "true")]),
        "speed: 40000 does not fit; write -32768 to 32767"
    );
    let intel = |gear: &'static str, torque: &'static str| {
        [("pressure", "1"), ("trim", "0"), ("torque", torque), ("gear", gear), ("class", "1")]
    };
    assert_eq!(
        refused("intel", &intel("third", "0")),
        "gear: third is no value of it; write one of reverse, neutral, first, second"
    );
    assert_eq!(refused("intel", &intel("first", "301")), "torque: is 301, outside -300 to 300");
    assert!(of("intel").encode_text(&intel("first", "-299.999")).is_ok());
    assert_eq!(
        refused("levels", &[("levels", "1, 2"), ("int", "0")]),
        "levels: 2 values instead of 3; write all, with commas between"
    );
}

#[test]
fn channels_are_found_by_name_subject_and_etag() {
    let rover = read(ROVER);
    let battery = rover.channel_named("battery").unwrap();
    let of_subject = |subject| rover.channels.iter().position(|channel| channel.subject == subject);
    let of_etag = |etag| rover.channels.iter().position(|channel| channel.etag == Some(etag));
    assert_eq!(of_subject(0xB0A0_1C00_0000_0007), Some(battery));
    assert_eq!(of_etag(rover.channels[battery].etag.unwrap()), Some(battery));
    assert_eq!(of_subject(1), None);
    assert_eq!(of_etag(Etag::new(5_000).unwrap()), None);
    assert_eq!(rover.channels.len(), 8);
}

cosmic_core::content! {
    /// As in the zoo.
    #[derive(Clone, Copy, PartialEq, Debug)]
    struct Plain {
        count: u32,
        speed: i16,
        valid: bool,
    }
}

#[test]
fn layouts_of_types_alone_are_those_of_rust() {
    let cluster = read(&zoo());
    let of = |name: &str| layout(&cluster, name);
    assert_eq!(of("plain").layout_hash(), Plain::LAYOUT);
    assert_eq!(of("plain").wire_hash(), Plain::LAYOUT);
    assert_eq!(of("plain").len, Plain::LEN);
    // The wire of the rover's is what a program could declare; what it means is in the other hash.
    let rover = read(ROVER);
    let wheel = layout(&rover, "left_wheel");
    assert_eq!(wheel.wire_hash(), layout_of(&["u32", "i16", "bool"]));
    assert_ne!(wheel.layout_hash(), wheel.wire_hash());
    for (a, b) in [
        ("scale = 0.0001", "scale = 0.0002"),
        ("unit = \"m\"", "unit = \"km\""),
        ("name = \"wheel\"\ndoc", "name = \"wheel\"\nversion = 2\ndoc"),
        ("type = \"u32\"\nscale", "type = \"i32\"\nscale"),
        ("name = \"wheel\"\ndoc", "name = \"wheel\"\nbyte_order = \"little\"\ndoc"),
    ] {
        let changed = ROVER.replacen(a, b, 1);
        assert_ne!(changed, ROVER);
        let changed = read(&changed);
        assert_ne!(layout(&changed, "left_wheel").layout_hash(), wheel.layout_hash(), "{b}");
    }
}

#[test]
fn mistakes_in_contents_are_named_with_their_remedy() {
    let with = |content: &str| {
        format!(
            "[segment]\nname = 'test'\nbit_rate = '1 Mbit/s'\nclock_accuracy = '50 us'\nrelease_jitter = '5 us'\n\
             [[node]]\nname = 'a'\nuid = 1\npublishes = ['c']\n\
             [[channel]]\nname = 'c'\nsubject = 1\nclass = 'NRT'\nperiod = '1 s'\n{content}"
        )
    };
    let field = |lines: &str| {
        format!("content = 'k'\n[[content]]\nname = 'k'\n[[content.field]]\nname = 'f'\n{lines}")
    };
    for (content, path, remedy) in [
        (String::new(), "channel.c.length", "or its content"),
        (
            "content = 'nothing'\n[[content]]\nname = 'k'\n[[content.field]]\nname = 'f'\ntype = 'u8'"
                .to_owned(),
            "channel.c.content",
            "write a [[content]]",
        ),
        (format!("length = 8\n{}", field("type = 'u8'")), "channel.c.length", "leave it out"),
        (
            "content = 'k'\n[[content]]\nname = 'k'".to_owned(),
            "content.k.field",
            "at least one [[content.field]]",
        ),
        (field("type = 'u65'"), "content.k.field.f.type", "u1 to u64"),
        (field(""), "content.k.field.f.type", "u1 to u64"),
        (field("type = 'u8'\nscale = 0"), "content.k.field.f.scale", "what one step is"),
        (field("type = 'u8'\nscale = '0.1'"), "content.k.field.f.scale", "without quotes"),
        (field("type = 'f32'\nscale = 0.1"), "content.k.field.f.scale", "a whole number such as u16"),
        (field("type = 'u8'\nmin = -1"), "content.k.field.f.min", "a wider type"),
        (field("type = 'u8'\nmin = 9\nmax = 8"), "content.k.field.f.min", "a greater max"),
        (field("type = 'u2'\nvalues = { a = 4 }"), "content.k.field.f.values", "from 0 to 3"),
        (field("type = 'u2'\nvalues = { a = 1, b = 1 }"), "content.k.field.f.values", "of its own"),
        (field("type = 'u2'\nvalues = { A = 1 }"), "content.k.field.f.values", "lower-case letters"),
        (field("type = 'u2'\nvalues = { a = 1 }\nunit = 'm'"), "content.k.field.f.unit", "leave out values"),
        (field("type = 'u8'\ncount = 0"), "content.k.field.f.count", "at least 1"),
        (
            field("type = 'u8'\ncount = 1024\n[[content.field]]\nname = 'g'\ntype = 'u8'"),
            "content.k",
            "at most 1024 bytes",
        ),
        (
            field("type = 'u8'\n[[content.field]]\nname = 'g'\ntype = 'u8'\nat = 7"),
            "content.k.field.g.at",
            "no other field has",
        ),
        (
            field("type = 'u8'\n[[content.field]]\nname = 'f'\ntype = 'u8'"),
            "content.k.field.f",
            "its own name",
        ),
        (field("type = 'u8'\ncolour = 3"), "content.k.field.f.colour", "the fields here are"),
        (
            format!(
                "{}\n[[content]]\nname = 'k_'\n[[content.field]]\nname = 'f'\ntype = 'u8'",
                field("type = 'u8'")
            ),
            "content.k_",
            "another name",
        ),
    ] {
        let text = with(&content);
        let problems = Cluster::read(&Source::new("a.toml", text.clone())).expect_err(&content);
        let list = problems.list();
        assert_eq!(list.len(), 1, "{content}:\n{problems}");
        assert_eq!(list[0].field, path, "{problems}");
        assert!(list[0].help.contains(remedy), "{problems}");
    }
}

#[test]
fn a_soft_channel_has_at_most_eight_bytes() {
    let text = zoo().replace("class = \"SRT\"\ncontent = \"packed\"", "class = \"SRT\"\ncontent = \"long\"");
    let problems = Cluster::read(&Source::new("a.toml", text)).expect_err("it is too long");
    assert_eq!(problems.list()[0].field, "channel.packed.content");
}

proptest! {
    /// What was encoded is decoded again, whatever the fields and values; and bytes that are decoded are encoded to
    /// themselves, but for bits that belong to no field.
    #[test]
    fn round_trip(seed in 1_u64..) {
        let mut dice = Dice(seed);
        let cluster = read(&zoo::grown_zoo(12));
        let layouts = &cluster.contents;
        let layout = &layouts[dice.below(layouts.len() as u64) as usize];
        for event in events(layout, 4) {
            let Ok(fields) = layout.decode(&event) else { continue };
            let values: Vec<(&str, Value)> = fields.iter().map(|field| (field.name, field.value.clone())).collect();
            let again = layout.encode(&values).unwrap();
            // Compared by their bits, since no float that is none equals itself.
            prop_assert_eq!(answer(layout, &again), answer(layout, &event));
            let covered: usize = layout.fields.iter().map(|field| field.span().len()).sum();
            if covered == 8 * layout.len {
                prop_assert_eq!(&again, &event);
            }
        }
    }
}
