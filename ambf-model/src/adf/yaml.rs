//! YAML text to a tree of nodes with positions. Typing is left to the reader.

use std::borrow::Cow;

use saphyr_parser::{Event, Parser, ScalarStyle, ScanError};

use super::normalise::Normalised;
use super::scalar;

/// Deepest nesting that is read; scenes need about ten.
const MAX_DEPTH: usize = 200;

/// A place in a text: line and column, both counted from 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Mark {
    pub line: u32,
    pub column: u32,
}

/// Names a node of a [`Document`].
pub(super) type NodeId = u32;

/// A value with its place. An alias is the same node as its anchor.
#[derive(Debug)]
pub(super) struct Node<'t> {
    pub mark: Mark,
    /// Something may refer to the node by an alias.
    pub anchored: bool,
    pub kind: Kind<'t>,
}

/// Content of a node.
#[derive(Debug)]
pub(super) enum Kind<'t> {
    Null,
    Scalar(Cow<'t, str>),
    List(Vec<NodeId>),
    /// Keys and values in file order, duplicates included.
    Map(Vec<(NodeId, NodeId)>),
}

/// The first document of a text.
#[derive(Debug)]
pub(super) struct Document<'t> {
    nodes: Vec<Node<'t>>,
    root: NodeId,
    /// Where a second document starts.
    pub second: Option<Mark>,
}

/// Why a text is no YAML.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct SyntaxError {
    pub mark: Mark,
    pub message: String,
}

impl<'t> Document<'t> {
    /// Parses `text`, or `normalised` in place of it; positions are those of the text before it was normalised.
    pub(super) fn parse(text: &'t str, normalised: Option<&'t Normalised>) -> Result<Self, SyntaxError> {
        Builder { nodes: Vec::new(), anchors: Vec::new(), open: Vec::new(), normalised }
            .run(normalised.map_or(text, |n| &n.text))
    }

    pub(super) fn root(&self) -> &Node<'t> {
        self.node(self.root)
    }

    pub(super) fn root_id(&self) -> NodeId {
        self.root
    }

    pub(super) fn node(&self, id: NodeId) -> &Node<'t> {
        &self.nodes[id as usize]
    }

    /// Number of nodes, aliases not counted.
    pub(super) fn len(&self) -> usize {
        self.nodes.len()
    }
}

/// A collection whose end has not been seen.
struct Open {
    id: NodeId,
    anchor: usize,
    pending_key: Option<NodeId>,
}

struct Builder<'t> {
    nodes: Vec<Node<'t>>,
    /// Node of each finished anchor; the parser numbers anchors from 1.
    anchors: Vec<Option<NodeId>>,
    open: Vec<Open>,
    normalised: Option<&'t Normalised>,
}

