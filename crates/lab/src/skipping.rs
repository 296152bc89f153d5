//! What leaving steps out costs in accuracy: scenes of one link, each estimated with every step, with what it needs, and by
//! a plane wave alone.

use crate::compare::CompareError;
use crate::ends::{Ends, Seen};
use csi5300::bartlett::Geometry;
use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Accuracy, Bearing, Effort, Options, Sufficient};
use csi5300_sim::motion::{Arc, Circle, FigureEight, Helix, Line, RandomWalk, RobotMotion, Square, Waypoints};
use csi5300_sim::scene::Wall;
use std::f64::consts::TAU;

/// Length of every scene, seconds.
const DURATION_S: f64 = 6.0;

/// A scene and the kind that it is of.
#[derive(Clone, Debug)]
pub struct SkipScene {
    /// What the scenes of a kind have in common.
    pub kind: &'static str,
    /// The link.
    pub ends: Ends,
}

/// An estimate of a scene.
#[derive(Clone, Debug)]
pub struct Estimated {
    /// The bearing.
    pub bearing: Bearing,
    /// It beside its truth.
    pub seen: Seen,
}

/// A scene estimated in three ways.
#[derive(Clone, Debug)]
pub struct Compared {
    /// With every step.
    pub everything: Estimated,
    /// With what it needs.
    pub needed: Estimated,
    /// By a plane wave alone.
    pub plane_wave: Estimated,
}

/// How an estimate is made.
#[must_use]
pub fn efforts() -> [Accuracy; 3] {
    let accuracy = Accuracy::default();
    [accuracy.with_effort(Effort::Everything), accuracy, accuracy.without_layers()]
}

impl SkipScene {
    /// Estimates the scene in all three ways from the same logs.
    ///
    /// # Errors
    /// If it cannot be simulated or gives no bearing.
    pub fn compare(&self, options: &Options) -> Result<Compared, CompareError> {
        let recording = self.ends.record()?;
        let estimate = |accuracy: Accuracy| -> Result<Estimated, CompareError> {
            let bearing = recording.bearing(&options.clone().with_accuracy(accuracy))?;
            Ok(Estimated { seen: recording.judge(&bearing), bearing })
        };
        let [everything, needed, plane_wave] = efforts();
        Ok(Compared { everything: estimate(everything)?, needed: estimate(needed)?, plane_wave: estimate(plane_wave)? })
    }
}

impl Compared {
    /// How far leaving steps out moved the answer, in units of the smaller of the two error bars: up to a mirror that the
    /// motion hides.
    #[must_use]
    pub fn moved(&self) -> f64 {
        moved(&self.everything.bearing, &self.needed.bearing)
    }

    /// True if steps were left out.
    #[must_use]
    pub fn skipped(&self) -> bool {
        !matches!(self.needed.bearing.sufficient, Sufficient::Everything(_))
    }
}

/// How far two answers of one link are apart, in units of the smaller of their error bars: up to a mirror that the motion
/// hides.
#[must_use]
pub fn moved(one: &Bearing, other: &Bearing) -> f64 {
    let (a, b) = (&one.answer, &other.answer);
    let direct = wrap_rad(a.azimuth_rad - b.azimuth_rad).abs();
    let folded = |mirror_rad: f64| wrap_rad(mirror_rad - b.azimuth_rad).abs();
    let on_a_line = one.plane_wave.geometry == Geometry::Line;
    let apart = a.mirror_rad.filter(|_| on_a_line).map_or(direct, |mirror| direct.min(folded(mirror)));
    apart / a.azimuth_sd_rad.min(b.azimuth_sd_rad)
}

/// Scenes of every kind, some 200 of them: always the same.
#[must_use]
pub fn scenes() -> Vec<SkipScene> {
    let mut scenes = Scenes(Vec::new());
    scenes.circles();
    scenes.arcs_and_lines();
    scenes.in_space();
    scenes.tilted();
    scenes.both_moving();
    scenes.many_paths();
    scenes.odometry();
    scenes.other_shapes();
    scenes.0
}

