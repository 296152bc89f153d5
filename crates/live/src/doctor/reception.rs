//! Checks on the records of a short reception.

use super::Check;
use csi5300::source::Next;
use csi5300::source::survey::Survey;
use driver_iface::bfee::{ALL_SUBCARRIERS, Iq, SUBCARRIERS};
use driver_iface::record::code;

/// A running reception.
#[derive(Debug, Default)]
pub struct Reception {
    /// Everything counted.
    pub survey: Survey,
    zero_csi: u64,
    nrx_steps: u64,
    last_nrx: Option<usize>,
    unnumbered: u64,
}

impl Reception {
    /// Counts an item of a source.
    pub fn note(&mut self, next: &Next<'_>) {
        let Some((bfee, identity)) = self.survey.note(next) else { return };
        let mut iq = [Iq::default(); SUBCARRIERS];
        let silent = |iq: &[Iq]| iq.iter().all(|iq| iq.i == 0 && iq.q == 0);
        let mut all_zero = true;
        for chain in 0..bfee.n_rx() {
            all_zero &= bfee.column(chain, 0, &ALL_SUBCARRIERS, &mut iq).is_none() || silent(&iq);
        }
        self.zero_csi += u64::from(all_zero);
        self.nrx_steps += u64::from(self.last_nrx.is_some_and(|last| last != bfee.n_rx()));
        self.last_nrx = Some(bfee.n_rx());
        self.unnumbered += u64::from(identity.frame_count.is_none());
    }

    /// Its checks, the worst first; one good check without problems.
    #[must_use]
    pub fn checks(&self) -> Vec<Check> {
        let name = "reception";
        let expected = "bfee records with CSI from known senders";
        let survey = &self.survey;
        let bfees = survey.bfees();
        if survey.records == 0 {
            return vec![Check::bad(name, "nothing", expected).mend(
                "is another robot sending HT frames to and from 00:16:ea:12:34:56 on this channel and width? If the \
                 checks above are good, look for a firmware crash in `sudo dmesg`",
            )];
        }
        if bfees == 0 {
            let only_frames = survey.by_code.keys().all(|code| *code == code::MPDU);
            let found = match only_frames {
                true => {
                    "only frames (0xC1), no CSI (0xBB): none of them is HT, or none goes to and from 00:16:ea:12:34:56"
                }
                false => "messages of the driver, but no CSI among them",
            };
            return vec![Check::bad(name, found, expected).mend("on the sender: `echo 0x4101` into monitor_tx_rate")];
        }
        let mut checks = self.doubts(name, expected, bfees);
        if checks.is_empty() {
            let senders = survey.senders.len();
            checks.push(Check::good(name, format!("{bfees} bfee records, {senders} senders"), expected));
        }
        checks
    }

    fn doubts(&self, name: &'static str, expected: &str, bfees: u64) -> Vec<Check> {
        let survey = &self.survey;
        let mut checks = Vec::new();
        if self.zero_csi > 0 {
            let verdict = if self.zero_csi == bfees { Check::bad } else { Check::doubt };
            let found = format!("{} of {bfees} records have only zeros as CSI", self.zero_csi);
            checks.push(verdict(name, found, expected).mend("reload the driver; if it stays, try another card"));
        }
        if survey.bad_bfee > 0 {
            checks.push(Check::doubt(name, format!("{} contradictory bfee records", survey.bad_bfee), expected));
        }
        if self.unnumbered == bfees {
            checks.push(
                Check::doubt(
                    name,
                    "no record names its sender: the csitool driver without connector_log bit 0x4",
                    expected,
                )
                .mend("use the WSR driver, or connector_log=0x5, to tell senders apart"),
            );
        } else if self.unnumbered * 2 > bfees {
            let found = format!("{} of {bfees} records from unknown senders", self.unnumbered);
            checks.push(Check::doubt(name, found, expected));
        }
        let connected = survey.rssi.iter().filter(|range| range.max > 0).count();
        if connected == 1 {
            checks.push(
                Check::doubt(name, "only one antenna receives", expected)
                    .mend("enough for bearings from motion; otherwise check the pigtails and rx_chains_msk (0x7)"),
            );
        }
        if self.nrx_steps * 20 > bfees {
            let found = format!("the number of receive chains changes {} times in {bfees} records", self.nrx_steps);
            checks.push(
                Check::doubt(name, found, expected)
                    .mend("connect all three antennas, or fix rx_chains_msk to one number"),
            );
        }
        if survey.overruns > 0 || survey.bfee_missing * 100 > bfees {
            let found =
                format!("{} overruns, {} numbers missing from bfee_count", survey.overruns, survey.bfee_missing);
            checks.push(
                Check::doubt(name, found, expected)
                    .mend("a larger --receive-buffer of `record`; fewer programs on this host"),
            );
        }
        checks
    }
}
