//! Conversion of messages between the serialisation of ROS 1 and CDR, the one of ROS 2.
//!
//! Both write the fields in order, little endian. They differ in this:
//!
//! | | ROS 1 | CDR (XCDR1) |
//! |---|---|---|
//! | alignment | none | each element to its size, counted from the beginning of the body |
//! | text | length, bytes | length with the final 0, bytes, 0 |
//! | `std_msgs/Header` | begins with `seq` | has none |
//! | message without fields | no byte | one byte |
//!
//! A [`Transcoder`] is made once for a type. Bytes are never trusted: a length that does not fit ends the conversion, and
//! memory is used only for what is there.

use crate::description::{is_header, Arity, Base, Description, Primitive};
use crate::names::TypeName;

/// Why bytes are no message of the type.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TranscodeError {
    /// Error when a field, text or array is longer than what is left.
    #[error("the message ends within what begins at byte {at}")]
    Truncated {
        /// Where it begins.
        at: usize,
    },
    /// Error when there is more than the message.
    #[error("the message is {message} bytes long, but {given} are given")]
    Trailing {
        /// Bytes of the message.
        message: usize,
        /// Bytes that were given.
        given: usize,
    },
    /// Error when a text of CDR does not end with 0.
    #[error("the text at byte {at} does not end with 0")]
    Unterminated {
        /// Where its length stands.
        at: usize,
    },
    /// Error when a text is longer than a length can say.
    #[error("the text at byte {at} is too long")]
    Long {
        /// Where its length stands.
        at: usize,
    },
}

/// Why there is no transcoder for a type.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UnusableType {
    /// Error when a type has a sequence of messages that have no fields: a few bytes could announce any number of them.
    #[error("{0} has a sequence of messages without fields")]
    SequenceOfNothing(TypeName),
}

/// One step of a conversion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// So many elements of so many bytes each.
    Run { size: u8, count: u32 },
    /// The first field of a header of ROS 1, which CDR has not.
    HeaderSequence,
    /// The byte that stands for a message without fields in CDR.
    Nothing,
    /// A text.
    Text,
    /// A count, then so many elements of so many bytes each.
    Sequence { size: u8 },
    /// So many times the following steps.
    Array { count: u32, steps: u32 },
    /// A count, then so many times the following steps.
    Repeated { steps: u32 },
}

/// Converts messages of one type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transcoder {
    steps: Vec<Step>,
}

/// Bytes that a CDR message may have after its last field: some implementations fill up to a multiple of four.
const PADDING: usize = 3;

/// Bytes of a final 0.
const END_OF_TEXT: usize = 1;

impl Transcoder {
    /// Compiles `description`.
    ///
    /// # Errors
    /// [`UnusableType`].
    pub fn new(description: &Description) -> Result<Self, UnusableType> {
        let mut compiler = Compiler { description, steps: Vec::new(), fixed: 0 };
        compiler.message(&description.name)?;
        Ok(Self { steps: compiler.steps })
    }

    /// Writes to `cdr` the body (without the four bytes before it) of the message whose ROS 1 bytes, without their length,
    /// are `ros1`. What was in `cdr` is lost; its memory is used again.
    ///
    /// # Errors
    /// When `ros1` is no message of the type. What is in `cdr` then is of no use.
    pub fn to_cdr(&self, ros1: &[u8], cdr: &mut Vec<u8>) -> Result<(), TranscodeError> {
        cdr.clear();
        // Alignment adds little to most messages.
        cdr.reserve(ros1.len() + ros1.len() / 8 + 16);
        let mut input = Input { bytes: ros1, at: 0 };
        to_cdr(&self.steps, &mut input, cdr)?;
        if input.at != ros1.len() {
            return Err(TranscodeError::Trailing { message: input.at, given: ros1.len() });
        }
        Ok(())
    }

