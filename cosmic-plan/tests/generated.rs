//! What `compile` writes is built as a user would build it: a crate of its own, with a build script's output.

use cosmic_plan::cluster::{Cluster, EXAMPLE};
use cosmic_plan::document::Source;
use cosmic_plan::output::rust;
use cosmic_plan::plan::{Effort, plan};
use std::path::{Path, PathBuf};
use std::process::Command;

fn rendered(text: &str) -> String {
    let cluster = Cluster::read(&Source::new("cluster.toml", text)).expect("it is well formed");
    let plan = plan(&cluster, &Effort::default()).expect("it fits");
    rust::render(&cluster, &plan, "cluster.toml", &[]).expect("it can be written")
}

fn tutorial(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/tutorial").join(name);
    std::fs::read_to_string(path).expect("it is there")
}

/// Has the compiler look at a crate with these modules, each a plan; `Err` with what it says.
fn check(name: &str, plans: &[(&str, String)], code: &str) -> Result<(), String> {
    let folder: PathBuf = Path::new(env!("CARGO_TARGET_TMPDIR")).join("generated").join(name);
    std::fs::create_dir_all(folder.join("src")).expect("it can be made");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let core = root.join("cosmic-core").display().to_string();
    let manifest = format!(
        "[package]\nname = \"{name}\"\nedition = \"2024\"\n[workspace]\n[dependencies]\ncosmic-core = {{ path = {core:?} }}\n"
    );
    let mut lib = "#![no_std]\n#![deny(warnings, missing_docs)]\n//! A test.\n".to_owned();
    for (module, plan) in plans {
        std::fs::write(folder.join(format!("src/{module}.rs")), plan).expect("it can be written");
        lib += &format!("/// A plan.\npub mod {module};\n");
    }
    lib += code;
    for (file, text) in [("Cargo.toml", manifest), ("src/lib.rs", lib)] {
        std::fs::write(folder.join(file), text).expect("it can be written");
    }
    std::fs::copy(root.join("Cargo.lock"), folder.join("Cargo.lock")).expect("it is there");
    let output = Command::new(env!("CARGO"))
        .args(["build", "--offline", "--quiet"])
        .current_dir(&folder)
        .env("CARGO_TARGET_DIR", Path::new(env!("CARGO_TARGET_TMPDIR")).join("generated/target"))
        .output()
        .expect("cargo starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() { Ok(()) } else { Err(said) }
}

#[test]
fn plans_compile_and_their_channels_take_what_fits() {
    let brokered = EXAMPLE.replace("binding = \"static\"", "binding = \"broker\"");
    let bursty = EXAMPLE.replace("min_interarrival = \"4 ms\"", "min_interarrival = \"4 ms\"\nburst = 3");
    let sealed = EXAMPLE.replace("[segment]", "[segment]\nsealed = true\nbrokers = [\"brake\"]");
    let stepped = EXAMPLE.replace("[segment]", "[segment]\npriority_step = \"1 ms\"");
    let refusing = EXAMPLE.replace("[segment]", "[segment]\nunplanned = \"refuse\"");
    let clockless = EXAMPLE.replace("sync_period = \"25 ms\"", "sync_period = \"0 s\"");
    let plans = [
        ("vehicle", rendered(EXAMPLE)),
        ("first", rendered(&tutorial("first.toml"))),
        ("pooled", rendered(&tutorial("pooled.toml"))),
        ("brokered", rendered(&brokered)),
        ("stepped", rendered(&stepped)),
        ("clockless", rendered(&clockless)),
        ("bursty", rendered(&bursty)),
        ("sealed", rendered(&sealed)),
        ("refusing", rendered(&refusing)),
    ];
    assert!(plans[3].1.contains("etag: None") && !plans[0].1.contains("etag: None"));
    let code = r"
use cosmic_core::admission::Unplanned;
use cosmic_core::event_layer::{Bytes, Channel};
/// Longer than a frame.
pub const DIARY: first::channels::diary::MessageChannel<Bytes<40>> = first::channels::diary::channel();
/// Longer contents do not fit; what states no fields is bytes.
pub const SPEED: Channel<Bytes<7>> = vehicle::channels::wheel_speed::channel();
/// Its etag comes from the broker.
pub const HEAT: Channel<brokered::contents::Temperature> = brokered::channels::temperature::channel();
/// Shorter ones do.
pub const ANGLE: Channel<u16> = pooled::channels::joint_angle::channel();
/// What is described needs no type of one's own.
pub const DESCRIBED: Channel<first::contents::JointAngle> = first::channels::joint_angle::CHANNEL;
const _: () = {
    assert!(stepped::CALENDAR.priority_step().as_ticks() == 1_000_000);
    assert!(stepped::CALENDAR.digest() == vehicle::CALENDAR.digest());
    assert!(vehicle::channels::suspension::RATE.is_periodic());
    assert!(vehicle::channels::suspension::RATE.interval().as_ticks() == 1_000_000);
    assert!(!bursty::channels::logbook::RATE.is_periodic());
    assert!(vehicle::nodes::brake::NODE.seal.is_none() && sealed::nodes::brake::NODE.seal.is_some());
    assert!(sealed::SEAL.nodes.len() == 3 && sealed::SEAL.channels.len() == 5 && sealed::SEAL.brokers.len() == 1);
    assert!(vehicle::nodes::brake::NODE.admission.is_none() && sealed::nodes::brake::NODE.admission.is_none());
    assert!(brokered::nodes::brake::NODE.admission.is_some());
    assert!(matches!(brokered::ADMISSION.unplanned, Unplanned::Ask));
    assert!(matches!(refusing::ADMISSION.unplanned, Unplanned::Refuse));
    assert!(refusing::ADMISSION.planned.len() == 3 && refusing::ADMISSION.reservations.soft.len() == 3);
    assert!(matches!(sealed::SEAL.nodes[2].rank, Some(rank) if rank.get() == 2));
    assert!(vehicle::nodes::brake::NODE.sync.is_some() && clockless::nodes::brake::NODE.sync.is_none());
    assert!(matches!(vehicle::nodes::brake::RANK, Some(rank) if rank.get() == 1));
};
";
    let rates = [
        (
            0,
            "channels::suspension",
            "periodic(PERIOD).with_jitter(::cosmic_core::time::Duration::from_micros(200))",
        ),
        // No jitter is stated: a tenth of the period, 1 ms at most.
        (
            1,
            "channels::motor_heat",
            "periodic(PERIOD).with_jitter(::cosmic_core::time::Duration::from_millis(1))",
        ),
        (
            6,
            "channels::logbook",
            "sporadic(MIN_INTERARRIVAL).with_burst(3).with_jitter(::cosmic_core::time::Duration::from_micros(400))",
        ),
    ];
    for (plan, channel, rate) in rates {
        assert!(plans[plan].1.contains(&format!("EventRate::{rate};")), "{channel}: {}", plans[plan].1);
    }
    let publishers =
        "publishers: ::cosmic_core::can::TxNodes::of(&[::cosmic_core::can::TxNode::new(3).unwrap()])";
    assert_eq!(plans[7].1.matches(publishers).count(), 2, "suspension and logbook");
    check("plans", &plans, code).unwrap_or_else(|said| panic!("{said}"));
}

#[test]
fn a_calendar_that_was_changed_by_hand_does_not_compile() {
    let plan = rendered(EXAMPLE);
    let edited = plan.replacen("omission_degree: 1,", "omission_degree: 2,", 1);
    assert_ne!(plan, edited);
    let said = check("edited", &[("plan", edited)], "").expect_err("it was changed");
    assert!(said.contains("not what was planned"), "{said}");
}

#[test]
fn a_message_that_is_longer_than_planned_does_not_compile() {
    let plan = [("plan", rendered(&tutorial("first.toml")))];
    let code = "use plan::channels::diary;\n/// 41 bytes are one too many.\n\
                pub const DIARY: diary::MessageChannel<[u8; 41]> = diary::channel();";
    let said = check("longer_message", &plan, code).expect_err("it is too long");
    assert!(said.contains("longer than the plan says of channel diary"), "{said}");
}

#[test]
fn content_that_is_longer_than_planned_does_not_compile() {
    let plan = [("plan", rendered(&tutorial("first.toml")))];
    let code = "/// Five bytes are one too many.\n\
                pub const ANGLE: cosmic_core::event_layer::Channel<[u8; 5]> = plan::channels::joint_angle::channel();";
    let said = check("longer", &plan, code).expect_err("it is too long");
    assert!(said.contains("longer than the plan says of channel joint_angle"), "{said}");
}
