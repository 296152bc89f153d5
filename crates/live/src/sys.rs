//! System calls without a safe wrapper in any crate. All `unsafe` code of the project is in this file.
#![allow(unsafe_code)]

use driver_iface::Mac;
use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};

/// One instruction of a classic socket filter.
pub type Instruction = libc::sock_filter;

/// Operations of an [`Instruction`] (`BPF_*`).
pub(crate) mod operation {
    pub(crate) const LOAD_WORD: u16 = 0x20; // BPF_LD | BPF_W | BPF_ABS
    pub(crate) const LOAD_BYTE: u16 = 0x30; // BPF_LD | BPF_B | BPF_ABS
    pub(crate) const LOAD_WORD_AT_X: u16 = 0x40; // BPF_LD | BPF_W | BPF_IND
    pub(crate) const LOAD_HALF_AT_X: u16 = 0x48; // BPF_LD | BPF_H | BPF_IND
    pub(crate) const LOAD_BYTE_AT_X: u16 = 0x50; // BPF_LD | BPF_B | BPF_IND
    pub(crate) const SHIFT_LEFT: u16 = 0x64; // BPF_ALU | BPF_LSH | BPF_K
    pub(crate) const ADD_X: u16 = 0x0c; // BPF_ALU | BPF_ADD | BPF_X
    pub(crate) const TO_X: u16 = 0x07; // BPF_MISC | BPF_TAX
    pub(crate) const JUMP_IF_EQUAL: u16 = 0x15; // BPF_JMP | BPF_JEQ | BPF_K
    pub(crate) const RETURN: u16 = 0x06; // BPF_RET | BPF_K
    /// Operand that loads the packet's type from the kernel's ancillary data (SKF_AD_OFF + SKF_AD_PKTTYPE).
    pub(crate) const PACKET_TYPE: u32 = (-0x1000_i32 + 4).cast_unsigned();
}

/// An operation, the instructions to skip if it is true or false, and its operand.
pub(crate) fn step(code: u16, jt: u8, jf: u8, k: u32) -> Instruction {
    Instruction { code, jt, jf, k }
}

/// Attaches a classic filter to a socket (SO_ATTACH_FILTER); it replaces an earlier one.
///
/// # Errors
/// The kernel's refusal, when the program is malformed or longer than it allows.
pub fn attach_filter(socket: BorrowedFd<'_>, program: &[Instruction]) -> io::Result<()> {
    let mut filter = program.to_vec();
    let len = u16::try_from(filter.len()).map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
    let program = libc::sock_fprog { len, filter: filter.as_mut_ptr() };
    let size = size_of::<libc::sock_fprog>() as libc::socklen_t;
    // SAFETY: `program` and the array that it points to live until after the call, `len` is that array's length and
    // `size` that of the structure, as SO_ATTACH_FILTER demands; the kernel copies both and keeps no pointer.
    let answer = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_ATTACH_FILTER,
            (&raw const program).cast::<libc::c_void>(),
            size,
        )
    };
    answered(answer)
}

/// ARPHRD_IEEE80211_RADIOTAP (`linux/if_arp.h`): the link type of a monitor interface.
pub const ARPHRD_IEEE80211_RADIOTAP: u16 = 803;

fn answered(answer: libc::c_int) -> io::Result<()> {
    if answer < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

/// Binds a packet socket to an interface, for frames of every protocol (`packet(7)`).
///
/// # Errors
/// The kernel's refusal.
pub fn bind_packet(socket: BorrowedFd<'_>, interface: u32) -> io::Result<()> {
    let index = libc::c_int::try_from(interface).map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
    let address = libc::sockaddr_ll {
        sll_family: libc::AF_PACKET as u16,
        sll_protocol: (libc::ETH_P_ALL as u16).to_be(),
        sll_ifindex: index,
        sll_hatype: 0,
        sll_pkttype: 0,
        sll_halen: 0,
        sll_addr: [0; 8],
    };
    let size = size_of::<libc::sockaddr_ll>() as libc::socklen_t;
    // SAFETY: `address` is a `sockaddr_ll` that lives until after the call, and `size` is its size; the kernel copies it.
    answered(unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), size) })
}

/// Link type (ARPHRD_*) and MAC of the interface that a packet socket is bound to.
///
/// # Errors
/// The kernel's refusal.
pub fn packet_link(socket: BorrowedFd<'_>) -> io::Result<(u16, Option<Mac>)> {
    // SAFETY: `sockaddr_ll` consists of integers and an array of them, for all of which zero is a value.
    let mut address: libc::sockaddr_ll = unsafe { std::mem::zeroed() };
    let mut size = size_of::<libc::sockaddr_ll>() as libc::socklen_t;
    // SAFETY: the kernel writes at most `size` bytes, the size of `address`, which is ours alone until the call ends.
    answered(unsafe { libc::getsockname(socket.as_raw_fd(), (&raw mut address).cast(), &raw mut size) })?;
    let mac = address.sll_addr.first_chunk().copied().filter(|_| address.sll_halen == 6).map(Mac);
    Ok((address.sll_hatype, mac))
}

