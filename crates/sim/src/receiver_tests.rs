use super::super::scene::Scene;
use super::*;

fn scene(radio: &str, more: &str) -> Scene {
    let text = format!(
        "duration_s = 10.0\n[radio]\n{radio}\n{more}\n[[robot]]\nname = \"rx\"\n[[robot]]\nname = \"tx\"\nposition_m = [4.0, 0.0, 0.0]\n"
    );
    Scene::from_toml(&text).unwrap()
}

fn arrival(t_ns: i64) -> Arrival {
    Arrival { from: 1, to: 0, t_ns, instant_ns: t_ns }
}

fn receive(scene: &Scene, n: i64) -> Vec<Measured> {
    let world = World::new(scene).unwrap();
    let mut receiver = Receiver::new(scene.radio, scene.seed, 0);
    (0..n).map(|i| receiver.measure(&world, arrival(i * 10_000_000)).unwrap()).collect()
}

#[test]
fn quantisation_rounds_to_nearest_and_counts_what_it_cuts() {
    let mut saturated = 0;
    let mut q = |x: f64| quantised(x, 0.0, &mut saturated).i;
    assert_eq!([q(0.4), q(0.6), q(-0.6), q(-0.4), q(126.6), q(127.4), q(-128.4)], [0, 1, -1, 0, 127, 127, -128]);
    assert_eq!([q(127.6), q(-129.0), q(1e30), q(-1e30)], [127, -128, 127, -128]);
    assert_eq!(saturated, 4);
}

#[test]
fn a_bare_record_is_the_channel_itself() {
    let scene = scene("gain.fixed = { lsb_at_1m = 400.0 }", "");
    let m = receive(&scene, 1)[0];
    assert_eq!((m.n_rx, m.antenna_sel, m.saturated), (3, 0x24, 0));
    let world = World::new(&scene).unwrap();
    for (i, &k) in world.carrier().indices().iter().enumerate() {
        let hz = world.carrier().centre_hz + f64::from(k) * 312_500.0;
        let want = Complex64::from_polar(100.0, -std::f64::consts::TAU * 4.0 * hz / 299_792_458.0);
        let got = m.csi[3 * i];
        assert!((f64::from(got.i) - want.re).abs() <= 0.5 + 1e-6 && (f64::from(got.q) - want.im).abs() <= 0.5 + 1e-6);
        assert_eq!((m.csi[3 * i + 1], m.csi[3 * i + 2]), (Iq::default(), Iq::default()), "B and C are not connected");
    }
}

#[test]
fn filters_shape_the_subcarriers_and_leave_the_level() {
    let gains: Vec<String> =
        (0..30).map(|k| format!("{:.1}", if !(3..=26).contains(&k) { -6.0 } else { 3.0 })).collect();
    let flat = receive(&scene("gain.agc = { target_lsb = 60.0 }", ""), 1)[0];
    let shaped = format!("gain.agc = {{ target_lsb = 60.0 }}\nfilter_db = [{}]", gains.join(", "));
    let shaped = receive(&scene(&shaped, ""), 1)[0];
    let size = |m: &Measured, i: usize| f64::from(m.csi[3 * i].i).hypot(f64::from(m.csi[3 * i].q));
    let rms = |m: &Measured| ((0..30).map(|i| size(m, i).powi(2)).sum::<f64>() / 30.0).sqrt();
    assert!((rms(&flat) - 60.0).abs() < 0.5 && (rms(&shaped) - 60.0).abs() < 0.5, "{} {}", rms(&flat), rms(&shaped));
    let ratio = size(&shaped, 15) / size(&shaped, 0);
    assert!((ratio - amplitude(9.0)).abs() < 0.05 * ratio, "{ratio}: 9 dB between middle and edge");
    assert_eq!((shaped.agc, shaped.rssi), (flat.agc, flat.rssi));
}

#[test]
fn a_pattern_weighs_both_directions_alike_by_the_robots_heading() {
    let power = |more: &str, arrival: Arrival| {
        let text = format!(
            "duration_s = 1.0\nradio.gain.agc = {{ target_lsb = 60.0 }}\n[[robot]]\nname = \"rx\"\n{more}\n\
             [[robot]]\nname = \"tx\"\nposition_m = [4.0, 0.0, 0.0]\n"
        );
        let patterned = Scene::from_toml(&text).unwrap();
        let world = World::new(&patterned).unwrap();
        let measured = Receiver::new(patterned.radio, 1, 0).measure(&world, arrival).unwrap();
        i32::from(measured.rssi[0]) - i32::from(measured.agc)
    };
    let back = Arrival { from: 0, to: 1, t_ns: 0, instant_ns: 0 };
    let plain = power("", arrival(0));
    // The other robot is at +x: ahead, to the left, behind.
    for (yaw_deg, db) in [(0.0, 6), (-90.0, 3), (180.0, -6), (90.0, -3)] {
        let more = format!("yaw_deg = {yaw_deg:?}\npattern = {{ cos_db = 6.0, sin_db = 3.0 }}");
        assert_eq!([power(&more, arrival(0)), power(&more, back)], [plain + db; 2], "{yaw_deg} degrees");
    }
    let more = "yaw_deg = 45.0\npattern = { cos2_db = 9.0, sin2_db = -4.0 }";
    assert_eq!(power(more, arrival(0)), plain + 4, "45 degrees to the right: the second harmonic's sine is -1");
}

