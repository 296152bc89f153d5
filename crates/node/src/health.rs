//! The state of a running robot, for the status socket and `csi5300 watch`.

use super::machine::{Machine, PoseCounts};
use super::team::TeamState;
use csi5300::internal::SENDERS_KEPT;
use csi5300::motion::odometry::SourceCounts;
use csi5300::pipeline::live::{AdmissionCounts, PeerCounts, PeerReport};
use csi5300::source::recorder::Totals;
use csi5300::time::{Instant, Span};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The state, as one JSON object.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Health {
    /// This robot.
    pub name: String,
    /// Seconds since it was started.
    pub uptime_s: f64,
    /// Records of this robot's card, and those a second.
    pub records: u64,
    /// Records a second.
    pub records_hz: f64,
    /// Losses reported on the way from the card: overruns, damaged records.
    pub losses: u64,
    /// Numbers missing from `bfee_count`.
    pub missing: u64,
    /// Frames of senders that are no peers.
    pub strangers: u64,
    /// Times that one of them was dropped for another.
    pub strangers_forgotten: u64,
    /// Odometry.
    pub poses: PoseCounts,
    /// Counts of the poses' source: serial line, controller, wheels.
    pub odometry: Option<SourceCounts>,
    /// Poses a second.
    pub poses_hz: f64,
    /// The newest pose: seconds since the Unix epoch, x, y, z in metres, heading in degrees.
    pub pose: Option<(f64, [f64; 3], Option<f64>)>,
    /// The log.
    pub log: Option<Totals>,
    /// The peers, then other senders whose bearings are made of what is heard alone.
    pub peers: Vec<PeerHealth>,
    /// The team's poses, if a graph of it is configured.
    pub team: Option<TeamState>,
    /// Counts of the robots' network.
    pub network: Option<serde_json::Value>,
    /// Counts of this robot's part in the sounding exchange.
    pub sounding: Option<serde_json::Value>,
    /// Counts of ROS outputs.
    pub ros: Option<serde_json::Value>,
    /// Counts of ROS 2 inputs and outputs.
    pub ros2: Option<serde_json::Value>,
    /// Its load.
    pub load: Load,
    /// Current problems, in words.
    pub trouble: Vec<String>,
}

/// The state of one peer.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PeerHealth {
    /// Its name.
    pub name: String,
    /// Its MAC.
    pub mac: String,
    /// What was counted.
    pub counts: PeerCounts,
    /// Pairs a second.
    pub pairs_hz: f64,
    /// Its last report.
    pub report: Option<PeerReport>,
}

/// The load of a robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Share of one core since the last state, percent.
    pub cpu_percent: f64,
    /// Time of the last estimate, milliseconds.
    pub estimate_ms: f64,
    /// The longest estimate so far, milliseconds.
    pub longest_estimate_ms: f64,
    /// Resident memory, MiB.
    pub memory_mib: f64,
    /// Worst timer lateness since the last state, milliseconds.
    pub late_ms: f64,
    /// Lines of bearings that could not be written.
    pub lines_lost: u64,
}

/// How long an alarm lasts after its last count.
const ALARM_LASTS: Span = Span::from_ms(60_000);

/// Records that no exchange confirms, from which on something is wrong.
const UNCONFIRMED: u64 = 32;

/// A count that is an alarm while it rises, and for a minute after.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Alarm {
    count: u64,
    at: Option<Instant>,
}

impl Alarm {
    /// True while the alarm lasts.
    pub fn is_on(&mut self, count: u64, now: Instant) -> bool {
        if count > self.count {
            (self.count, self.at) = (count, Some(now));
        }
        self.at.is_some_and(|at| now - at < ALARM_LASTS)
    }
}

/// All alarms.
#[derive(Clone, Debug, Default)]
struct Alarms {
    crowd: Alarm,
    unauthenticated: Alarm,
    contested: Vec<Alarm>,
}

