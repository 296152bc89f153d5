//! Why a scene is refused, and its place.

use super::toml_lines::{Step, TomlLines};
use std::fmt;
use std::path::{Path, PathBuf};

/// Why a scene was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// Its file could not be read.
    #[error("cannot read {}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// Neither a file nor a built-in scene has the name.
    #[error("there is no file {}, and no built-in scene of that name: {}", scene.display(), super::BUILT_IN.map(|own| own.0).join(", "))]
    Nowhere {
        /// The name.
        scene: PathBuf,
    },
    /// It is not TOML, or not a scene: an unknown key, a value of another type.
    #[error("{}{reason}", At(*line))]
    Toml {
        /// Line of the text, from 1, where it is known.
        line: Option<usize>,
        /// What the TOML reader said.
        reason: String,
    },
    /// A value is invalid, or robots are at impossible places.
    #[error("{}{reason}", At(*line))]
    Value {
        /// The way to the value from the scene's root, `robot[1].faults.loss`.
        place: ScenePlace,
        /// Line of the text, from 1; `None` for a scene without a text.
        line: Option<usize>,
        /// The problem, and valid values.
        reason: String,
    },
    /// A value has no text in TOML.
    #[error("the scene cannot be written: {reason}")]
    Unwritable {
        /// What the TOML writer said.
        reason: String,
    },
}

/// The line of a text, before what is wrong with it.
struct At(Option<usize>);

impl fmt::Display for At {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.map_or(Ok(()), |line| write!(f, "line {line}: "))
    }
}

impl SceneError {
    /// Line of the text, from 1, where it is known.
    #[must_use]
    pub fn line(&self) -> Option<usize> {
        match self {
            Self::Toml { line, .. } | Self::Value { line, .. } => *line,
            Self::Io { .. } | Self::Nowhere { .. } | Self::Unwritable { .. } => None,
        }
    }

    /// Why a scene was refused, with the name of its file, once.
    #[must_use]
    pub fn of_file(&self, file: &Path) -> String {
        match self {
            Self::Io { .. } | Self::Nowhere { .. } => self.to_string(),
            _ => format!("{}: {self}", file.display()),
        }
    }

    /// True if the scene is readable but invalid.
    #[must_use]
    pub fn is_of_text(&self) -> bool {
        matches!(self, Self::Toml { .. } | Self::Value { .. })
    }

    /// The same error with its line in the text.
    #[must_use]
    pub fn locate(self, text: &str) -> Self {
        match self {
            Self::Value { place, line: None, reason } => {
                let line = TomlLines::new(text).line(&place.0);
                Self::Value { place, line, reason }
            }
            other => other,
        }
    }
}

/// The way to a value from a scene's root.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ScenePlace(Vec<Step<'static>>);

impl fmt::Display for ScenePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (depth, step) in self.0.iter().enumerate() {
            match step {
                Step::Key(key) if depth == 0 => write!(f, "{key}")?,
                Step::Key(key) => write!(f, ".{key}")?,
                Step::Index(index) => write!(f, "[{index}]")?,
            }
        }
        Ok(())
    }
}

/// A problem and its place so far: outer tables add their names later.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Problem {
    place: ScenePlace,
    pub(crate) reason: String,
}

pub(crate) type Checked = Result<(), Problem>;

impl Problem {
    pub(crate) fn new(reason: impl Into<String>) -> Self {
        Self { place: ScenePlace::default(), reason: reason.into() }
    }

    /// The same place with another reason.
    pub(crate) fn because(self, reason: String) -> Self {
        Self { reason, ..self }
    }

    /// The same problem, one level further out.
    pub(crate) fn within(mut self, step: Step<'static>) -> Self {
        self.place.0.insert(0, step);
        self
    }

    pub(crate) fn key(self, key: &'static str) -> Self {
        self.within(Step::Key(key))
    }

    /// The same problem of a table in an array of tables.
    pub(crate) fn item(self, key: &'static str, index: usize) -> Self {
        self.within(Step::Index(index)).key(key)
    }
}

impl From<Problem> for SceneError {
    fn from(problem: Problem) -> Self {
        Self::Value { place: problem.place, line: None, reason: problem.reason }
    }
}

/// Refuses a value unless `ok`.
pub(crate) fn ensure(ok: bool, key: &'static str, reason: impl FnOnce() -> String) -> Checked {
    if ok { Ok(()) } else { Err(Problem::new(format!("{key} {}", reason())).key(key)) }
}

/// Largest value of any unit: products stay finite.
const LARGEST: f64 = 1e9;
/// Smallest divisor.
const SMALLEST: f64 = 1e-9;
/// Largest ratio of two powers, dB.
const FURTHEST_DB: f64 = 400.0;

/// Refuses negative and too large values.
pub(crate) fn not_negative(key: &'static str, value: f64) -> Checked {
    ensure(value >= 0.0, key, || format!("is {value}; it must be a number of at least 0"))?;
    at_most(key, value, LARGEST)
}

/// Refuses values that are not positive, too large or too small.
pub(crate) fn positive(key: &'static str, value: f64) -> Checked {
    ensure(value > 0.0, key, || format!("is {value}; it must be more than 0"))?;
    ensure(value >= SMALLEST, key, || format!("is {value}; {SMALLEST:e} is the least"))?;
    at_most(key, value, LARGEST)
}

/// Refuses values above a limit that the machine can handle.
pub(crate) fn at_most(key: &'static str, value: f64, most: f64) -> Checked {
    ensure(value <= most, key, || format!("is {value}; {most} is the most"))
}

/// Refuses values that are no share.
pub(crate) fn share(key: &'static str, value: f64) -> Checked {
    ensure((0.0..=1.0).contains(&value), key, || format!("is {value}; it is a share, from 0 to 1"))
}

/// Refuses values that are not finite or too large.
pub(crate) fn finite(key: &'static str, values: &[f64]) -> Checked {
    ensure(values.iter().all(|v| v.abs() <= LARGEST), key, || {
        format!("must be finite numbers, of at most {LARGEST:e} either side of 0")
    })
}

/// Refuses invalid deviations of decibels.
pub(crate) fn deviation_db(key: &'static str, value: f64) -> Checked {
    not_negative(key, value)?;
    at_most(key, value, FURTHEST_DB)
}

/// Refuses invalid decibels.
pub(crate) fn decibels(key: &'static str, values: &[f64]) -> Checked {
    ensure(values.iter().all(|v| v.abs() <= FURTHEST_DB), key, || {
        format!("must be finite numbers of dB, of at most {FURTHEST_DB} either side of 0")
    })
}
