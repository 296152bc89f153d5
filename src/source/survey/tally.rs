//! Counts by key of consecutive records: most have the key of the one before, which avoids a map access.

use super::Survey;
use super::bounds::SENDERS_KEPT;

/// Counts that are not in a [`Survey`]'s maps yet: of the last code, antennas and rate, how many records had them.
#[doc(hidden)]
#[derive(Debug, Default)]
pub struct Tally {
    code: (u8, u64),
    antenna_sel: (u8, u64),
    rate: (u16, u64),
}

/// Counts one more of `key`; gives the key before with its count, where it is another.
#[inline(always)]
fn count<K: Copy + PartialEq>(run: &mut (K, u64), key: K) -> Option<(K, u64)> {
    if run.0 == key {
        run.1 += 1;
        return None;
    }
    let before = std::mem::replace(run, (key, 1));
    (before.1 > 0).then_some(before)
}

impl Survey {
    /// Counts a record's code.
    #[inline(always)]
    pub(super) fn tally_code(&mut self, tally: &mut Tally, code: u8) {
        if let Some((code, records)) = count(&mut tally.code, code) {
            *self.by_code.entry(code).or_default() += records;
        }
    }

    /// Counts a bfee record's antennas and rate.
    #[inline(always)]
    pub(super) fn tally_bfee(&mut self, tally: &mut Tally, antenna_sel: u8, rate: u16) {
        if let Some((antenna_sel, records)) = count(&mut tally.antenna_sel, antenna_sel) {
            *self.antenna_sel.entry(antenna_sel).or_default() += records;
        }
        if let Some((rate, records)) = count(&mut tally.rate, rate) {
            self.count_rate(rate, records);
        }
    }

    /// Puts into the maps what [`Survey::note_in`] counted. The tally is empty then.
    #[doc(hidden)]
    pub fn settle(&mut self, tally: &mut Tally) {
        let Tally { code, antenna_sel, rate } = std::mem::take(tally);
        if code.1 > 0 {
            *self.by_code.entry(code.0).or_default() += code.1;
        }
        if antenna_sel.1 > 0 {
            *self.antenna_sel.entry(antenna_sel.0).or_default() += antenna_sel.1;
        }
        if rate.1 > 0 {
            self.count_rate(rate.0, rate.1);
        }
    }

    fn count_rate(&mut self, rate: u16, records: u64) {
        if self.rates.len() < SENDERS_KEPT || self.rates.contains_key(&rate) {
            *self.rates.entry(rate).or_default() += records;
        }
    }
}
