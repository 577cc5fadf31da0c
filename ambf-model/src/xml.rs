//! What of XML would keep `roxmltree` busy for minutes or exhaust the memory, found before it is parsed.

mod element;

pub(crate) use element::{quoted, Element, File, Id};

/// Most elements and texts of a file: a robot of 10 000 links has some 400 000.
pub(crate) const MAX_NODES: u32 = 2_000_000;

/// Most attributes of a file.
const MAX_ATTRIBUTES: usize = 4_000_000;

/// Most declarations of namespaces: the parser copies those of the outer element into each element that has one.
const MAX_NAMESPACES: usize = 256;

/// What there is too much of in `text`, and the byte where it was seen. `max_quotes` is the most quotes in one tag and
/// the text behind it: the parser compares each attribute of a tag with all before it.
pub(crate) fn find_excess(text: &str, max_quotes: usize) -> Option<(usize, &'static str)> {
    let attributes = text.bytes().filter(|b| *b == b'=').count();
    let tags = text.bytes().filter(|b| *b == b'<').count();
    if attributes > MAX_ATTRIBUTES || tags > MAX_NODES as usize {
        return Some((0, "too many elements or attributes"));
    }
    if let Some((byte, _)) = text.match_indices("xmlns").nth(MAX_NAMESPACES) {
        return Some((byte, "too many declarations of namespaces"));
    }
    let mut byte = 0;
    for tag in text.split('<') {
        // A tag holds no `<`, so that what follows it is counted with it: text, which has few quotes.
        if tag.bytes().filter(|b| matches!(b, b'"' | b'\'')).count() > max_quotes {
            return Some((byte.max(1) - 1, "too many attributes in one tag"));
        }
        byte += tag.len() + 1;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn excess_is_found_where_it_is() {
        assert_eq!(find_excess("<a b=\"1\">it's</a>", 8), None);
        let (at, what) = find_excess(&format!("<a>\n<b {}/></a>", "c=\"1\" ".repeat(5)), 8).unwrap();
        assert_eq!((at, what), (4, "too many attributes in one tag"));
        let (at, what) = find_excess(&"<a xmlns:b=\"c\">".repeat(300), 8).unwrap();
        assert_eq!((at, what), (256 * 15 + 3, "too many declarations of namespaces"));
        assert!(find_excess(&"<a/>".repeat(2_000_001), 8).is_some());
    }
}
