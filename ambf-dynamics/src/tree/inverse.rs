//! Inverse kinematics: coordinates of joints with which a point of a link is where it is to be.
//!
//! What is solved for are the coordinates of joints that follow no others. Those of followers are linear functions of them, and so are their
//! columns of the Jacobian, which are added to those of their leaders.

use nalgebra::{DMatrix, DVector, Isometry3, UnitQuaternion, Vector3};
use thiserror::Error;

use super::{Follower, Posture, Tree};

/// Damping that is tried first, m² or rad².
const FIRST_DAMPING: f64 = 1e-3;

/// Damping with which nothing moves any more.
const LARGEST_DAMPING: f64 = 1e12;

/// Rounding of a coordinate: by so much, relative to its size or absolute, it may be from a limit at which it counts as being.
const ROUNDING: f64 = 1e-12;

/// Most rounds in which coordinates are brought within the limits of followers.
const MOST_ROUNDS: usize = 10_000;

/// Where inverse kinematics is to bring a point of a link.
#[derive(Debug, Clone)]
pub struct Goal {
    /// Index of the link.
    pub link: usize,
    /// The frame on the link that is brought there, in the link's frame. Default: the link's own.
    pub frame: Isometry3<f64>,
    /// Where its origin is to be, m, world; `None`: anywhere.
    pub position: Option<Vector3<f64>>,
    /// How it is to be turned, world; `None`: anyhow.
    pub rotation: Option<UnitQuaternion<f64>>,
    /// Largest errors that count as reached, m and rad.
    pub tolerance: [f64; 2],
    /// Most steps.
    pub iterations: usize,
}

impl Goal {
    /// Distance by which the origin is off, and the turn by which the frame is, rad; axes of the world.
    fn error(&self, posture: &Posture<'_>) -> [Vector3<f64>; 2] {
        let frame = posture.poses[self.link] * self.frame;
        let distance = self.position.map_or_else(Vector3::zeros, |wanted| wanted - frame.translation.vector);
        let turn =
            self.rotation.map_or_else(Vector3::zeros, |wanted| (wanted * frame.rotation.inverse()).scaled_axis());
        [distance, turn]
    }

    fn is_reached(&self, error: &[Vector3<f64>; 2]) -> bool {
        error.iter().zip(&self.tolerance).all(|(part, most)| part.norm() <= *most)
    }

    fn size(&self, error: &[Vector3<f64>; 2]) -> f64 {
        error.iter().map(Vector3::norm_squared).sum()
    }

    /// Jacobian of what is wanted by the joints, and what is to be gone.
    fn equations(&self, posture: &Posture<'_>, error: &[Vector3<f64>; 2]) -> (DMatrix<f64>, DVector<f64>) {
        let point = (posture.poses[self.link] * self.frame).translation.vector;
        let jacobian = posture.jacobian(self.link, &point);
        let first = posture.tree.first_joint();
        let is_wanted = |row: &usize| if *row < 3 { self.position.is_some() } else { self.rotation.is_some() };
        let rows: Vec<usize> = (0..6).filter(is_wanted).collect();
        let wanted = DVector::from_iterator(rows.len(), rows.iter().map(|row| error[row / 3][row % 3]));
        let of_joints = jacobian.columns(first, posture.tree.joints).into_owned();
        (DMatrix::from_fn(rows.len(), posture.tree.joints, |row, column| of_joints[(rows[row], column)]), wanted)
    }
}

/// What [`Tree::inverse_kinematics`] found.
#[derive(Debug, Clone, PartialEq)]
pub struct Reached {
    /// (joints) coordinates, rad or m, within their limits; those of followers are what their leaders ask for, to rounding.
    pub positions: Vec<f64>,
    /// What is left, m.
    pub position_error: f64,
    /// What is left, rad.
    pub rotation_error: f64,
    /// Whether both are within the tolerance.
    pub reached: bool,
}

/// Error when the limits of joints that follow others leave those no coordinates at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("no coordinates of the joints are within the limits of those that follow others and of those that they follow")]
pub struct LimitsContradict {
    /// Index of the coordinate of a follower whose limits are not kept.
    pub coordinate: usize,
}

