//! Reads a configuration and collects all its problems: unreadable parts are removed, and the rest is read again. Values as the
//! file writes them.

use super::Config;
use csi5300::motion::odometry::opencr::Geometry;
use csi5300::signal::channel::Channel;
use csi5300_sim::toml_lines::line_of;
use driver_iface::bfee::Antenna;
use serde::de::{Deserialize, Deserializer, Error as _};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::ops::Range;
use std::str::FromStr;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Limit of reported problems: a file with more is another kind of file.
const MOST: usize = 64;
/// Limit of reported syntax errors: the first ones cause many of the others.
const FEW: usize = 5;
/// Stand-ins for missing or wrong keys, so that the rest can be read. A configuration with one is refused.
const STAND_INS: &str = "channel = \"108\"\ncapture.card = {}\n";

/// All problems of a configuration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
pub struct ConfigError(pub Vec<Problem>);

/// One problem.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Line, from 1, where there is one.
    pub line: Option<usize>,
    /// The problem and its remedy.
    pub reason: String,
}

impl Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.line {
            Some(line) => write!(f, "line {line}: {}", self.reason),
            None => f.write_str(&self.reason),
        }
    }
}

/// A configuration as far as it can be read.
pub(super) struct Reading<'t> {
    /// None if nothing is left to check.
    pub config: Option<Config>,
    /// What of the text was read.
    pub table: DeTable<'t>,
    pub problems: Vec<Problem>,
    /// Top-level keys with unreadable parts.
    pub gone: BTreeSet<String>,
    /// Those that were replaced by stand-ins.
    pub stand_ins: BTreeSet<String>,
}

/// A removed part.
struct Cut {
    /// The span of the table that it was in, and its key there.
    within: Range<usize>,
    key: String,
}

impl<'t> Reading<'t> {
    pub fn of(text: &'t str) -> Self {
        let problem = |span: Option<Range<usize>>, reason: &str| Problem {
            line: span.map(|span| line_of(text, span.start)),
            reason: match meant(reason) {
                Some(meant) => format!("{reason}; did you mean `{meant}`?"),
                None => reason.to_owned(),
            },
        };
        let (document, wrong) = DeTable::parse_recoverable(text);
        let (whole, table) = (document.span(), document.into_inner());
        let mut problems: Vec<Problem> = wrong.iter().map(|error| problem(error.span(), error.message())).collect();
        let few = if table.is_empty() { 1 } else { FEW };
        let more = problems.len().saturating_sub(few);
        problems.truncate(few);
        if let Some(last) = problems.last_mut().filter(|_| more > 0) {
            last.reason += &match table.is_empty() {
                true => format!(" ({more} further errors: this file is no configuration in TOML)"),
                false => format!(" ({more} further syntax errors)"),
            };
        }
        let (gone, stand_ins) = (BTreeSet::new(), BTreeSet::new());
        let mut reading = Self { config: None, table, problems: Vec::new(), gone, stand_ins };
        let mut cuts: Vec<Cut> = Vec::new();
        while problems.is_empty() || (wrong.is_empty() && problems.len() < MOST) {
            let error =
                match Config::deserialize(toml::Deserializer::from(Spanned::new(whole.clone(), reading.table.clone())))
                {
                    Ok(config) => {
                        reading.config = Some(config);
                        break;
                    }
                    Err(error) => error,
                };
            let missing = missing_key(error.message()).map(str::to_owned);
            let span = error.span().unwrap_or(whole.clone());
            // Missing because it, or all alternatives, were removed.
            let is_empty = error.message().starts_with("wanted exactly 1 element");
            let was_cut = |cut: &Cut| cut.within == span && (is_empty || missing.as_ref() == Some(&cut.key));
            if !cuts.iter().any(was_cut) {
                problems.push(problem(error.span(), error.message()));
            }
            match take_out(&mut reading.table, &whole, &span) {
                Some((top, cut)) => {
                    reading.gone.insert(top);
                    cuts.push(cut);
                }
                None if missing.as_deref().is_some_and(|key| reading.stand_in(key)) => {}
                None => break,
            }
        }
        reading.problems = problems;
        reading
    }

