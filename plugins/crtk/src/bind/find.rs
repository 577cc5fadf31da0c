//! Bodies and joints of an arm by the names in its configuration.

use ambf_model::adf::SourcePos;
use ambf_plugin::{ObjectId, ObjectType, View};
use thiserror::Error;

use crate::config::ArmConfig;
use crate::kinematics::ChainError;

/// Why an arm cannot be offered.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BindError {
    /// Error when the scene has no such object.
    #[error("{place}: {arm}: the scene has no {kind} `{name}`; there is {near}")]
    NoObject {
        /// Where the arm is configured.
        place: SourcePos,
        /// The arm.
        arm: String,
        /// What kind of object it should be.
        kind: &'static str,
        /// What it is called there.
        name: String,
        /// Names that are like it.
        near: String,
    },
    /// Error when no joints lead from the base to the tool.
    #[error("{place}: {arm}: no joints lead from the base `{base}` to the tool `{tool}`")]
    NoPath {
        /// Where the arm is configured.
        place: SourcePos,
        /// The arm.
        arm: String,
        /// Body.
        base: String,
        /// Body.
        tool: String,
    },
    /// Error when a joint has no coordinate.
    #[error("{place}: {arm}: the joint `{name}` has no single coordinate")]
    NoCoordinate {
        /// Where the arm is configured.
        place: SourcePos,
        /// The arm.
        arm: String,
        /// The joint.
        name: String,
    },
    /// Error when the chain is of no use.
    #[error("{place}: {arm}: {error}")]
    Chain {
        /// Where the arm is configured.
        place: SourcePos,
        /// The arm.
        arm: String,
        /// Why.
        error: ChainError,
    },
}

/// Looks things up for one arm.
pub(super) struct Finder<'a, 'w> {
    pub config: &'a ArmConfig,
    pub world: &'a View<'w>,
}

/// The only object whose identifier ends with the last part of a name and holds the parts before in order, such as
/// `psm1/yaw` or `psm1/JOINT yaw`; else what plugins find under the name.
pub(crate) fn look_up(world: &View<'_>, kind: ObjectType, name: &str) -> Option<usize> {
    by_parts(world, kind, name).or_else(|| world.find(kind, name))
}

fn by_parts(world: &View<'_>, kind: ObjectType, name: &str) -> Option<usize> {
    let wanted = plain_parts(name);
    let holds = |index: &usize| {
        let identifier = world.identifier(ObjectId::new(kind, *index)).unwrap_or_default();
        let has = plain_parts(&identifier);
        let mut before = has.iter().take(has.len().saturating_sub(1));
        let Some((last, first)) = wanted.split_last() else { return false };
        has.last() == Some(last) && first.iter().all(|part| before.any(|other| other == part))
    };
    let mut found = (0..world.count(kind)).filter(holds);
    let first = found.next()?;
    found.next().is_none().then_some(first)
}

/// Most names that an error offers.
const OFFERED: usize = 3;

impl Finder<'_, '_> {
    pub fn find(&self, kind: ObjectType, name: &str) -> Result<usize, BindError> {
        look_up(self.world, kind, name).ok_or_else(|| BindError::NoObject {
            place: self.config.source.clone(),
            arm: self.config.name.clone(),
            kind: if kind == ObjectType::Joint { "joint" } else { "body" },
            name: name.to_owned(),
            near: self.near(kind, name),
        })
    }

    fn near(&self, kind: ObjectType, name: &str) -> String {
        let all = (0..self.world.count(kind)).filter_map(|index| self.world.name(ObjectId::new(kind, index)));
        let mut all: Vec<(usize, String)> = all.map(|other| (edits(name, &other), other)).collect();
        all.sort();
        let names: Vec<String> = all.into_iter().take(OFFERED).map(|(_, other)| other).collect();
        if names.is_empty() {
            "none at all".into()
        } else {
            names.join(", ")
        }
    }

    pub fn joint(&self, name: &str) -> Result<usize, BindError> {
        let joint = self.find(ObjectType::Joint, name)?;
        if self.world.joint_frame(joint).is_none() {
            let (place, arm) = (self.config.source.clone(), self.config.name.clone());
            return Err(BindError::NoCoordinate { place, arm, name: name.to_owned() });
        }
        Ok(joint)
    }
}

/// Parts of a name without the word for its type, and without what is written differently in files, keys and topics.
fn plain_parts(name: &str) -> Vec<String> {
    let plain = |part: &str| {
        let part = part.trim_start_matches("BODY ").trim_start_matches("JOINT ");
        part.chars().filter(|c| !matches!(c, ' ' | '_')).collect()
    };
    name.split('/').filter(|part| !part.is_empty()).map(plain).collect()
}

/// Least number of characters that are added, removed or replaced to make one text of another (Levenshtein 1966).
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_keys_and_topics_are_compared_by_their_parts() {
        assert_eq!(plain_parts("psm1/BODY tool yaw link"), ["psm1", "toolyawlink"]);
        assert_eq!(plain_parts("/ambf/env/psm/left_jaw"), ["ambf", "env", "psm", "leftjaw"]);
    }

    #[test]
    fn likeness_of_names_is_counted_in_edits() {
        assert_eq!(edits("yaw", "yaw"), 0);
        assert_eq!(edits("jaw", "yaw"), 1);
        assert_eq!(edits("", "yaw"), 3);
        assert_eq!(edits("baselink-yawlink", "base link-yaw link"), 2);
    }
}