/// The coordinates of all joints as a function of those that follow none, and their limits.
pub(super) struct Folding {
    /// Coordinates that follow none.
    pub(super) free: Vec<usize>,
    /// (joints x free) rate of each coordinate over that of each free one.
    pub(super) rates: DMatrix<f64>,
    /// (joints) coordinates where the free ones are 0.
    offsets: DVector<f64>,
    /// (joints)
    limits: Vec<[f64; 2]>,
    followers: Vec<usize>,
}

impl Folding {
    pub(super) fn of(tree: &Tree) -> Self {
        let followers: Vec<usize> = tree.followers.iter().map(|follower| follower.coordinate).collect();
        let free: Vec<usize> = (0..tree.joints).filter(|joint| !followers.contains(joint)).collect();
        let mut rates = DMatrix::zeros(tree.joints, free.len());
        let mut offsets = DVector::zeros(tree.joints);
        free.iter().enumerate().for_each(|(column, joint)| rates[(*joint, column)] = 1.0);
        for Follower { coordinate, leaders, offset } in &tree.followers {
            offsets[*coordinate] = *offset;
            for &(leader, ratio) in leaders {
                let of_leader = rates.row(leader).into_owned();
                let mut row = rates.row_mut(*coordinate);
                row += of_leader * ratio;
                offsets[*coordinate] += ratio * offsets[leader];
            }
        }
        Self { free, rates, offsets, limits: tree.limits(), followers }
    }

    pub(super) fn positions(&self, free: &DVector<f64>) -> DVector<f64> {
        &self.rates * free + &self.offsets
    }

    /// Brings free coordinates to the nearest ones within their own limits.
    fn clamp(&self, free: &mut DVector<f64>) {
        for (value, joint) in free.iter_mut().zip(&self.free) {
            let [low, high] = self.limits[*joint];
            *value = value.max(low).min(high);
        }
    }

    /// How far a coordinate is beyond its limits; 0 within them, and for what is rounding.
    fn beyond(&self, joint: usize, value: f64) -> f64 {
        let [low, high] = self.limits[joint];
        let by = if value > high { value - high } else { (value - low).min(0.0) };
        if by.abs() <= ROUNDING * value.abs().max(1.0) {
            0.0
        } else {
            by
        }
    }

    /// Free coordinates near these that are within all limits: projected onto one limit after the other (Agmon 1954).
    fn feasible(&self, mut free: DVector<f64>) -> Result<DVector<f64>, LimitsContradict> {
        let mut left = None;
        for _ in 0..MOST_ROUNDS {
            self.clamp(&mut free);
            left = None;
            for &joint in &self.followers {
                let by = self.beyond(joint, self.positions(&free)[joint]);
                if by != 0.0 {
                    left = Some(joint);
                    let row = self.rates.row(joint).transpose();
                    free -= &row * (by / row.norm_squared().max(f64::MIN_POSITIVE));
                }
            }
            if left.is_none() {
                return Ok(free);
            }
        }
        left.map_or(Ok(free), |coordinate| Err(LimitsContradict { coordinate }))
    }

    /// The change of the free coordinates that the equations ask for with a damping, in which no coordinate leaves a limit at which it is.
    fn change(
        &self,
        free: &DVector<f64>,
        (jacobian, wanted): &(DMatrix<f64>, DVector<f64>),
        damping: f64,
    ) -> Option<DVector<f64>> {
        let positions = self.positions(free);
        let count = self.free.len();
        // Of all changes, those that are left.
        let mut allowed = DMatrix::identity(count, count);
        let mut is_held = vec![false; self.limits.len()];
        loop {
            let reduced = jacobian * &allowed;
            let mut matrix = reduced.tr_mul(&reduced);
            (0..count).for_each(|i| matrix[(i, i)] += damping);
            let change = &allowed * matrix.cholesky()?.solve(&reduced.tr_mul(wanted));
            let moved = &self.rates * &change;
            let leaves = |joint: &usize| {
                let ([low, high], at, by) = (self.limits[*joint], positions[*joint], moved[*joint]);
                let rounding = ROUNDING * at.abs().max(1.0);
                !is_held[*joint] && ((at <= low + rounding && by < 0.0) || (at >= high - rounding && by > 0.0))
            };
            let leaving: Vec<usize> = (0..self.limits.len()).filter(leaves).collect();
            if leaving.is_empty() {
                return Some(change);
            }
            for joint in leaving {
                is_held[joint] = true;
                let row = &allowed * self.rates.row(joint).transpose();
                let norm = row.norm();
                // Where others hold it already, nothing but rounding is left of it.
                if norm > ROUNDING * self.rates.row(joint).norm() {
                    let row = row / norm;
                    allowed -= &row * row.transpose();
                }
            }
        }
    }

