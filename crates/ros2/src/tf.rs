//! Frames and the transforms between them, from `/tf` and `/tf_static`.

use csi5300_bag::messages::standard::TransformStamped;
use nalgebra::Isometry3;
use std::collections::BTreeMap;

/// Frames that are kept at most.
const FRAMES: usize = 1_024;
/// Steps from one frame to another at most.
const STEPS: usize = 64;

/// What is known of a frame.
#[derive(Clone, Debug)]
struct Frame {
    parent: String,
    transform: Isometry3<f64>,
    is_fixed: bool,
}

/// Frames by their names, each with its parent.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tree {
    frames: BTreeMap<String, Frame>,
}

/// A frame's name without the leading slash of early releases.
fn plain(name: &str) -> &str {
    name.trim_start_matches('/')
}

impl Tree {
    /// Takes a transform. False if it is invalid, or one frame too many.
    pub fn handle(&mut self, told: &TransformStamped, is_fixed: bool) -> bool {
        let child = plain(&told.child_frame_id);
        let Some(transform) = told.transform.isometry() else { return false };
        if self.frames.len() >= FRAMES && !self.frames.contains_key(child) {
            return false;
        }
        let parent = plain(&told.header.frame_id).to_owned();
        self.frames.insert(child.to_owned(), Frame { parent, transform, is_fixed });
        true
    }

    /// The pose of `to` in its ancestor `from`, and the lowest moving frame on the way.
    pub fn find(&self, from: &str, to: &str) -> Option<(Isometry3<f64>, Option<&str>)> {
        let (from, mut at) = (plain(from), plain(to));
        let (mut whole, mut moving) = (Isometry3::identity(), None);
        for _ in 0..STEPS {
            if at == from {
                return Some((whole, moving));
            }
            let (name, frame) = self.frames.get_key_value(at)?;
            whole = frame.transform * whole;
            if !frame.is_fixed && moving.is_none() {
                moving = Some(name.as_str());
            }
            at = &frame.parent;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300_bag::messages::standard::{Header, Quaternion, Time, Transform, Vector3};
    use std::f64::consts::FRAC_1_SQRT_2;

    fn told(parent: &str, child: &str, at: [f64; 3], quarter: bool) -> TransformStamped {
        let half = if quarter { FRAC_1_SQRT_2 } else { 0.0 };
        let [x, y, z] = at;
        let rotation = Quaternion { z: half, w: (1.0 - half * half).sqrt(), ..Quaternion::default() };
        let transform = Transform { translation: Vector3 { x, y, z }, rotation };
        let header = Header { stamp: Time::default(), frame_id: parent.into() };
        TransformStamped { header, child_frame_id: child.into(), transform }
    }

    #[test]
    fn transforms_are_followed_down_the_tree() {
        let mut tree = Tree::default();
        assert!(tree.handle(&told("/odom", "base_link", [1.0, 0.0, 0.0], true), false));
        assert!(tree.handle(&told("base_link", "antenna", [0.5, 0.0, 0.2], false), true));
        let (whole, moving) = tree.find("odom", "antenna").unwrap();
        assert!((whole.translation.vector - nalgebra::Vector3::new(1.0, 0.5, 0.2)).norm() < 1e-12, "{whole}");
        assert_eq!(moving, Some("base_link"));
        assert_eq!(tree.find("base_link", "antenna").unwrap().1, None);
        assert!(tree.find("map", "antenna").is_none() && tree.find("antenna", "odom").is_none());
    }

    #[test]
    fn loops_end_and_invalid_transforms_are_refused() {
        let mut tree = Tree::default();
        tree.handle(&told("a", "b", [0.0; 3], false), false);
        tree.handle(&told("b", "a", [0.0; 3], false), false);
        assert!(tree.find("map", "a").is_none());
        assert!(!tree.handle(&told("a", "c", [f64::NAN, 0.0, 0.0], false), false));
        let mut no_turn = told("a", "c", [0.0; 3], false);
        no_turn.transform.rotation = Quaternion::default();
        assert!(!tree.handle(&no_turn, false));
        for k in 0..2 * FRAMES {
            tree.handle(&told("a", &format!("f{k}"), [0.0; 3], false), false);
        }
        assert_eq!(tree.frames.len(), FRAMES);
    }
}
