//! Simulates a team: robots drive between random places of a hall and observe each other.

use csi5300_team::{KeyframeId, Mode, OdometryNoise, Team};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Settings of a simulation.
#[derive(Clone, Copy, Debug)]
pub struct Hall {
    pub robots: usize,
    /// Duration, seconds. Each second, each robot has a keyframe and observes its peers.
    pub epochs: usize,
    /// Share of bearings with a wrong first candidate; in half of them the second candidate is right.
    pub wrong: f64,
    /// Share of bearings with a mirror of equal share.
    pub mirrored: f64,
    /// The last robot's bearings are random.
    pub has_liar: bool,
    /// Number of robots with a known first pose (deviation [`START_SD`]). With 0, the frame is that of the first robot.
    pub anchors: usize,
    /// Share of observations with a range: deviation 0.1 m; one in ten is up to 10 m too long.
    pub ranged: f64,
}

impl Hall {
    pub fn of(robots: usize) -> Self {
        Self { robots, epochs: 30, wrong: 0.15, mirrored: 0.3, has_liar: false, anchors: 0, ranged: 0.0 }
    }
}

/// Deviation of the bearings, radians.
pub const AZIMUTH_SD_RAD: f64 = 0.05;

/// Deviation of the known first poses, metres and radians.
const START_SD: [f64; 3] = [0.05, 0.05, 0.05];

/// Limit of peers that a robot observes each second.
const PEERS: usize = 4;

/// A team and the true poses of its keyframes.
pub struct Simulated {
    pub team: Team,
    /// True pose of the team's frame: the first robot's first pose or, with anchors, that of the hall.
    pub origin: [f64; 3],
    /// By keyframe.
    pub truth: Vec<[f64; 3]>,
    /// By robot and epoch.
    pub keyframes: Vec<Vec<KeyframeId>>,
}

pub struct Random(ChaCha8Rng);

impl Random {
    pub fn of_seed(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    pub fn normal(&mut self, sd: f64) -> f64 {
        let (a, b) = (self.between(1e-12, 1.0), self.between(0.0, TAU));
        sd * (-2.0 * a.ln()).sqrt() * b.cos()
    }

    fn happens(&mut self, share: f64) -> bool {
        self.between(0.0, 1.0) < share
    }
}

/// A driving robot.
struct Driver {
    pose: [f64; 3],
    goal: [f64; 2],
    odometry: [f64; 3],
    bias: f64,
    scale: f64,
}

impl Driver {
    fn new(random: &mut Random, side_m: f64, noise: &OdometryNoise) -> Self {
        let mut place = || random.between(0.0, side_m);
        let (pose, goal) = ([place(), place(), place()], [place(), place()]);
        let (bias, scale) = (random.normal(noise.bias_sd_rad_per_m), random.normal(noise.scale_sd));
        Self { pose: [pose[0], pose[1], random.between(-PI, PI)], goal, odometry: [0.0; 3], bias, scale }
    }

