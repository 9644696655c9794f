//! `cargo xtask build`, with programs in the place of cargo and rustc that say what they would say.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A folder of build products, the description of a cluster, and the false programs.
struct Desk(PathBuf);

impl Desk {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("xtask-build-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(folder.join("sysroot/lib/rustlib/thumbv7em-none-eabihf/lib")).unwrap();
        let desk = Self(folder.canonicalize().unwrap());
        fs::write(desk.0.join("mine.toml"), "").unwrap();
        fs::write(desk.0.join("built"), elf()).unwrap();
        let folder = desk.0.display();
        desk.program("rustc", &format!("echo '{folder}/sysroot'"));
        // The image that it makes is another one for each cluster.
        let artifact = format!(
            r#"{{"reason":"compiler-artifact","target":{{"kind":["bin"],"name":"sensor"}},"executable":"{folder}/sensor"}}"#
        );
        desk.program(
            "cargo",
            &format!(
                "if [ \"$1\" = metadata ]; then unset RUSTC; exec '{}' \"$@\"; fi\n\
                 echo \"$COSMIC_CLUSTER $*\" >> '{folder}/calls'\n\
                 cp '{folder}/built' '{folder}/sensor'; echo \"$COSMIC_CLUSTER\" >> '{folder}/sensor'\n\
                 echo '{artifact}'",
                env!("CARGO")
            ),
        );
        desk
    }

    fn program(&self, name: &str, script: &str) {
        let file = self.0.join(name);
        fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn build(&self, arguments: &[&str]) -> Output {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let mut command = Command::new(env!("CARGO_BIN_EXE_xtask"));
        command.current_dir(root).arg("build").args(arguments);
        command.env("CARGO", self.0.join("cargo")).env("RUSTC", self.0.join("rustc"));
        command.env("CARGO_TARGET_DIR", self.0.join("target")).env_remove("COSMIC_TARGET_WAY");
        command.output().unwrap()
    }

    /// What the cargo was called for, and how.
    fn calls(&self) -> String {
        fs::read_to_string(self.0.join("calls")).unwrap_or_default()
    }

    /// The folders of images.
    fn kept(&self) -> Vec<String> {
        let entries = fs::read_dir(self.0.join("target/images")).into_iter().flatten().flatten();
        let mut names: Vec<_> =
            entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// The shortest program for Arm: a header.
fn elf() -> Vec<u8> {
    let mut bytes = vec![0; 52];
    bytes[..7].copy_from_slice(b"\x7FELF\x01\x01\x01");
    // Executable, Arm, version 1; the length of the header.
    (bytes[16], bytes[18], bytes[20], bytes[40]) = (2, 40, 1, 52);
    bytes
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn each_cluster_has_images_of_its_own() {
    let desk = Desk::new("own");
    let example = desk.build(&["--image", "sensor"]);
    assert!(example.status.success(), "{}", text(&example.stderr));
    assert_eq!(desk.kept(), ["vehicle"]);
    let file = desk.0.join("target/images/vehicle/sensor");
    let of_example = fs::read(&file).unwrap();
    let mine = desk.0.join("mine.toml");
    let other = desk.build(&["--cluster", mine.to_str().unwrap(), "--image", "sensor"]);
    let (said, complained) = (text(&other.stdout), text(&other.stderr));
    assert!(other.status.success(), "{complained}");
    let [folder, _] = desk.kept().try_into().unwrap();
    assert!(folder.starts_with("mine-"), "{folder}");
    let of_mine = desk.0.join("target/images").join(folder);
    // Which plan, and where, is said at the end.
    let last = format!("The images for {} are in {}.", mine.display(), of_mine.display());
    assert_eq!(said.lines().last(), Some(&*last));
    assert!(said.contains("sensor"), "{said}");
    assert!(complained.contains(&format!("building the firmware images for {}", mine.display())));
    assert!(text(&fs::read(of_mine.join("sensor")).unwrap()).ends_with("mine.toml\n"));
    assert_eq!(fs::read(&file).unwrap(), of_example, "the example's image is left alone");
}

/// The build script of the firmware runs in another folder, so it is told the whole path.
#[test]
fn cargo_is_told_the_cluster_and_the_images() {
    let desk = Desk::new("told");
    let mine = desk.0.join("mine.toml");
    let roundabout = desk.0.join("target/../mine.toml");
    fs::create_dir_all(desk.0.join("target")).unwrap();
    let output = desk.build(&["--cluster", roundabout.to_str().unwrap(), "--image", "sensor"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let calls = desk.calls();
    assert!(
        calls.starts_with(&format!("{} build --target thumbv7em-none-eabihf", mine.display())),
        "{calls}"
    );
    assert!(calls.contains("--package firmware --profile firmware"), "{calls}");
    assert!(calls.trim_end().ends_with("--bin sensor"), "{calls}");
}

#[test]
fn a_cluster_that_is_not_there_is_refused_before_anything_is_built() {
    let desk = Desk::new("none");
    let output = desk.build(&["--cluster", "/no/such/cluster.toml"]);
    assert_eq!(output.status.code(), Some(1));
    let complained = text(&output.stderr);
    assert!(
        complained.starts_with("error: /no/such/cluster.toml cannot be read; name the file of a cluster"),
        "{complained}"
    );
    assert_eq!((desk.calls(), desk.kept()), (String::new(), vec![]));
}

#[test]
fn a_build_that_fails_keeps_nothing() {
    let desk = Desk::new("fails");
    let script = fs::read_to_string(desk.0.join("cargo")).unwrap();
    desk.program("cargo", &format!("{}\nexit 101", script.trim_start_matches("#!/bin/sh\n")));
    let output = desk.build(&["--cluster", desk.0.join("mine.toml").to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("building `firmware` for the target failed"));
    assert_eq!(desk.kept(), Vec::<String>::new());
}
