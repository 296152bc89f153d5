//! The threads that a short command computes on.

/// Makes the threads that links are worked on with, this one among them; 0 is one for each core.
///
/// # Errors
/// If they were made before, in words.
pub fn make(count: usize) -> Result<(), String> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(count).use_current_thread();
    let pool = {
        csi5300_live::sys::keep_heap();
        pool.start_handler(|_| csi5300_live::sys::keep_heap())
    };
    pool.build_global().map_err(|error| error.to_string())
}