struct Scenes(Vec<SkipScene>);

fn circle(radius_m: f64, turns: f64) -> RobotMotion {
    RobotMotion::Circle(Circle { radius_m, duration_s: DURATION_S, turns, start_s: 0.0 })
}

fn arc(radius_m: f64, angle_deg: f64) -> RobotMotion {
    RobotMotion::Arc(Arc { radius_m, angle_deg, duration_s: DURATION_S, start_s: 0.0 })
}

fn line(length_m: f64) -> RobotMotion {
    RobotMotion::Line(Line { length_m, duration_s: DURATION_S, start_s: 0.0 })
}

fn helix(radius_m: f64, rise_m: f64, turns: f64) -> RobotMotion {
    RobotMotion::Helix(Helix { radius_m, rise_m, duration_s: DURATION_S, turns, start_s: 0.0 })
}

fn square(side_m: f64) -> RobotMotion {
    RobotMotion::Square(Square { side_m, duration_s: DURATION_S, turns: 1.0, start_s: 0.0 })
}

fn eight(radius_m: f64) -> RobotMotion {
    RobotMotion::FigureEight(FigureEight { radius_m, duration_s: DURATION_S, turns: 1.0, start_s: 0.0 })
}

fn walk() -> RobotMotion {
    RobotMotion::RandomWalk(RandomWalk {
        speed_m_s: 0.3,
        turning_deg_s: 120.0,
        within_m: 0.6,
        duration_s: DURATION_S,
        start_s: 0.0,
    })
}

/// A circle in a plane that leans by so much.
fn leaning(radius_m: f64, tilt_deg: f64) -> RobotMotion {
    let (up, flat) = tilt_deg.to_radians().sin_cos();
    let point = |k: i32| {
        let (sin, cos) = (TAU * f64::from(k) / 60.0).sin_cos();
        [radius_m * (cos - 1.0) * flat, radius_m * sin, radius_m * (cos - 1.0) * up]
    };
    let speed_m_s = TAU * radius_m / DURATION_S;
    RobotMotion::Waypoints(Waypoints { points_m: (1..=60).map(point).collect(), speed_m_s, start_s: 0.0 })
}

impl Scenes {
    /// Adds a link; its azimuth and seed follow from how many there are.
    fn add(&mut self, kind: &'static str, receiver: RobotMotion, range_m: f64, snr_db: f64, more: impl Fn(&mut Ends)) {
        self.add_at(kind, receiver, range_m, 3.0, snr_db, more);
    }

    fn add_at(
        &mut self,
        kind: &'static str,
        receiver: RobotMotion,
        range_m: f64,
        elevation_deg: f64,
        snr_db: f64,
        more: impl Fn(&mut Ends),
    ) {
        let number = self.0.len();
        // The golden angle: no two scenes have like azimuths.
        let azimuth_rad = (137.508 * number as f64 + 20.0).to_radians();
        let ((sin, cos), (up, flat)) = (azimuth_rad.sin_cos(), elevation_deg.to_radians().sin_cos());
        let transmitter_m = [range_m * flat * cos, range_m * flat * sin, range_m * up];
        let seed = 1_000 + number as u64;
        let mut ends = Ends { receiver, transmitter_m, duration_s: DURATION_S, snr_db, seed, ..Ends::default() };
        more(&mut ends);
        self.0.push(SkipScene { kind, ends });
    }

    fn circles(&mut self) {
        for radius_m in [0.03, 0.1, 0.3, 0.5] {
            for range_m in [1.9, 4.0, 15.0, 390.0] {
                for snr_db in [25.0, 12.0, 0.0] {
                    self.add("circle", circle(radius_m, 1.0), range_m, snr_db, |_| {});
                }
            }
        }
    }

