//! The generated types of Rust: they compile as a user compiles them, and do what the host does.

use crate::zoo::{compare, folder, grown_zoo, read, vectors};
use cosmic_plan::contents::{FieldLayout, FieldType, Layout};
use cosmic_plan::document::Source;
use cosmic_plan::output::rust;
use cosmic_plan::plan::{Effort, plan};
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

fn rendered(text: &str) -> String {
    let cluster =
        cosmic_plan::cluster::Cluster::read(&Source::new("zoo.toml", text)).expect("it is well formed");
    let plan = plan(&cluster, &Effort::default()).expect("it fits");
    rust::render(&cluster, &plan, "zoo.toml", &["Hash".to_owned()]).expect("it can be written")
}

/// Runs a program that knows the plan.
fn run(name: &str, plan: &str, program: &str, input: &str) -> Output {
    let folder = folder(name);
    std::fs::create_dir_all(folder.join("src")).expect("it can be made");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let core = root.join("cosmic-core").display().to_string();
    let manifest = format!(
        "[package]\nname = \"{name}\"\nedition = \"2024\"\n[workspace]\n[dependencies]\ncosmic-core = {{ path = {core:?} }}\n"
    );
    for (file, text) in
        [("Cargo.toml", &*manifest), ("src/plan.rs", plan), ("src/main.rs", program), ("input", input)]
    {
        std::fs::write(folder.join(file), text).expect("it can be written");
    }
    std::fs::copy(root.join("Cargo.lock"), folder.join("Cargo.lock")).expect("it is there");
    Command::new(env!("CARGO"))
        .args(["run", "--offline", "--quiet", "--", "input"])
        .current_dir(&folder)
        .env("CARGO_TARGET_DIR", Path::new(env!("CARGO_TARGET_TMPDIR")).join("generated/target"))
        .output()
        .expect("cargo starts")
}

/// A program that answers questions as `zoo::answer` does.
fn program(layouts: &[Layout]) -> String {
    let mut arms = String::new();
    for layout in layouts {
        let numbers: Vec<String> = layout.fields.iter().map(number).collect();
        writeln!(
            arms,
            "        {:?} => <plan::contents::{} as Content>::decode(&bytes).map(|event| {{\n            \
             let mut again = vec![0; <plan::contents::{} as Content>::LEN];\n            event.encode(&mut again);\n            \
             (again, vec![{}])\n        }}),",
            layout.name,
            layout.type_name(),
            layout.type_name(),
            numbers.join(", ")
        )
        .unwrap();
    }
    format!(
        "//! A test.\n#![deny(warnings, missing_docs)]\nuse cosmic_core::event_layer::Content;\n/// The plan.\n#[allow(dead_code)]\npub mod plan;\n\
         fn list<T: ToString>(values: impl IntoIterator<Item = T>) -> String {{\n    \
         values.into_iter().map(|value| value.to_string()).collect::<Vec<_>>().join(\",\")\n}}\n\
         fn main() {{\n    let input = std::fs::read_to_string(\"input\").unwrap();\n    for line in input.lines() {{\n    \
         let (name, hex) = line.split_once(' ').unwrap();\n    \
         let byte = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();\n    \
         let bytes: Vec<u8> = (0..hex.len()).step_by(2).map(byte).collect();\n    \
         let answer: Option<(Vec<u8>, Vec<String>)> = match name {{\n{arms}        _ => unreachable!(),\n    }};\n    \
         match answer {{\n        None => println!(\"{{line}} malformed\"),\n        Some((again, numbers)) => {{\n            \
         let again: String = again.iter().map(|byte| format!(\"{{byte:02x}}\")).collect();\n            \
         println!(\"{{line}} {{again}} {{}}\", numbers.join(\" \"));\n        }}\n    }}\n    }}\n}}\n"
    )
}

