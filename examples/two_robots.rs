//! Two robots in a room, written as a capture folder. Prints each log with its records, and what was done to each robot.
//!
//! `cargo run --release --example two_robots -- [SCENE.toml | name of a built-in scene] [DIR]`

use csi5300_sim::{Room, Scene, write_dataset};
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let scene = args.next().unwrap_or_else(|| "lab-circle".to_owned());
    let dir = args.next().map_or_else(|| PathBuf::from("csi5300-two-robots"), PathBuf::from);
    let scene = match Scene::built_in(&scene) {
        Some(scene) => scene,
        None => Scene::load(Path::new(&scene))?,
    };
    let mut room = Room::new(&scene)?;
    for capture in write_dataset(&mut room, &dir, &mut |_| {})? {
        for log in capture.logs {
            println!("{}: {} records, {} lost at the end", log.path.display(), log.records, log.tail_records);
        }
    }
    for (robot, injected) in scene.robot.iter().zip(room.injected()) {
        println!("{}: {injected:?}", robot.name);
    }
    Ok(())
}
