//! A simulated room as a capture folder in the layout of the WSR data set.

use super::motion::Pose;
use super::refused;
use super::room::{Room, append};
use super::scene::{Card, Driver, Scene};
use super::sounder::FrameRole;
use csi5300::motion::odometry::{NextPose, OdometrySource};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::{Error, side_path};
use csi5300::time::Instant;
use driver_iface::record::Record;
use driver_iface::side_file::{Entry, Layout};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Rows per second of the true trajectories, as motion capture gives them.
const TRUTH_HZ: f64 = 200.0;
/// A killed logger leaves whole blocks of its C library's buffer.
const BLOCK: u64 = 4_096;

/// One receiving robot's folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrittenCapture {
    /// The initiator's number; it is the receiver of the data set.
    pub receiver: usize,
    /// Its folder.
    pub dir: PathBuf,
    /// The time in its files' names.
    pub stamp: String,
    /// The logs in it.
    pub logs: Vec<WrittenLog>,
}

/// One log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrittenLog {
    /// Its file.
    pub path: PathBuf,
    /// The robot that logged.
    pub robot: usize,
    /// Whole records in it.
    pub records: u64,
    /// Missing or cut records, because its writer was killed.
    pub tail_records: u64,
    /// Bytes of the first of those.
    pub tail_bytes: u64,
}

/// A log being written.
struct Writing {
    out: BufWriter<File>,
    log: WrittenLog,
    /// Records have their length before them, unlike FeitCSI's.
    is_framed: bool,
    len: u64,
    /// Host times, for records that have none.
    side: Option<BufWriter<File>>,
    /// Where the records of the last blocks begin.
    starts: Vec<u64>,
    scratch: Vec<u8>,
}

/// Runs a room to its end and writes what its robots log, one folder for each initiator (`dir` itself if there is one,
/// else `dir/NAME`):
///
/// | file | what |
/// |---|---|
/// | `csi_rx_TS.dat` | the initiator's log: the backward frames of all responders; of an AX210 in the format of FeitCSI |
/// | `csi_*_TS.datstp` | beside each log in the stock layout, whose records have no host times: those of its records |
/// | `csi_txK_TS.dat` | the log of robot number K: the initiator's forward frames to it |
/// | `rx_trajectory_TS_.csv` | where the initiator's antenna A truly was: sec.frac, 0, x, y, z, |
/// | `odom_rx_trajectory_TS_.csv` | its odometry: sec, nsec, x, y, z, quaternion, velocity, angular velocity, |
/// | `txK_trajectory_TS_.csv` | where the antenna of a moving robot K truly was |
/// | `groundtruth_positions.json` | channel and places of the transmitters' antennas at the start |
///
/// TS is the scene's start (UTC). Times in trajectories are those of the initiator's host clock, metres in the scene's
/// frame. Records of other robots' exchanges are skipped, as in the data set; they appear as gaps in `bfee_count`.
/// `progress` is called about a hundred times with the finished share of the scene, 0 to 1.
///
/// # Errors
/// [`Error::Io`] when a file cannot be written; [`Error::Backend`] when a card was taken before or fails, and for a robot that
/// follows poses.
pub fn write_dataset(room: &mut Room, dir: &Path, progress: &mut dyn FnMut(f64)) -> Result<Vec<WrittenCapture>, Error> {
    let followed =
        room.scene().robot.iter().find(|robot| matches!(robot.motion, super::motion::RobotMotion::Followed(_)));
    if let Some(robot) = followed {
        return Err(refused(format!(
            "robot `{}` goes where an odometry source says while a node runs: `csi5300 node`, with `follow` in `capture.room`",
            robot.name
        )));
    }
    let initiators = room.scene().initiators();
    let stamp = stamp(room.scene().start_unix_s);
    let mut folders = BTreeMap::new();
    for &receiver in &initiators {
        let name = room.scene().robot.get(receiver).map_or("", |robot| &robot.name);
        let folder = if initiators.len() == 1 { dir.to_owned() } else { dir.join(name) };
        at(&folder, "create the folder", fs::create_dir_all(&folder))?;
        folders.insert(receiver, folder);
    }
    let logs = run(room, &folders, &stamp, progress)?;
    let mut captures = Vec::new();
    for (&receiver, folder) in &folders {
        write_truths(room, receiver, folder, &stamp)?;
        write_odometry(room, receiver, folder, &stamp)?;
        write_positions(room, receiver, folder)?;
        let logs = logs.iter().filter(|((owner, _), _)| *owner == receiver).map(|(_, log)| log.clone()).collect();
        captures.push(WrittenCapture { receiver, dir: folder.clone(), stamp: stamp.clone(), logs });
    }
    Ok(captures)
}

