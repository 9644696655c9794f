//! What README shows of the demo is what the demo prints and draws, and what the workshop prints beside it. Some seconds
//! of virtual time, about two of the host's.
//!
//! `UPDATE_DOCS=1 cargo xtask test emulated` writes both anew.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::{env, fs};

/// The command as README shows it; its output stands behind it.
const PROMPT: &str = "$ cargo xtask demo ";
const END: &str = "```\n";
/// Timing follows from the instructions, and these from the compiler.
const COMPILER: &str = "The images are compiled by rustc ";

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn images() -> PathBuf {
    let images = env::var_os("COSMIC_IMAGES");
    images.expect("COSMIC_IMAGES names no directory of images: run `cargo xtask test emulated`").into()
}

/// Behind `start`, up to `end`: its place in the text.
fn between(text: &str, start: &str, end: &str) -> std::ops::Range<usize> {
    let from = text.find(start).unwrap_or_else(|| panic!("README does not say `{start}`")) + start.len();
    from..from + text[from..].find(end).unwrap_or_else(|| panic!("nothing ends `{start}`"))
}

/// The version that the compiler left in an image, such as `1.95.0`.
fn compiler_of(image: &Path) -> String {
    let bytes = fs::read(image).unwrap();
    let mark = b"rustc version ";
    let at = bytes.windows(mark.len()).position(|window| window == mark).unwrap() + mark.len();
    let version = bytes[at..].iter().take_while(|byte| **byte != b' ');
    version.map(|byte| char::from(*byte)).collect()
}

/// The cluster that configures itself.
fn workshop() -> Command {
    let images = env::var_os("COSMIC_WORKSHOP_IMAGES");
    let mut workshop = Command::new(env!("CARGO_BIN_EXE_workshop"));
    workshop.arg("--cluster").arg(repository().join("examples/workshop/cluster.toml"));
    workshop.arg("--images").arg(images.expect("COSMIC_WORKSHOP_IMAGES names no directory of images"));
    workshop
}

/// What a program printed that ended well.
fn passed(output: Output) -> String {
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{printed}{}", String::from_utf8_lossy(&output.stderr));
    printed
}

#[test]
fn readme_shows_what_the_demo_prints_and_draws() {
    let (readme_file, picture_file) =
        (repository().join("README.md"), repository().join("docs/pictures/demo.svg"));
    let readme = fs::read_to_string(&readme_file).unwrap();
    let is_update = env::var_os("UPDATE_DOCS").is_some();
    let compiler = compiler_of(&images().join("sensor"));
    let named = &readme[between(&readme, COMPILER, ".\n")];
    if named != compiler && !is_update {
        println!("not compared: the images are of rustc {compiler}, README's of {named}");
        return;
    }
    let scratch = env::temp_dir().join(format!("cosmic-demo-readme-{}", std::process::id()));
    let _ = fs::remove_dir_all(&scratch);
    fs::create_dir_all(&scratch).unwrap();
    let shown = between(&readme, PROMPT, END);
    let (arguments, expected) = readme[shown.clone()].split_once('\n').unwrap();
    let cluster = repository().join("cosmic-plan/examples/vehicle.toml");
    let mut demo = Command::new(env!("CARGO_BIN_EXE_demo"));
    demo.current_dir(&scratch)
        .arg("--images")
        .arg(images())
        .arg("--cluster")
        .arg(cluster)
        .args(arguments.split_whitespace());
    let printed = format!("{}\n{}", passed(demo.output().unwrap()), passed(workshop().output().unwrap()));
    let drawn = fs::read_to_string(scratch.join("target/demo/bus.svg")).unwrap();
    fs::remove_dir_all(scratch).unwrap();
    if is_update {
        let shown = shown.start + arguments.len() + 1..shown.end;
        let mut updated = readme.clone();
        updated.replace_range(shown, &printed);
        let named = between(&updated, COMPILER, ".\n");
        updated.replace_range(named, &compiler);
        fs::write(readme_file, updated).unwrap();
        fs::write(picture_file, drawn).unwrap();
        return;
    }
    let remedy = "`UPDATE_DOCS=1 cargo xtask test emulated` writes it anew";
    for (number, (shown, printed)) in expected.lines().zip(printed.lines()).enumerate() {
        assert_eq!(shown, printed, "README, line {number} of the demo's output; {remedy}");
    }
    assert_eq!(expected, printed, "README, the demo's output; {remedy}");
    assert!(fs::read_to_string(picture_file).unwrap() == drawn, "docs/pictures/demo.svg; {remedy}");
}
