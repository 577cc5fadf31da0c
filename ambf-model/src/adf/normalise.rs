//! Makes text that only a lenient YAML parser accepts acceptable to a strict one.
//!
//! The reference parser does not look at the indentation of flow collections, so existing files start or continue them
//! left of the block they belong to. Here such lines are indented; nothing else changes, and lines keep their number.

/// Blanks that are added at most, in multiples of the text's length.
const MAX_GROWTH: usize = 8;

/// A text with some lines indented.
#[derive(Debug)]
pub(super) struct Normalised {
    pub text: String,
    /// Line number and added columns, by line.
    shifted: Vec<(u32, u32)>,
}

impl Normalised {
    /// Columns that were added in front of a line (counted from 1).
    pub(super) fn added(&self, line: u32) -> u32 {
        match self.shifted.binary_search_by_key(&line, |&(l, _)| l) {
            Ok(i) => self.shifted[i].1,
            Err(_) => 0,
        }
    }
}

/// Indents the lines of flow collections that lie too far left; `None` when there are none, or when the text would grow
/// beyond reason: a few far indented keys would be enough.
pub(super) fn normalise(text: &str) -> Option<Normalised> {
    let mut scan = Scan::default();
    let mut out = String::with_capacity(text.len() + 64);
    let mut shifted = Vec::new();
    let mut room = MAX_GROWTH * text.len();
    for (number, line) in (1u32..).zip(text.split_inclusive('\n')) {
        let missing = scan.missing_columns(line);
        if missing > 0 {
            room = room.checked_sub(missing as usize)?;
            shifted.push((number, missing));
            out.extend(std::iter::repeat_n(' ', missing as usize));
        }
        out.push_str(line);
        scan.read(line);
    }
    (!shifted.is_empty()).then_some(Normalised { text: out, shifted })
}

#[derive(Default)]
struct Scan {
    /// Open flow collections.
    depth: usize,
    /// Quote that is open at the end of the line.
    quote: Option<char>,
    /// Column of the block key that the open flow collection belongs to.
    base: usize,
    /// The line ends with a block key that still waits for its value.
    waits: bool,
    /// Inside a block scalar whose key has this column.
    block_scalar: Option<usize>,
}

fn indent(line: &str) -> usize {
    line.len() - line.trim_start_matches(' ').len()
}

impl Scan {
    fn missing_columns(&self, line: &str) -> u32 {
        let content = line.trim();
        if content.is_empty() || self.in_block_scalar(line) {
            return 0;
        }
        let continues = self.depth > 0 || self.quote.is_some();
        let starts = self.waits && content.starts_with(['{', '[']);
        if continues || starts {
            let missing = (self.base + 1).saturating_sub(indent(line));
            u32::try_from(missing).unwrap_or(0)
        } else {
            0
        }
    }

    fn in_block_scalar(&self, line: &str) -> bool {
        self.block_scalar.is_some_and(|column| line.trim().is_empty() || indent(line) > column)
    }

    /// Follows quotes, brackets and comments of one line.
    fn read(&mut self, line: &str) {
        let content = line.trim();
        if self.in_block_scalar(line) {
            return;
        }
        self.block_scalar = None;
        let in_flow = self.depth > 0 || self.quote.is_some();
        if !in_flow && (content.is_empty() || content.starts_with('#')) {
            return;
        }
        let starts = self.waits && content.starts_with(['{', '[']);
        if !in_flow && !starts {
            let key = line.trim_start_matches([' ', '-']);
            self.base = line.len() - key.len();
        }
        let mut token_start = self.quote.is_none();
        let mut blank_before = true;
        let mut significant = String::new();
        let mut chars = line.trim_end().chars().peekable();
        while let Some(c) = chars.next() {
            if let Some(quote) = self.quote {
                match c {
                    '\\' if quote == '"' => {
                        chars.next();
                    }
                    '\'' if quote == '\'' && chars.peek() == Some(&'\'') => {
                        chars.next();
                    }
                    _ if c == quote => self.quote = None,
                    _ => {}
                }
                continue;
            }
            match c {
                '#' if blank_before => break,
                '"' | '\'' if token_start => self.quote = Some(c),
                '{' | '[' if token_start || self.depth > 0 => self.depth += 1,
                '}' | ']' => self.depth = self.depth.saturating_sub(1),
                _ => {}
            }
            blank_before = c == ' ' || c == '\t';
            if !blank_before {
                token_start = matches!(c, ':' | ',' | '{' | '[' | '-' | '?');
            }
            significant.push(c);
        }
        let significant = significant.trim_end();
        let value = significant.rsplit(": ").next().unwrap_or(significant);
        let last = value.split(' ').rfind(|w| !w.starts_with(['&', '!']));
        self.waits = self.depth == 0 && self.quote.is_none() && (significant.ends_with(':') || last.is_none());
        if self.depth == 0 && value.starts_with(['|', '>']) {
            self.block_scalar = Some(self.base);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::yaml::Document;
    use super::*;

    fn accepted(text: &str) -> Normalised {
        assert!(Document::parse(text, None).is_err(), "needs no normalising: {text}");
        let normalised = normalise(text).expect("something to indent");
        Document::parse(text, Some(&normalised)).expect("accepted");
        normalised
    }

    #[test]
    fn flow_mapping_in_column_0_after_a_key() {
        let n = accepted("s: &x\n{\n  a: 1,\n  b: 2\n}\nc: *x\n");
        assert_eq!((n.added(1), n.added(2), n.added(3)), (0, 1, 0));
        assert_eq!(n.text, "s: &x\n {\n  a: 1,\n  b: 2\n }\nc: *x\n");
    }

    #[test]
    fn flow_collections_that_fall_left_of_their_block() {
        accepted("- k: v\n  s: [1,\n2, 3\n]\n- 4\n");
        accepted("a:\n  b: {x: 'it''s }',\n y: \"\\\"}\" # }\n}\nc: 1\n");
        accepted("a:\n  b:\n[1, 2]\n");
    }

    #[test]
    fn nothing_else_is_touched() {
        for text in [
            "a: 1\nb: [1,\n  2]\n",
            "a: it's {\nb: 2\n",
            "a: |\n  {\n  x: [\n\n  y\nb: 1\n",
            "# {\na: 'x' # [\nb: 1\n",
            "a:\n- 1\n- 2\n",
        ] {
            assert!(normalise(text).is_none(), "{text}");
        }
    }

    #[test]
    fn positions_stay_those_of_the_original() {
        let text = "s:\n{\na: 1\n}\n";
        let normalised = normalise(text).unwrap();
        let doc = Document::parse(text, Some(&normalised)).unwrap();
        let super::super::yaml::Kind::Map(root) = &doc.root().kind else { panic!() };
        let value = doc.node(root[0].1);
        assert_eq!((value.mark.line, value.mark.column), (2, 1));
        let super::super::yaml::Kind::Map(inner) = &value.kind else { panic!() };
        let one = doc.node(inner[0].1);
        assert_eq!((one.mark.line, one.mark.column), (3, 4));
    }
}