    /// Writes to `ros1` the bytes, without their length, of the message whose CDR body (without the four bytes before it)
    /// is `cdr`. A header's `seq` is 0. What was in `ros1` is lost; its memory is used again.
    ///
    /// # Errors
    /// When `cdr` is no message of the type. What is in `ros1` then is of no use.
    pub fn to_ros1(&self, cdr: &[u8], ros1: &mut Vec<u8>) -> Result<(), TranscodeError> {
        ros1.clear();
        ros1.reserve(cdr.len() + 4);
        let mut input = Input { bytes: cdr, at: 0 };
        to_ros1(&self.steps, &mut input, ros1)?;
        if cdr.len() - input.at > PADDING {
            return Err(TranscodeError::Trailing { message: input.at, given: cdr.len() });
        }
        Ok(())
    }
}

/// Steps in the making.
struct Compiler<'a> {
    description: &'a Description,
    steps: Vec<Step>,
    /// Steps before this one stay as they are: they are the end of something that is repeated, or its beginning.
    fixed: usize,
}

impl Compiler<'_> {
    fn message(&mut self, name: &TypeName) -> Result<(), UnusableType> {
        if is_header(name) {
            self.steps.push(Step::HeaderSequence);
        }
        let fields = self.description.types.get(name).map_or(&[][..], Vec::as_slice);
        if fields.is_empty() {
            self.steps.push(Step::Nothing);
        }
        for field in fields {
            match (&field.base, field.arity) {
                (Base::Primitive(primitive), Arity::One) => self.run(*primitive, 1),
                (Base::Primitive(primitive), Arity::Array(count)) => self.run(*primitive, count),
                (Base::Primitive(primitive), Arity::Sequence) => {
                    self.steps.push(Step::Sequence { size: primitive.size() as u8 });
                }
                (Base::Text, arity) => self.repeat(arity, |compiler| {
                    compiler.steps.push(Step::Text);
                    Ok(())
                })?,
                (Base::Message(part), arity) => {
                    if arity == Arity::Sequence && is_empty(self.description, part) {
                        return Err(UnusableType::SequenceOfNothing(name.clone()));
                    }
                    self.repeat(arity, |compiler| compiler.message(part))?;
                }
            }
        }
        Ok(())
    }

    /// Adds elements; those that follow others of the same size become one step with them.
    fn run(&mut self, primitive: Primitive, more: u32) {
        let own = primitive.size() as u8;
        if let Some(Step::Run { size, count }) = self.steps[self.fixed..].last_mut() {
            if let (true, Some(sum)) = (*size == own, count.checked_add(more)) {
                *count = sum;
                return;
            }
        }
        self.steps.push(Step::Run { size: own, count: more });
    }

    /// Adds what `body` adds, as often as `arity` says. What is there once is as good as fields of the message itself.
    fn repeat(
        &mut self,
        arity: Arity,
        body: impl Fn(&mut Self) -> Result<(), UnusableType>,
    ) -> Result<(), UnusableType> {
        if arity == Arity::One {
            return body(self);
        }
        let at = self.steps.len();
        self.steps.push(Step::Repeated { steps: 0 });
        self.fixed = self.steps.len();
        body(self)?;
        self.fixed = self.steps.len();
        let steps = (self.fixed - at - 1) as u32;
        self.steps[at] = match arity {
            Arity::Array(count) => Step::Array { count, steps },
            _ => Step::Repeated { steps },
        };
        Ok(())
    }
}

/// Whether a message has no bytes in ROS 1.
fn is_empty(description: &Description, name: &TypeName) -> bool {
    description.types.get(name).is_none_or(|fields| {
        fields.iter().all(|field| {
            field.arity != Arity::Sequence && matches!(&field.base, Base::Message(part) if is_empty(description, part))
        })
    })
}

/// Bytes that are read from the front.
struct Input<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Input<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], TranscodeError> {
        let error = TranscodeError::Truncated { at: self.at };
        let end = self.at.checked_add(count).ok_or(error)?;
        let taken = self.bytes.get(self.at..end).ok_or(error)?;
        self.at = end;
        Ok(taken)
    }

    fn take_elements(&mut self, size: u8, count: u32) -> Result<&'a [u8], TranscodeError> {
        let bytes = (count as usize).checked_mul(usize::from(size));
        self.take(bytes.ok_or(TranscodeError::Truncated { at: self.at })?)
    }

    fn count(&mut self) -> Result<u32, TranscodeError> {
        let at = self.at;
        let bytes = self.take(4)?;
        Ok(u32::from_le_bytes(bytes.try_into().map_err(|_| TranscodeError::Truncated { at })?))
    }

    /// Leaves out what aligns the next element of so many bytes. At the end there may be nothing left to leave out.
    fn align(&mut self, size: u8) {
        self.at = aligned(self.at, size);
    }
}

