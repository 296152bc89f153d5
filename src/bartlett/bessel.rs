//! Band limits from the actual Bessel tail.

/// The least `M` with `2 sum_{m > M} |J_m(x)| <= eps`, for `x >= 0`.
///
/// By Jacobi and Anger \[jacobi-anger\] `exp(j x cos a) = sum_m j^m J_m(x) exp(j m a)`: a sample at `x` radians from the middle of a
/// circle of directions needs the modes up to `M` and leaves out at most `eps`. Since `J_m` for `m > x` rises with `x`,
/// the largest radius of a trajectory bounds all of it.
pub(crate) fn tail_order(x: f64, eps: f64) -> usize {
    let eps = eps.clamp(1e-17, 1.0);
    // Far enough that everything beyond is below 1e-18: |J_m(x)| falls faster than any power beyond m = x, over a
    // transition of width x^(1/3).
    let top = (x + 16.0 * x.cbrt() + 40.0).ceil() as usize;
    let values = bessel_j(x, top);
    let mut tail = 0.0;
    for m in (1..=top).rev() {
        tail += 2.0 * values[m].abs();
        if tail > eps {
            return m;
        }
    }
    0
}

/// `J_0(x) .. J_top(x)` by Miller's backward recurrence \[miller-recurrence\], normalised by `J_0 + 2 sum J_2k = 1`.
pub(crate) fn bessel_j(x: f64, top: usize) -> Vec<f64> {
    let mut values = vec![0.0; top + 1];
    if x == 0.0 {
        values[0] = 1.0;
        return values;
    }
    // Deep enough in the decay that the arbitrary starting value has died out.
    let start = (top + 20).max((x + 16.0 * x.cbrt() + 60.0) as usize).next_multiple_of(2);
    let (mut above, mut here, mut norm) = (0.0f64, 1e-300f64, 0.0f64);
    for m in (1..=start).rev() {
        let below = 2.0 * m as f64 / x * here - above;
        (above, here) = (here, below);
        if here.abs() > 1e250 {
            above *= 1e-250;
            here *= 1e-250;
            norm *= 1e-250;
            values.iter_mut().for_each(|v| *v *= 1e-250);
        }
        if m - 1 <= top {
            values[m - 1] = here;
        }
        if (m - 1) % 2 == 0 {
            norm += if m == 1 { here } else { 2.0 * here };
        }
    }
    values.iter_mut().for_each(|v| *v /= norm);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_agree_with_tables() {
        // Abramowitz and Stegun, table 9.1 and 9.4.
        let j = bessel_j(1.0, 10);
        assert!((j[0] - 0.765_197_686_557_966_6).abs() < 1e-15);
        assert!((j[1] - 0.440_050_585_744_933_5).abs() < 1e-15);
        assert!((j[10] - 2.630_615_123_687_453e-10).abs() < 1e-22);
        let j = bessel_j(100.0, 120);
        assert!((j[0] - 0.019_985_850_304_223_12).abs() < 1e-14, "{}", j[0]);
        assert!((j[100] - 0.096_366_673_295_861_54).abs() < 1e-14);
    }

    #[test]
    fn the_tail_is_the_least_order_that_meets_eps() {
        for x in [0.5, 7.0, 69.7, 1_200.0] {
            for eps in [1e-3, 1e-6, 1e-12] {
                let m = tail_order(x, eps);
                let j = bessel_j(x, m + 200);
                let tail = |from: usize| 2.0 * j[from..].iter().map(|v| v.abs()).sum::<f64>();
                assert!(tail(m + 1) <= eps, "x {x} eps {eps}");
                assert!(tail(m) > eps, "x {x} eps {eps} could be lower");
            }
        }
        assert_eq!(tail_order(0.0, 1e-6), 0);
    }
}
