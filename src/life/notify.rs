//! What the service manager is told, by the protocol of `sd_notify(3)`: ready, processed (its watchdog), status, ending.
//!
//! In: `NOTIFY_SOCKET`, the only environment variable that is read, since a service manager has no other way; without it all of this
//! does nothing. A message that cannot be sent at once is lost: nothing here waits, and nothing but a status allocates.

use std::ffi::OsStr;
use std::os::unix::net::UnixDatagram;

/// The way to the service manager.
#[derive(Debug, Default)]
pub struct Notifier {
    socket: Option<UnixDatagram>,
}

impl Notifier {
    /// The service manager that started this process, if one did.
    #[must_use]
    pub fn from_environment() -> Self {
        std::env::var_os("NOTIFY_SOCKET").map_or_else(Self::default, |address| Self::to(&address))
    }

    /// A service manager that listens at `address`: a path, or an abstract name after an `@`.
    #[must_use]
    pub fn to(address: &OsStr) -> Self {
        let socket = connect(address);
        if let Err(error) = &socket {
            log::warn!("the service manager at {} is not told anything: {error}", address.display());
        }
        Self { socket: socket.ok() }
    }

    /// The start is over.
    pub fn ready(&self) {
        self.send("READY=1");
    }

    /// Something was processed. Only that may be told, never that time has passed.
    pub fn processed(&self) {
        self.send("WATCHDOG=1");
    }

    /// A line for people.
    pub fn status(&self, text: &str) {
        if self.socket.is_some() {
            self.send(&format!("STATUS={text}"));
        }
    }

    /// The end has begun.
    pub fn stopping(&self) {
        self.send("STOPPING=1");
    }

    fn send(&self, message: &str) {
        if let Some(socket) = &self.socket {
            let _ = socket.send(message.as_bytes());
        }
    }
}

fn connect(address: &OsStr) -> std::io::Result<UnixDatagram> {
    let socket = UnixDatagram::unbound()?;
    socket.set_nonblocking(true)?;
    match address.as_encoded_bytes().strip_prefix(b"@") {
        #[cfg(any(target_os = "linux", target_os = "android"))]
        Some(name) => {
            use std::os::linux::net::SocketAddrExt as _;
            socket.connect_addr(&std::os::unix::net::SocketAddr::from_abstract_name(name)?)?;
        }
        _ => socket.connect(address)?,
    }
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_arrive_by_path_and_by_abstract_name_and_a_full_queue_is_not_waited_for() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("notify");
        let listener = UnixDatagram::bind(&path).unwrap();
        let notifier = Notifier::to(path.as_os_str());
        notifier.ready();
        let mut buffer = [0; 64];
        let length = listener.recv(&mut buffer).unwrap();
        assert_eq!(&buffer[..length], b"READY=1");
        let began = std::time::Instant::now();
        (0..100_000).for_each(|_| notifier.processed());
        assert!(began.elapsed() < std::time::Duration::from_secs(5));

        use std::os::linux::net::SocketAddrExt as _;
        let name = format!("noctule-test-{}", std::process::id());
        let address = std::os::unix::net::SocketAddr::from_abstract_name(&name).unwrap();
        let listener = UnixDatagram::bind_addr(&address).unwrap();
        Notifier::to(OsStr::new(&format!("@{name}"))).status("as it should be");
        let length = listener.recv(&mut buffer).unwrap();
        assert_eq!(&buffer[..length], b"STATUS=as it should be");
    }

    #[test]
    fn without_a_service_manager_nothing_happens() {
        Notifier::default().ready();
        Notifier::to(OsStr::new("/nowhere/at/all")).processed();
    }
}
