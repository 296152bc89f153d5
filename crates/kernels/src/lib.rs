//! The vector code of `csi5300`. A crate of its own is compiled once, optimised in every profile, and not recompiled with each
//! edit of the library. Internal, without a stable interface: use `csi5300::bartlett`.
//!
//! | module | what it computes |
//! |---|---|
//! | [`simd`] | tiers, the two precisions, sine and cosine of an angle in turns |
//! | [`sums`] | direct sums over samples, and their derivatives |
//! | [`nufft`] | non-uniform to non-uniform transforms in a plane and along a line, their spreading window and its settings |
//! | [`rings`] | profiles on rings of equal elevation from few evaluated directions |
//! | [`evaluate`] | all of these behind one type, chosen by the planner |
//! | [`fft`] | plans of `rustfft` for the tier, lengths with fast FFTs |
//!
//! [`simd::Real`] is the entry to all code that is generic over the precision. Its methods are compiled here for `f32` and
//! `f64` and for every tier; callers compile none of it.

pub mod evaluate;
pub mod fft;
pub mod nufft;
pub mod rings;
pub mod simd;
pub mod sums;
