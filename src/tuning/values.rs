//! The numbers themselves.

#[cfg(test)]
use super::TuningEntry;

tuning! {
    /// Thinning of the samples of a near-field search.
    aperture: ApertureTuning, "csi5300 evaluate $CSI5300_CAPTURES/wsr" {
        /// Neighbouring samples are averaged over this much displacement, turns of phase.
        span_turns: f64 = 0.12, "theory: the outermost differ from their mean by 0.06 turns, the average keeps 99 % of its amplitude", "half: LOS 0/-0.02, NLOS +1.3/+1.1, T265 LOS -0.12/0, T265 NLOS -0.03/+0.03; double: LOS +0.07/-0.03, NLOS +0.29/+0.28, T265 LOS +0.45/+0.06, T265 NLOS -0.02/+0.02";
    }

    /// The views whose powers are multiplied, their windows and exponents.
    views: ViewTuning, "csi5300 evaluate --ablation $CSI5300_CAPTURES/wsr" {
        /// Exponent of the whole round trip.
        round_trip_weight: f64 = 1.0 / 3.0, "chosen on real captures and rooms (docs/accuracy.md)", "half: LOS -0.05/-0.01, NLOS +0.12/+0.19, T265 LOS -0.30/-0.57, T265 NLOS +1.5/+1.4; double: LOS +0.03/0, NLOS +8.9/+1.2, T265 LOS -0.06/-0.06, T265 NLOS +1.5/+2.1";
        /// Exponent of the phase at the channel centre, which only chooses between peaks.
        centre_weight: f64 = 1.0 / 3.0, "chosen on real captures and rooms (docs/accuracy.md)", "half: LOS +0.08/-0.02, NLOS +0.37/+0.53, T265 LOS -0.05/0, T265 NLOS +1.0/+1.3; double: LOS -0.01/-0.04, NLOS +1.2/+0.54, T265 NLOS +2.4/+2.0; also: as the round trip's only view worse in line of sight";
        /// Windows of the phase at the channel centre at most.
        centre_windows: usize = 3, "chosen on real captures (docs/accuracy.md)", "half: LOS +0.07/-0.01, NLOS +7.1/+0.19, T265 LOS -0.12/0, T265 NLOS +2.4/+2.0; double: LOS +0.08/0, NLOS +0.37/+0.53, T265 LOS -0.57/-0.19, T265 NLOS -0.53/-1.2; also: 1: LOS 1.34 / 0.79 degrees, with the views of then (docs/accuracy.md)";
        /// A window of the phase at the channel centre is no shorter than this, wavelengths driven; a motion of less than one
        /// and a half of it is one window.
        centre_window_wavelengths: f64 = 7.0, "chosen across places: whole motions (18.5) have three, halves one (docs/accuracy.md)", "6.2 to 9.2 change nothing there; 0, always three: docs/accuracy.md";
        /// Exponent of each of the three views of the one-way channel.
        one_way_weight: f64 = 2.0 / 9.0, "two thirds in all, by three", "half: LOS +0.03/-0.01, NLOS +9.0/+0.59, T265 LOS +0.49/+0.07, T265 NLOS +0.16/0; double: LOS -0.05/-0.01, NLOS +0.26/+0.19, T265 LOS -0.19/-0.55, T265 NLOS +0.29/+0.53";
        /// Windows of the one-way channel on all subcarriers.
        one_way_windows: usize = 3, "not recorded", "half: NLOS +0.04/+0.15, T265 LOS +0.09/+0.02, T265 NLOS -0.05/-0.04; double: LOS -0.07/-0.02, NLOS +0.97/+0.17, T265 LOS +0.69/+0.04, T265 NLOS -3.8/0; also: all numbers of windows together at 2/3, 1.6 and 2 times: no gain (docs/accuracy.md)";
        /// Blocks of the one-way channel on all subcarriers.
        one_way_blocks: usize = 8, "exploration of 637 links", "half: LOS 0/-0.02, NLOS +0.07/+0.28, T265 LOS +0.03/-0.02, T265 NLOS +0.75/-0.06; double: LOS -0.08/0, NLOS +1.1/+0.55";
        /// Windows of the one-way channel next to the channel centre.
        inner_windows: usize = 6, "not recorded", "half: LOS -0.01/-0.02, NLOS +2.7/+0.56, T265 LOS -0.20/-0.03, T265 NLOS +4.0/+0.62; double: LOS 0/-0.02, T265 LOS +0.46/+0.08, T265 NLOS +1.5/-0.02";
        /// Subcarriers next to the channel centre, whose sign the sampling time cannot turn.
        inner_subcarriers: usize = 6, "chosen: few enough that the sampling time turns no sign", "half: NLOS -0.04/0, T265 NLOS -0.05/-0.01; double: LOS 0/-0.03, NLOS +0.02/+0.01";
    }

    /// How densely places are searched.
    grid: GridTuning, "cargo bench --bench place" {
        /// Half of the largest change of a phase at the rim from one cell to the next, radians.
        rim_rad: f64 = 1.2, "theory: at 1.2 a beam like a parabola has lost a tenth of its height", "half: LOS +0.13/+0.08, NLOS +0.45/+0.28, T265 LOS -0.04/+0.05, T265 NLOS +0.50/+1.7, time x1.5; double: LOS -0.09/-0.08, NLOS +0.25/+1.1, T265 LOS -0.09/-0.73, T265 NLOS +0.83/+1.4";
        /// Less curvature than this over the aperture, radians, is a plane wave.
        plane_rad: f64 = 0.3, "not recorded", "no effect";
        /// Cells at most; there is no search beyond.
        max_cells: usize = 400_000, "chosen: apertures of many metres exceed it", "half: elevation of simulated links +0.02/0, simulated links without every step 24 instead of 25; double: no effect";
        /// Largest error of a phase where powers are computed roughly, turns.
        rough_turns: f64 = 0.02, "theory: 1.5 % of a power's root", "no effect";
    }

    /// From peaks of the grid to tops.
    climb: ClimbTuning, "csi5300 evaluate $CSI5300_CAPTURES/wsr" {
        /// Peaks climbed at most.
        most: usize = 6, "not recorded", "half: NLOS -0.30/-0.02; double: errors over bar 0.692 instead of 0.755";
        /// Peaks below this share of the highest, in evidence, are not climbed.
        floor: f64 = 0.3, "chosen; confidence counts a ratio below as no other answer", "half: errors over bar 0.734 instead of 0.755; double: errors over bar 0.822 instead of 0.755";
        /// Rounds of a climb at most.
        rounds: usize = 40, "chosen: enough to halve the steps to fine_rad", "half: median range error (m) 0.946 instead of 0.981; double: no effect";
        /// Steps at which the climb of the answer ends, radians.
        fine_rad: f64 = 2e-5, "chosen: a thousandth of a degree", "no effect";
        /// Steps at which the climbs of the others end, radians.
        coarse_rad: f64 = 2e-3, "chosen: a tenth of a degree", "half: rooms NLOS +1.1/+3.9; double: rooms NLOS +1.1/+3.9, simulated links without every step 23 instead of 25";
        /// Steps at which climbs end that judge a change of the trajectory, cells.
        judging_cells: f64 = 0.05, "not recorded", "no effect";
    }

    /// What is likely before anything was received, and how much a motion says against it. A motion has three exponents
    /// (here two, and `focus.looks`): they turn joint power into likelihood for three questions, and were set separately.
    prior: PriorTuning, "csi5300 evaluate $CSI5300_CAPTURES/wsr" {
        /// The range up to which all are as likely, in units of the shortest.
        farthest: f64 = 20.0, "chosen on real captures", "half: LOS -0.09/-0.04, NLOS +0.11/-0.07, T265 LOS +0.52/+0.09, T265 NLOS -1.7/0; double: LOS +0.08/0, NLOS +0.34/+0.55, T265 LOS +0.07/+0.02, T265 NLOS +0.17/0; also: 150 and 1,000: T265 LOS 4.1 / 3.5, but LOS 1.3 / 0.7 and 1.8 / 1.5 degrees";
        /// What is left for ranges beyond it, in units of what a range has to one e times as far.
        beyond: f64 = 0.02, "not recorded", "no effect";
        /// How likely an elevation beyond the largest that is expected is, in units of one within.
        above: f64 = 0.1, "chosen: twins of a tilted plane are told by it, clean data by themselves", "no effect";
        /// An answer this many times likelier than another is the only one of the two; one beyond the limits of elevation
        /// and range has to be so.
        odds: f64 = 1000.0, "chosen: clean data exceed it by far, real captures of level motion stay below", "half: T265 LOS -0.32/-0.44, time x1.5; double: no effect";
        /// Independent looks where two places are compared by these odds: likelihood goes with the unexplained power to this.
        looks_of_odds: f64 = 16.0, "parts of real captures (docs/accuracy.md)", "half: no effect; double: T265 LOS +0.06/0, time x2.3";
        /// Independent looks where azimuths are compared by their evidence: probability goes with the joint power to this.
        looks_between_peaks: f64 = 22.4, "chosen by a program in 29 of 30 folds of places (sensitivity -- refit looks)", "half: LOS +0.01/+0.04, NLOS -0.26/-0.19, T265 NLOS +0.05/0; double: NLOS +0.71/+0.38, T265 LOS +0.15/0, T265 NLOS +0.13/0";
        /// Independent looks where places within a peak are weighed, for a peak that explains half of the power.
        looks_within_peak: f64 = 12.0, "not recorded; a program (sensitivity -- refit looks) chooses 8.4, which moves no column of whole motions by more than 0.05 degrees and raises the largest error of a circle in noise by half", "half: LOS -0.04/-0.02, NLOS -0.01/+0.04, T265 LOS -0.04/+0.01, T265 NLOS -0.04/-0.10; double: LOS +0.04/-0.02, NLOS +0.03/-0.07, T265 LOS +0.06/+0.07, T265 NLOS +0.09/+0.20";
        /// Steps of the weighing on either side, in azimuth.
        azimuth_steps: i32 = 5, "not recorded", "half: LOS +0.01/+0.03, T265 LOS +0.04/+0.04, T265 NLOS +0.03/+0.09; double: LOS -0.14/-0.05, NLOS -0.03/+0.23, T265 LOS -0.08/-0.53, T265 NLOS +0.09/+0.65";
        /// Their length, cells of the grid.
        azimuth_step_cells: f64 = 0.3, "not recorded", "half: LOS +0.03/+0.08, NLOS +0.01/+0.03, T265 LOS +0.05/+0.05, T265 NLOS +0.02/+0.15; double: LOS -0.14/-0.08, NLOS -0.03/+0.27, T265 LOS -0.07/-0.58, T265 NLOS +0.08/+0.63";
        /// Elevations of the weighing.
        elevations: usize = 4, "not recorded", "half: LOS -0.04/-0.08, NLOS 0/+0.06, T265 LOS -0.07/-0.04; double: LOS 0/-0.03, T265 NLOS -0.01/-0.02";
        /// Ranges of the weighing.
        ranges: usize = 5, "not recorded", "half: T265 LOS +0.01/-0.03; double: LOS -0.01/-0.05";
    }

    /// Which elevations are searched.
    elevation: ElevationTuning, "csi5300 evaluate $CSI5300_CAPTURES/wsr" {
        /// Motion that reaches no further up and down than this does not distinguish up from down, turns of phase.
        level_turns: f64 = 0.35, "theory: 20 degrees above and below then differ by a quarter of a turn either way", "no effect";
        /// Motion that reaches further up and down than this share of its largest extent distinguishes up from down.
        tall: f64 = 0.2, "chosen: a tracking camera's height drifts by up to a seventh of a circle's radius", "half: T265 LOS +0.03/0, time x1.9; double: no effect";
        /// A plane wave within the expected elevations that explains less of the power than this may have a better one
        /// beyond.
        clear: f64 = 0.5, "theory: the next best leaves no doubt only if it explains far more", "no effect";
    }

    /// Autofocus of the trajectory.
    focus: FocusTuning, "csi5300 evaluate --ablation --trajectory t265 $CSI5300_CAPTURES/wsr" {
        /// Scales that are tried.
        scales: [f64; 4] = [0.95, 0.975, 1.025, 1.05], "not recorded", "half: T265 LOS -0.07/0, T265 NLOS -0.36/-0.39; double: rooms NLOS +0.34/+1.4";
        /// Turns of the heading that are tried, radians per metre.
        turns_rad_per_m: [f64; 4] = [-0.2, -0.1, 0.1, 0.2], "not recorded", "half: T265 LOS -0.12/0, T265 NLOS -0.01/+0.16; double: T265 NLOS -0.06/+0.28";
        /// Answers of each link that are followed.
        followed: usize = 2, "not recorded", "half: T265 NLOS +0.47/+1.3; double: no effect";
        /// Independent looks that a motion gives: the blocks in which the one-way channel is summed.
        looks: f64 = 8.0, "equal to views.one_way_blocks", "half: rooms NLOS -0.24/-0.18; double: NLOS +0.09/+0.67, T265 LOS -0.07/0";
        /// What the gain has to exceed, in units of log-likelihood: the parameters fitted.
        parameters: f64 = 2.0, "theory: Akaike's criterion with two parameters", "half: NLOS +0.09/+0.67, T265 LOS -0.07/0; double: rooms NLOS -0.24/-0.18; also: 0: most motion-capture trajectories would be changed";
    }

    /// Taking paths out of the round trip.
    paths: PathTuning, "csi5300 explain --out DIR LINK" {
        /// Waves at most.
        most: usize = 6, "not recorded", "half: paths a link 2.395 instead of 3.158, products among paths a link 0.026 instead of 0.368; double: no effect";
        /// A wave that takes less than this share of what is left is noise or a side lobe.
        least_share: f64 = 0.06, "not recorded", "half: paths a link 5.868 instead of 3.158, products among paths a link 1.237 instead of 0.368; double: paths a link 1.079 instead of 3.158, products among paths a link 0 instead of 0.368";
        /// Waves weaker than this share of the strongest are left, in power of the round trip.
        weakest: f64 = 0.03, "chosen: 15 dB", "half: paths a link 3.263 instead of 3.158, products among paths a link 0.421 instead of 0.368; double: paths a link 3.053 instead of 3.158, products among paths a link 0.342 instead of 0.368";
        /// A wave is at two others' product if its square resembles the square of that by this, 0..1.
        alike: f64 = 0.3, "theory: within half a beam", "half: products among paths a link 1.158 instead of 0.368; double: products among paths a link 0 instead of 0.368";
        /// Largest power of a product over the geometric mean of its two paths' powers.
        cross_gain: f64 = 8.0, "theory: 2 a b has 4; chosen above that", "no effect";
    }

    /// Deviations of places.
    deviations: DeviationTuning, "csi5300 evaluate $CSI5300_CAPTURES/wsr" {
        /// Standard deviation of the scale of a trajectory.
        scale_sd: f64 = 0.01, "measured: motion capture is up to 2 % off what the phases say", "half: no effect; double: ranges 20 instead of 21, median range error (m) 0.764 instead of 0.981, receivers' median error (m) 0.251 instead of 0.256";
        /// Residuals that share an error over more rows than this are no white noise.
        white_rows: f64 = 2.0, "theory: white noise has 1, give or take 0.35", "half: rooms LOS +0.01/+0.03, simulated links +0.68/+0.02, elevation of simulated links +0.07/-0.02; double: rooms LOS -0.03/+0.02, rooms NLOS +0.02/+0.02, elevation of simulated links 0/-0.05";
        /// The same for motion that distinguishes up from down.
        white_rows_in_space: f64 = 3.0, "theory: white noise exceeds 2 once in a hundred motions, 3 never", "no effect";
        /// Steps to the least residual.
        polishes: usize = 8, "theory: each leaves the square of the error before it; a flat ridge takes some more", "half: elevation of simulated links +0.06/0; double: no effect";
        /// A polished answer further off than this, cells of azimuth, is another one.
        polish_cells: f64 = 2.0, "chosen: along the flat ridge of a short arc a climb ends more than half a cell away; that noise is all that is left says which place is right", "no effect";
        /// Turns along the motion up to which an error is slow.
        slow_turns: usize = 10, "chosen: a place shows in the first few", "half: rooms NLOS 0/+0.02, elevation of simulated links +0.07/0, simulated links without every step 18 instead of 25; double: ranges 22 instead of 21, median range error (m) 0.764 instead of 0.981";
        /// Parameters that were fitted to the residual.
        fitted: f64 = 4.0, "theory: amplitude's phase, azimuth, elevation, range", "half: no effect; double: simulated links without every step 22 instead of 25";
        /// A range is reported where its predicted deviation is below this share of it.
        range_share: f64 = 0.35, "not recorded", "half: ranges 6 instead of 21, median range error (m) 0.416 instead of 0.981, receivers' median error (m) 0.224 instead of 0.256; double: ranges 25 instead of 21";
        /// Shortest distance of a transmitter by default, metres.
        range_min_m: f64 = 1.8, "not recorded", "half: LOS -0.20/-0.07, NLOS +0.22/+0.78, T265 LOS +0.63/+0.15, T265 NLOS -0.03/-0.22; double: LOS +0.05/-0.09, NLOS +0.80/+0.96, T265 LOS -0.58/-0.44, T265 NLOS +0.33/+0.08";
    }

    /// How much of the estimate is computed.
    effort: EffortTuning, "cargo run --release -p csi5300-lab --example skipping" {
        /// A step that cannot move the azimuth by more than this share of its error bar is not taken.
        share: f64 = 0.1, "chosen: a tenth of an error bar is of no consequence", "half: no effect; double: simulated links without every step 26 instead of 25";
        /// How often noise alone is taken for another wave, which costs time and nothing else.
        false_alarms: f64 = 0.01, "chosen: one motion in a hundred", "no effect";
        /// Correlation of neighbouring rows that is more than noise, in units of what noise leaves of it.
        neighbours: f64 = 3.5, "theory: noise has 1 on average, and exceeds 3.5 once in 2,000 motions", "half: simulated links without every step 24 instead of 25; double: no effect";
    }

    /// What both models of certainty (probability and error bar) are given, of full answers and of plane waves.
    certainty: CertaintyTuning, "cargo run --release -p csi5300-lab --example fit_confidence -- $CSI5300_CAPTURES" {
        /// Independent looks where candidates share the probability: shares go with the evidence to this.
        looks: f64 = 8.0, "equal to focus.looks; the likelihood of the nearest candidate asks for 6", "half: Brier score 0.157 instead of 0.146, errors over bar 0.528 instead of 0.733; double: errors over bar 0.852 instead of 0.733, receivers' median error (m) 0.248 instead of 0.255; also: 4: Brier 0.182 instead of 0.178; 16: 0.174, but two columns miscalibrated by more";
        /// Spreads of candidates are clamped to these, degrees.
        spread_deg: [f64; 2] = [0.3, 100.0], "chosen: what the captures span", "half: errors over bar 0.783 instead of 0.733; double: errors over bar 0.678 instead of 0.733";
        /// Distances of the views are clamped to these, degrees.
        views_deg: [f64; 2] = [0.3, 90.0], "chosen: what the captures span", "half: no effect; double: errors over bar 0.703 instead of 0.733";
        /// Least and largest probability.
        limits: [f64; 2] = [0.02, 0.98], "chosen: what some tens of independent places can support", "no effect";
        /// Standard deviation of the heading of a tracking camera's trajectory over seven seconds, degrees.
        camera_heading_deg: f64 = 3.9, "measured: rotation of the path against motion capture's over 31 motions", "not measured";
        /// The same of a camera of whose steps only those are kept that wheels can roll, and what its scale adds.
        rolling_camera_heading_deg: f64 = 2.4, "measured: likewise 1.6, its place and heading on the robot as of the other places; and beside the rotation a median error of 1.8 in sight, from a scale that is off by 6 %", "not measured";
        /// The same of wheel odometry, with the antenna's place on the robot known.
        wheels_heading_deg: f64 = 1.5, "measured: against motion capture over 31 motions, antenna and heading at the start as of the other places", "no effect";
        /// The same with the antenna anywhere on the robot.
        unmounted_heading_deg: f64 = 20.0, "measured: median error of its bearings in line of sight 11 to 14 degrees", "no effect";
    }

    /// Error bar of full answers: ln degrees.
    full_error_bar: FullErrorBarTuning, "cargo run --release -p csi5300-lab --example fit_confidence -- $CSI5300_CAPTURES" {
        /// Intercept.
        base: f64 = 0.61, "fit: 1988 bearings of 30 places", "not measured";
        /// Per unit of ln(spread of the candidates).
        per_spread: f64 = 0.70, "fit: 1988 bearings of 30 places", "not measured";
        /// Per unit of ln(median distance of the views).
        per_views: f64 = 0.20, "fit: 1988 bearings of 30 places", "not measured";
    }

    /// Error bar of bearings by a plane wave: ln degrees.
    quick_error_bar: QuickErrorBarTuning, "cargo run --release -p csi5300-lab --example fit_confidence -- $CSI5300_CAPTURES" {
        /// Intercept.
        base: f64 = 6.71, "fit: 1885 bearings of 30 places", "not measured";
        /// Per unit of ln(coherence).
        per_coherence: f64 = -2.51, "fit: 1885 bearings of 30 places", "not measured";
        /// Per unit of ln(second peak / highest).
        per_ratio: f64 = 0.82, "fit: 1885 bearings of 30 places", "not measured";
        /// Per unit of ln(longest side of the aperture in wavelengths).
        per_aperture: f64 = -2.38, "fit: 1885 bearings of 30 places", "not measured";
        /// Where the turn-around was compensated.
        compensated: f64 = -0.52, "fit: 1885 bearings of 30 places", "not measured";
    }

    /// Probability that a full answer's azimuth is within five degrees.
    full_probability: FullProbabilityTuning, "cargo run --release -p csi5300-lab --example fit_confidence -- $CSI5300_CAPTURES" {
        /// Intercept.
        base: f64 = 2.06, "fit: 1988 bearings of 30 places", "not measured";
        /// Per unit of ln(spread of the candidates).
        per_spread: f64 = -0.57, "fit: 1988 bearings of 30 places", "not measured";
        /// Per unit of ln(median distance of the views).
        per_views: f64 = -0.25, "fit: 1988 bearings of 30 places", "not measured";
        /// Per unit of ln(1 + heading / 5 degrees).
        per_heading: f64 = -1.43, "fit: 1988 bearings of 30 places", "not measured";
    }

    /// Probability that the azimuth of a bearing by a plane wave is within five degrees.
    quick_probability: QuickProbabilityTuning, "cargo run --release -p csi5300-lab --example fit_confidence -- $CSI5300_CAPTURES" {
        /// Intercept.
        base: f64 = -3.34, "fit: 1885 bearings of 30 places", "not measured";
        /// Per unit of ln(coherence).
        per_coherence: f64 = 1.74, "fit: 1885 bearings of 30 places", "not measured";
        /// Per unit of ln(second peak / highest).
        per_ratio: f64 = -0.86, "fit: 1885 bearings of 30 places", "not measured";
        /// Per unit of ln(longest side of the aperture in wavelengths).
        per_aperture: f64 = 1.80, "fit: 1885 bearings of 30 places", "not measured";
        /// Where the turn-around was compensated.
        compensated: f64 = 0.82, "fit: 1885 bearings of 30 places", "not measured";
        /// Per unit of ln(1 + heading / 5 degrees).
        per_heading: f64 = -1.33, "fit: 1885 bearings of 30 places", "not measured";
        /// The ratio that stands for no second peak.
        no_other: f64 = 0.1, "not recorded", "no effect";
        /// The aperture is clamped to these, wavelengths.
        aperture_wavelengths: [f64; 2] = [4.7, 13.8], "measured: what the captures and their parts span", "half: Brier score of plane waves 0.292 instead of 0.208, plane waves' errors over bar 0.144 instead of 0.720; double: simulated links without every step 25 instead of 26";
    }

    /// Robust location.
    locate: LocateTuning, "csi5300 evaluate $CSI5300_CAPTURES/wsr" {
        /// Error that no bearing is better than, radians.
        azimuth_floor_rad: f64 = 0.02, "measured: median error in line of sight about one degree whatever was predicted", "half: no effect; double: receivers' median error (m) 0.269 instead of 0.256";
        /// The same for range, relative.
        range_floor: f64 = 0.3, "measured: one range in six is off by more", "half: receivers' median error (m) 0.275 instead of 0.256; double: receivers' median error (m) 0.238 instead of 0.256; also: 0.1: 0.22 instead of 0.15 m median in line of sight";
        /// Residual, in deviations, at which a sighting has lost half of its weight.
        cauchy: f64 = 2.0, "not recorded", "half: receivers' median error (m) 0.247 instead of 0.256; double: receivers' median error (m) 0.261 instead of 0.256";
        /// Power to which the evidence of another candidate over that of the answer is taken.
        candidate_power: f64 = 0.5, "chosen by a program in 29 of 30 folds of places (sensitivity -- refit place), motion capture and tracking camera", "half: mean error of links to located receivers (degrees; wsr, wsr-more, the same by T265) 4.8, 4.9, 7.0, 7.1 instead of 3.4, 5.1, 6.8, 7.3; double: 3.4, 5.4, 10.9, 12.3";
        /// Steps at most.
        steps: usize = 60, "not recorded", "no effect";
        /// Another place is named where the best is at most this many times as likely.
        as_likely: f64 = 2.0, "chosen: a link and its mirror are as likely, three links of a capture leave one place", "not measured";
        /// And is further away than so many deviations of the best.
        apart_sd: f64 = 3.0, "chosen", "not measured";
        /// And than so many metres.
        apart_m: f64 = 0.3, "chosen", "not measured";
    }

    /// Places of peers carried from one motion to the next.
    track: TrackTuning, "cargo run --release -p csi5300-lab --example over_time -- $CSI5300_CAPTURES/wsr $CSI5300_CAPTURES/wsr-more" {
        /// Standard deviation of a right direction, in Cramer-Rao bounds.
        sd_bounds: f64 = 5.0, "chosen: highest likelihood of the truth among a few values, 2,130 bearings of 30 places, whole motions to eighths", "not measured; also: 3: -0.28 instead of -0.21 in ln likelihood a bearing";
        /// The least of it, degrees.
        sd_least_deg: f64 = 1.0, "chosen: as sd_bounds", "not measured; also: half: -0.217 instead of -0.214 in ln likelihood a bearing; double: -0.212";
        /// Candidates have their shares to this power.
        share_power: f64 = 0.7, "chosen: as sd_bounds", "not measured; also: 0.5: -0.31 instead of -0.29 in ln likelihood a bearing; 1: -0.31";
        /// A right direction's deviation is at most this share of the way to its mirror, or the error bar.
        mirror_share: f64 = 0.25, "chosen: two normal densities stay two", "not measured; also: without it what is carried of `demo`'s line is at 180 degrees instead of 169";
        /// Share of wrong bearings none of whose candidates is right.
        none_right: f64 = 0.5, "chosen: as sd_bounds", "not measured; also: 0.4: -0.296 instead of -0.294 in ln likelihood a bearing; 0.7: -0.316";
        /// What each motion after the first adds to the power that the evidence of all is taken to; the first adds 1.
        own_share: f64 = 0.3, "fit: least Brier score of what is carried, 30 places, four trajectories, halves to eighths", "not measured; also: 0.2: Brier 0.212 instead of 0.209; 0.5: 0.212; 1: 0.228";
        /// Share of ranges that are wrong whatever their deviation.
        range_missed: f64 = 0.5, "chosen: ranges behind walls and by bent trajectories are wrong by metres", "not measured; also: 1 (no ranges): carried quarters in sight 2.6 / 2.3 instead of 2.5 / 2.2 degrees";
        /// Share of what is known that every motion gives back to the prior.
        forgotten: f64 = 0.02, "chosen: a peer that was carried elsewhere is found there after two motions", "not measured";
        /// Peers are as likely per area up to here, and per logarithm of the range beyond, metres.
        room_m: f64 = 4.0, "chosen: half of a room", "not measured";
        /// Least wander of a heading, degrees after one metre.
        turn_deg_per_rt_m: f64 = 0.2, "chosen: motion capture", "not measured";
        /// Error of positions as a share of the way driven.
        slip: f64 = 0.01, "as deviations.scale_sd", "not measured";
        /// A peer that is silent for longer has gone, seconds.
        gone_s: f64 = 300.0, "chosen: longer than a window of a live estimator", "not measured";
    }

    /// Alignment of the sampling time.
    alignment: AlignmentTuning, "csi5300 evaluate --ablation $CSI5300_CAPTURES/wsr" {
        /// Neighbours on either side that a packet is compared with.
        reach: usize = 7, "not recorded", "half: LOS -0.01/+0.03, NLOS +7.2/+0.21, T265 LOS +0.22/+0.03, T265 NLOS -0.69/-1.3; double: LOS +0.12/+0.05, NLOS +0.56/+0.68, T265 LOS +0.36/+0.11, T265 NLOS -4.0/-2.1";
        /// Rounds.
        rounds: usize = 3, "chosen: neighbours' means converge", "half: LOS -0.09/-0.08, NLOS +7.4/+0.27, T265 NLOS +1.0/-0.02; double: LOS +0.31/+0.08, NLOS +0.61/+0.05, T265 LOS +0.03/-0.02, T265 NLOS +0.02/-0.01";
        /// Subcarrier indices this near to the centre give a packet's phase whatever its slope.
        middle: f32 = 9.0, "theory: up to 0.3 rad per index", "half: NLOS +7.9/+0.38, T265 LOS +0.11/+0.05, T265 NLOS +1.4/+1.3; double: LOS -0.08/-0.04, NLOS +8.4/+1.0, T265 LOS -0.30/-0.04, T265 NLOS +0.89/-0.11; also: the whole band: parts of LOS 2.9 / 1.8 instead of 2.6 / 1.7 degrees";
        /// Newton steps on each slope in each round.
        steps: usize = 2, "not recorded", "half: NLOS +0.54/+0.54, T265 LOS +0.23/0, T265 NLOS +0.02/+0.01; double: NLOS +0.33/+0.53, T265 LOS +0.22/0, T265 NLOS -0.04/+0.01";
        /// Distance of the slopes tried first, radians per index.
        tried_step: f32 = 0.04, "theory: a lobe over 56 indices is 0.22 wide", "half: LOS +0.01/+0.03, NLOS +0.22/0, T265 LOS +0.23/+0.02, T265 NLOS +1.5/+2.1; double: LOS -0.09/0, NLOS +0.86/+0.64, T265 LOS +0.22/+0.01, T265 NLOS +2.6/+2.1";
        /// How many are tried; 32 at most.
        tried: usize = 27, "measured: outliers reach 0.4 rad per index", "half: NLOS +0.33/+0.48, T265 NLOS +0.01/-0.05; double: NLOS +0.24/0";
    }

    /// The square root of the round trip.
    one_way: OneWayTuning, "csi5300 evaluate --ablation $CSI5300_CAPTURES/wsr" {
        /// Packets on either side that a sample is compared with.
        reach: usize = 5, "not recorded", "half: errors over bar 0.816 instead of 0.755, receivers' median error (m) 0.248 instead of 0.256, products among paths a link 0.316 instead of 0.368; double: Brier score 0.150 instead of 0.146, products among paths a link 0.342 instead of 0.368";
        /// How much of the prediction a packet inherits.
        memory: f32 = 0.7, "not recorded", "half: NLOS +0.02/+0.17, T265 LOS +0.46/+0.07, T265 NLOS -3.9/-0.07; double: LOS +0.84/+0.11, NLOS +9.9/+0.14, T265 LOS +1.5/+0.04, T265 NLOS +3.9/-0.24";
        /// Packets further apart than this many wavelengths, by their median, have their common turn taken out before the signs are chosen.
        sparse_wavelengths: f64 = 0.037, "measured: the links at hand have 0.020 to 0.023, every second of their pairs 0.04; a circle with the noise of Dijkstra et al. has 0.035, and a root mean square error of 0.038 degrees without it and 0.040 with (60 runs)", "half: NLOS +3.6/+0.5; double: every second pair is taken as before (docs/accuracy.md, *Fewer packets*)";
        /// Motion on either side over which that turn is averaged, wavelengths.
        turn_reach_wavelengths: f64 = 0.35, "measured with every second to eighth pair of 71 links, where 0.2 to 0.7 differ by less than their noise, and on wide drives (docs/accuracy.md, *Fewer packets*)", "no effect: the links have denser packets";
        /// Sweeps at most.
        sweeps: usize = 12, "not recorded", "half: Brier score 0.150 instead of 0.146, products among paths a link 0.395 instead of 0.368; double: products among paths a link 0.342 instead of 0.368";
    }

    /// Turn-around compensation.
    turn_around: TurnAroundTuning, "csi5300 evaluate --ablation $CSI5300_CAPTURES/wsr" {
        /// Outliers are further than this from the line, microseconds.
        outlier_us: f64 = 25.0, "measured: the jitter is 4 to 22", "no effect";
        /// How far from the clocks' drift the offset is searched, Hz.
        search_hz: f64 = 20_000.0, "measured: the turn-around's own drift fakes up to 2 ppm, 11 kHz", "half: NLOS +0.02/+0.07, T265 NLOS +0.02/+0.16; double: no effect";
        /// Step of the search, Hz.
        step_hz: f64 = 400.0, "theory: the coherence is 8 kHz wide", "half: products among paths a link 0.395 instead of 0.368; double: products among paths a link 0.342 instead of 0.368";
        /// Pairs that an offset of their own is searched in.
        block: usize = 200, "not recorded", "no effect";
        /// How far a block's offset is searched from that of all, Hz.
        drift_hz: f64 = 4_000.0, "measured: 2.4 kHz within six seconds", "no effect";
        /// By how much a block's own offset must raise the sum of its unit phasors, on average.
        gain_per_block: f64 = 2.0, "theory: chance gives half of one", "no effect";
        /// Clocks that drift apart by more are not two cards'.
        max_drift: f64 = 100e-6, "theory: 802.11 allows each 20 ppm", "no effect";
        /// Second differences of the jitter beyond this are left out, microseconds.
        max_second_difference_us: i64 = 500, "not recorded", "half: products among paths a link 0.421 instead of 0.368; double: no effect";
        /// A turn-around that jitters by more leaves no phase, microseconds.
        max_spread_us: f64 = 500.0, "theory: several turns at the offsets that cards have", "no effect";
    }

    /// Whether two records are of one exchange, and two logs of one link.
    pairing: PairingTuning, "cargo test -p csi5300 pairing" {
        /// Largest change of the clocks' difference between pairs, microseconds.
        clock_slack_us: i64 = 20_000, "measured: answers of a busy host come up to 10 ms late", "no effect";
        /// The same per second between them, microseconds.
        clock_drift_per_s: i64 = 200, "theory: 200 ppm; 802.11 allows two cards 40", "no effect";
        /// Candidates that must agree before their difference is believed.
        run: usize = 16, "not recorded", "half: wrong pairs after restarts 3 instead of 0; double: no effect";
        /// They agree if the median step is at most this, microseconds.
        run_step_us: i64 = 80, "measured: a turn-around jitters by 4 to 22, independent senders by hundreds", "no effect";
        /// Candidates after which any are believed.
        patience: u32 = 1_024, "not recorded", "no effect";
        /// Common numbers that say something of whether logs match.
        min_common: usize = 16, "not recorded", "no effect";
        /// By this factor the best match must spread less than the next.
        min_margin: f64 = 1.5, "not recorded", "no effect";
        /// Two logs are of one run from this correlation of the pauses between frames on.
        clocks_alike: f64 = 0.6, "measured: 0.83 to 0.98 on 76 links, up to 0.31 on 30 pairs of unrelated logs", "no effect";
        /// Or from this correlation of the two directions' changes of shape on.
        channel_alike: f64 = 0.75, "measured: 0.91 to 0.99 on 76 links, up to 0.58 on 494 wrong pairs of 14 captures", "no effect";
        /// The shape's changes are no noise from this correlation from pair to pair on.
        steady: f64 = 0.2, "chosen: noise alone has 0, give or take 0.01", "no effect";
        /// Phases whose second differences are no steadier than this are random.
        random_phases: f64 = 0.25, "chosen: 1,500 random phases reach 0.17, the real links at hand have 0.6 at least", "no effect";
        /// But not logs of two runs where one plane wave has a coherence over this by the root of the number of samples.
        by_chance: f64 = 4.0, "theory: in the best of 10,000 directions, random phases reach sqrt(ln 1e7) once in a thousand times", "no effect";
        /// Pauses that differ by less than this between frames, median, are all alike, microseconds.
        pauses_us: f64 = 20.0, "measured: a turn-around jitters by 4 to 22", "no effect";
        /// An antenna whose mean RSSI is this much below the strongest one's is as good as unconnected, dB.
        unconnected_db: f64 = 14.0, "measured: ports without an antenna are 18 to 35 below in 64 logs", "nothing but a warning depends on it";
    }

    /// Which poses are motion.
    motion: MotionTuning, "cargo test -p csi5300 motion" {
        /// Poses further apart than this, or than ten usual steps, leave a gap, seconds.
        min_gap_s: f64 = 0.25, "not recorded", "half: NLOS +0.35/0; double: no effect";
        /// A robot that moved less across a gap stood still, metres.
        still_m: f64 = 0.005, "measured: several times the noise of motion capture at rest", "no effect";
        /// A clock was set back where a path in the order of time is longer by this factor than as it was given.
        two_places: f64 = 1.1, "measured: up to 1.01 in the three shared recordings that have a step back", "not measured";
        /// Half the time over which speed is judged, seconds.
        speed_half_s: f64 = 0.1, "not recorded", "half: LOS -0.09/-0.04; double: LOS +0.08/0, NLOS +0.21/+0.60, T265 LOS -0.19/+0.03, T265 NLOS +0.13/+0.02";
        /// A robot slower than this share of its usual speed stands still.
        still_share: f64 = 0.15, "not recorded", "half: LOS +0.08/0, NLOS +0.21/+0.59, T265 LOS 0/+0.03; double: LOS -0.09/-0.04, T265 NLOS -0.07/0";
        /// No robot drives slower, m/s.
        still_m_per_s: f64 = 0.004, "measured: motion capture at rest seems to move by less", "no effect";
        /// A trajectory has a row for each frame if their numbers differ by at most this share.
        row_for_row: f64 = 0.005, "chosen: some frames are lost", "no effect";
        /// A trajectory's times do not fit if more than this share of the pairs lies outside them.
        outside_share: f64 = 0.02, "chosen: logs begin and end some frames apart", "no effect";
        /// Largest motion that is searched as one array, metres.
        max_extent_m: f64 = 50.0, "chosen: far beyond what odometry follows to a wavelength", "no effect";
    }

    /// What a plane-wave search makes of the shape of the motion.
    plane_wave: PlaneWaveTuning, "cargo test -p csi5300 bartlett" {
        /// A trajectory at most this wide for its length may have a mirror.
        elongated: f64 = 0.15, "not recorded", "no effect";
        /// Azimuth and elevation must differ by this share of the phases' variance for elevation to be searched.
        independent: f64 = 0.1, "chosen: odometry's millimetres must not decide", "half: elevation of simulated links +0.10/0, simulated links without every step 24 instead of 25; double: elevation of simulated links -0.03/-0.03";
        /// A mirror that the odometry would exclude is reported from this height on.
        mirror_ratio: f64 = 0.8, "not recorded", "no effect";
        /// Assumed error of the positions, metres.
        odometry_sd_m: f64 = 0.003, "chosen: millimetres are what wheels, a tracking camera and a curved wave front get wrong", "no effect";
        /// A reflection is excluded by this natural logarithm of the likelihood ratio.
        mirror_excluded: f64 = 4.6, "theory: ln 99, a share of one percent", "half: no effect; double: simulated links without every step 26 instead of 25, simulated mirrors 9 instead of 11";
        /// A plane tilted by less is level, radians.
        level_rad: f64 = 0.2, "chosen: floors and drifting tracking cameras (measured 0.12) tilt by less", "half: simulated mirrors 12 instead of 11; double: no effect";
        /// A reflection in a level plane whose azimuth differs by less is the elevation's sign, radians.
        same_azimuth_rad: f64 = 0.087, "chosen: five degrees, as confidence counts", "half: no effect; double: simulated links without every step 26 instead of 25, simulated mirrors 10 instead of 11";
    }
}
