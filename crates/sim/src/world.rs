//! A scene made ready: places at any time, walls and reflectors, and the channel between two robots.
//!
//! Paths come from the image method \[allen-berkley1979\]: every specular path up to a given order, exactly. A set of paths
//! has its effect on each of 30 tones, or of any subcarriers.

use super::maths::{amplitude, heading, phasor};
use super::motion::{Pose, Recorded, RobotMotion, SharedWay, Track};
use super::random::{Purpose, Stream};
use super::refusal::{Problem, SceneError};
use super::scene::{Cfo, Pattern, Robot, Scene};
use csi5300::internal::lock;
use csi5300::signal::channel::{
    Channel, INDICES_20_MHZ, INDICES_40_MHZ, SPEED_OF_LIGHT_M_PER_S, SUBCARRIER_SPACING_HZ, Width,
};
use driver_iface::Mac;
use driver_iface::bfee::SUBCARRIERS;
use nalgebra::Vector3;
use num_complex::Complex64;

/// A scene made ready.
#[derive(Debug)]
pub struct World {
    scene: Scene,
    /// The carrier.
    pub carrier: Carrier,
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
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// True without surfaces: every robot hears every other one.
    pub fn is_open(&self) -> bool {
        self.surfaces.is_empty()
    }

    /// The MAC address of a robot.
    pub fn mac(&self, robot: usize) -> Mac {
        self.robots[robot].mac
    }

    /// A robot's true pose, `t_s` seconds into the scene.
    pub fn pose(&self, robot: usize, t_s: f64) -> Pose {
        self.robots[robot].track.at(t_s)
    }

    /// The way of a robot that follows a source; `None` for others.
    pub fn way(&self, robot: usize) -> Option<&SharedWay> {
        self.robots.get(robot)?.track.way()
    }

    /// The number of the frame in which a followed robot's pose is at `t_s`, 0 before its first one came; `None` for a
    /// robot that follows nobody.
    pub fn frame(&self, robot: usize, t_s: f64) -> Option<u32> {
        self.way(robot).map(|way| lock(way).at(t_s).1)
    }

    /// True if a robot never moves.
    pub fn is_still(&self, robot: usize) -> bool {
        self.robots[robot].track.is_still()
    }

    /// Where an antenna (0 = A) is, `None` if it is not connected.
    pub fn antenna(&self, robot: usize, antenna: usize, t_s: f64) -> Option<Vector3<f64>> {
        let placed = &self.robots[robot];
        let offset = (*placed.antennas_m.get(antenna)?)?;
        Some(placed.track.at(t_s).mounted(offset))
    }

    /// The phase that the carriers of sender and receiver add, turns, in a frame at `t_ns`; `jitter` is in -1..1.
    ///
    /// A sender's crystal that runs fast turns the coefficient forward: the received tone `exp(j 2 pi f_from t)` is
    /// mixed with `exp(-j 2 pi f_to t)`. `instant_ns` is the time of the exchange's forward frame.
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
    pub fn carrier_jitters(&self) -> bool {
        matches!(self.scene.cfo, Cfo::Paper(cfo) if cfo.jitter_ns != 0.0)
    }

    /// The sampling time offset between two cards' grids, seconds, within half a sample.
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

    /// The loss of free space over the first metre, dB.
    pub fn first_metre_db(&self) -> f64 {
        let wavelength_m = SPEED_OF_LIGHT_M_PER_S / self.carrier.centre_hz;
        let turns = 2.0 * std::f64::consts::TAU / wavelength_m;
        20.0 * libm::log10(turns)
    }
}

/// The trajectory of a recorded motion.
fn recorded(robot: &Robot) -> Result<Option<Recorded>, Problem> {
    let RobotMotion::Recorded(motion) = &robot.motion else { return Ok(None) };
    Recorded::load(&motion.file).map(Some).map_err(Problem::new)
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

/// Subcarriers in a record.
pub const TONES: usize = SUBCARRIERS;
/// Period of one sample at 20 MHz, seconds; at 40 MHz it is half of it.
pub const SAMPLE_20_S: f64 = 50e-9;

/// The tones of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carrier {
    /// Centre frequency, Hz.
    pub centre_hz: f64,
    /// The subcarrier indices of the 30 tones.
    pub indices: &'static [i8; TONES],
}