    /// Free coordinates after a change: each within its own limits or, where followers would leave theirs so, as far on the straight way
    /// as all limits let them go.
    fn moved(&self, free: &DVector<f64>, change: &DVector<f64>) -> DVector<f64> {
        let mut next = free + change;
        self.clamp(&mut next);
        let there = self.positions(&next);
        if self.followers.iter().all(|joint| self.beyond(*joint, there[*joint]) == 0.0) {
            return next;
        }
        let (here, by) = (self.positions(free), &self.rates * change);
        let share = (0..self.limits.len()).fold(1.0_f64, |share, joint| {
            let ([low, high], at) = (self.limits[joint], here[joint]);
            match self.beyond(joint, at + by[joint]) {
                0.0 => share,
                _ => share.min(((if by[joint] > 0.0 { high } else { low } - at) / by[joint]).max(0.0)),
            }
        });
        free + change * share
    }
}

impl Tree {
    /// Joint coordinates with which a point of a link is where `goal` says, near `start`: damped least squares
    /// (Levenberg-Marquardt; Nakamura and Hanafusa 1986), in which coordinates at a limit that they would leave stay there.
    /// [Followers](Self::followers) follow, and are within their limits, too; their numbers in `start` do not matter.
    /// The base stays where it is. It finds what is near: an answer that is not `reached` may have others at other starts.
    ///
    /// # Errors
    /// [`LimitsContradict`]; never where no joint follows another.
    ///
    /// # Panics
    /// If there are not as many coordinates as [joints](Self::joints), or the link is not there.
    pub fn inverse_kinematics(
        &self,
        base: &Isometry3<f64>,
        start: &[f64],
        goal: &Goal,
    ) -> Result<Reached, LimitsContradict> {
        assert_eq!(start.len(), self.joints, "positions");
        let folding = Folding::of(self);
        let begin = DVector::from_iterator(folding.free.len(), folding.free.iter().map(|joint| start[*joint]));
        let mut free = folding.feasible(begin)?;
        let at = |free: &DVector<f64>| self.posture(base, folding.positions(free).as_slice());
        let mut damping = FIRST_DAMPING;
        let mut posture = at(&free);
        let mut error = goal.error(&posture);
        for _ in 0..goal.iterations {
            if goal.is_reached(&error) {
                break;
            }
            let (jacobian, wanted) = goal.equations(&posture, &error);
            let equations = (jacobian * &folding.rates, wanted);
            let Some(change) = folding.change(&free, &equations, damping) else { break };
            let next = folding.moved(&free, &change);
            let next_posture = at(&next);
            let next_error = goal.error(&next_posture);
            if goal.size(&next_error) < goal.size(&error) {
                (free, posture, error) = (next, next_posture, next_error);
                damping = (damping * 0.1).max(f64::MIN_POSITIVE);
            } else {
                damping *= 10.0;
                if damping > LARGEST_DAMPING {
                    break;
                }
            }
        }
        let [position_error, rotation_error] = error.map(|part| part.norm());
        let positions = folding
            .positions(&free)
            .iter()
            .zip(&folding.limits)
            .map(|(value, [low, high])| value.max(*low).min(*high))
            .collect();
        Ok(Reached { positions, position_error, rotation_error, reached: goal.is_reached(&error) })
    }
}
