use super::*;
use csi5300::motion::odometry::csv;
use driver_iface::bfee::Bfee;
use driver_iface::record::{Step, events};
use std::path::{Path, PathBuf};

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

    let (truth, counts) = csv::read(&folder.0.join(format!("rx_trajectory_{ts}_.csv"))).unwrap();
    assert_eq!((counts.columns, counts.rows, counts.bad_rows), (5, 601, 0));
    let pose = truth.at(1_624_839_950.0 + 1.5).unwrap();
    assert!((pose.position_m - room.pose(0, 1.5).unwrap().position_m).norm() < 1e-5);
    let (odometry, counts) = csv::read(&folder.0.join(format!("odom_rx_trajectory_{ts}_.csv"))).unwrap();
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
    scene.sounding = Some(scene::Sounding {
        initiators: vec!["rx".into(), "a".into()],
        dialect: scene::Dialect::Native,
        ..scene::Sounding::default()
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
    scene.cfo = scene::Cfo::Paper(scene::PaperCfo::default());
    write_dataset(&mut Room::new(&scene).unwrap(), &folder.0, &mut |_| {}).unwrap();
    let bytes = std::fs::read(folder.0.join("csi_rx_2021-06-28_002550.dat")).unwrap();
    // CRC-32 of this scene's capture when the test was written; another value means that old captures can no longer be
    // reproduced.
    assert_eq!((bytes.len(), driver_iface::mpdu::crc32(&bytes)), (139_800, 2_669_735_483));
}
