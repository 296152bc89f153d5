//! Recorded logs at their own pace.

use super::{Card, Opened};
use crate::NodeError;
use crate::config::Replay as Asked;
use crate::together::{self, Begin};
use csi5300::source::replay::Paced;
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use driver_iface::Mac;
use std::path::Path;

/// Records of a log in which a host time is looked for.
const LOOKED_AT: usize = 4_096;

/// This robot's replayed log.
pub(super) struct Replayed<'a> {
    file: &'a Path,
    /// Its MAC, if that is known.
    own: Option<Mac>,
    /// Host time at which the log begins, seconds.
    pub(super) origin_s: f64,
}

/// This robot's log.
pub(super) fn open(asked: &Asked, own: Option<Mac>) -> Result<(Opened, Replayed<'_>), Error> {
    let origin_s = first_host_s(&asked.file)?;
    let card = Box::new(Paced::new(Replay::open(&asked.file)?, 1.0, None));
    let replayed = Replayed { file: &asked.file, own, origin_s };
    Ok((Opened { card, wake: None, mac: None, speed: asked.speed }, replayed))
}

/// A peer's log, to be played together with this robot's.
pub(super) fn peer(log: &Path, peer: Option<Mac>, own: Option<&Replayed<'_>>, start: Instant) -> Result<Card, Error> {
    let mut replay = Replay::open(log)?;
    let mut begin = Begin::default();
    if let Some((own, (own_mac, peer))) = own.and_then(|own| Some((own, own.own.zip(peer)?))) {
        begin = together::begin(|| Replay::open(own.file), || Replay::open(log), (own_mac, peer))?;
    }
    for _ in 0..begin.skip {
        replay.receive(start)?;
    }
    Ok(Box::new(Paced::new(replay, 1.0, None).beginning(start + begin.after)))
}

/// The host time of a log's first record that has one, seconds since the Unix epoch.
fn first_host_s(log: &Path) -> Result<f64, Error> {
    let mut source = Replay::open(log)?;
    let mut survey = Survey::default();
    for _ in 0..LOOKED_AT {
        let next = source.receive(Instant::ZERO)?;
        let ended = matches!(next, Next::End(_));
        if let Some(host_us) = survey.note(&next).and_then(|(_, identity)| identity.host_us) {
            return Ok(host_us as f64 * 1e-6);
        }
        if ended {
            break;
        }
    }
    Err(NodeError::NoHostTime { log: log.to_owned() }.into())
}
