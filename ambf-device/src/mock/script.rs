use std::str::FromStr;

/// What happens when: entries `what@from-to`, separated by commas, times in s; without `to` for ever. For example
/// `1@2.0-3.5, 0@0-`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Script<T>(Vec<(T, f64, f64)>);

impl<T> Default for Script<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T: Copy> Script<T> {
    /// What happens at `time`, and until when.
    pub(super) fn at(&self, time: f64) -> impl Iterator<Item = (T, f64)> + '_ {
        self.0.iter().filter(move |(_, from, to)| (*from..*to).contains(&time)).map(|&(what, _, to)| (what, to))
    }
}

impl<T: FromStr> FromStr for Script<T> {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let entries = text.split(',').map(str::trim).filter(|entry| !entry.is_empty());
        let entry = |entry: &str| {
            let (what, times) = entry.split_once('@')?;
            let (from, to) = times.split_once('-')?;
            let from: f64 = from.trim().parse().ok()?;
            let to = match to.trim() {
                "" => f64::INFINITY,
                to => to.parse().ok()?,
            };
            (from >= 0.0 && from < to).then_some((what.trim().parse().ok()?, from, to))
        };
        entries.map(entry).collect::<Option<_>>().map(Self).ok_or(())
    }
}

/// What can go wrong with a device, for tests of those who use it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// Reading does not return before the end.
    Block,
    /// Reading panics.
    Panic,
    /// Positions are no numbers.
    NotANumber,
    /// Samples are not valid.
    Invalid,
    /// The device is away.
    Lost,
}

impl FromStr for Fault {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Ok(match text {
            "block" => Self::Block,
            "panic" => Self::Panic,
            "nan" => Self::NotANumber,
            "invalid" => Self::Invalid,
            "lost" => Self::Lost,
            _ => return Err(()),
        })
    }
}

/// Number of a button.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Button(pub u32);

impl FromStr for Button {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        text.parse().ok().filter(|button| *button < 32).map(Self).ok_or(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_hold_from_their_first_moment_to_before_their_last() {
        let script: Script<Button> = "1@2.0-3.5, 0@0-,".parse().unwrap();
        let at = |time| script.at(time).map(|(Button(button), _)| button).collect::<Vec<_>>();
        assert_eq!([at(0.0), at(2.0), at(3.49), at(3.5)], [vec![0], vec![1, 0], vec![1, 0], vec![0]]);
        assert_eq!("".parse::<Script<Button>>().unwrap().at(1.0).count(), 0);
    }

    #[test]
    fn nonsense_is_refused() {
        for text in ["1", "1@2", "1@-1-2", "1@3-2", "32@0-", "x@0-", "1@0-nan", "1@nan-"] {
            assert!(text.parse::<Script<Button>>().is_err(), "{text}");
        }
        assert!("block@1-2, smoke@3-".parse::<Script<Fault>>().is_err());
    }
}
