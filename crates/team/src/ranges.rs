//! Reads ranges from another sensor: UWB, FTM, or a topic like `sensor_msgs/Range`.
//!
//! Formats: CSV with the columns `time_s,from,to,range_m,sd_m` in any order; JSON objects with these fields, one per line or in
//! an array.

use serde::Deserialize;

/// A range between two robots.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Range {
    /// Time on the trajectories' clock, seconds.
    pub time_s: f64,
    /// The measuring robot.
    pub from: String,
    /// The other robot.
    pub to: String,
    /// The distance, metres.
    pub range_m: f64,
    /// Its standard deviation, metres.
    pub sd_m: f64,
}

const COLUMNS: [&str; 5] = ["time_s", "from", "to", "range_m", "sd_m"];

/// Reads ranges.
///
/// # Errors
/// The first invalid row with its number (for CSV and JSON Lines, the line number), or a missing column.
pub fn read(text: &str) -> Result<Vec<Range>, String> {
    let text = text.trim_start_matches('\u{feff}').trim();
    let wrong = |row: usize, error: serde_json::Error| format!("row {row}: {error}");
    let rows: Vec<(usize, Range)> = if text.starts_with('[') {
        let all: Vec<Range> = serde_json::from_str(text).map_err(|error| wrong(error.line(), error))?;
        all.into_iter().enumerate().map(|(k, own)| (k + 1, own)).collect()
    } else if text.starts_with('{') {
        let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let row = |(k, line)| serde_json::from_str(line).map(|own| (k + 1, own)).map_err(|error| wrong(k + 1, error));
        lines.map(row).collect::<Result<_, _>>()?
    } else {
        csv(text)?
    };
    for (row, own) in &rows {
        let refuse = |why: String| Err(format!("row {row}: {why}"));
        if !own.time_s.is_finite() {
            return refuse(format!("time_s is {}: it must be finite", own.time_s));
        }
        for (what, value) in [("range_m", own.range_m), ("sd_m", own.sd_m)] {
            if !(value > 0.0 && value.is_finite()) {
                return refuse(format!("{what} is {value}: it must be above 0, in metres"));
            }
        }
        if own.from == own.to || own.from.is_empty() || own.to.is_empty() {
            return refuse(format!("a range needs two robots, not \"{}\" and \"{}\"", own.from, own.to));
        }
    }
    Ok(rows.into_iter().map(|(_, own)| own).collect())
}

fn csv(text: &str) -> Result<Vec<(usize, Range)>, String> {
    let cells = |line: &str| line.split(',').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>();
    let heading = cells(text.lines().next().unwrap_or_default());
    let mut at = [0; 5];
    for (at, column) in at.iter_mut().zip(COLUMNS) {
        *at = heading.iter().position(|own| own == column).ok_or_else(|| {
            format!(
                "no column {column}: give CSV with the columns time_s,from,to,range_m,sd_m, or JSON with these fields"
            )
        })?;
    }
    let row = |(k, line): (usize, &str)| {
        let (row, cells) = (k + 1, cells(line));
        let cell = |column: usize| {
            let found = at.get(column).and_then(|at| cells.get(*at));
            found.ok_or_else(|| format!("row {row}: {} cells, {} expected", cells.len(), heading.len()))
        };
        let number = |column: usize| {
            let text = cell(column)?;
            text.parse::<f64>().map_err(|_| format!("row {row}: \"{text}\" is not a number"))
        };
        let (from, to) = (cell(1)?.clone(), cell(2)?.clone());
        Ok((row, Range { time_s: number(0)?, from, to, range_m: number(3)?, sd_m: number(4)? }))
    };
    text.lines().enumerate().skip(1).filter(|(_, line)| !line.trim().is_empty()).map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const CSV: &str = "from,to,time_s,sd_m,range_m\nrx, tx2,1.5,0.1,3.25\n\nrx,tx3,2,0.5,4\n";

    #[test]
    fn csv_and_json_hold_the_same_ranges() {
        let own = read(CSV).unwrap();
        let first = Range { time_s: 1.5, from: "rx".into(), to: "tx2".into(), range_m: 3.25, sd_m: 0.1 };
        assert_eq!((own.len(), &own[0]), (2, &first));
        let line = |own: &Range| {
            format!(
                r#"{{"time_s":{},"from":"{}","to":"{}","range_m":{},"sd_m":{},"frame_id":"uwb"}}"#,
                own.time_s, own.from, own.to, own.range_m, own.sd_m
            )
        };
        let lines: Vec<String> = own.iter().map(line).collect();
        assert_eq!(read(&lines.join("\n")).unwrap(), own);
        assert_eq!(read(&format!("[{}]", lines.join(","))).unwrap(), own);
        assert_eq!(read("[]").unwrap(), []);
    }

    #[test]
    fn an_invalid_row_is_rejected_with_its_number() {
        let said = |text: &str| read(text).unwrap_err();
        assert!(said("").contains("no column time_s"));
        assert!(said("time_s,from,to,range_m\n").contains("no column sd_m"));
        let with = |row: &str| said(&format!("time_s,from,to,range_m,sd_m\n1,a,b,2,0.1\n{row}\n"));
        for (row, word) in [
            ("1,a,b,NaN,0.1", "range_m is NaN"),
            ("1,a,b,2,0", "sd_m is 0"),
            ("1,a,b,-2,0.1", "range_m is -2"),
            ("inf,a,b,2,0.1", "time_s is inf"),
            ("1,a,a,2,0.1", "two robots"),
            ("1,a,b,2", "4 cells, 5 expected"),
            ("1,a,b,x,0.1", "\"x\" is not a number"),
        ] {
            assert!(with(row).contains("row 3") && with(row).contains(word), "{row}: {}", with(row));
        }
        assert!(said("{\"time_s\":1}").contains("row 1: missing field"));
        assert!(said("[{\"time_s\":1,").contains("row 1"));
    }
}
