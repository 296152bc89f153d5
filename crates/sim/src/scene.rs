//! A scene: the TOML of a simulated room, and those that come with the program.
//!
//! Every effect is off by default and then costs nothing. Unknown keys are refused.

use super::crystal::Crystal;
use super::faults::Faults;
use super::motion::{Pose, RobotMotion};
use super::radio::Radio;
use super::refusal::SceneError;
use super::toml_lines::line_of;
use driver_iface::Mac;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A room, its robots and their motions.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Scene {
    /// A name for reports.
    pub name: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Length of the scene in true time, seconds.
    pub duration_s: f64,
    /// Channel number, of the centre if it is wider than 20 MHz; 108 is 5,540 MHz.
    pub channel: u16,
    /// Bandwidth, MHz: 20 or 40; of an AX210 80 and 160 too.
    pub bandwidth_mhz: u16,
    /// True time at the start of the scene, seconds since the Unix epoch.
    pub start_unix_s: i64,
    /// Highest number of reflections of a path.
    pub reflections: u8,
    /// The model of the carriers' offsets.
    #[serde(skip_serializing_if = "is_default")]
    pub cfo: Cfo,
    /// The cards that the robots have.
    #[serde(skip_serializing_if = "is_default")]
    pub card: Card,
    /// Kind of the frames, by their preamble; AX210 only, HE by default.
    pub preamble: Option<Preamble>,
    /// The layout of the records: the robots' driver.
    #[serde(skip_serializing_if = "is_default")]
    pub driver: Driver,
    /// Who sounds whom, and how often.
    pub sounding: Option<Sounding>,
    /// The radio of all robots without their own.
    #[serde(skip_serializing_if = "is_default")]
    pub radio: Radio,
    /// The robots.
    #[serde(skip_serializing_if = "is_default")]
    pub robot: Vec<Robot>,
    /// Upright walls.
    #[serde(skip_serializing_if = "is_default")]
    pub wall: Vec<Wall>,
    /// Flat reflectors of any orientation: floors, ceilings, cupboards.
    #[serde(skip_serializing_if = "is_default")]
    pub reflector: Vec<Reflector>,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            name: String::new(),
            seed: 1,
            duration_s: 0.0,
            channel: 108,
            bandwidth_mhz: 20,
            start_unix_s: 1_700_000_000,
            reflections: 0,
            cfo: Cfo::Off,
            card: Card::Intel5300,
            preamble: None,
            driver: Driver::Wsr,
            sounding: None,
            radio: Radio::default(),
            robot: Vec::new(),
            wall: Vec::new(),
            reflector: Vec::new(),
        }
    }
}

/// Carrier frequency offset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
#[doc(alias = "CFO")]
pub enum Cfo {
    /// Synthesisers agree perfectly, whatever the crystals do to the clocks.
    #[default]
    Off,
    /// Each carrier runs from its card's crystal and is evaluated at the true time of each frame.
    Physical,
    /// `df t + c1 sin(c2 t)` of \[paper\], both directions at one instant, and what the crystals add at each frame's own.
    Paper(PaperCfo),
}

/// The carrier offset of Dijkstra et al. (\[paper\] in docs/reference/references.md, the equation for CFO_ij): `df t + c1 sin(c2 t)`
/// cycles.
///
/// With their values it swings by `c1 c2` = 2 MHz, unlike any crystal: at true frame times the two directions would be
/// incoherent. So, as there, both are evaluated at one instant, the forward frame's, with a uniform difference of at
/// most `jitter_ns`. Crystals turn both directions at their own times, which leaves `2 pi f d` of a turn-around `d` in
/// the round trip.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaperCfo {
    /// Constant part, Hz.
    pub df_hz: f64,
    /// Amplitude, cycles.
    pub c1: f64,
    /// Angular rate, radians per second.
    pub c2: f64,
    /// The time difference's magnitude (epsilon_t in \[paper\]), nanoseconds.
    pub jitter_ns: f64,
}

