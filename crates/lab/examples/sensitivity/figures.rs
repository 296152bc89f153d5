//! What is measured with one set of numbers: captures, simulated rooms, simulated links, pairs.

use crate::{Fallible, pairs};
use csi5300::internal::{quick_deviation_rad, quick_features, quick_probability};
use csi5300::maths::{median, wrap_rad};
use csi5300::pipeline::{Bearing, Options, Sufficient};
use csi5300_lab::evaluate::quality::{ranges, receivers};
use csi5300_lab::evaluate::{Capture, Judged, TrajectorySource, find};
use csi5300_lab::skipping::scenes;
use nix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Of the simulated links every this many are estimated.
const EVERY: usize = 4;
/// A bearing within this is right, degrees: what probabilities are of.
const RIGHT_DEG: f64 = 5.0;
/// Median of |error| / error bar where 68 % of errors are within it.
const NORMAL: f64 = 0.674_5;

/// A figure and its keys among the values measured.
#[derive(Clone, Copy)]
pub enum Figure {
    /// Errors of the captures' bearings, degrees.
    Errors { name: &'static str, mean: &'static str, median: &'static str },
    /// Other errors, degrees.
    Beside { name: &'static str, mean: &'static str, median: &'static str },
    /// Anything else.
    Value { name: &'static str, key: &'static str },
}

impl Figure {
    /// True of the four columns that every number is judged by.
    pub fn of_captures(self) -> bool {
        matches!(self, Self::Errors { .. })
    }
}

macro_rules! errors {
    ($kind:ident, $name:literal, $key:literal) => {
        Figure::$kind { name: $name, mean: concat!($key, " mean"), median: concat!($key, " median") }
    };
}

/// All figures, in the order in which they are named.
pub const FIGURES: &[Figure] = &[
    errors!(Errors, "LOS", "mocap full LOS"),
    errors!(Errors, "NLOS", "mocap full NLOS"),
    errors!(Errors, "T265 LOS", "t265 full LOS"),
    errors!(Errors, "T265 NLOS", "t265 full NLOS"),
    errors!(Beside, "plane wave LOS", "mocap plane LOS"),
    errors!(Beside, "plane wave NLOS", "mocap plane NLOS"),
    errors!(Beside, "T265 plane wave LOS", "t265 plane LOS"),
    errors!(Beside, "T265 plane wave NLOS", "t265 plane NLOS"),
    Figure::Value { name: "links without bearing", key: "failed" },
    Figure::Value { name: "Brier score", key: "full brier" },
    Figure::Value { name: "errors over bar", key: "full over bar" },
    Figure::Value { name: "Brier score of plane waves", key: "plane brier" },
    Figure::Value { name: "plane waves' errors over bar", key: "plane over bar" },
    Figure::Value { name: "ranges", key: "ranges" },
    Figure::Value { name: "median range error (m)", key: "range error" },
    Figure::Value { name: "receivers' median error (m)", key: "located" },
    errors!(Beside, "rooms LOS", "rooms LOS"),
    errors!(Beside, "rooms NLOS", "rooms NLOS"),
    errors!(Beside, "simulated links", "links level"),
    errors!(Beside, "simulated links in space", "links space"),
    errors!(Beside, "elevation of simulated links", "links elevation"),
    Figure::Value { name: "simulated links without every step", key: "links skipped" },
    Figure::Value { name: "simulated mirrors", key: "links mirrors" },
    Figure::Value { name: "paths a link", key: "paths" },
    Figure::Value { name: "products among paths a link", key: "products" },
    Figure::Value { name: "pairs in motion", key: "in motion" },
    Figure::Value { name: "bearings from logs of different runs", key: "foreign" },
    Figure::Value { name: "right pairs after restarts", key: "restart right" },
    Figure::Value { name: "wrong pairs after restarts", key: "restart wrong" },
];

/// What was measured.
#[derive(Clone, Default, Serialize, Deserialize)]
pub struct Figures {
    /// By key; none where nothing could be measured.
    pub values: BTreeMap<String, Option<f64>>,
    /// Processor time, seconds.
    pub seconds: Option<f64>,
}

impl Figures {
    /// The first of several measurements of the same numbers, with the median of their times.
    pub fn usual(all: &[&Self]) -> Option<Self> {
        let mut seconds: Vec<f64> = all.iter().filter_map(|own| own.seconds).collect();
        Some(Self { values: all.first()?.values.clone(), seconds: median(&mut seconds) })
    }

    /// With the values of another part; times are of the first.
    pub fn and(mut self, other: &Self) -> Self {
        self.values.extend(other.values.clone());
        self
    }

    fn set(&mut self, key: &str, value: Option<f64>) {
        self.values.insert(key.into(), value.filter(|value| value.is_finite()));
    }

    /// Mean and median of absolute errors.
    fn errors(&mut self, key: &str, errors_deg: impl Iterator<Item = f64>) {
        let mut all: Vec<f64> = errors_deg.map(f64::abs).collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        self.set(&format!("{key} mean"), Some(mean));
        self.set(&format!("{key} median"), median(&mut all));
    }
}

/// One answer beside its truth.
struct Said {
    sight: &'static str,
    error_deg: f64,
    probability: Option<f64>,
    bar_deg: f64,
}

/// Simulated rooms and links with the numbers in use.
pub fn of_scenes(rooms: &Path) -> Fallible<Figures> {
    let mut figures = Figures::default();
    figures.of_rooms(rooms)?;
    figures.of_links()?;
    let (right, wrong) = pairs::after_restarts();
    figures.set("restart right", Some(right));
    figures.set("restart wrong", Some(wrong));
    Ok(figures)
}

/// The captures with the numbers in use.
pub fn of_captures(captures: &Path) -> Fallible<Figures> {
    let (captures, unreadable) = find(captures);
    if let Some(first) = unreadable.first() {
        return Err(first.clone().into());
    }
    let mut figures = Figures::default();
    let start_s = clock_s();
    let (mut full, mut plane, mut failed) = (Vec::new(), Vec::new(), 0);
    let sources = [("mocap", TrajectorySource::GroundTruth), ("t265", TrajectorySource::T265)];
    for (name, source) in sources {
        let seen = Seen::of(&captures, source)?;
        for sight in ["LOS", "NLOS"] {
            let own = |said: &[Said]| -> Vec<f64> {
                said.iter().filter(|said| said.sight == sight).map(|said| said.error_deg).collect()
            };
            figures.errors(&format!("{name} full {sight}"), own(&seen.full).into_iter());
            figures.errors(&format!("{name} plane {sight}"), own(&seen.plane).into_iter());
        }
        if source == TrajectorySource::GroundTruth {
            figures.of_places(&seen);
        }
        failed += seen.failed;
        full.extend(seen.full);
        plane.extend(seen.plane);
    }
    figures.set("failed", Some(f64::from(failed)));
    figures.certainty("full", &full);
    figures.certainty("plane", &plane);
    figures.seconds = Some(clock_s() - start_s);
    figures.set("foreign", Some(foreign(&captures)?));
    Ok(figures)
}

/// Seconds of this process's processor time.
fn clock_s() -> f64 {
    clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID).map_or(0.0, |t| t.tv_sec() as f64 + t.tv_nsec() as f64 * 1e-9)
}

fn options() -> Fallible<Options> {
    Ok(Options::new("108".parse()?))
}

/// Every link of some captures by one trajectory.
struct Seen {
    rows: Vec<Judged>,
    full: Vec<Said>,
    plane: Vec<Said>,
    failed: u32,
    links: u32,
    paths: usize,
    products: usize,
    in_motion: usize,
}

impl Seen {
    fn of(captures: &[Capture], source: TrajectorySource) -> Fallible<Self> {
        let mut seen = Self {
            rows: Vec::new(),
            full: Vec::new(),
            plane: Vec::new(),
            failed: 0,
            links: 0,
            paths: 0,
            products: 0,
            in_motion: 0,
        };
        for capture in captures {
            let mut bearings: BTreeMap<String, (Bearing, Options)> = BTreeMap::new();
            let mut look = |name: &str, bearing: &Bearing, options: &Options| {
                bearings.insert(name.to_owned(), (bearing.clone(), options.clone()));
            };
            let rows = capture.evaluate_and(source, None, &options()?, &mut look).rows;
            for row in rows {
                seen.add(&row, bearings.get(&row.answer.link));
                seen.rows.push(row);
            }
        }
        Ok(seen)
    }

