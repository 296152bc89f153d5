//! Claims decided by the kernel module's counters.

use super::{Needs, Told};
use crate::collect::Evidence;

/// Growth of the counters, in the order of the names; or why it is unknown.
fn grown<const N: usize>(evidence: &Evidence, names: [&str; N]) -> Result<[u64; N], Told> {
    if evidence.counters.is_empty() {
        return Err(Told::needs(Needs::Module));
    }
    let of = |name: &str| evidence.counters.iter().find(|(known, _)| known == name).map(|(_, more)| *more);
    let found = names.map(of);
    match found.iter().position(Option::is_none) {
        Some(at) => Err(Told::not_tried(format!(
            "the module has no counter `{}`: it is of another version",
            names.get(at).unwrap_or(&"")
        ))),
        None => Ok(found.map(Option::unwrap_or_default)),
    }
}

pub(super) fn csi(evidence: &Evidence) -> Told {
    match grown(evidence, ["phy", "bfee", "records"]) {
        Err(told) => told,
        Ok([0, 0, _]) => Told::not_tried("no frame was heard meanwhile"),
        Ok([phy, bfee, records]) => Told::decided(
            bfee > 0 && records > 0,
            format!("{phy} frames heard, {bfee} with CSI, {records} records made"),
        )
        .with("bfee", bfee as f64, ""),
    }
}

/// A counter that must not grow while CSI comes.
fn stays_zero<const N: usize>(evidence: &Evidence, names: [&str; N]) -> Told {
    let bfee = match grown(evidence, ["bfee"]) {
        Err(told) => return told,
        Ok([0]) => return Told::not_tried("no CSI came meanwhile: see module.csi"),
        Ok([bfee]) => bfee,
    };
    match grown(evidence, names) {
        Err(told) => told,
        Ok(counts) => {
            let words: Vec<String> = names.iter().zip(counts).map(|(name, count)| format!("{name} +{count}")).collect();
            Told::decided(counts.iter().all(|count| *count == 0), format!("{} of {bfee} with CSI", words.join(", ")))
        }
    }
}

pub(super) fn marked(evidence: &Evidence) -> Told {
    stays_zero(evidence, ["unmarked"])
}

pub(super) fn order(evidence: &Evidence) -> Told {
    stays_zero(evidence, ["no_order"])
}

pub(super) fn layout(evidence: &Evidence) -> Told {
    stays_zero(evidence, ["bad_bfee", "bad_phy"])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::{Collector, Plan};
    use crate::report::Verdict::{Fails, Holds, NotTried};

    fn verdicts(counters: &[(&str, u64)]) -> [crate::report::Verdict; 4] {
        let mut collector = Collector::new(Plan::new("64".parse().unwrap()));
        counters.iter().for_each(|(name, more)| collector.counted(name, *more));
        let evidence = collector.finish();
        [csi, marked, order, layout].map(|check| check(&evidence).verdict)
    }

    #[test]
    fn counters_are_read() {
        assert_eq!(verdicts(&[]), [NotTried; 4]);
        let good = [
            ("phy", 900),
            ("bfee", 800),
            ("records", 800),
            ("unmarked", 0),
            ("no_order", 0),
            ("bad_bfee", 0),
            ("bad_phy", 0),
        ];
        assert_eq!(verdicts(&good), [Holds; 4]);
        let deaf = [("phy", 900), ("bfee", 0), ("records", 0), ("unmarked", 0)];
        assert_eq!(verdicts(&deaf), [Fails, NotTried, NotTried, NotTried]);
        let bad = [
            ("phy", 900),
            ("bfee", 800),
            ("records", 800),
            ("unmarked", 800),
            ("no_order", 3),
            ("bad_bfee", 0),
            ("bad_phy", 1),
        ];
        assert_eq!(verdicts(&bad), [Holds, Fails, Fails, Fails]);
    }
}
