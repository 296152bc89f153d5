//! `csi5300 sound --answer`: answers the frames of robots that sound. Answers are given at once, from user space; with --dialect wsr
//! --ack-len N as the WSR driver gives them in the kernel. In the native dialect an answer carries what the card measured of an earlier
//! frame, so that the initiator has bearings live.

use super::super::live::Signals;
use super::super::{Result, print_json, usage};
use super::common::{DialectArg, NO_NUMBERS, Sounding, Wanted, tell};
use csi5300::exchange::tdma::Epoch;
use csi5300::internal::{Proof, Prover};
use csi5300::source::Next;
use csi5300::source::survey::Survey;
use csi5300_live::sounding::{News, Observer, Order, Running, measurement};
use csi5300_live::wait::Monotonic;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;

/// Hands the card's measurements to the answers.
struct Measuring {
    antenna: Antenna,
    peers: Vec<Mac>,
    survey: Survey,
    prover: Prover,
    carries: bool,
    told: bool,
}

impl Observer for Measuring {
    fn record(&mut self, next: &Next<'_>, running: &Running) {
        let proof = self.prover.note(next);
        let Some((bfee, identity)) = self.survey.note(next) else { return };
        if self.carries && identity.frame_count.is_none() && bfee.wsr().is_none() && !self.told {
            self.told = true;
            note!("{NO_NUMBERS}");
        }
        if self.carries
            && proof != Proof::Wrong
            && self.peers.contains(&identity.mac)
            && let Some(measurement) = measurement(&bfee, &identity, self.antenna)
        {
            // Where too many wait, the next one is newer.
            running.order(Order::Measurement(identity.mac, measurement));
        }
    }

    fn news(&mut self, news: &News) {
        tell(news);
    }
}

/// Answers until a signal or a limit ends it.
pub fn run(common: &Sounding, antenna: Antenna, json: bool) -> Result {
    if common.dialect == DialectArg::Wsr && common.ack_len.is_none() {
        usage("--dialect wsr needs --ack-len, the length of the frames meant for this robot (57 for the first)");
    }
    let signals = Signals::catch().map_err(|error| error.to_string())?;
    let clock = Monotonic::new();
    let opened = common.open(|config| (config.epoch, config.start) = (Epoch::Heard(clock.now()), clock.now()))?;
    common.see_to_rate(antenna)?;
    let carries = common.dialect == DialectArg::Native;
    let messages = common.messages(if carries { Wanted::IfPossible } else { Wanted::Not }, opened.own)?;
    let peers = common.peers.clone();
    let (survey, prover) = (Survey::with_known(peers.iter().copied()), Prover::new(opened.key.clone()));
    let mut task = Measuring { antenna, peers, survey, prover, carries, told: false };
    let (outcome, row) = common.run(&signals, messages, opened, clock, &mut task)?;
    if json {
        print_json(&row);
    }
    Ok(outcome)
}