    fn add(&mut self, row: &Judged, bearing: Option<&(Bearing, Options)>) {
        self.links += 1;
        let sight = if row.set().contains("NLOS") { "NLOS" } else { "LOS" };
        let Some(((bearing, options), truth_deg)) = bearing.zip(row.true_from_mean_pose_deg) else {
            self.failed += 1;
            return;
        };
        let off_deg = |azimuth_rad: f64| wrap_rad(azimuth_rad - truth_deg.to_radians()).to_degrees();
        let answer = &bearing.answer;
        self.full.push(Said {
            sight,
            error_deg: off_deg(answer.azimuth_rad),
            probability: answer.probability,
            bar_deg: answer.azimuth_sd_rad.to_degrees(),
        });
        let (wave, heading_rad) = (&bearing.plane_wave, options.heading_sd_rad.unwrap_or(0.0));
        let features = quick_features(wave, bearing.compensated, options.channel.wavelength_m());
        self.plane.push(Said {
            sight,
            error_deg: off_deg(wave.azimuth_rad),
            probability: wave.mirror_rad.is_none().then(|| quick_probability(features, heading_rad)),
            bar_deg: quick_deviation_rad(features, heading_rad, wave.azimuth_sd_rad).to_degrees(),
        });
        let paths = bearing.placed.iter().flat_map(|placed| &placed.paths);
        self.products += paths.clone().filter(|path| path.cross_term_of.is_some()).count();
        self.paths += paths.count();
        self.in_motion += bearing.pairs.in_motion;
    }
}

impl Figures {
    /// Ranges, receivers, paths and pairs.
    fn of_places(&mut self, seen: &Seen) {
        let rows: Vec<&Judged> = seen.rows.iter().collect();
        let ranges = ranges(&rows);
        self.set("ranges", Some(ranges.reported as f64));
        self.set("range error", ranges.median_m);
        let mut off_m: Vec<f64> = receivers(&seen.rows).iter().filter_map(|receiver| receiver.off_m).collect();
        self.set("located", median(&mut off_m));
        self.set("paths", Some(seen.paths as f64 / f64::from(seen.links)));
        self.set("products", Some(seen.products as f64 / f64::from(seen.links)));
        self.set("in motion", Some(seen.in_motion as f64));
    }

