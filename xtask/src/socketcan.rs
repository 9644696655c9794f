//! SocketCAN in a small virtual machine: Debian's kernel with its virtual CAN, emulated by QEMU, and nothing but the tests
//! and busybox in it. For machines whose own kernel has no CAN.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};

use crate::apt;
use crate::run::{self, step};
use crate::tally::Tally;
use crate::target;
use crate::workspace::Workspace;

/// Builds the tests, makes the machine, and runs them in it.
///
/// # Errors
/// What is missing, and cannot be got here.
pub(crate) fn test(workspace: &Workspace) -> Result<Tally> {
    if !cfg!(target_arch = "x86_64") {
        bail!("the virtual machine is one of x86-64; run this on such a host");
    }
    let needed = [("qemu-system-x86_64", "qemu-system-x86"), ("cpio", "cpio"), ("apt-get", "apt")];
    let missing: Vec<&str> =
        needed.iter().filter(|(program, _)| target::find_program(program).is_none()).map(|it| it.1).collect();
    if !missing.is_empty() {
        step(&format!("installing {}", missing.join(", ")), || apt::install(&missing))?;
    }
    let folder = workspace.target_dir().join("socketcan");
    fs::create_dir_all(&folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    let kernel = step("getting Debian's kernel and busybox", || Kernel::get(&folder))?;
    let program = step("building the tests", || build(workspace))?;
    let memory = step("making the machine", || kernel.initramfs(&folder, &program))?;
    step("testing SocketCAN in the machine", || boot(&kernel.image, &memory))
}

/// Debian's kernel, unpacked.
struct Kernel {
    image: PathBuf,
    modules: PathBuf,
    busybox: PathBuf,
}

impl Kernel {
    fn get(folder: &Path) -> Result<Self> {
        let root = folder.join("debian");
        if !root.join("complete").exists() {
            let image = kernel_package()?;
            let _ = fs::remove_dir_all(&root);
            fs::create_dir_all(&root)?;
            for package in [image.as_str(), "busybox-static"] {
                let mut download = Command::new("apt-get");
                run::run(download.args(["download", package]).current_dir(&root)).with_context(|| {
                    format!("Debian's package {package} cannot be downloaded: look at the network, and `apt-get update`")
                })?;
            }
            for package in files(&root, |name| name.ends_with(".deb"))? {
                run::run(Command::new("dpkg").arg("-x").arg(&package).arg(&root))?;
                fs::remove_file(&package)?;
            }
            fs::write(root.join("complete"), image)?;
        }
        let one = |folder: PathBuf, start: &str| -> Result<PathBuf> {
            let found = files(&folder, |name| name.starts_with(start))?;
            found.into_iter().next().with_context(|| {
                format!("no {start} is in {}: remove {} and try again", folder.display(), root.display())
            })
        };
        Ok(Self {
            image: one(root.join("boot"), "vmlinuz")?,
            modules: one(root.join("lib/modules"), "")?.join("kernel"),
            busybox: root.join("bin/busybox"),
        })
    }

    /// What the machine has in its memory when it starts.
    fn initramfs(&self, folder: &Path, program: &Path) -> Result<PathBuf> {
        let root = folder.join("root");
        let _ = fs::remove_dir_all(&root);
        for name in ["bin", "dev", "proc", "sys", "tmp"] {
            fs::create_dir_all(root.join(name))?;
        }
        let copy = |from: &Path, to: &str| -> Result<()> {
            let to = root.join(to);
            fs::create_dir_all(to.parent().unwrap_or(&root))?;
            fs::copy(from, &to).map(|_| ()).with_context(|| format!("{} cannot be copied", from.display()))
        };
        copy(&self.busybox, "bin/busybox")?;
        copy(program, "tests")?;
        for library in libraries(program)? {
            copy(&library, &library.display().to_string()[1..])?;
        }
        for (number, module) in MODULES.iter().enumerate() {
            copy(&self.modules.join(module), &format!("modules/{number}.ko"))?;
        }
        let init = root.join("init");
        fs::write(&init, INIT)?;
        fs::set_permissions(&init, fs::Permissions::from_mode(0o755))?;
        let memory = folder.join("initramfs");
        let pack = "find . | cpio --quiet --create --format=newc";
        let out = fs::File::create(&memory)?;
        run::run(Command::new("sh").args(["-c", pack]).current_dir(&root).stdout(out))?;
        Ok(memory)
    }
}

/// The package that `linux-image-amd64` stands for.
fn kernel_package() -> Result<String> {
    let output = Command::new("apt-cache").args(["depends", "linux-image-amd64"]).output();
    let output = output.context("`apt-cache` cannot be started: this needs Debian's apt")?;
    let text = String::from_utf8_lossy(&output.stdout);
    let package = text.lines().find_map(|line| line.trim().strip_prefix("Depends: linux-image-"));
    let package =
        package.context("apt knows no `linux-image-amd64`: this needs Debian; or type `apt-get update`")?;
    Ok(format!("linux-image-{package}"))
}

fn files(folder: &Path, wanted: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("{} cannot be read", folder.display()))?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    Ok(paths.filter(|path| path.file_name().is_some_and(|name| wanted(&name.to_string_lossy()))).collect())
}

