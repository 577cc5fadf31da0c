//! Lines of a program's log.

use std::time::Duration;

use crate::cdr::Writer;

/// A line of a log, `rcl_interfaces/msg/Log`: what nodes of ROS 2 send on `/rosout`. The place in the source is left open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogLine<'a> {
    /// When it was said, since 1970. System time.
    pub at: Duration,
    /// How important it is: 10 (debug), 20 (info), 30 (warn), 40 (error) or 50 (fatal).
    pub level: u8,
    /// Who says it: the name of a logger, as a rule that of a node without the slash before it.
    pub name: &'a str,
    /// What is said.
    pub text: &'a str,
}

impl LogLine<'_> {
    /// The body of the message: CDR, little endian, without the four bytes before it.
    pub fn encode(&self) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.u32(self.at.as_secs() as u32);
        writer.u32(self.at.subsec_nanos());
        writer.u8(self.level);
        writer.text(self.name);
        writer.text(self.text);
        // File, function and line.
        writer.text("");
        writer.text("");
        writer.u32(0);
        writer.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_its_fields_where_cdr_wants_them() {
        let line = LogLine { at: Duration::new(1, 2), level: 30, name: "a", text: "b c" };
        let mut expected = vec![1, 0, 0, 0, 2, 0, 0, 0, 30, 0, 0, 0];
        expected.extend([2, 0, 0, 0, b'a', 0, 0, 0, 4, 0, 0, 0, b'b', b' ', b'c', 0]);
        expected.extend([1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(line.encode(), expected);
    }
}
