//! Refuses scenes with invalid values.

use super::carrier::Carrier;
use super::faults::Faults;
use super::motion::RobotMotion;
use super::radio::{AntennaOrder, Gain, Noise, Radio, Stray, TurnAround};
use super::refusal::{
    Checked, Problem, at_most, decibels, deviation_db, ensure, finite, not_negative, positive, share,
};
use super::scene::{Card, Cfo, Dialect, Driver, HostClock, Odometry, Pattern, Preamble, Robot, Scene};
use csi5300::signal::channel::Channel;
use nalgebra::Vector3;

/// A scene lasts a year at most, seconds.
const LONGEST_S: f64 = 31_536_000.0;
/// A random walk lasts a day at most, seconds: its steps of 10 ms are in memory.
const LONGEST_WALK_S: f64 = 86_400.0;
/// Limit of rounds and of poses a second: more than a card or an encoder delivers.
const FASTEST_HZ: f64 = 100_000.0;
/// No delay is longer than a quarter of an hour, microseconds.
const LATEST_US: f64 = 1e9;

impl Scene {
    /// Checks every value and its relation to others; `world_check` has the rest.
    pub(crate) fn check_values(&self) -> Checked {
        positive("duration_s", self.duration_s)?;
        at_most("duration_s", self.duration_s, LONGEST_S)?;
        let most_mhz = match (self.card, self.preamble) {
            (Card::Intel5300, _) | (_, Some(Preamble::Ht)) => 40,
            _ => 160,
        };
        let is_width = matches!(self.bandwidth_mhz, 20 | 40 | 80 | 160) && self.bandwidth_mhz <= most_mhz;
        ensure(is_width, "bandwidth_mhz", || match most_mhz {
            40 => format!("is {}; the card has 20 and 40", self.bandwidth_mhz),
            _ => format!("is {}; the card has 20, 40, 80 and 160", self.bandwidth_mhz),
        })?;
        // The number of a wider channel is that of its centre, which is no channel of 20 MHz.
        let is_assigned = self.bandwidth_mhz > 20 || self.channel.to_string().parse::<Channel>().is_ok();
        let has_carrier = Carrier::new(self.channel, self.bandwidth_mhz == 40).is_some();
        ensure(is_assigned && has_carrier, "channel", || {
            format!("is {}; channels are 1 to 14, 36, 40, .. 64, 100, 104, .. 144 and 149, 153, .. 177", self.channel)
        })?;
        ensure(self.reflections <= 4, "reflections", || format!("is {}; 4 is the most", self.reflections))?;
        ensure(self.host_times_fit(&HostClock::default()), "start_unix_s", || {
            format!(
                "is {}, and the scene lasts {} s; records hold seconds from 0 to 4,294,967,295",
                self.start_unix_s, self.duration_s
            )
        })?;
        check_cfo(&self.cfo).map_err(|p| p.key("cfo"))?;
        check_radio(&self.radio).map_err(|p| p.key("radio"))?;
        ensure(!self.robot.is_empty(), "robot", || "is missing: a scene needs at least one [[robot]]".to_owned())?;
        for (number, robot) in self.robot.iter().enumerate() {
            let within = |p: Problem| {
                let name = if robot.name.is_empty() {
                    format!("robot {}", number + 1)
                } else {
                    robot.name.escape_debug().to_string()
                };
                let reason = format!("{name}: {}", p.reason);
                p.because(reason).item("robot", number)
            };
            self.check_robot(number, robot).map_err(within)?;
        }
        self.check_card()?;
        self.check_sounding()?;
        self.check_surfaces()
    }