impl<'t> Builder<'t> {
    fn run(mut self, text: &'t str) -> Result<Document<'t>, SyntaxError> {
        let mut parser = Parser::new_from_str(text);
        let mut root = None;
        while let Some(event) = parser.next_event() {
            let (event, span) = event.map_err(|e| self.scan_error(&e))?;
            let mark = self.mark(&span.start);
            let finished = match event {
                Event::Scalar(text, style, anchor, _) => {
                    let kind = if style == ScalarStyle::Plain && scalar::is_null(&text) {
                        Kind::Null
                    } else {
                        Kind::Scalar(text)
                    };
                    let id = self.add(mark, anchor, kind)?;
                    self.finish(id, anchor);
                    Some(id)
                }
                Event::SequenceStart(anchor, _) => {
                    self.start(mark, anchor, Kind::List(Vec::new()))?;
                    None
                }
                Event::MappingStart(anchor, _) => {
                    self.start(mark, anchor, Kind::Map(Vec::new()))?;
                    None
                }
                Event::SequenceEnd | Event::MappingEnd => self.open.pop().map(|open| {
                    self.finish(open.id, open.anchor);
                    open.id
                }),
                Event::Alias(anchor) => match self.anchors.get(anchor).copied().flatten() {
                    Some(id) => Some(id),
                    None => {
                        let message = "an alias refers to the collection that contains it";
                        return Err(SyntaxError { mark, message: message.into() });
                    }
                },
                Event::DocumentEnd => break,
                _ => None,
            };
            if let Some(id) = finished {
                match self.open.last_mut() {
                    Some(open) => attach(&mut self.nodes, open, id),
                    None => root = Some(id),
                }
            }
        }
        let second = match parser.next_event() {
            Some(Ok((Event::DocumentStart(_), span))) => Some(self.mark(&span.start)),
            Some(Err(e)) => Some(self.mark(e.marker())),
            _ => None,
        };
        let root = match root {
            Some(id) => id,
            None => self.add(Mark::default(), 0, Kind::Null)?,
        };
        Ok(Document { nodes: self.nodes, root, second })
    }

    fn add(&mut self, mark: Mark, anchor: usize, kind: Kind<'t>) -> Result<NodeId, SyntaxError> {
        let id = NodeId::try_from(self.nodes.len())
            .map_err(|_| SyntaxError { mark, message: "the file holds too many values".into() })?;
        self.nodes.push(Node { mark, anchored: anchor != 0, kind });
        Ok(id)
    }

    fn start(&mut self, mark: Mark, anchor: usize, kind: Kind<'t>) -> Result<(), SyntaxError> {
        if self.open.len() >= MAX_DEPTH {
            return Err(SyntaxError { mark, message: format!("nested deeper than {MAX_DEPTH} levels") });
        }
        let id = self.add(mark, anchor, kind)?;
        self.open.push(Open { id, anchor, pending_key: None });
        Ok(())
    }

    fn finish(&mut self, id: NodeId, anchor: usize) {
        if anchor != 0 {
            if self.anchors.len() <= anchor {
                self.anchors.resize(anchor + 1, None);
            }
            self.anchors[anchor] = Some(id);
        }
    }

    fn mark(&self, marker: &saphyr_parser::Marker) -> Mark {
        let line = u32::try_from(marker.line()).unwrap_or(u32::MAX);
        let column = u32::try_from(marker.col()).unwrap_or(u32::MAX);
        let added = self.normalised.map_or(0, |n| n.added(line));
        Mark { line, column: column.saturating_sub(added).saturating_add(1) }
    }

    fn scan_error(&self, error: &ScanError) -> SyntaxError {
        SyntaxError { mark: self.mark(error.marker()), message: error.info().to_owned() }
    }
}

fn attach(nodes: &mut [Node<'_>], open: &mut Open, id: NodeId) {
    match &mut nodes[open.id as usize].kind {
        Kind::List(items) => items.push(id),
        Kind::Map(entries) => match open.pending_key.take() {
            Some(key) => entries.push((key, id)),
            None => open.pending_key = Some(id),
        },
        Kind::Null | Kind::Scalar(_) => {} // only collections are opened
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Document<'_>, SyntaxError> {
        Document::parse(text, None)
    }

    #[test]
    fn positions_text_and_nulls() {
        let doc = parse("a: 010\n\"b\" : ['', ~, null]\nc:\n").unwrap();
        let Kind::Map(root) = &doc.root().kind else { panic!() };
        assert_eq!(root.len(), 3);
        let value = doc.node(root[0].1);
        assert!(matches!(&value.kind, Kind::Scalar(t) if t == "010"));
        assert_eq!(value.mark, Mark { line: 1, column: 4 });
        let Kind::List(items) = &doc.node(root[1].1).kind else { panic!() };
        assert!(matches!(&doc.node(items[0]).kind, Kind::Scalar(t) if t.is_empty()));
        assert!(matches!(doc.node(items[1]).kind, Kind::Null));
        assert!(matches!(doc.node(items[2]).kind, Kind::Null));
        assert!(matches!(doc.node(root[2].1).kind, Kind::Null));
        assert_eq!(doc.node(root[2].1).mark, Mark { line: 3, column: 2 });
        assert_eq!(doc.node(root[2].0).mark.line, 3);
    }

    #[test]
    fn an_alias_is_the_node_of_its_anchor() {
        let doc = parse("a: &x {k: 1}\nb: *x\nc: &x 2\nd: *x\n").unwrap();
        let Kind::Map(root) = &doc.root().kind else { panic!() };
        assert_eq!(root[0].1, root[1].1);
        assert_eq!(root[2].1, root[3].1);
        assert!(doc.node(root[0].1).anchored);
    }

    #[test]
    fn aliases_that_contain_themselves_are_refused() {
        let error = parse("a: &x [1, *x]\n").unwrap_err();
        assert!(error.message.contains("contains it"), "{error:?}");
        assert_eq!(error.mark.line, 1);
    }

    #[test]
    fn ten_thousand_levels_are_refused_at_once() {
        let flow = "[".repeat(10_000);
        assert!(parse(&flow).is_err());
        let mut block = String::new();
        for level in 0..10_000 {
            block.extend(std::iter::repeat_n(' ', level));
            block.push_str("a:\n");
        }
        assert!(parse(&block).unwrap_err().message.contains("nested"));
    }

    #[test]
    fn only_the_first_document_counts() {
        let doc = parse("a: 1\n---\nb: 2\n").unwrap();
        assert!(doc.second.is_some());
        assert_eq!(parse("a: 1\n").unwrap().second, None);
    }

    #[test]
    fn tabs_as_indentation_are_refused() {
        assert!(parse("a:\n\tb: 1\n").is_err());
    }
}
