//! Where the gateways stand: each in a network of its own, if this machine allows that, else both on the loopback
//! interface.
//!
//! The networks are namespaces of the kernel without a name: they, and the pair of interfaces between them, are gone with
//! the last process in them, whatever ended it. Nothing has to be cleaned up.

use std::convert::Infallible;
use std::net::{IpAddr, Ipv4Addr};
use std::os::unix::process::CommandExt as _;
use std::process::Command;

use crate::failed::Failed;

/// Where the gateways stand.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Ground {
    /// Both on the loopback interface, for this reason.
    Loopback(String),
    /// This process is in a network namespace of its own, and the gateway of the east is to be in another.
    Apart,
}

impl Ground {
    /// Looks whether network namespaces can be had. If so, this program begins anew inside one, with [`ENTERED`] among its
    /// arguments.
    ///
    /// # Errors
    /// They can be had, but the program cannot begin anew.
    pub fn enter() -> Result<Self, Failed> {
        let mut why = String::new();
        for unshare in [AS_ROOT, AS_USER] {
            match run("unshare", &[unshare, PROBE].concat()) {
                Ok(()) => return begin_anew(unshare).map(|never| match never {}),
                Err(what) => why = what,
            }
        }
        Ok(Self::Loopback(format!("no network namespaces here: {why}")))
    }

    /// This program has begun anew.
    ///
    /// # Errors
    /// The namespace has no loopback interface.
    pub fn entered() -> Result<Self, Failed> {
        run("ip", &["link", "set", "lo", "up"]).map_err(Failed)?;
        Ok(Self::Apart)
    }

    /// What runs a program where the gateway of the east is to be.
    pub fn far(&self, program: &std::path::Path) -> Command {
        match self {
            Self::Loopback(_) => Command::new(program),
            Self::Apart => {
                let mut command = Command::new("unshare");
                command.arg("--net").arg(program);
                command
            }
        }
    }
}

fn begin_anew(unshare: &[&str]) -> Result<Infallible, Failed> {
    let program = std::env::current_exe().map_err(|error| Failed(format!("where am I? {error}")))?;
    let mut command = Command::new("unshare");
    command.args(unshare).arg(program).args(std::env::args_os().skip(1)).arg(ENTERED);
    Err(Failed(format!("unshare cannot be run: {}", command.exec())))
}

/// A pair of interfaces: one in the namespace of this process, the other in that of another.
#[derive(Debug)]
pub struct Wire {
    /// The kernel delays what goes over it.
    pub delays: bool,
}

impl Wire {
    /// Lays it to the namespace of a process, and delays each direction, if this kernel can.
    ///
    /// # Errors
    /// What the kernel does not allow.
    pub fn lay(to: u32, delay: std::time::Duration) -> Result<Self, Failed> {
        let process = to.to_string();
        let ip = |line: &str| run("ip", &words(line)).map_err(Failed);
        let far = |line: &str| {
            let enter = ["--target", process.as_str(), "--net"];
            run("nsenter", &[enter.as_slice(), &words(line)].concat())
        };
        ip(&format!("link add {NEAR_END} type veth peer name {FAR_END} netns {process}"))?;
        ip(&format!("address add {NEAR}/30 dev {NEAR_END}"))?;
        ip(&format!("link set {NEAR_END} up"))?;
        far("ip link set lo up").map_err(Failed)?;
        far(&format!("ip address add {FAR}/30 dev {FAR_END}")).map_err(Failed)?;
        far(&format!("ip link set {FAR_END} up")).map_err(Failed)?;
        let discipline = |end: &str| format!("qdisc add dev {end} root netem delay {}us", delay.as_micros());
        let delays = run("tc", &words(&discipline(NEAR_END))).is_ok()
            && far(&format!("tc {}", discipline(FAR_END))).is_ok();
        Ok(Self { delays })
    }

    /// Takes the interface down, or up again.
    ///
    /// # Errors
    /// The kernel does not do it.
    pub fn set(&self, up: bool) -> Result<(), Failed> {
        run("ip", &["link", "set", NEAR_END, if up { "up" } else { "down" }]).map_err(Failed)
    }
}

fn words(line: &str) -> Vec<&str> {
    line.split_whitespace().collect()
}

/// Runs a program for what it does. The error is one line.
fn run(program: &str, arguments: &[&str]) -> Result<(), String> {
    let ran = Command::new(program).args(arguments).output();
    let output = ran.map_err(|error| format!("{program} cannot be run: {error}"))?;
    let said = String::from_utf8_lossy(&output.stderr);
    let said = said.lines().next().unwrap_or("it says nothing");
    if output.status.success() { Ok(()) } else { Err(format!("`{program} {}`: {said}", arguments.join(" "))) }
}

/// The address of this process's end of the wire.
pub const NEAR: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 77, 0, 1));
/// The address of the other end.
pub const FAR: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 77, 0, 2));
/// Tells the program that it is in a namespace.
pub const ENTERED: &str = "--entered";
const NEAR_END: &str = "west";
const FAR_END: &str = "east";
const AS_ROOT: &[&str] = &["--net", "--"];
const AS_USER: &[&str] = &["--user", "--map-root-user", "--net", "--"];
/// Makes what the demo needs, in a namespace that is gone at once.
const PROBE: &[&str] = &["ip", "link", "add", NEAR_END, "type", "veth", "peer", "name", FAR_END];