/// Frames that a packet socket has dropped since the last call, because its queue was full (PACKET_STATISTICS).
///
/// # Errors
/// The kernel's refusal.
pub fn packet_drops(socket: BorrowedFd<'_>) -> io::Result<u32> {
    /// PACKET_STATISTICS (`linux/if_packet.h`).
    const STATISTICS: libc::c_int = 6;
    let mut packets_and_drops = [0_u32; 2];
    let mut size = size_of_val(&packets_and_drops) as libc::socklen_t;
    // SAFETY: the kernel writes at most `size` bytes, the size of the array (`struct tpacket_stats`, two u32), which is
    // ours alone until the call ends.
    let answer = unsafe {
        libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_PACKET,
            STATISTICS,
            packets_and_drops.as_mut_ptr().cast(),
            &raw mut size,
        )
    };
    answered(answer).map(|()| packets_and_drops[1])
}

/// A request about an interface, its union all zero.
fn request(interface: &str) -> io::Result<libc::ifreq> {
    // SAFETY: `ifreq` consists of integers, arrays of them and pointers, for all of which zero is a value.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    if interface.len() >= request.ifr_name.len() || interface.bytes().any(|byte| byte == 0) {
        return Err(io::Error::from(io::ErrorKind::InvalidInput));
    }
    for (place, byte) in request.ifr_name.iter_mut().zip(interface.bytes()) {
        // Signed or not, as the architecture has it.
        *place = byte as libc::c_char;
    }
    Ok(request)
}

/// The longest packet that an interface takes, bytes (SIOCGIFMTU on any socket).
///
/// # Errors
/// The kernel's refusal, or a name that cannot be one.
pub fn mtu(socket: BorrowedFd<'_>, interface: &str) -> io::Result<usize> {
    let mut request = request(interface)?;
    // SAFETY: SIOCGIFMTU reads the name and writes `ifru_mtu` of the structure, which outlives the call.
    answered(unsafe { libc::ioctl(socket.as_raw_fd(), libc::SIOCGIFMTU, &raw mut request) })?;
    // SAFETY: the call succeeded, so `ifru_mtu` is the field that was written.
    let mtu = unsafe { request.ifr_ifru.ifru_mtu };
    Ok(usize::try_from(mtu).unwrap_or(0))
}

/// Lets the calling thread run under SCHED_FIFO: before every ordinary program, until it waits.
///
/// # Errors
/// The kernel's refusal: CAP_SYS_NICE or a limit (`ulimit -r`) is needed.
pub fn schedule_fifo(priority: i32) -> io::Result<()> {
    let parameters = libc::sched_param { sched_priority: priority };
    // SAFETY: `parameters` lives until after the call, which copies it; 0 names the calling thread.
    answered(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) })
}

/// Makes a TUN device with the link type of a monitor interface, up, with room for `mtu` bytes. Packets written to the
/// file are received from the device, packets sent to the device are read from the file; each after four bytes of
/// flags and protocol. It lives as long as the file. For tests and measurements without a card.
///
/// # Errors
/// The kernel's refusal: CAP_NET_ADMIN in the network namespace and access to /dev/net/tun are needed.
pub fn radiotap_tun(interface: &str, mtu: usize) -> io::Result<File> {
    let tun = File::options().read(true).write(true).open("/dev/net/tun")?;
    let socket = std::net::UdpSocket::bind("0.0.0.0:0")?;
    let mut create = request(interface)?;
    create.ifr_ifru.ifru_flags = libc::IFF_TUN as libc::c_short;
    // SAFETY: TUNSETIFF reads and writes the structure, which outlives the call.
    answered(unsafe { libc::ioctl(tun.as_raw_fd(), libc::TUNSETIFF, &raw mut create) })?;
    let link_type = libc::c_ulong::from(ARPHRD_IEEE80211_RADIOTAP);
    // SAFETY: TUNSETLINK takes its argument by value.
    answered(unsafe { libc::ioctl(tun.as_raw_fd(), libc::TUNSETLINK, link_type) })?;
    let mut resize = request(interface)?;
    resize.ifr_ifru.ifru_mtu = libc::c_int::try_from(mtu).unwrap_or(libc::c_int::MAX);
    // SAFETY: SIOCSIFMTU reads the structure, which outlives the call.
    answered(unsafe { libc::ioctl(socket.as_raw_fd(), libc::SIOCSIFMTU, &raw mut resize) })?;
    set_up(interface, true)?;
    Ok(tun)
}

