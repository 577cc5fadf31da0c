//! A mutation that keeps a text readable: one of its numbers becomes another.

use libfuzzer_sys::fuzzer_mutate;

/// Numbers that code tends not to expect.
const NUMBERS: [&str; 24] = [
    "0",
    "-0.0",
    "1",
    "-1",
    "2",
    "1e-320",
    "1e-155",
    "1e-30",
    "1e-14",
    "1e-6",
    "0.5",
    "3.14159265",
    "1e3",
    "1e7",
    "1e18",
    "1e30",
    "1e154",
    "1.7e308",
    "-1e10",
    "-1.7e308",
    ".inf",
    ".nan",
    "2147483647",
    "4294967295",
];

/// Replaces one number of `data[..size]`, or else does what libFuzzer would do. Returns the new size.
pub fn mutate(data: &mut [u8], size: usize, max_size: usize, seed: u32) -> usize {
    let numbers: Vec<(usize, usize)> = words(&data[..size]).collect();
    let (choice, seed) = (seed % 4, seed as usize / 4);
    if choice == 0 || numbers.is_empty() {
        return fuzzer_mutate(data, size, max_size);
    }
    let (start, end) = numbers[seed % numbers.len()];
    let new = NUMBERS[seed / numbers.len() % NUMBERS.len()].as_bytes();
    let new_size = size - (end - start) + new.len();
    if new_size > max_size {
        return fuzzer_mutate(data, size, max_size);
    }
    data.copy_within(end..size, start + new.len());
    data[start..start + new.len()].copy_from_slice(new);
    new_size
}

/// Where words that begin like a number start and end.
fn words(text: &[u8]) -> impl Iterator<Item = (usize, usize)> + '_ {
    let breaks = |&b: &u8| matches!(b, b' ' | b',' | b':' | b'[' | b']' | b'{' | b'}' | b'\n' | b'"');
    let mut at = 0;
    std::iter::from_fn(move || loop {
        let start = at + text.get(at..)?.iter().position(|b| !breaks(b))?;
        let end = text[start..].iter().position(breaks).map_or(text.len(), |n| start + n);
        at = end;
        if matches!(text[start], b'0'..=b'9' | b'-' | b'+' | b'.') {
            return Some((start, end));
        }
    })
}
