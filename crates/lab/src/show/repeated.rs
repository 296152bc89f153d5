//! Two stationary robots, drawn as by Dijkstra et al. (\[paper\] in docs/reference/references.md): their phase before and after
//! the offset is cancelled.

use super::link::track;
use super::{PhasePlot, PhaseTrack};
use crate::suite::Standing;

/// Pairs of stationary robots whose phases are averaged before unwrapping.
const STANDING: usize = 25;

/// The phase of two stationary robots.
#[must_use]
pub fn standing(standing: &Standing) -> PhasePlot {
    let product_rad = standing.course.iter().map(|phase| phase.round_trip_rad).collect();
    let spread = format!(
        "from packet to packet: {:.2} rad, {:.2} rad, {:.2} rad",
        standing.spread_one_way_rad, standing.spread_rad, standing.spread_compensated_rad
    );
    PhasePlot {
        title: "Two robots that stand: phase at the channel centre".into(),
        before: "one direction".into(),
        capture: PhaseTrack { product_rad, ..track(&spread, &standing.course) },
        averaged: STANDING,
        ..PhasePlot::default()
    }
}