    /// Puts a stand-in for a missing key; false if there is none.
    fn stand_in(&mut self, key: &str) -> bool {
        let found = DeTable::parse(STAND_INS).ok().and_then(|mut table| table.get_mut().remove_entry(key));
        found.is_some_and(|(name, value)| {
            self.gone.insert(key.to_owned());
            self.stand_ins.insert(key.to_owned());
            self.table.insert(name, value).is_none()
        })
    }
}

/// The known key nearest to an unknown one, if fewer than a third of its letters differ.
fn meant(message: &str) -> Option<&str> {
    let (field, known) =
        ["unknown field `", "unknown variant `"].iter().find_map(|kind| message.strip_prefix(kind))?.split_once('`')?;
    let known = known.split('`').skip(1).step_by(2);
    let (off, meant) = known.map(|key| (strsim::damerau_levenshtein(field, key), key)).min()?;
    (3 * off <= field.len()).then_some(meant)
}

/// The missing key of an error, if any.
fn missing_key(message: &str) -> Option<&str> {
    message.strip_prefix("missing field `")?.strip_suffix('`')
}

/// Removes the value or key of an error's span, the innermost first; returns also its top-level key. An array of tables
/// has the span of its first one.
fn take_out(table: &mut DeTable<'_>, own: &Range<usize>, span: &Range<usize>) -> Option<(String, Cut)> {
    for (name, value) in table.iter_mut() {
        if let Some((_, cut)) = take_out_below(value, span) {
            return Some((name.get_ref().to_string(), cut));
        }
    }
    let is_it = |name: &Spanned<_>, value: &Spanned<DeValue<'_>>| name.span() == *span || value.span() == *span;
    let found = table.iter().find(|(name, value)| is_it(name, value)).map(|(name, _)| name.get_ref().to_string());
    found.filter(|key| table.remove(key.as_str()).is_some()).map(|key| {
        let cut = Cut { within: own.clone(), key: key.clone() };
        (key, cut)
    })
}

fn take_out_below(value: &mut Spanned<DeValue<'_>>, span: &Range<usize>) -> Option<(String, Cut)> {
    let own = value.span();
    match value.get_mut() {
        DeValue::Table(table) => take_out(table, &own, span),
        DeValue::Array(array) => {
            if let Some(at) = array.iter().position(|item| item.span() == *span) {
                *array = array.iter().enumerate().filter(|(k, _)| *k != at).map(|(_, item)| item.clone()).collect();
                return Some((String::new(), Cut { within: own, key: String::new() }));
            }
            array.iter_mut().find_map(|item| take_out_below(item, span))
        }
        _ => None,
    }
}

pub(super) fn parsed<'de, D: Deserializer<'de>, T: FromStr<Err: Display>>(input: D) -> Result<T, D::Error> {
    String::deserialize(input)?.parse().map_err(D::Error::custom)
}

pub(super) fn maybe_parsed<'de, D: Deserializer<'de>, T: FromStr<Err: Display>>(
    input: D,
) -> Result<Option<T>, D::Error> {
    parsed(input).map(Some)
}

/// A channel: text, or the number of one of 20 MHz.
pub(super) fn channel<'de, D: Deserializer<'de>>(input: D) -> Result<Channel, D::Error> {
    #[derive(serde::Deserialize)]
    #[serde(untagged, expecting = "a channel: \"108\", \"36+\" for 40 MHz, or its centre, \"5290MHz\"")]
    enum Written {
        Number(u32),
        Text(String),
    }
    let text = match Written::deserialize(input)? {
        Written::Number(number) => number.to_string(),
        Written::Text(text) => text,
    };
    text.parse().map_err(D::Error::custom)
}

/// A TurtleBot3: Burger, or Waffle and Waffle Pi.
pub(super) fn model<'de, D: Deserializer<'de>>(input: D) -> Result<Option<Geometry>, D::Error> {
    match String::deserialize(input)?.as_str() {
        "burger" => Ok(Some(Geometry::BURGER)),
        "waffle" => Ok(Some(Geometry::WAFFLE)),
        other => Err(D::Error::unknown_variant(other, &["burger", "waffle"])),
    }
}