/// Contribution of the radios to every path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Common {
    /// Phase at the centre, turns.
    pub turns: f64,
    /// Delay, seconds. It turns subcarrier `k` by `-k 312.5 kHz delay_s` turns and does not change the centre, because
    /// the receiver mixes down before it samples.
    pub delay_s: f64,
}

impl Carrier {
    /// The carrier of a 5 GHz (or 2.4 GHz, 1 to 14) channel number, 20 MHz or 40 MHz wide.
    ///
    /// At 40 MHz the given number is that of the 40 MHz channel's centre. `None` for numbers that are no channel.
    pub fn new(channel: u16, wide: bool) -> Option<Self> {
        let centre_hz = Channel::new(channel.into(), Width::Ht20).ok()?.centre_hz();
        Some(Self { centre_hz, indices: if wide { &INDICES_40_MHZ } else { &INDICES_20_MHZ } })
    }

    /// Adds a path to `tones`: `gain / d exp(-j 2 pi (d f_k / c))` at the frequency `f_k` of each tone, with the
    /// radios' contribution. Distances are exact, without a far-field approximation; sizes are relative to free space at
    /// 1 m.
    ///
    /// Three sines and cosines a path: tone follows tone by multiplication, which costs about 30 rounding errors.
    pub fn add(&self, path: &Path, common: Common, tones: &mut [Complex64]) {
        let flight_s = path.length_m / SPEED_OF_LIGHT_M_PER_S;
        let step_turns = -SUBCARRIER_SPACING_HZ * (flight_s + common.delay_s);
        let first = self.indices[0];
        let centre_turns = common.turns - flight_s * self.centre_hz;
        let mut tone = phasor(centre_turns + f64::from(first) * step_turns) * (path.gain / path.length_m);
        let one = phasor(step_turns);
        let two = one * one;
        let four = two * two;
        let mut index = first;
        for (sum, &next) in tones.iter_mut().zip(self.indices) {
            match next - index {
                0 => {}
                1 => tone *= one,
                2 => tone *= two,
                _ => tone *= four,
            }
            index = next;
            *sum += tone;
        }
    }

    /// The same at any subcarriers, by their indices in rising order and their spacing.
    pub fn add_at(&self, path: &Path, common: Common, (indices, spacing_hz): (&[i16], f64), tones: &mut [Complex64]) {
        let flight_s = path.length_m / SPEED_OF_LIGHT_M_PER_S;
        let step_turns = -spacing_hz * (flight_s + common.delay_s);
        let centre_turns = common.turns - flight_s * self.centre_hz;
        let (one, size) = (phasor(step_turns), path.gain / path.length_m);
        let mut last: Option<(i16, Complex64)> = None;
        for (sum, &index) in tones.iter_mut().zip(indices) {
            let tone = match last {
                Some((before, tone)) if before + 1 == index => tone * one,
                _ => phasor(centre_turns + f64::from(index) * step_turns) * size,
            };
            last = Some((index, tone));
            *sum += tone;
        }
    }
}

/// A flat parallelogram that reflects and attenuates waves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    corner: Vector3<f64>,
    /// The two edges from the corner, and their dual vectors in the plane: `dual_i . edge_j` is 1 for i = j, else 0.
    duals: [Vector3<f64>; 2],
    normal: Vector3<f64>,
    /// Amplitude kept in a reflection, with the sign of one (a half turn).
    reflected: f64,
    /// Amplitude kept when passing through; 0 for an opaque surface.
    through: f64,
}

/// One way from transmitter to receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Path {
    /// Length, metres.
    pub length_m: f64,
    /// Amplitude after reflections and passages, with the sign of the reflections, without spreading (1 / length).
    pub gain: f64,
}

impl Surface {
    /// A surface from a corner and two edges, metres. `None` if they span no area.
    ///
    /// `loss_db` is lost in each reflection (which also turns the phase by half a turn, as at a good conductor);
    /// `through_db` in each passage, `None` for opaque.
    pub fn new(corner: Vector3<f64>, edges: [Vector3<f64>; 2], loss_db: f64, through_db: Option<f64>) -> Option<Self> {
        let [a, b] = edges;
        let across = a.cross(&b);
        let area2 = across.norm_squared();
        if area2 <= 1e-12 {
            return None;
        }
        Some(Self {
            corner,
            duals: [b.cross(&across) / area2, across.cross(&a) / area2],
            normal: across / area2.sqrt(),
            reflected: -amplitude(-loss_db),
            through: through_db.map_or(0.0, |db| amplitude(-db)),
        })
    }

