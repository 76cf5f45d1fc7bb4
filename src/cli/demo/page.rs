//! The live page beside a demo: a child that the demo starts, names the address of, and ends. Whatever happens to it, the demo
//! goes on.

use super::super::args::{DEFAULT_LISTEN, DemoArguments};
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Time that the page gets to end by itself.
const END_LIMIT: Duration = Duration::from_millis(700);

/// The page's process.
pub(super) struct Page {
    child: Child,
    address: Receiver<String>,
}

impl Page {
    /// Starts the page with the demo's configuration; `None`, and a word about it, when it cannot be started.
    pub(super) fn start(program: &Path, arguments: &DemoArguments) -> Option<Self> {
        let started = Self::try_start(program, arguments);
        started.inspect_err(|error| log::warn!("there is no live page: {error}")).ok()
    }

    fn try_start(program: &Path, arguments: &DemoArguments) -> std::io::Result<Self> {
        let mut command = Command::new(program);
        command.args(["--quiet", "view", "--with-parent"]);
        if let Some(path) = &arguments.choice.config {
            command.arg("--config").arg(path);
        }
        // The page holds the other end of its standard input: it ends with the demo, however that ends.
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).env_remove("NOTIFY_SOCKET");
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn()?;
        let (tell, address) = channel();
        if let Some(output) = child.stdout.take() {
            let read = move || {
                let mut line = String::new();
                if BufReader::new(output).read_line(&mut line).is_ok_and(|count| count > 0) {
                    let _ = tell.send(line.trim().to_owned());
                }
            };
            std::thread::Builder::new().name("page address".to_owned()).spawn(read)?;
        }
        Ok(Self { child, address })
    }

    /// Its address, once; with a word when it is not the usual one.
    pub(super) fn address(&self) -> Option<String> {
        let address = self.address.try_recv().ok()?;
        let usual = address.contains(DEFAULT_LISTEN);
        Some(if usual { address } else { format!("{address} ({DEFAULT_LISTEN} is in use)") })
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let begun = Instant::now();
        while begun.elapsed() < END_LIMIT {
            if !matches!(self.child.try_wait(), Ok(None)) {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
