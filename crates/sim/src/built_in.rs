//! Scenes that come with the program.

use super::scene::Scene;

/// Names and texts of the built-in scenes, ready to be printed, changed and read again.
pub const BUILT_IN: [(&str, &str); 4] = [
    ("paper-circle", include_str!("../../../scenes/paper-circle.toml")),
    ("paper-line", include_str!("../../../scenes/paper-line.toml")),
    ("lab-circle", include_str!("../../../scenes/lab-circle.toml")),
    ("lab-line", include_str!("../../../scenes/lab-line.toml")),
];

impl Scene {
    /// A built-in scene by name, see [`BUILT_IN`].
    #[must_use]
    pub fn built_in(name: &str) -> Option<Self> {
        let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name)?;
        Self::from_toml(text).ok()
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
    }
}
