//! How to request a profile, and the description of a plan.

use std::fmt;

use serde::Serialize;

use csi5300_kernels::simd::Tier;

/// How exact, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ProfileOptions {
    /// The guarantee: every `|f~(u) - f(u)| <= eps * sum w |z|`. Default 1e-4; 0 asks for the oracle.
    pub eps: f64,
    /// Force a method instead of the cheapest. One that cannot serve the scene is replaced by the cheapest that can.
    pub method: Option<Method>,
    /// Force single or double precision instead of the narrowest that meets `eps`.
    pub precision: Option<Precision>,
}

impl Default for ProfileOptions {
    fn default() -> Self {
        Self { eps: 1e-4, method: None, precision: None }
    }
}

impl ProfileOptions {
    /// With another guarantee, relative to `sum w |z|`.
    #[must_use]
    pub fn with_eps(mut self, eps: f64) -> Self {
        self.eps = eps;
        self
    }

    /// With a method forced.
    #[must_use]
    pub fn with_method(mut self, method: Method) -> Self {
        self.method = Some(method);
        self
    }

    /// With a precision forced.
    #[must_use]
    pub fn with_precision(mut self, precision: Precision) -> Self {
        self.precision = Some(precision);
        self
    }
}

/// The ways to a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Method {
    /// No motion within the tolerance: one value for all directions.
    Constant,
    /// The sum as written, in double, phases exact to the last bit; a tolerance of 0 takes it.
    Oracle,
    /// Antipodal pairs at every direction.
    Direct,
    /// Antipodal pairs on band-limited rings, then Fourier interpolation.
    RingsDirect,
    /// Planar NUFFT onto band-limited rings, then Fourier interpolation.
    RingsNufft,
    /// Planar NUFFT straight to every direction.
    TargetsNufft,
    /// A one-dimensional NUFFT over the cosine to a line of motion.
    Cone,
    /// Slabs of planar NUFFTs, onto rings or straight to the directions.
    Slab,
}

/// Numbers that the bulk of the work is done in; the front end is always double.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Precision {
    /// `f32`.
    Single,
    /// `f64`.
    Double,
}

/// A plan's method, precision and instructions.
fn words(method: Method) -> &'static str {
    match method {
        Method::Constant => "one value for all directions",
        Method::Oracle => "the sum as written",
        Method::Direct => "direct sums at every direction",
        Method::RingsDirect => "direct sums on rings, interpolated",
        Method::RingsNufft => "a planar NUFFT onto rings, interpolated",
        Method::TargetsNufft => "a planar NUFFT to every direction",
        Method::Cone => "a one-dimensional NUFFT along the line of motion",
        Method::Slab => "slabs of planar NUFFTs",
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Single => "single",
            Self::Double => "double",
        })
    }
}

fn instructions(tier: Tier) -> &'static str {
    match tier {
        Tier::Portable => "portable code",
        Tier::Sse42 => "SSE4.2",
        Tier::Avx2 => "AVX2",
        Tier::Avx512 => "AVX-512",
        Tier::Native => "this machine's own vectors",
    }
}

/// The steps, cost and skipped parts of a plan, as a value that prints.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Explanation {
    /// The method.
    pub method: Method,
    /// The precision of the bulk of the work.
    pub precision: Precision,
    /// The SIMD tier.
    pub tier: Tier,
    /// The tolerance that it meets.
    pub eps: f64,
    /// Requested directions.
    pub directions: usize,
    /// Directions evaluated from the samples; the others follow by interpolation or symmetry.
    pub evaluated: usize,
    /// The planner's estimate of a run, microseconds (a model, not a measurement).
    pub estimate_us: f64,
    /// Bytes of tables.
    pub table_bytes: usize,
    /// The directions not computed, and why.
    pub skipped: Vec<String>,
    /// Sizes inside: kernel width, FFT lengths, band limits.
    pub detail: String,
}

impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} in {} precision with {}, eps {:.1e}, about {:.0} us, {} kB of tables",
            words(self.method),
            self.precision,
            instructions(self.tier),
            self.eps,
            self.estimate_us,
            self.table_bytes / 1024
        )?;
        writeln!(f, "  {} of {} directions evaluated; {}", self.evaluated, self.directions, self.detail)?;
        for skipped in &self.skipped {
            writeln!(f, "  skipped: {skipped}")?;
        }
        Ok(())
    }
}

/// What became of the elevation in a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum ElevationSearch {
    /// The limit of |elevation| was 0: only the horizon was searched.
    NotAsked,
    /// Its predicted deviation is above that of a uniform guess within the limits: only the horizon was searched.
    NotObservable,
    /// It was searched along with the azimuth.
    Searched,
}

/// Computed and skipped parts of a guaranteed search, as a value that prints.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SearchPlan {
    /// The SIMD tier.
    pub tier: Tier,
    /// The precision of the samples of the profile; peaks are climbed in double.
    pub precision: Precision,
    /// Modes around a ring that phases can reach.
    pub band_limit: usize,
    /// Azimuths of a ring that are summed, half of them as antipodes where the motion is level.
    pub summed: usize,
    /// Azimuths of a ring that are interpolated from them: enough that no maximum is missed.
    pub sampled: usize,
    /// Rings of constant elevation.
    pub rings: usize,
    /// Directions in which the profile was computed exactly, on the way to its peaks.
    pub exact: usize,
    /// Samples that each of these sums is over.
    pub samples: usize,
    /// What became of the elevation.
    pub elevation: ElevationSearch,
    /// True if the motion is level: rings below the horizon are those above it.
    pub level: bool,
    /// The estimate of its cost, microseconds (a model, not a measurement).
    pub estimate_us: f64,
}

impl SearchPlan {
    /// The directions not computed, and why.
    #[must_use]
    pub fn skipped(&self) -> Vec<String> {
        let mut list = vec![format!(
            "the profile on any grid: {} azimuths a ring hold its {} modes, and its maximum is found between them",
            self.summed, self.band_limit
        )];
        match self.elevation {
            ElevationSearch::NotAsked => list.push("every elevation: not asked for".into()),
            ElevationSearch::NotObservable => {
                list.push("every elevation but the horizon: this motion cannot observe it".into());
            }
            ElevationSearch::Searched if self.level => list.push("the lower hemisphere: the motion is level".into()),
            ElevationSearch::Searched => {}
        }
        list
    }
}

impl fmt::Display for SearchPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "search in {} precision with {}, about {:.0} us: {} rings of {} sums over {} samples, {} exact looks in double",
            self.precision,
            instructions(self.tier),
            self.estimate_us,
            self.rings,
            self.summed,
            self.samples,
            self.exact
        )?;
        self.skipped().iter().try_for_each(|skipped| writeln!(f, "  skipped: {skipped}"))
    }
}
