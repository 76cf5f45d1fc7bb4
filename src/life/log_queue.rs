//! The log in a thread of its own: a terminal, pipe or journal that is slow or full must never hold up whoever decides for the robot.
//!
//! In: lines as they are written. Out: the same lines on a sink, in order. The queue is bounded; lines that find it full are dropped and
//! counted, and the count is told before the next line.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

/// Lines that may wait.
const QUEUE: usize = 256;

enum Entry {
    Line(Vec<u8>),
    /// Asks for an answer when everything before it is written.
    Flush(SyncSender<()>),
}

/// The writing end, which never waits.
#[derive(Clone)]
pub struct LogQueue {
    queue: SyncSender<Entry>,
    dropped: Arc<AtomicU64>,
}

impl LogQueue {
    /// Starts the thread that writes to `sink`; it ends with the last writing end.
    ///
    /// # Errors
    /// If the system refuses a thread.
    pub fn start(sink: impl Write + Send + 'static) -> io::Result<Self> {
        let (queue, entries) = sync_channel(QUEUE);
        let dropped = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&dropped);
        std::thread::Builder::new().name("log".to_owned()).spawn(move || write_all(&entries, &counted, sink))?;
        Ok(Self { queue, dropped })
    }

    /// Waits until what was written so far is on the sink, at most for `limit`.
    pub fn finish(&self, limit: Duration) {
        let (answer, done) = sync_channel(1);
        if self.queue.try_send(Entry::Flush(answer)).is_ok() {
            let _: Result<(), RecvTimeoutError> = done.recv_timeout(limit);
        }
    }
}

impl Write for LogQueue {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        match self.queue.try_send(Entry::Line(line.to_vec())) {
            Ok(()) => {}
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A sink that fails is written to again with the next line: there is nobody else to tell.
fn write_all(entries: &Receiver<Entry>, dropped: &AtomicU64, mut sink: impl Write) {
    for entry in entries {
        let count = dropped.swap(0, Ordering::Relaxed);
        if count > 0 {
            let _ = writeln!(sink, "({count} lines of the log were dropped: whoever reads it is too slow)");
        }
        match entry {
            Entry::Line(line) => {
                let _ = sink.write_all(&line);
                let _ = sink.flush();
            }
            Entry::Flush(answer) => {
                let _ = answer.try_send(());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use std::time::Instant;

    /// Blocks until it is let go, then keeps what is written.
    struct Gate {
        open: Receiver<()>,
        waits: bool,
        written: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Gate {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if std::mem::take(&mut self.waits) {
                let _ = self.open.recv();
            }
            self.written.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_sink_that_blocks_holds_nobody_up_and_what_was_dropped_is_told() {
        let (let_go, open) = sync_channel(1);
        let written = Arc::new(Mutex::new(Vec::new()));
        let mut queue = LogQueue::start(Gate { open, waits: true, written: Arc::clone(&written) }).unwrap();
        let start = Instant::now();
        for line in 0..10_000 {
            queue.write_all(format!("line {line}\n").as_bytes()).unwrap();
        }
        queue.finish(Duration::from_millis(10));
        assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
        assert!(written.lock().unwrap().is_empty(), "the sink still blocks");
        let_go.send(()).unwrap();
        // The queue drains, then takes lines again.
        let deadline = Instant::now() + Duration::from_secs(10);
        while queue.queue.try_send(Entry::Line(b"last\n".to_vec())).is_err() {
            assert!(Instant::now() < deadline, "the queue never drained");
            std::thread::sleep(Duration::from_millis(1));
        }
        queue.finish(Duration::from_secs(10));
        let text = String::from_utf8(written.lock().unwrap().clone()).unwrap();
        // How many are dropped, and between which lines that is told, hangs on when the threads ran.
        let (told, lines): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| line.contains("were dropped"));
        assert!(lines.starts_with(&["line 0", "line 1"]) && lines.last() == Some(&"last"), "{text}");
        assert!(!told.is_empty(), "{text}");
    }

    /// Panics when it is written to.
    struct Trap;

    impl Write for Trap {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            panic!("planted");
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_panic_of_the_log_ends_the_process_with_70() {
        const CHILD: &str = "NOCTULE_TEST_LOG_CHILD";
        if std::env::var_os(CHILD).is_some() {
            crate::life::panic::end_on_panic(&Arc::default());
            let mut queue = LogQueue::start(Trap).unwrap();
            queue.write_all(b"line\n").unwrap();
            std::thread::sleep(Duration::from_secs(10));
            std::process::exit(0);
        }
        let program = std::env::current_exe().unwrap();
        let test = "life::log_queue::tests::a_panic_of_the_log_ends_the_process_with_70";
        let began = Instant::now();
        let output =
            std::process::Command::new(program).args(["--exact", test, "--nocapture"]).env(CHILD, "1").output();
        let output = output.unwrap();
        assert_eq!(output.status.code(), Some(70));
        assert!(began.elapsed() < Duration::from_secs(5));
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(told.contains("thread log") && told.contains("planted"), "{told}");
    }
}