type Logs<T> = BTreeMap<(usize, usize), T>;

/// Runs the room and writes all logs, by initiator and logging robot.
fn run(
    room: &mut Room,
    folders: &BTreeMap<usize, PathBuf>,
    stamp: &str,
    progress: &mut dyn FnMut(f64),
) -> Result<Logs<WrittenLog>, Error> {
    let robots = room.scene().robot.len();
    let mut logs: Logs<Writing> = BTreeMap::new();
    for (&receiver, folder) in folders {
        for robot in 0..robots {
            let who = if robot == receiver { "rx".to_owned() } else { format!("tx{robot}") };
            let path = folder.join(format!("csi_{who}_{stamp}.dat"));
            logs.insert((receiver, robot), Writing::create(path, robot, room.scene())?);
        }
    }
    let end_us = room.scene().duration_s * 1e6;
    let mut told = 0.0;
    progress(told);
    let keep = |robot, role, from, host_us, record: &Record<'_>| {
        let key = owner(folders, role, robot, from).map(|owner| (owner, robot));
        key.and_then(|key| logs.get_mut(&key)).map_or(Ok(()), |log| log.write(host_us, record))
    };
    room.run_cards(keep, |now| {
        let share = (now.as_us() as f64 / end_us).min(1.0);
        if share >= told + 0.01 {
            told = share;
            progress(share);
        }
        Ok(())
    })?;
    let mut done = BTreeMap::new();
    for (key, writing) in logs {
        let killed = room.scene().robot.get(key.1).is_some_and(|robot| robot.faults.killed);
        let log = writing.finish(killed)?;
        room.note_tail(key.1, log.tail_records, log.tail_bytes);
        done.insert(key, log);
    }
    Ok(done)
}

/// The initiator in whose folder a record belongs.
fn owner(folders: &BTreeMap<usize, PathBuf>, role: FrameRole, robot: usize, from: usize) -> Option<usize> {
    let initiates = |robot: &usize| folders.contains_key(robot);
    match role {
        FrameRole::Forward => Some(from).filter(initiates),
        FrameRole::Backward => Some(robot).filter(initiates),
        FrameRole::Overheard => None,
        // The record does not tell, but with one initiator it is clear.
        FrameRole::Unknown => Some(robot).filter(initiates).or(Some(from).filter(initiates)),
    }
}

impl Writing {
    /// With a side file of host times, where records have none.
    fn create(path: PathBuf, robot: usize, scene: &Scene) -> Result<Self, Error> {
        let file = at(&path, "create the log", File::create(&path))?;
        let side = (scene.driver == Driver::Stock).then(|| side_path(&path));
        let side = side.map(|path| at(&path, "create the side file", File::create(&path))).transpose()?;
        let log = WrittenLog { path, robot, records: 0, tail_records: 0, tail_bytes: 0 };
        Ok(Self {
            out: BufWriter::new(file),
            log,
            is_framed: scene.card == Card::Intel5300,
            len: 0,
            side: side.map(BufWriter::new),
            starts: Vec::new(),
            scratch: Vec::new(),
        })
    }

