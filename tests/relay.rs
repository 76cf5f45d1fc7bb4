//! Contract: `noctule relay` copies commands and energyscapes to topics that the transport's own link can carry, and the link brings them to
//! another machine as they were; the command topic itself has no room for the link. The last needs `iox2-link-tunnel-zenoh`
//! (`cargo install iceoryx2-integrations-zenoh-link-tunnel-cli --version 0.10.0`), `ip` and root; `NOCTULE_REQUIRE_LINK=1` makes their absence a failure.

mod client_rig;
mod ipc_rig;

use client_rig::{Publisher, SENSORS};
use ipc_rig::{Place, foreign_node};
use noctule::io::wire::WireType;
use noctule::io::wire::message::VelocityCommand;
use noctule::io::{Echo, Relay};
use noctule::signal::{DaemonState, Reason, SampleFormat};
use noctule::time::{Clock, SystemClock};
use serde_json::Value;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn sensors() -> Vec<String> {
    SENSORS.map(str::to_owned).to_vec()
}

fn echo(place: &Place, topic: &str) -> Echo {
    Echo::open(&place.ipc, topic, true, &sensors(), SampleFormat::PcmF32).expect("opened")
}

fn last(echo: &Echo) -> Option<Value> {
    std::iter::from_fn(|| echo.next_line()).last().map(|line| serde_json::from_str(&line).expect("JSON"))
}

fn publish(publisher: &mut Publisher) {
    publisher.publish_next();
    let now = SystemClock.now();
    let mut command = VelocityCommand::standstill(now, DaemonState::Active, Reason::Armed);
    command.linear_m_s = 0.25;
    publisher.topics.publish_command(command, now).expect("published");
}

#[test]
fn copies_are_what_was_published() {
    let mut publisher = Publisher::new();
    let relay = Relay::open(&publisher.place.ipc, &sensors(), &[publisher.grid.cell_count(); 3]).expect("opened");
    let [command, copy] = ["noctule/command", "noctule/relay/command"].map(|topic| echo(&publisher.place, topic));
    let [image, image_copy] = ["noctule/sonar/left/energyscape", "noctule/relay/sonar/left/energyscape"]
        .map(|topic| echo(&publisher.place, topic));
    for _ in 0..3 {
        publish(&mut publisher);
        assert!(relay.pass_on().expect("passed on") >= 4, "three images and a command");
        let (sent, copied) = (last(&command).expect("a command"), last(&copy).expect("its copy"));
        assert_eq!((sent["linear_m_s"].as_f64(), &sent), (Some(0.25), &copied));
        let (sent, copied) = (last(&image).expect("an image"), last(&image_copy).expect("its copy"));
        assert_eq!((sent["sequence"].as_u64(), &sent), (Some(publisher.sequence), &copied));
    }
    // Negative control: nothing passes by itself.
    publish(&mut publisher);
    assert!(last(&command).is_some() && last(&copy).is_none() && last(&image_copy).is_none());
}

/// What the transport's link does on either machine: opens or makes a service with its default limits, without our attribute, and takes a
/// publisher of its own. `look` is called while it lives.
fn link_publishes<R>(place: &Place, service: &str, look: impl FnOnce() -> R) -> Result<R, String> {
    let node = foreign_node(&place.root(), &place.params.prefix);
    let service = node
        .service_builder(&service.try_into().expect("name"))
        .publish_subscribe::<VelocityCommand>()
        .open_or_create()
        .map_err(|error| format!("{error:?}"))?;
    let publisher = service.publisher_builder().create().map_err(|error| format!("{error:?}"))?;
    let command =
        VelocityCommand { schema_hash: VelocityCommand::SCHEMA_HASH, sequence: 7, ..VelocityCommand::default() };
    publisher.send_copy(command).map_err(|error| format!("{error:?}"))?;
    Ok(look())
}

#[test]
fn the_link_finds_room_beside_the_relay_and_none_on_the_command_topic() {
    let publisher = Publisher::new();
    let _relay = Relay::open(&publisher.place.ipc, &sensors(), &[publisher.grid.cell_count(); 3]).expect("opened");
    let copy = echo(&publisher.place, "noctule/relay/command");
    let heard = link_publishes(&publisher.place, "noctule/relay/command", || last(&copy)).expect("room for the link");
    assert_eq!(heard.expect("heard")["sequence"], 7);
    // The negative control and the reason for copies: a second commander is refused, whoever it is.
    let refused = link_publishes(&publisher.place, "noctule/command", || ()).expect_err("refused");
    assert!(refused.contains("ExceedsMaxSupportedPublishers"), "{refused}");
}