impl Alarms {
    /// What is wrong, in words.
    fn look(&mut self, machine: &Machine, now: Instant) -> Vec<String> {
        let front = machine.estimator.own_log();
        let (forgotten, unauthenticated) = (front.survey.senders_forgotten, front.unused.unauthenticated);
        let mut words = Vec::new();
        if let Some(silent) = machine.silent_for(now) {
            words.push(format!(
                "no record from this robot's card for {:.0} s: `csi5300 doctor` looks for the reason",
                silent.as_s()
            ));
        }
        if self.crowd.is_on(forgotten, now) {
            words.push(format!(
                "more than {SENDERS_KEPT} senders on this channel ({forgotten} were forgotten): a busy channel, or frames \
                 with made-up addresses; peers are still heard"
            ));
        }
        if self.unauthenticated.is_on(unauthenticated, now) {
            words.push(format!(
                "{unauthenticated} frames with numbers of the exchange and without its key were measured and skipped"
            ));
        }
        self.contested.resize(machine.estimator.peers().count(), Alarm::default());
        for (alarm, (peer, counts)) in self.contested.iter_mut().zip(machine.estimator.peers()) {
            let AdmissionCounts { contested, unconfirmed, .. } = counts.refused;
            words.extend((counts.pairs == 0).then(|| unconfirmed_words(&peer.name, unconfirmed)).flatten());
            if alarm.is_on(contested, now) {
                words.push(format!(
                    "{}: {contested} exchanges have two records: somebody sends in its name or in this robot's; none of \
                     them is used",
                    peer.name
                ));
            }
        }
        words
    }
}

/// What is wrong if none of a peer's records is of an exchange that the scheduler saw, in words. The first ones may come before it.
fn unconfirmed_words(peer: &str, unconfirmed: u64) -> Option<String> {
    (unconfirmed >= UNCONFIRMED).then(|| {
        format!("{peer}: {unconfirmed} records, none of a confirmed exchange: are its [sounding] and its key those of this robot?")
    })
}

/// Makes states, with rates since the last one.
#[derive(Clone, Debug, Default)]
pub struct Looks {
    name: String,
    /// The last state.
    last: Health,
    alarms: Alarms,
    /// The last report of each peer.
    reports: BTreeMap<usize, PeerReport>,
}

impl Looks {
    /// A monitor of the robot `name`.
    pub fn new(name: String) -> Self {
        Self { name, ..Self::default() }
    }

    /// Keeps a peer's last report.
    pub fn note(&mut self, peer: usize, report: PeerReport) {
        self.reports.insert(peer, report);
    }

    /// The state now.
    pub fn look(&mut self, machine: &Machine, now: Instant, load: Load) -> Health {
        let survey = &machine.estimator.own_log().survey;
        let (losses, strangers) = machine.estimator.losses();
        let poses = machine.pose_counts;
        let before = std::mem::take(&mut self.last);
        let seconds = (now.as_s() - before.uptime_s).max(1e-6);
        let rate = |now: u64, before: u64| (now - before.min(now)) as f64 / seconds;
        let peers = machine.estimator.peers().map(|(peer, counts)| (peer.name.as_str(), peer.mac, counts));
        let peers = peers.chain(machine.estimator.others()).enumerate().map(|(k, (name, mac, counts))| PeerHealth {
            name: name.to_owned(),
            mac: mac.to_string(),
            counts,
            pairs_hz: rate(counts.pairs, before.peers.get(k).map_or(0, |peer| peer.counts.pairs)),
            report: self.reports.get(&k).cloned(),
        });
        let pose = machine.estimator.track().last();
        let health = Health {
            name: self.name.clone(),
            uptime_s: now.as_s(),
            records: survey.came(),
            records_hz: rate(survey.came(), before.records),
            losses,
            missing: survey.bfee_missing,
            strangers,
            strangers_forgotten: survey.senders_forgotten,
            poses,
            odometry: machine.odometry_counts(),
            poses_hz: rate(poses.poses, before.poses.poses),
            pose: pose.map(|pose| (pose.t_s, pose.position_m.into(), pose.heading_rad.map(f64::to_degrees))),
            log: machine.totals(),
            peers: peers.collect(),
            load,
            trouble: machine.trouble().into_iter().chain(self.alarms.look(machine, now)).collect(),
            ..Health::default()
        };
        self.last.clone_from(&health);
        health
    }
}

