//! Random numbers that are the same on every machine: ChaCha8 streams \[chacha\] and a ziggurat \[ziggurat2000\].
//!
//! Each purpose (noise, timing, losses, odometry, a walk) of each robot has a stream of its own, so switching one
//! effect on does not change what another draws.

use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::OnceLock;

/// The purpose of a stream of random numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// Receiver noise and everything else inside one record.
    Radio,
    /// Send jitter, turn-around, host latency.
    Timing,
    /// Losses and duplicates.
    Loss,
    /// The odometry sensor.
    Odometry,
    /// A random walk.
    Walk,
    /// Constants of one card: phases of its synthesiser.
    Card,
    /// Phases between the chains of one card.
    Chains,
}

/// A deterministic source of random numbers.
#[derive(Clone, Debug)]
pub struct Stream {
    rng: ChaCha8Rng,
    ziggurat: &'static Ziggurat,
}

impl Stream {
    /// The stream of robot number `robot` for one purpose, under a scene's seed.
    #[must_use]
    pub(crate) fn new(seed: u64, robot: usize, purpose: Purpose) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(((robot as u64) << 8) | purpose as u64);
        Self { rng, ziggurat: Ziggurat::get() }
    }

    /// A stream that belongs to no robot, under a seed.
    #[must_use]
    pub fn of_seed(seed: u64) -> Self {
        Self { rng: ChaCha8Rng::seed_from_u64(seed), ziggurat: Ziggurat::get() }
    }

    /// Uniform from `low` to below `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        unit(self.bits())
    }

    /// Uniform over all numbers of 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.rng.next_u64()
    }

    /// Uniform from 0 to `end` - 1, with a bias of `end` / 2^64; 0 without a draw if there is no choice.
    pub fn below(&mut self, end: u64) -> u64 {
        if end <= 1 { 0 } else { ((u128::from(self.bits()) * u128::from(end)) >> 64) as u64 }
    }

    /// Uniform in [-1, 1).
    pub fn symmetric(&mut self) -> f64 {
        2.0 * self.uniform() - 1.0
    }

    /// True with the given probability. Nothing is drawn for probabilities of 0 and below, or 1 and above.
    pub fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && (probability >= 1.0 || self.uniform() < probability)
    }

    /// Normal with mean 0 and standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        loop {
            let bits = self.bits();
            let layer = (bits & 127) as usize;
            let u = 2.0 * unit(bits) - 1.0;
            let x = u * self.ziggurat.x[layer];
            if u.abs() < self.ziggurat.ratio[layer] {
                return x;
            }
            if let Some(x) = self.beyond(layer, u, x) {
                return x;
            }
        }
    }

    /// A normal number scaled by `std`; nothing is drawn when `std` is 0.
    pub fn spread(&mut self, std: f64) -> f64 {
        if std == 0.0 { 0.0 } else { std * self.normal() }
    }

    /// The rare part of the ziggurat: the tail, or the wedge of a layer (`None`: try again).
    #[cold]
    fn beyond(&mut self, layer: usize, u: f64, x: f64) -> Option<f64> {
        if layer == 0 {
            loop {
                // 1 - uniform is in (0, 1], so the logarithms are finite.
                let a = -libm::log(1.0 - self.uniform()) / Ziggurat::R;
                let b = -libm::log(1.0 - self.uniform());
                if 2.0 * b > a * a {
                    return Some((Ziggurat::R + a).copysign(u));
                }
            }
        }
        let (outer, inner) = (self.ziggurat.x[layer], self.ziggurat.x[layer + 1]);
        let high = libm::exp(-0.5 * (outer * outer - x * x));
        let low = libm::exp(-0.5 * (inner * inner - x * x));
        (high + self.uniform() * (low - high) < 1.0).then_some(x)
    }
}

/// The upper 53 bits as a number in [0, 1).
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Marsaglia and Tsang's ziggurat for the normal density, 128 layers, in Doornik's form ZIGNOR
/// \[ziggurat2000\].
#[derive(Debug)]
struct Ziggurat {
    x: [f64; 129],
    ratio: [f64; 128],
}

impl Ziggurat {
    /// Where the tail begins.
    const R: f64 = 3.442_619_855_899;
    /// The area of each layer.
    const V: f64 = 9.912_563_035_262_17e-3;

    fn get() -> &'static Self {
        static TABLE: OnceLock<Ziggurat> = OnceLock::new();
        TABLE.get_or_init(Self::build)
    }

    fn build() -> Self {
        let density = |x: f64| libm::exp(-0.5 * x * x);
        let mut x = [0.0; 129];
        x[0] = Self::V / density(Self::R);
        x[1] = Self::R;
        for i in 2..128 {
            x[i] = (-2.0 * libm::log(Self::V / x[i - 1] + density(x[i - 1]))).sqrt();
        }
        let mut ratio = [0.0; 128];
        for i in 0..128 {
            ratio[i] = x[i + 1] / x[i];
        }
        Self { x, ratio }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_have_the_normal_distribution() {
        let mut stream = Stream::new(7, 0, Purpose::Radio);
        let n = 400_000;
        let draws: Vec<f64> = (0..n).map(|_| stream.normal()).collect();
        let moment = |k: i32| draws.iter().map(|x| x.powi(k)).sum::<f64>() / f64::from(n);
        assert!(moment(1).abs() < 0.01, "mean {}", moment(1));
        assert!((moment(2) - 1.0).abs() < 0.01, "variance {}", moment(2));
        assert!(moment(3).abs() < 0.03, "skewness {}", moment(3));
        assert!((moment(4) - 3.0).abs() < 0.06, "kurtosis {}", moment(4));
        // Shares of the normal distribution inside 1 and 2, and beyond 3.5 (the ziggurat's tail).
        for (limit, share) in [(1.0, 0.682_689), (2.0, 0.954_500), (3.5, 0.999_535)] {
            let inside = draws.iter().filter(|x| x.abs() < limit).count() as f64 / f64::from(n);
            let error = (share * (1.0 - share) / f64::from(n)).sqrt();
            assert!((inside - share).abs() < 5.0 * error, "{inside} inside {limit}, not {share}");
        }
    }

    #[test]
    fn streams_are_the_same_everywhere_and_differ_by_purpose() {
        let draw = |seed, robot, purpose| {
            let mut s = Stream::new(seed, robot, purpose);
            [s.uniform().to_bits(), s.normal().to_bits()]
        };
        assert_eq!(draw(1, 0, Purpose::Radio), draw(1, 0, Purpose::Radio));
        for other in [draw(2, 0, Purpose::Radio), draw(1, 1, Purpose::Radio), draw(1, 0, Purpose::Loss)] {
            assert_ne!(draw(1, 0, Purpose::Radio), other);
        }
    }

    #[test]
    fn certain_events_draw_nothing() {
        let mut a = Stream::new(3, 0, Purpose::Loss);
        let mut b = a.clone();
        assert!(!a.happens(0.0) && a.happens(1.0) && a.spread(0.0) == 0.0);
        assert_eq!(a.uniform().to_bits(), b.uniform().to_bits());
    }
}
