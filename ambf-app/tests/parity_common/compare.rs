//! How far two recordings of a scene are apart.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use super::reference::{BodyState, JointState, Table};

/// A largest difference and where it is.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Worst {
    pub difference: f64,
    pub step: u64,
    pub name: String,
}

impl Worst {
    fn take(&mut self, difference: f64, step: u64, name: &str) {
        // NaN must not pass as small.
        if difference > self.difference || difference.is_nan() {
            *self = Self { difference, step, name: name.into() };
        }
    }
}

/// What is compared: m, rad, m/s and rad/s of bodies; position (rad or m), velocity (per s) and effort (N·m or N) of
/// joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    Position,
    Rotation,
    Linear,
    Angular,
    JointPosition,
    JointVelocity,
    JointEffort,
}

/// For each state of `ours`, its place in `theirs`.
///
/// # Panics
/// When names, steps or times differ.
fn places<T>(ours: &Table<T>, theirs: &Table<T>) -> Vec<usize> {
    let known: HashMap<&str, usize> = ours.names.iter().enumerate().map(|(i, name)| (name.as_str(), i)).collect();
    let (mut a, mut b) = (ours.names.clone(), theirs.names.clone());
    a.sort();
    b.sort();
    assert_eq!(a, b, "names differ");
    assert_eq!(known.len(), a.len(), "a name occurs twice");
    let steps = |table: &Table<T>| table.rows.iter().map(|row| row.0).collect::<Vec<_>>();
    assert_eq!(steps(ours), steps(theirs), "steps differ");
    for (ours, theirs) in ours.rows.iter().zip(&theirs.rows) {
        assert!((ours.1 - theirs.1).abs() < 1e-9, "step {}: time {} against {}", ours.0, ours.1, theirs.1);
    }
    theirs.names.iter().map(|name| known[name.as_str()]).collect()
}

fn difference(a: &BodyState, b: &BodyState, quantity: Quantity) -> f64 {
    match quantity {
        Quantity::Position => (a.position - b.position).norm(),
        Quantity::Linear => (a.linear - b.linear).norm(),
        Quantity::Angular => (a.angular - b.angular).norm(),
        // Twice the arc sine of half the chord: exact for small angles, where the arc cosine of the product is not.
        _ => {
            let chord = (a.rotation - b.rotation).norm().min((a.rotation + b.rotation).norm());
            4.0 * (chord / 2.0).min(1.0).asin()
        }
    }
}

/// The largest difference of a quantity between the bodies of two recordings of the same steps, over the steps in
/// `range`.
pub fn compare_bodies(
    ours: &Table<BodyState>,
    theirs: &Table<BodyState>,
    quantity: Quantity,
    range: RangeInclusive<u64>,
) -> Worst {
    let places = places(ours, theirs);
    let mut worst = Worst::default();
    for (a, b) in ours.rows.iter().zip(&theirs.rows).filter(|(a, _)| range.contains(&a.0)) {
        for (i, name) in theirs.names.iter().enumerate() {
            worst.take(difference(&a.2[places[i]], &b.2[i], quantity), a.0, name);
        }
    }
    worst
}

/// The largest difference of a quantity between the joints of two recordings of the same steps, over the steps in
/// `range`.
///
/// Row 0 of prismatic joints is left out: the C++ program had not solved the slider yet and reports a number that was
/// never initialised.
pub fn compare_joints(
    ours: &Table<JointState>,
    theirs: &Table<JointState>,
    quantity: Quantity,
    range: RangeInclusive<u64>,
) -> Worst {
    let places = places(ours, theirs);
    let mut worst = Worst::default();
    for (a, b) in ours.rows.iter().zip(&theirs.rows).filter(|(a, _)| range.contains(&a.0)) {
        for (i, name) in theirs.names.iter().enumerate() {
            let (x, y) = (&a.2[places[i]], &b.2[i]);
            assert_eq!((x.kind, &x.parent, &x.child), (y.kind, &y.parent, &y.child), "joint {name}");
            if y.kind == 1 && a.0 == 0 {
                continue;
            }
            let apart = match quantity {
                Quantity::JointVelocity => (x.velocity - y.velocity).abs(),
                Quantity::JointEffort => (x.effort - y.effort).abs(),
                // The angle jumps at ±π.
                _ if matches!(y.kind, 0 | 3) => {
                    let apart = (x.position - y.position).rem_euclid(TAU);
                    apart.min(TAU - apart)
                }
                _ => (x.position - y.position).abs(),
            };
            worst.take(apart, a.0, name);
        }
    }
    worst
}

/// Names of the bodies that have moved and stand still at the end: over the last 100 steps no speed above 1 mm/s or 10
/// mrad/s.
pub fn at_rest(table: &Table<BodyState>) -> Vec<&str> {
    let (Some(first), Some(last)) = (table.rows.first(), table.rows.last()) else { return Vec::new() };
    let late: Vec<_> = table.rows.iter().filter(|row| row.0 + 100 >= last.0).collect();
    let is_still = |state: &BodyState| state.linear.norm() < 1e-3 && state.angular.norm() < 1e-2;
    let rests =
        |&i: &usize| late.iter().all(|row| is_still(&row.2[i])) && table.rows.iter().any(|row| row.2[i] != first.2[i]);
    (0..table.names.len()).filter(rests).map(|i| table.names[i].as_str()).collect()
}

/// How far (m) a body ends from where it ends in the other recording.
///
/// # Panics
/// When one of the recordings does not know it.
pub fn apart_at_end(ours: &Table<BodyState>, theirs: &Table<BodyState>, name: &str) -> f64 {
    let end = |table: &Table<BodyState>| {
        let place = table.names.iter().position(|known| known == name).unwrap_or_else(|| panic!("no `{name}`"));
        table.rows.last().expect("rows").2[place]
    };
    difference(&end(ours), &end(theirs), Quantity::Position)
}
