//! Simulated teams: how often their poses are within what the covariances say, or one team's graph as JSON for GTSAM.
//!
//! `cargo run --release -p csi5300-team --example team` prints the table of docs/method/team.md;
//! `.. --example team -- 5 1 OUT.json` writes the graph of five robots, seed 1.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../tests/team/simulated.rs"]
mod simulated;

use simulated::{Hall, Held, simulated};
use std::time::Instant;

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if let [robots, seed, out] = &args[..] {
        let hall = Hall { has_liar: true, ranged: 0.1, ..Hall::of(robots.parse().unwrap()) };
        let own = simulated(hall, seed.parse().unwrap());
        let found = own.team.solve().unwrap();
        return std::fs::write(out, csi5300_team::factors::json(&own.team, &found)).unwrap();
    }
    println!("| team | runs | places within 68 / 95 % | yaws | rms of places, m | solving, s |");
    println!("|---|---|---|---|---|---|");
    for (robots, runs) in [(2, 300), (5, 75), (20, 15)] {
        let usual = Hall::of(robots);
        let halls = [
            ("", usual),
            (", ranges", Hall { ranged: 0.25, ..usual }),
            (", one lies", Hall { has_liar: true, ..usual }),
        ];
        for (name, hall) in halls {
            let (mut held, mut spent_s) = (Held::default(), 0.0);
            for seed in 0..runs {
                let own = simulated(hall, seed);
                let begun = Instant::now();
                let found = own.team.solve().unwrap();
                spent_s += begun.elapsed().as_secs_f64() / f64::from(runs as u32);
                own.judge(&found, &mut held);
            }
            let shares = |counts: [usize; 2]| counts.map(|count| format!("{:.0}", held.share(count))).join(" / ");
            let (places, yaws, rms_m) = (shares(held.places), shares(held.yaws), held.rms_m());
            println!("| {robots} robots{name} | {runs} | {places} | {yaws} | {rms_m:.3} | {spent_s:.2} |");
        }
    }
}
