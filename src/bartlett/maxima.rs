//! Local maxima of a sampled profile, found as its rows come: three rows of a side are kept, and never all of them.

/// A sample that none of its eight neighbours exceeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Maximum {
    /// Elevation of its row, radians.
    pub elevation: f64,
    /// Its place in the row.
    pub column: usize,
    /// The sample before it on its row, itself, and the one after it.
    pub around: [f64; 3],
}

impl Maximum {
    pub fn value(&self) -> f64 {
        self.around[1]
    }

    /// Where it is in its row, in steps: the vertex of the parabola through the logarithms of the three samples.
    pub fn vertex(&self) -> f64 {
        let [before, here, after] = self.around.map(|value| value.max(f64::MIN_POSITIVE).ln());
        let bend = before - 2.0 * here + after;
        let offset = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        self.column as f64 + offset
    }
}

/// The rows on one side of the horizon, from the horizon outwards: each is searched once the next one is there.
#[derive(Default)]
pub(super) struct Side {
    /// The row before the last one, and the last one; empty if there is none.
    before: Vec<f64>,
    last: Vec<f64>,
    elevation: f64,
    /// The last row is searched by another side.
    only_beside: bool,
    /// Which samples of a row may be maxima of it.
    high: Vec<bool>,
}

impl Side {
    /// The other side of a horizon that is the only row as yet; `row` is the first one there. The horizon is searched by this
    /// side alone.
    pub fn met_by(&mut self, row: &[f64]) -> Self {
        self.before = row.to_vec();
        Self { last: self.last.clone(), only_beside: true, ..Self::default() }
    }

    /// Takes the next row.
    pub fn push(&mut self, row: &[f64], elevation: f64, maxima: &mut Vec<Maximum>) {
        self.search(row, maxima);
        std::mem::swap(&mut self.before, &mut self.last);
        self.last.clear();
        self.last.extend_from_slice(row);
        (self.elevation, self.only_beside) = (elevation, false);
    }

    /// Searches the last row, after which there is none.
    pub fn end(&mut self, maxima: &mut Vec<Maximum>) {
        self.search(&[], maxima);
    }

    fn search(&mut self, next: &[f64], maxima: &mut Vec<Maximum>) {
        let ring = self.last.len();
        if self.only_beside || ring == 0 {
            return;
        }
        let row = &self.last;
        // Most are below a neighbour on their own ring: said of all in a plain loop, which is vector code.
        self.high.clear();
        self.high.resize(ring, false);
        for (high, around) in self.high[1..].iter_mut().zip(row.windows(3)) {
            *high = (around[1] >= around[0]) & (around[1] >= around[2]);
        }
        (self.high[0], self.high[ring - 1]) = (true, true);
        for (column, _) in self.high.iter().enumerate().filter(|(_, high)| **high) {
            let (before, after) =
                (if column == 0 { ring - 1 } else { column - 1 }, if column + 1 == ring { 0 } else { column + 1 });
            let around = [row[before], row[column], row[after]];
            let value = around[1];
            let below = |row: &[f64]| row.is_empty() || [before, column, after].iter().all(|c| row[*c] <= value);
            if around[0] <= value && around[2] <= value && below(&self.before) && below(next) {
                maxima.push(Maximum { elevation: self.elevation, column, around });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of ascending elevation, `rows[half]` the horizon.
    fn found(rows: &[Vec<f64>]) -> Vec<Maximum> {
        let half = rows.len() / 2;
        let mut maxima = Vec::new();
        let mut up = Side::default();
        up.push(&rows[half], 0.0, &mut maxima);
        if half > 0 {
            let mut down = up.met_by(&rows[half - 1]);
            for k in 1..=half {
                down.push(&rows[half - k], -(k as f64), &mut maxima);
                up.push(&rows[half + k], k as f64, &mut maxima);
            }
            down.end(&mut maxima);
        }
        up.end(&mut maxima);
        maxima
    }

    #[test]
    fn the_maxima_are_those_that_no_neighbour_exceeds() {
        let mut state = 9u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64
        };
        for half in [0, 1, 2, 7] {
            let (n, ring) = (2 * half + 1, 11);
            let rows: Vec<Vec<f64>> = (0..n).map(|_| (0..ring).map(|_| random()).collect()).collect();
            let mut expected = Vec::new();
            for (r, own) in rows.iter().enumerate() {
                for (column, value) in own.iter().enumerate() {
                    let near = |row: &Vec<f64>| [ring - 1, 0, 1].map(|d| row[(column + d) % ring]);
                    let around = near(own);
                    let beside = rows[r.saturating_sub(1)..(r + 2).min(n)].iter().flat_map(near);
                    if beside.fold(0.0, f64::max) <= *value {
                        expected.push((r as f64 - half as f64, column, around));
                    }
                }
            }
            let mut got: Vec<_> = found(&rows).iter().map(|m| (m.elevation, m.column, m.around)).collect();
            got.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            assert!(!expected.is_empty());
            assert_eq!(got, expected, "{half}");
        }
    }
}
