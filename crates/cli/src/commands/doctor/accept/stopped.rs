//! The finished parts of an interrupted run, kept in the report's folder; the same command continues from them.

use super::live::Step;
use csi5300_accept::{Collector, Evidence, Side};
use driver_iface::bfee::Antenna;
use std::path::Path;

/// Its file, beside the logs.
pub(super) const FILE: &str = "stopped.json";

/// What the finished parts of a run leave besides their logs.
#[derive(Debug, serde::Deserialize, serde::Serialize)]
pub(super) struct Stopped {
    /// The run's channel and parts: only the same run may continue it.
    asked: String,
    /// Parts that are finished, from the first on.
    pub finished: usize,
    /// How late the host woke meanwhile, microseconds.
    lateness_us: Vec<f64>,
    /// By how much each counter of the kernel module grew.
    counters: Vec<(String, u64)>,
}

/// The log of a run without an antenna.
pub(super) fn unplugged(antenna: Antenna) -> String {
    format!("unplugged-{antenna:?}.dat")
}

impl Stopped {
    /// The state after this many parts; `None` if it cannot be continued. Everything before the first antenna is one part.
    pub(super) fn after(finished: usize, steps: &[Step], asked: String, evidence: &Evidence) -> Option<Self> {
        let (lateness_us, counters) = (evidence.lateness_us.clone(), evidence.counters.clone());
        (finished >= first(steps)).then_some(Self { asked, finished, lateness_us, counters })
    }

    /// What a run with the same channel and parts left in a folder.
    pub(super) fn read(folder: &Path, asked: &str, steps: &[Step]) -> Option<Self> {
        let stopped: Self = serde_json::from_slice(&std::fs::read(folder.join(FILE)).ok()?).ok()?;
        (stopped.asked == asked && (first(steps)..=steps.len()).contains(&stopped.finished)).then_some(stopped)
    }

    /// Hands over what was measured.
    pub(super) fn take_up(&self, folder: &Path, steps: &[Step], collector: &mut Collector) -> Result<(), String> {
        let log = |name: &str| {
            let path = folder.join(name);
            std::fs::read(&path)
                .map_err(|error| format!("{}: {error}; without {FILE} the run restarts", path.display()))
        };
        collector.log(Side::Near, &log("near.dat")?);
        if folder.join("far.dat").exists() {
            collector.log(Side::Far, &log("far.dat")?);
        }
        for step in steps.iter().take(self.finished) {
            if let Step::Unplug(antenna) = step {
                collector.unplugged_log(*antenna, &log(&unplugged(*antenna))?);
            }
        }
        self.lateness_us.iter().for_each(|us| collector.woke_late(csi5300::time::Span::from_us(*us as i64)));
        Ok(())
    }

    /// By how much a counter of the module grew.
    pub(super) fn counted(&self, name: &str) -> u64 {
        self.counters.iter().find(|(known, _)| known == name).map_or(0, |(_, count)| *count)
    }
}

/// Parts before the first antenna is unplugged.
fn first(steps: &[Step]) -> usize {
    steps.iter().take_while(|step| !matches!(step, Step::Unplug(_))).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::time::Span;
    use csi5300_accept::Plan;

    #[test]
    fn only_the_same_run_goes_on_with_whole_parts() {
        let steps = [Step::Listen(Span::from_s(1.0)), Step::Unplug(Antenna::B), Step::Unplug(Antenna::C)];
        let mut collector = Collector::new(Plan::new("64".parse().unwrap()));
        collector.woke_late(Span::from_us(70));
        collector.counted("bfee", 5);
        let evidence = collector.finish();
        assert!(Stopped::after(0, &steps, "64".into(), &evidence).is_none(), "nothing is whole");
        let folder = std::env::temp_dir().join(format!("csi5300-stopped-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let stopped = Stopped::after(2, &steps, "64".into(), &evidence).unwrap();
        std::fs::write(folder.join(FILE), serde_json::to_vec(&stopped).unwrap()).unwrap();
        assert!(Stopped::read(&folder, "108", &steps).is_none(), "another run");
        let read = Stopped::read(&folder, "64", &steps).unwrap();
        assert_eq!((read.finished, read.counted("bfee"), read.counted("phy")), (2, 5, 0));
        let mut collector = Collector::new(Plan::new("64".parse().unwrap()));
        let why = read.take_up(&folder, &steps, &mut collector).unwrap_err();
        assert!(why.contains("near.dat"), "{why}");
        for name in ["near.dat", "unplugged-B.dat"] {
            std::fs::write(folder.join(name), b"").unwrap();
        }
        read.take_up(&folder, &steps, &mut collector).unwrap();
        let evidence = collector.finish();
        assert_eq!((evidence.unplugged.len(), evidence.lateness_us), (1, vec![70.0]));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
