//! Logs made after public reports: of cards in client and access point mode, of loggers that write whole datagrams, of other
//! senders' frames in monitor mode.

use crate::common::cases;
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use driver_iface::Mac;

/// What is counted in a log, and who sent what with which number.
/// Sender and number of each frame.
type Frames = Vec<(Mac, Option<u32>)>;

fn read(name: &str) -> Option<(Survey, Frames)> {
    let folder = cases("reports/logs")?;
    let bytes = std::fs::read(folder.join(name)).unwrap();
    let mut source = Replay::new(std::io::Cursor::new(bytes), name.to_owned());
    let (mut survey, mut heard) = (Survey::default(), Vec::new());
    loop {
        let next = source.receive(Instant::ZERO).unwrap();
        heard.extend(survey.note(&next).map(|(_, identity)| (identity.mac, identity.frame_count)));
        if matches!(next, Next::End(_)) {
            return Some((survey, heard));
        }
    }
}

#[test]
fn a_record_that_goes_on_behind_its_csi_is_read() {
    let Some((survey, heard)) = read("bfee_plus3.dat") else { return };
    assert_eq!((heard.len(), survey.longer, survey.bytes_behind_csi, survey.damages), (2, 2, 6, 0));
}

#[test]
fn frames_without_a_check_sequence_have_their_sender_in_address_2() {
    let sender: Mac = "02:53:00:00:00:01".parse().unwrap();
    for (name, frames) in [("managed_no_fcs.dat", 40), ("managed_null_only.dat", 20)] {
        let Some((survey, heard)) = read(name) else { return };
        assert_eq!((survey.mpdu_bad_fcs, survey.mpdu_without_fcs), (0, frames), "{name}");
        assert!(!heard.is_empty() && heard.iter().all(|heard| *heard == (sender, None)), "{name}: {heard:?}");
    }
}

#[test]
fn frames_of_a_network_have_no_number_and_their_sender_in_address_2() {
    for (name, sender) in [("tods_with_fcs.dat", "02:53:00:00:00:01"), ("fromds_with_fcs.dat", "02:53:00:00:00:aa")] {
        let Some((survey, heard)) = read(name) else { return };
        let sender: Mac = sender.parse().unwrap();
        assert_eq!((heard.len(), survey.mpdu_bad_fcs, survey.mpdu_without_fcs), (20, 0, 0), "{name}");
        assert!(heard.iter().all(|heard| *heard == (sender, None)), "{name}: {heard:?}");
    }
}

#[test]
fn control_frames_between_do_not_take_the_sender_away() {
    let Some((survey, heard)) = read("monitor_with_acks.dat") else { return };
    let sender: Mac = "02:53:00:00:00:01".parse().unwrap();
    assert_eq!((heard.len(), survey.mpdu_bad_fcs), (20, 0));
    assert!(heard.iter().all(|(mac, _)| *mac == sender), "{heard:?}");
}
