//! `csi5300 doctor --bring-up`: what only a card can tell, asked in order, and a report to send in.

use csi5300_live::doctor::{Machine, System};
use driver_iface::Mac;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

/// Where the module counts.
const COUNTERS: &str = "/sys/module/csi5300/counters";
/// What the kernel's log is searched for.
const WORDS: [&str; 5] = ["iwlwifi", "iwldvm", "csi5300", "cfg80211", "wrong command queue"];

/// A question, and the arguments of `csi5300` that answer it.
struct Question {
    asks: &'static str,
    arguments: Vec<String>,
    /// What an answer looks like in the counters and words that follow.
    tells: &'static str,
}

/// The questions in order. `log` is where the card's records go.
fn questions(interface: &str, peer: Option<Mac>, log: &Path) -> Vec<Question> {
    let words = |line: &str| line.split(' ').map(str::to_string).collect::<Vec<_>>();
    let log = log.display().to_string();
    let mut record = words("record --force --stop-after 20s");
    record.insert(1, log.clone());
    let mut questions = vec![
        Question {
            asks: "is everything in its place?",
            arguments: words("doctor"),
            tells: "every line `ok`; what is BAD is mended first",
        },
        Question {
            asks: "does the firmware send 0xBB, asked as the patched drivers ask it? (another robot sounds meanwhile)",
            arguments: record,
            tells: "`bfee` and `records` grow: it does. `phy` grows and `bfee` does not: it hears frames, but not HT frames to \
                    the magic address, or it was not asked (`rxons`, `stations`, `orders` above 0 in the counters at the \
                    report's beginning: it was). `unmarked` grows with `bfee`: the driver takes CSI for answers to commands \
                    (`wrong command queue` in the kernel's log). `no_order` grows with `records`: the order of the antennas \
                    is not told, so connect one antenna only. `bad_bfee` or `bad_phy` grow: the packets are laid out in \
                    another way than the driver's sources say",
        },
        Question {
            asks: "do the records make sense?",
            arguments: vec!["info".into(), log],
            tells: "one sender, 3x1 or fewer chains, plausible RSSI, no gaps",
        },
    ];
    if let Some(peer) = peer {
        let line =
            format!("sound --interface {interface} --peers {peer} --rate 50 --stop-after 10s --alone --open-loop");
        questions.push(Question {
            asks: "do frames leave at an HT rate? (another robot records meanwhile, or responds)",
            arguments: words(&line),
            tells: "`rates_set` grows by the frames sent here; at the other robot `bfee` grows by as many: they leave, and at an HT \
                    rate. There only `phy` grows: they leave at a legacy rate",
        });
    }
    questions
}

/// The module's counters, in order of their names.
fn counters(system: &dyn System) -> Vec<(String, u64)> {
    let value = |name: &String| system.text(&format!("{COUNTERS}/{name}"))?.parse().ok();
    system.names(COUNTERS).into_iter().filter_map(|name| value(&name).map(|count| (name, count))).collect()
}

/// What has grown between two readings, as words.
fn grown(before: &[(String, u64)], after: &[(String, u64)]) -> String {
    let old = |name: &str| before.iter().find(|(known, _)| known == name).map_or(0, |(_, count)| *count);
    let grown = after.iter().map(|(name, count)| (name, count.wrapping_sub(old(name)))).filter(|(_, more)| *more > 0);
    let words: Vec<_> = grown.map(|(name, more)| format!("{name} +{more}")).collect();
    match (after.is_empty(), words.is_empty()) {
        (true, _) => "the module csi5300 is not loaded: no counters".into(),
        (false, true) => "no counter of the module has grown".into(),
        (false, false) => words.join(", "),
    }
}

/// Facts about the machine that the doctor's checks do not print.
fn facts(system: &dyn System) -> String {
    let text = |path: &str| system.text(path).unwrap_or_else(|| "-".into());
    let mut facts = format!("csi5300 {}, kernel {}\n", env!("CARGO_PKG_VERSION"), text("/proc/sys/kernel/osrelease"));
    for name in system.names("/sys/module/csi5300/parameters") {
        let _ = writeln!(facts, "csi5300.ko {name}={}", text(&format!("/sys/module/csi5300/parameters/{name}")));
    }
    for (name, count) in counters(system) {
        let _ = writeln!(facts, "csi5300.ko counter {name}={count}");
    }
    let log = system.run(&["dmesg"]).map(|ran| ran.text).unwrap_or_default();
    let told = log.lines().filter(|line| WORDS.iter().any(|word| line.contains(word))).collect::<Vec<_>>();
    for line in told.iter().skip(told.len().saturating_sub(40)) {
        let _ = writeln!(facts, "  {line}");
    }
    facts
}

/// Asks everything, says how it goes, and writes the report.
pub fn run(interface: &str, peer: Option<Mac>, report: &Path) -> Result<(), String> {
    let system = Machine;
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut text = facts(&system);
    for question in questions(interface, peer, &report.with_extension("dat")) {
        note!("{}", question.asks);
        let before = counters(&system);
        let ran = Command::new(&program).args(&question.arguments).stdin(Stdio::null()).output();
        let ran = ran.map_err(|error| format!("{}: {error}", program.display()))?;
        let said = [String::from_utf8_lossy(&ran.stdout), String::from_utf8_lossy(&ran.stderr)].concat();
        let _ = write!(
            text,
            "\n== {}\n$ csi5300 {}\n{said}exit status {}\ncounters: {}\nreads as: {}\n",
            question.asks,
            question.arguments.join(" "),
            ran.status.code().map_or("none: a signal".into(), |code| code.to_string()),
            grown(&before, &counters(&system)),
            question.tells
        );
    }
    crate::commands::draft::write(report, text)?;
    note!("the report is in {}: send it in as firmware-notes/README.md says", report.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_question_is_a_command_that_parses() {
        use clap::Parser;
        let peer = "00:21:6a:00:00:02".parse().unwrap();
        let asked = questions("wlp1s0", Some(peer), Path::new("/tmp/a report.dat"));
        assert_eq!(asked.len(), 4);
        for question in asked {
            let words = ["csi5300".to_string()].into_iter().chain(question.arguments.iter().cloned());
            let parsed = crate::commands::Cli::try_parse_from(words);
            assert!(
                parsed.is_ok(),
                "{:?}: {}",
                question.arguments,
                parsed.err().map(|error| error.to_string()).unwrap_or_default()
            );
        }
        assert_eq!(questions("wlp1s0", None, Path::new("x")).len(), 3);
    }

    #[test]
    fn counters_that_grew_are_named() {
        let counts = |bfee, phy| vec![("bfee".to_string(), bfee), ("phy".to_string(), phy)];
        assert_eq!(grown(&counts(1, 5), &counts(1, 9)), "phy +4");
        assert_eq!(grown(&counts(1, 5), &counts(1, 5)), "no counter of the module has grown");
        assert!(grown(&[], &[]).contains("not loaded"));
    }
}
