//! What a plain sonar at some place on the robot would read, taken from the scan of the whole robot.
//!
//! Goes in: a scan, where the transducer stands and looks, its cone. Comes out: the nearest reflector in the cone, nothing within
//! range, or unseen. A reflector counts where it is (its [`Peak`](crate::signal::Peak)), not in every direction in which its echo is
//! heard, so that a cone is as wide as it says.

use crate::geometry::{Pose2, cartesian_from_polar, polar_from_cartesian};
use crate::signal::{Reading, RobotScan};

/// Steps in which a cone is looked through for what is unseen.
const LOOK_STEP_M: f64 = 0.1;

/// A cone on the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VirtualSonar {
    /// Place and heading of the transducer in the robot frame.
    pub transducer: Pose2,
    /// Full apex angle of its cone.
    pub cone_rad: f64,
    /// Farthest that it reads.
    pub range_max_m: f64,
}

/// What it reads, and of which reflector of the scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SonarReading {
    /// Measured from the transducer.
    pub reading: Reading,
    /// Index of the reflector in the scan.
    pub peak: Option<usize>,
}

impl SonarReading {
    /// Range of an echo.
    #[must_use]
    pub fn range_m(&self) -> Option<f64> {
        match self.reading {
            Reading::Echo { range_m, .. } => Some(range_m),
            Reading::Clear | Reading::Unseen => None,
        }
    }
}

impl VirtualSonar {
    /// Reads the scan.
    #[must_use]
    pub fn read(&self, scan: &RobotScan) -> SonarReading {
        let within = |(index, peak): (usize, &crate::signal::Peak)| {
            let (range_m, bearing_rad) = polar_from_cartesian(self.transducer.local_from_parent(peak.position_m));
            let heard = bearing_rad.abs() <= 0.5 * self.cone_rad && range_m <= self.range_max_m;
            heard.then_some((index, range_m, peak.energy))
        };
        let nearest = scan.peaks.iter().enumerate().filter_map(within).min_by(|a, b| a.1.total_cmp(&b.1));
        match nearest {
            Some((index, range_m, energy)) => {
                SonarReading { reading: Reading::Echo { range_m, energy }, peak: Some(index) }
            }
            None if self.is_seen(scan) => SonarReading { reading: Reading::Clear, peak: None },
            None => SonarReading { reading: Reading::Unseen, peak: None },
        }
    }

    /// Whether axis and both sides of the cone are known to be free out to its range, beyond what no sensor ever sees.
    fn is_seen(&self, scan: &RobotScan) -> bool {
        let steps = (self.range_max_m / LOOK_STEP_M).floor() as usize;
        [-0.5, 0.0, 0.5].iter().all(|share| {
            (1..=steps).all(|step| {
                let there_m = cartesian_from_polar(step as f64 * LOOK_STEP_M, share * self.cone_rad);
                let (range_m, bearing_rad) = polar_from_cartesian(self.transducer.parent_from_local(there_m));
                let ray = &scan.rays[RobotScan::ray_at(bearing_rad)];
                // The skirt of a reflector outside the cone hides what is behind it, and nothing in front.
                range_m <= ray.free_m
                    || matches!(ray.reading, Reading::Echo { range_m: echo_m, .. } if range_m <= echo_m)
            })
        })
    }
}
