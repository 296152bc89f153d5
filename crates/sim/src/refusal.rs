//! Why a scene is refused, and its place: invalid values, impossible places of robots, soundings that do not fit. The only
//! way in for scenes from files.

use super::faults::Faults;
use super::motion::RobotMotion;
use super::radio::{AntennaOrder, Radio, TurnAround};
use super::scene::{Card, Dialect, Driver, HostClock, Preamble, Robot, Scene};
use super::sounder::request;
use super::toml_lines::TomlLines;
use super::world::{Carrier, World, surfaces};
use csi5300::signal::channel::Channel;
use nalgebra::Vector3;
use std::fmt;
use std::io::Read;
use std::path::{Path, PathBuf};
use toml::Value;

/// Why a scene was refused.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// Its file could not be read.
    #[error("cannot read {}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// Neither a file nor a built-in scene has the name.
    #[error("there is no file {}, and no built-in scene of that name: {}", scene.display(), super::BUILT_IN.map(|own| own.0).join(", "))]
    Nowhere {
        /// The name.
        scene: PathBuf,
    },
    /// It is not TOML or not a scene (an unknown key, a value of another type), a value is invalid, or robots are at impossible
    /// places.
    #[error("{}{reason}", at(*line))]
    Value {
        /// The way to the value from the scene's root, `robot[1].faults.loss`; empty where TOML's reader refused it.
        place: String,
        /// Line of the text, from 1; `None` for a scene without a text.
        line: Option<usize>,
        /// The problem, and valid values.
        reason: String,
    },
    /// A value has no text in TOML: what its writer said.
    #[error("the scene cannot be written: {0}")]
    Unwritable(String),
}

/// The line of a text, before what is wrong with it.
fn at(line: Option<usize>) -> String {
    line.map_or_else(String::new, |line| format!("line {line}: "))
}

impl SceneError {
    /// Line of the text, from 1, where it is known.
    #[must_use]
    pub fn line(&self) -> Option<usize> {
        match self {
            Self::Value { line, .. } => *line,
            Self::Io { .. } | Self::Nowhere { .. } | Self::Unwritable(_) => None,
        }
    }

    /// Why a scene was refused, with the name of its file, once.
    #[must_use]
    pub fn of_file(&self, file: &Path) -> String {
        match self {
            Self::Io { .. } | Self::Nowhere { .. } => self.to_string(),
            _ => format!("{}: {self}", file.display()),
        }
    }

    /// True if the scene is readable but invalid.
    #[must_use]
    pub fn is_of_text(&self) -> bool {
        matches!(self, Self::Value { .. })
    }

    /// The same error with its line in the text.
    #[must_use]
    pub fn locate(self, text: &str) -> Self {
        match self {
            Self::Value { place, line: None, reason } if !place.is_empty() => {
                let steps = place.split(['.', '[']).map(|step| step.trim_end_matches(']'));
                let line = TomlLines::new(text).line(steps);
                Self::Value { place, line, reason }
            }
            other => other,
        }
    }
}

/// A problem and its place so far: outer tables add their names later.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Problem {
    place: String,
    reason: String,
}

pub(crate) type Checked = Result<(), Problem>;

impl Problem {
    pub(crate) fn new(reason: impl Into<String>) -> Self {
        Self { place: String::new(), reason: reason.into() }
    }

    /// The same problem, one level further out.
    pub(crate) fn key(mut self, key: &str) -> Self {
        let dot = if self.place.is_empty() { "" } else { "." };
        self.place = format!("{key}{dot}{}", self.place);
        self
    }

    /// The same problem of a table in an array of tables.
    pub(crate) fn item(self, key: &str, index: usize) -> Self {
        self.key(&format!("{key}[{index}]"))
    }
}

impl From<Problem> for SceneError {
    fn from(problem: Problem) -> Self {
        Self::Value { place: problem.place, line: None, reason: problem.reason }
    }
}

/// The problems of a table, which has this key.
fn table(key: &str, check: impl FnOnce() -> Checked) -> Checked {
    check().map_err(|problem| problem.key(key))
}

/// Refuses a value unless `ok`.
fn ensure(ok: bool, key: &str, reason: impl fmt::Display) -> Checked {
    if ok { Ok(()) } else { Err(Problem::new(format!("{key} {reason}")).key(key)) }
}

/// Largest value of any unit: products stay finite.
const LARGEST: f64 = 1e9;
/// Smallest divisor.
const SMALLEST: f64 = 1e-9;
/// Limit of rounds and of poses a second: more than a card or an encoder delivers.
const FASTEST_HZ: f64 = 100_000.0;

