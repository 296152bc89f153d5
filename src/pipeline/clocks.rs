//! Whether a log and a trajectory tell the same times.

use super::draft::{Clocks, LinkJoin, estimate_with};
use super::{Bearing, CaptureReport, JoinBy, LinkError, Options};
use crate::estimate::clock::{STEP_S, offsets_s};
use crate::motion::pose::{Gap, Trajectory};
use crate::signal::channel::Channel;
use crate::source::survey::{HostSteps, SET_US, Survey};
use driver_iface::bfee::rate::HT40;
use serde::Serialize;
use std::fmt;

/// The given times are in doubt if others are likelier by this logarithm, and are away by this many deviations and by more than
/// [`STEP_S`]. With correct clocks, times that far away reach a logarithm of 4.1 in 500 simulated captures, and of 6.9 in 31 real ones by
/// three sensors. A real drive along a line reaches 15, at times that it hardly tells apart.
const DOUBT: f64 = 8.0;
const APART: f64 = 3.0;
/// The estimate is repeated at the likeliest times at most this often, until no others are likelier by this logarithm.
const ROUNDS: usize = 4;
const SETTLED: f64 = 2.0;

/// The trajectory's clock less the receiver's host clock, estimated from the phases of all links.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClockOffset {
    /// What [`Options::clock_offset_s`] should be, seconds.
    pub offset_s: f64,
    /// Its standard deviation, seconds.
    pub sd_s: f64,
    /// `ln` of the likelihood there over that of the times as given.
    pub log_ratio: f64,
    /// Whether the times as given are in doubt: bearings by them may be wrong by far more than noise explains.
    pub doubt: bool,
}

impl ClockOffset {
    /// The most likely one of a receiver's links; `None` if one wave explains each of them, or poses are joined row by row.
    fn of(links: &[Result<Bearing, LinkError>], options: &Options) -> Option<Self> {
        let each = || links.iter().flatten().map(|bearing| &bearing.found.at_other_times).filter(|own| !own.is_empty());
        each().next()?;
        let logs: Vec<f64> = (0..offsets_s().len()).map(|k| each().map(|own| own[k]).sum()).collect();
        let all = || offsets_s().zip(logs.iter().copied());
        let given = logs[logs.len() / 2];
        let (offset_s, highest) = all().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let weighed = all().map(|(own_s, log)| ((log - highest).exp(), (own_s - offset_s).powi(2)));
        let (total, square) = weighed.fold((0.0, 0.0), |(total, sum), (by, square)| (total + by, sum + by * square));
        // The steps are uniform within themselves.
        let step_s = all().nth(1)?.0 - all().next()?.0;
        let sd_s = (square / total + step_s * step_s / 12.0).sqrt();
        let log_ratio = highest - given;
        let doubt = log_ratio > DOUBT && offset_s.abs() > APART * sd_s;
        let found = Self { offset_s: options.clock_offset_s + offset_s, sd_s, log_ratio, doubt };
        Some(found).filter(|found| found.offset_s.is_finite() && found.log_ratio.is_finite())
    }
}

impl fmt::Display for ClockOffset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { sd_s, log_ratio, .. } = self;
        // Not "-0.00".
        let offset_s = (100.0 * self.offset_s).round() / 100.0 + 0.0;
        write!(
            f,
            "the phases fit the trajectory far better with --clock-offset {offset_s:.2} (+- {sd_s:.2} s; log-likelihood +{log_ratio:.0}): \
             the clocks of log and trajectory differ"
        )
    }
}

