//! Section `keyframe`: states with names.

use std::collections::HashMap;

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use super::body::Bodies;
use super::convert::{body_identifier, joint_identifier};
use super::joint::{Joint, Kind};
use super::settings::finish;
use super::source::Source;
use crate::adf::{Keyframe, Limits, Model, ProblemKind};
use crate::xml::Element;

/// A joint of the file as one of the model.
struct Coordinate<'b, 'a> {
    joint: &'b Joint<'a>,
    /// Where its joint stands in the model's list, or its body, if it is free. `None`: it was left out.
    index: Option<usize>,
    /// rad or m.
    limits: Option<Limits>,
    /// Where the body stands as it is written.
    start: Isometry3<f64>,
    /// Centre of mass in the body's frame, m.
    centre: Vector3<f64>,
}

impl Coordinate<'_, '_> {
    /// How many numbers of `qpos` and `qvel` are its own.
    fn sizes(&self) -> [usize; 2] {
        match self.joint.kind {
            Kind::Free => [7, 6],
            Kind::Ball => [4, 3],
            Kind::Slide | Kind::Hinge => [1, 1],
        }
    }

    /// A position within the limits, which are hard here.
    fn within(&self, position: f64, element: &Element<'_>) -> f64 {
        let Some(Limits { low, high }) = self.limits else { return position };
        if !(low..=high).contains(&position) {
            let found = format!("{position} for {}", self.joint.name);
            let expected = format!("its limits, {low} to {high}");
            element.warn(ProblemKind::OutOfRange, "qpos", &found, &expected, "the nearest one is used");
        }
        position.clamp(low, high)
    }
}

/// The states of a description; `model` has its bodies and joints.
pub(super) fn read<'a>(
    sections: &[Element<'a>],
    source: &Source<'a>,
    bodies: &Bodies<'a>,
    model: &Model,
) -> Vec<Keyframe> {
    let joints: HashMap<&str, usize> =
        model.joints.iter().enumerate().map(|(index, joint)| (joint.common.identifier.as_str(), index)).collect();
    let made: HashMap<&str, usize> =
        model.bodies.iter().enumerate().map(|(index, body)| (body.common.identifier.as_str(), index)).collect();
    let coordinates: Vec<Coordinate<'_, 'a>> = bodies
        .all
        .iter()
        .flat_map(|body| body.joints.iter().map(move |joint| (body, joint)))
        .map(|(body, joint)| {
            let own = made.get(body_identifier(&body.name).as_str()).copied();
            let centre = own.and_then(|index| model.bodies[index].inertial_offset);
            let index = match joint.kind {
                Kind::Free => own,
                _ => joints.get(joint_identifier(&joint.name).as_str()).copied(),
            };
            let limits = index.filter(|_| joint.has_coordinate()).and_then(|index| model.joints[index].limits);
            Coordinate {
                joint,
                index,
                limits: limits.filter(|limits| limits.low <= limits.high),
                start: body.in_world,
                centre: centre.unwrap_or_default().translation.vector,
            }
        })
        .collect();
    let mut keyframes = Vec::new();
    for section in sections {
        finish(section, &[], &[], &["key"]);
        for element in source.children(section, "key") {
            let unused = [
                ("a key sets joints and free bodies", &["time", "act", "mpos", "mquat"][..]),
                ("commands are not part of a state", &["ctrl"][..]),
            ];
            finish(&element, &["name", "qpos", "qvel"], &unused, &[]);
            let name = match element.attribute("name") {
                Some(_) => element.need_name("name", "a name").to_owned(),
                None => keyframes.len().to_string(),
            };
            keyframes.extend(key(&element, name, &coordinates));
        }
    }
    keyframes
}

/// `None`, reported, if it does not fit the joints.
fn key(element: &Element<'_>, name: String, coordinates: &[Coordinate<'_, '_>]) -> Option<Keyframe> {
    let numbers = |name: &'static str, of: usize| -> Option<Vec<f64>> {
        let numbers = element.numbers_in(name, 0..=usize::MAX)?;
        let wanted: usize = coordinates.iter().map(|coordinate| coordinate.sizes()[of]).sum();
        if numbers.len() == wanted {
            return Some(numbers);
        }
        let (found, expected) = (format!("{} numbers", numbers.len()), format!("{wanted}, those of all joints"));
        element.error(ProblemKind::OutOfRange, name, &found, &expected, "the key is left out");
        None
    };
    let given = |name: &'static str, of| match element.attribute(name) {
        Some(_) => numbers(name, of).map(Some),
        None => Some(None),
    };
    let (positions, rates) = (given("qpos", 0)?, given("qvel", 1)?);
    let mut frame = Keyframe { name, ..Keyframe::default() };
    let [mut first_position, mut first_rate] = [0, 0];
    for coordinate in coordinates {
        let [size, rate_size] = coordinate.sizes();
        let own = positions.as_ref().map(|numbers| &numbers[first_position..first_position + size]);
        let rates = rates.as_ref().map(|numbers| &numbers[first_rate..first_rate + rate_size]);
        (first_position, first_rate) = (first_position + size, first_rate + rate_size);
        let Some(index) = coordinate.index else { continue };
        match coordinate.joint.kind {
            Kind::Hinge | Kind::Slide => {
                frame.positions.extend(own.map(|own| (index, coordinate.within(own[0], element))));
                frame.rates.extend(rates.map(|rates| (index, rates[0])));
            }
            Kind::Free => {
                let pose =
                    own.map(|own| Isometry3::from_parts(Vector3::new(own[0], own[1], own[2]).into(), turn(&own[3..])));
                frame.poses.extend(pose.map(|pose| (index, pose)));
                frame.twists.extend(rates.map(|rates| {
                    // The velocity is that of the body frame in the world, the angular velocity in the body frame.
                    let rotation = pose.unwrap_or(coordinate.start).rotation;
                    let angular = rotation * Vector3::new(rates[3], rates[4], rates[5]);
                    let linear =
                        Vector3::new(rates[0], rates[1], rates[2]) + angular.cross(&(rotation * coordinate.centre));
                    (index, [linear, angular])
                }));
            }
            Kind::Ball => {
                let turns = own.is_some_and(|own| turn(own) != UnitQuaternion::identity());
                if turns || rates.is_some_and(|rates| rates.iter().any(|rate| *rate != 0.0)) {
                    let why = format!("the ball joint {} has no coordinate, and stays as it is", coordinate.joint.name);
                    element.ignored(if turns { "qpos" } else { "qvel" }, &why);
                }
            }
        }
    }
    Some(frame)
}

/// The rotation of a quaternion w, x, y, z; none of one of length 0, as in MuJoCo.
fn turn(numbers: &[f64]) -> UnitQuaternion<f64> {
    let quaternion = Quaternion::new(numbers[0], numbers[1], numbers[2], numbers[3]);
    UnitQuaternion::try_new(quaternion, f64::MIN_POSITIVE).unwrap_or_default()
}
