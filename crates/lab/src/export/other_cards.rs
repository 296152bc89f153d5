//! Exports frames of cards other than the 5300 as arrays: all subcarriers of the frames of one shape.

use super::arrays::{Mat, Npz};
use super::{Target, extension, unknown};
use crate::Failure;
use crate::cards::{CardTime, Layout, is_damage, is_dbm, most_frequent};
use csi_formats::{Format, Frame, Item, Items};
use num_complex::Complex32;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{BufWriter, Write as _};
use std::path::Path;

/// Frames of one shape, in the order of the log.
#[derive(Clone, Debug)]
pub struct CardFrames {
    /// The kind of log.
    pub format: Format,
    /// Frames of the most frequent shape in the log.
    pub frames: Vec<Frame>,
    /// Seconds from the log's first frame by the card's clock, else by the host's; NaN if neither is known.
    pub time_s: Vec<f64>,
    /// Skipped frames of other shapes.
    pub other_shapes: u64,
    /// Frames that the caller did not request.
    pub left_out: u64,
    /// Damaged stretches of the log.
    pub damaged: u64,
    /// Bytes that are not frames with CSI, by reason.
    pub skipped: BTreeMap<String, u64>,
}

impl CardFrames {
    /// The frames of a log for which `keeps` is true; it gets each frame's seconds from the log's first.
    pub fn read(format: Format, bytes: &[u8], mut keeps: impl FnMut(&Frame, f64) -> bool) -> Self {
        let (mut all, mut left_out, mut damaged, mut skipped) = (Vec::new(), 0, 0, BTreeMap::new());
        let mut time = Time::default();
        for item in Items::new(format, bytes) {
            match item {
                Item::Frame(frame) => {
                    let time_s = time.of(&frame);
                    if keeps(&frame, time_s) {
                        // What the frames of one array share.
                        all.push(((frame.n_rx, frame.n_tx, Layout::of(&frame)), frame, time_s));
                    } else {
                        left_out += 1;
                    }
                }
                Item::Skipped(bad) => {
                    damaged += u64::from(is_damage(bad.why));
                    *skipped.entry(bad.why.to_string()).or_default() += bad.len;
                }
            }
        }
        let usual = most_frequent(all.iter().map(|(shape, ..)| shape)).cloned();
        let total = all.len() as u64;
        let (frames, time_s): (Vec<_>, Vec<_>) = all
            .into_iter()
            .filter(|(shape, ..)| Some(shape) == usual.as_ref())
            .map(|(_, frame, time_s)| (frame, time_s))
            .unzip();
        Self { format, other_shapes: total - frames.len() as u64, frames, time_s, left_out, damaged, skipped }
    }

    /// Receive chains, transmit chains, subcarriers.
    #[must_use]
    pub fn shape(&self) -> [usize; 3] {
        self.frames.first().map_or([0; 3], |frame| [frame.n_rx, frame.n_tx, frame.subcarriers.len()])
    }

    /// CSI `[frame][rx][tx][subcarrier]` in units of the card; NaN where the card measured nothing (pilots, the centre).
    pub fn csi(&self) -> impl Iterator<Item = Complex32> {
        self.frames.iter().flat_map(|frame| {
            let measured = frame.measured.iter().cycle();
            let value = |([re, im], measured): (&[f32; 2], &bool)| match measured {
                true => Complex32::new(*re, *im),
                false => Complex32::new(f32::NAN, f32::NAN),
            };
            frame.csi.iter().zip(measured).map(value)
        })
    }

    /// Index of each subcarrier relative to the channel's centre, in units of the spacing.
    #[must_use]
    pub fn subcarriers(&self) -> &[i16] {
        self.frames.first().map_or(&[], |frame| &frame.subcarriers)
    }

    /// RSSI by frame and receive chain; NaN if unknown.
    pub fn rssi(&self) -> impl Iterator<Item = f64> {
        let chains = self.shape()[0];
        self.frames.iter().flat_map(move |frame| {
            (0..chains).map(|chain| frame.rssi.get(chain).copied().flatten().map_or(f64::NAN, f64::from))
        })
    }

    /// An integer per frame; -1 if unknown.
    pub fn whole<'a>(&'a self, of: impl Fn(&Frame) -> Option<i64> + 'a) -> impl Iterator<Item = i64> + 'a {
        self.frames.iter().map(move |frame| of(frame).unwrap_or(-1))
    }

    /// The senders' octets by frame; zeros if unknown.
    pub fn macs(&self) -> impl Iterator<Item = u8> {
        self.frames.iter().flat_map(|frame| frame.sender.unwrap_or_default())
    }

