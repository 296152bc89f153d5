//! Two logs and a trajectory to a bearing. Prints the azimuth with its deviation, then carrier offset and turn-around jitter.
//!
//! `cargo run --example bearing_from_logs -- [RX.dat TX.dat TRAJECTORY.csv CHANNEL]` (default: the fixture of the tests).
//! Expect `120.48 +- 0.31 deg from 245 of 277 pairs, coherence 0.99`, and a line with the carrier frequency offset.

use csi5300::pipeline::Capture;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    if args.is_empty() {
        let files =
            ["csi_rx_2023-11-14_221320.dat", "csi_tx1_2023-11-14_221320.dat", "rx_trajectory_2023-11-14_221320_.csv"];
        args = files.map(|name| format!("{}/tests/fixtures/small-circle/{name}", env!("CARGO_MANIFEST_DIR"))).into();
        args.push("108".into());
    }
    let [rx, tx, trajectory, channel] =
        <[String; 4]>::try_from(args).map_err(|_| "arguments: RX.dat TX.dat TRAJECTORY.csv CHANNEL")?;
    let capture = Capture::new(channel.parse()?).receiver(rx)?.transmitter(tx)?.trajectory(trajectory)?;
    for bearing in capture.bearings()? {
        let bearing = bearing?;
        let (azimuth_deg, sd_deg) =
            (bearing.answer.azimuth_rad.to_degrees(), bearing.answer.azimuth_sd_rad.to_degrees());
        let pairs = bearing.pairs;
        let coherence = bearing.plane_wave.coherence;
        println!(
            "{azimuth_deg:.2} +- {sd_deg:.2} deg from {} of {} pairs, coherence {coherence:.2}",
            pairs.in_motion, pairs.formed
        );
        if let Some(turn_around) = bearing.turn_around {
            println!("CFO {:.0} Hz, turn-around jitter {:.1} us", turn_around.df_hz, turn_around.jitter_median_us);
        }
    }
    Ok(())
}