    fn write(&mut self, host_us: Option<i64>, record: &Record<'_>) -> Result<(), Error> {
        if let Some(side) = &mut self.side {
            let mut entry = [0; Layout::Narrow.bytes()];
            // A time that does not fit stays zeros: not known.
            let _ = Entry::from(host_us).emit(Layout::Narrow, &mut entry);
            at(&self.log.path, "write the host times beside", side.write_all(&entry))?;
        }
        self.scratch.clear();
        append(&mut self.scratch, record, self.is_framed)?;
        at(&self.log.path, "write the log", self.out.write_all(&self.scratch))?;
        let block = self.len / BLOCK * BLOCK;
        if self.starts.len() > 2_048 {
            self.starts.retain(|&start| start + BLOCK >= block);
        }
        self.starts.push(self.len);
        self.len += self.scratch.len() as u64;
        self.log.records += 1;
        Ok(())
    }

    /// Closes the log; a killed one is cut at its last full block.
    fn finish(mut self, killed: bool) -> Result<WrittenLog, Error> {
        at(&self.log.path, "write the log", self.out.flush())?;
        let kept = self.len / BLOCK * BLOCK;
        if killed && kept < self.len {
            at(&self.log.path, "cut the log", self.out.get_ref().set_len(kept))?;
            // A record that ends after the cut is not whole.
            let ends = self.starts.iter().skip(1).copied().chain([self.len]);
            let cut: Vec<u64> = self.starts.iter().zip(ends).filter(|&(_, end)| end > kept).map(|(&s, _)| s).collect();
            self.log.tail_records = cut.len() as u64;
            self.log.records -= self.log.tail_records;
            self.log.tail_bytes = cut.first().map_or(0, |&start| kept.saturating_sub(start));
        }
        if let Some(side) = &mut self.side {
            let whole = self.log.records * Layout::Narrow.bytes() as u64;
            let done = side.flush().and_then(|()| side.get_ref().set_len(whole));
            at(&self.log.path, "write the host times beside", done)?;
        }
        Ok(self.log)
    }
}

impl Room {
    /// Adds to a robot's account what its killed logger lost.
    fn note_tail(&self, robot: usize, records: u64, bytes: u64) {
        let mut air = self.air();
        let injected = &mut air.node(robot).injected;
        injected.tail_records += records;
        injected.tail_bytes += bytes;
    }
}

/// True trajectories: the receiver's, and those of transmitters that move.
fn write_truths(room: &Room, receiver: usize, folder: &Path, stamp: &str) -> Result<(), Error> {
    for (robot, state) in room.scene().robot.iter().enumerate() {
        let name = match robot {
            _ if robot == receiver => format!("rx_trajectory_{stamp}_.csv"),
            _ if state.motion != super::motion::RobotMotion::Static => format!("tx{robot}_trajectory_{stamp}_.csv"),
            _ => continue,
        };
        write_file(&folder.join(name), |out| {
            let rows = (room.scene().duration_s * TRUTH_HZ).floor() as usize;
            for row in 0..=rows {
                let t_s = row as f64 / TRUTH_HZ;
                let (Some(p), Some(us)) = (room.antenna(robot, t_s), room.host_us(receiver, t_s)) else { continue };
                let (s, us) = (us.div_euclid(1_000_000), us.rem_euclid(1_000_000));
                writeln!(out, "{s}.{us:06},0.000000,{:.6},{:.6},{:.6},", p.x, p.y, p.z)?;
            }
            Ok(())
        })?;
    }
    Ok(())
}

