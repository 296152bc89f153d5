//! Measures one pair: sizes of its messages, and processor time of its estimate.

use crate::Fallible;
use csi5300::driver_iface::record::Record;
use csi5300::motion::odometry::{NextPose, OdometrySource};
use csi5300::motion::pose::Pose;
use csi5300::pipeline::Options;
use csi5300::pipeline::live::{LiveEstimator, LivePeer, LiveSettings, PeerState, Track};
use csi5300::signal::channel::Channel;
use csi5300::source::remote::Batch;
use csi5300::source::{CsiSource, Next, Stamps};
use csi5300::time::{Instant, Span};
use csi5300_sim::motion::{Circle, RobotMotion};
use csi5300_sim::{Room, Scene};
use std::fs::{read_dir, read_to_string};

/// Costs of a pair.
#[derive(Debug)]
pub struct Pair {
    /// Size of a record and of a pose as the node publishes them, each in its own message, bytes.
    pub record_bytes: f64,
    pub pose_bytes: f64,
    /// Size of a bearing's report as a line of JSON, bytes.
    pub line_bytes: f64,
    pub poses_hz: f64,
    /// Processor time of a record and of a bearing, seconds.
    pub record_s: f64,
    pub bearing_s: f64,
}

enum Item {
    Pose(Option<Pose>),
    Record { own: bool, stamps: Stamps, code: u8, body: Vec<u8> },
}

/// Measures two turns of the circle in the scene `lab-circle`, with 100 exchanges a second; the other robot stands.
pub fn measure(channel: Channel) -> Fallible<Pair> {
    let mut scene = Scene::built_in("lab-circle").ok_or("no scene lab-circle")?;
    scene.duration_s = 60.0;
    let circle = Circle { radius_m: 0.296, duration_s: 54.0, turns: 2.0, start_s: 1.2 };
    scene.robot[0].motion = RobotMotion::Circle(circle);
    let mut room = Room::new(&scene)?;
    let (own, peer) = room.mac(0).zip(room.mac(1)).ok_or("no robots")?;
    let items = items(&mut room)?;
    let run = |polls: bool| -> Fallible<(f64, Vec<usize>)> {
        let track = Track::still(scene.robot[1].position_m.into(), 0.0);
        let told = LivePeer { name: "tx".into(), mac: peer, track, yaw_rad: 0.0 };
        let (settings, options) = (LiveSettings::new(channel.wavelength_m()), Options::new(channel));
        let mut live = LiveEstimator::new(own, Track::default(), vec![told], settings, options, Instant::ZERO);
        let (mut lines, began_s) = (Vec::new(), processor_s()?);
        for (now, item) in &items {
            match item {
                Item::Pose(pose) => live.handle_pose(*pose),
                Item::Record { own, stamps, code, body } => {
                    let next = Next::Record(*stamps, Record { code: *code, body });
                    if *own { live.handle_own(&next) } else { live.handle_peer(0, &next) }
                }
            }
            while let Some((_, report)) = polls.then(|| live.poll_report(*now)).flatten() {
                if report.state == PeerState::Bearing {
                    lines.push(serde_json::to_string(&report)?.len() + 1);
                }
            }
        }
        Ok((processor_s()? - began_s, lines))
    };
    let ((taking_s, _), (all_s, lines)) = (run(false)?, run(true)?);
    let (mut poses, mut records) = (Vec::new(), Vec::new());
    for (_, item) in &items {
        match item {
            Item::Pose(Some(pose)) => poses.push(pose_message(*pose).len()),
            Item::Record { stamps, code, body, .. } => {
                records.push(record_message(stamps.host_us, Record { code: *code, body }).len());
            }
            Item::Pose(None) => {}
        }
    }
    let mean = |bytes: &[usize]| bytes.iter().sum::<usize>() as f64 / bytes.len().max(1) as f64;
    Ok(Pair {
        record_bytes: mean(&records),
        pose_bytes: mean(&poses),
        line_bytes: mean(&lines),
        poses_hz: poses.len() as f64 / scene.duration_s,
        record_s: taking_s / records.len().max(1) as f64,
        bearing_s: (all_s - taking_s) / lines.len().max(1) as f64,
    })
}

/// The poses of the first robot and the records of both, in time order.
fn items(room: &mut Room) -> Fallible<Vec<(Instant, Item)>> {
    let end_s = room.scene().duration_s;
    let mut robot = room.backend(0).ok_or("no robot")?;
    let mut peer = room.card(1).ok_or("no peer")?;
    let (mut items, mut now) = (Vec::new(), Instant::ZERO);
    while now.as_s() < end_s {
        while let next @ (NextPose::Pose(_) | NextPose::NewFrame) = robot.odometry.receive(now)? {
            items.push((now, Item::Pose(if let NextPose::Pose(pose) = next { Some(pose) } else { None })));
        }
        for (own, card) in [(true, &mut robot.card), (false, &mut peer)] {
            while let Next::Record(stamps, Record { code, body }) = card.receive(now)? {
                items.push((now, Item::Record { own, stamps, code, body: body.to_vec() }));
            }
        }
        let next = [robot.card.next_at(), peer.next_at(), robot.odometry.next_at()].into_iter().flatten().min();
        now = next.ok_or("nothing comes before the end")?.max(now + Span::from_us(1));
    }
    Ok(items)
}

fn record_message(host_us: Option<i64>, record: Record<'_>) -> Vec<u8> {
    let mut batch = Batch::records(1);
    batch.push_record(host_us, record);
    batch.take()
}

fn pose_message(pose: Pose) -> Vec<u8> {
    let mut batch = Batch::poses(1);
    batch.push_pose(1, pose);
    batch.take()
}

/// Processor time of this program so far, all threads, seconds.
fn processor_s() -> Fallible<f64> {
    let mut all_ns = 0;
    for task in read_dir("/proc/self/task")? {
        let text = read_to_string(task?.path().join("schedstat"))?;
        all_ns += text.split(' ').next().ok_or("no schedstat")?.parse::<u64>()?;
    }
    Ok(all_ns as f64 * 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::source::remote::Mailbox;

    #[test]
    fn a_peer_can_read_the_messages() {
        let record = Record { code: 0xbb, body: &[7; 213] };
        let pose = Pose { t_s: 1.0, position_m: nalgebra::Vector3::zeros(), heading_rad: None };
        for message in [record_message(Some(1), record), pose_message(pose)] {
            let mailbox = Mailbox::new(4);
            mailbox.put_at(Instant::ZERO, &message);
            assert_eq!((mailbox.counts().received, mailbox.counts().foreign), (1, 0));
        }
        assert_eq!(record_message(None, record).len(), 16 + 8 + record.emit_len());
    }
}
