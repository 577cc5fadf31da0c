//! CDR (XCDR1, little endian) by hand, for the few messages that the node itself writes and reads.

/// Writes the body of a message.
#[derive(Debug, Default)]
pub(crate) struct Writer(pub Vec<u8>);

impl Writer {
    fn align(&mut self, size: usize) {
        self.0.resize(self.0.len().next_multiple_of(size), 0);
    }

    pub fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub fn bool(&mut self, value: bool) {
        self.0.push(u8::from(value));
    }

    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn i64(&mut self, value: i64) {
        self.align(8);
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.align(8);
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    /// Lengths of lists and texts are below 2^32: they are our own, or came in with a length of 32 bits.
    pub fn count(&mut self, count: usize) {
        self.u32(u32::try_from(count).unwrap_or(u32::MAX));
    }

    pub fn text(&mut self, text: &str) {
        self.count(text.len() + 1);
        self.0.extend_from_slice(text.as_bytes());
        self.0.push(0);
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    pub fn each<T>(&mut self, items: impl ExactSizeIterator<Item = T>, mut write: impl FnMut(&mut Self, T)) {
        self.count(items.len());
        items.for_each(|item| write(self, item));
    }
}

/// Reads the body of a message; every reading is `None` where the message ends before.
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    fn take(&mut self, align: usize, count: usize) -> Option<&'a [u8]> {
        let from = self.at.next_multiple_of(align);
        let taken = self.bytes.get(from..from.checked_add(count)?)?;
        self.at = from + count;
        Some(taken)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.take(1, 1).map(|bytes| bytes[0])
    }

    pub fn bool(&mut self) -> Option<bool> {
        self.u8().map(|byte| byte != 0)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.take(4, 4)?.try_into().ok().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.take(8, 8)?.try_into().ok().map(u64::from_le_bytes)
    }

    pub fn i64(&mut self) -> Option<i64> {
        self.take(8, 8)?.try_into().ok().map(i64::from_le_bytes)
    }

    pub fn f64(&mut self) -> Option<f64> {
        self.take(8, 8)?.try_into().ok().map(f64::from_le_bytes)
    }

    pub fn text(&mut self) -> Option<String> {
        let length = self.u32()? as usize;
        let bytes = self.take(1, length)?;
        let text = bytes.strip_suffix(&[0]).or(bytes.is_empty().then_some(bytes))?;
        String::from_utf8(text.to_vec()).ok()
    }

    /// A list whose elements have at least one byte each.
    pub fn each<T>(&mut self, mut read: impl FnMut(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        let count = self.u32()? as usize;
        if count > self.bytes.len() - self.at {
            return None;
        }
        (0..count).map(|_| read(self)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let mut writer = Writer::default();
        writer.u8(1);
        writer.text("ab");
        writer.f64(0.5);
        writer.bool(true);
        writer.each([1i64, -2].into_iter(), Writer::i64);
        let read = |bytes: &[u8]| {
            let mut reader = Reader::new(bytes);
            Some((reader.u8()?, reader.text()?, reader.f64()?, reader.bool()?, reader.each(Reader::i64)?))
        };
        assert_eq!(read(&writer.0), Some((1, "ab".into(), 0.5, true, vec![1, -2])));
        for end in 0..writer.0.len() {
            assert_eq!(read(&writer.0[..end]), None, "{end}");
        }
    }

    #[test]
    fn counts_that_lie_are_refused() {
        assert_eq!(Reader::new(&[0xff; 8]).each(Reader::u8), None);
        assert_eq!(Reader::new(&[0xff; 8]).text(), None);
        assert_eq!(Reader::new(&[1, 0, 0, 0, b'a']).text(), None);
    }
}
