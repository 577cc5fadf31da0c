//! Messages as RustDDS takes and gives them: bytes that it does not look into.

use std::convert::Infallible;

use rustdds::bytes::Bytes;
use rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use rustdds::RepresentationIdentifier;

/// The body of a message that came, or its length if that is more than is taken.
pub(crate) type Received = Result<Vec<u8>, usize>;

/// Passes bytes through.
pub(crate) struct Raw;

pub(crate) type RawWriter = rustdds::no_key::DataWriter<Bytes, Raw>;
pub(crate) type RawReader = rustdds::no_key::SimpleDataReader<Received, Raw>;

impl SerializerAdapter<Bytes> for Raw {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Bytes) -> Result<Bytes, Infallible> {
        Ok(value.clone())
    }
}

impl DeserializerAdapter<Received> for Raw {
    type Error = Infallible;
    type Decoded = Received;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Received) -> Received {
        decoded
    }
}

impl DefaultDecoder<Received> for Raw {
    type Decoder = Limit;
    const DECODER: Limit = Limit(usize::MAX);
}

/// Copies what has at most so many bytes.
#[derive(Clone)]
pub(crate) struct Limit(pub usize);

impl Decode<'_, Received> for Limit {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], _: RepresentationIdentifier) -> Result<Received, Infallible> {
        Ok(if bytes.len() <= self.0 { Ok(bytes.to_vec()) } else { Err(bytes.len()) })
    }
}
