//! The text of one element of a file, for those who read keys of their own in it.

use super::common::SourcePos;
use super::report::LoadError;
use super::scalar;
use super::yaml::{Document, Kind, Node, NodeId};

/// Longest text that is written, bytes: with aliases a small file can have an endless one.
const MAX_TEXT: usize = 4 << 20;

/// The value of the root key at `source` as YAML: one line a key, what is below it in braces and brackets, aliases
/// spelled out, comments left out. Without a line, or with no key at its place, the whole file as it is written.
///
/// # Errors
/// Those of [`load`](super::load) that come before any value is looked at; [`LoadError::Unreadable`] for an element
/// whose text is longer than 4 MiB.
pub fn node_text(source: &SourcePos) -> Result<String, LoadError> {
    let bytes = super::read_bytes(&source.file)?;
    let element = super::with_document(&bytes, &source.file, |doc, entries| {
        let at = |&&(key, _): &&(NodeId, NodeId)| {
            let mark = doc.node(key).mark;
            source.line > 0 && (mark.line, mark.column) == (source.line, source.column)
        };
        let Some(&(_, value)) = entries.iter().find(at) else { return Ok(None) };
        let mut text = String::new();
        let mut writer = Writer { doc, text: &mut text };
        writer.block(doc.node(value)).map(|()| Some(text)).ok_or_else(|| LoadError::Unreadable {
            file: source.file.to_path_buf(),
            source: std::io::Error::other(format!("the element in line {} is longer than 4 MiB", source.line)),
        })
    })?;
    match element {
        Some(text) => Ok(text),
        None => Ok(String::from_utf8_lossy(&bytes).into_owned()),
    }
}

struct Writer<'w, 't> {
    doc: &'w Document<'t>,
    text: &'w mut String,
}

impl Writer<'_, '_> {
    /// A node at the root of a text. `None`: it is too long.
    fn block(&mut self, node: &Node<'_>) -> Option<()> {
        if let Kind::Map(entries) = &node.kind {
            for &(key, value) in entries {
                self.flow(self.doc.node(key))?;
                self.text.push_str(": ");
                self.flow(self.doc.node(value))?;
                self.text.push('\n');
            }
            return Some(());
        }
        self.flow(node)?;
        self.text.push('\n');
        Some(())
    }

    fn flow(&mut self, node: &Node<'_>) -> Option<()> {
        match &node.kind {
            Kind::Null => self.text.push('~'),
            Kind::Scalar(text) if is_plain(text) => self.text.push_str(text),
            Kind::Scalar(text) => self.quoted(text),
            Kind::List(items) => {
                self.text.push('[');
                for (i, &item) in items.iter().enumerate() {
                    self.text.push_str(if i > 0 { ", " } else { "" });
                    self.flow(self.doc.node(item))?;
                }
                self.text.push(']');
            }
            Kind::Map(entries) => {
                self.text.push('{');
                for (i, &(key, value)) in entries.iter().enumerate() {
                    self.text.push_str(if i > 0 { ", " } else { "" });
                    self.flow(self.doc.node(key))?;
                    self.text.push_str(": ");
                    self.flow(self.doc.node(value))?;
                }
                self.text.push('}');
            }
        }
        (self.text.len() <= MAX_TEXT).then_some(())
    }

    fn quoted(&mut self, text: &str) {
        self.text.push('"');
        for c in text.chars() {
            match c {
                '"' | '\\' => self.text.extend(['\\', c]),
                '\n' => self.text.push_str("\\n"),
                '\t' => self.text.push_str("\\t"),
                c if c.is_control() => self.text.push_str(&format!("\\U{:08X}", u32::from(c))),
                c => self.text.push(c),
            }
        }
        self.text.push('"');
    }
}

/// Whether a text means itself without quotes, wherever it stands.
fn is_plain(text: &str) -> bool {
    let ordinary = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '.' | '/' | '+' | '-' | ' ' | '(' | ')');
    let first = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '/' | '+' | '.' | '-');
    text.chars().all(ordinary)
        && text.starts_with(first)
        && !text.ends_with(' ')
        && !["- ", "--", "..."].iter().any(|start| text.starts_with(start))
        && text != "-"
        && !scalar::is_null(text)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::Outline;
    use super::*;

    fn text_at(file: &str, line: u32) -> String {
        let path = std::env::temp_dir().join(format!("ambf_node_text_{}_{line}.yaml", std::process::id()));
        std::fs::write(&path, file).unwrap();
        let text = node_text(&SourcePos { file: path.as_path().into(), line, column: 1 }).unwrap();
        std::fs::remove_file(&path).unwrap();
        text
    }

    #[test]
    fn an_element_is_written_with_everything_that_stands_in_it() {
        let file = "defaults: &d {x: 1, y: [a, 'b: c']}\nBODY a: # a comment\n  name: a\n  own keys:\n    - *d\n    - \"two\\nlines\"\n  \
                    none: ~\n  tilde: '~'\nother: 1\n";
        let text = text_at(file, 2);
        assert_eq!(text, "name: a\nown keys: [{x: 1, y: [a, \"b: c\"]}, \"two\\nlines\"]\nnone: ~\ntilde: \"~\"\n");
        let outline = Outline::parse(&text, Path::new("node")).unwrap();
        let keys: Vec<_> = outline.root().get("own keys").unwrap().items().collect();
        assert_eq!(keys[0].get("y").unwrap().items().nth(1).unwrap().text(), Some("b: c"));
        assert_eq!(keys[1].text(), Some("two\nlines"));
        assert_eq!(
            (outline.root().get("none").unwrap().text(), outline.root().get("tilde").unwrap().text()),
            (None, Some("~"))
        );
    }

    #[test]
    fn a_root_is_the_file_itself() {
        let file = "# world\ngravity: {x: 0, y: 0, z: -9.8}\n";
        assert_eq!(text_at(file, 0), file);
        assert_eq!(text_at(file, 7), file, "no key stands there");
    }

    #[test]
    fn what_would_mean_something_else_is_quoted() {
        for text in ["a b", "-5", "1e-3", "/a/b.so", "BODY left (1)", "+x"] {
            assert!(is_plain(text), "{text}");
        }
        for text in ["", "~", "null", " a", "a ", "- a", "---", "a: b", "#a", "[a", "*a", "&a", "a,b", "-", "é", "?"] {
            assert!(!is_plain(text), "{text}");
        }
    }

    #[test]
    fn a_text_without_end_is_refused() {
        let mut file = String::from("a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n");
        for i in 1..9 {
            let items = vec![format!("*a{}", i - 1); 10].join(", ");
            file += &format!("a{i}: &a{i} [{items}]\n");
        }
        let path = std::env::temp_dir().join(format!("ambf_node_text_{}_long.yaml", std::process::id()));
        std::fs::write(&path, file).unwrap();
        let error = node_text(&SourcePos { file: path.as_path().into(), line: 9, column: 1 }).unwrap_err();
        std::fs::remove_file(&path).unwrap();
        assert!(error.to_string().contains("4 MiB"), "{error}");
    }
}
