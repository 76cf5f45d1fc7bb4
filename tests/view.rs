//! Contract: the live page shows what was published and its age, says so when there is nothing, asks for its token, answers to no
//! foreign site, and a slow or silent client costs nobody else anything. Clients here share no code with the page.

mod ipc_rig;
mod view_rig;

use noctule::view::board::Moment;
use noctule::view::metrics::{exposition, verdict};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tungstenite::Message;
use view_rig::{LIMIT, Served, Socket, Speakers, Word, exchange, next_word, state_until};

const TOKEN: &str = "a-token-of-this-test-0123";

#[test]
fn the_page_loads_nothing_from_elsewhere_and_says_so_to_the_browser() {
    let served = Served::new();
    let (status, head, page) = served.get("/", &[]);
    assert_eq!(status, 200);
    for rule in ["default-src 'none'", "script-src 'self'", "frame-ancestors 'none'", "nosniff", "no-referrer"] {
        assert!(head.contains(rule), "{rule}: {head}");
    }
    let mut files = vec![page.clone()];
    for part in page.split(['"', '\'']).filter(|part| part.starts_with('/') && part.len() > 1) {
        let (status, head, body) = served.get(part, &[]);
        assert_eq!(status, 200, "{part}");
        assert!(head.contains("content-security-policy"), "{part}");
        files.push(body);
    }
    assert!(files.len() >= 4, "page, style, script and icon");
    for file in files {
        let named = file.replace("http://www.w3.org/2000/svg", "");
        assert!(!named.contains("http://") && !named.contains("https://"), "{named}");
        assert!(!named.contains("style=\"") && !named.contains("onclick=\""), "the policy forbids it");
    }
    assert_eq!(served.get("/nothing", &[]).0, 404);
}

#[test]
fn without_a_daemon_everything_says_so() {
    let served = Served::new();
    assert_eq!(served.get("/healthz", &[]), (503, served.get("/healthz", &[]).1, "no daemon is heard\n".to_owned()));
    assert_eq!(served.metric("noctule_daemon_up"), Some(0.0));
    assert_eq!(served.metric("noctule_ping_sets_total"), None, "what was never told has no number");
    let mut socket = served.socket("/live", &[]).expect("socket");
    let Word::State(hello) = next_word(&mut socket) else { panic!("hello first") };
    assert_eq!((&hello["kind"], &hello["robot"]["sensors"][0]["name"]), (&"hello".into(), &"front".into()));
    let state = state_until(&mut socket, |_| true);
    for key in ["daemon", "controller", "command", "health", "trouble"] {
        assert!(state[key].is_null(), "{key}: {state}");
    }
}

#[test]
fn what_is_published_is_shown_and_other_starts_of_the_daemon_too_even_after_a_wipe() {
    let served = Served::new();
    let mut socket = served.socket("/live", &[]).expect("socket");
    for start in 0..3 {
        if start == 2 {
            // Somebody takes all files away, those that the page holds open too.
            noctule::io::wipe(&served.place.params).expect("wiped");
        }
        let mut speakers = Speakers::new(&served.place);
        let epoch = format!("{:016x}", speakers.daemon.epoch());
        speakers.until(|| served.metric("noctule_daemon_up") == Some(1.0));
        let mut images = BTreeMap::new();
        let begun = Instant::now();
        let state = loop {
            assert!(begun.elapsed() < LIMIT);
            speakers.ping_set();
            match next_word(&mut socket) {
                Word::Image(bytes) => drop(images.insert(bytes[1], bytes)),
                Word::State(state) if images.len() == 3 && state["daemon"]["epoch"] == epoch.as_str() => break state,
                Word::State(_) => {}
            }
        };
        assert_eq!((&state["daemon"]["state"], &state["controller"]["state"]), (&"ACTIVE".into(), &"TRACK".into()));
        let why = state["command"]["why"].as_str().expect("why");
        for part in ["Obstacle avoidance", "turns right at 0.40 rad/s", "front", "1.55 m", "left", "0.10", "0.0070"] {
            assert!(why.contains(part), "{part}: {why}");
        }
        let age_ms = state["now_ms"].as_f64().expect("now") - state["command"]["emitted_ms"].as_f64().expect("time");
        assert!((60.0..5000.0).contains(&age_ms), "{age_ms} ms old");
        let image = &images[&2];
        let (bearings, ranges) = (180, view_rig::RANGES.div_ceil(2));
        assert_eq!(image.len(), 48 + bearings * ranges);
        assert_eq!(image[48 + 120 * ranges + 50], 201, "-20 dBFS in half decibels from -120");
        assert_eq!(image[48 + 120 * ranges + 60], 41, "-100 dBFS");
    }
    assert_eq!(served.metric("noctule_daemon_restarts_total"), Some(2.0));
}

