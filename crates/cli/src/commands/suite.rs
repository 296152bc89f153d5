//! `csi5300 suite`.

use super::{Outcome, Result, print, print_json, usage};
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
#[cfg(feature = "plot")]
use csi5300_lab::suite::Experiment;
use csi5300_lab::suite::{REPETITIONS, Summary, experiments, run_all, summarise};
use std::fmt::Write;
use std::path::PathBuf;

// Arguments of `suite`.
#[derive(clap::Args)]
pub struct Args {
    /// Repetitions of each experiment
    #[arg(long, default_value_t = REPETITIONS, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    repetitions: u64,
    /// Only experiments whose name holds this
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// A row for each repetition, as CSV
    #[arg(long, default_value = "csi5300-suite.csv", value_name = "FILE")]
    csv: PathBuf,
    /// Draw each experiment into this folder: phase before and after, and the profile averaged over the repetitions
    #[cfg(feature = "plot")]
    #[arg(long, visible_alias = "out", value_name = "DIR")]
    plot: Option<PathBuf>,
    #[cfg(feature = "plot")]
    #[command(flatten)]
    drawing: super::pictures::Drawing,
    /// JSON Lines: one object an experiment instead of the table
    #[arg(long)]
    json: bool,
    /// Overwrite the table, and pictures of the same names, if they are there
    #[arg(long)]
    force: bool,
}

/// Runs the experiments of Dijkstra et al. (\[paper\] in docs/references.md) and prints a table of them.
pub fn run(args: &Args) -> Result {
    let mut all = experiments();
    if let Some(text) = &args.only {
        all.retain(|experiment| experiment.name.contains(text));
    }
    if all.is_empty() {
        let names: Vec<String> = experiments().into_iter().map(|experiment| experiment.name).collect();
        usage(&format!("no experiment has that in its name; there are: {}", names.join("; ")));
    }
    let channel = Channel::new(108, Width::Ht20).map_err(|error| error.to_string())?;
    let failed = |error: String| format!("cannot write {}: {error}", args.csv.display());
    let draft = super::draft::Draft::create(&args.csv, args.force)?;
    #[cfg(feature = "plot")]
    check_pictures(args, &all)?;
    // Opened first: a file that cannot be written is found before minutes of work, not after.
    let mut csv = csv::Writer::from_path(draft.path()).map_err(|error| failed(error.to_string()))?;
    let mut runs = Vec::new();
    for (k, experiment) in all.iter().enumerate() {
        super::progress(&format!("{} of {} experiments: {}", k + 1, all.len(), experiment.name));
        let own = run_all(std::slice::from_ref(experiment), args.repetitions, &Options::new(channel));
        runs.extend(own.map_err(|error| error.to_string())?);
    }
    super::progress("");
    runs.iter().try_for_each(|run| csv.serialize(run)).map_err(|error| failed(error.to_string()))?;
    csv.flush().map_err(|error| failed(error.to_string()))?;
    draft.keep(false).map_err(|error| failed(error.to_string()))?;
    let table = summarise(&runs);
    if args.json {
        table.iter().for_each(print_json);
    } else {
        print(&describe(&table));
    }
    #[cfg(feature = "plot")]
    if let Some(folder) = &args.plot {
        let written = csi5300_lab::show::repeated::write(&runs, folder, &args.drawing.format(args.force));
        let written = written.map_err(|error| super::pictures::refused(&error))?;
        note!("{} in {}", super::some(written.len() as u64, "picture", "pictures"), folder.display());
    }
    note!("{} in {}", super::some(runs.len() as u64, "repetition", "repetitions"), args.csv.display());
    Ok(Outcome::Done)
}

/// Refuses pictures that are there before minutes of work, not after.
#[cfg(feature = "plot")]
fn check_pictures(args: &Args, all: &[Experiment]) -> std::result::Result<(), String> {
    args.drawing.must_have(args.plot.as_deref(), "--plot");
    let Some(folder) = &args.plot else { return Ok(()) };
    let stems = |experiment: &Experiment| csi5300_lab::show::repeated::stems(&experiment.name, folder);
    let stems: Vec<PathBuf> = all.iter().flat_map(stems).collect();
    args.drawing.format(args.force).check(&stems).map_err(|error| super::pictures::refused(&error))
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