pub(super) fn antenna<'de, D: Deserializer<'de>>(input: D) -> Result<Antenna, D::Error> {
    let name = String::deserialize(input)?;
    let found = Antenna::ALL.into_iter().find(|antenna| antenna.to_string() == name);
    found.ok_or_else(|| D::Error::custom(format!("antenna `{name}`: A, B or C")))
}

pub(super) fn antennas<'de, D: Deserializer<'de>>(input: D) -> Result<Vec<Antenna>, D::Error> {
    #[derive(serde::Deserialize)]
    struct One(#[serde(deserialize_with = "antenna")] Antenna);
    Ok(Vec::<One>::deserialize(input)?.into_iter().map(|one| one.0).collect())
}

/// A number, if `is_good`; `words` say which are.
fn number<'de, D: Deserializer<'de>>(input: D, is_good: impl Fn(f64) -> bool, words: &str) -> Result<f64, D::Error> {
    let value = f64::deserialize(input)?;
    if is_good(value) { Ok(value) } else { Err(D::Error::custom(format!("{value:?}: {words}"))) }
}

pub(super) fn positive<'de, D: Deserializer<'de>, T: From<f64>>(input: D) -> Result<T, D::Error> {
    number(input, |value| value.is_finite() && value > 0.0, "a number above 0").map(T::from)
}

pub(super) fn finite<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    number(input, f64::is_finite, FINITE)
}

/// What every number of a place and every angle must be.
const FINITE: &str = "every number must be finite";

/// Largest distance of a part from the middle of a robot, metres.
const ON_ROBOT_M: f64 = 10.0;

/// A coordinate of a part of a robot, metres.
#[derive(Clone, Copy)]
struct OnRobot(f64);

impl<'de> Deserialize<'de> for OnRobot {
    fn deserialize<D: Deserializer<'de>>(input: D) -> Result<Self, D::Error> {
        let is_good = |m: f64| m.abs() <= ON_ROBOT_M;
        number(input, is_good, "metres from the middle of the robot, 10 at most").map(Self)
    }
}

pub(super) fn on_robot<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    OnRobot::deserialize(input).map(|own| own.0)
}

/// A part's place on a robot: metres forward, left, up.
pub(super) fn offset<'de, D: Deserializer<'de>>(input: D) -> Result<[f64; 3], D::Error> {
    all_of(Vec::<OnRobot>::deserialize(input)?).map(|own| own.map(|m| m.0))
}

/// Numbers of a list that must have `N` of them: arrays of serde ignore further ones.
fn all_of<const N: usize, T, E: serde::de::Error>(all: Vec<T>) -> Result<[T; N], E> {
    let count = all.len();
    all.try_into().map_err(|_| E::custom(format!("{count} numbers where {N} are expected")))
}

/// `N` finite numbers.
struct Exactly<const N: usize>([f64; N]);

impl<'de, const N: usize> Deserialize<'de> for Exactly<N> {
    fn deserialize<D: Deserializer<'de>>(input: D) -> Result<Self, D::Error> {
        let all = Vec::<f64>::deserialize(input)?;
        if all.iter().all(|value| value.is_finite()) { all_of(all).map(Self) } else { Err(D::Error::custom(FINITE)) }
    }
}

pub(super) fn exactly<'de, const N: usize, D: Deserializer<'de>>(input: D) -> Result<[f64; N], D::Error> {
    Exactly::deserialize(input).map(|own| own.0)
}

pub(super) fn lists<'de, const N: usize, D: Deserializer<'de>>(input: D) -> Result<Vec<[f64; N]>, D::Error> {
    Vec::<Exactly<N>>::deserialize(input).map(|all| all.into_iter().map(|own| own.0).collect())
}

pub(super) fn named<'de, const N: usize, D: Deserializer<'de>>(
    input: D,
) -> Result<BTreeMap<String, [f64; N]>, D::Error> {
    let all = BTreeMap::<String, Exactly<N>>::deserialize(input)?;
    Ok(all.into_iter().map(|(name, own)| (name, own.0)).collect())
}