    /// Writes `.npz`, `.mat` or `.csv`.
    ///
    /// # Errors
    /// If it cannot be written, or has another extension.
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        let [n_rx, n_tx, n_sub] = self.shape().map(|len| len as u64);
        let n = self.frames.len() as u64;
        match extension(path).as_deref() {
            Some("npz") => {
                let mut file = Npz::create(path)?;
                file.array("csi", &[n, n_rx, n_tx, n_sub], self.csi())?;
                file.array("rssi", &[n, n_rx], self.rssi())?;
                self.write_fields(&mut file)?;
                file.finish()
            }
            Some("mat") => {
                let mut file = Mat::create(path)?;
                let parts = [self.csi().map(|h| h.re).collect::<Vec<_>>(), self.csi().map(|h| h.im).collect()];
                let [re, im] = parts.map(Vec::into_iter);
                file.complex("csi", &[n_sub, n_tx, n_rx, n], re, im)?;
                file.array("rssi", &[n_rx, n], self.rssi())?;
                self.write_fields(&mut file)?;
                file.finish()
            }
            Some("csv") => self.write_csv(path),
            _ => return Err(unknown(".npz, .mat or .csv")),
        }
        .map_err(Failure::from)
    }

    fn write_fields(&self, file: &mut impl Target) -> std::io::Result<()> {
        let n = self.frames.len() as u64;
        file.put("record", [n, 1], 0..n as i64)?;
        file.put("offset", [n, 1], self.whole(|frame| i64::try_from(frame.offset).ok()))?;
        file.put("time_s", [n, 1], self.time_s.iter().copied())?;
        file.put("clock_ticks", [n, 1], self.whole(ticks))?;
        file.put("clock_tick_ps", [n, 1], self.whole(|frame| frame.clock.map(|clock| i64::from(clock.tick_ps))))?;
        file.put("host_us", [n, 1], self.whole(|frame| frame.host_us))?;
        file.put("sequence", [n, 1], self.whole(|frame| frame.sequence.map(i64::from)))?;
        file.put("centre_mhz", [n, 1], self.whole(|frame| frame.centre_mhz.map(i64::from)))?;
        file.put("width_mhz", [n, 1], self.frames.iter().map(|frame| frame.width_mhz))?;
        file.put("first_rx", [n, 1], self.frames.iter().map(|frame| frame.first_rx))?;
        file.put("first_tx", [n, 1], self.frames.iter().map(|frame| frame.first_tx))?;
        file.put("mac", [n, 6], self.macs())?;
        let in_dbm = self.frames.iter().map(|frame| u8::from(is_dbm(frame)));
        file.put("rssi_in_dbm", [n, 1], in_dbm)?;
        let subcarriers = self.subcarriers();
        file.put("subcarriers", [subcarriers.len() as u64, 1], subcarriers.iter().map(|index| i64::from(*index)))?;
        let spacing_hz = self.frames.first().map_or(0.0, Frame::spacing_hz);
        file.put("spacing_hz", [1, 1], std::iter::once(spacing_hz))
    }

    fn write_csv(&self, path: &Path) -> std::io::Result<()> {
        let mut out = BufWriter::with_capacity(1 << 18, std::fs::File::create(path)?);
        let [n_rx, n_tx, _] = self.shape();
        let mut head = "record,offset,time_s,clock_ticks,host_us,sequence,mac".to_owned();
        (0..n_rx).for_each(|rx| head += &format!(",rssi_{}", chain(rx)));
        for (rx, tx, index) in places(n_rx, n_tx, self.subcarriers()) {
            let _ = write!(head, ",re_{index}_{0}_{1},im_{index}_{0}_{1}", chain(rx), tx + 1);
        }
        writeln!(out, "{head}")?;
        let width: usize = self.shape().iter().product();
        let mut csi = self.csi();
        for (k, (frame, time_s)) in self.frames.iter().zip(&self.time_s).enumerate() {
            let known = |value: Option<i64>| value.map_or(String::new(), |value| value.to_string());
            let mut line = format!("{k},{}", frame.offset);
            let _ = write!(line, ",{}", if time_s.is_finite() { time_s.to_string() } else { String::new() });
            let sender = frame.sender.map_or(String::new(), |mac| driver_iface::Mac(mac).to_string());
            let numbers = [ticks(frame), frame.host_us, frame.sequence.map(i64::from)].map(known);
            let _ = write!(line, ",{},{sender}", numbers.join(","));
            (0..n_rx)
                .for_each(|rx| line += &format!(",{}", known(frame.rssi.get(rx).copied().flatten().map(i64::from))));
            for h in csi.by_ref().take(width) {
                let _ = if h.re.is_nan() { write!(line, ",,") } else { write!(line, ",{},{}", h.re, h.im) };
            }
            writeln!(out, "{line}")?;
        }
        out.flush()
    }
}

/// The name of a receive chain: `a` for the first.
pub(super) fn chain(rx: usize) -> char {
    char::from(b'a' + (rx % 26) as u8)
}

