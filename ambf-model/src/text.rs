//! Texts as they may leave a program: what files, messages and command lines hold is no part of the terminal's language.

use std::borrow::Cow;

/// Most digits that a number is shown with, those of a checksum; longer ones are those of 1e300 written out.
const MAX_DIGITS: usize = 40;

/// `text` as one line: characters that cannot be printed are escaped (`\n`, `\u{1b}`), and numbers of more than 40 digits
/// are rounded to those that tell them from others (`1e300`). Tabs stay.
pub fn one_line(text: &str) -> Cow<'_, str> {
    printable(text, |c| c == '\t')
}

/// The same for a text of several lines.
pub fn lines(text: &str) -> Cow<'_, str> {
    printable(text, |c| c == '\t' || c == '\n')
}

/// What a list of `count` entries has, for a message about an index: `is empty`, `has 3 (0 to 2)`.
pub fn has_entries(count: usize) -> String {
    match count {
        0 => "is empty".to_owned(),
        1 => "has 1 (0)".to_owned(),
        _ => format!("has {count} (0 to {})", count - 1),
    }
}

fn printable(text: &str, is_kept: impl Fn(char) -> bool) -> Cow<'_, str> {
    let is_fine = |c: char| c == ' ' || c.is_ascii_graphic() || is_kept(c);
    let has_long =
        text.len() > MAX_DIGITS && text.split(|c: char| !c.is_ascii_digit()).any(|run| run.len() > MAX_DIGITS);
    if !has_long && text.chars().all(is_fine) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        if c.is_ascii_digit() {
            let (number, after) = split_number(rest);
            match number.bytes().filter(u8::is_ascii_digit).count() {
                digits if digits > MAX_DIGITS => out += &shortened(number, digits),
                _ => out += number,
            }
            rest = after;
            continue;
        }
        if is_fine(c) || !is_unprintable(c) {
            out.push(c);
        } else {
            out.extend(c.escape_debug());
        }
        rest = &rest[c.len_utf8()..];
    }
    Cow::Owned(out)
}

/// Digits at the beginning, with those behind a decimal point, and the rest.
fn split_number(text: &str) -> (&str, &str) {
    let digits = |text: &str| text.bytes().take_while(u8::is_ascii_digit).count();
    let whole = digits(text);
    let fraction = text[whole..].strip_prefix('.').map_or(0, digits);
    text.split_at(if fraction > 0 { whole + 1 + fraction } else { whole })
}

fn shortened(number: &str, digits: usize) -> String {
    match number.parse::<f64>() {
        Ok(value) if value.is_finite() => format!("{value:e}"),
        _ => format!("{}… ({digits} digits)", &number[..MAX_DIGITS / 2]),
    }
}

/// Control characters, marks of direction, blanks that are none; not accents on the letter before.
fn is_unprintable(c: char) -> bool {
    // After a letter, accents are not escaped.
    let mut pair = [0; 5];
    pair[0] = b'a';
    let length = c.encode_utf8(&mut pair[1..]).len();
    let pair = std::str::from_utf8(&pair[..=length]).unwrap_or("a");
    !matches!(c, '\'' | '"' | '\\') && pair.escape_debug().count() > 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_would_obey_is_escaped() {
        for plain in
            ["", "BODY a: \"x\" `y` \\ 100 %", "é 😀 日本 e\u{301}", "a\tb", "1.25e-3, 0x7f, 12345678901234567890"]
        {
            assert!(matches!(one_line(plain), Cow::Borrowed(_)) || one_line(plain) == plain, "{plain}");
        }
        assert_eq!(one_line("\u{1b}[2Jx\n\r\u{202e}\0\u{85}\u{7f}"), "\\u{1b}[2Jx\\n\\r\\u{202e}\\0\\u{85}\\u{7f}");
        assert_eq!(lines("a\nb\u{7}"), "a\nb\\u{7}");
    }

    #[test]
    fn a_list_without_entries_is_empty_and_not_0_to_minus_1() {
        assert_eq!([0, 1, 3].map(has_entries), ["is empty", "has 1 (0)", "has 3 (0 to 2)"]);
    }

    #[test]
    fn numbers_have_a_bounded_form() {
        assert_eq!(one_line(&format!("mass {} kg", 1e300)), "mass 1e300 kg");
        assert_eq!(one_line(&format!("({}, {:?}, {})", -1e308, 2.5, 1e-300)), "(-1e308, 2.5, 1e-300)");
        let long = "7".repeat(500);
        assert_eq!(one_line(&long), format!("{}… (500 digits)", "7".repeat(20)));
        for hash in ["0123456789abcdef0123456789abcdef0123456789", "00000000000000000000000000000000"] {
            assert_eq!(one_line(hash), hash);
        }
    }
}
