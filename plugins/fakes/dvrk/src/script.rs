//! Scripts: what fake arms, pedals and their node do, and when.
//!
//! A line is a time in s, then what happens; `#` begins a comment. With the name of an arm after the time it concerns
//! that arm only, otherwise all of them.
//!
//! ```text
//! 0.0  pose 0 0 0  0 0 0        # device frame: x y z in m, roll pitch yaw in rad; between two such lines the hand moves evenly
//! 2.0  MTMR pose 0.05 0 0  0 0 0
//! 1.0  gripper 0.2              # 0 closed … 1 open; evenly between two lines
//! 2.5  press clutch             # clutch, coag, operator_present, camera, camera_plus, camera_minus
//! 3.0  release clutch
//! 3.5  tap camera               # pressed and released quickly: 1, 0 and then 2
//! 4.0  fault
//! 4.5  command enable           # as if a console had sent it
//! 5.0  stop                     # the node disappears…
//! 6.0  start                    # …and is back
//! 7.0  dialect legacy           # the node is another release of the robot's software from now on
//! 8.0  zero_stamps on
//! 9.0  end                      # the program ends
//! 9.0  loop                     # or: from the beginning
//! ```

use dvrk_arm::{isometry, Dialect, Pedal};
use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

use crate::parse_dialect;

/// Error in a script.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{place}: {what}")]
pub struct ScriptError {
    /// `name:line`.
    pub place: String,
    /// What is wrong and what was expected.
    pub what: String,
}

/// Something that happens at one moment.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Event {
    Press(Pedal),
    Release(Pedal),
    Tap(Pedal),
    Fault,
    Command(String),
    Stop,
    Start,
    Dialect(Dialect),
    ZeroStamps(bool),
    End,
}

/// A value at a time, of one arm or of all.
#[derive(Debug, Clone, PartialEq)]
struct Key<T> {
    t: f64,
    arm: Option<String>,
    value: T,
}

/// A script.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Script {
    poses: Vec<Key<Isometry3<f64>>>,
    grippers: Vec<Key<f64>>,
    events: Vec<Key<Event>>,
    /// When it begins anew.
    period: Option<f64>,
}

impl Script {
    /// Reads a script; `name` is for messages.
    ///
    /// # Errors
    /// [`ScriptError`] for the first line that is not understood.
    pub fn parse(name: &str, text: &str) -> Result<Self, ScriptError> {
        let mut script = Self::default();
        let mut last = 0.0;
        for (number, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default();
            let words: Vec<&str> = line.split([' ', '\t', ',']).filter(|word| !word.is_empty()).collect();
            if words.is_empty() {
                continue;
            }
            let error = |what: String| ScriptError { place: format!("{name}:{}", number + 1), what };
            let t = words[0].parse::<f64>().ok().filter(|t| t.is_finite() && *t >= last);
            let t =
                t.ok_or_else(|| error(format!("\"{}\" is no time, s, that is not before the line above", words[0])))?;
            last = t;
            script.line(t, &words[1..]).map_err(error)?;
        }
        Ok(script)
    }

    fn line(&mut self, t: f64, words: &[&str]) -> Result<(), String> {
        let known = ["pose", "gripper", "press", "release", "tap", "fault", "command", "stop", "start", "dialect"];
        let known = known.iter().chain(&["zero_stamps", "end", "loop"]);
        let is_known = |word: &str| known.clone().any(|name| *name == word);
        let (arm, words) = match words {
            [arm, rest @ ..] if !is_known(arm) && !rest.is_empty() => (Some((*arm).to_owned()), rest),
            words => (None, words),
        };
        let event = match words {
            ["pose", numbers @ ..] => {
                let numbers: Option<Vec<f64>> = numbers.iter().map(|word| word.parse().ok()).collect();
                let numbers = numbers.and_then(|numbers| <[f64; 6]>::try_from(numbers).ok());
                let numbers = numbers.filter(|numbers| numbers.iter().all(|x| x.is_finite()));
                let numbers = numbers.ok_or("pose needs six numbers: x y z in m, roll pitch yaw in rad")?;
                self.poses.push(Key { t, arm, value: isometry(numbers) });
                return Ok(());
            }
            ["gripper", number] => {
                let value = number.parse().ok().filter(|x| (0.0..=1.0).contains(x));
                let value = value.ok_or("gripper needs a number from 0, closed, to 1, open")?;
                self.grippers.push(Key { t, arm, value });
                return Ok(());
            }
            ["loop"] if t > 0.0 => {
                self.period = Some(t);
                return Ok(());
            }
            ["press", pedal] => Event::Press(parse_pedal(pedal)?),
            ["release", pedal] => Event::Release(parse_pedal(pedal)?),
            ["tap", pedal] => Event::Tap(parse_pedal(pedal)?),
            ["fault"] => Event::Fault,
            ["command", command] => Event::Command((*command).to_owned()),
            ["stop"] => Event::Stop,
            ["start"] => Event::Start,
            ["dialect", dialect] => Event::Dialect(parse_dialect(dialect)?),
            ["zero_stamps", "on"] => Event::ZeroStamps(true),
            ["zero_stamps", "off"] => Event::ZeroStamps(false),
            ["end"] => Event::End,
            _ => {
                let mut what = format!("\"{}\" is not understood, expected one of", words.join(" "));
                what.extend(known.flat_map(|name| [" ", name]));
                return Err(what);
            }
        };
        self.events.push(Key { t, arm, value: event });
        Ok(())
    }