/// The receiver's odometry, in the order in which poses came.
fn write_odometry(room: &Room, receiver: usize, folder: &Path, stamp: &str) -> Result<(), Error> {
    let Some(mut source) = room.odometry(receiver) else { return Ok(()) };
    let mut rows = Vec::new();
    let mut now = Instant::ZERO;
    loop {
        match source.receive(now)? {
            NextPose::Pose(pose) => rows.push(pose),
            NextPose::Pending => now = source.next_at().unwrap_or(now),
            NextPose::NewFrame => {}
            NextPose::End => break,
        }
    }
    write_file(&folder.join(format!("odom_rx_trajectory_{stamp}_.csv")), |out| {
        let mut before: Option<csi5300::motion::pose::Pose> = None;
        for pose in rows {
            let yaw_rad = pose.heading_rad.unwrap_or(0.0);
            let (qz, qw) = libm::sincos(0.5 * yaw_rad);
            let (mut speed, mut rate) = (0.0, 0.0);
            if let Some(before) = before.filter(|before| before.t_s < pose.t_s) {
                let step_s = pose.t_s - before.t_s;
                let along = super::maths::heading(yaw_rad).dot(&(pose.position_m - before.position_m));
                (speed, rate) = (along / step_s, (yaw_rad - before.heading_rad.unwrap_or(0.0)) / step_s);
            }
            let us = (pose.t_s * 1e6).round() as i64;
            let (s, ns) = (us.div_euclid(1_000_000), us.rem_euclid(1_000_000) * 1_000);
            let p = pose.position_m;
            write!(out, "{s}.000000,{ns}.000000,{:.6},{:.6},{:.6},0.000000,0.000000,", p.x, p.y, p.z)?;
            writeln!(out, "{qz:.6},{qw:.6},{speed:.6},0.000000,0.000000,0.000000,0.000000,{rate:.6},")?;
            before = Some(pose);
        }
        Ok(())
    })
}

/// `groundtruth_positions.json`, as the WSR toolbox reads it.
fn write_positions(room: &Room, receiver: usize, folder: &Path) -> Result<(), Error> {
    let mut places = serde_json::Map::new();
    for robot in (0..room.scene().robot.len()).filter(|&robot| robot != receiver) {
        let Some(p) = room.antenna(robot, 0.0) else { continue };
        let yaw_rad = room.pose(robot, 0.0).map_or(0.0, |Pose { yaw_rad, .. }| yaw_rad);
        let (z, w) = libm::sincos(0.5 * yaw_rad);
        let place = serde_json::json!({
            "position": { "x": p.x, "y": p.y, "z": p.z },
            "orientation": { "x": 0, "y": 0, "z": z, "w": w },
        });
        places.insert(format!("tx{robot}"), place);
    }
    let mut channel = serde_json::json!(room.scene().channel);
    // A number is that of 20 MHz, or shows no width.
    if let (40, Ok(own)) = (room.scene().bandwidth_mhz, Channel::new(room.scene().channel.into(), Width::Ht20)) {
        channel = format!("{:.0}MHz", own.centre_hz() / 1e6).into();
    }
    let all = serde_json::json!({
        "channel": { "desc": "WiFi channel; at 40 MHz and more that of the centre", "value": channel },
        "true_rx_position": { "desc": "Position of RX_SAR robot as per the dataset map", "value": 1 },
        "true_tx_positions": { "desc": "True groundtruth positions of TX for checking accuracy", "value": places },
    });
    write_file(&folder.join("groundtruth_positions.json"), |out| writeln!(out, "{all:#}"))
}

