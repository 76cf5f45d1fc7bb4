//! From a ping set to the range scan of the whole robot, without a daemon around it: for closed loops of the detectors, tools and tests.
//!
//! In: a configuration and ping sets. Out: [`RobotScan`]s. Imaging and scan are the daemon's own; states, layers and topics are left
//! out.

use super::trial::{TrialRig, open_imager};
use super::wiring::SensingSetup;
use super::{ServiceError, regions};
use crate::config::Config;
use crate::detect::reflectors::ReflectorFinder;
use crate::detect::{EgoMotion, EgoPlatform, ScanFuser, SpaceDetector};
use crate::flow::MaskParams;
use crate::imaging::Imager;
use crate::imaging::backend::BackendError;
use crate::imaging::params::Prefer;
use crate::sensor::SensorSetup;
use crate::signal::{PingSet, PolarGrid, RobotScan};
use std::sync::Arc;

/// Scans what a robot hears.
pub struct Scanning {
    imager: Imager,
    fuser: ScanFuser,
    scan: RobotScan,
}

/// What every detector on images is made with: the grid, the sensors and what each does not see, and the noise floor and the side-lobe
/// level that the layers of `config` use.
struct Sight<'a> {
    grid: &'a Arc<PolarGrid>,
    sensors: &'a [SensorSetup],
    hidden: Vec<Vec<bool>>,
    params: MaskParams,
}

impl<'a> Sight<'a> {
    fn new(config: &Config, setup: &'a SensingSetup) -> Self {
        Self {
            grid: &setup.plan.grid,
            sensors: &setup.sensors,
            hidden: setup.hidden_directions(),
            params: regions::mask_params(&config.control, &config.platform, &config.imaging.directions),
        }
    }

    fn floor(&self) -> impl Fn(f64) -> f64 + '_ {
        |range_m| self.params.noise_floor.at(range_m)
    }
}

/// The fuser of the sensors of `setup`, as the daemon makes it.
#[must_use]
pub fn fuser(config: &Config, setup: &SensingSetup) -> ScanFuser {
    let sight = Sight::new(config, setup);
    ScanFuser::new(sight.grid, sight.sensors, &sight.hidden, sight.floor(), sight.params.side_lobe_share)
}

/// The finder of reflectors of each sensor, as the estimator of motion makes them.
#[must_use]
pub fn reflector_finders(config: &Config, setup: &SensingSetup) -> Vec<ReflectorFinder> {
    let sight = Sight::new(config, setup);
    let finder =
        |hidden: &Vec<bool>| ReflectorFinder::new(sight.grid, hidden, sight.floor(), sight.params.side_lobe_share);
    sight.hidden.iter().map(finder).collect()
}

/// The estimator of a robot, as the daemon makes it.
#[must_use]
pub fn estimator(config: &Config, setup: &SensingSetup) -> EgoMotion {
    let sight = Sight::new(config, setup);
    let platform = EgoPlatform {
        radius_m: config.platform.radius_m,
        max_linear_m_s: config.platform.max_linear_m_s,
        max_angular_rad_s: config.platform.max_angular_rad_s,
        speed_of_sound_m_s: setup.speed_of_sound_m_s,
    };
    let share = sight.params.side_lobe_share;
    EgoMotion::new(sight.grid, sight.sensors, &sight.hidden, sight.floor(), share, platform)
}

/// The detector of points in space of a robot, as the daemon makes it; `None` where the grid is level.
#[must_use]
pub fn space(config: &Config, setup: &SensingSetup) -> Option<SpaceDetector> {
    let sight = Sight::new(config, setup);
    let share = sight.params.side_lobe_share;
    SpaceDetector::new(sight.grid, sight.sensors, &sight.hidden, sight.floor(), share, config.platform.z_m)
}

impl Scanning {
    /// Scans for the robot of `rig`, on one thread.
    ///
    /// # Errors
    /// When there is no such backend.
    pub fn open(rig: &TrialRig, prefer: Prefer) -> Result<Self, BackendError> {
        let imager = open_imager(rig.setup(), rig.masks(), prefer)?;
        Ok(Self { imager, fuser: fuser(rig.config(), rig.setup()), scan: RobotScan::unseen() })
    }

    /// What the robot sees of a ping set.
    ///
    /// # Errors
    /// When the ping set cannot be imaged.
    pub fn look(&mut self, pings: &PingSet) -> Result<&RobotScan, ServiceError> {
        let image = self.imager.image(pings)?;
        for (index, energyscape) in image.energyscapes.iter().enumerate().filter(|(index, _)| image.imaged[*index]) {
            self.fuser.hear(index, pings.sequence, energyscape.emitted_at, &energyscape.values);
        }
        self.fuser.fuse(&mut self.scan);
        Ok(&self.scan)
    }
}
