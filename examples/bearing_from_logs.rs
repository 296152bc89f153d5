//! Two logs and a trajectory to a bearing. Prints the azimuth with its deviation, then carrier offset and turn-around jitter.
//!
//! `cargo run --example bearing_from_logs -- [RX.dat TX.dat TRAJECTORY.csv CHANNEL]` (default: the fixture of the tests)

use csi5300::motion::odometry;
use csi5300::pipeline::{Options, Transmitter, bearings};
use csi5300::source::replay::Replay;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let fixture = |name: &str| format!("{}/tests/fixtures/small-circle/{name}", env!("CARGO_MANIFEST_DIR"));
    let [rx, tx, trajectory, channel] = <[String; 4]>::try_from(args).unwrap_or_else(|_| {
        [
            fixture("csi_rx_2023-11-14_221320.dat"),
            fixture("csi_tx1_2023-11-14_221320.dat"),
            fixture("rx_trajectory_2023-11-14_221320_.csv"),
            "108".into(),
        ]
    });
    let (trajectory, _) = odometry::csv::read(Path::new(&trajectory))?;
    let (mut rx, mut tx) = (Replay::open(Path::new(&rx))?, Replay::open(Path::new(&tx))?);
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
    let report = bearings(&mut rx, transmitters, &trajectory, &Options::new(channel.parse()?))?;
    for link in report.links {
        let bearing = link.bearing?;
        let answer = &bearing.answer;
        println!(
            "{:.2} +- {:.2} deg from {} of {} pairs, coherence {:.2}",
            answer.azimuth_rad.to_degrees(),
            answer.azimuth_sd_rad.to_degrees(),
            bearing.pairs.in_motion,
            bearing.pairs.formed,
            bearing.plane_wave.coherence
        );
        if let Some(turn_around) = bearing.turn_around {
            println!("CFO {:.0} Hz, turn-around jitter {:.1} us", turn_around.df_hz, turn_around.jitter_median_us);
        }
    }
    Ok(())
}
