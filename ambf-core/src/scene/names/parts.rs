//! Which names hold a text: suffix arrays (Manber and Myers, *SIAM Journal on Computing* 22, 1993).

use std::ops::Range;

/// Ends a name. No byte of UTF-8.
const END: u8 = 0xff;
/// Runs of suffixes of one name that are looked at to name some that hold a text.
const MAX_RUNS: usize = 32;

/// The names that hold a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Holding {
    Nothing,
    One(String),
    /// Several, of which some are named, in lexicographic order.
    Several(Vec<String>),
}

impl Holding {
    fn with(self, other: Self) -> Self {
        let names = |holding| match holding {
            Self::Nothing => Vec::new(),
            Self::One(name) => vec![name],
            Self::Several(names) => names,
        };
        match (self, other) {
            (Self::Nothing, one) | (one, Self::Nothing) => one,
            (one, another) => {
                let mut names = [names(one), names(another)].concat();
                names.sort();
                Self::Several(names)
            }
        }
    }
}

/// Names that are added one by one and searched for texts. A search takes time in proportion to the text, and the
/// logarithm of the number of names twice; the names are sorted anew when as many have been added.
#[derive(Debug, Clone, Default)]
pub(super) struct Parts {
    /// Each at least twice as large as the next one.
    sorted: Vec<Sorted>,
    /// Added since the last search.
    added: Vec<String>,
}

impl Parts {
    pub fn add(&mut self, name: &str) {
        self.added.push(name.to_owned());
    }

    pub fn holding(&mut self, text: &str) -> Holding {
        if !self.added.is_empty() {
            let mut names = std::mem::take(&mut self.added);
            let size = |names: &[String]| names.iter().map(|name| name.len() + 1).sum::<usize>();
            while self.sorted.last().is_some_and(|last| last.text.len() < 2 * size(&names)) {
                names.extend(self.sorted.pop().into_iter().flat_map(|last| last.names()));
            }
            self.sorted.push(Sorted::new(&names));
        }
        self.sorted.iter().fold(Holding::Nothing, |found, sorted| found.with(sorted.holding(text)))
    }
}

/// Names with their suffixes in order.
#[derive(Debug, Clone)]
struct Sorted {
    /// The names, each with its end.
    text: Vec<u8>,
    /// Where each suffix that is not an end begins, in lexicographic order.
    suffixes: Vec<u32>,
    /// For each of them the next one of another name.
    run_ends: Vec<u32>,
    /// Where each name begins.
    starts: Vec<u32>,
}

impl Sorted {
    fn new(names: &[String]) -> Self {
        let (mut text, mut starts) = (Vec::new(), Vec::with_capacity(names.len()));
        for name in names {
            starts.push(text.len() as u32);
            text.extend_from_slice(name.as_bytes());
            text.push(END);
        }
        let mut sorted = Self { suffixes: suffixes(&text), text, run_ends: Vec::new(), starts };
        let owners: Vec<usize> = sorted.suffixes.iter().map(|&suffix| sorted.owner(suffix)).collect();
        let mut end = owners.len();
        sorted.run_ends = vec![end as u32; owners.len()];
        for place in (0..owners.len()).rev() {
            if owners.get(place + 1).is_some_and(|&next| next != owners[place]) {
                end = place + 1;
            }
            sorted.run_ends[place] = end as u32;
        }
        sorted
    }

    /// Index of the name of which a suffix is.
    fn owner(&self, suffix: u32) -> usize {
        self.starts.partition_point(|&start| start <= suffix) - 1
    }

    fn name(&self, owner: usize) -> String {
        let start = self.starts[owner] as usize;
        let end = self.starts.get(owner + 1).map_or(self.text.len(), |&next| next as usize) - 1;
        String::from_utf8_lossy(&self.text[start..end]).into_owned()
    }

    fn names(&self) -> Vec<String> {
        (0..self.starts.len()).map(|owner| self.name(owner)).collect()
    }

    /// The suffixes that begin with a text.
    fn range(&self, text: &[u8]) -> Range<usize> {
        let head = |&suffix: &u32| {
            let rest = &self.text[suffix as usize..];
            &rest[..rest.len().min(text.len())]
        };
        let first = self.suffixes.partition_point(|suffix| head(suffix) < text);
        first..first + self.suffixes[first..].partition_point(|suffix| head(suffix) == text)
    }

