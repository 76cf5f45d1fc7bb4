//! Contract: in a real browser, beside the running demo, the page shows the robot and why it moves, without an error of its own, on
//! a wide screen and a phone's; without a daemon and after its end it says so. `NOCTULE_REQUIRE_CHROMIUM=1` makes a missing browser a failure.

mod ipc_rig;
mod view_rig;

use ipc_rig::Place;
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tungstenite::Message;
use view_rig::{Served, Socket, exchange};

/// Starting a browser takes some seconds on a loaded machine; nothing here may take longer.
const LIMIT: Duration = Duration::from_secs(60);
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// The browser's program. Without one tests end early, and say so past the test runner's capture.
fn browser() -> Option<&'static str> {
    let runs = |name: &&&str| Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success());
    let found = NAMES.iter().find(runs).copied();
    if found.is_none() {
        let help = "apt-get install chromium";
        assert!(std::env::var_os("NOCTULE_REQUIRE_CHROMIUM").is_none_or(|value| value != "1"), "no {NAMES:?}; {help}");
        let _ = writeln!(std::io::stderr(), "SKIPPED, the live page is NOT tested in a browser: no {NAMES:?}; {help}");
    }
    found
}

/// A browser with one page, driven by the DevTools protocol.
struct Browser {
    child: Child,
    socket: Socket,
    number: u64,
    complaints: Vec<String>,
    _profile: TempDir,
}

