//! Chromium without a screen, driven by WebDriver.

use std::io::{BufRead as _, BufReader, Lines};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use fantoccini::{Client, ClientBuilder};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};

use super::PATIENCE;

/// One browser at a time: each takes hundreds of megabytes.
static TURN: Mutex<()> = Mutex::new(());

/// What is looked at with.
pub(crate) enum Screen {
    /// So wide and so high.
    Wide(u32, u32),
    /// A phone's, of so many points; a touch screen with two pixels for a point.
    Phone(u32, u32),
}

/// A browser with one page open.
pub(crate) struct Browser {
    runtime: tokio::runtime::Runtime,
    client: Option<Client>,
    _driver: Driver,
    _data: tempfile::TempDir,
    _turn: MutexGuard<'static, ()>,
}

/// With what it says, which it must be able to go on saying.
struct Driver(Child, Option<Lines<BufReader<ChildStdout>>>);

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Opens a page; `None` if there is no browser here, and nobody insists on one.
pub(crate) fn open(url: &str, screen: &Screen) -> Option<Browser> {
    let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let Some((driver, port)) = driver() else {
        let what = "chromedriver is not found: `sudo apt-get install chromium chromium-driver`, or `cargo xtask test linux`, \
                    which installs it where it may";
        assert!(std::env::var_os(INSIST).is_none(), "{what}");
        eprintln!("not tried in a browser: {what}");
        return None;
    };
    let data = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let client = runtime.block_on(async {
        let mut builder = ClientBuilder::new(HttpConnector::new());
        let capabilities = capabilities(screen, &data.path().display().to_string());
        builder.capabilities(capabilities.as_object().unwrap().clone());
        let client = builder.connect(&format!("http://127.0.0.1:{port}")).await.unwrap();
        client.goto(url).await.unwrap();
        client
    });
    Some(Browser { runtime, client: Some(client), _driver: driver, _data: data, _turn: turn })
}

fn driver() -> Option<(Driver, u16)> {
    let mut command = Command::new("chromedriver");
    command.arg("--port=0").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut driver = Driver(command.spawn().ok()?, None);
    let mut lines = BufReader::new(driver.0.stdout.take()?).lines();
    while let Some(Ok(line)) = lines.next() {
        // "ChromeDriver was started successfully on port 41234."
        if let Some((_, port)) = line.rsplit_once("successfully on port ") {
            driver.1 = Some(lines);
            return Some((driver, port.trim_end_matches('.').parse().ok()?));
        }
    }
    None
}

fn capabilities(screen: &Screen, data: &str) -> Value {
    let mut arguments = vec![
        "--headless".to_owned(),
        "--no-sandbox".to_owned(),
        "--disable-gpu".to_owned(),
        "--disable-dev-shm-usage".to_owned(),
        "--disable-quic".to_owned(),
        "--no-first-run".to_owned(),
        "--disable-background-networking".to_owned(),
        "--disable-component-update".to_owned(),
        "--disable-sync".to_owned(),
        "--no-proxy-server".to_owned(),
        format!("--user-data-dir={data}"),
    ];
    let mut options = json!({});
    match *screen {
        Screen::Wide(width, height) => arguments.push(format!("--window-size={width},{height}")),
        Screen::Phone(width, height) => {
            options["mobileEmulation"] = json!({ "deviceMetrics":
                { "width": width, "height": height, "pixelRatio": 2.0, "touch": true, "mobile": true } });
        }
    }
    options["args"] = json!(arguments);
    json!({ "browserName": "chrome", "goog:chromeOptions": options, "goog:loggingPrefs": { "browser": "ALL" } })
}

impl Browser {
    fn client(&self) -> &Client {
        self.client.as_ref().unwrap()
    }

    /// Runs a script in the page; what it returns.
    pub(crate) fn run(&self, script: &str) -> Value {
        self.runtime.block_on(self.client().execute(script, Vec::new())).unwrap()
    }

    /// The text of an element, by its id.
    pub(crate) fn text(&self, id: &str) -> String {
        let script = format!("return document.getElementById('{id}').innerText");
        self.run(&script).as_str().unwrap_or_default().to_owned()
    }

    pub(crate) fn number(&self, id: &str) -> u64 {
        self.text(id).parse().unwrap()
    }

    /// Waits until an expression is true in the page.
    pub(crate) fn until(&self, expression: &str) {
        let begun = Instant::now();
        while self.run(&format!("return Boolean({expression})")) != Value::Bool(true) {
            let seen = self.run("return document.body.innerText");
            assert!(begun.elapsed() < PATIENCE, "in {PATIENCE:?} not: {expression}; the page shows:\n{seen}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Types as a person does, to whatever has the focus.
    pub(crate) fn press(&self, keys: &str) {
        self.runtime.block_on(async {
            let focused = self.client().active_element().await.unwrap();
            focused.send_keys(keys).await.unwrap();
        });
    }

    /// Clicks on what a CSS selector finds first. What is found may be drawn anew before it is clicked on.
    pub(crate) fn click(&self, selector: &str) {
        let begun = Instant::now();
        let click = async || self.client().find(fantoccini::Locator::Css(selector)).await?.click().await;
        while let Err(error) = self.runtime.block_on(click()) {
            assert!(error.is_stale_element_reference() && begun.elapsed() < PATIENCE, "{selector}: {error}");
        }
    }

    /// What the page looks like, as PNG.
    pub(crate) fn picture(&self) -> Vec<u8> {
        self.runtime.block_on(self.client().screenshot()).unwrap()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        if let Some(client) = self.client.take() {
            let _ = self.runtime.block_on(client.close());
        }
    }
}

/// Set where a missing browser is a failure.
const INSIST: &str = "COSMIC_BROWSER";