impl Health {
    /// Everything on one line.
    pub fn line(&self) -> String {
        let mut text = format!("{:.0} records/s, {:.0} poses/s", self.records_hz, self.poses_hz);
        let disk = self.log.as_ref().map_or(0, |log| log.dropped + log.lost_on_disk);
        if self.poses.refused > 0 {
            let _ = write!(text, " ({} refused)", self.poses.refused);
        }
        let _ = write!(text, "; lost {}", self.losses + disk);
        for peer in &self.peers {
            let _ = write!(text, "; {} ", peer.name);
            match peer.report.as_ref().map(|report| (report.answer.azimuth_deg, &report.words)) {
                Some((Some(azimuth), _)) => text += &format!("{azimuth:.1} deg"),
                Some((None, words)) => text.push_str(words),
                None => text.push('-'),
            }
        }
        let _ = write!(text, "; {:.0} % of a core", self.load.cpu_percent);
        if let Some(trouble) = self.trouble.first() {
            let _ = write!(text, "; {trouble}");
        }
        text
    }

    /// The losses, each count with its name; empty without losses.
    #[must_use]
    pub fn lost(&self) -> Vec<String> {
        let disk = self.log.as_ref().map_or(0, |log| log.dropped + log.lost_on_disk);
        let unsent = self.network.as_ref().and_then(|network| network.get("unsent")?.as_u64()).unwrap_or(0);
        let unrecorded = self.ros2.as_ref().and_then(|ros| ros.get("bag")?.get("lost")?.as_u64()).unwrap_or(0);
        let mut counts = vec![
            (self.losses, "losses of records heard here".to_owned()),
            (disk, "records missing in the log".to_owned()),
            (unsent, "messages not sent".to_owned()),
            (unrecorded, "messages missing in the recording".to_owned()),
            (self.load.lines_lost, "lines not written".to_owned()),
            (self.poses.incomplete, "trajectories with skipped rows".to_owned()),
        ];
        counts.extend(self.peers.iter().map(|peer| (peer.counts.losses, format!("losses of {}'s records", peer.name))));
        counts.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_alarm_lasts_a_minute_after_its_last_count() {
        let mut alarm = Alarm::default();
        let mut at = |count, s: i64| alarm.is_on(count, Instant::from_us(s * 1_000_000));
        let lasts = [at(0, 0), at(1, 1), at(1, 60), at(2, 60), at(2, 119), at(2, 120)];
        assert_eq!(lasts, [false, true, true, true, true, false]);
    }

    #[test]
    fn the_line_tells_poses_that_are_not_used() {
        let mut health = Health { poses_hz: 50.0, ..Health::default() };
        assert!(health.line().starts_with("0 records/s, 50 poses/s; lost 0"));
        health.poses.refused = 3;
        assert!(health.line().starts_with("0 records/s, 50 poses/s (3 refused); lost 0"));
    }

    #[test]
    fn records_of_another_key_are_said() {
        assert_eq!(unconfirmed_words("b", UNCONFIRMED - 1), None);
        assert!(
            unconfirmed_words("b", UNCONFIRMED).unwrap().starts_with("b: 32 records, none of a confirmed exchange")
        );
    }

    #[test]
    fn what_the_recording_lacks_is_lost() {
        let health = Health { ros2: Some(serde_json::json!({ "bag": { "lost": 3 } })), ..Health::default() };
        assert_eq!(health.lost(), ["3 messages missing in the recording"]);
    }
}
