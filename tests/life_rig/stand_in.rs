//! A daemon made of the daemon's own pieces with a source that fails on demand: this test program, started again.

use crate::ipc_rig::Place;
use noctule::config::Config;
use noctule::imaging::params::Prefer;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::io::Ipc;
use noctule::io::source::simulator::SimulatorSource;
use noctule::io::source::{Delivery, Source, SourceError};
use noctule::life::Stop;
use noctule::life::panic::{end_on_panic, is_dying};
use noctule::service::{self, Parts, ServiceError, wiring};
use noctule::signal::{PingSet, SampleFormat, Velocity};
use noctule::sim::{SimParams, World};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

const CONFIG: &str = "NOCTULE_STAND_IN_CONFIG";
const FAULT: &str = "NOCTULE_STAND_IN_FAULT";

/// What goes wrong once [`trigger`] exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The acquiring thread never comes back from its source.
    ParkedSource,
    /// The source returns an error: the acquiring thread returns early.
    SourceFails,
    /// The source says that it has ended.
    SourceEnds,
}

const FAULTS: [(&str, Fault); 3] =
    [("parked_source", Fault::ParkedSource), ("source_fails", Fault::SourceFails), ("source_ends", Fault::SourceEnds)];

/// The file whose appearance starts the fault.
pub fn trigger(place: &Place) -> PathBuf {
    place.directory.path().join("trigger")
}

pub fn command(place: &Place, fault: Fault) -> Command {
    let (name, _) = FAULTS.iter().find(|(_, known)| *known == fault).expect("a fault of the table");
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    command
        .args(["--exact", "stand_in_process", "--test-threads", "1", "--quiet", "--nocapture"])
        .env(CONFIG, place.config_file())
        .env(FAULT, name)
        .stdout(Stdio::null());
    command
}

/// To be called by a test named `stand_in_process` of every file that uses the stand-in.
pub fn serve_if_asked() {
    let (Some(path), Ok(name)) = (std::env::var_os(CONFIG).map(PathBuf::from), std::env::var(FAULT)) else { return };
    let (_, fault) = *FAULTS.iter().find(|(known, _)| *known == name).expect("a fault of the table");
    let stop = Stop::on_signals().expect("signals");
    end_on_panic(stop.flag());
    stop.hold();
    let ended = run(&path, fault, &stop);
    let code = match ended {
        _ if is_dying() => 70,
        Ok(()) => 0,
        Err(ServiceError::Internal(_)) => 70,
        Err(_) => 65,
    };
    // As the program does: what hangs is not waited for.
    signal_hook::low_level::exit(code);
}

fn run(path: &Path, fault: Fault, stop: &Stop) -> Result<(), ServiceError> {
    let trigger = path.with_file_name("trigger");
    let mut config = Config::load(path).expect("configuration");
    config.recording.format = SampleFormat::PcmF32;
    let setup = wiring::sensing(&config)?;
    let masks = wiring::masks(&config, &setup)?;
    let options = ImagerOptions { threads: Some(1), ..ImagerOptions::default() };
    let imager = Imager::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), Prefer::Cpu, options)?;
    let ipc = Ipc::open(&config.ipc)?;
    let open = |setup: &wiring::SensingSetup| -> Result<Box<dyn Source + Send>, ServiceError> {
        let params = SimParams { repeat_waypoints: true, ..SimParams::default() };
        let simulator = service::simulator(&config, setup, World::default_world().expect("world"), params, 1)?;
        let simulated = SimulatorSource::open(simulator, &ipc, config.control.rate_hz, setup.recording.duration_s())?;
        Ok(Box::new(FaultySource { simulated, fault, trigger }))
    };
    service::drive(&config, Parts { setup, masks, imager }, &ipc, open, None, stop)
}

struct FaultySource {
    simulated: SimulatorSource,
    fault: Fault,
    trigger: PathBuf,
}

impl Source for FaultySource {
    fn next_ping_set(&mut self, pings: &mut PingSet, limit: Duration) -> Result<Delivery, SourceError> {
        if self.trigger.exists() {
            match self.fault {
                Fault::ParkedSource => loop {
                    std::thread::park();
                },
                Fault::SourceFails => return Err(SourceError::Other("planted".to_owned())),
                Fault::SourceEnds => return Ok(Delivery::End),
            }
        }
        self.simulated.next_ping_set(pings, limit)
    }

    fn wanted_velocity(&self) -> Option<Velocity> {
        self.simulated.wanted_velocity()
    }

    fn describe(&self) -> String {
        "simulated robot with a fault".to_owned()
    }
}
