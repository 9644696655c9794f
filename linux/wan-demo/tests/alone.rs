//! What the demo starts ends with it, however it ended.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use cosmic_wan_demo::ground::Ground;

/// What waits bound hangs only.
const PATIENCE: Duration = Duration::from_secs(60);

/// A gateway as the demo starts it, that waits for its configuration.
fn gateway(mut command: Command) -> Child {
    command.args(["--gateway", "no.toml", "--segment", "west"]);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let first = BufReader::new(child.stdout.take().unwrap()).lines().next().unwrap().unwrap();
    assert_eq!(first, "here");
    child
}

fn network_of(process: &str) -> String {
    let name = std::fs::read_link(format!("/proc/{process}/ns/net")).unwrap();
    name.to_string_lossy().into_owned()
}

fn networks() -> Vec<String> {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let of = |process: std::fs::DirEntry| std::fs::read_link(process.path().join("ns/net")).ok();
    processes.filter_map(of).map(|name| name.to_string_lossy().into_owned()).collect()
}

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_wan-demo"))
}

#[test]
fn a_gateway_ends_with_the_input_that_its_demo_held() {
    let mut child = gateway(Command::new(program()));
    drop(child.stdin.take());
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        assert!(begun.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_network_is_gone_with_the_last_process_in_it() {
    if !Command::new("unshare").args(["--net", "true"]).status().is_ok_and(|status| status.success()) {
        eprintln!("no network namespaces here: not tried");
        return;
    }
    let mut child = gateway(Ground::Apart.far(program()));
    let network = network_of(&child.id().to_string());
    assert_ne!(network, network_of("self"));
    assert!(networks().contains(&network));
    child.kill().unwrap();
    child.wait().unwrap();
    let begun = Instant::now();
    while networks().contains(&network) {
        assert!(begun.elapsed() < PATIENCE, "{network} is still there");
        std::thread::sleep(Duration::from_millis(10));
    }
}
