//! The bearings of all links of a capture: what takes all of them together, and what threads do beside each other.

use super::accurate;
use super::bearing::Bearing;
use super::draft::Draft;
use super::error::LinkError;
use super::link::Link;
use super::options::Options;
use crate::motion::pose::Trajectory;
use rayon::prelude::*;

/// A link and the trajectories that its pairs are joined with, both on the receiver's clock.
#[derive(Clone, Copy, Debug)]
pub struct LinkJoin<'a> {
    /// The link, with all its pairs.
    pub link: &'a Link,
    /// The receiver's trajectory: the same for all links of one call.
    pub receiver: &'a Trajectory,
    /// The transmitter's, if it moved.
    pub transmitter: Option<&'a Trajectory>,
}

/// The bearings of all links of a capture, in their order. Together, because autofocus finds what the trajectory that
/// they share lacks from all of them; a single link is a capture of one.
///
/// Each is an error by itself: see [`LinkError`].
#[must_use]
pub fn estimate(links: &[LinkJoin<'_>], options: &Options) -> Vec<Result<Bearing, LinkError>> {
    let mut drafts: Vec<Result<Draft, LinkError>> = match options.parallel {
        true => begin_all(links, options),
        false => links.iter().map(|join| Draft::begin(join, options)).collect(),
    };
    if options.accuracy.focus {
        // What links share is the receiver's trajectory: the displacements of a moving transmitter are no path of it. One
        // link that it leaves nothing but noise of shows that it is right.
        let still = |draft: &&mut Draft| !draft.bearing.samples.transmitter_moves();
        let is_right = drafts.iter().flatten().any(|draft| draft.bearing.sufficient.explains_all());
        let placed = drafts.iter_mut().flatten().filter(still).filter_map(|draft| draft.placed.as_mut());
        accurate::refocus(&mut placed.filter(|_| !is_right).collect::<Vec<_>>(), options.parallel);
    }
    let finish = |draft: Result<Draft, LinkError>| draft.map(|draft| draft.finish(options));
    match options.parallel {
        true => drafts.into_par_iter().map(finish).collect(),
        false => drafts.into_iter().map(finish).collect(),
    }
}

/// The bearing of one link by itself: a capture of one.
pub(super) fn estimate_one(join: &LinkJoin<'_>, options: &Options) -> Result<Bearing, LinkError> {
    Ok(Draft::begin(join, options)?.finish(options))
}

/// Begins all links on the threads of the current rayon pool. A thread that has no link left looks for paths of one that is
/// begun: they are in vain only where the trajectory is changed afterwards.
fn begin_all(links: &[LinkJoin<'_>], options: &Options) -> Vec<Result<Draft, LinkError>> {
    let mut drafts: Vec<Option<Result<Draft, LinkError>>> = links.iter().map(|_| None).collect();
    rayon::scope_fifo(|scope| {
        for (join, draft) in links.iter().zip(&mut drafts) {
            scope.spawn_fifo(move |scope| {
                if let Ok(draft) = draft.insert(Draft::begin(join, options)) {
                    scope.spawn_fifo(move |_| draft.find_paths(options));
                }
            });
        }
    });
    drafts.into_iter().flatten().collect()
}
