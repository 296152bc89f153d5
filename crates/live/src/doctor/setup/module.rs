//! The steps for the stock driver with `csi5300.ko` beside it (driver-iface/kmod): the firmware in its place, the module.

use super::{Driver, Request, Step, System};
use crate::doctor::card::{FIRMWARE, FIRMWARE_BYTES, wins};

/// A hash of the sources of the module that is loaded.
const BUILD: &str = "/sys/module/csi5300/srcversion";
/// The module's parameters.
const PARAMETERS: &str = "/sys/module/csi5300/parameters";
/// The module's rate of sounding frames.
pub(crate) const RATE: &str = "/sys/module/csi5300/parameters/monitor_tx_rate";
const FOLDER: &str = "/lib/firmware";
/// csitool's firmware under the name that it is published under.
const PUBLISHED: &str = "iwlwifi-5000-2.ucode.sigcomm2010";
/// What is appended to the name of a firmware that is moved aside.
const ASIDE: &str = ".csi5300-aside";
const SECURE_BOOT: &str = "/sys/firmware/efi/efivars/SecureBoot-8be4df61-93ca-11d2-aa0d-00e098032b8c";

/// True if the module is loaded, or can be.
pub(super) fn installed(system: &dyn System) -> bool {
    let known =
        || system.run(&["modinfo", "-F", "license", "csi5300"]).is_some_and(|ran| ran.ok && !ran.text.is_empty());
    system.text(&format!("{PARAMETERS}/layout")).is_some() || known()
}

/// Puts csitool's firmware where the driver finds it, and moves preferred ones away. If the file is not on this
/// machine, the user must copy it, as the doctor reports.
pub(super) fn firmware(system: &dyn System) -> Vec<Step> {
    let at = |name: &str| format!("{FOLDER}/{name}");
    let aside =
        |name: &str| Step::run("kept, but out of the driver's way", &["mv", &at(name), &at(&format!("{name}{ASIDE}"))]);
    let mut steps: Vec<_> = system.names(FOLDER).iter().filter(|name| wins(name)).map(|name| aside(name)).collect();
    if system.size(FIRMWARE) == Some(FIRMWARE_BYTES) || system.size(&at(PUBLISHED)) != Some(FIRMWARE_BYTES) {
        return steps;
    }
    if system.size(FIRMWARE).is_some() {
        steps.push(aside("iwlwifi-5000-2.ucode"));
    }
    steps.push(Step::run("the firmware that sends CSI", &["ln", "-s", PUBLISHED, FIRMWARE]));
    steps
}

/// True if the loaded module was built from other sources than the one on this disk, as after an update.
fn is_another_build(system: &dyn System) -> bool {
    let on_disk = system.run(&["modinfo", "-F", "srcversion", "csi5300"]).filter(|ran| ran.ok);
    let on_disk = on_disk.map(|ran| ran.text.trim().to_owned()).filter(|build| !build.is_empty());
    on_disk.is_some_and(|build| system.text(BUILD).unwrap_or_default().trim() != build)
}

/// The module with its parameters, unless it already runs with them and is the one on the disk.
pub(super) fn load(system: &dyn System, request: &Request) -> Vec<Step> {
    let text = |name: &str| system.text(&format!("{PARAMETERS}/{name}")).unwrap_or_default();
    let answered = request.ack_len.unwrap_or(0).to_string();
    // Records of the WSR layout name the sender themselves; those of the stock layout need the frame before them.
    let (layout, log) = if request.ack_len.is_some() { ("wsr", "1") } else { ("stock", "5") };
    let first_of = |names: String| names.split(',').next().unwrap_or_default().to_string();
    let there = request.ack_len.is_none() || first_of(text("answer_on")) == request.interface;
    let is_loaded = system.text(&format!("{PARAMETERS}/layout")).is_some();
    let another = is_loaded && is_another_build(system);
    if [text("layout"), text("connector_log"), text("ack_len")] == [layout, log, &answered] && there && !another {
        return Vec::new();
    }
    let why = match another {
        true => "the loaded csi5300 is another build than the one on this disk (srcversion)",
        false => "the module takes its parameters when it is loaded",
    };
    let mut words = vec!["modprobe", "csi5300"];
    let parameters = [
        format!("layout={layout}"),
        format!("connector_log={log}"),
        format!("ack_len={answered}"),
        format!("answer_on={}", request.interface),
    ];
    words.extend(parameters.iter().take(if request.ack_len.is_some() { 4 } else { 2 }).map(String::as_str));
    vec![Step::run(why, &["modprobe", "-r", "csi5300"]).may_fail(), Step::run("CSI to the connector", &words)]
}