/// Takes an interface up or down (SIOCSIFFLAGS, with no other flag set).
///
/// # Errors
/// The kernel's refusal: CAP_NET_ADMIN in the network namespace is needed.
pub fn set_up(interface: &str, up: bool) -> io::Result<()> {
    let socket = std::net::UdpSocket::bind("0.0.0.0:0")?;
    let mut request = request(interface)?;
    request.ifr_ifru.ifru_flags = if up { libc::IFF_UP as libc::c_short } else { 0 };
    // SAFETY: SIOCSIFFLAGS reads the structure, which outlives the call.
    answered(unsafe { libc::ioctl(socket.as_raw_fd(), libc::SIOCSIFFLAGS, &raw mut request) })
}

/// For a short command that computes: the calling thread's heap grows by 8 MiB at a time, is kept until the process ends, and is in
/// large pages (MADV_HUGEPAGE) where the kernel has them. Each page that is new to a process costs it about a microsecond; a
/// bearing of three links touches some 1,400 of 4 KiB. Every thread that allocates much calls it for itself. Only glibc's heap
/// can be told; with another nothing happens.
pub fn keep_heap() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        const STEP: usize = 8 << 20;
        const LARGE_PAGE: usize = 2 << 20;
        let step = STEP as libc::c_int;
        for (what, bytes) in
            [(libc::M_TRIM_THRESHOLD, 8 * step), (libc::M_MMAP_THRESHOLD, 4 * step), (libc::M_TOP_PAD, step)]
        {
            // SAFETY: `mallopt` takes numbers only, and sets how glibc grows and shrinks its heaps.
            unsafe { libc::mallopt(what, bytes) };
        }
        // More than a heap has free at first: this makes it grow.
        let first: Vec<u8> = Vec::with_capacity(LARGE_PAGE / 4);
        let start = first.as_ptr().map_addr(|at| at - at % LARGE_PAGE).cast_mut();
        // SAFETY: MADV_HUGEPAGE changes which pages back the heap, not what is in it; where the range holds other memory of this
        // process, or none, that is as true.
        unsafe { libc::madvise(start.cast::<libc::c_void>(), STEP, libc::MADV_HUGEPAGE) };
    }
}

/// The name of the running program, for commands in messages.
pub(crate) fn program() -> String {
    let own = std::env::current_exe().ok();
    own.and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned())).unwrap_or_else(|| "csi5300".into())
}

#[cfg(test)]
pub(crate) use tests::passes;

#[cfg(test)]
mod tests {
    use super::operation::PACKET_TYPE;
    use super::{Instruction, keep_heap};

    /// Runs a filter as `linux/filter.h` defines it, as far as ours go; a load beyond the end refuses the packet.
    pub(crate) fn passes(program: &[Instruction], packet: &[u8], packet_type: u32) -> bool {
        let (mut at, mut a, mut x) = (0, 0_u32, 0_u32);
        loop {
            let step = program[at];
            at += 1;
            let load = |offset: u32, len: usize| {
                let bytes = packet.get(offset as usize..)?.get(..len)?;
                Some(bytes.iter().fold(0, |sum, byte| sum << 8 | u32::from(*byte)))
            };
            let loaded = match step.code {
                0x20 if step.k == PACKET_TYPE => Some(packet_type),
                0x20 => load(step.k, 4),
                0x30 => load(step.k, 1),
                0x40 => load(x + step.k, 4),
                0x48 => load(x + step.k, 2),
                0x50 => load(x + step.k, 1),
                0x64 => Some(a << step.k),
                0x0c => Some(a + x),
                0x07 => {
                    x = a;
                    Some(a)
                }
                0x15 => {
                    at += usize::from(if a == step.k { step.jt } else { step.jf });
                    Some(a)
                }
                _ => return step.k != 0,
            };
            let Some(loaded) = loaded else { return false };
            a = loaded;
        }
    }

    #[test]
    fn a_heap_that_is_kept_is_written_like_any_other() {
        let sum = || {
            keep_heap();
            let parts: Vec<Vec<u64>> = (0..64).map(|part| (part..part + 20_000).collect()).collect();
            parts.iter().flatten().sum::<u64>()
        };
        let expected = (0..64u64).map(|part| (part..part + 20_000).sum::<u64>()).sum::<u64>();
        assert_eq!((sum(), std::thread::spawn(sum).join().unwrap()), (expected, expected));
    }
}
