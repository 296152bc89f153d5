//! Any bytes as a scene: refused with a reason, or unchanged after writing and reading.

use csi5300_sim::scene::Scene;

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match Scene::parse(text) {
        Ok(scene) => {
            let written = scene.to_toml().expect("a scene that can be read can be written");
            assert_eq!(Scene::parse(&written).expect("a scene that was written can be read"), scene);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