    /// Drives half a metre towards the goal and turns by at most 40 degrees. Odometry reports the step with bias, scale and
    /// noise.
    fn step(&mut self, random: &mut Random, side_m: f64, noise: &OdometryNoise) -> f64 {
        let to = [self.goal[0] - self.pose[0], self.goal[1] - self.pose[1]];
        if to[0].hypot(to[1]) < 1.0 {
            self.goal = [random.between(0.0, side_m), random.between(0.0, side_m)];
        }
        let turn = wrap(to[1].atan2(to[0]) - self.pose[2]).clamp(-0.7, 0.7);
        let driven_m = 0.5;
        let moved = |pose: [f64; 3], length: f64, chord: f64, turn: f64, across: f64| {
            let (sin, cos) = (pose[2] + chord).sin_cos();
            [pose[0] + length * cos - across * sin, pose[1] + length * sin + across * cos, wrap(pose[2] + turn)]
        };
        self.pose = moved(self.pose, driven_m, 0.5 * turn, turn, 0.0);
        let end_sd_m = noise.slip * driven_m;
        let length = (driven_m + random.normal(end_sd_m)) / (1.0 + self.scale);
        let bent = self.bias * driven_m;
        let measured = turn - bent + random.normal(noise.turn_rad_per_rt_m * driven_m.sqrt());
        let across = random.normal(end_sd_m);
        self.odometry = moved(self.odometry, length, 0.5 * turn - 0.5 * bent, measured, across);
        driven_m
    }
}

pub fn wrap(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

/// Simulates a team.
pub fn simulated(hall: Hall, seed: u64) -> Simulated {
    followed(hall, seed, &mut |_, _| {})
}

/// As [`simulated`], and calls `look` after each second.
pub fn followed(hall: Hall, seed: u64, look: &mut dyn FnMut(&mut Team, usize)) -> Simulated {
    let mut random = Random::of_seed(seed);
    let (noise, side_m) = (OdometryNoise::default(), 3.0 + 3.0 * (hall.robots as f64).sqrt());
    let (mut team, mut truth) = (Team::default(), Vec::new());
    let robots: Vec<_> = (0..hall.robots).map(|k| team.robot(&format!("r{k}"), true, noise).unwrap()).collect();
    let mut drivers: Vec<Driver> = robots.iter().map(|_| Driver::new(&mut random, side_m, &noise)).collect();
    let mut keyframes = vec![Vec::new(); hall.robots];
    for epoch in 0..hall.epochs {
        for (k, driver) in drivers.iter_mut().enumerate() {
            let driven_m = if epoch > 0 { driver.step(&mut random, side_m, &noise) } else { 0.0 };
            keyframes[k].push(team.keyframe(robots[k], epoch as f64, driver.odometry, driven_m).unwrap());
            truth.push(driver.pose);
            if epoch == 0 && k < hall.anchors {
                let known = [0, 1, 2].map(|part| driver.pose[part] + random.normal(START_SD[part]));
                team.prior(keyframes[k][0], known, START_SD).unwrap();
            }
        }
        for k in 0..hall.robots {
            for _ in 0..PEERS.min(hall.robots - 1) {
                let peer = (k + 1 + random.between(0.0, hall.robots as f64 - 1.0) as usize) % hall.robots;
                let (own, other) = (drivers[k].pose, drivers[peer].pose);
                let (x, y) = (other[0] - own[0], other[1] - own[1]);
                let lies = hall.has_liar && k + 1 == hall.robots;
                let modes = bearing(&mut random, hall, wrap(y.atan2(x) - own[2]), lies);
                let (from, to) = (keyframes[k][epoch], keyframes[peer][epoch]);
                team.link(from, to, &modes, 0.1).unwrap();
                if random.happens(hall.ranged) {
                    let late_m = if random.happens(0.1) { random.between(0.0, 10.0) } else { 0.0 };
                    let range_m = (x.hypot(y) + random.normal(0.1) + late_m).max(0.05);
                    team.link(from, to, &[Mode::range(range_m, 0.1, 1.0)], 0.1).unwrap();
                }
            }
        }
        look(&mut team, epoch);
    }
    let origin = if hall.anchors > 0 { [0.0; 3] } else { truth[0] };
    Simulated { team, origin, truth, keyframes }
}

fn bearing(random: &mut Random, hall: Hall, azimuth: f64, lies: bool) -> Vec<Mode> {
    let mut anything = |share: f64| Mode::azimuth(random.between(-PI, PI), AZIMUTH_SD_RAD, share);
    if lies {
        return vec![anything(0.9), anything(0.1)];
    }
    let (first, second) = (anything(0.7), anything(0.3));
    let right = wrap(azimuth + random.normal(AZIMUTH_SD_RAD));
    let right = |share: f64| Mode::azimuth(right, AZIMUTH_SD_RAD, share);
    if random.happens(hall.wrong) {
        let is_second = random.happens(0.5);
        return vec![first, if is_second { right(0.3) } else { second }];
    }
    if random.happens(hall.mirrored) {
        let own = right(0.5);
        // A robot that drives straight ahead cannot distinguish left from right.
        return vec![Mode::azimuth(-own.azimuth_rad.unwrap()[0], AZIMUTH_SD_RAD, 0.5), own];
    }
    vec![right(0.85), Mode { share: 0.15, ..first }]
}

/// Counts of position and yaw errors within the 68 and 95 % regions of the covariances, and the sum of squared position
/// errors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Held {
    pub poses: usize,
    pub places: [usize; 2],
    pub yaws: [usize; 2],
    pub square_m2: f64,
}

impl Held {
    pub fn share(&self, count: usize) -> f64 {
        100.0 * count as f64 / self.poses as f64
    }

    pub fn rms_m(&self) -> f64 {
        (self.square_m2 / self.poses as f64).sqrt()
    }
}

impl Simulated {
    /// Adds the last pose of each robot but the first, relative to the true pose of the team's frame.
    pub fn judge(&self, found: &csi5300_team::Solution, held: &mut Held) {
        let seen_from = |origin: [f64; 3], pose: [f64; 3]| {
            let ((sin, cos), x, y) = (origin[2].sin_cos(), pose[0] - origin[0], pose[1] - origin[1]);
            [cos * x + sin * y, cos * y - sin * x, wrap(pose[2] - origin[2])]
        };
        for robot in self.keyframes.iter().skip(1) {
            let last = *robot.last().unwrap();
            let truth = seen_from(self.origin, self.truth[last.index()]);
            let (pose, covariance) = (found.pose(last), found.covariance(last));
            let off = nalgebra::Vector2::new(pose[0] - truth[0], pose[1] - truth[1]);
            let inverse = covariance.fixed_view::<2, 2>(0, 0).try_inverse().unwrap();
            let square = off.dot(&(inverse * off));
            let turned = wrap(pose[2] - truth[2]).abs() / covariance[(2, 2)].sqrt();
            held.poses += 1;
            held.square_m2 += off.norm_squared();
            for (k, (place, yaw)) in [(2.296, 1.0), (6.180, 2.0)].into_iter().enumerate() {
                held.places[k] += usize::from(square <= place);
                held.yaws[k] += usize::from(turned <= yaw);
            }
        }
    }
}
