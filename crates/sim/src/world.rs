//! A scene made ready: places at any time, carriers, and the channel between two robots.

use super::carrier::{Carrier, Common, SAMPLE_20_S, Tones};
use super::followed::{SharedWay, lock};
use super::maths::{amplitude, heading};
use super::motion::{Pose, RobotMotion, Track};
use super::random::{Purpose, Stream};
use super::recorded::Recorded;
use super::refusal::{Problem, SceneError};
use super::scene::{Cfo, Pattern, Robot, Scene};
use super::surfaces::{Path, Surface, Surfaces};
use driver_iface::Mac;
use nalgebra::Vector3;
use num_complex::Complex64;

/// A scene made ready.
#[derive(Debug)]
pub struct World {
    scene: Scene,
    carrier: Carrier,
    surfaces: Surfaces,
    robots: Vec<Placed>,
}

/// One robot.
#[derive(Debug)]
struct Placed {
    track: Track,
    mac: Mac,
    /// Antennas A, B, C in the robot's frame, where connected.
    antennas_m: [Option<Vector3<f64>>; 3],
    /// Phase at which its synthesiser locked, turns; it has opposite signs in the two directions.
    lock_turns: f64,
}

impl World {
    /// Makes a scene ready.
    ///
    /// # Errors
    /// [`SceneError::Value`] when a value makes no sense or a trajectory file cannot be read.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        scene.check_values()?;
        let wide = scene.bandwidth_mhz == 40;
        let carrier =
            Carrier::new(scene.channel, wide).ok_or_else(|| Problem::new("no such channel").key("channel"))?;
        let mut robots = Vec::with_capacity(scene.robot.len());
        for (number, robot) in scene.robot.iter().enumerate() {
            let mut walk = Stream::new(scene.seed, number, Purpose::Walk);
            let mut card = Stream::new(scene.seed, number, Purpose::Card);
            let antennas = [Some(robot.antenna_m), robot.antenna_b_m, robot.antenna_c_m];
            robots.push(Placed {
                track: Track::new(
                    robot.start(),
                    &robot.motion,
                    recorded(robot).map_err(|p| p.key("motion").item("robot", number))?,
                    &mut walk,
                ),
                mac: robot.mac_address(number).ok_or_else(|| Problem::new("no MAC address").item("robot", number))?,
                antennas_m: antennas.map(|place| place.map(Vector3::from)),
                lock_turns: card.uniform(),
            });
        }
        let surfaces = surfaces(scene).ok_or_else(|| Problem::new("a wall or reflector has no area").key("wall"))?;
        Ok(Self {
            carrier,
            surfaces: Surfaces::new(surfaces, usize::from(scene.reflections)),
            robots,
            scene: scene.clone(),
        })
    }

    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The carrier.
    #[cfg(test)]
    pub fn carrier(&self) -> &Carrier {
        &self.carrier
    }

    /// True without surfaces: every robot hears every other one.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.surfaces.is_empty()
    }

    /// The MAC address of a robot.
    #[must_use]
    pub fn mac(&self, robot: usize) -> Mac {
        self.robots[robot].mac
    }

    /// A robot's true pose, `t_s` seconds into the scene.
    #[must_use]
    pub fn pose(&self, robot: usize, t_s: f64) -> Pose {
        self.robots[robot].track.at(t_s)
    }

    /// The way of a robot that follows a source; `None` for others.
    #[must_use]
    pub fn way(&self, robot: usize) -> Option<&SharedWay> {
        self.robots.get(robot)?.track.way()
    }

    /// The number of the frame in which a followed robot's pose is at `t_s`, 0 before its first one came; `None` for a
    /// robot that follows nobody.
    #[must_use]
    pub fn frame(&self, robot: usize, t_s: f64) -> Option<u32> {
        self.way(robot).map(|way| lock(way).at(t_s).1)
    }

    /// True if a robot never moves.
    #[must_use]
    pub fn is_still(&self, robot: usize) -> bool {
        self.robots[robot].track.is_still()
    }

    /// Where an antenna (0 = A) is, `None` if it is not connected.
    #[must_use]
    pub fn antenna(&self, robot: usize, antenna: usize, t_s: f64) -> Option<Vector3<f64>> {
        let placed = &self.robots[robot];
        let offset = (*placed.antennas_m.get(antenna)?)?;
        Some(placed.track.at(t_s).mounted(offset))
    }

    /// The phase that the carriers of sender and receiver add, turns, in a frame at `t_ns`; `jitter` is in -1..1.
    ///
    /// A sender's crystal that runs fast turns the coefficient forward: the received tone `exp(j 2 pi f_from t)` is
    /// mixed with `exp(-j 2 pi f_to t)`. `instant_ns` is the time of the exchange's forward frame.
    #[must_use]
    pub fn carrier_turns(&self, from: usize, to: usize, t_ns: i64, instant_ns: i64, jitter: f64) -> f64 {
        match self.scene.cfo {
            Cfo::Off => 0.0,
            Cfo::Physical => {
                let lock = self.robots[from].lock_turns - self.robots[to].lock_turns;
                self.carrier.centre_hz * self.gained_s(from, to, t_ns) + lock
            }
            Cfo::Paper(cfo) => {
                // Its equation: exp(-2 pi i CFO) one way, exp(+2 pi i CFO) the other.
                let (sign, jitter_ns) = if to < from { (-1.0, jitter * cfo.jitter_ns) } else { (1.0, 0.0) };
                let t_s = (instant_ns as f64 + jitter_ns) * 1e-9;
                let own = sign * (cfo.df_hz * t_s + cfo.c1 * libm::sin(cfo.c2 * t_s));
                // The crystals act at the frame's own time, as on real cards: turn-around jitter shows them.
                own + self.carrier.centre_hz * self.gained_s(from, to, t_ns)
            }
        }
    }

    /// Whether [`World::carrier_turns`] uses its jitter.
    #[must_use]
    pub fn carrier_jitters(&self) -> bool {
        matches!(self.scene.cfo, Cfo::Paper(cfo) if cfo.jitter_ns != 0.0)
    }

    /// The sampling time offset between two cards' grids, seconds, within half a sample.
    #[must_use]
    pub fn sampling_offset_s(&self, from: usize, to: usize, t_ns: i64) -> f64 {
        let period_s = SAMPLE_20_S * 20.0 / f64::from(self.scene.bandwidth_mhz);
        let samples = self.gained_s(from, to, t_ns) / period_s;
        (samples - samples.round_ties_even()) * period_s
    }

    /// Lead of the sender's crystal over the receiver's, seconds.
    fn gained_s(&self, from: usize, to: usize, t_ns: i64) -> f64 {
        let t_s = t_ns as f64 * 1e-9;
        let gained = |robot: usize| self.scene.robot[robot].crystal.gained_s(t_s);
        gained(from) - gained(to)
    }

    /// Every path between antenna A of `from` and an antenna of `to`. False if there is none, or no such antenna.
    pub fn paths(&self, from: usize, to: usize, antenna: usize, t_s: f64, found: &mut Vec<Path>) -> bool {
        found.clear();
        let (Some(p), Some(q)) = (self.antenna(from, 0, t_s), self.antenna(to, antenna, t_s)) else { return false };
        if self.surfaces.is_empty() {
            found.push(Path { length_m: (p - q).norm(), gain: 1.0 });
        } else {
            self.surfaces.paths(p, q, found);
        }
        if let Some(gain) = self.pattern_gain(from, to, q - p, t_s) {
            found.iter_mut().for_each(|path| path.gain *= gain);
        }
        !found.is_empty()
    }

    /// The amplitude by the patterns of both robots' antennas, if either has one; `way` is the vector between them.
    fn pattern_gain(&self, from: usize, to: usize, way: Vector3<f64>, t_s: f64) -> Option<f64> {
        let level = way.xy().norm();
        let ends = [(from, way), (to, -way)];
        let mut db = None;
        for (robot, way) in ends {
            let pattern = self.scene.robot[robot].pattern;
            if pattern != Pattern::default() && level > 0.0 {
                let ahead = heading(self.pose(robot, t_s).yaw_rad);
                let (cos, sin) =
                    ((ahead.x * way.x + ahead.y * way.y) / level, (ahead.x * way.y - ahead.y * way.x) / level);
                db = Some(db.unwrap_or(0.0) + pattern.gain_db(cos, sin));
            }
        }
        db.map(amplitude)
    }

    /// Adds a set of paths to tones; sizes are relative to free space at 1 m.
    pub fn add(&self, paths: &[Path], common: Common, tones: &mut Tones) {
        for path in paths {
            self.carrier.add(path, common, tones);
        }
    }

    /// The same at any subcarriers, by their indices and their spacing, Hz.
    pub fn add_at(&self, paths: &[Path], common: Common, at: (&[i16], f64), tones: &mut [Complex64]) {
        for path in paths {
            self.carrier.add_at(path, common, at, tones);
        }
    }

    /// The loss of free space over the first metre, dB.
    #[must_use]
    pub fn first_metre_db(&self) -> f64 {
        let turns = 2.0 * std::f64::consts::TAU / self.carrier.wavelength_m();
        20.0 * libm::log10(turns)
    }
}

/// The trajectory of a recorded motion.
fn recorded(robot: &Robot) -> Result<Option<Recorded>, Problem> {
    let RobotMotion::Recorded(motion) = &robot.motion else { return Ok(None) };
    Recorded::load(&motion.file).map(Some).map_err(|error| Problem::new(error.to_string()))
}

/// The surfaces of a scene; `None` if one has no area.
pub(super) fn surfaces(scene: &Scene) -> Option<Vec<Surface>> {
    let walls = scene.wall.iter().map(|wall| {
        let [x0, y0] = wall.from_m;
        let [x1, y1] = wall.to_m;
        let corner = Vector3::new(x0, y0, wall.bottom_m);
        let edges = [Vector3::new(x1 - x0, y1 - y0, 0.0), Vector3::new(0.0, 0.0, wall.top_m - wall.bottom_m)];
        Surface::new(corner, edges, wall.loss_db, wall.through_db)
    });
    let reflectors = scene.reflector.iter().map(|panel| {
        let edges = [Vector3::from(panel.edge_a_m), Vector3::from(panel.edge_b_m)];
        Surface::new(Vector3::from(panel.corner_m), edges, panel.loss_db, panel.through_db)
    });
    walls.chain(reflectors).collect()
}
