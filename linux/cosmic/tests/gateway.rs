//! `cosmic gateway`: the program, and its live page in Chromium.
#![cfg(feature = "ip")]

#[path = "../../page/tests/common/browser.rs"]
#[allow(dead_code, reason = "the tests of the page use more of it")]
mod browser;
mod common;

use std::time::Duration;

use browser::{Screen, open};
use common::gateway::{Gateway, port, publisher};
use common::{CLUSTER, Segment, root, run, text};

/// Bounds only a test that hangs.
pub(crate) const PATIENCE: Duration = Duration::from_secs(90);

const PAGE: &str = "[page]\nlisten = \"127.0.0.1:0\"";

#[test]
fn the_page_of_a_gateway_shows_its_segments_and_an_event_that_crossed() {
    let (west, east) = (Segment::start(), Segment::start());
    let gateway = Gateway::start(&[("west", &west), ("east", &east)], PAGE);
    let url = gateway.says("the page: ");
    let _publisher = publisher(&west);
    let Some(browser) = open(&url, &Screen::Wide(1_300, 1_000)) else { return };
    browser.until("document.getElementById('title').innerText === 'gateway, network test'");
    browser.until("document.querySelectorAll('#maps h3').length === 2");
    // A way, with what became of it; and the event itself, with its publisher.
    let way = |words: &str| {
        format!(
            "[...document.querySelectorAll('#way-table tbody tr')].some(row => /{words}/.test(row.innerText))"
        )
    };
    browser.until(&way(r"gripper\s+SRT\s+west\s+east\s+forwarded\s+[1-9]"));
    browser.until("/west.05\\s+east\\s+forwarded/.test(document.getElementById('crossing-table').innerText)");
    // It crosses the bus of the east: published there by the gateway, marked in both maps.
    browser.until("[...document.querySelectorAll('#maps .spot text')].filter(it => it.textContent.includes('⇄')).length === 2");
    browser.run("document.querySelector('#way-table tbody button').click()");
    browser.until("document.getElementById('channel-words').innerText.startsWith('gripper (SRT')");
    // A filter holds for what crosses, too; the keys reach it.
    browser.press("9");
    browser.until("document.activeElement.id === 'ways'");
    browser.press("/");
    browser.press("nobody");
    browser.until("document.querySelectorAll('#way-table tbody tr, #crossing-table tbody tr').length === 0");
    // It only shows.
    browser.run(
        "fetch('api/publish', { method: 'POST' }).then(it => { document.body.dataset.published = it.status; })",
    );
    browser.until("document.body.dataset.published === '403'");
}

#[test]
fn what_is_wrong_with_a_configuration_is_told_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("gateway.toml");
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    let right = format!(
        "network = \"test\"\n[page]\nlisten = \"@\"\n[ip]\nlisten = [\"tcp/127.0.0.1:{}\"]\n[[segment]]\nname = \"west\"\n\
         link = \"sim:/nowhere\"\nuid = \"0x6A7E\"\ntx-node = 90\nplan = {:?}\n",
        port(),
        root().join(CLUSTER)
    );
    for (text_of_file, code, why) in [
        (right.replace('@', "here"), 2, "page.listen: \"here\" is none; write an address"),
        (
            right.replace("sim:/nowhere", "slcan:/dev/ttyACM0").replace('@', "127.0.0.1:0"),
            2,
            "leave out [page]",
        ),
        (right.replace('@', &address.to_string()), 3, "the page cannot be served at"),
        (
            right.replace("tx-node", "tx-nod").replace('@', "127.0.0.1:0"),
            2,
            "tx-nod: is not a field that is known here",
        ),
    ] {
        std::fs::write(&file, text_of_file).unwrap();
        let output = run(&["gateway", file.to_str().unwrap()]);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(said.contains(why) && said.lines().count() == 1, "{said}");
    }
    std::fs::write(&file, right.replace('@', "127.0.0.1:0")).unwrap();
    let output = run(&["gateway", "--check", file.to_str().unwrap()]);
    assert!(output.status.success() && text(&output.stdout).ends_with("1 segments, 0 channels\n"));
}
