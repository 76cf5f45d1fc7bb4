//! What goes wrong in a soak, and what the safe-state contract asks for then.

use crate::signal::SENSORS_MAX;
use crate::sim::Fault;

/// Something that goes wrong for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Trouble {
    /// A fault of some sensors.
    Sensors {
        /// What.
        fault: Fault,
        /// Whose.
        whose: [bool; SENSORS_MAX],
    },
    /// The GPU is lost, again and again.
    GpuLost,
    /// The GPU gives values that are wrong by 1 %.
    GpuWrong,
    /// The daemon says nothing and hears nothing.
    DaemonSilent,
    /// No ping arrives.
    SourceSilent,
    /// An operator stops the robot.
    OperatorStop,
}

/// What must follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Demand {
    /// The robot goes on as if nothing was.
    GoOn,
    /// The robot goes on, at 0.1 m/s at most and not backwards, or stops.
    Slow,
    /// The robot stops, and goes on by itself when the trouble is over.
    Stop,
    /// The robot stops and waits for an operator, once the trouble is found, which may take so long.
    Latch {
        /// Longest time to find it.
        found_in_ns: u64,
    },
}

/// A trouble with its name and what must follow.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// A word, and the sensor where there is one.
    pub name: String,
    /// What goes wrong.
    pub trouble: Trouble,
    /// What must follow.
    pub demand: Demand,
}

/// What the plausibility of samples may take to find: 5 s (safe-state contract, checks 15 and 29).
const SLOWLY_FOUND_NS: u64 = 5_000_000_000;
const AT_ONCE: Demand = Demand::Latch { found_in_ns: 0 };
const IN_5_S: Demand = Demand::Latch { found_in_ns: SLOWLY_FOUND_NS };

/// Everything that goes wrong with a robot of `sensor_count` sensors, each sensor's faults at each sensor.
#[must_use]
pub fn catalogue(sensor_count: usize) -> Vec<Case> {
    let one_sensor: &[(Fault, Demand)] = &[
        (Fault::EmitterDead { rms: 1e-3 }, AT_ONCE),
        (Fault::Zeros, AT_ONCE),
        (Fault::Frozen, AT_ONCE),
        (Fault::Dropped, Demand::Slow),
        (Fault::Clipped { gain: 100.0 }, Demand::Stop),
        (Fault::DeadChannels { count: 2 }, Demand::GoOn),
        (Fault::DeadChannels { count: 5 }, Demand::Slow),
        (Fault::DeadChannels { count: 12 }, Demand::Stop),
        (Fault::StuckChannels { count: 5 }, Demand::Slow),
        (Fault::HotChannels { count: 2, rms: 1e-2 }, Demand::GoOn),
        (Fault::SwappedChannels { pairs: 4 }, IN_5_S),
        (Fault::RateError { ratio: 1.01 }, IN_5_S),
        (Fault::Desync { late_ns: 5_000 }, Demand::Slow),
        (Fault::Desync { late_ns: 500_000 }, AT_ONCE),
        (Fault::Gaps { missing: 1 }, Demand::Slow),
        (Fault::Duplicate, Demand::Slow),
    ];
    let all_sensors: &[(Fault, Demand)] = &[
        (Fault::Dropped, Demand::Stop),
        (Fault::Duplicate, Demand::Stop),
        (Fault::Backward, Demand::Stop),
        (Fault::Future { ahead_ns: 200_000_000 }, Demand::Stop),
        (Fault::Past { behind_ns: 400_000_000 }, Demand::Stop),
    ];
    let others: &[(&str, Trouble, Demand)] = &[
        ("gpu-lost", Trouble::GpuLost, Demand::Slow),
        ("gpu-wrong", Trouble::GpuWrong, IN_5_S),
        ("daemon-silent", Trouble::DaemonSilent, Demand::Stop),
        ("source-silent", Trouble::SourceSilent, Demand::Stop),
        ("operator-stop", Trouble::OperatorStop, AT_ONCE),
    ];
    let case = |name: String, trouble, demand| Case { name, trouble, demand };
    let mut cases = Vec::new();
    for (fault, demand) in one_sensor {
        for sensor in 0..sensor_count.min(SENSORS_MAX) {
            let whose = std::array::from_fn(|index| index == sensor);
            let name = format!("{}{} of sensor {sensor}", fault.name(), extent(fault));
            cases.push(case(name, Trouble::Sensors { fault: *fault, whose }, *demand));
        }
    }
    for (fault, demand) in all_sensors {
        let whose = std::array::from_fn(|index| index < sensor_count);
        cases.push(case(
            format!("{} of all sensors", fault.name()),
            Trouble::Sensors { fault: *fault, whose },
            *demand,
        ));
    }
    cases.extend(others.iter().map(|(name, trouble, demand)| case((*name).to_owned(), *trouble, *demand)));
    cases
}

/// How much of it, where one fault is in the list twice.
fn extent(fault: &Fault) -> String {
    match fault {
        Fault::DeadChannels { count } | Fault::StuckChannels { count } | Fault::HotChannels { count, .. } => {
            format!(" ({count})")
        }
        Fault::Desync { late_ns } => format!(" ({} us)", late_ns / 1000),
        _ => String::new(),
    }
}
