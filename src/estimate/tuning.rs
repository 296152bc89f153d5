//! Every tuned number of the estimate, each with its physical meaning and where it is from.
//!
//! None of them decides an answer: halving or doubling any of them stays inside the interval of the differences between
//! places (`research/` has the measurements).

/// Packets on either side whose mean sampling-time slope a packet is turned to. The cards' common slope wanders over tens
/// of packets; what differs from packet to packet is jitter.
pub(crate) const SLOPE_PACKETS: usize = 7;

/// How much of the running mean of a one-way channel stays from packet to packet when its sign is chosen: three packets, over
/// which a driving robot's channel hardly changes.
pub(crate) const SIGN_MEMORY: f32 = 0.7;

/// Window lengths that the likelihood is averaged over, each half of the one before: the shortest is an eighth of the motion.
pub(crate) const WINDOW_LENGTHS: usize = 4;

/// Longest motion over which a wave may stay coherent, metres: over twice the arcs of a metre that were measured, odometry
/// and other paths change more than a wavelength.
pub(crate) const COHERENT_M: f64 = 2.5;

/// Shortest distance of a transmitter that is expected, metres: robots do not drive into each other.
pub(crate) const NEAREST_M: f64 = 1.8;

/// The range is uniform in its logarithm up to so many times the shortest: 36 m, a building.
pub(crate) const FARTHEST: f64 = 20.0;

/// Largest |elevation| that is expected, degrees: 1.8 m higher at 5 m.
pub(crate) const ELEVATION_DEG: f64 = 20.0;

/// Probability of an elevation beyond that, where the motion would show it.
pub(crate) const ELEVATION_BEYOND: f64 = 0.1;

/// Half width of what paths that pass for the direct one add to an azimuth, degrees (the scale of a Cauchy density).
pub(crate) const MODEL_DEG: f64 = 0.2;

/// Probability that none of what was found is right.
pub(crate) const UNEXPLAINED: f64 = 0.01;

/// Figures of sensors rather than of the estimate: what odometry gets wrong.
pub(crate) mod sensor {
    /// Error of positions from moment to moment, metres: what wheels, a tracking camera and a bent wave front get wrong.
    pub(crate) const POSITION_M: f64 = 0.003;
    /// Relative error of a path's scale by motion capture, with what the crystals' drift adds along a straight drive.
    pub(crate) const SCALE: f64 = 0.01;
    /// Heading of the whole path, degrees: motion capture.
    pub(crate) const MOTION_CAPTURE_DEG: f64 = 0.3;
    /// The same of a tracking camera: rotation against motion capture over 31 motions.
    pub(crate) const CAMERA_DEG: f64 = 3.9;
    /// The same of a camera's path held to what wheels can roll.
    pub(crate) const ROLLING_CAMERA_DEG: f64 = 2.4;
    /// The same of wheel odometry where the place of the antenna on the robot is known.
    pub(crate) const WHEELS_DEG: f64 = 1.5;
    /// The same of wheel odometry where it is not.
    pub(crate) const UNMOUNTED_DEG: f64 = 20.0;
}
