//! The calls for which no crate has a safe form. All `unsafe` of the project is in this file.
#![allow(unsafe_code)]

use super::netlink::Netlink;
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// One instruction of a classic socket filter (`struct sock_filter`, `linux/filter.h`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instruction {
    /// Operation, `BPF_*`.
    pub code: u16,
    /// Instructions to skip if true.
    pub if_true: u8,
    /// Instructions to skip if false.
    pub if_false: u8,
    /// Operand.
    pub k: u32,
}

/// Attaches a classic filter to a socket (SO_ATTACH_FILTER); it replaces an earlier one.
///
/// # Errors
/// The kernel's refusal, when the program is malformed or longer than it allows.
pub fn attach_filter(socket: BorrowedFd<'_>, program: &[Instruction]) -> io::Result<()> {
    let mut filter: Vec<libc::sock_filter> = program
        .iter()
        .map(|step| libc::sock_filter { code: step.code, jt: step.if_true, jf: step.if_false, k: step.k })
        .collect();
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
    if answer == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Registers a listener with tokio's reactor, for reading and for errors (an overrun is one).
///
/// # Errors
/// The reactor's refusal.
pub fn watch(listener: Netlink) -> io::Result<AsyncFd<Netlink>> {
    let interest = Interest::READABLE | Interest::ERROR;
    // SAFETY: a listener owns its socket from `open` to its drop and never exchanges it, so `as_raw_fd` gives the same
    // open descriptor for as long as the `AsyncFd`, which owns the listener, is registered.
    unsafe { AsyncFd::register_with_interest(listener, interest) }.map_err(|error| error.into_parts().1)
}

/// Registers a descriptor with tokio's reactor, for reading and for errors.
///
/// # Errors
/// The reactor's refusal.
#[cfg(feature = "node")]
pub fn watch_fd(fd: std::os::fd::OwnedFd) -> io::Result<AsyncFd<std::os::fd::OwnedFd>> {
    let interest = Interest::READABLE | Interest::ERROR;
    // SAFETY: an `OwnedFd` is the same open descriptor from its making to its drop, and the `AsyncFd` owns it.
    unsafe { AsyncFd::register_with_interest(fd, interest) }.map_err(|error| error.into_parts().1)
}
