//! Transmitters located from several stretches of simulated drives, whose frame is one.

use csi5300::pipeline::Options;
use csi5300_lab::evaluate::transmitters::{Frame, Located, located};
use csi5300_lab::evaluate::{Capture, TrajectorySource, find};
use csi5300_lab::rooms;
use std::collections::BTreeMap;
use std::path::Path;

#[test]
fn transmitters_in_sight_are_where_several_stretches_say_and_in_their_ellipses() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("together");
    let _ = std::fs::remove_dir_all(&folder);
    rooms::write_drives(&folder, 2, 1).unwrap();
    let (captures, _) = find(&folder.join("drives_LOS"));
    let options = Options::new("108".parse().unwrap());
    let of = |captures: &[Capture], frame: Frame| -> Vec<Located> {
        let one = |capture: &Capture| {
            let found = capture.motions(TrajectorySource::GroundTruth, None, &options, 4, frame);
            assert!(found.motions.len() >= 11, "{:?}", found.failed);
            located(&found.motions, &BTreeMap::new())
        };
        captures.iter().flat_map(one).collect()
    };
    let here = of(&captures, Frame::default());
    let there = of(&captures[..1], Frame { origin_m: [20.0, -5.0], yaw_rad: 2.0 });
    assert_eq!((here.len(), there.len()), (6, 3));
    for one in &here {
        println!("{one:?}");
        assert!(one.off_m.unwrap() < 0.6 && one.share.unwrap() > 0.5 && one.motions >= 3, "{one:?}");
    }
    let within = here.iter().filter(|one| one.within == Some(true)).count();
    // 68 % of places at least: evidence in sight is better than it says.
    assert!(within >= 4, "{within} of 6");
    // In another frame everything is as far from the truth, which is moved with it.
    for (here, there) in here.iter().zip(&there) {
        let moved = here.off_m.unwrap() - there.off_m.unwrap();
        assert!(moved.abs() < 0.15, "{here:?} {there:?}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