/// Lowest and highest value of the numbers whose way ends so; of several, the first counts. All others are from 0 to [`LARGEST`].
const RANGES: [(&str, f64, f64); 13] = [
    // A year.
    ("scene.duration_s", SMALLEST, 31_536_000.0),
    // A day: the steps of 10 ms are in memory.
    ("random_walk.duration_s", SMALLEST, 86_400.0),
    ("odometry.rate_hz", SMALLEST, FASTEST_HZ),
    ("sounding.rate_hz", SMALLEST, f64::INFINITY),
    ("duration_s warm_up_s wander_period_s stray_s within_m waypoints.speed_m_s", SMALLEST, LARGEST),
    ("scale lsb_at_1m target_lsb", SMALLEST, LARGEST),
    ("loss duplicate retry driver_drop drop late share tail", 0.0, 1.0),
    // Ratios of powers, and their deviations.
    ("filter_db tx_power_dbm rssi_db snr_db floor_dbm", -400.0, 400.0),
    ("lsb_std_db agc_std_db rssi_std_db", 0.0, 400.0),
    ("cos_db sin_db cos2_db sin2_db", -60.0, 60.0),
    // Crystals are good to some 20 ppm.
    ("offset_ppm drift_ppm_per_s warm_up_ppm wander_ppm drift_ppm", -1e3, 1e3),
    ("offset_s", -1e8, 1e8),
    (
        "position_m yaw_deg antenna_m antenna_b_m antenna_c_m turns angle_deg rise_m points_m origin_m origin_yaw_deg \
         turning_deg_s heading_drift_deg_s df_hz c1 c2 delay_ns chain_deg tail_us far.us late.us from_m to_m bottom_m top_m \
         corner_m edge_a_m edge_b_m",
        -LARGEST,
        LARGEST,
    ),
];

/// Refuses numbers out of their ranges. `way` is the place from `scene` on, `keys` the same without indices.
fn check_numbers(value: &Value, way: &str, keys: &str) -> Checked {
    let number = match value {
        Value::Float(number) => *number,
        Value::Array(items) => {
            let mut items = items.iter().enumerate();
            return items.try_for_each(|(index, item)| check_numbers(item, &format!("{way}[{index}]"), keys));
        }
        Value::Table(table) => {
            let mut items = table.iter();
            return items
                .try_for_each(|(key, item)| check_numbers(item, &format!("{way}.{key}"), &format!("{keys}.{key}")));
        }
        _ => return Ok(()),
    };
    let is_own = |end: &str| keys.strip_suffix(end).is_some_and(|front| front.is_empty() || front.ends_with('.'));
    let own = RANGES.iter().find(|(ends, ..)| ends.split_whitespace().any(is_own));
    let (low, high) = own.map_or((0.0, LARGEST), |(_, low, high)| (*low, *high));
    if (low..=high).contains(&number) {
        return Ok(());
    }
    let key = keys.rsplit('.').next().unwrap_or(keys);
    let reason = format!("{key} is {number}; it must be from {low} to {high}");
    Err(Problem::new(reason).key(way.trim_start_matches("scene.")))
}

impl Scene {
    /// Checks every value and its relation to others; `check` has the rest.
    pub(crate) fn check_values(&self) -> Checked {
        self.check_all().map_err(|problem| {
            let own = |(number, _): &(usize, &Robot)| problem.place.starts_with(&format!("robot[{number}]"));
            let Some((number, robot)) = self.robot.iter().enumerate().find(own) else { return problem };
            let name = match robot.name.as_str() {
                "" => format!("robot {}", number + 1),
                name => name.escape_debug().to_string(),
            };
            Problem { reason: format!("{name}: {}", problem.reason), ..problem }
        })
    }

    fn check_all(&self) -> Checked {
        // Without what may have no text in TOML: integers beyond 2^63 (a queue without a limit), and paths that are no UTF-8.
        let mut scene = Self { seed: 0, ..self.clone() };
        for robot in &mut scene.robot {
            (robot.faults.queue_records, robot.crystal.clock_start_us, robot.ack_len) = (0, 0, None);
            if let RobotMotion::Recorded(motion) = &mut robot.motion {
                motion.file = PathBuf::new();
            }
        }
        let values = Value::try_from(scene).map_err(|error| Problem::new(error.to_string()))?;
        check_numbers(&values, "scene", "scene")?;
        let most_mhz = match (self.card, self.preamble) {
            (Card::Intel5300, _) | (_, Some(Preamble::Ht)) => 40,
            _ => 160,
        };
        let is_width = matches!(self.bandwidth_mhz, 20 | 40 | 80 | 160) && self.bandwidth_mhz <= most_mhz;
        let widths = if most_mhz == 40 { "20 and 40" } else { "20, 40, 80 and 160" };
        ensure(is_width, "bandwidth_mhz", format!("is {}; the card has {widths}", self.bandwidth_mhz))?;
        // The number of a wider channel is that of its centre, which is no channel of 20 MHz.
        let is_assigned = self.bandwidth_mhz > 20 || self.channel.to_string().parse::<Channel>().is_ok();
        let has_carrier = Carrier::new(self.channel, self.bandwidth_mhz == 40).is_some();
        let channels = "channels are 1 to 14, 36, 40, .. 64, 100, 104, .. 144 and 149, 153, .. 177";
        ensure(is_assigned && has_carrier, "channel", format!("is {}; {channels}", self.channel))?;
        ensure(self.reflections <= 4, "reflections", format!("is {}; 4 is the most", self.reflections))?;
        let times = format!(
            "is {}, and the scene lasts {} s; records hold seconds from 0 to 4,294,967,295",
            self.start_unix_s, self.duration_s
        );
        ensure(self.host_times_fit(&HostClock::default()), "start_unix_s", times)?;
        table("radio", || check_radio(&self.radio))?;
        ensure(!self.robot.is_empty(), "robot", "is missing: a scene needs at least one [[robot]]")?;
        for (number, robot) in self.robot.iter().enumerate() {
            self.check_robot(number, robot).map_err(|problem| problem.item("robot", number))?;
        }
        self.check_card()?;
        self.check_sounding()?;
        self.check_surfaces()
    }

