use std::panic::{catch_unwind, AssertUnwindSafe};

/// Runs code of others, such as a driver or a plugin. Nothing unwinds out of it.
///
/// # Errors
/// What it panicked with. What it was changing may be half changed.
pub fn caught<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
        let text = text.unwrap_or("without a word").to_owned();
        // Dropping it could panic again.
        std::mem::forget(panic);
        text
    })
}
