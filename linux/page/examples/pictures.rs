//! Draws the pictures of the page that the documentation shows: `cargo run -p cosmic-page --example pictures`.
//!
//! A rover on the simulated bus: its left motor has stopped publishing its speed, and a tool that nobody planned sends.
//! The rover's time is virtual; only the browser's is real.

#[path = "../tests/common/mod.rs"]
mod common;

use std::fs;
use std::path::Path;

use common::browser::{Browser, Screen, open};
use common::{Rover, Server};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_page::{Config, Hub};

fn main() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/pictures");
    let pictures =
        [("page-wide.png", Screen::Wide(1_360, 1_640)), ("page-phone.png", Screen::Phone(390, 1_500))];
    for (name, screen) in pictures {
        let hub = Hub::new(Config { title: "COSMIC".to_owned(), ..Config::default() });
        let mut rover = Rover::of(&hub, "rover");
        let server = Server::start(&hub);
        let Some(browser) = open(&server.url(), &screen) else { return };
        browser.until("document.documentElement.dataset.connection === 'live'");
        drive(&mut rover, &browser);
        let path = folder.join(name);
        match fs::write(&path, browser.picture()) {
            Ok(()) => println!("drawn: {}", path.display()),
            Err(error) => println!("{} cannot be written: {error}", path.display()),
        }
    }
}

/// Some seconds of the rover, with what goes wrong; then the attitude is looked at.
fn drive(rover: &mut Rover, browser: &Browser) {
    let id = Id::new(Priority::SOFT_MOST_URGENT, TxNode::new(0x70).unwrap(), Etag::new(0x2000).unwrap());
    let wheel = common::bed::channel_named(&rover.bed.plan, "left_wheel");
    let mut frames = 0;
    for tenth in 0..60 {
        rover.bed.orders.borrow_mut().mute = (30..33).contains(&tenth).then_some(wheel);
        if tenth % 10 == 4 {
            rover.bed.send(rover.bed.stranger, Frame::new(id, Payload::full([0x5A; 8])));
        }
        frames += rover.run(100);
        // No more at once than is told in a tenth of a second.
        std::thread::sleep(std::time::Duration::from_millis(120));
    }
    assert!(frames > 1_000, "the rover drives");
    let choose = "[...document.querySelectorAll('#channel-table tbody button')].find(it => it.innerText === 'attitude')";
    browser.until(&format!("Boolean({choose})"));
    browser.run(&format!("{choose}.click()"));
    browser.until("document.getElementById('plot-text').innerText.includes('values in 10 s')");
    browser.until("document.getElementById('channel-table').innerText.includes('calibrated=true')");
}
