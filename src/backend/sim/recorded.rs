//! A recorded trajectory as a motion: the CSV layouts of the WSR toolbox and of the paper.

use super::motion::Pose;
use nalgebra::Vector3;
use std::io::Read;

/// Poses over time, interpolated linearly; at rest before the first row and after the last.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Seconds since the first row, never falling.
    t_s: Vec<f64>,
    poses: Vec<Pose>,
}

impl Recorded {
    /// A trajectory from rows of (seconds, pose), which are put into the order of time.
    #[must_use]
    pub fn from_rows(mut rows: Vec<(f64, Pose)>) -> Self {
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        let first = rows.first().map_or(0.0, |row| row.0);
        let (t_s, poses) = rows.into_iter().map(|(t, pose)| (t - first, pose)).unzip();
        Self { t_s, poses }
    }

    /// Reads a trajectory CSV without a header. Told apart by their number of columns (a trailing comma counts not):
    ///
    /// | columns | meaning |
    /// |---|---|
    /// | 5 | sec, nsec, x, y, z |
    /// | 6 | sec, nsec, x, y, z, yaw (the paper's motion capture) |
    /// | 9 | sec, nsec, x, y, z, qx, qy, qz, qw (the paper's simulation) |
    /// | 15 | the same and linear and angular velocity (WSR odometry and T265) |
    ///
    /// Five columns have no heading: the robot faces where it goes. Metres, radians; time is `sec + nsec 1e-9`.
    ///
    /// # Errors
    /// A sentence with the row's number when a row is not numbers, has another width, or the file has no rows.
    pub fn read(csv: impl Read) -> Result<Self, String> {
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .from_reader(csv);
        let mut rows: Vec<(f64, Pose)> = Vec::new();
        let mut faces = true;
        for (index, record) in reader.records().enumerate() {
            let record = record.map_err(|e| format!("row {}: {e}", index + 1))?;
            let fields: Vec<&str> = record.iter().filter(|field| !field.is_empty()).collect();
            let numbers: Vec<f64> = fields
                .iter()
                .map(|f| f.parse::<f64>().ok().filter(|v| v.is_finite()))
                .collect::<Option<_>>()
                .ok_or_else(|| format!("row {}: {record:?} is not finite numbers only", index + 1))?;
            let (row, has_heading) = pose_of(&numbers).ok_or_else(|| {
                format!("row {}: {} columns; a trajectory has 5, 6, 9 or 15", index + 1, numbers.len())
            })?;
            faces &= has_heading;
            rows.push(row);
        }
        if rows.is_empty() {
            return Err("no rows: a trajectory needs at least one".to_owned());
        }
        let mut recorded = Self::from_rows(rows);
        if !faces {
            recorded.face_forward();
        }
        Ok(recorded)
    }

    /// From the first row to the last, seconds.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.t_s.last().copied().unwrap_or(0.0)
    }

    /// The pose `t_s` seconds after the first row.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Pose {
        let after = self.t_s.partition_point(|&t| t <= t_s);
        let last = self.poses.len().saturating_sub(1);
        let pose = |i: usize| {
            self.poses.get(i).copied().unwrap_or(Pose { position_m: Vector3::zeros(), yaw_rad: 0.0 })
        };
        let (Some(&from), Some(&to)) = (self.t_s.get(after.wrapping_sub(1)), self.t_s.get(after)) else {
            return pose(if after == 0 { 0 } else { last });
        };
        let (a, b) = (pose(after - 1), pose(after));
        let part = if to > from { (t_s - from) / (to - from) } else { 0.0 };
        let turn = b.yaw_rad - a.yaw_rad;
        let turn = turn - std::f64::consts::TAU * (turn / std::f64::consts::TAU).round();
        Pose {
            position_m: a.position_m + (b.position_m - a.position_m) * part,
            yaw_rad: a.yaw_rad + turn * part,
        }
    }

    /// Headings along the way driven, for files that have none.
    fn face_forward(&mut self) {
        let places: Vec<Vector3<f64>> = self.poses.iter().map(|p| p.position_m).collect();
        let mut yaw_rad = 0.0;
        for (pose, next) in self.poses.iter_mut().zip(places.iter().skip(1).chain(places.last())) {
            let step = next - pose.position_m;
            if step.xy().norm() > 1e-4 {
                yaw_rad = libm::atan2(step.y, step.x);
            }
            pose.yaw_rad = yaw_rad;
        }
    }
}

/// One row as (seconds, pose), and whether it says where the robot faces.
fn pose_of(row: &[f64]) -> Option<((f64, Pose), bool)> {
    let &[sec, nsec, x, y, z, ref rest @ ..] = row else { return None };
    let yaw_rad = match *rest {
        [] => None,
        [yaw] => Some(yaw),
        [qx, qy, qz, qw] | [qx, qy, qz, qw, _, _, _, _, _, _] => {
            Some(libm::atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz)))
        }
        _ => return None,
    };
    let pose = Pose { position_m: Vector3::new(x, y, z), yaw_rad: yaw_rad.unwrap_or(0.0) };
    Some(((sec + nsec * 1e-9, pose), yaw_rad.is_some()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_layout_is_read() {
        let five = Recorded::read("10.0,0,0,0,1,\n11.0,0,0,2,1,\n12.0,0,0,4,1,\n".as_bytes()).unwrap();
        assert_eq!(five.duration_s(), 2.0);
        assert_eq!(five.at(0.5).position_m, Vector3::new(0.0, 1.0, 1.0));
        assert!((five.at(0.5).yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-15, "faces where it goes");

        let six = Recorded::read("10.0,0,1,2,3,0.5,\n".as_bytes()).unwrap();
        assert_eq!(six.at(99.0), Pose { position_m: Vector3::new(1.0, 2.0, 3.0), yaw_rad: 0.5 });

        let fifteen = "5,500000000,0,0,0,0,0,0.6,0.8,0,0,0,0,0,0,\n6,0,1,0,0,0,0,0.6,0.8,0,0,0,0,0,0,\n";
        let fifteen = Recorded::read(fifteen.as_bytes()).unwrap();
        assert_eq!(fifteen.duration_s(), 0.5);
        assert!((fifteen.at(0.0).yaw_rad - 2.0 * 0.6f64.atan2(0.8)).abs() < 1e-15);
    }

    #[test]
    fn bad_rows_are_named() {
        for (csv, what) in [("1,2,3\n", "row 1: 3 columns"), ("1,0,0,0,0\n1,0,x,0,0\n", "row 2"), ("", "no rows")] {
            let error = Recorded::read(csv.as_bytes()).unwrap_err();
            assert!(error.contains(what), "{error}");
        }
    }

    #[test]
    fn headings_turn_the_short_way() {
        let at = |yaw_rad| Pose { position_m: Vector3::zeros(), yaw_rad };
        let table = Recorded::from_rows(vec![(0.0, at(3.0)), (1.0, at(-3.0))]);
        assert!((table.at(0.5).yaw_rad - std::f64::consts::PI).abs() < 1e-12);
    }
}