impl Default for PaperCfo {
    fn default() -> Self {
        Self { df_hz: 10.0, c1: 10_000.0, c2: 200.0, jitter_ns: 100.0 }
    }
}

/// A card.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Card {
    /// Intel 5300.
    #[default]
    Intel5300,
    /// Intel AX210 with FeitCSI: 16 bits, all subcarriers but the pilots, a clock of 3.125 ns, two chains, no frame numbers.
    Ax210,
}

/// The kind of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Preamble {
    /// 802.11n.
    Ht,
    /// 802.11ac.
    Vht,
    /// 802.11ax.
    He,
}

/// The driver of the robots' cards.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Driver {
    /// The WSR toolbox's: records carry host time, MAC and frame number.
    #[default]
    Wsr,
    /// The original CSI tool's, with `connector_log=0x5`: each record follows a copy of its frame.
    Stock,
}

/// The sounding exchange that the room itself runs.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sounding {
    /// Rounds per second; a round is one forward and one backward frame with every other robot. `inf` is the highest
    /// rate that fits.
    pub rate_hz: f64,
    /// Names of the robots that initiate, in turns; the first robot when empty. The WSR dialect knows no turns.
    pub initiators: Vec<String>,
    /// The frames' dialect.
    pub dialect: Dialect,
    /// First round, seconds.
    pub start_s: f64,
}

impl Default for Sounding {
    fn default() -> Self {
        Self { rate_hz: 100.0, initiators: Vec::new(), dialect: Dialect::Wsr, start_s: 0.0 }
    }
}

/// The dialect of sounding frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Dialect {
    /// The WSR toolbox's: the length of a frame addresses a robot.
    #[default]
    Wsr,
    /// Ours: destination, role and number in the payload.
    Native,
}

/// One robot.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Robot {
    /// Its name, in file names too.
    pub name: String,
    /// MAC address, `"00:21:6A:53:89:D2"`. Without one: 02:53:00:00 and the robot's number.
    pub mac: Option<String>,
    /// Place at the start, metres.
    pub position_m: [f64; 3],
    /// Heading at the start, degrees from +x towards +y.
    pub yaw_deg: f64,
    /// Antenna A in the robot's frame (x forward, y left, z up), metres.
    pub antenna_m: [f64; 3],
    /// Antenna B, if connected.
    pub antenna_b_m: Option<[f64; 3]>,
    /// Antenna C, if connected.
    pub antenna_c_m: Option<[f64; 3]>,
    /// Its antennas' gain by direction.
    #[serde(skip_serializing_if = "is_default")]
    pub pattern: Pattern,
    /// How it moves.
    #[serde(skip_serializing_if = "is_default")]
    pub motion: RobotMotion,
    /// Its card's crystal.
    #[serde(skip_serializing_if = "is_default")]
    pub crystal: Crystal,
    /// Its host's clock.
    #[serde(skip_serializing_if = "is_default")]
    pub host_clock: HostClock,
    /// Its radio, where it differs from the scene's; replaces all of it.
    pub radio: Option<Radio>,
    /// Its faults.
    #[serde(skip_serializing_if = "is_default")]
    pub faults: Faults,
    /// Its odometry.
    #[serde(skip_serializing_if = "is_default")]
    pub odometry: Odometry,
    /// Frames of exactly this many bytes (with FCS) are answered by the card's driver, as the WSR driver's module
    /// parameter of this name does. For rooms with injected frames.
    pub ack_len: Option<usize>,
}

/// The antennas' gain towards the other robot, dB, by its azimuth `a` in this robot's frame (0 ahead, to the left positive):
/// `cos_db cos a + sin_db sin a + cos2_db cos 2a + sin2_db sin 2a`. Reflections arrive with the gain of the straight way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pattern {
    /// More ahead than behind.
    pub cos_db: f64,
    /// More to the left than to the right.
    pub sin_db: f64,
    /// More ahead and behind than to the sides.
    pub cos2_db: f64,
    /// More to the left ahead and to the right behind than to the other corners.
    pub sin2_db: f64,
}

