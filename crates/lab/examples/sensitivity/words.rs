//! What was measured, in a line of a table.

use crate::figures::{FIGURES, Figure, Figures};

/// Errors that move by no more than this have not moved, degrees.
const STILL_DEG: f64 = 0.02;
/// Other figures that move by no more than this share have not moved.
const STILL_SHARE: f64 = 0.02;
/// Processor time that changes by no more than this factor is the machine's doing.
const STILL_TIME: f64 = 1.3;
/// Figures beside the errors of captures that are named at most.
const OTHERS: usize = 3;

/// `half: LOS +0.02/+0.01; double: no effect`, or `no effect` of both.
pub fn sentence(base: &Figures, half: Option<&Figures>, double: Option<&Figures>) -> String {
    match [half, double].map(|own| own.map_or_else(|| "cannot run".to_owned(), |own| moved(base, own))) {
        [half, double] if half == double => half,
        [half, double] => format!("half: {half}; double: {double}"),
    }
}

/// True if nothing that was measured moved.
pub fn is_still(base: &Figures, own: &Figures) -> bool {
    FIGURES.iter().all(|figure| difference(figure, base, own).is_none())
}

/// What moved: errors of the captures, or, where none did, what else.
fn moved(base: &Figures, own: &Figures) -> String {
    let of = |captures: bool| -> Vec<String> {
        FIGURES
            .iter()
            .filter(|figure| figure.of_captures() == captures)
            .filter_map(|f| difference(f, base, own))
            .collect()
    };
    let (mut said, others) = (of(true), of(false));
    if said.is_empty() {
        said.extend(others.into_iter().take(OTHERS));
    }
    let time = own.seconds.zip(base.seconds).map_or(1.0, |(own, base)| own / base);
    if !(1.0 / STILL_TIME..=STILL_TIME).contains(&time) {
        said.push(format!("time x{time:.1}"));
    }
    if said.is_empty() { "no effect".into() } else { said.join(", ") }
}

/// A figure's change, if it is one.
fn difference(figure: &Figure, base: &Figures, own: &Figures) -> Option<String> {
    let get = |figures: &Figures, name: &str| figures.values.get(name).copied().flatten();
    match *figure {
        Figure::Errors { name, mean, median } | Figure::Beside { name, mean, median } => {
            let change = |key: &str| get(own, key).zip(get(base, key)).map(|(own, base)| own - base);
            let (mean, median) = (change(mean)?, change(median)?);
            (mean.abs().max(median.abs()) > STILL_DEG).then(|| format!("{name} {}/{}", signed(mean), signed(median)))
        }
        Figure::Value { name, key } => {
            let (was, is) = (get(base, key), get(own, key));
            match (was, is) {
                (Some(was), Some(is)) if (is - was).abs() > STILL_SHARE * was.abs() => {
                    Some(format!("{name} {} instead of {}", plain(is), plain(was)))
                }
                (Some(_), None) if own.values.contains_key(key) => Some(format!("no {name}")),
                _ => None,
            }
        }
    }
}

/// Two digits, one above 1 degree in which the second says nothing.
fn signed(change_deg: f64) -> String {
    match change_deg.abs() {
        large if large >= 1.0 => format!("{change_deg:+.1}"),
        small if small < 0.005 => "0".into(),
        _ => format!("{change_deg:+.2}"),
    }
}

fn plain(value: f64) -> String {
    if value.fract() == 0.0 { format!("{value}") } else { format!("{value:.3}") }
}