/// The bearings of a receiver's links, and what their phases say of its clock. If other times are far likelier, probabilities and
/// error bars refer to those.
pub(super) fn estimate(joins: &[LinkJoin<'_>], options: &Options) -> Vec<Result<Bearing, LinkError>> {
    let at = |offset_s: f64| {
        let options = Options { clock_offset_s: offset_s, ..options.clone() };
        let made = estimate_with(joins, (&options, Clocks::Compared));
        (ClockOffset::of(&made, &options), made)
    };
    let (found, mut made) = at(options.clock_offset_s);
    let Some(mut found) = found else { return made };
    if found.doubt {
        let likelier = settle(&mut found, at);
        found.doubt = (found.offset_s - options.clock_offset_s).abs() > STEP_S;
        for (bearing, likelier) in made.iter_mut().zip(likelier).filter(|_| found.doubt) {
            let (Ok(bearing), Ok(likelier)) = (bearing, likelier) else { continue };
            bearing.answer = bearing.answer.clone().doubted(&likelier);
        }
    }
    made.iter_mut().flatten().for_each(|bearing| bearing.clock_offset = Some(found));
    made
}

/// Repeats the estimate at the likeliest times until no others are likelier: its last bearings.
fn settle<T>(found: &mut ClockOffset, at: impl Fn(f64) -> (Option<ClockOffset>, T)) -> T {
    let (mut next, mut made) = at(found.offset_s);
    for _ in 0..ROUNDS {
        // Where one wave now explains everything, the times are right.
        let Some(likelier) = next else { break };
        let is_settled = likelier.log_ratio < SETTLED;
        if !is_settled || (likelier.offset_s - found.offset_s).abs() < STEP_S {
            *found = ClockOffset { offset_s: likelier.offset_s, sd_s: likelier.sd_s, ..*found };
        }
        if is_settled {
            break;
        }
        (next, made) = at(found.offset_s);
    }
    made
}

impl CaptureReport {
    /// In words, if the receiver's log contradicts what it is read with, or itself: the channel's width, the order of its records, or
    /// the times of one of the `trajectories`.
    pub fn contradiction<'a>(
        &self,
        trajectories: impl IntoIterator<Item = &'a Trajectory>,
        options: &Options,
    ) -> Option<String> {
        trajectories.into_iter().find_map(|path| self.receiver.survey.contradiction(path, options))
    }
}

impl Survey {
    fn contradiction(&self, trajectory: &Trajectory, options: &Options) -> Option<String> {
        let width = self.other_width(options.channel);
        width.or_else(|| self.disorder()).or_else(|| self.clocks_part(trajectory, options))
    }

    /// In words, if the card's clock goes back again and again; in 145 real logs it never does.
    fn disorder(&self) -> Option<String> {
        let (back, all) = (self.clock_steps.steps_back, self.bfees());
        (10 * back > all).then(|| {
            format!("{back} of {all} records are older than the one before: sort them by time, or separate those of several cards")
        })
    }

    /// In words, if most records are of another width than the channel, whose centre is then another.
    fn other_width(&self, channel: Channel) -> Option<String> {
        let count =
            |is_wide| self.rates.iter().filter(|(rate, _)| (*rate & HT40 != 0) == is_wide).map(|(_, n)| n).sum();
        let [narrow, wide]: [u64; 2] = [false, true].map(count);
        let (width, most) = if wide > narrow { (40, wide) } else { (20, narrow) };
        let renamed = channel.renamed(wide > narrow).filter(|_| most > 0)?;
        Some(format!(
            "{most} of {} records are {width} MHz wide, channel {channel} is not, and has another centre: name it {renamed}",
            narrow + wide
        ))
    }

