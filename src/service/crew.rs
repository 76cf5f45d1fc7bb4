//! Many independent pieces of work on a few threads, their results in order whatever the number of threads.
//!
//! Goes in: how many pieces, how many threads, what each thread works with, the work. Comes out: one result a piece. Knows nothing of
//! what the work is; the only clock read is that of the progress report.

use super::ServiceError;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

/// Pause between two reports of progress.
const REPORT_PAUSE: Duration = Duration::from_millis(200);

/// Does `count` pieces of work on `jobs` threads called `name`. Every thread makes its own `tools` once. `tell` is shown, on the calling
/// thread and a few times a second, what is finished.
///
/// # Errors
/// [`ServiceError::Internal`] when no thread can be started.
pub(super) fn work_off<Tools, Done: Send>(
    count: usize,
    jobs: usize,
    name: &str,
    tools: impl Fn() -> Tools + Sync,
    work: impl Fn(&mut Tools, usize) -> Done + Sync,
    tell: &mut dyn FnMut(&[Option<Done>]),
) -> Result<Vec<Done>, ServiceError> {
    let next = AtomicUsize::new(0);
    let mut finished: Vec<Option<Done>> = Vec::new();
    finished.resize_with(count, || None);
    std::thread::scope(|scope| {
        let (sender, receiver) = mpsc::channel();
        for worker in 0..jobs.clamp(1, count.max(1)) {
            let (sender, next, tools, work) = (sender.clone(), &next, &tools, &work);
            let take_turns = move || {
                let mut tools = tools();
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    // A receiver that is gone has failed already; there is nobody to work for.
                    if index >= count || sender.send((index, work(&mut tools, index))).is_err() {
                        break;
                    }
                }
            };
            let named = std::thread::Builder::new().name(format!("{name}-{worker}"));
            named
                .spawn_scoped(scope, take_turns)
                .map_err(|error| ServiceError::Internal(format!("no thread: {error}")))?;
        }
        drop(sender);
        loop {
            match receiver.recv_timeout(REPORT_PAUSE) {
                Ok((index, done)) => finished[index] = Some(done),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok::<(), ServiceError>(()),
            }
            tell(&finished);
        }
    })?;
    let done: Vec<Done> = finished.into_iter().flatten().collect();
    if done.len() == count { Ok(done) } else { Err(ServiceError::Internal("a run was lost".to_owned())) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_whatever_the_threads_and_all_are_told() {
        for jobs in [0, 1, 3, 50] {
            let mut most = 0;
            let mut tell = |finished: &[Option<usize>]| most = finished.iter().flatten().count();
            let done = work_off(20, jobs, "test", || 100, |tools, index| *tools + index, &mut tell).expect("threads");
            assert_eq!(done, (100..120).collect::<Vec<_>>());
            assert_eq!(most, 20);
        }
        assert!(work_off(0, 3, "test", || (), |(), index| index, &mut |_| ()).expect("nothing").is_empty());
    }
}