impl Pattern {
    /// The gain, dB, towards a direction given by its cosine and sine in the robot's frame.
    #[must_use]
    pub fn gain_db(&self, cos: f64, sin: f64) -> f64 {
        let (cos2, sin2) = (2.0 * cos * cos - 1.0, 2.0 * sin * cos);
        self.cos_db * cos + self.sin_db * sin + self.cos2_db * cos2 + self.sin2_db * sin2
    }
}

/// A host's wall clock: `true time + offset + drift`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct HostClock {
    /// Seconds ahead of true time.
    pub offset_s: f64,
    /// Parts per million fast.
    pub drift_ppm: f64,
}

/// Odometry as a sensor. The default is perfect, at 100 Hz.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Odometry {
    /// Poses per second.
    pub rate_hz: f64,
    /// White noise of each coordinate, metres (standard deviation).
    pub noise_m: f64,
    /// White noise of the heading, degrees (standard deviation).
    pub noise_deg: f64,
    /// Metres reported per metre driven.
    pub scale: f64,
    /// Drift of the heading, degrees per second.
    pub heading_drift_deg_s: f64,
    /// Random walk of the heading, degrees per root second (standard deviation after 1 s).
    pub heading_walk_deg: f64,
    /// Share of poses that never come.
    pub drop: f64,
    /// Share of poses that come late.
    pub late: f64,
    /// How late those come, seconds.
    pub late_s: f64,
}

impl Default for Odometry {
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            noise_m: 0.0,
            noise_deg: 0.0,
            scale: 1.0,
            heading_drift_deg_s: 0.0,
            heading_walk_deg: 0.0,
            drop: 0.0,
            late: 0.0,
            late_s: 0.0,
        }
    }
}

/// An upright wall.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// One end on the floor, metres.
    pub from_m: [f64; 2],
    /// The other end.
    pub to_m: [f64; 2],
    /// Lower edge, metres.
    #[serde(default)]
    pub bottom_m: f64,
    /// Upper edge, metres.
    #[serde(default = "storey")]
    pub top_m: f64,
    /// Thickness, metres: no robot's centre may come closer than half of it. Waves see the middle plane only.
    #[serde(default = "thickness")]
    pub thickness_m: f64,
    /// Lost in a reflection, dB.
    #[serde(default = "plaster")]
    pub loss_db: f64,
    /// Lost in a passage, dB; opaque without it.
    pub through_db: Option<f64>,
}

/// A flat parallelogram.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Reflector {
    /// A corner, metres.
    pub corner_m: [f64; 3],
    /// From the corner along one edge, metres.
    pub edge_a_m: [f64; 3],
    /// From the corner along the other.
    pub edge_b_m: [f64; 3],
    /// Lost in a reflection, dB.
    #[serde(default = "plaster")]
    pub loss_db: f64,
    /// Lost in a passage, dB; opaque without it.
    pub through_db: Option<f64>,
}

fn storey() -> f64 {
    2.5
}

fn thickness() -> f64 {
    0.1
}

fn plaster() -> f64 {
    6.0
}

/// True for a value that a written scene may omit.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Scene {
    /// Parses a scene. Values are checked when a room is made; names of trajectory files are not changed.
    ///
    /// # Errors
    /// [`SceneError::Value`] with the line: no TOML, an unknown key, a value of another kind.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        toml::from_str(text).map_err(|error| SceneError::Value {
            place: String::new(),
            line: error.span().map(|span| line_of(text, span.start)),
            reason: error.message().to_owned(),
        })
    }

    /// The scene as TOML that [`Scene::parse`] reads into the same scene. Tables with default values are omitted.
    ///
    /// # Errors
    /// [`SceneError::Unwritable`] if a value has no text, as the path of a trajectory that is not UTF-8.
    pub fn to_toml(&self) -> Result<String, SceneError> {
        toml::to_string(self).map_err(|error| SceneError::Unwritable(error.to_string()))
    }

    /// The radio of a robot.
    #[must_use]
    pub(crate) fn radio_of<'a>(&'a self, robot: &'a Robot) -> &'a Radio {
        robot.radio.as_ref().unwrap_or(&self.radio)
    }

    /// The numbers of the initiating robots.
    #[must_use]
    pub fn initiators(&self) -> Vec<usize> {
        let named = self.sounding.as_ref().map_or(&[][..], |s| &s.initiators);
        let numbers: Vec<usize> =
            named.iter().filter_map(|name| self.robot.iter().position(|r| r.name == *name)).collect();
        if numbers.is_empty() { vec![0] } else { numbers }
    }
}