/// The number of a field on the wire, as text.
fn number(field: &FieldLayout) -> String {
    let one = |value: &str| match field.kind {
        FieldType::Bool | FieldType::Bit => format!("u8::from({value})"),
        FieldType::Single | FieldType::Double => format!("{value}.to_bits()"),
        _ if field.labels.is_empty() => value.to_owned(),
        // By way of its name: the number is not the type's own.
        _ => {
            let arms: Vec<String> = field
                .labels
                .iter()
                .map(|label| {
                    format!("{:?} => {}_i64", cosmic_plan::contents::camel_case(&label.name), label.raw)
                })
                .collect();
            format!(
                "match format!(\"{{:?}}\", {value}).as_str() {{ {}, _ => unreachable!() }}",
                arms.join(", ")
            )
        }
    };
    let of = format!("event.{}", field.name);
    match field.count {
        None => format!("({}).to_string()", one(&of)),
        Some(_) => format!("list({of}.map(|value| {}))", one("value")),
    }
}

#[test]
fn types_do_what_the_host_does() {
    let text = grown_zoo(30);
    let cluster = read(&text);
    let (questions, answers) = vectors(&cluster, 20, |_| true);
    assert!(answers.lines().filter(|line| line.ends_with("malformed")).count() > 100);
    let text = text.replace("\nclass = 'NRT'", "\nclass = \"NRT\"");
    // `f32` has no hash.
    let plan = rendered(&text).replace(", Hash)]", ")]");
    let output = run("zoo", &plan, &program(&cluster.contents), &questions);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    compare(&String::from_utf8_lossy(&output.stdout), &answers);
}

const RUST_CONTENT: &str = "//! A test.
use cosmic_core::event_layer::{Channel, Content};
/// The plan.
#[allow(dead_code)]
pub mod plan;
cosmic_core::content! {
    /// As the description has it.
    #[derive(Clone, Copy)]
    pub struct Mine {
        pub count: u32,
        pub speed: TYPE,
        pub valid: bool,
    }
}
/// In Rust, checked against the description.
pub const PLAIN: Channel<Mine> = plan::channels::plain::channel();
/// Generated.
pub const GENERATED: Channel<plan::contents::Plain> = plan::channels::plain::CHANNEL;
/// Bytes.
pub const BYTES: Channel<[u8; 7]> = plan::channels::plain::channel();

fn main() {
    assert_eq!(Mine { count: 1, speed: 2, valid: true }.encoded_len(), Mine::LEN);
    assert_eq!(PLAIN.subject(), GENERATED.subject());
    assert_eq!(PLAIN.subject(), BYTES.subject());
    let event = plan::contents::Packed {
        mode: plan::contents::PackedMode::Fast,
        ready: true,
        angle: plan::contents::Packed::angle_of(-90.04).unwrap(),
        level: plan::contents::Packed::level_of(42.2).unwrap(),
        flags: [true, false, false, true, false],
        rest: 7,
    };
    let mut bytes = [0xFF; 6];
    event.encode(&mut bytes);
    assert_eq!(bytes, [0x5C, 0x7C, 0x68, 0x90, 0x00, 0x07]);
    assert_eq!((event.angle_value(), event.level_value()), (-90.0, 42.0));
    for wrong in [180.1, f32::NAN, f32::INFINITY, -1e30] {
        assert_eq!(plan::contents::Packed::angle_of(wrong), None);
    }
    assert_eq!(plan::contents::Packed::angle_of(180.04), Some(1800));
    assert_eq!(plan::contents::Long::started_at_of(-1.5), Some(-1_500_000));
}
";

#[test]
fn content_in_rust_is_checked_against_the_description() {
    let plan = rendered(&crate::zoo::zoo()).replace(", Hash)]", ")]");
    let output = run("fits", &plan, &RUST_CONTENT.replace("TYPE", "i16"), "");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // The same length, other types.
    let output = run("fits", &plan, &RUST_CONTENT.replace("TYPE", "u16"), "");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    assert!(
        said.contains("the fields of this type are not those that the plan states of content plain"),
        "{said}"
    );
}