    /// Refuses keys of the other card.
    fn check_card(&self) -> Checked {
        if self.card == Card::Intel5300 {
            return ensure(self.preamble.is_none(), "preamble", || "is of an AX210: a 5300 sends HT".to_owned());
        }
        ensure(self.driver == Driver::Wsr, "driver", || "is of a 5300: an AX210 has FeitCSI's".to_owned())?;
        let radio = |radio: &Radio| {
            let none = |key: &'static str| move || format!("is of a 5300: an AX210 has no {key}");
            ensure(radio.filter_db.is_none(), "filter_db", none("filter of 30 subcarriers"))?;
            ensure(radio.antenna_order == AntennaOrder::Fixed, "antenna_order", none("order by RSSI"))
        };
        radio(&self.radio).map_err(|p: Problem| p.key("radio"))?;
        for (number, robot) in self.robot.iter().enumerate() {
            let check = || {
                ensure(robot.antenna_c_m.is_none(), "antenna_c_m", || "is a third: an AX210 has two".to_owned())?;
                let faults = robot.faults.card.is_empty();
                ensure(faults, "faults", || {
                    "has faults of a 5300's records, which an AX210 does not write".to_owned()
                })?;
                robot.radio.as_ref().map_or(Ok(()), radio).map_err(|p: Problem| p.key("radio"))
            };
            check().map_err(|p: Problem| p.item("robot", number))?;
        }
        Ok(())
    }

    /// True if records can hold the host's time from the start of the scene to its end.
    fn host_times_fit(&self, clock: &HostClock) -> bool {
        let held = 0.0..=f64::from(u32::MAX);
        let begins_s = self.start_unix_s as f64 + clock.offset_s;
        let ends_s = begins_s + self.duration_s * (1.0 + clock.drift_ppm * 1e-6);
        held.contains(&begins_s) && held.contains(&ends_s)
    }

    fn check_robot(&self, number: usize, robot: &Robot) -> Checked {
        ensure(!robot.name.is_empty(), "name", || "is missing".to_owned())?;
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        ensure(robot.name.chars().all(plain), "name", || {
            "goes into file names: only letters, digits, - and _".to_owned()
        })?;
        let mac = robot.mac_address(number);
        ensure(mac.is_some(), "mac", || "is no MAC address; one looks like 00:21:6A:53:89:D2".to_owned())?;
        for (other_number, other) in self.robot.iter().take(number).enumerate() {
            ensure(other.name != robot.name, "name", || "is taken: two robots cannot share one".to_owned())?;
            ensure(other.mac_address(other_number) != mac, "mac", || {
                format!("is also that of {}: pairs are told apart by MAC", other.name)
            })?;
        }
        finite("position_m", &robot.position_m)?;
        finite("yaw_deg", &[robot.yaw_deg])?;
        finite("antenna_m", &robot.antenna_m)?;
        finite("antenna_b_m", &robot.antenna_b_m.unwrap_or_default())?;
        finite("antenna_c_m", &robot.antenna_c_m.unwrap_or_default())?;
        let Pattern { cos_db, sin_db, cos2_db, sin2_db } = robot.pattern;
        let harmonics = [cos_db, sin_db, cos2_db, sin2_db];
        ensure(harmonics.iter().all(|db| db.abs() <= 60.0), "pattern", || {
            "has no more than 60 dB of any kind".to_owned()
        })?;
        check_motion(&robot.motion).map_err(|p| p.key("motion"))?;
        let c = &robot.crystal;
        let drifts = [c.offset_ppm, c.drift_ppm_per_s, c.warm_up_ppm, c.wander_ppm];
        ensure(drifts.iter().all(|ppm| ppm.abs() <= 1e3), "crystal", || {
            "is off by more than 1,000 ppm; crystals are good to some 20".to_owned()
        })?;
        positive("warm_up_s", c.warm_up_s).map_err(|p| p.key("crystal"))?;
        positive("wander_period_s", c.wander_period_s).map_err(|p| p.key("crystal"))?;
        let host = &robot.host_clock;
        ensure(host.offset_s.abs() < 1e8 && host.drift_ppm.abs() <= 1e3, "host_clock", || {
            "is further off than clocks are".to_owned()
        })?;
        ensure(self.host_times_fit(host), "host_clock", || {
            format!(
                "is {} s ahead of a scene that begins at {} s and lasts {} s; records hold seconds from 0 to 4,294,967,295",
                host.offset_s, self.start_unix_s, self.duration_s
            )
        })?;
        if let Some(radio) = &robot.radio {
            check_radio(radio).map_err(|p| p.key("radio"))?;
        }
        check_faults(&robot.faults).map_err(|p| p.key("faults"))?;
        check_odometry(&robot.odometry).map_err(|p| p.key("odometry"))
    }