#[test]
fn noise_has_the_stated_ratio_and_agc_the_stated_size() {
    let records = receive(&scene("noise.snr_db = 3.0", ""), 400);
    let clean = receive(&scene("", ""), 1)[0];
    let (mut signal, mut noise, mut total, mut n) = (0.0, 0.0, 0.0, 0.0);
    // Noise is part of what the gain control holds at 31 steps.
    let shrink = (1.0 / (1.0 + power(-3.0))).sqrt();
    for m in &records {
        for i in 0..TONES {
            let z = |iq: Iq| Complex64::new(f64::from(iq.i), f64::from(iq.q));
            let (got, want) = (z(m.csi[3 * i]), z(clean.csi[3 * i]) * shrink);
            signal += want.norm_sqr();
            noise += (got - want).norm_sqr();
            total += got.norm_sqr();
            n += 1.0;
        }
    }
    let snr_db = decibel(signal / noise);
    assert!((snr_db - 3.0).abs() < 0.1, "{snr_db} dB");
    assert!(((total / n).sqrt() - 31.0).abs() < 0.3, "{}", (total / n).sqrt());
}

#[test]
fn rssi_and_agc_give_the_received_power() {
    // 15 dBm over 4 m at 5.54 GHz: 59.36 dB of free space loss, -44.36 dBm.
    let m = receive(&scene("", ""), 1)[0];
    let rss_dbm = f64::from(m.rssi[0]) - 44.0 - f64::from(m.agc);
    assert!((rss_dbm + 44.36).abs() <= 0.5, "{rss_dbm} dBm");
    assert_eq!(m.rssi[0], 38);
    let floor = receive(&scene("noise.floor_dbm = -92.0", ""), 1)[0];
    assert_eq!(floor.rssi[0], 38);
}

#[test]
fn antennas_are_ordered_by_rssi_packet_by_packet() {
    let radio = "antenna_order = \"by_rssi\"\nstray_b = { lsb = 2.0, rssi_db = 14.0, rssi_std_db = 2.0 }\n\
                 stray_c = { lsb = 1.5, rssi_db = 14.0, rssi_std_db = 2.0 }";
    let records = receive(&scene(radio, ""), 400);
    let abc = records.iter().filter(|m| m.antenna_sel == 0x24).count();
    let acb = records.iter().filter(|m| m.antenna_sel == 0x18).count();
    assert_eq!(abc + acb, 400, "A is always the strongest");
    assert!((120..280).contains(&abc), "B and C change places: {abc}");
    for m in &records {
        let weaker = if m.antenna_sel == 0x24 { (1, 2) } else { (2, 1) };
        assert!(m.rssi[weaker.0] >= m.rssi[weaker.1]);
    }
    let rms = |k: usize| {
        let sum: f64 = records
            .iter()
            .flat_map(|m| (0..TONES).map(move |i| m.csi[3 * i + k]))
            .map(|iq| f64::from(iq.i).powi(2) + f64::from(iq.q).powi(2))
            .sum();
        (sum / (400.0 * TONES as f64)).sqrt()
    };
    assert!((rms(1) - 1.8).abs() < 0.3 && (rms(0) - 31.0).abs() < 0.1, "{} {}", rms(0), rms(1));
}