impl Browser {
    fn start(program: &str) -> Self {
        let profile = TempDir::new().expect("profile");
        let mut child = Command::new(program)
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"])
            .args(["--disable-background-networking", "--disable-component-update", "--remote-debugging-port=0"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("browser");
        let lines = BufReader::new(child.stderr.take().expect("pipe")).lines();
        let mut told = lines.map_while(Result::ok);
        let address = told
            .find_map(|line| line.strip_prefix("DevTools listening on ws://")?.split('/').next().map(str::to_owned));
        let address: SocketAddr = address.expect("it listens").parse().expect("an address");
        // Its later words must not fill the pipe.
        std::thread::spawn(move || told.for_each(drop));
        let request = format!("GET /json/list HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
        let list = exchange(address, &request).2;
        let pages: Value = serde_json::from_str(list.trim()).unwrap_or_else(|error| panic!("{error}: {list}"));
        let page = pages.as_array().expect("pages").iter().find(|page| page["type"] == "page").expect("a page");
        let stream = TcpStream::connect(address).expect("connected");
        stream.set_read_timeout(Some(LIMIT)).expect("limited");
        let url = page["webSocketDebuggerUrl"].as_str().expect("address");
        let socket = tungstenite::client::client(url, stream).expect("handshake").0;
        let mut browser = Self { child, socket, number: 0, complaints: Vec::new(), _profile: profile };
        for domain in ["Runtime.enable", "Log.enable", "Page.enable"] {
            browser.call(domain, json!({}));
        }
        browser
    }

    /// Calls a method and gives its result; what the page complains of meanwhile is remembered.
    fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.number += 1;
        let call = json!({ "id": self.number, "method": method, "params": parameters });
        self.socket.send(Message::text(call.to_string())).expect("called");
        loop {
            let Message::Text(text) = self.socket.read().expect("an answer") else { continue };
            let answer: Value = serde_json::from_str(text.as_str()).expect("JSON");
            if answer["id"] == self.number {
                return answer["result"].clone();
            }
            match answer["method"].as_str() {
                Some("Runtime.exceptionThrown") => self.complaints.push(answer["params"].to_string()),
                Some("Log.entryAdded") if answer["params"]["entry"]["level"] == "error" => {
                    self.complaints.push(answer["params"]["entry"].to_string());
                }
                _ => {}
            }
        }
    }

    fn open(&mut self, url: &str, width: u32, height: u32) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.call("Emulation.setDeviceMetricsOverride", size);
        self.call("Page.navigate", json!({ "url": url }));
    }

    fn value(&mut self, expression: &str) -> Value {
        let call = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let result = self.call("Runtime.evaluate", call);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {result}");
        result["result"]["value"].clone()
    }

    fn text(&mut self, id: &str) -> String {
        let value = self.value(&format!("document.getElementById('{id}')?.textContent ?? ''"));
        value.as_str().unwrap_or_default().to_owned()
    }

    fn until(&mut self, what: &str, expression: &str) {
        let begun = Instant::now();
        while self.value(expression) != true {
            let said = ["notice", "daemon-state", "controller-state", "why"].map(|id| self.text(id));
            assert!(begun.elapsed() < LIMIT, "{what}; the page says {said:?}, complaints {:?}", self.complaints);
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// A picture of the page, kept beside the test programs.
    fn screenshot(&mut self, name: &str) -> (u32, u32, Vec<u8>) {
        let shot = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        let bytes = from_base64(shot["data"].as_str().expect("a picture"));
        let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::write(&path, &bytes).expect("kept");
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().expect("PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("size")];
        let info = reader.next_frame(&mut pixels).expect("pixels");
        (info.width, info.height, pixels)
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.call("Browser.close", json!({}));
        let begun = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) && begun.elapsed() < Duration::from_secs(5) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn from_base64(text: &str) -> Vec<u8> {
    let digit = |byte: u8| match byte {
        b'A'..=b'Z' => byte - b'A',
        b'a'..=b'z' => byte - b'a' + 26,
        b'0'..=b'9' => byte - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u32> = text.bytes().filter(|byte| *byte != b'=').map(|byte| u32::from(digit(byte))).collect();
    let group = |group: &[u32]| {
        let word = group.iter().fold(0, |word, digit| word << 6 | digit) << (6 * (4 - group.len()));
        word.to_be_bytes()[1..group.len()].to_vec()
    };
    digits.chunks(4).flat_map(group).collect()
}

/// The demo with its page, as a user starts it.
struct Demo {
    child: Child,
    url: String,
    place: Place,
}

impl Demo {
    fn start() -> Self {
        let place = Place::new();
        let mut child = Command::new(env!("CARGO_BIN_EXE_noctule"))
            .args(["demo", "--duration", "120", "--config"])
            .arg(place.config_file())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("demo");
        let lines = BufReader::new(child.stderr.take().expect("pipe")).lines();
        let mut told = lines.map_while(Result::ok);
        let address = |line: String| line.split_once("live page: ")?.1.split(' ').next().map(str::to_owned);
        let url = told.find_map(address).expect("its address");
        std::thread::spawn(move || told.for_each(drop));
        Self { child, url, place }
    }

    fn end(&mut self) {
        let pid = rustix::process::Pid::from_child(&self.child);
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        let _ = self.child.wait();
    }
}

impl Drop for Demo {
    fn drop(&mut self) {
        self.end();
        let _ = &self.place;
    }
}

/// Colours of a canvas, at most a thousand of them.
const COLOURS: &str = "(canvas) => { const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data; \
    const seen = new Set(); for (let i = 0; i < data.length && seen.size < 1000; i += 4) seen.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]); \
    return seen.size; }";

#[test]
fn beside_the_demo_the_page_shows_the_robot_and_why_it_moves() {
    let Some(program) = browser() else { return };
    let mut demo = Demo::start();
    let mut browser = Browser::start(program);
    browser.open(&demo.url, 1440, 900);
    // Whether it drives is the daemon's affair, and on a loaded machine it may refuse to; it is heard in any state.
    let live = "document.body?.dataset.fresh === 'true' && /^(READY|ACTIVE|DEGRADED|STOPPED)$/.test(document.getElementById('daemon-state')?.textContent) && document.querySelectorAll('.fan').length === 3";
    browser.until("the robot is live", live);
    browser.until(
        "three pictures",
        &format!("[...document.querySelectorAll('.fan canvas')].filter((c) => ({COLOURS})(c) > 60).length === 3"),
    );
    let plan = browser.value(&format!("({COLOURS})(document.getElementById('plan'))"));
    assert!(plan.as_u64().is_some_and(|colours| colours > 100), "{plan} colours over the robot");
    let controller = browser.text("controller-state");
    assert!(["WAIT", "TRACK", "HOLD", "LATCHED"].contains(&controller.as_str()), "{controller}");
    let why = browser.text("why");
    assert!(why.contains("robot") && why.ends_with('.'), "{why}");
    for id in ["command-linear", "command-angular", "driven-linear"] {
        let shown = browser.text(id).replace('\u{2212}', "-");
        assert!(shown.parse::<f64>().is_ok(), "{id}: {shown}");
    }
    assert_eq!(browser.value("document.querySelectorAll('#sensor-rows tr').length"), 3);
    assert!(!browser.text("backend").is_empty());

    // Held is held, and a step leads to another ping set.
    browser.value("document.getElementById('pause').click()");
    let held = browser.text("notice");
    assert!(held.starts_with("Paused. Shown is ping set"), "{held}");
    let shown = |notice: &str| notice.split(['t', ',']).find_map(|part| part.trim().parse::<u64>().ok());
    std::thread::sleep(Duration::from_millis(600));
    let later = browser.text("notice");
    assert!(shown(&held).is_some() && shown(&held) == shown(&later), "{held} / {later}");
    browser.value("document.getElementById('back').click()");
    assert_ne!(shown(&browser.text("notice")), shown(&held));
    browser.value("document.getElementById('pause').click()");

    let (width, height, pixels) = browser.screenshot("live_page.png");
    assert_eq!((width, height), (1440, 900));
    let bright = pixels.iter().filter(|value| **value > 128).count();
    assert!(bright > pixels.len() / 200, "the picture is not black");

    browser.open(&demo.url, 390, 844);
    browser.until("it is live on a phone", live);
    let overflow = browser.value("document.documentElement.scrollWidth - window.innerWidth");
    assert!(overflow.as_f64().is_some_and(|pixels| pixels <= 0.0), "{overflow} pixels too wide for a phone");
    let small = browser.value(
        "[...document.querySelectorAll('button')].filter((b) => b.offsetHeight < 36 || b.offsetWidth < 36).length",
    );
    assert_eq!(small, 0, "buttons for fingers");
    browser.screenshot("live_page_phone.png");
    assert_eq!(browser.complaints, Vec::<String>::new());

    demo.end();
    browser.until("the end is told", "document.getElementById('notice').textContent.includes('was lost')");
    assert_eq!(browser.value("document.body.dataset.fresh"), "false", "what is old is not shown as new");
}

#[test]
fn without_a_daemon_the_page_says_so() {
    let Some(program) = browser() else { return };
    let served = Served::new();
    let mut browser = Browser::start(program);
    browser.open(&served.url, 800, 600);
    browser
        .until("no daemon is told", "document.getElementById('notice')?.textContent.startsWith('No daemon is heard')");
    assert_eq!(browser.text("daemon-state"), "not heard");
    assert_eq!(browser.text("command-linear"), "–");
    assert_eq!(browser.value("document.body.dataset.fresh"), "false");
    assert_eq!(browser.complaints, Vec::<String>::new());
}
