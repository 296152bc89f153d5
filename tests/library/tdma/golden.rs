//! The golden table: robots x loss x jitter -> pairs, collisions, fairness. Kept as text; set
//! `CSI5300_REGENERATE` to write it anew after a change that is meant to change it, and look at the difference.

use super::air::{Air, everybody};
use csi5300::exchange::tdma::Request;
use std::fmt::Write;

/// All robots want the turn, all have the same epoch; the rate leaves a tenth of the channel free.
fn row(n: usize, loss_percent: u32, jitter_us: u64) -> String {
    let links = n as u16 - 1;
    let shortest_us = 700.0;
    let request = Request::new(links, 1e6 / (shortest_us * 1.1 * f64::from(links)));
    let mut air = Air::new(&everybody(n, request), 1_000 * n as u64 + 10 * u64::from(loss_percent) + jitter_us);
    (air.loss, air.jitter_us) = (f64::from(loss_percent) / 100.0, jitter_us);
    let cycle_us = air.stations[0].tdma.plan().cycle_us(n as u32) as i64;
    air.run_us(cycle_us * (120 / n as i64).max(10));
    let total = |count: fn(&csi5300::exchange::tdma::TdmaCounts) -> u64| -> u64 {
        air.stations.iter().map(|station| count(station.tdma.counts())).sum()
    };
    assert_eq!(air.collisions, 0, "{n} robots, {loss_percent} % loss, {jitter_us} us jitter: frames overlapped");
    assert_eq!(total(|counts| counts.yields), 0, "{n} robots, {loss_percent} % loss: two initiators");
    // Counts that differ by chance only: s tries on each link, each a pair with probability q.
    let tries = (total(|counts| counts.forward) + total(|counts| counts.missed_slots)) as f64;
    let q = air.pairs() as f64 / tries;
    let chance = 1.0 / (1.0 + (1.0 - q) * (n * (n - 1)) as f64 / air.pairs() as f64);
    assert!(air.jain() > chance - 0.05, "{n} robots, {loss_percent} % loss: {} against {chance}", air.jain());
    format!(
        "{n:>6} {loss_percent:>6} {jitter_us:>9} {:>8} {:>8} {:>8} {:>7} {:>6} {:>10} {:.4} {chance:.4}",
        total(|counts| counts.forward),
        air.pairs(),
        total(|counts| counts.missed_slots),
        total(|counts| counts.missed_replies),
        total(|counts| counts.turns),
        air.collisions,
        air.jain()
    )
}

#[test]
fn the_golden_table_holds() {
    let mut table = String::from(
        "# Virtual air, synchronised robots that all sound all others; 120/robots cycles of turns, at\n\
         # least 10. Made by tests/library/tdma/golden.rs. chance: Jain's index if links differ by chance only.\n\
         robots loss_% jitter_us  forward    pairs   missed replies  turns collisions   jain chance\n",
    );
    for n in [2, 3, 5, 8, 16, 32] {
        for loss_percent in [0, 20, 40, 60] {
            for jitter_us in [0, 50, 120] {
                writeln!(table, "{}", row(n, loss_percent, jitter_us)).unwrap();
            }
        }
    }
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/tdma_golden.txt");
    if std::env::var_os("CSI5300_REGENERATE").is_some() {
        std::fs::write(&path, &table).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap();
    for (now, kept) in table.lines().zip(kept.lines()) {
        assert_eq!(now, kept, "set CSI5300_REGENERATE if the change is meant");
    }
    assert_eq!(table.lines().count(), kept.lines().count());
}