/// Reads the text format as its description says, by itself: families with their kind, and samples below them.
fn parsed(text: &str) -> BTreeMap<String, (String, BTreeMap<String, f64>)> {
    let mut families: BTreeMap<String, (String, BTreeMap<String, f64>)> = BTreeMap::new();
    let (mut family, mut helped) = (String::new(), String::new());
    for line in text.lines() {
        if let Some(help) = line.strip_prefix("# HELP ") {
            helped = help.split(' ').next().expect("name").to_owned();
            assert!(help.len() > helped.len() + 3, "help says something: {line}");
        } else if let Some(kind) = line.strip_prefix("# TYPE ") {
            let (name, kind) = kind.split_once(' ').expect("name and kind");
            assert_eq!(name, helped, "help and type of one family");
            assert!(["counter", "gauge", "histogram"].contains(&kind), "{line}");
            assert!(families.insert(name.to_owned(), (kind.to_owned(), BTreeMap::new())).is_none(), "{name} twice");
            family = name.to_owned();
        } else {
            let (series, value) = line.rsplit_once(' ').expect("series and value");
            let name = series.split('{').next().expect("name");
            assert!(name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_'), "{name}");
            let suffix = name.strip_prefix(family.as_str()).unwrap_or_else(|| panic!("{line} is not of {family}"));
            let (kind, samples) = families.get_mut(&family).expect("family");
            let allowed: &[&str] = if kind == "histogram" { &["_bucket", "_sum", "_count"] } else { &[""] };
            assert!(allowed.contains(&suffix), "{line}");
            assert_eq!(kind == "counter", name.ends_with("_total"), "{name}");
            let value = if value == "NaN" { f64::NAN } else { value.parse().expect("a number") };
            assert!(samples.insert(series.to_owned(), value).is_none(), "{series} twice");
        }
    }
    families
}

#[test]
fn the_numbers_are_prometheus_text_and_those_that_were_published() {
    let served = Served::new();
    let mut speakers = Speakers::new(&served.place);
    speakers.until(|| {
        served.metric("noctule_controller_up") == Some(1.0) && served.metric("noctule_ping_sets_total").is_some()
    });
    let (_, head, text) = served.get("/metrics", &[]);
    assert!(head.contains("text/plain; version=0.0.4"), "{head}");
    let families = parsed(&text);
    let value = |series: &str| {
        let family = families.values().find_map(|(_, samples)| samples.get(series));
        *family.unwrap_or_else(|| panic!("{series} in {text}"))
    };
    assert_eq!(value("noctule_ping_sets_dropped_total"), 2.0);
    assert_eq!(value("noctule_pings_rejected_total{sensor=\"left\"}"), 4.0);
    assert_eq!(
        [0, 1, 2].map(|i| value(&format!("noctule_sensor_present{{sensor=\"{}\"}}", ["front", "left", "right"][i]))),
        [1.0, 0.0, 1.0]
    );
    assert_eq!(value("noctule_daemon_state{state=\"ACTIVE\"}"), 1.0);
    assert_eq!(value("noctule_daemon_state{state=\"FAULT\"}"), 0.0);
    assert!(value("noctule_commands_by_layer_total{layer=\"obstacle_avoidance\"}") >= 1.0);
    assert_eq!(value("noctule_backend_info{backend=\"cpu\",adapter=\"a \\\"quoted\\\" adapter\"}"), 1.0);
    assert!((value("noctule_daemon_latency_seconds{statistic=\"p99\"}") - 0.02).abs() < 1e-12);
    assert!(value("noctule_message_age_seconds{topic=\"noctule/sonar/front/energyscape\"}") >= 0.06);
    let count = value("noctule_latency_seconds_count");
    assert!(count >= 1.0);
    assert_eq!(value("noctule_latency_seconds_bucket{le=\"0.01\"}"), 0.0);
    assert_eq!(value("noctule_latency_seconds_bucket{le=\"0.02\"}"), count, "12.5 ms");
    assert_eq!(value("noctule_latency_seconds_bucket{le=\"+Inf\"}"), count);
    assert!((value("noctule_latency_seconds_sum") / count - 0.0125).abs() < 1e-9);
    assert_eq!(served.get("/healthz", &[]).0, 200);
}

#[test]
fn a_daemon_that_fell_silent_is_down_and_its_numbers_are_not_repeated() {
    let command = noctule::io::wire::message::VelocityCommand {
        t_published_ns: 1,
        state: 3,
        ..noctule::io::wire::message::VelocityCommand::blank()
    };
    let health = noctule::io::wire::telemetry::Health {
        t_monotonic_ns: 1,
        state: 3,
        ..noctule::io::wire::telemetry::Health::blank()
    };
    let moment = Moment { command: Some(command), health: Some(health), ..Moment::default() };
    let sensors = ["front".to_owned()];
    let live = parsed(&exposition(&moment, &sensors, [0, 0], 2_000_000_000));
    let old = parsed(&exposition(&moment, &sensors, [0, 0], 60_000_000_000));
    for family in ["noctule_ping_sets_total", "noctule_daemon_state", "noctule_command_linear_meters_per_second"] {
        assert!(live.contains_key(family) && !old.contains_key(family), "{family}");
    }
    assert_eq!(old["noctule_daemon_up"].1["noctule_daemon_up"], 0.0);
    assert!(old["noctule_message_age_seconds"].1["noctule_message_age_seconds{topic=\"noctule/command\"}"] > 59.0);
    assert!(verdict(&moment, 2_000_000_000).0 && !verdict(&moment, 60_000_000_000).0);
}

#[test]
fn beyond_loopback_nobody_looks_without_the_token() {
    let served = Served::with("0.0.0.0:0", Some(TOKEN), &[]);
    assert!(served.url.ends_with(&format!("/?token={TOKEN}")), "{}", served.url);
    for path in ["/", "/app.js", "/metrics", "/?token=wrong-token-0123456789", "/nothing"] {
        assert_eq!(served.get(path, &[]).0, 401, "{path}");
    }
    assert_eq!(served.socket("/live", &[]).err(), Some(401));
    assert_eq!(served.socket("/", &[("Sec-WebSocket-Protocol", "foxglove.websocket.v1")]).err(), Some(401));
    assert_eq!(served.get("/healthz", &[]).0, 503, "one word is for everybody");
    let (status, head, _) = served.get(&format!("/?token={TOKEN}"), &[]);
    assert_eq!(status, 303, "the token leaves the address");
    assert!(
        head.contains("location: /\r\n") && head.contains("httponly") && head.contains("samesite=strict"),
        "{head}"
    );
    let cookie = head.lines().find_map(|line| line.strip_prefix("set-cookie: ")).expect("cookie");
    let cookie = cookie.split(';').next().expect("pair");
    assert_eq!(served.get("/", &[("Cookie", cookie)]).0, 200);
    assert!(served.socket("/live", &[("Cookie", cookie)]).is_ok());
    assert_eq!(served.get("/metrics", &[("Authorization", &format!("Bearer {TOKEN}"))]).0, 200);
    assert_eq!(served.get("/metrics", &[("Authorization", "Bearer wrong-token-0123456789")]).0, 401);
    let player = [("Sec-WebSocket-Protocol", "foxglove.websocket.v1")];
    assert!(served.socket(&format!("/?token={TOKEN}"), &player).is_ok());
    let made = Served::with("0.0.0.0:0", None, &[]);
    assert!(made.url.contains("/?token="), "without a token one is made: {}", made.url);
    assert_eq!(made.get("/", &[]).0, 401);
}

#[test]
fn on_loopback_no_other_name_and_no_other_site_gets_in() {
    let served = Served::new();
    assert_eq!(served.get("/", &[("Host", "evil.example")]).0, 421, "DNS rebinding");
    assert_eq!(served.get("/metrics", &[("Host", "evil.example:8765")]).0, 421);
    let own = format!("http://localhost:{}", served.address.port());
    assert!(served.socket("/live", &[("Origin", &own)]).is_ok());
    assert_eq!(served.socket("/live", &[("Origin", "http://evil.example")]).err(), Some(403));
    assert_eq!(served.socket("/foxglove", &[("Origin", "http://evil.example")]).err(), Some(403));
    let post = format!("POST / HTTP/1.1\r\nHost: {}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n", served.address);
    assert_eq!(exchange(served.address, &post).0, 405, "there is nothing to command");
    let long = format!("GET / HTTP/1.1\r\nHost: {}\r\nX: {}\r\n\r\n", served.address, "x".repeat(64 * 1024));
    assert_ne!(exchange(served.address, &long).0, 200, "heads are limited");
}

#[test]
fn silent_connections_are_closed_and_keep_nobody_out_for_long() {
    let served = Served::new();
    let silent: Vec<TcpStream> = (0..60)
        .map(|index| {
            let mut stream = TcpStream::connect(served.address).expect("connected");
            // Half of them say a part of a request.
            let _ = if index % 2 == 0 { stream.write_all(b"GET / HTTP/1.1\r\nHost:") } else { Ok(()) };
            stream
        })
        .collect();
    let begun = Instant::now();
    while served.get("/healthz", &[]).0 != 503 {
        assert!(begun.elapsed() < Duration::from_secs(12), "still kept out");
        std::thread::sleep(Duration::from_millis(200));
    }
    drop(silent);
}

#[test]
fn the_command_refuses_what_cannot_be_and_ends_with_its_parent_leaving_nothing() {
    let place = ipc_rig::Place::new();
    let command = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_noctule"));
        command.arg("view").args(arguments).arg("--config").arg(place.config_file());
        command
    };
    let refused = |arguments: &[&str]| {
        let output = command(arguments).output().expect("ran");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, text) = refused(&["--token", "short"]);
    assert!(code == Some(2) && text.contains("allowed: 16 to 256"), "{code:?} {text}");
    let taken = TcpListener::bind("127.0.0.1:0").expect("bound");
    let address = taken.local_addr().expect("address").to_string();
    let (code, text) = refused(&["--listen", &address]);
    assert!(code == Some(69) && text.contains(&address) && text.contains("takes any free port"), "{code:?} {text}");

    let mut page = command(&["--with-parent", "--listen", &address]);
    let mut page = page.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("page");
    let mut url = String::new();
    BufReader::new(page.stdout.take().expect("pipe")).read_line(&mut url).expect("its address");
    let found: SocketAddr = url.trim().trim_start_matches("http://").trim_end_matches('/').parse().expect("an address");
    assert_ne!(found.to_string(), address, "another port than the one in use");
    assert_eq!(exchange(found, &format!("GET /healthz HTTP/1.1\r\nHost: {found}\r\nConnection: close\r\n\r\n")).0, 503);
    drop(page.stdin.take());
    assert_eq!(ipc_rig::wait_for(&mut page, LIMIT).code(), Some(0));
    assert_eq!(place.left_behind(), Vec::<String>::new());
}

