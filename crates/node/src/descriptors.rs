//! File descriptors: some are kept for the log, whoever connects.

/// Descriptors that stay free for the log, its next file and what the service opens.
const RESERVED: u64 = 32;

/// False when those who look at the robot would take what its log needs.
pub(crate) fn are_to_spare() -> bool {
    let limit =
        nix::sys::resource::getrlimit(nix::sys::resource::Resource::RLIMIT_NOFILE).map_or(u64::MAX, |(soft, _)| soft);
    // This listing has a descriptor of its own.
    let used = std::fs::read_dir("/proc/self/fd").map_or(u64::MAX, |listing| listing.count() as u64);
    used.saturating_add(RESERVED) < limit
}
