//! Serial chains by the product of exponentials (Lynch and Park 2017, chapters 4 and 5):
//! T(q) = exp(S₁θ₁) … exp(Sₙθₙ) M, with screws S in the base frame and θ = ratio · q + offset.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3, Vector6};
use thiserror::Error;

use super::{Coordinates, Jacobian, MAX_JOINTS};

/// How a joint moves what follows it, in the base frame while all joints are at their references.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Rotation about a line.
    Revolute {
        /// Direction of the line.
        axis: Unit<Vector3<f64>>,
        /// A point of it, m.
        point: Point3<f64>,
    },
    /// Translation.
    Prismatic {
        /// Direction.
        axis: Unit<Vector3<f64>>,
    },
}

impl Motion {
    /// The displacement by an angle (rad) or a distance (m).
    pub fn displacement(&self, by: f64) -> Isometry3<f64> {
        match self {
            Self::Revolute { axis, point } => {
                let rotation = UnitQuaternion::from_axis_angle(axis, by);
                Isometry3::from_parts((point.coords - rotation * point.coords).into(), rotation)
            }
            Self::Prismatic { axis } => Translation3::from(axis.into_inner() * by).into(),
        }
    }

    /// The same joint seen after the displacement `by`.
    fn moved(&self, by: &Isometry3<f64>) -> Self {
        match self {
            Self::Revolute { axis, point } => Self::Revolute { axis: by.rotation * axis, point: by * point },
            Self::Prismatic { axis } => Self::Prismatic { axis: by.rotation * axis },
        }
    }

    /// Twist of a unit speed: velocity of the point of the moved body that is at `place`, then angular velocity.
    fn twist_at(&self, place: &Vector3<f64>) -> Vector6<f64> {
        let (linear, angular) = match self {
            Self::Revolute { axis, point } => (axis.cross(&(place - point.coords)), axis.into_inner()),
            Self::Prismatic { axis } => (axis.into_inner(), Vector3::zeros()),
        };
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }
}

/// A joint of a [`Chain`]: θ = ratio · q\[coordinate\] + offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChainJoint {
    /// How it moves.
    pub motion: Motion,
    /// Which coordinate moves it.
    pub coordinate: usize,
    /// 1 for a joint that is a coordinate itself; joints of a parallelogram may follow with another.
    pub ratio: f64,
    /// Less the reference of the joint, rad or m.
    pub offset: f64,
}

/// Why a chain is of no use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum ChainError {
    /// Error when there are more coordinates than [`MAX_JOINTS`].
    #[error("{0} joints, expected 1 to {MAX_JOINTS}")]
    Count(usize),
    /// Error when a joint follows a coordinate that the arm lacks.
    #[error("a joint follows coordinate {coordinate} of {count}")]
    Coordinate {
        /// That coordinate, from 0.
        coordinate: usize,
        /// How many there are.
        count: usize,
    },
}

/// Joints from a base to a control point.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    joints: Vec<ChainJoint>,
    count: usize,
    home: Isometry3<f64>,
}

impl Chain {
    /// A chain of `count` coordinates; `home`: the control point in the base while all θ are 0.
    ///
    /// # Errors
    /// [`ChainError`].
    pub fn new(count: usize, joints: Vec<ChainJoint>, home: Isometry3<f64>) -> Result<Self, ChainError> {
        if !(1..=MAX_JOINTS).contains(&count) {
            return Err(ChainError::Count(count));
        }
        match joints.iter().find(|joint| joint.coordinate >= count) {
            Some(joint) => Err(ChainError::Coordinate { coordinate: joint.coordinate, count }),
            None => Ok(Self { joints, count, home }),
        }
    }

    /// Number of coordinates.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The same chain with its control point moved by `tip`, in the tool's frame.
    pub fn with_tip(mut self, tip: &Isometry3<f64>) -> Self {
        self.home *= tip;
        self
    }

    /// The control point in the base.
    pub fn forward(&self, q: &Coordinates) -> Isometry3<f64> {
        self.joints.iter().fold(Isometry3::identity(), |pose, joint| pose * joint.displacement(q)) * self.home
    }

    /// Twist of the control point in base axes, by speeds of the joints.
    pub fn jacobian(&self, q: &Coordinates) -> Jacobian {
        let place = self.forward(q).translation.vector;
        self.jacobian_at(q, &place)
    }

    /// Twist of the point that moves with the tool and is at the base's origin now, in base axes: the spatial Jacobian.
    pub fn spatial_jacobian(&self, q: &Coordinates) -> Jacobian {
        self.jacobian_at(q, &Vector3::zeros())
    }