    /// In words, if the host's clock or the trajectory's was set while both ran and the other was not: one part of the log then has
    /// poses of other times. `None` if poses are joined row by row.
    fn clocks_part(&self, trajectory: &Trajectory, options: &Options) -> Option<String> {
        let offset_s = options.clock_offset_s;
        let (first_us, last_us) = self.host_us.filter(|_| options.join == JoinBy::Time)?;
        let HostSteps { set, furthest_us, before_us, .. } = self.host_steps;
        let s = |us: i64| us as f64 * 1e-6;
        let (from_s, to_s) = trajectory.span_s();
        if set > 0 {
            let longest_s = || trajectory.gaps().iter().map(|gap| gap.to_s - gap.from_s).fold(0.0, f64::max);
            let own_s = if furthest_us < 0 { trajectory.back_s() } else { longest_s() };
            let both = [before_us, before_us.saturating_add(furthest_us)].map(|us| s(us) + offset_s);
            let is_inside = both.iter().all(|t_s| (from_s..=to_s).contains(t_s));
            return (is_inside && own_s < s(furthest_us).abs() - s(SET_US)).then(|| {
                format!(
                    "the host's clock was set by {:+.3} s, {:.1} s after the first record, and the trajectory's was not: one part of \
                     the log has poses of other times (`export --dat` with --from or --to takes a part)",
                    s(furthest_us),
                    s(before_us.saturating_sub(first_us))
                )
            });
        }
        // Of a host's clock shorter steps are not seen.
        let is_long = |gap: &Gap| gap.to_s - gap.from_s > 1.2 * s(SET_US);
        let is_inside = |gap: &Gap| s(first_us) + offset_s < gap.from_s && gap.to_s < s(last_us) + offset_s;
        let gap = trajectory.set_on().into_iter().find(|gap| is_long(gap) && is_inside(gap))?;
        Some(format!(
            "the trajectory's clock was set on by {:.3} s at {:.3} s, where the robot drives on as if no time had passed, and the \
             host's was not: poses of one part are of other times (use the rows on one side)",
            gap.to_s - gap.from_s,
            gap.from_s
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::pose::Pose;
    use crate::signal::channel::Width;
    use nalgebra::Vector3;

    #[test]
    fn records_of_another_width_than_the_channels_are_told() {
        let told = |rates: &[(u16, u64)], channel: &str| {
            let mut survey = Survey::default();
            survey.rates = rates.iter().copied().collect();
            survey.other_width(channel.parse().unwrap())
        };
        let (narrow, wide) = ([(0x101, 9), (0x901, 1)], [(0x101, 1), (0x901, 9)]);
        let words = "9 of 10 records are 40 MHz wide, channel 108 is not, and has another centre: name it 108+";
        assert_eq!(told(&wide, "108"), Some(words.to_owned()));
        assert!(
            told(&narrow, "112-")
                .unwrap()
                .ends_with("are 20 MHz wide, channel 112- is not, and has another centre: name it 112")
        );
        assert!(told(&wide, "6").unwrap().ends_with("name it 6+ or 6-"));
        assert_eq!(
            [told(&wide, "108+"), told(&wide, "5550MHz"), told(&narrow, "108"), told(&[], "108+")],
            [const { None }; 4]
        );
        // A truth file names a channel of 40 MHz by its centre.
        let mut survey = Survey::default();
        survey.rates = [(0x901, 9)].into();
        assert_eq!(survey.other_width(Channel::new(110, Width::Ht20).unwrap()), None);
    }

    #[test]
    fn records_in_another_order_than_that_of_time_are_told() {
        let of = |steps_back| {
            let mut survey = Survey::default();
            (survey.wsr, survey.clock_steps.steps_back) = (100, steps_back);
            survey.disorder()
        };
        assert_eq!((of(0), of(10), Survey::default().disorder()), (None, None, None));
        assert!(of(99).unwrap().starts_with("99 of 100 records are older than the one before: sort them"));
    }

    #[test]
    fn a_clock_that_was_set_while_the_other_was_not_is_told() {
        let channel = "108".parse().unwrap();
        // 20 s at 100 Hz, round a circle; both clocks begin at 1,000 s, and are set at 8 s.
        let told = |(host_s, path_s, stands): (f64, f64, bool), options: &Options| {
            let mut survey = Survey::default();
            for k in 0..2_000_u32 {
                let host_us = 1_000_000_000 + 10_000 * i64::from(k) + if k < 800 { 0 } else { (host_s * 1e6) as i64 };
                survey.host_steps.note(10_000 * k, Some(host_us));
                let (first_us, _) = survey.host_us.unwrap_or((host_us, host_us));
                survey.host_us = Some((first_us, host_us));
            }
            let pose = |k: u32| {
                let way = 0.005 * f64::from(if stands { k.max(1_000) } else { k });
                let t_s = 1_000.0 + 0.01 * f64::from(k) + if k < 800 { 0.0 } else { path_s };
                Pose { t_s, position_m: Vector3::new(way.cos(), way.sin(), 0.0), heading_rad: None }
            };
            survey.clocks_part(&Trajectory::new((0..2_000).map(pose).collect()).unwrap(), options)
        };
        let plain = Options::new(channel);
        let is_told = |host_s: f64, path_s: f64| told((host_s, path_s, false), &plain);
        assert_eq!([is_told(0.0, 0.0), is_told(5.0, 5.0), is_told(-5.0, -5.0)], [const { None }; 3]);
        for set_s in [5.0, -5.0] {
            let words = is_told(set_s, 0.0).unwrap();
            assert!(words.starts_with(&format!("the host's clock was set by {set_s:+.3} s, 8.0 s after")), "{words}");
        }
        assert!(is_told(0.0, 5.0).unwrap().starts_with("the trajectory's clock was set on by 5.010 s at 1007.990 s"));
        // A robot that stood in the gap; poses of another day, which no record has; rows.
        assert_eq!(told((0.0, 5.0, true), &plain), None);
        assert_eq!(told((5.0, 0.0, false), &Options { clock_offset_s: -86_400.0, ..Options::new(channel) }), None);
        assert_eq!(told((5.0, 0.0, false), &Options { join: JoinBy::Row, ..Options::new(channel) }), None);
    }
}
