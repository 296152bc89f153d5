//! Worker threads: one pool per process, because threads do not survive a fork.

use crate::error::{Failure, Kind};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::{Arc, Mutex, PoisonError};

/// The pool, and the process that created it.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// The pool of this process: one thread per core, or RAYON_NUM_THREADS.
///
/// # Errors
/// If threads cannot start.
pub fn pool() -> Result<Arc<ThreadPool>, Failure> {
    let mut place = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let own = std::process::id();
    if let Some((process, pool)) = &*place
        && *process == own
    {
        return Ok(Arc::clone(pool));
    }
    let pool = Arc::new(build(0)?);
    // A parent's pool has no threads here: dropping it would wait for them.
    std::mem::forget(place.replace((own, Arc::clone(&pool))));
    Ok(pool)
}

/// A separate pool; 0 threads means one per core.
///
/// # Errors
/// If threads cannot start.
pub fn build(threads: usize) -> Result<ThreadPool, Failure> {
    let pool = ThreadPoolBuilder::new().num_threads(threads.min(1024)).thread_name(|n| format!("csi5300-{n}")).build();
    pool.map_err(|error| Failure::new(Kind::Internal, format!("cannot start threads: {error}")))
}
