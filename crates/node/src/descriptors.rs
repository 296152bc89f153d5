//! Reserves file descriptors for the log.

/// Descriptors that stay free for the log, its next file and what the service opens.
const RESERVED: u64 = 32;

/// False if viewers would take descriptors that the log needs.
pub(crate) fn are_to_spare() -> bool {
    let limit =
        nix::sys::resource::getrlimit(nix::sys::resource::Resource::RLIMIT_NOFILE).map_or(u64::MAX, |(soft, _)| soft);
    // The listing itself uses a descriptor.
    let used = std::fs::read_dir("/proc/self/fd").map_or(u64::MAX, |listing| listing.count() as u64);
    used.saturating_add(RESERVED) < limit
}
