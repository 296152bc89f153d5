//! The vector code of `csi5300`, in a crate of its own so that it is compiled once, optimised in every profile, and not
//! again with each edit of the library. Internal, without a stable interface: use `csi5300::bartlett`.
//!
//! | module | what it computes |
//! |---|---|
//! | [`simd`] | tiers, the two precisions, sine and cosine of an angle in turns |
//! | [`sums`] | direct sums over samples, and their derivatives |
//! | [`kernel`] | the spreading window of the NUFFT, its transform and its polynomials |
//! | [`setting`] | width and oversampling by tolerance; one axis of a grid |
//! | [`nufft`] | non-uniform to non-uniform transforms in a plane |
//! | [`rings`], [`resample`] | profiles on rings of equal elevation from few evaluated directions |
//! | [`cone`] | motion along a line: one dimension is enough |
//! | [`evaluate`] | all of these behind one type, chosen by the planner |
//! | [`fft`] | plans of `rustfft` for the tier, sizes that it likes |
//!
//! Everything that is generic over the precision is entered through [`simd::Real`], whose methods are compiled here for
//! `f32` and `f64` and for every tier; callers compile none of it.

pub mod cone;
pub mod evaluate;
pub mod fft;
pub mod kernel;
pub mod nufft;
pub mod resample;
pub mod rings;
pub mod setting;
pub mod simd;
pub mod sums;
