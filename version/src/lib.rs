//! The version that the programs print: small, so that little is compiled again when only the commit is another one.

#[cfg(test)]
mod commit;

/// Version of the project. Optimised programs that were built in a working tree of git have the commit behind it, and
/// `-dirty` where sources were changed since: `0.1.0 (1a2b3c4)`, `0.1.0 (1a2b3c4-dirty)`.
pub const VERSION: &str = env!("AMBF_VERSION");

#[cfg(test)]
mod tests {
    #[test]
    fn it_begins_with_that_of_the_crate() {
        assert_eq!(super::VERSION.split(' ').next(), Some(env!("CARGO_PKG_VERSION")));
    }
}
