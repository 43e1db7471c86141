//! Independent jobs on every core.

use std::sync::Mutex;
use std::thread;

/// `work` of each job on every core, in the order of the jobs.
pub fn each<J: Send, T: Send>(jobs: impl IntoIterator<Item = J>, work: impl Fn(J) -> T + Sync) -> Vec<T> {
    on(thread::available_parallelism().map_or(1, usize::from), jobs, work)
}

/// The same on so many threads.
pub fn on<J: Send, T: Send>(
    threads: usize,
    jobs: impl IntoIterator<Item = J>,
    work: impl Fn(J) -> T + Sync,
) -> Vec<T> {
    let jobs = Mutex::new(jobs.into_iter().collect::<Vec<J>>().into_iter().enumerate());
    let done = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let next = jobs.lock().expect("no job panics holding the list").next();
                    let Some((at, job)) = next else { break };
                    let result = work(job);
                    done.lock().expect("no job panics holding the results").push((at, result));
                }
            });
        }
    });
    let mut done = done.into_inner().expect("no job panics holding the results");
    done.sort_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}