    /// Refuses keys of the other card.
    fn check_card(&self) -> Checked {
        if self.card == Card::Intel5300 {
            return ensure(self.preamble.is_none(), "preamble", "is of an AX210: a 5300 sends HT");
        }
        ensure(self.driver == Driver::Wsr, "driver", "is of a 5300: an AX210 has FeitCSI's")?;
        let radio = |radio: &Radio| {
            let of_5300 = "is of a 5300: an AX210 has no";
            let filter = format!("{of_5300} filter of 30 subcarriers");
            ensure(radio.filter_db.is_none(), "filter_db", filter)?;
            ensure(radio.antenna_order == AntennaOrder::Fixed, "antenna_order", format!("{of_5300} order by RSSI"))
        };
        table("radio", || radio(&self.radio))?;
        for (number, robot) in self.robot.iter().enumerate() {
            let check = || {
                ensure(robot.antenna_c_m.is_none(), "antenna_c_m", "is a third: an AX210 has two")?;
                let of_5300 = "has faults of a 5300's records, which an AX210 does not write";
                ensure(robot.faults.card.is_empty(), "faults", of_5300)?;
                table("radio", || robot.radio.as_ref().map_or(Ok(()), radio))
            };
            check().map_err(|p: Problem| p.item("robot", number))?;
        }
        Ok(())
    }

    /// True if records can hold the host's time from the start of the scene to its end.
    fn host_times_fit(&self, clock: &HostClock) -> bool {
        let held = 0.0..=f64::from(u32::MAX);
        let begins_s = self.start_unix_s as f64 + clock.offset_s;
        let ends_s = begins_s + self.duration_s * (1.0 + clock.drift_ppm * 1e-6);
        held.contains(&begins_s) && held.contains(&ends_s)
    }

    fn check_robot(&self, number: usize, robot: &Robot) -> Checked {
        ensure(!robot.name.is_empty(), "name", "is missing")?;
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        ensure(robot.name.chars().all(plain), "name", "goes into file names: only letters, digits, - and _")?;
        let mac = robot.mac_address(number);
        ensure(mac.is_some(), "mac", "is no MAC address; one looks like 00:21:6A:53:89:D2")?;
        // Readers take what a group address seems to send for another program's frames.
        let sends = self.driver == Driver::Wsr || mac.is_none_or(|mac| !mac.is_group());
        let group = "is a group address, of which the stock layout gives no frame numbers: the first byte must be even";
        ensure(sends, "mac", group)?;
        let lost = robot.faults.card.iter().find(|fault| self.driver == Driver::Stock && fault.is_of_wsr());
        let of_wsr = "changes host time, sender or number, which records of the stock layout do not hold";
        ensure(
            lost.is_none(),
            "faults",
            format!("has {}, which {of_wsr}", lost.map_or(String::new(), |fault| fault.name())),
        )?;
        for (other_number, other) in self.robot.iter().take(number).enumerate() {
            ensure(other.name != robot.name, "name", "is taken: two robots cannot share one")?;
            let also = format!("is also that of {}: pairs are told apart by MAC", other.name);
            ensure(other.mac_address(other_number) != mac, "mac", also)?;
        }
        if let RobotMotion::Waypoints(motion) = &robot.motion {
            let points = || ensure(!motion.points_m.is_empty(), "points_m", "has no points");
            table("motion", || table("waypoints", points))?;
        }
        let times = format!(
            "is {} s ahead of a scene that begins at {} s and lasts {} s; records hold seconds from 0 to 4,294,967,295",
            robot.host_clock.offset_s, self.start_unix_s, self.duration_s
        );
        ensure(self.host_times_fit(&robot.host_clock), "host_clock", times)?;
        if let Some(radio) = &robot.radio {
            table("radio", || check_radio(radio))?;
        }
        table("faults", || check_faults(&robot.faults))
    }

    fn check_sounding(&self) -> Checked {
        let Some(sounding) = &self.sounding else { return Ok(()) };
        table("sounding", || {
            // Infinity is the highest rate that fits.
            let fits = sounding.rate_hz <= FASTEST_HZ || sounding.rate_hz == f64::INFINITY;
            ensure(fits, "rate_hz", format!("is {}; {FASTEST_HZ} is the most", sounding.rate_hz))?;
            ensure(self.robot.len() >= 2, "rate_hz", "needs two robots at least")?;
            for (number, name) in sounding.initiators.iter().enumerate() {
                let is_robot = self.robot.iter().any(|robot| robot.name == *name);
                ensure(is_robot, "initiators", format!("has no robot {name:?}"))?;
                let twice = sounding.initiators[..number].contains(name);
                ensure(!twice, "initiators", format!("names {name:?} twice"))?;
            }
            let takes_turns = sounding.dialect == Dialect::Native || sounding.initiators.len() <= 1;
            ensure(takes_turns, "initiators", "take turns, which only the native dialect knows")
        })
    }

    fn check_surfaces(&self) -> Checked {
        for (index, wall) in self.wall.iter().enumerate() {
            let long = ensure(wall.from_m != wall.to_m, "to_m", "is where the wall begins");
            let high = || ensure(wall.top_m > wall.bottom_m, "top_m", "is not above bottom_m");
            long.and_then(|()| high()).map_err(|problem| problem.item("wall", index))?;
        }
        for (index, panel) in self.reflector.iter().enumerate() {
            let area = Vector3::from(panel.edge_a_m).cross(&Vector3::from(panel.edge_b_m)).norm();
            let wide = ensure(area > 1e-6, "edge_b_m", "spans no area with edge_a_m");
            wide.map_err(|problem| problem.item("reflector", index))?;
        }
        Ok(())
    }
}