    /// The mirror image of a point.
    fn image(&self, p: Vector3<f64>) -> Vector3<f64> {
        p - self.normal * (2.0 * self.height(p))
    }

    /// Signed distance of a point from the plane.
    fn height(&self, p: Vector3<f64>) -> f64 {
        (p - self.corner).dot(&self.normal)
    }

    /// Where the segment between two points crosses the surface, if strictly between them.
    fn crossing(&self, from: Vector3<f64>, to: Vector3<f64>) -> Option<Vector3<f64>> {
        let (h0, h1) = (self.height(from), self.height(to));
        if h0 * h1 >= 0.0 {
            return None;
        }
        let point = from + (to - from) * (h0 / (h0 - h1));
        let within = |dual: &Vector3<f64>| (0.0..=1.0).contains(&(point - self.corner).dot(dual));
        self.duals.iter().all(within).then_some(point)
    }

    /// The distance of a point from the surface, metres.
    pub fn distance_m(&self, p: Vector3<f64>) -> f64 {
        let clamped = |dual: &Vector3<f64>| (p - self.corner).dot(dual).clamp(0.0, 1.0);
        let edges = self.edges();
        let nearest = self.corner + edges[0] * clamped(&self.duals[0]) + edges[1] * clamped(&self.duals[1]);
        (p - nearest).norm()
    }

    /// True if the straight way between two points goes through the surface.
    pub fn separates(&self, from: Vector3<f64>, to: Vector3<f64>) -> bool {
        self.crossing(from, to).is_some()
    }

    /// The edges again, from their duals.
    fn edges(&self) -> [Vector3<f64>; 2] {
        let [p, q] = self.duals;
        let across = p.cross(&q);
        let area2 = across.norm_squared();
        [q.cross(&across) / area2, across.cross(&p) / area2]
    }
}

/// All surfaces of a scene.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    all: Vec<Surface>,
    /// Highest number of reflections in a path.
    order: usize,
}

impl Surfaces {
    /// The surfaces of a scene; paths have at most `order` reflections.
    pub fn new(all: Vec<Surface>, order: usize) -> Self {
        Self { all, order }
    }

    /// True if there is nothing but free space.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Finds every path between two points: the direct one first (if not blocked), then those with reflections.
    pub fn paths(&self, from: Vector3<f64>, to: Vector3<f64>, found: &mut Vec<Path>) {
        found.clear();
        let direct = self.passage(from, to, [None, None]);
        if direct != 0.0 {
            found.push(Path { length_m: (to - from).norm(), gain: direct });
        }
        if self.order > 0 && !self.all.is_empty() {
            let mut mirrors = Vec::with_capacity(self.order);
            self.reflect(from, from, to, &mut mirrors, found);
        }
    }

    /// Extends the sequence of mirrors by each surface. `image` is the image of `from` in the mirrors so far.
    fn reflect(
        &self,
        from: Vector3<f64>,
        image: Vector3<f64>,
        to: Vector3<f64>,
        mirrors: &mut Vec<(usize, Vector3<f64>)>,
        found: &mut Vec<Path>,
    ) {
        for (index, surface) in self.all.iter().enumerate() {
            if mirrors.last().is_some_and(|&(last, _)| last == index) {
                continue;
            }
            let next = surface.image(image);
            mirrors.push((index, next));
            if let Some(gain) = self.trace(from, to, mirrors) {
                found.push(Path { length_m: (to - next).norm(), gain });
            }
            if mirrors.len() < self.order {
                self.reflect(from, next, to, mirrors, found);
            }
            mirrors.pop();
        }
    }

    /// Follows a path back from the receiver over its mirrors; its gain, or `None` if it does not exist.
    fn trace(&self, from: Vector3<f64>, to: Vector3<f64>, mirrors: &[(usize, Vector3<f64>)]) -> Option<f64> {
        let (mut point, mut left, mut gain) = (to, None, 1.0);
        for &(index, image) in mirrors.iter().rev() {
            let surface = self.all.get(index)?;
            let bounce = surface.crossing(image, point)?;
            gain *= surface.reflected * self.passage(bounce, point, [Some(index), left]);
            if gain == 0.0 {
                return None;
            }
            (point, left) = (bounce, Some(index));
        }
        gain *= self.passage(from, point, [left, None]);
        (gain != 0.0).then_some(gain)
    }