fn aligned(at: usize, size: u8) -> usize {
    at.next_multiple_of(usize::from(size))
}

fn pad(cdr: &mut Vec<u8>, size: u8) {
    cdr.resize(aligned(cdr.len(), size), 0);
}

fn push_count(cdr: &mut Vec<u8>, count: u32) {
    pad(cdr, 4);
    cdr.extend_from_slice(&count.to_le_bytes());
}

fn to_cdr(steps: &[Step], input: &mut Input<'_>, cdr: &mut Vec<u8>) -> Result<(), TranscodeError> {
    let mut next = 0;
    while let Some(step) = steps.get(next) {
        next += 1;
        match *step {
            Step::Run { size, count } => {
                pad(cdr, size);
                cdr.extend_from_slice(input.take_elements(size, count)?);
            }
            Step::HeaderSequence => {
                input.take(4)?;
            }
            Step::Nothing => cdr.push(0),
            Step::Text => {
                let at = input.at;
                let length = input.count()?;
                let text = input.take(length as usize)?;
                push_count(cdr, length.checked_add(END_OF_TEXT as u32).ok_or(TranscodeError::Long { at })?);
                cdr.extend_from_slice(text);
                cdr.push(0);
            }
            Step::Sequence { size } => {
                let count = input.count()?;
                let elements = input.take_elements(size, count)?;
                push_count(cdr, count);
                if count > 0 {
                    pad(cdr, size);
                    cdr.extend_from_slice(elements);
                }
            }
            Step::Array { count, steps: body } => {
                let body = &steps[next..next + body as usize];
                next += body.len();
                (0..count).try_for_each(|_| to_cdr(body, input, cdr))?;
            }
            Step::Repeated { steps: body } => {
                let body = &steps[next..next + body as usize];
                next += body.len();
                let count = input.count()?;
                push_count(cdr, count);
                (0..count).try_for_each(|_| to_cdr(body, input, cdr))?;
            }
        }
    }
    Ok(())
}

fn to_ros1(steps: &[Step], input: &mut Input<'_>, ros1: &mut Vec<u8>) -> Result<(), TranscodeError> {
    let mut next = 0;
    while let Some(step) = steps.get(next) {
        next += 1;
        match *step {
            Step::Run { size, count } => {
                input.align(size);
                ros1.extend_from_slice(input.take_elements(size, count)?);
            }
            Step::HeaderSequence => ros1.extend_from_slice(&[0; 4]),
            Step::Nothing => {
                input.take(1)?;
            }
            Step::Text => text_to_ros1(input, ros1)?,
            Step::Sequence { size } => {
                input.align(4);
                let count = input.count()?;
                ros1.extend_from_slice(&count.to_le_bytes());
                if count > 0 {
                    input.align(size);
                    ros1.extend_from_slice(input.take_elements(size, count)?);
                }
            }
            Step::Array { count, steps: body } => {
                let body = &steps[next..next + body as usize];
                next += body.len();
                (0..count).try_for_each(|_| to_ros1(body, input, ros1))?;
            }
            Step::Repeated { steps: body } => {
                let body = &steps[next..next + body as usize];
                next += body.len();
                input.align(4);
                let count = input.count()?;
                ros1.extend_from_slice(&count.to_le_bytes());
                (0..count).try_for_each(|_| to_ros1(body, input, ros1))?;
            }
        }
    }
    Ok(())
}