fn check_radio(radio: &Radio) -> Checked {
    ensure((1..=3).contains(&radio.chains), "chains", format!("is {}; the card has 1 to 3", radio.chains))?;
    ensure(radio.mcs <= 7, "mcs", format!("is {}; one stream has 0 to 7", radio.mcs))?;
    let turn @ TurnAround { min_us, median_us, max_us, .. } = &radio.turn_around;
    let ordered = min_us <= median_us && median_us <= max_us;
    let order = format!("has min_us {min_us}, median_us {median_us}, max_us {max_us}: not in order");
    ensure(ordered, "turn_around", order)?;
    let all = turn.groups().iter().map(|group| group.share).sum::<f64>();
    ensure(all <= 1.0, "turn_around", format!("has groups away from the core of {all} in all; more than all"))
}

fn check_faults(faults: &Faults) -> Checked {
    ensure(faults.queue_records > 0, "queue_records", "is 0: nothing would ever arrive")?;
    let (stall_s, every_s) = (faults.stall_s, faults.stall_every_s);
    let stalled = format!(
        "is {stall_s}, in whole microseconds not less than stall_every_s, {every_s}: the listener would never go on"
    );
    ensure(faults.goes_on_after_stalls(), "stall_s", stalled)
}

/// Interval and limit of checked places of a path, seconds.
const STEP_S: f64 = 0.05;
const STEPS: f64 = 20_000.0;

/// Checks a scene as a whole: the sounding fits, and robots stay outside walls.
///
/// # Errors
/// [`SceneError::Value`] with the place in the scene.
pub(crate) fn check(world: &World) -> Result<(), SceneError> {
    check_rate(world.scene())?;
    check_ways(world)?;
    Ok(check_places(world)?)
}

/// The rounds asked for fit into the time there is.
fn check_rate(scene: &Scene) -> Checked {
    let Some(sounding) = &scene.sounding else { return Ok(()) };
    request(scene, sounding).map(|_| ()).map_err(|error| Problem::new(error.to_string()).key("rate_hz").key("sounding"))
}

/// Robots neither begin inside walls nor drive into or through them.
fn check_ways(world: &World) -> Checked {
    let scene = world.scene();
    let walls = surfaces(scene).unwrap_or_default();
    let all_steps = (scene.duration_s / STEP_S).ceil().min(STEPS) as usize;
    for (index, robot) in scene.robot.iter().enumerate() {
        let steps = if world.is_still(index) || walls.is_empty() { 0 } else { all_steps };
        let mut before = world.pose(index, 0.0).position_m;
        for step in 0..=steps {
            let t_s = if steps == 0 { 0.0 } else { scene.duration_s * step as f64 / steps as f64 };
            let here = world.pose(index, t_s).position_m;
            for (wall, surface) in scene.wall.iter().zip(&walls) {
                let inside = surface.distance_m(here) <= 0.5 * wall.thickness_m;
                if inside || surface.separates(before, here) {
                    let when = if step == 0 { "is".to_owned() } else { format!("drives, after {t_s:.1} s,") };
                    let ([x0, y0], [x1, y1]) = (wall.from_m, wall.to_m);
                    let reason = format!("{} {when} inside the wall from ({x0}, {y0}) to ({x1}, {y1})", robot.name);
                    let key = if step == 0 { "position_m" } else { "motion" };
                    return Err(Problem::new(reason).key(key).item("robot", index));
                }
            }
            before = here;
        }
    }
    Ok(())
}

/// Two things closer than this, metres, are at the same place.
const SAME_PLACE_M: f64 = 0.01;

/// Refuses robots that start at one place, and antennas at one place on robots that stay: nothing could be measured.
/// Robots that meet later are counted.
fn check_places(world: &World) -> Checked {
    let robots = &world.scene().robot;
    for (index, robot) in robots.iter().enumerate() {
        for (other, state) in robots.iter().enumerate().take(index) {
            let apart = world.pose(index, 0.0).position_m - world.pose(other, 0.0).position_m;
            if apart.norm() < SAME_PLACE_M {
                let reason = format!("{} is where {} is", robot.name, state.name);
                return Err(Problem::new(reason).key("position_m").item("robot", index));
            }
            let stay = world.is_still(index) && world.is_still(other);
            if stay && (antennas_meet(world, index, other) || antennas_meet(world, other, index)) {
                let reason =
                    format!("an antenna of {} is where one of {} is, and both stay there", robot.name, state.name);
                return Err(Problem::new(reason).key("antenna_m").item("robot", index));
            }
        }
    }
    Ok(())
}

/// True if one robot's sending antenna is at the place of another's receiving antenna.
fn antennas_meet(world: &World, from: usize, to: usize) -> bool {
    let scene = world.scene();
    let chains = scene.robot.get(to).map_or(0, |robot| usize::from(scene.radio_of(robot).chains));
    let sends = world.antenna(from, 0, 0.0);
    let receive = (0..chains).filter_map(|antenna| world.antenna(to, antenna, 0.0));
    sends.is_some_and(|sends| receive.into_iter().any(|receives| (sends - receives).norm() < SAME_PLACE_M))
}