    fn check_sounding(&self) -> Checked {
        let Some(sounding) = &self.sounding else { return Ok(()) };
        let check = || {
            ensure(sounding.rate_hz > 0.0, "rate_hz", || format!("is {}; it must be more than 0", sounding.rate_hz))?;
            // Infinity is the highest rate that fits.
            if sounding.rate_hz.is_finite() {
                at_most("rate_hz", sounding.rate_hz, FASTEST_HZ)?;
            }
            not_negative("start_s", sounding.start_s)?;
            ensure(self.robot.len() >= 2, "rate_hz", || "needs two robots at least".to_owned())?;
            for (number, name) in sounding.initiators.iter().enumerate() {
                ensure(self.robot.iter().any(|r| r.name == *name), "initiators", || format!("has no robot {name:?}"))?;
                let twice = sounding.initiators[..number].contains(name);
                ensure(!twice, "initiators", || format!("names {name:?} twice"))?;
            }
            let takes_turns = sounding.dialect == Dialect::Native || sounding.initiators.len() <= 1;
            ensure(takes_turns, "initiators", || "take turns, which only the native dialect knows".to_owned())?;
            Ok(())
        };
        check().map_err(|p: Problem| p.key("sounding"))
    }

    fn check_surfaces(&self) -> Checked {
        for (index, wall) in self.wall.iter().enumerate() {
            let check = || {
                finite("from_m", &wall.from_m)?;
                finite("to_m", &wall.to_m)?;
                ensure(wall.from_m != wall.to_m, "to_m", || "is where the wall begins".to_owned())?;
                finite("bottom_m", &[wall.bottom_m])?;
                finite("top_m", &[wall.top_m])?;
                ensure(wall.top_m > wall.bottom_m, "top_m", || "is not above bottom_m".to_owned())?;
                not_negative("thickness_m", wall.thickness_m)?;
                check_losses(wall.loss_db, wall.through_db)
            };
            check().map_err(|p: Problem| p.item("wall", index))?;
        }
        for (index, panel) in self.reflector.iter().enumerate() {
            let check = || {
                finite("corner_m", &panel.corner_m)?;
                finite("edge_a_m", &panel.edge_a_m)?;
                finite("edge_b_m", &panel.edge_b_m)?;
                let area = Vector3::from(panel.edge_a_m).cross(&Vector3::from(panel.edge_b_m)).norm();
                ensure(area > 1e-6, "edge_b_m", || "spans no area with edge_a_m".to_owned())?;
                check_losses(panel.loss_db, panel.through_db)
            };
            check().map_err(|p: Problem| p.item("reflector", index))?;
        }
        Ok(())
    }
}

fn check_losses(loss_db: f64, through_db: Option<f64>) -> Checked {
    not_negative("loss_db", loss_db)?;
    through_db.map_or(Ok(()), |db| not_negative("through_db", db))
}

