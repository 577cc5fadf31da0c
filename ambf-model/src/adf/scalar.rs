//! Typing of scalars by target, from their text, with the rules of the reference parser.

/// Spellings of an absent value.
pub(super) fn is_null(text: &str) -> bool {
    matches!(text, "" | "~" | "null" | "Null" | "NULL")
}

/// `y n yes no true false on off`, each in lower case, capitalised or in capitals.
pub(super) fn boolean(text: &str) -> Option<bool> {
    const WORDS: [(&str, bool); 8] = [
        ("true", true),
        ("false", false),
        ("yes", true),
        ("no", false),
        ("y", true),
        ("n", false),
        ("on", true),
        ("off", false),
    ];
    let (_, value) = WORDS.iter().find(|(w, _)| w.eq_ignore_ascii_case(text))?;
    let mut rest = text.chars().skip(1);
    let all_lower = text.chars().all(|c| c.is_ascii_lowercase());
    let all_upper = text.chars().all(|c| c.is_ascii_uppercase());
    let capitalised = rest.all(|c| c.is_ascii_lowercase());
    (all_lower || all_upper || capitalised).then_some(*value)
}

/// Decimal or exponent notation, `.inf`, `.nan`; blanks around it are allowed. May be non-finite only when written so.
pub(super) fn real(text: &str) -> Option<f64> {
    let text = text.trim_matches([' ', '\t']);
    match text {
        ".inf" | ".Inf" | ".INF" | "+.inf" | "+.Inf" | "+.INF" => return Some(f64::INFINITY),
        "-.inf" | "-.Inf" | "-.INF" => return Some(f64::NEG_INFINITY),
        ".nan" | ".NaN" | ".NAN" => return Some(f64::NAN),
        _ => {}
    }
    let plain = |b: u8| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.' | b'e' | b'E');
    if !text.bytes().all(plain) {
        return None; // keeps out `inf`, `nan`, which Rust would take
    }
    text.parse::<f64>().ok().filter(|x| x.is_finite())
}

/// Decimal, `0x` hexadecimal or `0` octal with an optional sign.
pub(super) fn integer(text: &str) -> Option<i64> {
    let text = text.trim_matches([' ', '\t']);
    let (negative, digits) = match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    let hex = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X"));
    let (digits, radix) = match hex {
        Some(rest) => (rest, 16),
        None if digits.len() > 1 && digits.starts_with('0') => (&digits[1..], 8),
        None => (digits, 10),
    };
    if !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None; // a second sign
    }
    let value = i64::from_str_radix(digits, radix).ok()?;
    Some(if negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn booleans_in_three_cases_only() {
        for yes in ["y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"] {
            assert_eq!(boolean(yes), Some(true), "{yes}");
        }
        for no in ["n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"] {
            assert_eq!(boolean(no), Some(false), "{no}");
        }
        for other in ["0", "1", "tRue", "yES", "", "true ", "null", "ÿ"] {
            assert_eq!(boolean(other), None, "{other}");
        }
    }

    #[test]
    fn reals() {
        assert_eq!(real(" 1.5e-3 "), Some(0.0015));
        assert_eq!(real("-.5"), Some(-0.5));
        assert_eq!(real("3."), Some(3.0));
        assert_eq!(real("7"), Some(7.0));
        assert!(real("-0.0").is_some_and(|x| x == 0.0 && x.is_sign_negative()));
        assert_eq!(real("-.inf"), Some(f64::NEG_INFINITY));
        assert!(real(".NaN").is_some_and(f64::is_nan));
        for other in ["1_000", "0x10", "inf", "nan", "", "1,5", "1e999", "e", "1 2"] {
            assert_eq!(real(other), None, "{other}");
        }
    }

    #[test]
    fn integers() {
        assert_eq!(integer("0xCd"), Some(205));
        assert_eq!(integer("-0x10"), Some(-16));
        assert_eq!(integer("010"), Some(8));
        assert_eq!(integer("0"), Some(0));
        assert_eq!(integer("+12"), Some(12));
        for other in ["1.0", "1e3", "08", "", "-", "--1", "0x", "0x-1", "99999999999999999999"] {
            assert_eq!(integer(other), None, "{other}");
        }
    }

    #[test]
    fn nulls() {
        assert!(is_null("") && is_null("~") && is_null("NULL") && !is_null("none"));
    }
}