/// Builds the tests, and finds the program.
fn build(workspace: &Workspace) -> Result<PathBuf> {
    let mut command = workspace.cargo();
    command.args(["test", "--package", "cosmic-linux", "--test", "socketcan_vm", "--no-run"]);
    command.args(["--message-format", "json-render-diagnostics"]);
    let mut program = None;
    let status = run::lines(&mut command, |line| {
        let message: Option<serde_json::Value> = serde_json::from_str(line).ok();
        if let Some(path) = message.as_ref().and_then(|message| message["executable"].as_str()) {
            program = Some(PathBuf::from(path));
        }
    })?;
    match program {
        Some(program) if status.success() => Ok(program),
        _ => bail!("the tests cannot be built; see above"),
    }
}

/// The shared libraries of a program, and what loads them.
fn libraries(program: &Path) -> Result<Vec<PathBuf>> {
    let output = Command::new("ldd").arg(program).output().context("`ldd` cannot be started")?;
    let text = String::from_utf8_lossy(&output.stdout);
    let found: Vec<PathBuf> =
        text.split_whitespace().filter(|word| word.starts_with('/')).map(PathBuf::from).collect();
    if found.is_empty() {
        bail!("`ldd {}` names no library: {text}", program.display());
    }
    Ok(found)
}

/// Starts the machine, shows what it says, and counts its tests.
fn boot(image: &Path, memory: &Path) -> Result<Tally> {
    let mut qemu = Command::new("timeout");
    qemu.args([
        "600",
        "qemu-system-x86_64",
        "-nodefaults",
        "-display",
        "none",
        "-no-reboot",
        "-serial",
        "stdio",
    ]);
    qemu.args(["-m", "512", "-net", "none", "-append", "console=ttyS0 quiet panic=-1"]);
    qemu.arg("-kernel").arg(image).arg("-initrd").arg(memory).stdin(Stdio::null());
    let mut tally = None;
    run::lines(&mut qemu, |line| {
        println!("{line}");
        tally = tally.or_else(|| counts(line));
    })?;
    tally.context("the machine has ended before its tests did: see above; 600 s is all it has")
}

/// `test result: ok. 4 passed; 1 failed; ...`
fn counts(line: &str) -> Option<Tally> {
    let words: Vec<&str> = line.split_once("test result:")?.1.split_whitespace().collect();
    let before = |name: &str| words.windows(2).find(|pair| pair[1].starts_with(name))?[0].parse().ok();
    Some(Tally { passed: before("passed")?, failed: before("failed")? })
}

/// In the order in which they need each other.
const MODULES: [&str; 4] =
    ["net/can/can.ko", "net/can/can-raw.ko", "drivers/net/can/dev/can-dev.ko", "drivers/net/can/vcan.ko"];

const INIT: &str = "#!/bin/busybox sh
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t sysfs sys /sys
/bin/busybox mount -t devtmpfs dev /dev
for module in /modules/*; do /bin/busybox insmod $module || /bin/busybox echo \"$module cannot be loaded\"; done
/bin/busybox ip link set lo up
/bin/busybox ip link add vcan0 type vcan
/bin/busybox ip link set vcan0 up
/tests --test-threads 1
/bin/busybox poweroff -f
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_tests_say_at_their_end_is_counted() {
        let tally =
            counts("test result: FAILED. 4 passed; 1 failed; 0 ignored; 0 measured; 2 filtered out").unwrap();
        assert_eq!((tally.passed, tally.failed), (4, 1));
        assert!(counts("running 5 tests").is_none());
    }
}