fn check_motion(motion: &RobotMotion) -> Checked {
    let timed = |kind: &'static str, sizes: [(&'static str, f64); 2], duration_s: f64, start_s: f64| {
        let [size, of_any_sign] = sizes;
        let check = || {
            not_negative(size.0, size.1)?;
            finite(of_any_sign.0, &[of_any_sign.1])?;
            positive("duration_s", duration_s)?;
            not_negative("start_s", start_s)
        };
        check().map_err(|p: Problem| p.key(kind))
    };
    match motion {
        RobotMotion::Static => Ok(()),
        RobotMotion::Line(m) => {
            let length = ("length_m", m.length_m);
            timed("line", [length, length], m.duration_s, m.start_s)
        }
        RobotMotion::Circle(m) => {
            timed("circle", [("radius_m", m.radius_m), ("turns", m.turns)], m.duration_s, m.start_s)
        }
        RobotMotion::Arc(m) => {
            timed("arc", [("radius_m", m.radius_m), ("angle_deg", m.angle_deg)], m.duration_s, m.start_s)
        }
        RobotMotion::Square(m) => timed("square", [("side_m", m.side_m), ("turns", m.turns)], m.duration_s, m.start_s),
        RobotMotion::Helix(m) => {
            finite("rise_m", &[m.rise_m]).map_err(|p| p.key("helix"))?;
            timed("helix", [("radius_m", m.radius_m), ("turns", m.turns)], m.duration_s, m.start_s)
        }
        RobotMotion::FigureEight(m) => {
            timed("figure_eight", [("radius_m", m.radius_m), ("turns", m.turns)], m.duration_s, m.start_s)
        }
        RobotMotion::RandomWalk(m) => {
            positive("within_m", m.within_m).map_err(|p| p.key("random_walk"))?;
            at_most("duration_s", m.duration_s, LONGEST_WALK_S).map_err(|p| p.key("random_walk"))?;
            let sizes = [("speed_m_s", m.speed_m_s), ("turning_deg_s", m.turning_deg_s)];
            timed("random_walk", sizes, m.duration_s, m.start_s)
        }
        RobotMotion::Waypoints(m) => {
            let check = || {
                positive("speed_m_s", m.speed_m_s)?;
                not_negative("start_s", m.start_s)?;
                ensure(!m.points_m.is_empty(), "points_m", || "has no points".to_owned())?;
                m.points_m.iter().try_for_each(|p| finite("points_m", p))
            };
            check().map_err(|p: Problem| p.key("waypoints"))
        }
        RobotMotion::Recorded(m) => {
            let check = || {
                not_negative("start_s", m.start_s)?;
                not_negative("stray_m", m.stray_m)?;
                positive("stray_s", m.stray_s)
            };
            check().map_err(|p: Problem| p.key("recorded"))
        }
        RobotMotion::Followed(m) => {
            let check = || finite("origin_m", &m.origin_m).and_then(|()| finite("origin_yaw_deg", &[m.origin_yaw_deg]));
            check().map_err(|p: Problem| p.key("followed"))
        }
    }
}

fn check_cfo(cfo: &Cfo) -> Checked {
    let Cfo::Paper(cfo) = cfo else { return Ok(()) };
    let check = || {
        finite("df_hz", &[cfo.df_hz])?;
        finite("c1", &[cfo.c1])?;
        finite("c2", &[cfo.c2])?;
        not_negative("jitter_ns", cfo.jitter_ns)
    };
    check().map_err(|p: Problem| p.key("paper"))
}

fn check_gain(gain: &Gain) -> Checked {
    match gain {
        Gain::Fixed(fixed) => positive("lsb_at_1m", fixed.lsb_at_1m).map_err(|p| p.key("fixed")),
        Gain::Agc(agc) => {
            let check = || {
                positive("target_lsb", agc.target_lsb)?;
                deviation_db("lsb_std_db", agc.lsb_std_db)?;
                decibels("rssi_db", &[agc.rssi_db])?;
                deviation_db("agc_std_db", agc.agc_std_db)
            };
            check().map_err(|p: Problem| p.key("agc"))
        }
    }
}

fn check_stray(stray: &Stray) -> Checked {
    not_negative("lsb", stray.lsb)?;
    decibels("rssi_db", &[stray.rssi_db])?;
    deviation_db("rssi_std_db", stray.rssi_std_db)
}

