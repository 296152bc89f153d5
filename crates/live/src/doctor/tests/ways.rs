//! The three ways to CSI, in a build that has all of them.

use super::*;

/// A distribution's kernel of today with its own driver, run with CAP_BPF, CAP_PERFMON and CAP_NET_ADMIN.
fn todays(name: &str) -> Stage {
    let stage = Stage::healthy(name);
    stage.remove("sys/module/iwlwifi");
    stage.remove("proc/net/connector");
    for (path, text) in [
        ("sys/module/iwlwifi/parameters/power_save", "N\n"),
        ("proc/net/connector", "Name            ID\ncn_proc         1:1\n"),
        ("proc/sys/kernel/osrelease", "6.1.0-56-amd64\n"),
        ("proc/self/status", "CapEff:\t000000c000001000\n"),
        ("sys/bus/event_source/devices/kprobe/type", "8\n"),
        ("sys/kernel/security/lockdown", "none [integrity] confidentiality\n"),
        ("run/uname -m", "x86_64\n"),
    ] {
        stage.put(path, text);
    }
    stage
}

const EFIVAR: &str = "sys/firmware/efi/efivars/SecureBoot-8be4df61-93ca-11d2-aa0d-00e098032b8c";

#[test]
fn a_kernel_of_today_needs_no_patch() {
    let stage = todays("today");
    stage.put(EFIVAR, "\u{6}\0\0\0\u{1}");
    let way = stage.check("way to CSI");
    assert_eq!(way.verdict, Verdict::Good, "{way:?}");
    assert!(way.found.contains("Best here: eBPF") && way.found.contains("patched driver: no"), "{way:?}");
    assert!(way.found.contains("module: no (Secure Boot"), "{way:?}");
    assert!(way.mend.unwrap().contains("record --stock"));
    for name in ["kernel", "Secure Boot", "patched module"] {
        assert_eq!(stage.check(name).verdict, Verdict::Good, "{name}");
    }
    assert!(stage.examine().iter().all(|check| check.verdict != Verdict::Bad), "{:?}", stage.examine());
}

#[test]
fn another_way_one_step_away_excuses_the_kernel() {
    let stage = todays("a-step");
    stage.put("proc/self/status", "CapEff:\t0000000000001000\n");
    assert_eq!(stage.check("way to CSI").verdict, Verdict::Doubt);
    for name in ["kernel", "patched module", "connector index"] {
        let check = stage.check(name);
        assert!(check.verdict != Verdict::Bad && check.mend.is_none(), "{check:?}");
    }
    // If every other way is closed, an older kernel remains.
    stage.remove("sys/bus/event_source");
    stage.put(EFIVAR, "\u{6}\0\0\0\u{1}");
    assert!(stage.check("kernel").mend.unwrap().contains("4.15"));
    assert_eq!(stage.check("patched module").verdict, Verdict::Bad);
}

#[test]
fn a_missing_feature_is_reported() {
    let expect = |stage: &Stage, verdict: Verdict, words: &str| {
        let way = stage.check("way to CSI");
        assert!(way.verdict == verdict && way.found.contains(words), "{words}: {way:?}");
    };
    let cases: [(&str, &str, Verdict, &str); 7] = [
        ("proc/sys/kernel/osrelease", "5.7.19\n", Verdict::Doubt, "eBPF: no (5.7.19 is older than 5.8)"),
        ("run/uname -m", "aarch64\n", Verdict::Doubt, "eBPF: no (not x86-64)"),
        (
            "sys/kernel/security/lockdown",
            "none integrity [confidentiality]\n",
            Verdict::Doubt,
            "eBPF: no (kernel lockdown",
        ),
        ("proc/self/status", "CapEff:\t0000000000001000\n", Verdict::Doubt, "CAP_BPF and CAP_PERFMON are not held"),
        ("proc/sys/kernel/perf_event_paranoid", "3\n", Verdict::Doubt, "perf_event_paranoid above 2 wants root"),
        ("sys/module/csi5300/refcnt", "0\n", Verdict::Good, "Best here: module"),
        ("sys/module/iwlwifi/parameters/connector_log", "1\n", Verdict::Good, "Best here: patched driver"),
    ];
    for (k, (path, text, verdict, words)) in cases.into_iter().enumerate() {
        let stage = todays(&format!("missing-{k}"));
        stage.put(path, text);
        expect(&stage, verdict, words);
    }
    let stage = todays("no-kprobes");
    stage.remove("sys/bus/event_source");
    stage.put(EFIVAR, "\u{6}\0\0\0\u{1}");
    expect(&stage, Verdict::Bad, "eBPF: no (the kernel has no kprobes)");
    assert_eq!(stage.check("Secure Boot").verdict, Verdict::Bad);
}