#[test]
fn on_the_other_machine_a_service_that_the_link_made_can_be_read() {
    let place = Place::new();
    let node = foreign_node(&place.root(), &place.params.prefix);
    let service = node
        .service_builder(&"noctule/relay/command".try_into().expect("name"))
        .publish_subscribe::<VelocityCommand>()
        .max_publishers(2)
        .history_size(0)
        .create()
        .expect("made");
    let heard = echo(&place, "noctule/relay/command");
    let publisher = service.publisher_builder().create().expect("publisher");
    let command =
        VelocityCommand { schema_hash: VelocityCommand::SCHEMA_HASH, sequence: 9, ..VelocityCommand::default() };
    publisher.send_copy(command).expect("sent");
    assert_eq!(last(&heard).expect("heard")["sequence"], 9);
}

/// Two network namespaces with a cable between them.
struct Machines {
    names: [String; 2],
}

fn ip(arguments: &str) -> bool {
    let ran = Command::new("ip").args(arguments.split(' ')).stderr(Stdio::null()).status();
    ran.is_ok_and(|status| status.success())
}

impl Machines {
    fn new() -> Option<Self> {
        let names = ["a", "b"].map(|side| format!("nt{}{side}", std::process::id()));
        let [a, b] = &names;
        let machines = Self { names: names.clone() };
        let made = ip(&format!("netns add {a}"))
            && ip(&format!("netns add {b}"))
            && ip(&format!("link add v netns {a} type veth peer name v netns {b}"))
            && [(a, 1), (b, 2)].iter().all(|(name, host)| {
                ip(&format!("-n {name} addr add 10.77.0.{host}/24 dev v"))
                    && ip(&format!("-n {name} link set lo up"))
                    && ip(&format!("-n {name} link set v up"))
            });
        made.then_some(machines)
    }

    /// A program on one of the machines, in a folder.
    fn program(&self, machine: usize, folder: &Path, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[machine], program]).current_dir(folder);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    }
}

impl Drop for Machines {
    fn drop(&mut self) {
        for name in &self.names {
            let _ = ip(&format!("netns del {name}"));
        }
    }
}

/// A program that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let pid = self.0.id().to_string();
        let _ = Command::new("kill").args(["-INT", &pid]).status();
        let deadline = Instant::now() + Duration::from_secs(3);
        while self.0.try_wait().is_ok_and(|ended| ended.is_none()) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(10));
        }
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A folder with the configurations of robot, transport and link.
fn machine(place: &Place, link: &str) -> PathBuf {
    let folder = place.directory.path().join("machine");
    std::fs::create_dir_all(folder.join("config")).expect("made");
    std::fs::write(folder.join("config/iceoryx2.toml"), place.ipc.transport_toml().expect("TOML")).expect("written");
    let text = format!("{{ mode: \"peer\", scouting: {{ multicast: {{ enabled: false }} }}, {link} }}");
    std::fs::write(folder.join("link.json5"), text).expect("written");
    folder
}

#[test]
fn commands_and_energyscapes_reach_another_machine_through_the_transports_own_link() {
    let link = "iox2-link-tunnel-zenoh";
    let installed = Command::new(link).arg("--version").output().is_ok_and(|output| output.status.success());
    let Some(machines) = installed.then(Machines::new).flatten() else {
        let required = std::env::var_os("NOCTULE_REQUIRE_LINK").is_some_and(|value| value == "1");
        assert!(!required, "{link} is not installed, or network namespaces are not to be had");
        let _ = writeln!(
            std::io::stderr(),
            "SKIPPED, the link to other machines is NOT tested: no {link}, or no namespaces"
        );
        return;
    };
    let (mut publisher, other) = (Publisher::new(), Place::new());
    let folders = [
        machine(&publisher.place, "listen: { endpoints: [\"tcp/10.77.0.1:7447\"] }"),
        machine(&other, "connect: { endpoints: [\"tcp/10.77.0.1:7447\"] }"),
    ];
    let relay = Relay::open(&publisher.place.ipc, &sensors(), &[publisher.grid.cell_count(); 3]).expect("opened");
    let _links = [0, 1].map(|side| {
        let mut command = machines.program(side, &folders[side], link);
        command.args(["-z", "link.json5", "--poll", "5", "--allow", "noctule/relay/*"]);
        Running(command.spawn().expect("started"))
    });
    let command = echo(&other, "noctule/relay/command");
    let image = echo(&other, "noctule/relay/sonar/left/energyscape");
    let (mut heard, mut seen) = (None, None);
    let deadline = Instant::now() + Duration::from_secs(30);
    while (heard.is_none() || seen.is_none()) && Instant::now() < deadline {
        publish(&mut publisher);
        relay.pass_on().expect("passed on");
        std::thread::sleep(Duration::from_millis(50));
        heard = last(&command).or(heard);
        seen = last(&image).or(seen);
    }
    let (heard, seen) = (heard.expect("a command"), seen.expect("an energyscape"));
    assert_eq!((heard["linear_m_s"].as_f64(), &heard["state"]), (Some(0.25), &"ACTIVE".into()));
    let sent = publisher.published[&seen["sequence"].as_u64().expect("a number")];
    assert_eq!(seen["max"].as_f64(), Some(f64::from(sent.value)));
    assert_eq!(seen["t_monotonic_ns"].as_u64(), Some(sent.t_monotonic_ns));
}
