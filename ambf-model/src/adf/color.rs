//! Colour tables.

use std::collections::BTreeMap;

use super::reader::Map;
use super::report::ProblemKind;

/// A colour table as written: name to (red, green, blue, alpha), each 0 to 255. Bodies cannot use it in this version.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ColorTable {
    /// Colours by name.
    pub colors: BTreeMap<String, [u8; 4]>,
}

impl ColorTable {
    pub(super) fn read(root: &Map<'_>) -> Self {
        root.reader().tolerate();
        let mut table = Self::default();
        for name in root.unread_keys() {
            let color = root.reader().element("colour", || {
                let map = root.map(name);
                let parts = ["r", "g", "b", "a"].map(|key| {
                    let value = map.need_uint(key);
                    u8::try_from(value).unwrap_or_else(|_| {
                        map.reject(ProblemKind::OutOfRange, key, "0 to 255");
                        0
                    })
                });
                map.finish();
                Some(parts)
            });
            if let Some(color) = color {
                table.colors.insert(name.to_owned(), color);
            }
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::read;
    use super::*;

    #[test]
    fn colours() {
        let text = "a: &a {r: 0xcd, g: 0, b: 255, a: 1}\nb: *a\nc: {r: 256, g: 0, b: 0, a: 0}\nd: 3\n";
        let (table, problems) = read::<ColorTable>(text);
        assert_eq!(table.colors["a"], [0xcd, 0, 255, 1]);
        assert_eq!(table.colors["b"], table.colors["a"]);
        assert_eq!(table.colors.len(), 2);
        assert!(problems[0].contains("`c / r` is `256`, expected 0 to 255; the colour is dropped"));
    }
}
