//! Subscribers that use another version of a message: rosrust refuses them and says so only in the `log` facade.

use std::collections::BTreeMap;

use log::{Level, LevelFilter, Log, Metadata, Record};
use parking_lot::Mutex;

use super::signal::RateLimitedLog;

/// Reports from now on which topic a client could not connect to, because type or checksum differ. Does nothing when
/// the program has a logger of its own, which then gets those lines.
pub(super) fn report_mismatches() {
    if log::set_boxed_logger(Box::<MismatchLogger>::default()).is_ok() {
        log::set_max_level(LevelFilter::Error);
    }
}

/// How many different lines are told apart.
const MAX_LINES: usize = 256;

/// Repeats a line at most once a second, without holding up others.
#[derive(Default)]
struct MismatchLogger(Mutex<BTreeMap<String, RateLimitedLog>>);

impl MismatchLogger {
    fn report(&self, line: String) {
        let mut lines = self.0.lock();
        if lines.len() >= MAX_LINES {
            lines.clear();
        }
        lines.entry(line.clone()).or_default().report(line);
    }
}

impl Log for MismatchLogger {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.level() == Level::Error && metadata.target().starts_with("rosrust::tcpros")
    }

    fn log(&self, record: &Record<'_>) {
        // All other lines are about clients that come and go.
        if self.enabled(record.metadata()) {
            if let Some(line) = mismatch(&record.args().to_string()) {
                self.report(line);
            }
        }
    }

    fn flush(&self) {}
}

/// A line for the user if `text` is about a mismatch.
fn mismatch(text: &str) -> Option<String> {
    text.contains("mismatched").then(|| {
        let lines: Vec<&str> = text.lines().map(|line| line.trim_start_matches("Caused by:").trim()).collect();
        format!("{} (a client with another version of the message; is it built with our ambf_msgs?)", lines.join(": "))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_mismatches_are_for_the_user() {
        let text = "Failed to connect to topic '/a'\nCaused by:Data field 'md5sum' within header mismatched. Expected: 'x' Actual: 'y'";
        let line = mismatch(text).unwrap();
        assert!(line.starts_with("Failed to connect to topic '/a': Data field 'md5sum'"), "{line}");
        assert!(!line.contains('\n'));
        assert_eq!(mismatch("TCP connection failed at topic '/a': try again"), None);
    }
}
