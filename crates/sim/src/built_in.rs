//! Scenes that come with the program.

use super::refusal::SceneError;
use super::scene::Scene;
use std::path::Path;

/// Names and texts of the built-in scenes, ready to be printed, changed and read again.
pub const BUILT_IN: [(&str, &str); 5] = [
    ("paper-circle", include_str!("../../../scenes/paper-circle.toml")),
    ("paper-line", include_str!("../../../scenes/paper-line.toml")),
    ("lab-circle", include_str!("../../../scenes/lab-circle.toml")),
    ("lab-line", include_str!("../../../scenes/lab-line.toml")),
    ("two-antennas", include_str!("../../../scenes/two-antennas.toml")),
];

impl Scene {
    /// A built-in scene by name, see [`BUILT_IN`].
    #[must_use]
    pub fn built_in(name: &str) -> Option<Self> {
        let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name)?;
        Self::from_toml(text).ok()
    }

    /// The scene of a file, or else the built-in one of that name.
    ///
    /// # Errors
    /// If there is neither, or the scene is refused.
    pub fn find(scene: &Path) -> Result<Self, SceneError> {
        // A folder with a built-in scene's name, as `simulate` makes it, is no scene.
        let built_in = || scene.to_str().and_then(Self::built_in);
        match std::fs::metadata(scene) {
            Err(_) => built_in().ok_or_else(|| SceneError::Nowhere { scene: scene.to_owned() }),
            Ok(there) if there.is_dir() => built_in().map_or_else(|| Self::load(scene), Ok),
            Ok(_) => Self::load(scene),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_scene_is_good() {
        for (name, text) in BUILT_IN {
            let scene = Scene::from_toml(text).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(scene.name, name);
            assert_eq!(Scene::built_in(name), Some(scene));
        }
        assert_eq!(Scene::built_in("nowhere"), None);
        assert!(Scene::find(Path::new("lab-line")).is_ok());
        let nowhere = Scene::find(Path::new("nowhere")).unwrap_err();
        let words = "there is no file nowhere, and no built-in scene of that name: paper-circle, paper-line, lab-circle, lab-line, two-antennas";
        assert_eq!(nowhere.of_file(Path::new("nowhere")), words);
    }
}
