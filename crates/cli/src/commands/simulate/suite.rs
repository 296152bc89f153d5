//! `csi5300 simulate suite`: the experiments of Dijkstra et al.

use super::super::draft::Draft;
use super::super::{Outcome, Result, print, print_json, progress, some, usage};
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::suite::{REPETITIONS, Summary, experiments, run_all, summarise};
use std::fmt::Write;
use std::path::Path;

// Which experiments to run.
#[derive(clap::Args, Clone)]
#[command(
    next_help_heading = "The experiments of Dijkstra et al. (SCENE is suite; --out names a CSV table with a row for each repetition)"
)]
pub struct Which {
    /// Repetitions of each experiment [default: 10]
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    repetitions: Option<u64>,
    /// Only experiments whose name contains this
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
}

impl Which {
    /// True if anything was asked of them.
    pub fn is_asked(&self) -> bool {
        self.repetitions.is_some() || self.only.is_some()
    }
}

/// Runs the experiments of Dijkstra et al. (\[paper\] in docs/reference/references.md) and prints a table of them.
pub fn run(which: &Which, path: &Path, force: bool, json: bool) -> Result {
    let mut all = experiments();
    if let Some(text) = &which.only {
        all.retain(|experiment| experiment.name.contains(text));
    }
    if all.is_empty() {
        let names: Vec<String> = experiments().into_iter().map(|experiment| experiment.name).collect();
        usage(&format!("no experiment has that in its name; there are: {}", names.join("; ")));
    }
    let channel = Channel::new(108, Width::Ht20).map_err(|error| error.to_string())?;
    let failed = |error: String| format!("cannot write {}: {error}", path.display());
    let draft = Draft::create(path, force)?;
    // Opened first, so that an unwritable file fails before minutes of work.
    let mut csv = csv::Writer::from_path(draft.path()).map_err(|error| failed(error.to_string()))?;
    let mut runs = Vec::new();
    for (k, experiment) in all.iter().enumerate() {
        progress(&format!("{} of {} experiments: {}", k + 1, all.len(), experiment.name));
        let own =
            run_all(std::slice::from_ref(experiment), which.repetitions.unwrap_or(REPETITIONS), &Options::new(channel));
        runs.extend(own.map_err(|error| error.to_string())?);
    }
    progress("");
    runs.iter().try_for_each(|run| csv.serialize(run)).map_err(|error| failed(error.to_string()))?;
    csv.flush().map_err(|error| failed(error.to_string()))?;
    draft.keep(false).map_err(|error| failed(error.to_string()))?;
    let table = summarise(&runs);
    if json {
        table.iter().for_each(print_json);
    } else {
        print(&describe(&table));
    }
    note!("{} in {}", some(runs.len() as u64, "repetition", "repetitions"), path.display());
    Ok(Outcome::Done)
}

fn describe(table: &[Summary]) -> String {
    let mut text = format!(
        "{:<34} {:>5} {:>17} {:>11} {:>10} {:>10} {:>17}\n{:<34} {:>5} {:>17} {:>11} {:>10} {:>10} {:>17}\n",
        "experiment",
        "runs",
        "|error| mean, max",
        "confidence",
        "likelihood",
        "coherence",
        "residual, comp.",
        "",
        "",
        "deg",
        "",
        "share",
        "",
        "rad"
    );
    let value = |value: Option<f64>, digits: usize| value.map_or_else(|| "-".into(), |v| format!("{v:.digits$}"));
    for row in table {
        let errors = row.mean_error_deg.zip(row.largest_error_deg);
        let error = errors.map_or_else(|| "-".into(), |(mean, largest)| format!("{mean:.3}, {largest:.3}"));
        let residual = format!("{:.3}, {:.3}", row.residual_rad, row.residual_compensated_rad);
        let _ = writeln!(
            text,
            "{:<34} {:>5} {error:>17} {:>11} {:>10} {:>10} {residual:>17}",
            row.experiment,
            row.repetitions,
            value(row.confidence, 2),
            value(row.likelihood_share, 4),
            value(row.coherence, 3),
        );
    }
    text
}