    /// Twist of the control point in its own axes: the body Jacobian.
    pub fn body_jacobian(&self, q: &Coordinates) -> Jacobian {
        let to_tool = self.forward(q).rotation.inverse();
        let mut jacobian = self.jacobian(q);
        for mut column in jacobian.column_iter_mut() {
            let linear = to_tool * column.fixed_rows::<3>(0);
            let angular = to_tool * column.fixed_rows::<3>(3);
            column.fixed_rows_mut::<3>(0).copy_from(&linear);
            column.fixed_rows_mut::<3>(3).copy_from(&angular);
        }
        jacobian
    }

    fn jacobian_at(&self, q: &Coordinates, place: &Vector3<f64>) -> Jacobian {
        let mut jacobian = Jacobian::zeros();
        let mut before = Isometry3::identity();
        for joint in &self.joints {
            let twist = joint.motion.moved(&before).twist_at(place) * joint.ratio;
            let mut column = jacobian.column_mut(joint.coordinate);
            column += twist;
            before *= joint.displacement(q);
        }
        jacobian
    }
}

impl ChainJoint {
    fn displacement(&self, q: &Coordinates) -> Isometry3<f64> {
        self.motion.displacement(self.ratio * q[self.coordinate] + self.offset)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{coordinates, random_psm, Random};
    use super::super::{DhTable, Instrument};
    use super::*;

    /// Velocity of the pose by central differences: linear, angular, base axes.
    fn difference(chain: &Chain, q: &Coordinates, joint: usize) -> Vector6<f64> {
        const STEP: f64 = 1e-6;
        let at = |by: f64| {
            let mut moved = *q;
            moved[joint] += by;
            chain.forward(&moved)
        };
        let (after, before) = (at(STEP), at(-STEP));
        let linear = (after.translation.vector - before.translation.vector) / (2.0 * STEP);
        let angular = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * STEP);
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    #[test]
    fn jacobians_are_derivatives() {
        let chain = DhTable::psm(&Instrument::LARGE_NEEDLE_DRIVER).chain();
        let mut random = Random::new(7);
        for _ in 0..200 {
            let q = random_psm(&mut random);
            let pose = chain.forward(&q);
            let (jacobian, body, spatial) = (chain.jacobian(&q), chain.body_jacobian(&q), chain.spatial_jacobian(&q));
            for joint in 0..6 {
                let expected = difference(&chain, &q, joint);
                assert!((jacobian.column(joint) - expected).norm() < 1e-8);
                let turned = pose.rotation * body.fixed_view::<3, 1>(0, joint);
                assert!((turned - expected.fixed_rows::<3>(0)).norm() < 1e-8);
                let angular = expected.fixed_rows::<3>(3).into_owned();
                let at_origin = expected.fixed_rows::<3>(0) - angular.cross(&pose.translation.vector);
                assert!((spatial.fixed_view::<3, 1>(0, joint) - at_origin).norm() < 1e-8);
                assert!((spatial.fixed_view::<3, 1>(3, joint) - angular).norm() < 1e-8);
            }
            assert_eq!(jacobian.columns(6, 2).norm(), 0.0, "joints that the arm lacks");
        }
    }

    #[test]
    fn followers_move_with_their_coordinate() {
        // A parallelogram keeps the tool's direction: the second joint turns back what the first one turns.
        let axis = Vector3::y_axis();
        let joint = |x: f64, ratio: f64| {
            let motion = Motion::Revolute { axis, point: Point3::new(x, 0.0, 0.0) };
            ChainJoint { motion, coordinate: 0, ratio, offset: 0.0 }
        };
        let home = Isometry3::translation(1.5, 0.0, 0.0);
        let chain = Chain::new(1, vec![joint(0.0, 1.0), joint(1.0, -1.0)], home).unwrap();
        let q = coordinates(&[0.6]);
        let pose = chain.forward(&q);
        assert!(pose.rotation.angle() < 1e-12);
        let expected = Vector3::new(0.6_f64.cos() + 0.5, 0.0, -0.6_f64.sin());
        assert!((pose.translation.vector - expected).norm() < 1e-12);
        assert!((chain.jacobian(&q).column(0) - difference(&chain, &q, 0)).norm() < 1e-8);
    }

    #[test]
    fn chains_of_no_use_are_refused() {
        let motion = Motion::Prismatic { axis: Vector3::x_axis() };
        let joint = ChainJoint { motion, coordinate: 1, ratio: 1.0, offset: 0.0 };
        let new = |count| Chain::new(count, vec![joint], Isometry3::identity());
        assert_eq!(new(0), Err(ChainError::Count(0)));
        assert_eq!(new(MAX_JOINTS + 1), Err(ChainError::Count(MAX_JOINTS + 1)));
        assert_eq!(new(1), Err(ChainError::Coordinate { coordinate: 1, count: 1 }));
        assert!(new(2).is_ok());
    }
}
