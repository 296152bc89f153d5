//! Walls and reflectors, and the image method \[allen-berkley1979\]: every specular path up to a given order, exactly.

use super::maths::amplitude;
use nalgebra::Vector3;

/// A flat parallelogram that reflects and attenuates waves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    corner: Vector3<f64>,
    /// The two edges from the corner, and their dual vectors in the plane: `dual_i . edge_j` is 1 for i = j, else 0.
    duals: [Vector3<f64>; 2],
    normal: Vector3<f64>,
    /// Amplitude kept in a reflection, with the sign of one (a half turn).
    reflected: f64,
    /// Amplitude kept when passing through; 0 for an opaque surface.
    through: f64,
}

/// One way from transmitter to receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Path {
    /// Length, metres.
    pub length_m: f64,
    /// Amplitude after reflections and passages, with the sign of the reflections, without spreading (1 / length).
    pub gain: f64,
}

impl Surface {
    /// A surface from a corner and two edges, metres. `None` if they span no area.
    ///
    /// `loss_db` is lost in each reflection (which also turns the phase by half a turn, as at a good conductor);
    /// `through_db` in each passage, `None` for opaque.
    #[must_use]
    pub fn new(corner: Vector3<f64>, edges: [Vector3<f64>; 2], loss_db: f64, through_db: Option<f64>) -> Option<Self> {
        let [a, b] = edges;
        let across = a.cross(&b);
        let area2 = across.norm_squared();
        if area2 <= 1e-12 {
            return None;
        }
        Some(Self {
            corner,
            duals: [b.cross(&across) / area2, across.cross(&a) / area2],
            normal: across / area2.sqrt(),
            reflected: -amplitude(-loss_db),
            through: through_db.map_or(0.0, |db| amplitude(-db)),
        })
    }

    /// The mirror image of a point.
    fn image(&self, p: Vector3<f64>) -> Vector3<f64> {
        p - self.normal * (2.0 * self.height(p))
    }

    /// Signed distance of a point from the plane.
    fn height(&self, p: Vector3<f64>) -> f64 {
        (p - self.corner).dot(&self.normal)
    }

    /// Where the segment between two points crosses the surface, if strictly between them.
    fn crossing(&self, from: Vector3<f64>, to: Vector3<f64>) -> Option<Vector3<f64>> {
        let (h0, h1) = (self.height(from), self.height(to));
        if h0 * h1 >= 0.0 {
            return None;
        }
        let point = from + (to - from) * (h0 / (h0 - h1));
        let within = |dual: &Vector3<f64>| (0.0..=1.0).contains(&(point - self.corner).dot(dual));
        self.duals.iter().all(within).then_some(point)
    }

    /// The distance of a point from the surface, metres, and whether a segment crosses it.
    #[must_use]
    pub fn distance_m(&self, p: Vector3<f64>) -> f64 {
        let clamped = |dual: &Vector3<f64>| (p - self.corner).dot(dual).clamp(0.0, 1.0);
        let edges = self.edges();
        let nearest = self.corner + edges[0] * clamped(&self.duals[0]) + edges[1] * clamped(&self.duals[1]);
        (p - nearest).norm()
    }

    /// True if the straight way between two points goes through the surface.
    #[must_use]
    pub fn separates(&self, from: Vector3<f64>, to: Vector3<f64>) -> bool {
        self.crossing(from, to).is_some()
    }

    /// The edges again, from their duals.
    fn edges(&self) -> [Vector3<f64>; 2] {
        let [p, q] = self.duals;
        let across = p.cross(&q);
        let area2 = across.norm_squared();
        [q.cross(&across) / area2, across.cross(&p) / area2]
    }
}

/// All surfaces of a scene.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    all: Vec<Surface>,
    /// Highest number of reflections in a path.
    order: usize,
}

impl Surfaces {
    /// The surfaces of a scene; paths have at most `order` reflections.
    #[must_use]
    pub fn new(all: Vec<Surface>, order: usize) -> Self {
        Self { all, order }
    }

