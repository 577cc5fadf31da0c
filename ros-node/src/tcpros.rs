//! Parts of TCPROS: headers of `key=value` fields and blocks of bytes, each behind its length.

use std::collections::HashMap;

/// Longest text of a peer that is repeated to the user, characters.
const MAX_QUOTE: usize = 200;

/// `text` for a line to the user: printable, and not longer than that.
pub(crate) fn quote(text: &str) -> String {
    let printable = text.trim().chars().map(|c| if c.is_control() { ' ' } else { c });
    let mut quoted: String = printable.take(MAX_QUOTE).collect();
    if text.chars().nth(MAX_QUOTE).is_some() {
        quoted.push('…');
    }
    if quoted.is_empty() {
        quoted.push_str("(nothing)");
    }
    quoted
}

/// The fields of a connection header without its length; what is no field is left out.
pub fn fields(mut header: &[u8]) -> HashMap<String, String> {
    let mut fields = HashMap::new();
    while let Some((length, rest)) = header.split_first_chunk::<4>() {
        let length = u32::from_le_bytes(*length) as usize;
        let Some((field, rest)) = rest.split_at_checked(length) else { break };
        header = rest;
        if let Some((key, value)) = std::str::from_utf8(field).ok().and_then(|field| field.split_once('=')) {
            fields.insert(key.to_owned(), value.to_owned());
        }
    }
    fields
}

/// `text` behind its length. No text of ours comes near 4 GB.
pub fn block(text: &[u8]) -> Vec<u8> {
    let mut block = (text.len() as u32).to_le_bytes().to_vec();
    block.extend(text);
    block
}

/// A connection header of these fields, behind its length.
pub fn header_of(fields: &[(&str, &str)]) -> Vec<u8> {
    let fields: Vec<u8> = fields.iter().flat_map(|(key, value)| block(format!("{key}={value}").as_bytes())).collect();
    block(&fields)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_in_a_header() {
        let header = header_of(&[("type", "std_msgs/Bool"), ("definition", "a=b"), ("empty", "")]);
        let found = fields(&header[4..]);
        assert_eq!(
            (found["type"].as_str(), found["definition"].as_str(), found["empty"].as_str()),
            ("std_msgs/Bool", "a=b", "")
        );
        assert!(fields(&[255, 255, 255, 255, 1]).is_empty() && fields(&[]).is_empty());
    }
}
