//! Symmetric matrix in envelope form and its Cholesky factor. Each row is stored from its first entry to the diagonal.

/// The lower triangle of a symmetric matrix, or its Cholesky factor.
#[derive(Clone, Debug)]
pub struct Envelope {
    /// Column of the first entry of each row.
    first: Vec<usize>,
    /// Offset of each row in `values`.
    begins: Vec<usize>,
    values: Vec<f64>,
}

impl Envelope {
    /// A zero matrix; row `k` begins at column `first[k]`.
    pub fn zeros(first: Vec<usize>) -> Self {
        let mut total = 0;
        let begin = |(row, first): (usize, &usize)| {
            let begin = total;
            total += row + 1 - first;
            begin
        };
        let begins = first.iter().enumerate().map(begin).collect();
        Self { first, begins, values: vec![0.0; total] }
    }

    pub fn len(&self) -> usize {
        self.first.len()
    }

    /// The entries of a row from column `from` up to `end`; `from` must be inside the envelope.
    fn row(&self, row: usize, from: usize, end: usize) -> &[f64] {
        let begin = self.begins[row] + from - self.first[row];
        &self.values[begin..begin + end - from]
    }

    /// Adds to an entry; the envelope must hold it.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        let (row, column) = if row < column { (column, row) } else { (row, column) };
        self.values[self.begins[row] + column - self.first[row]] += value;
    }

    /// Multiplies the diagonal by `1 + damping` and adds 1e-9, so that an unconstrained variable does not move.
    pub fn damp(&mut self, damping: f64) {
        for row in 0..self.len() {
            let at = self.begins[row] + row - self.first[row];
            self.values[at] = self.values[at] * (1.0 + damping) + 1e-9;
        }
    }

    /// The Cholesky factor. On failure, the row at which the matrix is not positive definite.
    pub fn factor(mut self) -> Result<Self, usize> {
        for row in 0..self.len() {
            for column in self.first[row]..=row {
                let from = self.first[row].max(self.first[column]);
                let sum = dot(self.row(row, from, column), self.row(column, from, column));
                let at = self.begins[row] + column - self.first[row];
                let rest = self.values[at] - sum;
                self.values[at] = if column < row {
                    rest / self.row(column, column, column + 1)[0]
                } else if rest > 1e-11 * self.values[at] {
                    rest.sqrt()
                } else {
                    return Err(row);
                };
            }
        }
        Ok(self)
    }

    /// Solves `L L' x = side` in place.
    pub fn solve(&self, side: &mut [f64]) {
        for row in 0..self.len() {
            let first = self.first[row];
            let known = dot(self.row(row, first, row), &side[first..row]);
            side[row] = (side[row] - known) / self.row(row, row, row + 1)[0];
        }
        for row in (0..self.len()).rev() {
            let first = self.first[row];
            side[row] /= self.row(row, row, row + 1)[0];
            let (before, rest) = side.split_at_mut(row);
            let own = self.row(row, first, row);
            before[first..].iter_mut().zip(own).for_each(|(x, a)| *x -= a * rest[0]);
        }
    }
}

/// Dot product in eight partial sums, so that additions need not wait for each other.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (mut sums, tail) = ([0.0; 8], a.len() - a.len() % 8);
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    let rest: f64 = a[tail..].iter().zip(&b[tail..]).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn envelope_and_dense_cholesky_give_the_same_solution() {
        let first = vec![0, 0, 1, 1, 3, 0];
        let mut own = Envelope::zeros(first.clone());
        let mut dense = DMatrix::<f64>::zeros(6, 6);
        for row in 0..6 {
            for column in first[row]..=row {
                let value = if row == column { 5.0 + row as f64 } else { 1.0 / (1.0 + (row + 2 * column) as f64) };
                own.add(column, row, value);
                (dense[(row, column)], dense[(column, row)]) = (value, value);
            }
        }
        let side = DVector::from_fn(6, |k, _| k as f64 - 2.5);
        let mut x = side.as_slice().to_vec();
        own.clone().factor().unwrap().solve(&mut x);
        let expected = dense.cholesky().unwrap().solve(&side);
        assert!((DVector::from_vec(x) - expected).norm() < 1e-12);
        own.add(3, 3, -20.0);
        assert_eq!(own.factor().unwrap_err(), 3);
    }
}