impl Wall {
    /// An opaque wall from the floor to 2.5 m, 10 cm thick, with a reflection loss of 6 dB; ends in metres.
    #[must_use]
    pub fn between(from_m: [f64; 2], to_m: [f64; 2]) -> Self {
        let (top_m, thickness_m, loss_db) = (storey(), thickness(), plaster());
        Self { from_m, to_m, bottom_m: 0.0, top_m, thickness_m, loss_db, through_db: None }
    }
}

impl Robot {
    /// Its pose at the start.
    #[must_use]
    pub fn start(&self) -> Pose {
        Pose { position_m: Vector3::from(self.position_m), yaw_rad: super::maths::rad(self.yaw_deg) }
    }

    /// Its MAC address; `None` if the text is none.
    #[must_use]
    pub fn mac_address(&self, number: usize) -> Option<Mac> {
        match &self.mac {
            Some(text) => text.parse().ok(),
            // A locally administered address.
            None => Some(Mac([0x02, 0x53, 0, 0, (number >> 8) as u8, number as u8])),
        }
    }
}

/// Names and texts of the built-in scenes, ready to be printed, changed and read again.
pub const BUILT_IN: [(&str, &str); 5] = [
    ("paper-circle", include_str!("../../../scenes/paper-circle.toml")),
    ("paper-line", include_str!("../../../scenes/paper-line.toml")),
    ("lab-circle", include_str!("../../../scenes/lab-circle.toml")),
    ("lab-line", include_str!("../../../scenes/lab-line.toml")),
    ("two-antennas", include_str!("../../../scenes/two-antennas.toml")),
];

impl Scene {
    /// A built-in scene by name, see [`BUILT_IN`].
    #[must_use]
    pub fn built_in(name: &str) -> Option<Self> {
        let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name)?;
        Self::from_toml(text).ok()
    }

    /// The scene of a file, or else the built-in one of that name.
    ///
    /// # Errors
    /// If there is neither, or the scene is refused.
    pub fn find(scene: &Path) -> Result<Self, SceneError> {
        // A folder with a built-in scene's name, as `simulate` makes it, is no scene.
        let built_in = || scene.to_str().and_then(Self::built_in);
        match std::fs::metadata(scene) {
            Err(_) => built_in().ok_or_else(|| SceneError::Nowhere { scene: scene.to_owned() }),
            Ok(there) if there.is_dir() => built_in().map_or_else(|| Self::load(scene), Ok),
            Ok(_) => Self::load(scene),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_scene_is_good() {
        for (name, text) in BUILT_IN {
            let scene = Scene::from_toml(text).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(scene.name, name);
            assert_eq!(Scene::from_toml(&scene.to_toml().unwrap()).unwrap(), scene);
            assert_eq!(Scene::built_in(name), Some(scene));
        }
        assert_eq!(Scene::built_in("nowhere"), None);
        assert!(Scene::find(Path::new("lab-line")).is_ok());
        let nowhere = Scene::find(Path::new("nowhere")).unwrap_err();
        let words = "there is no file nowhere, and no built-in scene of that name: paper-circle, paper-line, lab-circle, lab-line, two-antennas";
        assert_eq!(nowhere.of_file(Path::new("nowhere")), words);
    }
}