fn check_radio(radio: &Radio) -> Checked {
    let sizes = [
        ("phase_noise_rad", radio.phase_noise_rad),
        ("chain_noise_rad", radio.chain_noise_rad),
        ("delay_std_ns", radio.delay_std_ns),
        ("send_jitter_us", radio.send_jitter_us),
        ("host_latency_us", radio.host_latency_us),
        ("host_latency_std_us", radio.host_latency_std_us),
    ];
    sizes
        .iter()
        .try_for_each(|&(key, value)| not_negative(key, value).and_then(|()| at_most(key, value, LATEST_US)))?;
    finite("delay_ns", &[radio.delay_ns])?;
    finite("chain_deg", &radio.chain_deg)?;
    decibels("filter_db", &radio.filter_db.unwrap_or_default())?;
    share("share", radio.send_delay.share).map_err(|p| p.key("send_delay"))?;
    not_negative("us", radio.send_delay.us).map_err(|p| p.key("send_delay"))?;
    not_negative("spread_us", radio.send_delay.spread_us).map_err(|p| p.key("send_delay"))?;
    decibels("tx_power_dbm", &[radio.tx_power_dbm])?;
    ensure((1..=3).contains(&radio.chains), "chains", || format!("is {}; the card has 1 to 3", radio.chains))?;
    ensure(radio.mcs <= 7, "mcs", || format!("is {}; one stream has 0 to 7", radio.mcs))?;
    if let Noise::SnrDb(db) | Noise::FloorDbm(db) = radio.noise {
        decibels("noise", &[db])?;
    }
    check_gain(&radio.gain).map_err(|p| p.key("gain"))?;
    check_stray(&radio.stray_b).map_err(|p| p.key("stray_b"))?;
    check_stray(&radio.stray_c).map_err(|p| p.key("stray_c"))?;
    check_turn_around(&radio.turn_around)
}

fn check_turn_around(turn: &TurnAround) -> Checked {
    let ordered = turn.min_us >= 0.0 && turn.min_us <= turn.median_us && turn.median_us <= turn.max_us;
    ensure(ordered, "turn_around", || {
        format!("has min_us {}, median_us {}, max_us {}: not in order", turn.min_us, turn.median_us, turn.max_us)
    })?;
    at_most("max_us", turn.max_us, LATEST_US).map_err(|p| p.key("turn_around"))?;
    not_negative("spread_us", turn.spread_us).map_err(|p| p.key("turn_around"))?;
    not_negative("tail_spread_us", turn.tail_spread_us).map_err(|p| p.key("turn_around"))?;
    finite("tail_us", &[turn.tail_us]).map_err(|p| p.key("turn_around"))?;
    not_negative("tail_run", turn.tail_run).map_err(|p| p.key("turn_around"))?;
    for (key, group) in [("far", &turn.far), ("late", &turn.late)] {
        let check = || {
            share("share", group.share)?;
            finite("us", &[group.us])?;
            not_negative("spread_us", group.spread_us)
        };
        check().map_err(|p: Problem| p.key(key).key("turn_around"))?;
    }
    let all = turn.groups().iter().map(|group| group.share).sum::<f64>();
    ensure(all <= 1.0, "turn_around", || format!("has groups away from the core of {all} in all; more than all"))?;
    share("tail", turn.tail).map_err(|p| p.key("turn_around"))
}

fn check_faults(faults: &Faults) -> Checked {
    share("loss", faults.loss)?;
    share("duplicate", faults.duplicate)?;
    share("retry", faults.retry)?;
    share("driver_drop", faults.driver_drop)?;
    ensure(faults.queue_records > 0, "queue_records", || "is 0: nothing would ever arrive".to_owned())?;
    not_negative("stall_every_s", faults.stall_every_s)?;
    not_negative("stall_s", faults.stall_s)?;
    ensure(faults.goes_on_after_stalls(), "stall_s", || {
        format!(
            "is {}, in whole microseconds not less than stall_every_s, {}: the listener would never go on",
            faults.stall_s, faults.stall_every_s
        )
    })?;
    faults.restart_at_s.iter().try_for_each(|&t_s| not_negative("restart_at_s", t_s))?;
    not_negative("restart_s", faults.restart_s)
}

fn check_odometry(odometry: &Odometry) -> Checked {
    positive("rate_hz", odometry.rate_hz)?;
    at_most("rate_hz", odometry.rate_hz, FASTEST_HZ)?;
    not_negative("noise_m", odometry.noise_m)?;
    not_negative("noise_deg", odometry.noise_deg)?;
    positive("scale", odometry.scale)?;
    finite("heading_drift_deg_s", &[odometry.heading_drift_deg_s])?;
    not_negative("heading_walk_deg", odometry.heading_walk_deg)?;
    share("drop", odometry.drop)?;
    share("late", odometry.late)?;
    not_negative("late_s", odometry.late_s)
}