    /// Amplitude after passing through the surfaces between two points, without those at its ends.
    fn passage(&self, from: Vector3<f64>, to: Vector3<f64>, on: [Option<usize>; 2]) -> f64 {
        let mut gain = 1.0;
        for (index, surface) in self.all.iter().enumerate() {
            if !on.contains(&Some(index)) && surface.separates(from, to) {
                gain *= surface.through;
                if gain == 0.0 {
                    break;
                }
            }
        }
        gain
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn channels_have_their_frequencies() {
        assert_eq!(Carrier::new(108, false).unwrap().centre_hz, 5.540e9);
        assert_eq!(Carrier::new(6, false).unwrap().centre_hz, 2.437e9);
        assert_eq!(Carrier::new(14, false).unwrap().centre_hz, 2.484e9);
        assert!(Carrier::new(20, false).is_none());
    }

    #[test]
    fn every_tone_is_the_exact_phase_at_its_own_frequency() {
        let common = Common { turns: 12_345.678, delay_s: 200e-9 };
        for wide in [false, true] {
            let carrier = Carrier::new(108, wide).unwrap();
            let mut tones = [Complex64::default(); TONES];
            let path = Path { length_m: 3.968_3, gain: -0.5 };
            carrier.add(&path, common, &mut tones);
            for (tone, &k) in tones.iter().zip(carrier.indices) {
                let hz = carrier.centre_hz + f64::from(k) * SUBCARRIER_SPACING_HZ;
                let turns = common.turns
                    - path.length_m * hz / SPEED_OF_LIGHT_M_PER_S
                    - f64::from(k) * SUBCARRIER_SPACING_HZ * common.delay_s;
                let want = phasor(turns) * (path.gain / path.length_m);
                assert!((tone - want).norm() < 1e-11, "tone {k}");
            }
        }
    }

    #[test]
    fn any_subcarriers_have_the_phase_of_their_frequency() {
        let (carrier, common) = (Carrier::new(36, true).unwrap(), Common { turns: 7.25, delay_s: 90e-9 });
        let path = Path { length_m: 5.5, gain: 0.8 };
        let indices: Vec<i16> = (-244..-2).chain(3..245).collect();
        let mut tones = vec![Complex64::default(); indices.len()];
        carrier.add_at(&path, common, (&indices, 78_125.0), &mut tones);
        for (tone, &k) in tones.iter().zip(&indices) {
            let off_hz = f64::from(k) * 78_125.0;
            let turns =
                common.turns - path.length_m * (carrier.centre_hz + off_hz) / SPEED_OF_LIGHT_M_PER_S - off_hz * 90e-9;
            assert!((tone - phasor(turns) * (path.gain / path.length_m)).norm() < 1e-9, "tone {k}");
        }
    }

    #[test]
    fn indices_step_by_at_most_the_grouping() {
        for (indices, grouping) in [(INDICES_20_MHZ, 2), (INDICES_40_MHZ, 4)] {
            assert!(indices.windows(2).all(|w| matches!(w[1] - w[0], 1 | 2 | 4) && w[1] - w[0] <= grouping));
        }
    }

    fn v(x: f64, y: f64, z: f64) -> Vector3<f64> {
        Vector3::new(x, y, z)
    }

    /// A wall of 2.5 m height between two points on the floor.
    fn wall(from: [f64; 2], to: [f64; 2], loss_db: f64, through_db: Option<f64>) -> Surface {
        let edge = v(to[0] - from[0], to[1] - from[1], 0.0);
        Surface::new(v(from[0], from[1], 0.0), [edge, v(0.0, 0.0, 2.5)], loss_db, through_db).unwrap()
    }

    fn paths(surfaces: &Surfaces, from: Vector3<f64>, to: Vector3<f64>) -> Vec<Path> {
        let mut found = Vec::new();
        surfaces.paths(from, to, &mut found);
        found
    }

    #[test]
    fn one_wall_gives_its_image() {
        let s = Surfaces::new(vec![wall([-10.0, 2.0], [10.0, 2.0], 6.0, None)], 2);
        let found = paths(&s, v(0.0, 0.0, 1.0), v(3.0, 0.0, 1.0));
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0], Path { length_m: 3.0, gain: 1.0 });
        assert!((found[1].length_m - 5.0).abs() < 1e-12, "3 along, 2 x 2 across");
        assert!((found[1].gain + 10f64.powf(-6.0 / 20.0)).abs() < 1e-12);
    }

    #[test]
    fn reflections_outside_a_panel_do_not_exist() {
        let s = Surfaces::new(vec![wall([5.0, 2.0], [10.0, 2.0], 0.0, None)], 2);
        assert_eq!(paths(&s, v(0.0, 0.0, 1.0), v(3.0, 0.0, 1.0)).len(), 1);
        // Too low: the reflection would be above the wall's 2.5 m.
        let s = Surfaces::new(vec![wall([-10.0, 2.0], [10.0, 2.0], 0.0, None)], 1);
        assert_eq!(paths(&s, v(0.0, 0.0, 3.0), v(3.0, 0.0, 3.0)).len(), 1);
    }

    #[test]
    fn a_corridor_has_two_paths_of_each_order() {
        let walls = vec![wall([-50.0, 1.0], [50.0, 1.0], 3.0, None), wall([-50.0, -2.0], [50.0, -2.0], 3.0, None)];
        let found = paths(&Surfaces::new(walls, 3), v(0.0, 0.0, 1.0), v(4.0, 0.0, 1.0));
        let mut across: Vec<f64> = found.iter().map(|p| (p.length_m * p.length_m - 16.0).sqrt()).collect();
        across.sort_by(f64::total_cmp);
        // Images at 2, 4 (order 1), 6, 6 (order 2), 8, 10 (order 3) metres across.
        for (got, want) in across.iter().zip([0.0, 2.0, 4.0, 6.0, 6.0, 8.0, 10.0]) {
            assert!((got - want).abs() < 1e-9, "{across:?}");
        }
        assert_eq!(found.len(), 7);
    }

    #[test]
    fn a_wall_blocks_or_weakens_the_direct_path() {
        let (a, b) = (v(0.0, 0.0, 1.0), v(3.0, 0.0, 1.0));
        let opaque = wall([1.0, -1.0], [1.0, 1.0], 0.0, None);
        let mirror = wall([-10.0, 2.0], [10.0, 2.0], 0.0, None);
        let found = paths(&Surfaces::new(vec![opaque, mirror], 2), a, b);
        assert!(found.iter().all(|p| p.length_m > 4.9), "only the way round is left: {found:?}");
        assert!(!found.is_empty());
        let found = paths(&Surfaces::new(vec![wall([1.0, -1.0], [1.0, 1.0], 0.0, Some(20.0))], 0), a, b);
        assert!((found[0].gain - 0.1).abs() < 1e-12);
    }

    #[test]
    fn distances_are_to_the_panel_not_to_its_plane() {
        let s = wall([0.0, 0.0], [2.0, 0.0], 0.0, None);
        assert!((s.distance_m(v(1.0, 0.5, 1.0)) - 0.5).abs() < 1e-12);
        assert!((s.distance_m(v(5.0, 4.0, 1.0)) - 5.0).abs() < 1e-12);
        assert!(Surface::new(v(0.0, 0.0, 0.0), [v(1.0, 0.0, 0.0), v(2.0, 0.0, 0.0)], 0.0, None).is_none());
    }

    proptest! {
        /// The channel is reciprocal: the same paths both ways.
        #[test]
        fn paths_are_reciprocal(a in prop::array::uniform3(0.1..3.9f64), b in prop::array::uniform3(0.1..3.9f64)) {
            let corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
            let mut walls: Vec<Surface> =
                (0..4).map(|i| wall(corners[i], corners[(i + 1) % 4], 4.0, None)).collect();
            walls.push(wall([1.0, 1.5], [2.0, 2.5], 4.0, Some(8.0)));
            let s = Surfaces::new(walls, 2);
            let (a, b) = (Vector3::from(a), Vector3::from(b));
            let sorted = |mut p: Vec<Path>| {
                p.sort_by(|x, y| x.length_m.total_cmp(&y.length_m).then(x.gain.total_cmp(&y.gain)));
                p
            };
            let (there, back) = (sorted(paths(&s, a, b)), sorted(paths(&s, b, a)));
            prop_assert_eq!(there.len(), back.len());
            for (x, y) in there.iter().zip(&back) {
                prop_assert!((x.length_m - y.length_m).abs() < 1e-9 && (x.gain - y.gain).abs() < 1e-9);
            }
        }
    }
}