    /// Time in the script at time `t` of its run.
    fn phase(&self, t: f64) -> f64 {
        self.period.map_or(t, |period| t.rem_euclid(period))
    }

    /// Where the script wants an arm at time `t`; `None` if it says nothing about it.
    pub(crate) fn pose(&self, arm: &str, t: f64) -> Option<Isometry3<f64>> {
        between(&self.poses, arm, self.phase(t), |a, b, s| {
            let rotation = a.rotation.try_slerp(&b.rotation, s, 1e-9).unwrap_or(b.rotation);
            let position: Vector3<f64> = a.translation.vector.lerp(&b.translation.vector, s);
            Isometry3::from_parts(position.into(), rotation)
        })
    }

    /// The same for its gripper.
    pub(crate) fn gripper(&self, arm: &str, t: f64) -> Option<f64> {
        between(&self.grippers, arm, self.phase(t), |a, b, s| a + (b - a) * s)
    }

    /// What happens after time `from` until time `to`, and to which arm; `from` may be negative for the beginning.
    pub(crate) fn events(&self, from: f64, to: f64) -> Vec<(Option<&str>, &Event)> {
        let rounds = self.period.map_or(0, |period| (to / period) as u32);
        let begin = self.period.map_or(0, |period| (from.max(0.0) / period) as u32);
        let mut due = Vec::new();
        for round in begin..=rounds {
            let shift = f64::from(round) * self.period.unwrap_or(0.0);
            let now = self.events.iter().filter(|key| (from..to).contains(&(key.t + shift)));
            due.extend(now.map(|key| (key.arm.as_deref(), &key.value)));
        }
        due
    }
}

/// Even motion between the keys of an arm, rest before the first and after the last.
fn between<T: Copy>(keys: &[Key<T>], arm: &str, t: f64, mix: impl FnOnce(&T, &T, f64) -> T) -> Option<T> {
    let own = |key: &&Key<T>| key.arm.as_deref().is_none_or(|name| name == arm);
    let before = keys.iter().filter(own).rfind(|key| key.t <= t);
    let after = keys.iter().filter(own).find(|key| key.t > t);
    match (before, after) {
        (Some(a), Some(b)) => Some(mix(&a.value, &b.value, (t - a.t) / (b.t - a.t))),
        (Some(one), None) | (None, Some(one)) => Some(one.value),
        (None, None) => None,
    }
}

fn parse_pedal(name: &str) -> Result<Pedal, String> {
    Ok(match name {
        "clutch" => Pedal::Clutch,
        "coag" => Pedal::Coag,
        "operator_present" => Pedal::OperatorPresent,
        "camera" => Pedal::Camera,
        "camera_plus" => Pedal::CameraPlus,
        "camera_minus" => Pedal::CameraMinus,
        _ => {
            return Err(format!(
                "\"{name}\" is no pedal, expected clutch, coag, operator_present, camera, camera_plus or camera_minus"
            ))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_move_evenly_and_arms_apart() {
        let text = "0 pose 0 0 0 0 0 0\n1 MTMR pose 0.1 0 0 0 0 1 # right\n\n2 gripper 0\n4 gripper 1\n";
        let script = Script::parse("a.txt", text).unwrap();
        let half = script.pose("MTMR", 0.5).unwrap();
        assert!((half.translation.x - 0.05).abs() < 1e-12 && (half.rotation.euler_angles().2 - 0.5).abs() < 1e-12);
        assert_eq!(script.pose("MTML", 0.5).unwrap(), Isometry3::identity());
        let gripper = [0.0, 3.0, 9.0].map(|t| script.gripper("MTML", t));
        assert_eq!(gripper, [Some(0.0), Some(0.5), Some(1.0)]);
        assert_eq!(Script::default().pose("MTMR", 0.0), None);
    }

    #[test]
    fn events_happen_once_a_round() {
        let script = Script::parse("a", "0 press clutch\n0.5 MTMR fault\n1 loop").unwrap();
        assert_eq!(script.events(-1.0, 0.001), [(None, &Event::Press(Pedal::Clutch))]);
        assert_eq!(script.events(0.001, 0.5), []);
        let later = [(Some("MTMR"), &Event::Fault), (None, &Event::Press(Pedal::Clutch))];
        assert_eq!(script.events(0.5, 1.25), later);
        assert_eq!(script.events(7.25, 7.75), [(Some("MTMR"), &Event::Fault)]);
    }

    #[test]
    fn errors_say_where() {
        for (text, word) in [
            ("0 pose 1 2 3", "six numbers"),
            ("1 fault\n0 fault", "a:2"),
            ("x fault", "no time"),
            ("0 press pedal", "camera_plus"),
            ("0 dance", "expected one of pose"),
            ("0 gripper 2", "closed"),
            ("0", "not understood"),
            ("0 loop", "not understood"),
            ("0 dialect klingon", "legacy"),
        ] {
            let error = Script::parse("a", text).unwrap_err().to_string();
            assert!(error.starts_with("a:") && error.contains(word), "{text}: {error}");
        }
    }
}
