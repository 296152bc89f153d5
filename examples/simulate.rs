//! Two robots simulated in memory, and the bearing that their logs give. Prints it beside the true one: they differ by less
//! than half a degree.
//!
//! `cargo run --release --example simulate`

use csi5300::pipeline::{Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300_sim::{Room, Scene};

/// One robot drives a circle, the other stands 3.2 m away; noise, and carriers that differ as two crystals do.
const SCENE: &str = r#"
duration_s = 5.0
cfo = "physical"
sounding.rate_hz = 100
radio.noise.snr_db = 15.0
[[robot]]
name = "rx"
crystal.offset_ppm = 1.0
motion.circle = { radius_m = 0.3, duration_s = 5.0 }
[[robot]]
name = "tx"
position_m = [3.0, 1.0, 0.3]
"#;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let run = Room::new(&Scene::parse(SCENE)?)?.run()?;
    let (rx, tx) = (run.robot("rx").ok_or("no rx")?, run.robot("tx").ok_or("no tx")?);
    println!("rx logged {} records, {} bytes; tx {} records", rx.records, rx.log.len(), tx.records);
    let path = rx.true_path.as_ref().ok_or("no path")?;
    let (mut own, mut other) = (rx.replay(), tx.replay());
    let transmitters = vec![Transmitter { log: &mut other, trajectory: None }];
    let report = bearings(&mut own, transmitters, path, &Options::new(Channel::new(108, Width::Ht20)?))?;
    for link in report.links {
        let bearing = link.bearing?;
        let away = tx.start_m().ok_or("no place")? - bearing.mean_position_m;
        let (found, truth) = (bearing.answer.azimuth_rad.to_degrees(), away.y.atan2(away.x).to_degrees());
        println!("azimuth {found:.2} deg, true {truth:.2} deg");
    }
    Ok(())
}