/// States that arrive at `reader` within two seconds.
fn states_of(reader: &mut Socket) -> usize {
    reader.get_ref().set_read_timeout(Some(Duration::from_millis(200))).expect("limited");
    let (begun, mut count) = (Instant::now(), 0);
    while begun.elapsed() < Duration::from_secs(2) {
        match reader.read() {
            Ok(Message::Text(text)) => {
                let state: Value = serde_json::from_str(text.as_str()).expect("JSON");
                if state["kind"] == "state" {
                    count += 1;
                    let _ = reader.send(Message::text("ok"));
                }
            }
            Ok(_) => {}
            Err(tungstenite::Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => {}
            Err(error) => panic!("{error}"),
        }
    }
    count
}

/// Ping sets every 50 ms in another thread until the flag is set, counted.
fn speak(mut speakers: Speakers, stop: &Arc<AtomicBool>) -> (Arc<AtomicU64>, std::thread::JoinHandle<Speakers>) {
    let (stop, count) = (Arc::clone(stop), Arc::new(AtomicU64::new(0)));
    let counter = Arc::clone(&count);
    let speaking = std::thread::spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            speakers.ping_set();
            counter.fetch_add(1, Ordering::Relaxed);
            std::thread::sleep(Duration::from_millis(50));
        }
        speakers
    });
    (count, speaking)
}