    fn arcs_and_lines(&mut self) {
        for angle_deg in [60.0, 120.0, 240.0] {
            for range_m in [2.2, 8.0, 100.0] {
                for snr_db in [20.0, 8.0] {
                    self.add("arc", arc(0.4, angle_deg), range_m, snr_db, |_| {});
                }
            }
        }
        for length_m in [0.3, 1.0] {
            for range_m in [3.0, 10.0, 100.0] {
                for snr_db in [20.0, 8.0] {
                    self.add("line", line(length_m), range_m, snr_db, |_| {});
                }
            }
        }
    }

    fn in_space(&mut self) {
        for elevation_deg in [-60.0, -25.0, 0.0, 25.0, 60.0] {
            for range_m in [1.2, 6.0, 40.0] {
                for snr_db in [20.0, 8.0] {
                    self.add_at("helix", helix(0.3, 0.3, 1.0), range_m, elevation_deg, snr_db, |_| {});
                }
            }
        }
    }

    fn tilted(&mut self) {
        for tilt_deg in [10.0, 30.0, 60.0] {
            for range_m in [3.0, 20.0] {
                for elevation_deg in [-20.0, 0.0, 15.0] {
                    self.add_at("tilted", leaning(0.3, tilt_deg), range_m, elevation_deg, 15.0, |_| {});
                }
            }
        }
    }

    fn both_moving(&mut self) {
        let pairs = [
            (circle(0.3, 1.0), line(0.8)),
            (circle(0.3, 1.0), circle(0.25, -2.0)),
            (arc(0.4, 240.0), walk()),
            (square(0.4), eight(0.15)),
            (helix(0.3, 0.4, 1.0), helix(0.2, 0.5, -1.0)),
        ];
        for (receiver, transmitter) in pairs {
            for range_m in [2.5, 5.0, 30.0] {
                self.add("both moving", receiver.clone(), range_m, 15.0, |ends| ends.transmitter = transmitter.clone());
            }
        }
    }

    /// A room of four walls, so loud as to be plaster or steel; with one wall before the transmitter in every third.
    fn many_paths(&mut self) {
        for (k, loss_db) in [12.0, 6.0, 2.0].into_iter().enumerate() {
            for (receiver, range_m) in [
                (circle(0.3, 1.0), 2.5),
                (circle(0.3, 1.0), 4.0),
                (arc(0.4, 200.0), 3.0),
                (arc(0.4, 120.0), 4.5),
                (walk(), 3.5),
                (square(0.4), 3.0),
                (helix(0.3, 0.3, 1.0), 3.0),
                (line(1.0), 3.5),
            ] {
                let half_m = 5.0 + 0.4 * k as f64;
                let corner =
                    |k: usize| [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]][k % 4].map(|v: f64| v * half_m);
                let wall = |k: usize| Wall { loss_db, ..Wall::between(corner(k), corner(k + 1)) };
                self.add("many paths", receiver, range_m, 15.0, |ends| {
                    (ends.walls, ends.reflections) = ((0..4).map(wall).collect(), 1 + u8::from(loss_db < 10.0));
                });
            }
        }
    }

    fn odometry(&mut self) {
        for (noise_m, scale) in [(0.0005, 0.0), (0.003, 0.0), (0.0, 0.01), (0.002, 0.03)] {
            for (receiver, range_m) in [
                (circle(0.3, 1.0), 4.0),
                (arc(0.4, 200.0), 5.0),
                (helix(0.3, 0.3, 1.0), 6.0),
                (line(1.0), 8.0),
                (walk(), 5.0),
            ] {
                self.add("odometry errors", receiver, range_m, 15.0, |ends| {
                    (ends.odometry_noise_m, ends.odometry_scale) = (noise_m, scale);
                });
            }
        }
    }

    fn other_shapes(&mut self) {
        for range_m in [2.0, 6.0, 60.0] {
            for snr_db in [20.0, 8.0] {
                self.add("walk", walk(), range_m, snr_db, |_| {});
                self.add("square", square(0.5), range_m, snr_db, |_| {});
                self.add("eight", eight(0.2), range_m, snr_db, |_| {});
            }
        }
    }
}