    /// Brier score of the probabilities, and how errors compare with their bars: 1 where these tell the truth.
    fn certainty(&mut self, kind: &str, said: &[Said]) {
        let score = |said: &Said| {
            let right = f64::from(u8::from(said.error_deg.abs() <= RIGHT_DEG));
            said.probability.map(|probability| (probability - right).powi(2))
        };
        let scores: Vec<f64> = said.iter().filter_map(score).collect();
        self.set(&format!("{kind} brier"), Some(scores.iter().sum::<f64>() / scores.len() as f64));
        let mut ratios: Vec<f64> = said.iter().map(|said| said.error_deg.abs() / said.bar_deg).collect();
        self.set(&format!("{kind} over bar"), median(&mut ratios).map(|ratio| ratio / NORMAL));
    }

    fn of_rooms(&mut self, rooms: &Path) -> Fallible<()> {
        let seen = Seen::of(&find(rooms).0, TrajectorySource::GroundTruth)?;
        for sight in ["LOS", "NLOS"] {
            let own = seen.full.iter().filter(|said| said.sight == sight).map(|said| said.error_deg);
            self.errors(&format!("rooms {sight}"), own);
        }
        Ok(())
    }

    /// Every fourth scene of `csi5300_lab::skipping`.
    fn of_links(&mut self) -> Fallible<()> {
        let (mut level, mut space, mut elevation) = (Vec::new(), Vec::new(), Vec::new());
        let (mut skipped, mut mirrors) = (0, 0);
        for scene in scenes().iter().step_by(EVERY) {
            let recording = scene.ends.record()?;
            let Ok(bearing) = recording.bearing(&options()?) else { continue };
            let seen = recording.judge(&bearing);
            let in_space = matches!(scene.kind, "helix" | "tilted");
            if in_space { &mut space } else { &mut level }.push(seen.azimuth_error_deg);
            elevation.extend(seen.elevation_error_deg);
            skipped += u32::from(!matches!(bearing.sufficient, Sufficient::Everything(_)));
            mirrors += u32::from(bearing.answer.mirror_rad.is_some());
        }
        self.errors("links level", level.into_iter());
        self.errors("links space", space.into_iter());
        self.errors("links elevation", elevation.into_iter());
        self.set("links skipped", Some(f64::from(skipped)));
        self.set("links mirrors", Some(f64::from(mirrors)));
        Ok(())
    }
}

/// Bearings that come of the receiver's log of one capture and the transmitters' of the next: each is one too many.
fn foreign(captures: &[Capture]) -> Fallible<f64> {
    let options = options()?;
    let mixed = captures.iter().zip(captures.iter().cycle().skip(1)).map(|(own, next)| {
        let mixed = Capture { transmitters: next.transmitters.clone(), ..own.clone() };
        let rows = mixed.evaluate(TrajectorySource::GroundTruth, None, &options).rows;
        rows.iter().filter(|row| row.answer.azimuth_deg.is_some()).count()
    });
    Ok(mixed.sum::<usize>() as f64)
}