/// All positions of a frame's CSI, in the order of [`Frame::csi`].
/// A frame's time on the card's clock.
fn ticks(frame: &Frame) -> Option<i64> {
    i64::try_from(frame.clock?.ticks).ok()
}

fn places(n_rx: usize, n_tx: usize, subcarriers: &[i16]) -> impl Iterator<Item = (usize, usize, i16)> {
    (0..n_rx).flat_map(move |rx| (0..n_tx).flat_map(move |tx| subcarriers.iter().map(move |index| (rx, tx, *index))))
}

/// Seconds from the first frame.
#[derive(Default)]
struct Time {
    card: CardTime,
    first_host_us: Option<i64>,
}

impl Time {
    fn of(&mut self, frame: &Frame) -> f64 {
        if let Some((ps, _)) = self.card.of(frame) {
            return ps as f64 * 1e-12;
        }
        frame.host_us.map_or(f64::NAN, |us| (us - *self.first_host_us.get_or_insert(us)) as f64 * 1e-6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi_formats::{Kind, Tones, feitcsi};

    /// A log of AX200 frames, 1 ms apart by the card's clock; every third has another width.
    fn log() -> Vec<u8> {
        let mut bytes = Vec::new();
        for k in 0..9_u32 {
            let width_mhz = if k % 3 == 2 { 40 } else { 20 };
            let tones = Tones::of(Kind::Ht, width_mhz).expect("it has some").subcarriers.len();
            let repr = feitcsi::Repr {
                ftm: k * 320_000,
                host_us: 0,
                n_rx: 2,
                n_tx: 1,
                kind: Kind::Ht,
                width_mhz,
                mcs: 0,
                rssi_dbm: [-40, -50],
                sender: [2, 0, 0, 0, 0, (k % 2) as u8],
                // The clock wraps in between.
                clock_us: (u32::MAX - 3_500).wrapping_add(1_000 * k),
            };
            let csi: Vec<[i16; 2]> = (0..2 * tones).map(|at| [at as i16, k as i16]).collect();
            repr.emit(&csi, &mut bytes);
        }
        bytes
    }

    #[test]
    fn frames_of_the_most_frequent_shape_become_arrays() {
        let bytes = log();
        let read = CardFrames::read(Format::FeitCsi, &bytes, |_, _| true);
        assert_eq!((read.frames.len(), read.other_shapes, read.left_out, read.damaged), (6, 3, 0, 0));
        let ms: Vec<f64> = read.time_s.iter().map(|s| (s * 1e3).round()).collect();
        assert_eq!(ms, [0.0, 1.0, 3.0, 4.0, 6.0, 7.0]);
        let [n_rx, n_tx, n] = read.shape();
        assert_eq!((n_rx, n_tx, n), (2, 1, read.subcarriers().len()));
        let csi: Vec<Complex32> = read.csi().collect();
        assert_eq!(csi.len(), 6 * n_rx * n_tx * n);
        // The second chain of the third frame of this shape, computed as it was written.
        let (frame, chain, at) = (2, 1, 5);
        assert!(read.frames[0].measured[at]);
        assert_eq!(csi[(frame * n_rx + chain) * n + at], Complex32::new((n + at) as f32, 3.0));
        let pilot = read.subcarriers().iter().position(|index| *index == 7).expect("there is a pilot");
        assert!(csi[pilot].re.is_nan());
        assert_eq!(read.rssi().take(2).collect::<Vec<_>>(), [-40.0, -50.0]);
        assert!(read.whole(|frame| frame.host_us).all(|us| us == -1), "no host time is none");
        let late =
            CardFrames::read(Format::FeitCsi, &bytes, |frame, s| s > 0.002 && frame.sender == Some([2, 0, 0, 0, 0, 1]));
        assert_eq!((late.frames.len(), late.other_shapes, late.left_out), (2, 1, 6));
    }

    #[test]
    fn each_file_has_the_same_values() {
        let read = CardFrames::read(Format::FeitCsi, &log(), |_, _| true);
        let folder = &crate::temporary::Temporary::folder("other-cards").0;
        for name in ["a.npz", "A.MAT", "a.csv"] {
            read.write(&folder.join(name)).unwrap();
        }
        assert!(read.write(&folder.join("a.txt")).unwrap_err().to_string().starts_with("unknown extension"));
        let text = std::fs::read_to_string(folder.join("a.csv")).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        assert!(rows.len() == 7 && rows.iter().all(|row| row.len() == rows[0].len()), "{}", rows.len());
        let column = |name: &str| rows[0].iter().position(|head| *head == name).expect(name);
        assert_eq!(rows[3][column("im_-28_b_1")], "3");
        assert_eq!((rows[1][column("re_7_a_1")], rows[1][column("host_us")]), ("", ""));
        assert_eq!(rows[2][column("rssi_b")], "-50");
    }
}