#[test]
fn crystals_turn_the_two_directions_against_each_other() {
    let text = "duration_s = 10.0\ncfo = \"physical\"\n[radio]\ngain.fixed = { lsb_at_1m = 500.0 }\n[[robot]]\nname = \"rx\"\n[[robot]]\n\
                name = \"tx\"\nposition_m = [4.0, 0.0, 0.0]\ncrystal.offset_ppm = -2.0\n";
    let scene = Scene::from_toml(text).unwrap();
    let world = World::new(&scene).unwrap();
    let mut receiver = Receiver::new(scene.radio, 1, 0);
    let mut phase = |from, to, t_ns| {
        let m = receiver.measure(&world, Arrival { from, to, t_ns, instant_ns: t_ns }).unwrap();
        Complex64::new(f64::from(m.csi[45].i), f64::from(m.csi[45].q))
    };
    // -2 ppm of 5.54 GHz is -11.08 kHz: 20 us turn it by -0.2216 of a turn, in the direction of the fast sender.
    let turned = (phase(1, 0, 20_000) / phase(1, 0, 0)).arg();
    assert!((turned + std::f64::consts::TAU * 0.2216).abs() < 0.03, "{turned}");
    let still = phase(0, 1, 0) * phase(1, 0, 0);
    let later = phase(0, 1, 7_777_000) * phase(1, 0, 7_777_000);
    assert!((later / still).arg().abs() < 0.03, "at one instant both cancel");
    // 225 us of turn-around leave 2 pi f d.
    let late = (phase(0, 1, 0) * phase(1, 0, 225_000) / still).arg();
    let want = std::f64::consts::TAU * (-11_080.0 * 225e-6);
    assert!(csi5300::maths::wrap_rad(late - want).abs() < 0.03, "{late}, not {want}");
}

#[test]
fn the_papers_offset_cancels_but_for_its_jitter() {
    let paper =
        |jitter: &str| scene("gain.fixed = { lsb_at_1m = 500.0 }", &format!("[cfo.paper]\njitter_ns = {jitter}"));
    let residual = |scene: &Scene| {
        let world = World::new(scene).unwrap();
        let mut receiver = Receiver::new(scene.radio, 1, 0);
        let z: Vec<Complex64> = (0..500)
            .map(|i| {
                let t_ns = i * 10_000_000;
                let mut at = |from, to, late| {
                    let m =
                        receiver.measure(&world, Arrival { from, to, t_ns: t_ns + late, instant_ns: t_ns }).unwrap();
                    Complex64::new(f64::from(m.csi[45].i), f64::from(m.csi[45].q))
                };
                at(0, 1, 0) * at(1, 0, 225_000)
            })
            .collect();
        let mean: Complex64 = z.iter().sum();
        (z.iter().map(|z| (z / mean).arg().powi(2)).sum::<f64>() / 500.0).sqrt()
    };
    assert!(residual(&paper("0.0")) < 0.02);
    // 2 pi x 2 MHz x uniform in +-100 ns x rms of the cosine: 0.513 rad.
    let got = residual(&paper("100.0"));
    assert!((got - 0.513).abs() < 0.06, "{got}");
}

#[test]
fn disabled_effects_draw_no_random_numbers() {
    let scene = scene("", "");
    let world = World::new(&scene).unwrap();
    let mut receiver = Receiver::new(scene.radio, 1, 0);
    let before = receiver.stream.clone().uniform().to_bits();
    receiver.measure(&world, arrival(0)).unwrap();
    assert_eq!(receiver.stream.uniform().to_bits(), before);
}

/// Phases of chain B against A over records, radians.
fn chain_phases(scene: &Scene, n: i64) -> Vec<f64> {
    let phase = |m: &Measured| {
        let [a, b] = [m.csi[0], m.csi[1]].map(|iq| Complex64::new(f64::from(iq.i), f64::from(iq.q)));
        (b * a.conj()).arg()
    };
    receive(scene, n).iter().map(phase).collect()
}

#[test]
fn chains_have_constants_that_flip_with_the_firmware_and_noise_of_their_own() {
    // Antenna B where A is, so that nothing but the chains differs.
    let with = |radio: &str| {
        let mut scene = scene(&format!("gain.agc = {{ target_lsb = 100.0 }}\n{radio}"), "");
        scene.robot[0].antenna_b_m = Some([0.0; 3]);
        scene
    };
    let at = |radio: &str, n: i64| chain_phases(&with(radio), n);
    assert!(at("", 2).iter().all(|rad| rad.abs() < 0.02));
    assert!(at("chain_deg = [60.0, 0.0]", 2).iter().all(|rad| (rad.to_degrees() - 60.0).abs() < 1.0));
    let noisy = at("chain_noise_rad = 0.2", 4_000);
    let rms = (noisy.iter().map(|rad| rad * rad).sum::<f64>() / 4_000.0).sqrt();
    assert!((rms - 0.2).abs() < 0.01, "{rms}");
    // Of many loads of the firmware half are turned over.
    let world = World::new(&with("chain_flips = true")).unwrap();
    let mut receiver = Receiver::new(world.scene().radio, 1, 0);
    let mut over = 0;
    for _ in 0..200 {
        receiver.load();
        let [_, turns, _] = receiver.chain_turns;
        assert!(turns == 0.0 || turns == 0.5);
        over += usize::from(turns == 0.5);
    }
    assert!((70..130).contains(&over), "{over}");
}
