//! CSV: a row for each record; what is not known is empty.

use super::other_cards::chain;
use super::{Export, Figures, Walk};
use crate::Failure;
use crate::table::{NO_ANTENNA, NO_TIME, Order};
use driver_iface::Mac;
use driver_iface::bfee::SUBCARRIERS;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// The columns of a record before its CSI.
const FIELDS: &str = "time_us,timestamp_low,bfee_count,host_us,frame_count,n_rx,n_tx,rssi_a,rssi_b,rssi_c,noise_dbm,agc,\
                      antenna_sel,rate_n_flags,antennas_known,total_rss_dbm,scale,record,mac";

/// Writes all records.
pub fn write(export: &Export<'_>, path: &Path) -> Result<Figures, Failure> {
    let mut out = BufWriter::with_capacity(1 << 18, File::create(path)?);
    let mut head = FIELDS.to_owned();
    for subcarrier in 0..SUBCARRIERS {
        let columns = export.antennas.iter().flat_map(|antenna| (1..=export.streams).map(move |s| (antenna, s)));
        for (antenna, stream) in columns {
            let name = format!("{subcarrier}_{}_{stream}", chain(antenna.index()));
            head += &format!(",re_{name},im_{name}");
        }
    }
    writeln!(out, "{head}")?;
    let (mut walk, mut csi) = (Walk::new(export, Order::SubcarriersFirst)?, Vec::new());
    while let Some(first) = walk.next(&mut csi) {
        for (record, csi) in (first..).zip(csi.chunks(walk.rows.len())) {
            let mut line = fields(export, &walk.figures, record);
            for h in csi {
                // Writing to a string never fails.
                let _ = if h.re.is_nan() { line.write_str(",,") } else { write!(line, ",{},{}", h.re, h.im) };
            }
            writeln!(out, "{line}")?;
        }
    }
    let figures = walk.finish()?;
    out.flush()?;
    Ok(figures)
}

/// A record's values of [`FIELDS`].
fn fields(export: &Export<'_>, figures: &Figures, k: usize) -> String {
    fn known(value: impl ToString, is_known: bool) -> String {
        if is_known { value.to_string() } else { String::new() }
    }
    let all = export.columns;
    let [time_us, host_us, frame] = [&all.time_us, &all.host_us, &all.frame].map(|column| column[k]);
    let [rss_dbm, scale] = [&figures.rss_dbm, &figures.scale].map(|column| known(column[k], !column[k].is_nan()));
    let mac = all.mac.as_chunks::<6>().0.get(k).copied().map_or(Mac::ZERO, Mac);
    let [rssi_a, rssi_b, rssi_c] = [0, 1, 2].map(|port| all.rssi[3 * k + port]);
    format!(
        "{time_us},{},{},{},{},{},{},{rssi_a},{rssi_b},{rssi_c},{},{},{},{},{},{rss_dbm},{scale},{k},{}",
        all.timestamp_low[k],
        all.bfee_count[k],
        known(host_us, host_us != NO_TIME),
        known(frame, frame >= 0),
        all.n_rx[k],
        all.n_tx[k],
        all.noise_dbm[k],
        all.agc[k],
        all.antenna_sel[k],
        all.rate[k],
        u8::from(all.antenna_order[3 * k] != NO_ANTENNA),
        known(mac, !mac.is_zero())
    )
}