fn write_file(path: &Path, rows: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<(), Error> {
    let file = at(path, "create", File::create(path))?;
    let mut out = BufWriter::new(file);
    at(path, "write", rows(&mut out).and_then(|()| out.flush()))
}

/// Adds operation and file to an error.
fn at<T>(path: &Path, tried: &str, result: io::Result<T>) -> Result<T, Error> {
    let what = || format!("cannot {tried} {}; is the folder there, writable and on a disk with room", path.display());
    result.map_err(|source| Error::Io { what: what(), source })
}

/// `YYYY-MM-DD_HHMMSS` (UTC) of seconds since the Unix epoch, as captures are named.
#[must_use]
pub fn stamp(unix_s: i64) -> String {
    let (days, second) = (unix_s.div_euclid(86_400), unix_s.rem_euclid(86_400));
    // Days since 1 March of year 0, in the proleptic Gregorian calendar: eras of 400 years have 146,097 days.
    let days = days + 719_468;
    let (era, day) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year_of_era = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day_of_year = day - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day_of_month = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + 400 * era + i64::from(month <= 2);
    let (h, m, s) = (second / 3_600, second / 60 % 60, second % 60);
    format!("{year:04}-{month:02}-{day_of_month:02}_{h:02}{m:02}{s:02}")
}

#[cfg(test)]
mod tests {
    use super::stamp;
    use super::*;
    use crate::scene::{Cfo, Dialect, PaperCfo, Sounding};
    use csi5300::motion::odometry::csv;
    use driver_iface::bfee::Bfee;
    use driver_iface::record::{Step, events};

    #[test]
    fn stamps_are_dates() {
        assert_eq!(stamp(0), "1970-01-01_000000");
        assert_eq!(stamp(1_624_839_950), "2021-06-28_002550");
        assert_eq!(stamp(951_782_399), "2000-02-28_235959");
        assert_eq!(stamp(951_782_400), "2000-02-29_000000");
        assert_eq!(stamp(4_107_542_400), "2100-03-01_000000");
    }

    /// A folder that is removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("csi5300-{name}-{}", std::process::id()));
            let _ = std::fs::remove_dir_all(&path);
            Self(path)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn scene() -> Scene {
        Scene::from_toml(
            "duration_s = 3.0\nstart_unix_s = 1624839950\n[sounding]\nrate_hz = 100\n[radio]\nnoise.snr_db = 20.0\n\
             [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.3, duration_s = 3.0 }\nfaults.killed = true\n\
             [[robot]]\nname = \"a\"\nposition_m = [4.0, 0.0, 0.0]\n[[robot]]\nname = \"b\"\nposition_m = [0.0, 4.0, 0.0]\n\
             motion.line = { length_m = 0.5, duration_s = 3.0 }\n",
        )
        .unwrap()
    }

    /// Frame numbers by the sender's last MAC byte, and bytes that are no whole record.
    fn read(path: &Path) -> (Vec<(u8, u32)>, usize) {
        let bytes = std::fs::read(path).unwrap();
        let (mut numbers, mut whole) = (Vec::new(), 0);
        for event in events(&bytes) {
            if let Step::Record { record, .. } = event {
                let wsr = Bfee::new_checked(record.body).unwrap().wsr().unwrap();
                numbers.push((wsr.mac.0[5], wsr.frame_count.unwrap()));
                whole += record.emit_len();
            }
        }
        (numbers, bytes.len() - whole)
    }

    #[test]
    fn a_capture_folder_is_what_the_toolbox_reads() {
        let folder = Folder::new("dataset");
        let mut room = Room::new(&scene()).unwrap();
        let mut shares = Vec::new();
        let captures = write_dataset(&mut room, &folder.0, &mut |share| shares.push(share)).unwrap();
        assert_eq!(captures.len(), 1);
        let ts = "2021-06-28_002550";
        assert_eq!(captures[0].stamp, ts);

        let (rx, rest) = read(&folder.0.join(format!("csi_rx_{ts}.dat")));
        let log = &captures[0].logs[0];
        let injected = room.injected();
        assert_eq!((rx.len() as u64, rest as u64), (log.records, log.tail_bytes));
        assert_eq!(std::fs::metadata(&log.path).unwrap().len() % 4096, 0, "a killed logger leaves whole blocks");
        assert_eq!((injected[0].tail_records, injected[0].tail_bytes), (log.tail_records, log.tail_bytes));
        assert_eq!(injected[0].delivered, log.records + log.tail_records);
        assert!(log.tail_records > 0 && log.tail_bytes < 233);
        for tx in 1..=2u8 {
            let (numbers, rest) = read(&folder.0.join(format!("csi_tx{tx}_{ts}.dat")));
            assert!(rest == 0 && numbers.iter().all(|&(mac, _)| mac == 0), "only the initiator's frames");
            let answered = rx.iter().filter(|&&(mac, _)| mac == tx).map(|&(_, n)| n);
            assert!(answered.eq(numbers.iter().map(|&(_, n)| n).take(rx.iter().filter(|r| r.0 == tx).count())));
            assert!((290..=301).contains(&numbers.len()), "{}", numbers.len());
        }
        assert!(shares.len() > 50 && shares.windows(2).all(|w| w[0] < w[1]));

        let (truth, counts) = csv::read(&folder.0.join(format!("rx_trajectory_{ts}_.csv")), None).unwrap();
        assert_eq!((counts.columns, counts.rows, counts.bad_rows), (5, 601, 0));
        let pose = truth.at(1_624_839_950.0 + 1.5).unwrap();
        assert!((pose.position_m - room.pose(0, 1.5).unwrap().position_m).norm() < 1e-5);
        let (odometry, counts) = csv::read(&folder.0.join(format!("odom_rx_trajectory_{ts}_.csv")), None).unwrap();
        assert_eq!((counts.columns, counts.rows), (15, 301));
        let (at, yaw) = (odometry.at(1_624_839_951.5).unwrap(), room.pose(0, 1.5).unwrap().yaw_rad);
        assert!((csi5300::maths::wrap_rad(at.heading_rad.unwrap() - yaw)).abs() < 1e-5);
        assert!(folder.0.join(format!("tx2_trajectory_{ts}_.csv")).is_file(), "the one that moves");
        assert!(!folder.0.join(format!("tx1_trajectory_{ts}_.csv")).exists());

        let json = std::fs::read_to_string(folder.0.join("groundtruth_positions.json")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["channel"]["value"], 108);
        assert_eq!(json["true_tx_positions"]["value"]["tx1"]["position"]["x"], 4.0);
    }

    #[test]
    fn several_initiators_have_a_folder_each() {
        let folder = Folder::new("turns");
        let mut scene = scene();
        scene.sounding = Some(Sounding {
            initiators: vec!["rx".into(), "a".into()],
            dialect: Dialect::Native,
            ..Sounding::default()
        });
        scene.robot[0].faults.killed = false;
        scene.duration_s = 8.0;
        let mut room = Room::new(&scene).unwrap();
        let captures = write_dataset(&mut room, &folder.0, &mut |_| {}).unwrap();
        assert_eq!(captures.iter().map(|c| c.receiver).collect::<Vec<_>>(), [0, 1]);
        for (name, own, other) in [("rx", 0, 1), ("a", 1, 0)] {
            let dir = folder.0.join(name);
            let (back, _) = read(&dir.join("csi_rx_2021-06-28_002550.dat"));
            let (forth, _) = read(&dir.join(format!("csi_tx{other}_2021-06-28_002550.dat")));
            let answered: Vec<u32> = back.iter().filter(|r| r.0 == other).map(|r| r.1).collect();
            assert!(answered.len() > 50 && forth.iter().all(|r| r.0 == own), "{name}: {}", answered.len());
            assert!(forth.iter().map(|r| r.1).take(answered.len()).eq(answered));
        }
        let again = write_dataset(&mut room, &folder.0, &mut |_| {});
        assert!(again.unwrap_err().to_string().contains("taken before"));
    }

    #[test]
    fn a_data_set_is_the_same_on_every_machine() {
        let folder = Folder::new("bytes");
        let mut scene = scene();
        scene.robot[0].faults.killed = false;
        scene.cfo = Cfo::Paper(PaperCfo::default());
        write_dataset(&mut Room::new(&scene).unwrap(), &folder.0, &mut |_| {}).unwrap();
        let bytes = std::fs::read(folder.0.join("csi_rx_2021-06-28_002550.dat")).unwrap();
        // CRC-32 of this scene's capture when the test was written; another value means that old captures can no longer be
        // reproduced.
        assert_eq!((bytes.len(), driver_iface::mpdu::crc32(&bytes)), (139_800, 2_669_735_483));
    }
}
