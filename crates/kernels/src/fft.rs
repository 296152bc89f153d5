//! FFTs of the tier that was asked for.

use std::sync::Arc;

#[cfg(target_arch = "x86_64")]
use rustfft::FftPlannerSse;
use rustfft::{Fft, FftNum, FftPlanner, FftPlannerScalar};

use crate::simd::{Real, Tier};

/// What each of the planners of `rustfft` can do.
pub(crate) trait Plans<T: FftNum>: Send {
    fn forward(&mut self, length: usize) -> Arc<dyn Fft<T>>;
    fn inverse(&mut self, length: usize) -> Arc<dyn Fft<T>>;
}

macro_rules! plans {
    ($planner:ident) => {
        impl<T: FftNum> Plans<T> for $planner<T> {
            fn forward(&mut self, length: usize) -> Arc<dyn Fft<T>> {
                self.plan_fft_forward(length)
            }

            fn inverse(&mut self, length: usize) -> Arc<dyn Fft<T>> {
                self.plan_fft_inverse(length)
            }
        }
    };
}
plans!(FftPlanner);
plans!(FftPlannerScalar);
#[cfg(target_arch = "x86_64")]
plans!(FftPlannerSse);

/// The planners in one precision; only [`Real`] calls it, so that all of `rustfft` is compiled in this crate alone.
#[inline(always)]
pub(crate) fn plans_of<T: FftNum>(tier: Tier) -> Box<dyn Plans<T>> {
    match tier {
        #[cfg(target_arch = "x86_64")]
        Tier::Sse42 => match FftPlannerSse::new() {
            Ok(planner) => Box::new(planner),
            Err(()) => Box::new(FftPlannerScalar::new()),
        },
        Tier::Avx2 | Tier::Avx512 | Tier::Native => Box::new(FftPlanner::new()),
        _ => Box::new(FftPlannerScalar::new()),
    }
}

/// The planner of one tier, with its cache.
pub struct Ffts<T: Real> {
    tier: Tier,
    planner: Planner<T>,
}

/// A planner of `rustfft`, without its type.
pub struct Planner<T: FftNum>(pub(crate) Box<dyn Plans<T>>);

impl<T: Real> Ffts<T> {
    /// For a tier that this machine can run. (An AVX-512 tier runs the FFTs of AVX2: there are no wider ones.)
    pub fn new(tier: Tier) -> Self {
        Self { tier, planner: T::planner(tier) }
    }

    /// The tier that plans are made for.
    pub fn tier(&self) -> Tier {
        self.tier
    }

    /// The forward transform of `length` points, planned once.
    pub fn forward(&mut self, length: usize) -> Arc<dyn Fft<T>> {
        self.planner.0.forward(length)
    }

    /// The inverse transform of `length` points, planned once.
    pub fn inverse(&mut self, length: usize) -> Arc<dyn Fft<T>> {
        self.planner.0.inverse(length)
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
