//! The page of the running demo, in a browser: events of flashed images cross two gateways. It wants images and the server
//! of emulated segments, which `cargo xtask test wan` builds and names.

#[path = "../../page/tests/common/browser.rs"]
#[allow(dead_code, reason = "the tests of the page use more of it")]
mod browser;

use std::io::{BufRead as _, BufReader, Lines};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::time::Duration;

use browser::{Screen, open};

/// Bounds only a test that hangs.
pub(crate) const PATIENCE: Duration = Duration::from_secs(120);

struct Demo {
    program: Child,
    says: Lines<BufReader<ChildStderr>>,
}

impl Demo {
    /// `None` where nobody says what of.
    fn start(out: &std::path::Path) -> Option<Self> {
        let variable = |name| std::env::var_os(name);
        let (images, server, cluster) = (variable(IMAGES)?, variable(SERVER)?, variable(CLUSTER)?);
        let mut command = Command::new(env!("CARGO_BIN_EXE_wan-demo"));
        command.arg("--images").arg(images).arg("--server").arg(server).arg("--cluster").arg(cluster);
        command.arg("--out").arg(out).args("--page 127.0.0.1:0 --cut 1 --around 1 --rounds 3".split(' '));
        let mut program = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let says = BufReader::new(program.stderr.take().unwrap()).lines();
        Some(Self { program, says })
    }

    /// What stands behind this in what it says.
    fn says(&mut self, wanted: &str) -> String {
        let lines = self.says.by_ref().map_while(Result::ok).inspect(|line| eprintln!("{line}"));
        let found = lines.filter_map(|line| Some(line.split_once(wanted)?.1.to_owned())).next();
        found.unwrap_or_else(|| panic!("it ended without saying: {wanted}"))
    }

    /// As by Ctrl-C. Returns its exit code.
    fn end(mut self) -> Option<i32> {
        let told = Command::new("kill").args(["-INT", &self.program.id().to_string()]).status();
        assert!(told.unwrap().success());
        self.program.wait().unwrap().code()
    }
}

impl Drop for Demo {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

#[test]
fn events_of_flashed_images_are_seen_to_cross_two_gateways() {
    let out = tempfile::tempdir().unwrap();
    let Some(mut demo) = Demo::start(out.path()) else {
        eprintln!(
            "not tried: {IMAGES}, {SERVER} and {CLUSTER} are not set; `cargo xtask test wan` sets them"
        );
        return;
    };
    let url = demo.says("the page: ");
    let Some(browser) = open(&url, &Screen::Wide(1_300, 1_000)) else { return };
    browser.until("document.querySelectorAll('#maps h3').length === 2");
    let row_of = |table: &str, words: &str| {
        format!(
            "[...document.querySelectorAll('#{table} tbody tr')].some(row => /{words}/.test(row.innerText))"
        )
    };
    // By one gateway out of the west, by the other into the east.
    for channel in ["temperature", "brake_force"] {
        browser.until(&row_of("way-table", &format!(r"{channel}\s+SRT\s+west\s+IP\s+forwarded\s+[1-9]")));
        browser.until(&row_of("way-table", &format!(r"{channel}\s+SRT\s+west\s+east\s+forwarded\s+[1-9]")));
    }
    // Each event with who published it: sensor and brake.
    browser.until(&row_of("crossing-table", "west.0[12]"));
    // Hard channels stay where they are.
    assert_eq!(browser.run(&format!("return {}", row_of("way-table", "wheel_speed"))), false);
    demo.says("stay until Ctrl-C");
    browser.until(&row_of("way-table", "command"));
    drop(browser);
    assert_eq!(demo.end(), Some(0));
}

const IMAGES: &str = "COSMIC_WAN_IMAGES";
const SERVER: &str = "COSMIC_WAN_SERVER";
const CLUSTER: &str = "COSMIC_WAN_CLUSTER";
