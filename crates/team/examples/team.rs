//! Simulated teams: coverage of the covariances and run time; or the graph of one team as JSON for GTSAM.
//!
//! `cargo run -p csi5300-team --example team` prints the table of docs/method/team.md;
//! `.. --example team -- 5 1 OUT.json` writes the graph of five robots, seed 1.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../tests/team/simulated.rs"]
mod simulated;

use simulated::{Hall, Held, simulated};

/// Processor time of this process, seconds.
fn processor_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/schedstat").unwrap();
    text.split(' ').next().unwrap().parse::<f64>().unwrap() / 1e9
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if let [robots, seed, out] = &args[..] {
        let hall = Hall { has_liar: true, ranged: 0.1, ..Hall::of(robots.parse().unwrap()) };
        let own = simulated(hall, seed.parse().unwrap());
        let found = own.team.solve().unwrap();
        return std::fs::write(out, csi5300_team::factors::json(&own.team, &found)).unwrap();
    }
    println!("| team | solved | places within 68 / 95 % | yaws | rms of places, m | processor time of a solution, s |");
    println!("|---|---|---|---|---|---|");
    // Robots of a run share errors, so many runs are needed.
    for (robots, epochs, anchors, runs) in [(2, 30, 0, 600), (5, 20, 0, 120), (20, 12, 4, 30)] {
        let usual = Hall { epochs, anchors, ..Hall::of(robots) };
        let mut halls = vec![
            ("", usual),
            (", ranges", Hall { ranged: 0.25, ..usual }),
            (", one lies", Hall { has_liar: true, ..usual }),
        ];
        if anchors > 0 {
            halls.push((", no known pose", Hall { anchors: 0, ..usual }));
        }
        for (name, hall) in halls {
            let (mut held, mut spent_s, mut solved) = (Held::default(), 0.0, 0);
            for seed in 0..runs {
                let own = simulated(hall, seed);
                let begun_s = processor_s();
                let found = own.team.solve();
                spent_s += (processor_s() - begun_s) / f64::from(runs as u32);
                if let Ok(found) = found {
                    own.judge(&found, &mut held);
                    solved += 1;
                }
            }
            let shares = |counts: [usize; 2]| counts.map(|count| format!("{:.0}", held.share(count))).join(" / ");
            let (places, yaws, rms_m) = (shares(held.places), shares(held.yaws), held.rms_m());
            println!("| {robots} robots{name} | {solved}/{runs} | {places} | {yaws} | {rms_m:.3} | {spent_s:.2} |");
        }
    }
    window();
}

/// 20 robots with one keyframe per second for a minute, solved every second over the last 10 s: prints the processor time
/// of a solution as a share of its second.
fn window() {
    let hall = Hall { epochs: 60, has_liar: true, ..Hall::of(20) };
    let (mut last, mut shares, mut held, mut unsolved) = (None, Vec::new(), Held::default(), 0);
    let own = simulated::followed(hall, 1, &mut |team, epoch| {
        let begun_s = processor_s();
        let found = match &last {
            None if epoch < 4 => return,
            None => team.solve(),
            Some(before) => team.solve_from(before),
        };
        // In the first seconds the measurements may not determine a robot.
        let Ok(found) = found else {
            unsolved += 1;
            return;
        };
        team.forget(&found, epoch as f64 - 10.0);
        shares.push(100.0 * (processor_s() - begun_s));
        last = Some(found);
    });
    own.judge(last.as_ref().unwrap(), &mut held);
    shares.sort_by(f64::total_cmp);
    let (middle, most, rms_m) = (shares[shares.len() / 2], shares[shares.len() - 1], held.rms_m());
    println!(
        "20 robots at 1 Hz: {middle:.0} % of each second in the median, {most:.0} % at most; places after a minute {rms_m:.3} m rms; {unsolved} seconds unsolved"
    );
}
