//! Kernel settings for a tolerance, and the grid of one dimension.

/// Kernel width and oversampling, and the error they cause, relative to `sum |z|`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Cells that the window covers.
    pub width: usize,
    /// Cells per band limit.
    pub oversampling: f64,
    /// Error of both kernels in both dimensions, measured ([`crate::kernel::Kernel::loss`]).
    pub loss: f64,
}

const fn setting(width: usize, oversampling: f64, loss: f64) -> Setting {
    Setting { width, oversampling, loss }
}

/// In order of cost.
const SETTINGS: [Setting; 10] = [
    setting(4, 2.0, 4.4e-3),
    setting(8, 1.5, 1.5e-5),
    setting(8, 1.75, 2.8e-6),
    setting(8, 2.0, 7.5e-7),
    setting(12, 1.5, 1.3e-8),
    setting(12, 1.75, 8e-10),
    setting(12, 2.0, 1.4e-10),
    setting(16, 1.5, 9.2e-12),
    setting(16, 1.75, 2.6e-13),
    setting(16, 2.0, 6e-14),
];

impl Setting {
    /// The cheapest setting with an error of at most `eps`, or `None`. Widths 4 and 8 exist in single precision, 8 to 16 in
    /// double.
    pub fn for_eps(eps: f64, single: bool) -> Option<Self> {
        let there = |width: usize| if single { width <= 8 } else { width >= 8 };
        SETTINGS.into_iter().find(|s| s.loss <= eps && there(s.width))
    }
}

/// One dimension of the transform.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Grid cells per turn of position.
    pub per_turn: f64,
    /// Cells on either side of the middle that samples reach.
    pub half: usize,
    /// FFT length.
    pub n: usize,
}

impl Axis {
    /// For positions within `extent` turns of the middle.
    pub fn new(extent: f64, setting: Setting) -> Self {
        let sigma = setting.oversampling;
        let per_turn = 2.0 * sigma;
        let half = (extent * per_turn + 0.5 * setting.width as f64).ceil() as usize;
        // The second kernel's band, and room beyond the largest direction cosine.
        let band = (2.0 * sigma * half as f64).ceil() as usize;
        let room = ((setting.width + 3) as f64 / (1.0 - 1.0 / sigma)).ceil() as usize;
        Self { per_turn, half, n: crate::fft::good_size(band.max(room)) }
    }

    /// Number of cells that samples reach.
    pub fn support(&self) -> usize {
        2 * self.half + 1
    }

    /// First cell that a direction cosine `u` touches, and the offset for the polynomials.
    pub fn locate(&self, u: f64, width: usize) -> (isize, f64) {
        locate(u * self.n as f64 / self.per_turn, width)
    }
}

/// First cell that position `x` (cells) touches, and the offset for the polynomials.
pub fn locate(x: f64, width: usize) -> (isize, f64) {
    let middle = (width as f64 - 1.0) / 2.0;
    let first = (x - middle).round_ties_even();
    (first as isize, x - first - middle)
}
