//! Readers of single option values.

use std::path::PathBuf;

use ambf_core::adf::PhysicsProfile;
use clap::builder::{PossibleValuesParser, TypedValueParser};

use super::RosVersions;

/// `true yes on 1` or `false no off 0`, in any case.
pub(super) fn boolean(text: &str) -> Result<bool, String> {
    match text.to_ascii_lowercase().as_str() {
        "true" | "yes" | "on" | "1" => Ok(true),
        "false" | "no" | "off" | "0" => Ok(false),
        _ => Err("expected true, yes, on, 1 or false, no, off, 0".to_owned()),
    }
}

/// A profile of the physics, by name.
pub(super) fn profile() -> impl TypedValueParser<Value = PhysicsProfile> {
    let one = |name: String| PhysicsProfile::from_name(&name).expect("one of the possible values");
    PossibleValuesParser::new(PhysicsProfile::NAMES.map(|(name, _)| name)).map(one)
}

/// Versions of ROS, by name.
pub(super) fn ros_versions() -> impl TypedValueParser<Value = RosVersions> {
    let one = |name: String| RosVersions::NAMES.into_iter().find(|(own, _)| *own == name);
    PossibleValuesParser::new(RosVersions::NAMES.map(|(name, _)| name))
        .map(move |name| one(name).expect("one of the possible values").1)
}

/// A finite number above zero.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() && number > 0.0 => Ok(number),
        _ => Err("expected a number above 0".to_owned()),
    }
}

/// A whole number from 1 to 100 000, such as a frequency in Hz.
pub(super) fn count(text: &str) -> Result<u32, String> {
    match text.trim().parse() {
        Ok(number) if (1..=100_000).contains(&number) => Ok(number),
        _ => Err("expected a whole number from 1 to 100000".to_owned()),
    }
}

/// A frequency of devices' loops, Hz: a device sets a force that is not renewed within 50 ms to zero, and the laws know
/// periods of 0.1 to 20 ms.
pub(super) fn haptic_frequency(text: &str) -> Result<u32, String> {
    match text.trim().parse() {
        Ok(number) if (50..=10_000).contains(&number) => Ok(number),
        _ => {
            Err("expected a whole number from 50 to 10000 (forces of a slower loop would end before the next)"
                .to_owned())
        }
    }
}

/// A whole number from 0 on.
pub(super) fn whole(text: &str) -> Result<usize, String> {
    text.trim().parse().map_err(|_| "expected a whole number, 0 or more".to_owned())
}

/// The non-empty parts between commas, without blanks around them.
pub(super) fn parts(text: &str) -> impl Iterator<Item = &str> {
    text.split(',').map(str::trim).filter(|part| !part.is_empty())
}

/// Comma-separated paths.
pub(super) fn paths(text: &str) -> Vec<PathBuf> {
    parts(text).map(PathBuf::from).collect()
}

/// Comma-separated indexes counted from 0, and the parts that are none.
pub(super) fn indexes(text: &str) -> (Vec<usize>, Vec<String>) {
    let mut indexes = Vec::new();
    let mut others = Vec::new();
    let dense: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    for part in parts(&dense) {
        match part.parse() {
            Ok(index) => indexes.push(index),
            Err(_) => others.push(part.to_owned()),
        }
    }
    (indexes, others)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boolean_words_in_any_case() {
        for word in ["true", "Yes", "ON", "1"] {
            assert_eq!(boolean(word), Ok(true), "{word}");
        }
        for word in ["false", "No", "OFF", "0"] {
            assert_eq!(boolean(word), Ok(false), "{word}");
        }
        for word in ["", "2", "tru", "y"] {
            assert!(boolean(word).is_err(), "{word}");
        }
    }

    #[test]
    fn only_finite_numbers_above_zero_are_positive() {
        assert_eq!(positive("0.5"), Ok(0.5));
        for text in ["0", "-1", "nan", "inf", "1e400", "", "1x"] {
            assert!(positive(text).is_err(), "{text}");
        }
    }

    #[test]
    fn counts_are_bounded_whole_numbers() {
        assert_eq!((count("1"), count("100000"), whole("0")), (Ok(1), Ok(100_000), Ok(0)));
        for text in ["0", "-1", "100001", "1.5", "1e3", "", "99999999999"] {
            assert!(count(text).is_err(), "{text}");
        }
        assert!(whole("-1").is_err() && whole("").is_err());
        assert_eq!((haptic_frequency("50"), haptic_frequency(" 10000")), (Ok(50), Ok(10_000)));
        assert!(haptic_frequency("49").is_err() && haptic_frequency("10001").is_err());
    }

    #[test]
    fn blanks_and_empty_parts_of_lists_do_not_count() {
        assert_eq!(indexes(" 1, 6,,10 ,"), (vec![1, 6, 10], vec![]));
        assert_eq!(indexes("1 0"), (vec![10], vec![]));
        assert_eq!(indexes(""), (vec![], vec![]));
        assert_eq!(paths(" a b.yaml , c.yaml,"), [PathBuf::from("a b.yaml"), PathBuf::from("c.yaml")]);
    }

    #[test]
    fn parts_that_are_no_index_are_handed_back() {
        let huge = "99999999999999999999999";
        let (good, bad) = indexes(&format!("x,2,-1,{huge},1.5"));
        assert_eq!(good, [2]);
        assert_eq!(bad, ["x", "-1", huge, "1.5"]);
    }
}
