//! `cosmic serve`, as a browser and a person call it. What the page looks like is tried in `linux/page`.

mod common;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;

use common::{CLUSTER, Running, Segment, run, text, until};
use serde_json::Value;

const ROVER: &str = "log:docs/tasks/rover.log";

/// The page that is served, and the token if there is one.
struct Page {
    _program: Running,
    address: String,
    token: Option<String>,
}

impl Page {
    fn start(arguments: &[&str]) -> Self {
        let mut words = vec!["serve", "--listen", "127.0.0.1:0", "--json"];
        words.extend(arguments);
        let mut program = Running::start(&words);
        let mut line = String::new();
        BufReader::new(program.0.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap();
        let address = said["url"].as_str().unwrap()["http://".len()..].trim_end_matches('/').to_owned();
        Self { _program: program, address, token: said["token"].as_str().map(str::to_owned) }
    }

    fn ask(&self, request: &str) -> String {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.write_all(request.replace("@", &self.address).as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    fn state(&self) -> Value {
        let answer = self.ask("GET /api/state HTTP/1.1\r\nHost: @\r\nConnection: close\r\n\r\n");
        serde_json::from_str(&answer[answer.find("\r\n\r\n").unwrap()..]).unwrap()
    }

    fn publish(&self, token: &str, body: &str) -> String {
        self.ask(&format!(
            "POST /api/publish HTTP/1.1\r\nHost: @\r\nConnection: close\r\nContent-Type: application/json\r\n\
             Authorization: Bearer {token}\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        ))
    }
}

#[test]
fn a_log_passes_on_the_page_as_it_did_beside_another_segment() {
    let segment = Segment::start();
    let also = format!("{}@{CLUSTER}", segment.link());
    let page = Page::start(&["-l", ROVER, "-c", CLUSTER, "--also", &also, "--also", "sim:/nowhere/segment"]);
    until("the log has ended", || page.state()["states"][0]["trouble"] == "the log has ended");
    until("the others have been tried", || page.state()["states"][2]["trouble"].is_string());
    let state = page.state();
    let names: Vec<_> = state["hello"]["segments"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["rover", "rover", "sim:/nowhere/segment"]);
    assert_eq!(state["states"][0]["snapshot"]["nodes"][3]["name"], "imu");
    assert_eq!(state["states"][1]["trouble"], Value::Null);
    let trouble = state["states"][2]["trouble"].as_str().unwrap();
    assert!(trouble.contains("/nowhere/segment") && trouble.ends_with("; trying again"), "{trouble}");
    assert_eq!((&state["hello"]["may_publish"], &page.token), (&false.into(), &None));
}

#[test]
fn who_has_the_token_publishes_on_the_segment() {
    let segment = Segment::start();
    let link = segment.link();
    let page =
        Page::start(&["-l", &link, "-c", CLUSTER, "--allow-publish", "--tx-node", "5", "--patience", "50s"]);
    let body = r#"{"segment":0,"channel":"gripper","content":["state=open","force=3.5"]}"#;
    assert!(page.publish("0123", body).starts_with("HTTP/1.1 401"));
    let token = page.token.clone().unwrap();
    let answer = page.publish(&token, body);
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    // The page has seen it cross the bus.
    until("the event is shown", || {
        let state = page.state();
        let channels = state["states"][0]["snapshot"]["channels"].as_array().unwrap().clone();
        channels.iter().any(|it| it["name"] == "gripper" && it["last"]["fields"][1]["value"] == "3.5")
    });
    for (wrong, why) in [
        (body.replace("gripper", "griper"), "there is no channel"),
        (body.replace("force", "farce"), "farce"),
        (body.replace("gripper", "drive"), "this is no"),
        (body.replace(":0,", ":1,"), "only the segment of --link"),
    ] {
        let answer = page.publish(&token, &wrong);
        assert!(answer.starts_with("HTTP/1.1 422") && answer.contains(why), "{answer}");
    }
}

#[test]
fn what_cannot_be_served_is_refused_with_a_remedy() {
    for (arguments, why) in [
        (vec!["serve", "-l", ROVER, "--allow-publish"], "leave out --allow-publish"),
        (vec!["serve", "-l", "slcan:/dev/ttyACM0", "--allow-publish"], "serves one program at a time"),
        (vec!["serve"], "say --link"),
        (vec!["serve", "-l", ROVER, "--also", "can0"], "write sim:PATH"),
        (vec!["serve", "-l", ROVER, "--listen", "192.0.2.1:1"], "choose another --listen"),
        (vec!["serve", "-l", ROVER, "--also", "sim:/x@nowhere.toml"], "nowhere.toml cannot be read"),
    ] {
        let output = run(&arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(text(&output.stderr).contains(why), "{}", text(&output.stderr));
    }
}

#[test]
fn a_page_ends_after_its_span() {
    let output = run(&["serve", "-l", ROVER, "--listen", "127.0.0.1:0", "--for", "100ms"]);
    assert!(output.status.success());
    assert!(text(&output.stdout).starts_with("the page: http://127.0.0.1:"), "{}", text(&output.stdout));
}