    /// True if there is nothing but free space.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Finds every path between two points: the direct one first (if not blocked), then those with reflections.
    pub fn paths(&self, from: Vector3<f64>, to: Vector3<f64>, found: &mut Vec<Path>) {
        found.clear();
        let direct = self.passage(from, to, [None, None]);
        if direct != 0.0 {
            found.push(Path { length_m: (to - from).norm(), gain: direct });
        }
        if self.order > 0 && !self.all.is_empty() {
            let mut mirrors = Vec::with_capacity(self.order);
            self.reflect(from, from, to, &mut mirrors, found);
        }
    }

    /// Extends the sequence of mirrors by each surface. `image` is the image of `from` in the mirrors so far.
    fn reflect(
        &self,
        from: Vector3<f64>,
        image: Vector3<f64>,
        to: Vector3<f64>,
        mirrors: &mut Vec<(usize, Vector3<f64>)>,
        found: &mut Vec<Path>,
    ) {
        for (index, surface) in self.all.iter().enumerate() {
            if mirrors.last().is_some_and(|&(last, _)| last == index) {
                continue;
            }
            let next = surface.image(image);
            mirrors.push((index, next));
            if let Some(gain) = self.trace(from, to, mirrors) {
                found.push(Path { length_m: (to - next).norm(), gain });
            }
            if mirrors.len() < self.order {
                self.reflect(from, next, to, mirrors, found);
            }
            mirrors.pop();
        }
    }

    /// Follows a path back from the receiver over its mirrors; its gain, or `None` if it does not exist.
    fn trace(&self, from: Vector3<f64>, to: Vector3<f64>, mirrors: &[(usize, Vector3<f64>)]) -> Option<f64> {
        let (mut point, mut left, mut gain) = (to, None, 1.0);
        for &(index, image) in mirrors.iter().rev() {
            let surface = self.all.get(index)?;
            let bounce = surface.crossing(image, point)?;
            gain *= surface.reflected * self.passage(bounce, point, [Some(index), left]);
            if gain == 0.0 {
                return None;
            }
            (point, left) = (bounce, Some(index));
        }
        gain *= self.passage(from, point, [left, None]);
        (gain != 0.0).then_some(gain)
    }