#[test]
fn a_stalled_browser_delays_no_other_and_gets_the_newest_when_it_wakes() {
    let served = Served::new();
    let stop = Arc::new(AtomicBool::new(false));
    let (published, speaking) = speak(Speakers::new(&served.place), &stop);
    // Reads nothing and says nothing.
    let mut stalled = served.socket("/live", &[]).expect("socket");
    let mut reader = served.socket("/live", &[]).expect("socket");
    let before = published.load(Ordering::Relaxed);
    let count = states_of(&mut reader) as u64;
    let meanwhile = published.load(Ordering::Relaxed) - before;
    // A loaded machine puts two ping sets into one state now and then.
    assert!(2 * count >= meanwhile, "{count} states of {meanwhile} ping sets");
    // What waits for the stalled one is two states at most, then the newest.
    let mut kinds = Vec::new();
    while kinds.len() < 2 {
        if let Ok(Message::Text(text)) = stalled.read() {
            let state: Value = serde_json::from_str(text.as_str()).expect("JSON");
            kinds.extend((state["kind"] == "state").then_some(state["command"]["sequence"].as_u64()));
        }
    }
    stalled.send(Message::text("ok")).expect("said");
    let newest = state_until(&mut stalled, |_| true)["command"]["sequence"].as_u64().expect("sequence");
    let before = kinds[1].unwrap_or(0);
    assert!(2 * (newest - before) >= meanwhile, "{before}, then {newest}: what was missed is not sent late");
    stop.store(true, Ordering::Relaxed);
    drop(speaking.join().expect("spoke"));
}

/// The judge of the test above sees a server that serves one client after the other.
#[test]
fn a_server_that_waits_for_its_slowest_client_is_seen() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("bound");
    let address = listener.local_addr().expect("address");
    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    let serving = std::thread::spawn(move || {
        let accept = || {
            let stream = listener.accept().expect("accepted").0;
            stream.set_write_timeout(Some(Duration::from_secs(1))).expect("limited");
            tungstenite::accept(stream).expect("handshake")
        };
        let mut clients = [accept(), accept()];
        while !asked.load(Ordering::Relaxed) {
            for client in &mut clients {
                let _ = client.send(Message::binary(vec![0u8; 1 << 20]));
                let _ = client.send(Message::text("{\"kind\": \"state\"}"));
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    });
    let connect = || {
        let stream = TcpStream::connect(address).expect("connected");
        tungstenite::client::client(format!("ws://{address}/"), stream).expect("handshake").0
    };
    let _stalled = connect();
    let mut reader = connect();
    let count = states_of(&mut reader);
    stop.store(true, Ordering::Relaxed);
    // The judge above would have asked for half of what was tried, forty in two seconds.
    assert!(2 * count < 40, "{count}: the fault was not seen");
    drop(reader);
    serving.join().expect("served");
}
