//! The planner's choice among the methods, and the parts that it skips.

use super::bessel::tail_order;
use super::cost::{ORACLE_TERM_NS, price};
use super::explain::{Method, Precision};
use super::key::{Key, cone_rows, ring_shape};
use super::scene::{Geometry, Scene};
use csi5300_kernels::setting::Setting;
use csi5300_kernels::simd::Tier;

/// A method with its cost and its skipped parts.
pub(crate) struct Choice {
    pub method: Method,
    pub precision: Precision,
    pub setting: Option<Setting>,
    /// Band limits in azimuth and elevation.
    pub order: [usize; 2],
    pub steepest: f64,
    pub cost_ns: f64,
    pub skipped: Vec<String>,
}

/// What the planner chooses from where there is motion and a tolerance.
const METHODS: [Method; 6] =
    [Method::Direct, Method::RingsDirect, Method::RingsNufft, Method::TargetsNufft, Method::Slab, Method::Cone];

pub(crate) fn choose(scene: &Scene, key: &Key, tier: Tier) -> Choice {
    let eps = key.options.eps;
    let mut best = Choice {
        method: Method::Oracle,
        precision: Precision::Double,
        setting: None,
        order: [usize::MAX; 2],
        steepest: key.grid.steepest,
        cost_ns: ORACLE_TERM_NS * key.grid.len() as f64 * key.count as f64,
        skipped: Vec::new(),
    };
    if eps > 0.0 && key.extent == [0.0; 3] {
        best.method = Method::Constant;
        best.cost_ns = key.count as f64;
        best.skipped.push(String::from("every direction but one: no motion within the tolerance, hence no bearing"));
        return best;
    }
    if eps == 0.0 || key.options.method == Some(Method::Oracle) {
        return best;
    }
    let forced = key.options.method;
    let [level_radius, radius] = key.radius;
    // Modes beyond the limit are lost and, folded back, added once more: an eighth of eps in either angle is a quarter.
    best.order = [tail_order(level_radius, eps / 8.0), tail_order(radius, eps / 8.0)];
    let mut found = false;
    for method in METHODS {
        let Some((precision, setting, cost)) = price(key, method, best.order, tier) else { continue };
        let wanted = forced == Some(method);
        if !found || wanted || (cost < best.cost_ns && forced != Some(best.method)) {
            (best.method, best.precision, best.setting, best.cost_ns) = (method, precision, setting, cost);
            found = true;
        }
    }
    best.skipped = skipped(scene, key, &best);
    best
}

/// What the chosen plan leaves out, in words.
fn skipped(scene: &Scene, key: &Key, choice: &Choice) -> Vec<String> {
    let mut list = Vec::new();
    let geometry = scene.shape().geometry;
    if key.extent[2] == 0.0
        && choice.steepest > 0.0
        && matches!(choice.method, Method::RingsDirect | Method::RingsNufft)
    {
        list.push(String::from("the lower hemisphere: level motion sees the elevation's cosine only"));
    }
    if choice.steepest == 0.0 {
        list.push(String::from("every elevation: only azimuths on the horizon were asked for"));
    }
    if key.axes.is_some() && !key.line {
        list.push(String::from("the axis across a tilted plane"));
    }
    if key.line {
        list.push(String::from("both axes across the line: one cosine, so a direction and its mirror are the same"));
    } else if geometry == Geometry::Line {
        list.push(String::from("little: along the line it wobbles by more than the tolerance lets pass"));
    }
    if choice.method == Method::Cone && cone_rows(key).is_some_and(|(rows, of)| rows.len() < of.len()) {
        list.push(String::from("the lower hemisphere: the line is level"));
    }
    if let Some((d, nodes)) = ring_shape(key, choice.order) {
        let rings = key.grid.shape();
        if d < rings.1 && matches!(choice.method, Method::RingsDirect | Method::RingsNufft | Method::Slab) {
            list.push(format!("{} of {} azimuths per ring: band limit {}", rings.1 - d, rings.1, choice.order[0]));
        }
        if 2 * nodes < rings.0 {
            list.push(format!("all but {nodes} elevations a side: band limit {}", choice.order[1]));
        }
    }
    list
}