    /// Amplitude after passing through the surfaces between two points, without those at its ends.
    fn passage(&self, from: Vector3<f64>, to: Vector3<f64>, on: [Option<usize>; 2]) -> f64 {
        let mut gain = 1.0;
        for (index, surface) in self.all.iter().enumerate() {
            if !on.contains(&Some(index)) && surface.separates(from, to) {
                gain *= surface.through;
                if gain == 0.0 {
                    break;
                }
            }
        }
        gain
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn v(x: f64, y: f64, z: f64) -> Vector3<f64> {
        Vector3::new(x, y, z)
    }

    /// A wall of 2.5 m height between two points on the floor.
    fn wall(from: [f64; 2], to: [f64; 2], loss_db: f64, through_db: Option<f64>) -> Surface {
        let edge = v(to[0] - from[0], to[1] - from[1], 0.0);
        Surface::new(v(from[0], from[1], 0.0), [edge, v(0.0, 0.0, 2.5)], loss_db, through_db).unwrap()
    }

    fn paths(surfaces: &Surfaces, from: Vector3<f64>, to: Vector3<f64>) -> Vec<Path> {
        let mut found = Vec::new();
        surfaces.paths(from, to, &mut found);
        found
    }

    #[test]
    fn one_wall_gives_its_image() {
        let s = Surfaces::new(vec![wall([-10.0, 2.0], [10.0, 2.0], 6.0, None)], 2);
        let found = paths(&s, v(0.0, 0.0, 1.0), v(3.0, 0.0, 1.0));
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0], Path { length_m: 3.0, gain: 1.0 });
        assert!((found[1].length_m - 5.0).abs() < 1e-12, "3 along, 2 x 2 across");
        assert!((found[1].gain + 10f64.powf(-6.0 / 20.0)).abs() < 1e-12);
    }

    #[test]
    fn reflections_outside_a_panel_do_not_exist() {
        let s = Surfaces::new(vec![wall([5.0, 2.0], [10.0, 2.0], 0.0, None)], 2);
        assert_eq!(paths(&s, v(0.0, 0.0, 1.0), v(3.0, 0.0, 1.0)).len(), 1);
        // Too low: the reflection would be above the wall's 2.5 m.
        let s = Surfaces::new(vec![wall([-10.0, 2.0], [10.0, 2.0], 0.0, None)], 1);
        assert_eq!(paths(&s, v(0.0, 0.0, 3.0), v(3.0, 0.0, 3.0)).len(), 1);
    }

    #[test]
    fn a_corridor_has_two_paths_of_each_order() {
        let walls = vec![wall([-50.0, 1.0], [50.0, 1.0], 3.0, None), wall([-50.0, -2.0], [50.0, -2.0], 3.0, None)];
        let found = paths(&Surfaces::new(walls, 3), v(0.0, 0.0, 1.0), v(4.0, 0.0, 1.0));
        let mut across: Vec<f64> = found.iter().map(|p| (p.length_m * p.length_m - 16.0).sqrt()).collect();
        across.sort_by(f64::total_cmp);
        // Images at 2, 4 (order 1), 6, 6 (order 2), 8, 10 (order 3) metres across.
        for (got, want) in across.iter().zip([0.0, 2.0, 4.0, 6.0, 6.0, 8.0, 10.0]) {
            assert!((got - want).abs() < 1e-9, "{across:?}");
        }
        assert_eq!(found.len(), 7);
    }

    #[test]
    fn a_wall_blocks_or_weakens_the_direct_path() {
        let (a, b) = (v(0.0, 0.0, 1.0), v(3.0, 0.0, 1.0));
        let opaque = wall([1.0, -1.0], [1.0, 1.0], 0.0, None);
        let mirror = wall([-10.0, 2.0], [10.0, 2.0], 0.0, None);
        let found = paths(&Surfaces::new(vec![opaque, mirror], 2), a, b);
        assert!(found.iter().all(|p| p.length_m > 4.9), "only the way round is left: {found:?}");
        assert!(!found.is_empty());
        let found = paths(&Surfaces::new(vec![wall([1.0, -1.0], [1.0, 1.0], 0.0, Some(20.0))], 0), a, b);
        assert!((found[0].gain - 0.1).abs() < 1e-12);
    }

    #[test]
    fn distances_are_to_the_panel_not_to_its_plane() {
        let s = wall([0.0, 0.0], [2.0, 0.0], 0.0, None);
        assert!((s.distance_m(v(1.0, 0.5, 1.0)) - 0.5).abs() < 1e-12);
        assert!((s.distance_m(v(5.0, 4.0, 1.0)) - 5.0).abs() < 1e-12);
        assert!(Surface::new(v(0.0, 0.0, 0.0), [v(1.0, 0.0, 0.0), v(2.0, 0.0, 0.0)], 0.0, None).is_none());
    }

    proptest! {
        /// The channel is reciprocal: the same paths both ways.
        #[test]
        fn paths_are_reciprocal(a in prop::array::uniform3(0.1..3.9f64), b in prop::array::uniform3(0.1..3.9f64)) {
            let corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
            let mut walls: Vec<Surface> =
                (0..4).map(|i| wall(corners[i], corners[(i + 1) % 4], 4.0, None)).collect();
            walls.push(wall([1.0, 1.5], [2.0, 2.5], 4.0, Some(8.0)));
            let s = Surfaces::new(walls, 2);
            let (a, b) = (Vector3::from(a), Vector3::from(b));
            let sorted = |mut p: Vec<Path>| {
                p.sort_by(|x, y| x.length_m.total_cmp(&y.length_m).then(x.gain.total_cmp(&y.gain)));
                p
            };
            let (there, back) = (sorted(paths(&s, a, b)), sorted(paths(&s, b, a)));
            prop_assert_eq!(there.len(), back.len());
            for (x, y) in there.iter().zip(&back) {
                prop_assert!((x.length_m - y.length_m).abs() < 1e-9 && (x.gain - y.gain).abs() < 1e-9);
            }
        }
    }
}
