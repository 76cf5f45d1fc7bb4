//! Writes raw pings of the simulated front sensor as a recording, so that there is something to process without hardware:
//!
//! ```sh
//! cargo run --release --example simulated_recording -- office.npy
//! cargo run --release -- process office.npy --out images --png
//! ```

use noctule::config::Config;
use noctule::service::{simulator, wiring};
use noctule::signal::{SampleFormat, Samples, Velocity};
use noctule::sim::{SimParams, World};
use noctule::time::Stamp;
use npyz::WriterBuilder as _;

const PINGS: usize = 5;

fn main() -> anyhow::Result<()> {
    let path = std::env::args().nth(1).ok_or_else(|| anyhow::anyhow!("usage: simulated_recording FILE.npy"))?;
    let mut config = Config::default();
    config.recording.format = SampleFormat::PcmF32;
    let setup = wiring::sensing(&config)?;
    let mut simulator = simulator(&config, &setup, World::default_world()?, SimParams::default(), 1)?;
    let mut pings = simulator.empty_ping_set();
    let shape = [PINGS as u64, 32, setup.recording.samples as u64];
    let file = std::fs::File::create(&path)?;
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd()?;
    for _ in 0..PINGS {
        simulator.ping_set(Stamp::default(), &mut pings);
        if let Samples::PcmF32(values) = &*pings.pings[0].samples {
            writer.extend(values.iter().copied())?;
        }
        // Half a second on, so that the echoes move.
        (0..50).for_each(|_| simulator.step(Velocity::forward_m_s(0.3), 0.01));
    }
    writer.finish()?;
    println!("{path}: {PINGS} pings of 32 microphones, f32, 450 kHz");
    Ok(())
}