/// Bytes of a scene's file at most.
const LONGEST: u64 = 16 << 20;

impl Scene {
    /// Reads and checks a scene's text, with the lines of what is refused. Trajectory files are relative to the current
    /// folder.
    ///
    /// # Errors
    /// [`SceneError`] with the line and the reason: unknown keys, values out of range, robots inside walls, ...
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        Self::read(text, Path::new(""))
    }

    /// As [`Scene::from_toml`]; trajectory files are relative to `folder`, and the scene contains that path.
    ///
    /// # Errors
    /// As [`Scene::from_toml`].
    pub fn read(text: &str, folder: &Path) -> Result<Self, SceneError> {
        let mut scene = Self::parse(text)?;
        for robot in &mut scene.robot {
            if let RobotMotion::Recorded(motion) = &mut robot.motion {
                motion.file = folder.join(&motion.file);
            }
        }
        let checked = World::new(&scene).and_then(|world| check(&world));
        checked.map_err(|error| error.locate(text))?;
        Ok(scene)
    }

    /// Reads and checks a scene file.
    ///
    /// # Errors
    /// As [`Scene::from_toml`], and when the file cannot be read.
    pub fn load(file: &Path) -> Result<Self, SceneError> {
        let io = |source| SceneError::Io { file: file.to_owned(), source };
        let mut text = String::new();
        std::fs::File::open(file).map_err(io)?.take(LONGEST + 1).read_to_string(&mut text).map_err(io)?;
        if text.len() as u64 > LONGEST {
            return Err(io(std::io::Error::other(format!(
                "it is longer than {} MiB, which no scene is",
                LONGEST >> 20
            ))));
        }
        Self::read(&text, file.parent().unwrap_or(Path::new("")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CardFault;
    use crate::crystal::Crystal;
    use crate::motion::{Arc, Circle, FollowedMotion, Helix, Line, RandomWalk, RecordedMotion, Square, Waypoints};
    use crate::radio::{Agc, DelayGroup, FixedGain, Gain, Noise, Stray};
    use crate::scene::{Cfo, Odometry, PaperCfo, Pattern, Reflector, Sounding, Wall};
    use proptest::prelude::*;

    const GOOD: &str = r#"duration_s = 10.0
seed = 3
reflections = 1
[cfo.paper]
df_hz = 10
[[robot]]
name = "rx"
mac = "00:21:6A:53:89:D2"
motion.circle = { radius_m = 0.3, duration_s = 10.0 }
[[robot]]
name = "tx"
position_m = [-3.858, 0.929, 0.0]
[[wall]]
from_m = [-5.0, 3.0]
to_m = [5.0, 3.0]
"#;

    #[test]
    fn a_scene_that_no_text_can_hold_is_checked_too() {
        let mut scene = Scene::from_toml(GOOD).unwrap();
        scene.seed = u64::MAX;
        (scene.robot[1].faults.queue_records, scene.robot[1].crystal.clock_start_us) = (usize::MAX, u64::MAX);
        assert_eq!(scene.check_values(), Ok(()));
        scene.robot[1].odometry.late_s = f64::NAN;
        let place = scene.check_values().unwrap_err().place;
        assert_eq!(place, "robot[1].odometry.late_s");
    }

    #[test]
    fn a_good_scene_is_read() {
        let scene = Scene::from_toml(GOOD).unwrap();
        assert_eq!(scene.robot.len(), 2);
        assert_eq!(scene.robot[1].mac_address(1).unwrap().0, [2, 0x53, 0, 0, 0, 1]);
        assert!(matches!(scene.cfo, Cfo::Paper(c) if c.c1 == 10_000.0 && c.df_hz == 10.0));
    }

    /// Bad scenes, one a line: the line that is refused, a word of the reason, and what of the good scene is replaced by what.
    const BAD: &str = r#"
3 | noise_free | reflections = 1 | noise_free = true
1 | duration_s is -1; it must be from 0.000000001 to 31536000 | duration_s = 10.0\nseed | duration_s = -1.0\nseed
1 | to 31536000 | duration_s = 10.0\nseed | duration_s = 1e12\nseed
12 | tx: rate_hz is 1000000000000; it must be from 0.000000001 to 100000 | name = "tx" | name = "tx"\nodometry.rate_hz = 1e12
2 | channels are | seed = 3 | channel = 20
9 | radius_m is -0.3 | radius_m = 0.3, | radius_m = -0.3,
9 | colour | radius_m = 0.3, | radius_m = 0.3, colour = 1,
12 | is also that of rx | name = "tx" | name = "tx"\nmac = "00:21:6a:53:89:d2"
8 | no MAC address | mac = "00:21:6A:53:89:D2" | mac = "00:21:6A:53:89"
8 | is a group address | mac = "00:21:6A:53:89:D2" | mac = "01:23:45:67:89:AB" | seed = 3 | driver = "stock"
12 | tx: faults has no_tail, which changes | name = "tx" | name = "tx"\nfaults.card = ["no_tail"] | seed = 3 | driver = "stock"
12 | inside the wall | [-3.858, 0.929, 0.0] | [-3.858, 2.97, 0.0]
12 | tx is where rx is | [-3.858, 0.929, 0.0] | [0.0, 0.0, 0.0]
9 | drives, after | radius_m = 0.3, | radius_m = 1.6,
14 | x | name = "tx" | name = "tx"\n[robot.faults]\nloss = 1.5\n[robot.x]
12 | loss is 1.5; it must be from 0 to 1 | name = "tx" | name = "tx"\nfaults.loss = 1.5
12 | never go on | name = "tx" | name = "tx"\nfaults = { stall_every_s = 1.0, stall_s = 1.0 }
# Both are 2 us on the clock of the room.
12 | never go on | name = "tx" | name = "tx"\nfaults = { stall_every_s = 0.000002, stall_s = 0.0000016 }
2 | lasts 10 s; records hold | seed = 3 | start_unix_s = 4294967294
2 | is -1 | seed = 3 | start_unix_s = -1
12 | is -9 s ahead of a scene that begins at 5 s | name = "tx" | name = "tx"\nhost_clock.offset_s = -9.0 | seed = 3 | start_unix_s = 5
12 | to 86400 | name = "tx" | name = "tx"\nmotion.random_walk = { speed_m_s = 1.0, duration_s = 1e9 }
12 | an antenna of tx is where one of rx is | motion.circle = { radius_m = 0.3, duration_s = 10.0 } | antenna_m = [-3.858, 0.929, 0.2] | name = "tx" | name = "tx"\nantenna_m = [0.0, 0.0, 0.2]
15 | where the wall begins | to_m = [5.0, 3.0] | to_m = [-5.0, 3.0]
16 | top_m is inf; it must be from -1000000000 | to_m = [5.0, 3.0] | to_m = [5.0, 3.0]\ntop_m = inf
9 | from 0.000000001 to | duration_s = 10.0 } | duration_s = 1e-300 }
2 | share is 2; it must be from 0 to 1 | seed = 3 | radio.send_delay = { share = 2.0 }
2 | length 2 | seed = 3 | radio.filter_db = [0.0, 1.0]
12 | cos_db is 70; it must be from -60 to 60 | name = "tx" | name = "tx"\npattern = { cos_db = 70.0 }
9 | stray_m is -0.1 | circle = { radius_m = 0.3, duration_s = 10.0 } | recorded = { file = "t", stray_m = -0.1 }
# What is missing, and what is too much.
5 | do not fit | [cfo.paper] | [sounding]\nrate_hz = 90000.0\n[cfo.paper]
5 | rate_hz is -5 | [cfo.paper] | [sounding]\nrate_hz = -5.0\n[cfo.paper]
5 | no robot "me" | [cfo.paper] | [sounding]\ninitiators = ["me"]\n[cfo.paper]
5 | names "rx" twice | [cfo.paper] | [sounding]\ninitiators = ["rx", "tx", "rx"]\n[cfo.paper]
"#;

    #[test]
    fn bad_scenes_are_refused_with_line_and_reason() {
        let cases = BAD.lines().filter(|case| !case.is_empty() && !case.starts_with('#'));
        assert_eq!(cases.clone().count(), 34);
        for case in cases {
            let columns: Vec<String> = case.split(" | ").map(|column| column.replace("\\n", "\n")).collect();
            let (changes, []) = columns[2..].as_chunks::<2>() else { panic!("{case}") };
            let text = changes.iter().fold(GOOD.to_owned(), |text, [from, to]| {
                assert!(text.contains(from), "{case}");
                text.replace(from, to)
            });
            let error = Scene::from_toml(&text).unwrap_err();
            assert_eq!(error.line(), columns[0].parse().ok(), "{error}\n{text}");
            assert!(error.to_string().contains(&columns[1]), "{error} does not say {:?}", columns[1]);
        }
        assert!(Scene::from_toml("duration_s = 1.0").unwrap_err().to_string().contains("[[robot]]"));
    }

    /// Numbers that may be negative, by their last names.
    const SIGNED: &str = "position_m yaw_deg antenna_m antenna_b_m antenna_c_m cos_db sin_db cos2_db sin2_db offset_ppm \
        drift_ppm_per_s warm_up_ppm wander_ppm offset_s drift_ppm heading_drift_deg_s delay_ns chain_deg \
        filter_db tx_power_dbm snr_db floor_dbm rssi_db tail_us from_m to_m bottom_m corner_m edge_a_m \
        edge_b_m turns angle_deg rise_m points_m origin_m origin_yaw_deg turning_deg_s df_hz";
    /// The same, for names that occur in several tables.
    const SIGNED_WAYS: [&str; 4] = ["paper.c1", "paper.c2", "far.us", "late.us"];

    fn radio(gain: Gain, noise: Noise) -> Radio {
        let group = DelayGroup { share: 0.1, us: 30.0, spread_us: 2.0 };
        Radio {
            noise,
            phase_noise_rad: 0.1,
            delay_ns: 200.0,
            delay_std_ns: 20.0,
            sampling_offset: true,
            filter_db: Some([0.5; 30]),
            gain,
            tx_power_dbm: 14.0,
            chains: 2,
            chain_deg: [40.0, -50.0],
            chain_flips: true,
            chain_noise_rad: 0.2,
            stray_b: Stray { lsb: 1.0, rssi_db: 3.0, rssi_std_db: 0.5 },
            stray_c: Stray { lsb: 2.0, rssi_db: 4.0, rssi_std_db: 0.5 },
            antenna_order: AntennaOrder::ByRssi,
            mcs: 1,
            turn_around: TurnAround {
                median_us: 220.0,
                spread_us: 5.0,
                tail: 0.1,
                tail_us: -90.0,
                tail_spread_us: 4.0,
                far: group,
                late: group,
                tail_run: 2.0,
                min_us: 140.0,
                max_us: 320.0,
            },
            send_jitter_us: 40.0,
            send_delay: group,
            host_latency_us: 90.0,
            host_latency_std_us: 9.0,
        }
    }

    fn robot(number: usize, motion: RobotMotion) -> Robot {
        Robot {
            name: format!("r{number}"),
            mac: None,
            position_m: [10.0 * (number + 1) as f64, 1.0, 0.5],
            yaw_deg: 10.0,
            antenna_m: [0.1, 0.0, 0.2],
            antenna_b_m: Some([0.2, 0.0, 0.2]),
            antenna_c_m: Some([0.3, 0.0, 0.2]),
            pattern: Pattern { cos_db: 1.0, sin_db: 0.5, cos2_db: 0.3, sin2_db: 0.2 },
            motion,
            crystal: Crystal {
                offset_ppm: 1.0,
                drift_ppm_per_s: 0.1,
                warm_up_ppm: 0.5,
                warm_up_s: 20.0,
                wander_ppm: 0.1,
                wander_period_s: 30.0,
                clock_start_us: 7,
            },
            host_clock: HostClock { offset_s: 2.0, drift_ppm: 3.0 },
            radio: Some(radio(Gain::Fixed(FixedGain { lsb_at_1m: 200.0, agc_db: 20 }), Noise::FloorDbm(-92.0))),
            faults: Faults {
                loss: 0.1,
                duplicate: 0.1,
                retry: 0.1,
                driver_drop: 0.1,
                queue_records: 99,
                stall_every_s: 5.0,
                stall_s: 0.1,
                restart_at_s: vec![8.0],
                restart_s: 0.5,
                killed: true,
                card: vec![CardFault::NoGain],
            },
            odometry: Odometry {
                rate_hz: 50.0,
                noise_m: 0.01,
                noise_deg: 0.1,
                scale: 1.01,
                heading_drift_deg_s: 0.1,
                heading_walk_deg: 0.1,
                drop: 0.1,
                late: 0.1,
                late_s: 0.1,
            },
            ack_len: Some(57),
        }
    }

    /// A scene with every possible number and robots of all motions. It names all fields, so that a new one does not
    /// compile without a line here.
    fn full(trajectory: &Path) -> Scene {
        let (start_s, duration_s, radius_m, turns) = (0.1, 5.0, 1.0, 2.0);
        let motions = [
            RobotMotion::Line(Line { length_m: 2.0, duration_s, start_s }),
            RobotMotion::Circle(Circle { radius_m, duration_s, turns, start_s }),
            RobotMotion::Arc(Arc { radius_m, angle_deg: 45.0, duration_s, start_s }),
            RobotMotion::Square(Square { side_m: 1.0, duration_s, turns, start_s }),
            RobotMotion::Helix(Helix { radius_m, rise_m: 0.1, duration_s, turns, start_s }),
            RobotMotion::FigureEight(Circle { radius_m, duration_s, turns, start_s }),
            RobotMotion::RandomWalk(RandomWalk {
                speed_m_s: 0.2,
                turning_deg_s: 80.0,
                within_m: 1.5,
                duration_s,
                start_s,
            }),
            RobotMotion::Waypoints(Waypoints { points_m: vec![[90.0, 2.0, 0.0]], speed_m_s: 0.3, start_s }),
            RobotMotion::Recorded(RecordedMotion { file: trajectory.into(), start_s, stray_m: 0.01, stray_s: 9.0 }),
            RobotMotion::Followed(FollowedMotion { origin_m: [1.0, 2.0, 3.0], origin_yaw_deg: 4.0 }),
        ];
        Scene {
            name: "full".into(),
            seed: 5,
            duration_s: 10.0,
            channel: 100,
            bandwidth_mhz: 40,
            start_unix_s: 1_600_000_000,
            reflections: 1,
            cfo: Cfo::Paper(PaperCfo { df_hz: 11.0, c1: 9_000.0, c2: 190.0, jitter_ns: 90.0 }),
            card: Card::Intel5300,
            preamble: None,
            driver: Driver::Stock,
            sounding: Some(Sounding {
                rate_hz: 2.0,
                initiators: vec!["r0".into()],
                dialect: Dialect::Native,
                start_s: 0.2,
            }),
            radio: radio(
                Gain::Agc(Agc { target_lsb: 30.0, lsb_std_db: 0.5, rssi_db: 37.0, agc_std_db: 0.5 }),
                Noise::SnrDb(20.0),
            ),
            robot: motions.into_iter().enumerate().map(|(number, motion)| robot(number, motion)).collect(),
            wall: vec![Wall {
                from_m: [0.0, -9.0],
                to_m: [5.0, -9.0],
                bottom_m: 0.1,
                top_m: 2.4,
                thickness_m: 0.2,
                loss_db: 5.0,
                through_db: Some(9.0),
            }],
            reflector: vec![Reflector {
                corner_m: [1.0, -9.0, 2.0],
                edge_a_m: [2.0, 0.1, 0.1],
                edge_b_m: [0.1, 2.0, 0.2],
                loss_db: 5.0,
                through_db: Some(9.0),
            }],
        }
    }

    /// Calls `visit` with each number of a document and the way to it; indices are left out of the way's last part.
    fn numbers(value: &Value, way: &mut Vec<Step>, visit: &mut dyn FnMut(&[Step])) {
        match value {
            Value::Integer(_) | Value::Float(_) => visit(way),
            Value::Array(items) => {
                for (index, item) in items.iter().enumerate() {
                    way.push(Step::Index(index));
                    numbers(item, way, visit);
                    way.pop();
                }
            }
            Value::Table(table) => {
                for (key, item) in table {
                    way.push(Step::Key(key.clone()));
                    numbers(item, way, visit);
                    way.pop();
                }
            }
            _ => {}
        }
    }

    #[derive(Clone, Debug)]
    enum Step {
        Key(String),
        Index(usize),
    }

    fn at<'v>(value: &'v mut Value, way: &[Step]) -> &'v mut Value {
        way.iter().fold(value, |value, step| match step {
            Step::Key(key) => &mut value[key.as_str()],
            Step::Index(index) => &mut value[*index],
        })
    }

    fn read(document: &Value) -> Result<Scene, SceneError> {
        Scene::from_toml(&toml::to_string(document).unwrap())
    }

    #[test]
    fn every_number_of_a_scene_that_makes_no_sense_is_refused_with_its_line() {
        let trajectory = std::env::temp_dir().join(format!("csi5300-numbers-{}.csv", std::process::id()));
        std::fs::write(&trajectory, "10.0,0,90,0,1,\n11.0,0,91,2,1,\n").unwrap();
        let text = full(&trajectory).to_toml().unwrap();
        Scene::from_toml(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let mut document: Value = toml::from_str(&text).unwrap();
        let mut ways = Vec::new();
        numbers(&document, &mut Vec::new(), &mut |way| ways.push(way.to_vec()));
        assert!(ways.len() > 700, "{} numbers", ways.len());
        // Robots differ in their motions alone.
        let apart = |way: &&Vec<Step>| match &way[..] {
            [Step::Key(robot), Step::Index(index), Step::Key(table), ..] if robot == "robot" => {
                *index == 0 || table == "motion"
            }
            _ => true,
        };
        let mut wrong = Vec::new();
        for way in ways.iter().filter(apart) {
            let keys: Vec<&str> = way
                .iter()
                .filter_map(|step| if let Step::Key(key) = step { Some(key.as_str()) } else { None })
                .collect();
            let name = keys.join(".");
            let signed = SIGNED.split(' ').any(|signed| signed == *keys.last().unwrap())
                || SIGNED_WAYS.iter().any(|signed| name.ends_with(signed));
            let before = at(&mut document, way).clone();
            let whole = before.is_integer();
            let cases = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300].map(Value::Float);
            let negative = if whole { Value::Integer(-1) } else { Value::Float(-1.0) };
            for case in cases.into_iter().chain(std::iter::once(negative).filter(|_| !signed)) {
                // Without end is the highest rate that fits.
                if name == "sounding.rate_hz" && case.as_float() == Some(f64::INFINITY) {
                    continue;
                }
                *at(&mut document, way) = case.clone();
                match read(&document) {
                    Ok(_) => wrong.push(format!("{name} = {case:?} is taken")),
                    Err(error) if error.line().is_none() => wrong.push(format!("{name} = {case:?}: no line: {error}")),
                    Err(_) => {}
                }
            }
            *at(&mut document, way) = before;
        }
        std::fs::remove_file(&trajectory).unwrap();
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        /// Whatever its numbers and names.
        #[test]
        fn a_written_scene_is_read_as_itself(
            number in prop_oneof![any::<f64>().prop_filter("equal to itself", |v| !v.is_nan()), (-9..9).prop_map(f64::from)],
            name in prop_oneof!["[a-z_-]{0,8}", any::<String>()],
            (seed, start_unix_s, whole) in any::<(u64, i64, u32)>(),
            (cfo, gain, noise) in (0..3_usize, 0..2_usize, 0..3_usize),
        ) {
            let mut scene = full(Path::new(&name));
            (scene.name, scene.seed, scene.start_unix_s, scene.duration_s) = (name.clone(), seed, start_unix_s, number);
            scene.cfo = [Cfo::Off, Cfo::Physical, Cfo::Paper(PaperCfo { df_hz: number, ..PaperCfo::default() })][cfo];
            let fixed = Gain::Fixed(FixedGain { lsb_at_1m: number, agc_db: whole as u8 });
            scene.radio.gain = [fixed, Gain::Agc(Agc { target_lsb: number, ..Agc::default() })][gain];
            scene.radio.noise = [Noise::Off, Noise::SnrDb(number), Noise::FloorDbm(number)][noise];
            (scene.radio.filter_db, scene.sounding) = (Some([number; 30]), None);
            (scene.wall[0].through_db, scene.reflector[0].edge_a_m) = (None, [number; 3]);
            let robot = &mut scene.robot[0];
            (robot.name, robot.mac) = (name.clone(), Some(name));
            (robot.position_m, robot.antenna_b_m, robot.odometry.late_s) = ([number; 3], None, number);
            (robot.motion, robot.radio, robot.ack_len) = (RobotMotion::Static, None, None);
            (robot.faults.restart_at_s, robot.faults.queue_records) = (vec![number; 2], whole as usize);
            scene.robot.push(Robot::default());
            let text = scene.to_toml().unwrap();
            let again = Scene::parse(&text).map_err(|error| TestCaseError::fail(format!("{error}\n{text}")))?;
            prop_assert_eq!(again, scene, "{}", text);
        }
    }
}