    fn holding(&self, text: &str) -> Holding {
        let range = self.range(text.as_bytes());
        let mut owners = Vec::new();
        let mut place = range.start;
        for _ in 0..MAX_RUNS {
            if place >= range.end {
                break;
            }
            owners.push(self.owner(self.suffixes[place]));
            place = self.run_ends[place] as usize;
        }
        owners.sort_unstable();
        owners.dedup();
        let mut names: Vec<String> = owners.into_iter().map(|owner| self.name(owner)).collect();
        match names.len() {
            // The empty text is part of a name without letters, which has no suffix.
            0 if text.is_empty() && !self.starts.is_empty() => Holding::One(String::new()),
            0 => Holding::Nothing,
            1 => names.pop().map_or(Holding::Nothing, Holding::One),
            _ => {
                names.sort();
                Holding::Several(names)
            }
        }
    }
}

/// Where the suffixes of a text begin, in lexicographic order, without those that begin with an end: by their first
/// bytes, then by twice as many, and so on.
fn suffixes(text: &[u8]) -> Vec<u32> {
    const FIRST: usize = 8;
    let n = text.len();
    let key = |at: usize| {
        let mut bytes = [0; FIRST];
        let head = &text[at..n.min(at + FIRST)];
        bytes[..head.len()].copy_from_slice(head);
        u64::from_be_bytes(bytes)
    };
    let mut order: Vec<u32> = (0..n as u32).collect();
    order.sort_by_cached_key(|&at| key(at as usize));
    let mut ranks = vec![0u32; n];
    let rank = |order: &[u32], ranks: &mut [u32], differ: &dyn Fn(usize, usize) -> bool| {
        let mut distinct = 0;
        for place in 0..order.len() {
            if place > 0 && differ(order[place - 1] as usize, order[place] as usize) {
                distinct = place as u32;
            }
            ranks[order[place] as usize] = distinct;
        }
    };
    rank(&order, &mut ranks, &|a, b| key(a) != key(b));
    let mut length = FIRST;
    while length < n {
        let before = ranks.clone();
        let pair = |at: usize| (before[at], before.get(at + length).map_or(0, |rank| rank + 1));
        // Only runs of equal ranks change.
        let mut is_sorted = true;
        let mut start = 0;
        while start < n {
            let mut end = start + 1;
            while end < n && before[order[end] as usize] == before[order[start] as usize] {
                end += 1;
            }
            if end - start > 1 {
                is_sorted = false;
                order[start..end].sort_unstable_by_key(|&at| pair(at as usize).1);
            }
            start = end;
        }
        if is_sorted {
            break;
        }
        rank(&order, &mut ranks, &|a, b| pair(a) != pair(b));
        length *= 2;
    }
    order.retain(|&at| text[at as usize] != END);
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same by a look at each name.
    fn scanned(names: &[String], text: &str) -> Holding {
        let mut found: Vec<String> = names.iter().filter(|name| name.contains(text)).cloned().collect();
        found.sort();
        match found.len() {
            0 => Holding::Nothing,
            1 => Holding::One(found.remove(0)),
            _ => Holding::Several(found),
        }
    }

    #[test]
    fn texts_are_found_in_names_wherever_they_are() {
        let mut state = 7u32;
        let mut next = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) % below
        };
        for letters in [2, 4] {
            let (mut parts, mut names) = (Parts::default(), Vec::new());
            for round in 0..200 {
                let name: String = (0..next(12))
                    .map(|_| char::from(b'a' + next(letters) as u8))
                    .chain(round.to_string().chars())
                    .collect();
                parts.add(&name);
                names.push(name);
                let text: String = (0..1 + next(5)).map(|_| char::from(b'a' + next(letters) as u8)).collect();
                match (parts.holding(&text), scanned(&names, &text)) {
                    (Holding::Several(some), Holding::Several(all)) => {
                        assert!(some.len() > 1 && some.iter().all(|name| all.contains(name)), "{text}: {some:?}");
                        assert!(all.len() > 5 || some == all, "{text}: {some:?} of {all:?}");
                    }
                    (found, expected) => assert_eq!(found, expected, "{text} in {names:?}"),
                }
            }
        }
    }

    #[test]
    fn the_empty_text_is_part_of_every_name() {
        let mut parts = Parts::default();
        assert_eq!(parts.holding(""), Holding::Nothing);
        parts.add("");
        assert_eq!(parts.holding(""), Holding::One(String::new()));
    }

    /// Names were compared with a text one after the other: 10 000 texts took 20 s.
    #[test]
    fn names_are_sorted_anew_only_when_many_were_added() {
        let mut parts = Parts::default();
        let mut sizes = Vec::new();
        for n in 0..1000 {
            parts.add(&format!("/ambf/env/BODY link {n}"));
            assert!(matches!(parts.holding(&format!("link {n}")), Holding::One(_) | Holding::Several(_)));
            sizes.push(parts.sorted.len());
        }
        assert!(sizes.iter().all(|&size| size <= 10), "{sizes:?}");
    }
}