fn text_to_ros1(input: &mut Input<'_>, ros1: &mut Vec<u8>) -> Result<(), TranscodeError> {
    input.align(4);
    let at = input.at;
    let length = input.count()?;
    let text = match input.take(length as usize)? {
        // Not quite the standard, but some write the empty text so.
        [] => &[],
        [text @ .., 0] => text,
        _ => return Err(TranscodeError::Unterminated { at }),
    };
    ros1.extend_from_slice(&(text.len() as u32).to_le_bytes());
    ros1.extend_from_slice(text);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transcoder(definition: &str) -> Transcoder {
        Transcoder::new(&Description::parse(TypeName::message("pkg", "Type"), definition).unwrap()).unwrap()
    }

    /// Both ways, and every prefix of either is refused.
    fn check(definition: &str, ros1: &[u8], cdr: &[u8]) {
        let transcoder = transcoder(definition);
        let (mut to, mut back) = (vec![7; 3], vec![7; 3]);
        transcoder.to_cdr(ros1, &mut to).unwrap();
        assert_eq!(to, cdr, "{definition}");
        transcoder.to_ros1(cdr, &mut back).unwrap();
        assert_eq!(back, ros1, "{definition}");
        for end in 0..ros1.len() {
            assert!(transcoder.to_cdr(&ros1[..end], &mut to).is_err(), "{definition}: {end} of ROS 1");
        }
        for end in 0..cdr.len() {
            assert!(transcoder.to_ros1(&cdr[..end], &mut back).is_err(), "{definition}: {end} of CDR");
        }
        assert!(transcoder.to_cdr(&[ros1, &[0]].concat(), &mut to).is_err());
        assert!(transcoder.to_ros1(&[cdr, &[0; PADDING]].concat(), &mut back).is_ok());
        assert!(transcoder.to_ros1(&[cdr, &[0; PADDING + 1]].concat(), &mut back).is_err());
    }

    #[test]
    fn elements_are_aligned_to_their_size() {
        check("uint8 a\nfloat64 b", &[1, 2, 3, 4, 5, 6, 7, 8, 9], &[1, 0, 0, 0, 0, 0, 0, 0, 2, 3, 4, 5, 6, 7, 8, 9]);
        check("bool a\nint16 b\nuint8 c\nint32 d", &[1, 2, 3, 4, 5, 6, 7, 8], &[1, 0, 2, 3, 4, 0, 0, 0, 5, 6, 7, 8]);
        check("uint8[3] a\nint16[2] b", &[1, 2, 3, 4, 5, 6, 7], &[1, 2, 3, 0, 4, 5, 6, 7]);
    }

    #[test]
    fn texts_end_with_a_zero() {
        check("string a\nuint8 b", &[2, 0, 0, 0, b'a', b'b', 9], &[3, 0, 0, 0, b'a', b'b', 0, 9]);
        check("string a", &[0, 0, 0, 0], &[1, 0, 0, 0, 0]);
        check(
            "uint8 c\nstring[] a",
            &[5, 2, 0, 0, 0, 1, 0, 0, 0, b'x', 0, 0, 0, 0],
            &[5, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, b'x', 0, 0, 0, 1, 0, 0, 0, 0],
        );
        let mut ros1 = Vec::new();
        transcoder("string a").to_ros1(&[0, 0, 0, 0], &mut ros1).unwrap();
        assert_eq!(ros1, [0, 0, 0, 0]);
        let unterminated = transcoder("string a").to_ros1(&[1, 0, 0, 0, b'a'], &mut ros1);
        assert_eq!(unterminated, Err(TranscodeError::Unterminated { at: 0 }));
    }

    #[test]
    fn empty_sequences_are_a_count_alone() {
        check("float64[] a\nuint8 b", &[0, 0, 0, 0, 9], &[0, 0, 0, 0, 9]);
        let one = [1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8];
        check("float64[] a", &one, &[1, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8]);
    }

    const SEPARATOR: &str = "================================================================================";

    #[test]
    fn headers_and_messages_without_fields_differ() {
        let header =
            format!("Header h\nuint8 a\n{SEPARATOR}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id");
        let (stamp, frame) = ([1, 0, 0, 0, 2, 0, 0, 0], [0, 0, 0, 0]);
        let ros1 = [&[0; 4][..], &stamp, &frame, &[9]].concat();
        check(&header, &ros1, &[&stamp[..], &[1, 0, 0, 0, 0], &[9]].concat());
        check("", &[], &[0]);
        let nested = format!("Nothing n\nuint16 a\n{SEPARATOR}\nMSG: pkg/Nothing\n");
        check(&nested, &[3, 4], &[0, 0, 3, 4]);
        let many = format!("Nothing[] n\n{SEPARATOR}\nMSG: pkg/Nothing\n");
        let many = Description::parse(TypeName::message("pkg", "Type"), &many).unwrap();
        assert!(matches!(Transcoder::new(&many), Err(UnusableType::SequenceOfNothing(_))));
    }

    #[test]
    fn messages_in_messages_are_runs_where_they_can() {
        let pose = format!(
            "Point p\nPoint[2] q\nfloat32 a\nPoint[] r\nfloat32 b\n{SEPARATOR}\nMSG: pkg/Point\nfloat64 x\nfloat64 y\nfloat32 z\nfloat32 w"
        );
        let steps = transcoder(&pose).steps;
        let point = [Step::Run { size: 8, count: 2 }, Step::Run { size: 4, count: 2 }];
        let single = Step::Run { size: 4, count: 1 };
        let mut expected = Vec::from(point);
        expected.push(Step::Array { count: 2, steps: 2 });
        expected.extend(point);
        expected.extend([single, Step::Repeated { steps: 2 }]);
        expected.extend(point);
        expected.push(single);
        assert_eq!(steps, expected);
        let flat = format!(
            "float64 a\nXyz p\nXyz q\nfloat64[3] b\n{SEPARATOR}\nMSG: pkg/Xyz\nfloat64 x\nfloat64 y\nfloat64 z"
        );
        assert_eq!(transcoder(&flat).steps, [Step::Run { size: 8, count: 10 }]);
    }

    #[test]
    fn counts_that_lie_are_refused_without_memory_for_them() {
        let point = format!("Point[] r\n{SEPARATOR}\nMSG: pkg/Point\nfloat64 x\nstring s");
        for definition in ["float64[] a", "string a", "string[] a", &point] {
            let transcoder = transcoder(definition);
            let (mut to, mut back) = (Vec::new(), Vec::new());
            assert!(transcoder.to_cdr(&[0xff; 16], &mut to).is_err(), "{definition}");
            assert!(transcoder.to_ros1(&[0xff; 16], &mut back).is_err(), "{definition}");
            assert!(to.capacity() < 1000 && back.capacity() < 1000, "{definition}");
        }
    }

    #[test]
    fn bytes_of_any_kind_end_in_a_message_or_an_error() {
        let definition = format!(
            "Header h\nuint8 a\nstring s\nPart[] parts\nPart[2] two\nstring[] names\nbool[] flags\nint16[] shorts\n\
             {SEPARATOR}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n\
             {SEPARATOR}\nMSG: pkg/Part\nfloat64[] x\nstring s\nint8 t"
        );
        let transcoder = transcoder(&definition);
        // A linear congruential generator: the same bytes in every run.
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize
        };
        let (mut one, mut other, mut back, mut good) = (Vec::new(), Vec::new(), Vec::new(), 0);
        for _ in 0..20_000 {
            let mut bytes: Vec<u8> = (0..random() % 300).map(|_| random() as u8).collect();
            // Mostly small counts, so that some get far.
            bytes.iter_mut().for_each(|byte| *byte = if random() % 16 > 0 { 0 } else { *byte % 4 });
            let _ = transcoder.to_ros1(&bytes, &mut one);
            assert!(one.len() <= 4 * bytes.len() + 64);
            // Whatever is a message of ROS 1 comes back the same, apart from the number in its header.
            if transcoder.to_cdr(&bytes, &mut other).is_ok() {
                good += 1;
                transcoder.to_ros1(&other, &mut back).unwrap();
                assert_eq!(back[4..], bytes[4..]);
            }
            assert!(other.len() <= 4 * bytes.len() + 64);
        }
        assert!(good > 0, "none was a message");
    }
}
