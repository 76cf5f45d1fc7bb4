//! From a ping set to the range scan of the whole robot, without a daemon around it: for closed loops of the detectors, tools and tests.
//!
//! In: a configuration and ping sets. Out: [`RobotScan`]s. Imaging and scan are the daemon's own; states, layers and topics are left
//! out.

use super::trial::{TrialRig, open_imager};
use super::wiring::SensingSetup;
use super::{ServiceError, regions};
use crate::config::Config;
use crate::detect::{EgoMotion, EgoPlatform, ScanFuser, SpaceDetector};
use crate::imaging::Imager;
use crate::imaging::backend::BackendError;
use crate::imaging::params::Prefer;
use crate::signal::{PingSet, RobotScan};

/// Scans what a robot hears.
pub struct Scanning {
    imager: Imager,
    fuser: ScanFuser,
    scan: RobotScan,
}

/// The fuser of the sensors of `setup`, with the noise floor and the side-lobe level that the layers of `config` use.
#[must_use]
pub fn fuser(config: &Config, setup: &SensingSetup) -> ScanFuser {
    let params = regions::mask_params(&config.control, &config.platform);
    let floor = |range_m| params.noise_floor.at(range_m);
    ScanFuser::new(&setup.plan.grid, &setup.sensors, &setup.hidden_directions(), floor, params.side_lobe_share)
}

/// The estimator of a robot, as the daemon makes it.
#[must_use]
pub fn estimator(config: &Config, setup: &SensingSetup) -> EgoMotion {
    let params = regions::mask_params(&config.control, &config.platform);
    let platform = EgoPlatform {
        radius_m: config.platform.radius_m,
        max_linear_m_s: config.platform.max_linear_m_s,
        max_angular_rad_s: config.platform.max_angular_rad_s,
        speed_of_sound_m_s: setup.speed_of_sound_m_s,
    };
    let floor = |range_m| params.noise_floor.at(range_m);
    let hidden = setup.hidden_directions();
    EgoMotion::new(&setup.plan.grid, &setup.sensors, &hidden, floor, params.side_lobe_share, platform)
}

/// The detector of points in space of a robot, as the daemon makes it; `None` where the grid is level.
#[must_use]
pub fn space(config: &Config, setup: &SensingSetup) -> Option<SpaceDetector> {
    let params = regions::mask_params(&config.control, &config.platform);
    let floor = |range_m| params.noise_floor.at(range_m);
    let hidden = setup.hidden_directions();
    SpaceDetector::new(&setup.plan.grid, &setup.sensors, &hidden, floor, params.side_lobe_share, config.platform.z_m)
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