/// The steps that remove the module, and those that restore the firmware.
pub(super) fn undo(system: &dyn System) -> (Option<Step>, Vec<Step>) {
    let loaded = system.text(&format!("{PARAMETERS}/layout")).is_some();
    let module = loaded.then(|| Step::run("without the module", &["modprobe", "-r", "csi5300"]));
    let moved: Vec<_> = system.names(FOLDER).into_iter().filter(|name| name.ends_with(ASIDE)).collect();
    let mut steps = Vec::new();
    if !moved.is_empty() && system.link(FIRMWARE).as_deref() == Some(PUBLISHED) {
        steps.push(Step::run("the link that the set-up made", &["rm", FIRMWARE]));
    }
    for name in moved {
        let (from, to) = (format!("{FOLDER}/{name}"), format!("{FOLDER}/{}", name.trim_end_matches(ASIDE)));
        steps.push(Step::run("the firmware that was there before", &["mv", &from, &to]));
    }
    (module, steps)
}

/// Problems of this driver that no step can repair, in words.
pub(super) fn warnings(system: &dyn System, driver: Option<Driver>) -> Vec<String> {
    let secure = system.bytes(SECURE_BOOT).and_then(|bytes| bytes.get(4).copied()) == Some(1);
    let mut warnings = Vec::new();
    match driver {
        Some(Driver::Module) if secure => warnings.push(
            "Secure Boot is on: csi5300.ko loads only with the key of DKMS enrolled (`sudo mokutil --import \
             /var/lib/dkms/mok.pub`, on Ubuntu /var/lib/shim-signed/mok/MOK.der; reboot and confirm), or with Secure Boot \
             off",
        ),
        _ if secure => warnings.push("Secure Boot is on: it refuses a patched iwlwifi that is not signed"),
        _ => {}
    }
    if driver == Some(Driver::Module) && !installed(system) {
        warnings.push(
            "csi5300.ko is not installed: `sudo dpkg -i csi5300-dkms_*_all.deb` builds it for this kernel \
             (packaging/dkms/build.sh makes the package)",
        );
    }
    let published = format!("{FOLDER}/{PUBLISHED}");
    let sizes = [system.size(FIRMWARE), system.size(&published)];
    if driver == Some(Driver::Module) && !sizes.contains(&Some(FIRMWARE_BYTES)) {
        warnings.push(
            "csitool's firmware is not on this machine: copy iwlwifi-5000-2.ucode.sigcomm2010 (336,252 bytes, from csitool's \
             supplementary repository) to /lib/firmware first",
        );
    }
    warnings.into_iter().map(str::to_string).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Role, plan, undo, warnings};
    use super::*;
    use crate::doctor::Tree;
    use std::path::PathBuf;

    struct Stage(PathBuf);

    impl Stage {
        fn new(name: &str) -> Self {
            let root = std::env::temp_dir().join(format!("csi5300-module-{}-{name}", std::process::id()));
            let _ = std::fs::remove_dir_all(&root);
            let stage = Self(root);
            stage.put("run/modinfo -F license csi5300", "GPL\n");
            stage.put("run/modinfo -p iwlwifi", "swcrypto:software crypto (int)\n");
            stage
        }

        fn put(&self, path: &str, text: &str) {
            let path = self.0.join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }

        fn tree(&self) -> Tree {
            Tree::new(self.0.clone())
        }

        fn lines(&self, ack_len: Option<u32>) -> Vec<String> {
            plan(&self.tree(), &request(ack_len)).unwrap().iter().map(Step::line).collect()
        }
    }

    impl Drop for Stage {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn request(ack_len: Option<u32>) -> Request {
        let (interface, channel) = ("wlp1s0".to_string(), "64+".parse().unwrap());
        Request { interface, channel, role: Role::Responder, driver: None, ack_len }
    }

    #[test]
    fn a_fresh_system_gets_firmware_module_and_rate() {
        let stage = Stage::new("fresh");
        stage.put("lib/firmware/iwlwifi-5000-2.ucode", "the distribution's");
        stage.put("lib/firmware/iwlwifi-5000-5.ucode.zst", "newer");
        stage.put("lib/firmware/iwlwifi-5150-2.ucode", "another card's");
        stage.put(&format!("lib/firmware/{PUBLISHED}"), &"x".repeat(FIRMWARE_BYTES as usize));
        let lines = stage.lines(None);
        let at = |words: &str| {
            lines.iter().position(|line| line.contains(words)).unwrap_or_else(|| panic!("{words}: {lines:?}"))
        };
        let (newer, own) =
            (at("mv /lib/firmware/iwlwifi-5000-5.ucode.zst"), at("mv /lib/firmware/iwlwifi-5000-2.ucode "));
        let link = at("ln -s iwlwifi-5000-2.ucode.sigcomm2010 /lib/firmware/iwlwifi-5000-2.ucode");
        assert!(newer < link && own < link && link < at("modprobe -r iwldvm iwlwifi"));
        assert!(at("modprobe iwlwifi") < at("modprobe csi5300 layout=stock connector_log=5"));
        assert!(at("modprobe csi5300") < at("set type monitor"));
        assert!(!lines.iter().any(|line| line.contains("5150") || line.contains("debugfs")), "{lines:?}");
        assert_eq!(lines.last().unwrap(), &format!("echo 0x4901 | sudo tee {RATE}"));
        assert!(warnings(&stage.tree(), &request(None)).is_empty());
    }

    #[test]
    fn a_correct_set_up_is_kept_and_can_be_undone() {
        let stage = Stage::new("running");
        stage.put("lib/firmware/iwlwifi-5000-5.ucode.csi5300-aside", "newer");
        stage.put(&format!("lib/firmware/{PUBLISHED}"), &"x".repeat(FIRMWARE_BYTES as usize));
        std::os::unix::fs::symlink(PUBLISHED, stage.0.join("lib/firmware/iwlwifi-5000-2.ucode")).unwrap();
        for (name, value) in
            [("layout", "wsr"), ("connector_log", "1"), ("ack_len", "59"), ("answer_on", "wlp1s0,(null)")]
        {
            stage.put(&format!("sys/module/csi5300/parameters/{name}"), value);
        }
        assert!(!stage.lines(Some(59)).iter().any(|line| line.contains("modprobe") || line.contains("firmware")));
        let other = stage.lines(Some(57));
        let wanted = "sudo modprobe csi5300 layout=wsr connector_log=1 ack_len=57 answer_on=wlp1s0";
        assert!(other.iter().any(|line| line == wanted), "{other:?}");
        let undone: Vec<_> = undo(&stage.tree(), "wlp1s0").iter().map(Step::line).collect();
        let at = |words: &str| {
            undone.iter().position(|line| line.contains(words)).unwrap_or_else(|| panic!("{words}: {undone:?}"))
        };
        assert!(at("modprobe -r csi5300") < at("rm /lib/firmware/iwlwifi-5000-2.ucode"));
        assert!(
            at("rm ") < at("mv /lib/firmware/iwlwifi-5000-5.ucode.csi5300-aside /lib/firmware/iwlwifi-5000-5.ucode")
        );
        assert!(at("mv ") < at("modprobe iwlwifi"));
    }

    #[test]
    fn another_build_than_the_one_on_disk_is_reloaded() {
        let stage = Stage::new("build");
        stage.put(&format!("lib/firmware/{PUBLISHED}"), &"x".repeat(FIRMWARE_BYTES as usize));
        std::os::unix::fs::symlink(PUBLISHED, stage.0.join("lib/firmware/iwlwifi-5000-2.ucode")).unwrap();
        for (name, value) in [("layout", "stock"), ("connector_log", "5"), ("ack_len", "0")] {
            stage.put(&format!("sys/module/csi5300/parameters/{name}"), value);
        }
        let load = || load(&stage.tree(), &request(None));
        assert!(load().is_empty(), "nothing says which builds they are");
        stage.put("run/modinfo -F srcversion csi5300", "0123456789ABCDEF01234AB\n");
        for (loaded, steps) in
            [(None, 2), (Some("FFFFFFFFFFFFFFFFFFFFFFF\n"), 2), (Some("0123456789ABCDEF01234AB\n"), 0)]
        {
            loaded.iter().for_each(|build| stage.put(BUILD.trim_start_matches('/'), build));
            let planned = load();
            assert_eq!(planned.len(), steps, "{loaded:?}");
            assert!(
                planned
                    .iter()
                    .take(1)
                    .all(|step| step.why.contains("another build") && step.line().contains("-r csi5300"))
            );
        }
    }

    #[test]
    fn problems_without_a_step_are_reported() {
        let stage = Stage::new("warned");
        stage.put(SECURE_BOOT.trim_start_matches('/'), "\u{6}\0\0\0\u{1}");
        std::fs::remove_file(stage.0.join("run/modinfo -F license csi5300")).unwrap();
        let request = Request { driver: Some(Driver::Module), ..request(None) };
        let said = warnings(&stage.tree(), &request);
        assert_eq!(said.len(), 3, "{said:?}");
        assert!(said[0].contains("mokutil") && said[1].contains("dpkg -i") && said[2].contains("336,252"), "{said:?}");
    }
}
