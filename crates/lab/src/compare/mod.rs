//! Compares a recorded capture with a simulated one of the same scene, figure by figure.
//!
//! [`Figures`] are the measurable properties of any capture: its records, their times, and the effects of radios and
//! channel on the phase. [`rows`] compares those of two captures with their limits, and [`fit()`] derives a scene from
//! a recorded capture.

pub mod distribution;
mod error;
pub mod figures;
pub mod fit;
mod fitted_scene;
mod pattern;
pub mod side;
pub mod table;

pub use error::CompareError;
pub use figures::{Figures, LinkFigures, measure, measure_scene, measure_scene_along};
pub use fit::{Fitted, fit};
pub use fitted_scene::{channel_of, scene_channel};
pub use table::{FigureRow, Verdict, rows};
