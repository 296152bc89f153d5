//! FFTs of the requested tier.

use std::sync::Arc;

#[cfg(target_arch = "x86_64")]
use rustfft::FftPlannerSse;
use rustfft::{Fft, FftNum, FftPlanner, FftPlannerScalar};

use crate::simd::{Real, Tier};

/// The interface of all planners of `rustfft`.
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

/// The planners in one precision; only [`Real`] calls it, so that only this crate compiles `rustfft`.
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

/// A planner of `rustfft`, type-erased.
pub struct Planner<T: FftNum>(pub(crate) Box<dyn Plans<T>>);

impl<T: Real> Ffts<T> {
    /// For a tier that this machine supports. (The AVX-512 tier uses the FFTs of AVX2, the widest there are.)
    pub fn new(tier: Tier) -> Self {
        Self { tier, planner: T::planner(tier) }
    }

    /// The tier of the plans.
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

/// The least even `2^a 3^b 5^c >= n`: lengths with fast FFTs.
pub fn good_size(n: usize) -> usize {
    let even = n.max(2).next_multiple_of(2);
    (even..).step_by(2).find(|m| is_smooth(*m, &[2, 3, 5])).unwrap_or(even)
}

/// The least multiple of `step` that is at least `n` and has no prime factor above 11: for short FFTs, where each extra value
/// costs a sum over all samples.
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
