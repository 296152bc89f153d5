//! A listener as csitool's log_to_file is one: its bind, its membership, its way to write a message down.

use netlink_sys::{Socket, SocketAddr, protocols::NETLINK_CONNECTOR};

/// Listens and gives the code and body of each message.
pub struct LogToFile(Socket);

impl LogToFile {
    pub fn open() -> Self {
        let mut socket = Socket::new(NETLINK_CONNECTOR).unwrap();
        // The index as a bit mask: a mistake of the original, which joins other groups too.
        socket.bind(&SocketAddr::new(std::process::id(), 26)).unwrap();
        socket.add_membership(26).unwrap();
        socket.set_non_blocking(true).unwrap();
        Self(socket)
    }

    /// The next message, if there is one. An overrun is a failure, as there.
    pub fn receive(&self) -> Option<Vec<u8>> {
        let mut buffer = Vec::with_capacity(4_096);
        match self.0.recv(&mut buffer, 0) {
            Ok(_) => {}
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => return None,
            Err(error) => panic!("recv: {error}"),
        }
        // nlmsghdr, then cn_msg with its length at 16; the data at 20.
        let message = &buffer[16..];
        let len = usize::from(u16::from_le_bytes([message[16], message[17]]));
        Some(message[20..20 + len].to_vec())
    }
}
