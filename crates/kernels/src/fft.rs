//! FFTs of the tier that was asked for.

use std::sync::Arc;

use rustfft::{Fft, FftNum, FftPlanner, FftPlannerScalar};

use crate::simd::Tier;

/// The planner of one tier, with its cache.
pub struct Ffts<T: FftNum> {
    tier: Tier,
    planner: Planner<T>,
}

enum Planner<T: FftNum> {
    Detected(FftPlanner<T>),
    #[cfg(target_arch = "x86_64")]
    Sse(rustfft::FftPlannerSse<T>),
    Scalar(FftPlannerScalar<T>),
}

impl<T: FftNum> Ffts<T> {
    /// For a tier that this machine can run. (An AVX-512 tier runs the FFTs of AVX2: there are no wider ones.)
    pub fn new(tier: Tier) -> Self {
        let planner = match tier {
            #[cfg(target_arch = "x86_64")]
            Tier::Sse42 => {
                rustfft::FftPlannerSse::new().map_or_else(|()| Planner::Scalar(FftPlannerScalar::new()), Planner::Sse)
            }
            Tier::Avx2 | Tier::Avx512 | Tier::Native => Planner::Detected(FftPlanner::new()),
            _ => Planner::Scalar(FftPlannerScalar::new()),
        };
        Self { tier, planner }
    }

    /// The tier that plans are made for.
    pub fn tier(&self) -> Tier {
        self.tier
    }

    /// The forward transform of `length` points, planned once.
    pub fn forward(&mut self, length: usize) -> Arc<dyn Fft<T>> {
        match &mut self.planner {
            Planner::Detected(planner) => planner.plan_fft_forward(length),
            #[cfg(target_arch = "x86_64")]
            Planner::Sse(planner) => planner.plan_fft_forward(length),
            Planner::Scalar(planner) => planner.plan_fft_forward(length),
        }
    }

    /// The inverse transform of `length` points, planned once.
    pub fn inverse(&mut self, length: usize) -> Arc<dyn Fft<T>> {
        match &mut self.planner {
            Planner::Detected(planner) => planner.plan_fft_inverse(length),
            #[cfg(target_arch = "x86_64")]
            Planner::Sse(planner) => planner.plan_fft_inverse(length),
            Planner::Scalar(planner) => planner.plan_fft_inverse(length),
        }
    }
}

/// The least even `2^a 3^b 5^c >= n`: lengths that FFTs like.
pub fn good_size(n: usize) -> usize {
    let even = n.max(2).next_multiple_of(2);
    (even..).step_by(2).find(|m| is_smooth(*m, &[2, 3, 5])).unwrap_or(even)
}

/// The least multiple of `step` from `n` on without a prime above 11: for short FFTs beside which each value costs a sum
/// over all samples.
pub fn near_size(n: usize, step: usize) -> usize {
    let least = n.max(step).next_multiple_of(step);
    (least..).step_by(step).find(|m| is_smooth(*m, &[2, 3, 5, 7, 11])).unwrap_or(least)
}

fn is_smooth(n: usize, primes: &[usize]) -> bool {
    let divide = |mut rest: usize, p: &usize| {
        while rest.is_multiple_of(*p) {
            rest /= p;
        }
        rest
    };
    primes.iter().fold(n, divide) == 1
}
