//! Denavit-Hartenberg tables, modified convention (Craig 1986): Rot_x(α) · Trans_x(a) · Rot_z(θ) · Trans_z(d).

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{Chain, ChainJoint, EcmInverse, Motion, PsmInverse};

/// A row of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DhJoint {
    /// Turns about x, rad.
    pub alpha: f64,
    /// Along x, m.
    pub a: f64,
    /// Added to the coordinate: to θ of a revolute joint (rad), to d of a prismatic one (m).
    pub offset: f64,
    /// d of a revolute joint, m; θ of a prismatic one, rad.
    pub other: f64,
    /// Whether the coordinate is d.
    pub is_prismatic: bool,
}

impl DhJoint {
    /// A revolute joint: θ = q + `offset`.
    pub const fn revolute(alpha: f64, a: f64, offset: f64, d: f64) -> Self {
        Self { alpha, a, offset, other: d, is_prismatic: false }
    }

    /// A prismatic joint: d = q + `offset`.
    pub const fn prismatic(alpha: f64, a: f64, theta: f64, offset: f64) -> Self {
        Self { alpha, a, offset, other: theta, is_prismatic: true }
    }

    /// The frame in which the joint moves along or about z.
    fn before(&self) -> Isometry3<f64> {
        let about_x = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), self.alpha);
        // Rotation and translation with respect to one axis commute.
        Isometry3::from_parts(Translation3::new(self.a, 0.0, 0.0), about_x)
    }

    /// Pose of the joint's frame in the one before, at coordinate `q`.
    pub fn pose(&self, q: f64) -> Isometry3<f64> {
        let (theta, d) = if self.is_prismatic { (self.other, q + self.offset) } else { (q + self.offset, self.other) };
        let about_z = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), theta);
        self.before() * Isometry3::from_parts(Translation3::new(0.0, 0.0, d), about_z)
    }
}

/// Lengths of a PSM with an instrument (Intuitive's, as dVRK has them).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instrument {
    /// From the remote centre to the insertion's zero, D, m.
    pub depth: f64,
    /// From the insertion to the wrist's pitch axis, L, m.
    pub length: f64,
    /// From the wrist's pitch axis to its yaw axis, m.
    pub wrist: f64,
}

impl Instrument {
    /// 400006 on a Classic arm. On an Si, 420006 gives the same poses: D − L is 0.0156 m in both.
    pub const LARGE_NEEDLE_DRIVER: Self = Self { depth: 0.4318, length: 0.4162, wrist: 0.0091 };

    /// 420006 in the surgical robotics challenge.
    pub const CHALLENGE: Self = Self { depth: 0.4318, length: 0.4826, wrist: 0.009 };

    /// An instrument by its number, as `420006`.
    pub fn of_number(number: &str) -> Option<Self> {
        match number {
            "400006" => Some(Self::LARGE_NEEDLE_DRIVER),
            "420006" => Some(Self { depth: 0.4826, length: 0.4670, wrist: 0.0091 }),
            _ => None,
        }
    }

    /// Whether two instruments, by their numbers, are known to give the same poses.
    pub fn are_alike(one: &str, other: &str) -> bool {
        let lengths = |number| Self::of_number(number).map(|own| (own.depth - own.length, own.wrist));
        // Lengths are given to 0.1 mm.
        let near = |(a, b): ((f64, f64), (f64, f64))| (a.0 - b.0).abs() < 1e-5 && (a.1 - b.1).abs() < 1e-5;
        lengths(one).zip(lengths(other)).is_some_and(near)
    }
}

/// An arm as a table.
#[derive(Debug, Clone, PartialEq)]
pub struct DhTable {
    /// Rows, base first.
    pub joints: Vec<DhJoint>,
    /// Control point in the last joint's frame.
    pub tool: Isometry3<f64>,
}

fn turn(rows: Matrix3<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::identity(),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows)),
    )
}

impl DhTable {
    /// A patient side manipulator: yaw, pitch, insertion, roll, wrist pitch, wrist yaw. Control point: wrist yaw axis.
    pub fn psm(instrument: &Instrument) -> Self {
        let Instrument { depth, length, wrist } = *instrument;
        let joints = vec![
            DhJoint::revolute(FRAC_PI_2, 0.0, FRAC_PI_2, 0.0),
            DhJoint::revolute(-FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0),
            DhJoint::prismatic(FRAC_PI_2, 0.0, 0.0, -depth),
            DhJoint::revolute(0.0, 0.0, 0.0, length),
            DhJoint::revolute(-FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0),
            DhJoint::revolute(-FRAC_PI_2, wrist, -FRAC_PI_2, 0.0),
        ];
        Self { joints, tool: turn(Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0)) }
    }

    /// An endoscope manipulator: yaw, pitch, insertion, roll. `up_down`: angle of the endoscope's view, rad about X
    /// (0 straight, ±30° for up and down endoscopes).
    pub fn ecm(up_down: f64) -> Self {
        let joints = vec![
            DhJoint::revolute(FRAC_PI_2, 0.0, FRAC_PI_2, 0.0),
            DhJoint::revolute(-FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0),
            DhJoint::prismatic(FRAC_PI_2, 0.0, 0.0, -EcmInverse::DEPTH),
            DhJoint::revolute(0.0, 0.0, 0.0, EcmInverse::LENGTH),
        ];
        let straight = turn(Matrix3::new(0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0));
        Self { joints, tool: straight * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), up_down) }
    }

    /// A master: seven revolute joints, from dVRK's table in the standard convention, written in the modified one.
    pub fn mtm() -> Self {
        let joints = vec![
            DhJoint::revolute(0.0, 0.0, -FRAC_PI_2, 0.0),
            DhJoint::revolute(FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0),
            DhJoint::revolute(0.0, 0.2794, FRAC_PI_2, 0.0),
            DhJoint::revolute(-FRAC_PI_2, 0.3645, 0.0, 0.1506),
            DhJoint::revolute(FRAC_PI_2, 0.0, 0.0, 0.0),
            DhJoint::revolute(-FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0),
            DhJoint::revolute(FRAC_PI_2, 0.0, FRAC_PI_2, 0.0),
        ];
        Self { joints, tool: Isometry3::identity() }
    }

    /// Control point in the base, row by row: what [`Chain::forward`] computes in another way.
    pub fn forward(&self, q: &[f64]) -> Isometry3<f64> {
        let pose = self.joints.iter().zip(q).fold(Isometry3::identity(), |pose, (joint, &q)| pose * joint.pose(q));
        pose * self.tool
    }

    /// The table as a chain.
    ///
    /// # Panics
    /// With no rows, or more than [`MAX_JOINTS`](super::MAX_JOINTS).
    pub fn chain(&self) -> Chain {
        let mut pose = Isometry3::identity();
        let mut joints = Vec::with_capacity(self.joints.len());
        for (coordinate, joint) in self.joints.iter().enumerate() {
            let frame = pose * joint.before();
            let axis = frame.rotation * Vector3::z_axis();
            let motion = if joint.is_prismatic {
                Motion::Prismatic { axis }
            } else {
                Motion::Revolute { axis, point: frame * Point3::origin() }
            };
            joints.push(ChainJoint { motion, coordinate, ratio: 1.0, offset: 0.0 });
            pose *= joint.pose(0.0);
        }
        Chain::new(self.joints.len(), joints, pose * self.tool).expect("a table has a row a coordinate")
    }
}

impl From<&Instrument> for PsmInverse {
    fn from(instrument: &Instrument) -> Self {
        Self { gap: instrument.depth - instrument.length, wrist: instrument.wrist, tip: Isometry3::identity() }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Quaternion;

    use super::super::testing::{coordinates, gap, random_psm, Random};
    use super::*;

    fn pose(p: [f64; 3], [x, y, z, w]: [f64; 4]) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Isometry3::from_parts(Translation3::new(p[0], p[1], p[2]), rotation)
    }

    /// Joint positions; place with either of dVRK's instruments and with that of the challenge; rotation: computed from
    /// the tables of their files by other programs.
    #[allow(clippy::type_complexity, clippy::approx_constant, reason = "a table, as it was printed")]
    const PSM: [([f64; 6], [f64; 3], [f64; 3], [f64; 4]); 3] = [
        ([0.0, 0.0, 0.12, 0.0, 0.0, 0.0], [0.0, 0.0, -0.1135], [0.0, 0.0, -0.1798], [0.707107, 0.707107, 0.0, 0.0]),
        (
            [0.1, -0.2, 0.15, 0.3, -0.4, 0.5],
            [0.014945, 0.031684, -0.138463],
            [0.021422, 0.044821, -0.203133],
            [0.779083, 0.490896, 0.389079, 0.025857],
        ),
        (
            [-0.5, 0.4, 0.2, -1.2, 0.6, -0.7],
            [-0.080194, -0.076448, -0.156782],
            [-0.109528, -0.102255, -0.210369],
            [0.077858, 0.812559, -0.574344, 0.061768],
        ),
    ];

    #[test]
    fn poses_of_a_psm_are_the_known_ones() {
        for (q, classic, challenge, rotation) in PSM {
            let expected = [
                (Instrument::of_number("400006").unwrap(), classic),
                (Instrument::of_number("420006").unwrap(), classic),
                (Instrument::CHALLENGE, challenge),
            ];
            for (instrument, position) in expected {
                let table = DhTable::psm(&instrument);
                let expected = pose(position, rotation);
                assert!(gap(&table.forward(&q), &expected) < 3e-6);
                assert!(gap(&table.chain().forward(&coordinates(&q)), &expected) < 3e-6);
            }
        }
    }

    #[test]
    fn poses_of_an_ecm_are_the_known_ones() {
        let table = DhTable::ecm(0.0);
        for (q, [x, y, z]) in
            [([0.0, 0.0, 0.05, 0.0], [0.0, 0.0, -0.0507]), ([0.1, -0.2, 0.1, 0.3], [0.009853, 0.020006, -0.0982])]
        {
            let got = table.chain().forward(&coordinates(&q)).translation.vector;
            assert!((got - Vector3::new(x, y, z)).norm() < 1e-6, "{got}");
        }
    }

    #[test]
    fn exponentials_and_rows_agree() {
        let mut random = Random::new(3);
        let table = DhTable::psm(&Instrument::CHALLENGE);
        for _ in 0..1000 {
            let q = random_psm(&mut random);
            assert!(gap(&table.forward(q.as_slice()), &table.chain().forward(&q)) < 1e-12);
        }
    }

    #[test]
    fn the_master_agrees_with_the_standard_convention() {
        // dVRK's table: θ offset, d, a, α; rotate and move along z, then along x.
        const ROWS: [[f64; 4]; 7] = [
            [-FRAC_PI_2, 0.0, 0.0, FRAC_PI_2],
            [-FRAC_PI_2, 0.0, 0.2794, 0.0],
            [FRAC_PI_2, 0.0, 0.3645, -FRAC_PI_2],
            [0.0, 0.1506, 0.0, FRAC_PI_2],
            [0.0, 0.0, 0.0, -FRAC_PI_2],
            [-FRAC_PI_2, 0.0, 0.0, FRAC_PI_2],
            [FRAC_PI_2, 0.0, 0.0, 0.0],
        ];
        let standard = |q: &[f64]| {
            ROWS.iter().zip(q).fold(Isometry3::identity(), |pose, (&[offset, d, a, alpha], q)| {
                let about_z = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q + offset);
                let about_x = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), alpha);
                let along_x = Isometry3::from_parts(Translation3::new(a, 0.0, d), about_x);
                pose * Isometry3::from_parts(Translation3::identity(), about_z) * along_x
            })
        };
        let chain = DhTable::mtm().chain();
        let mut random = Random::new(29);
        for _ in 0..1000 {
            let q = [(); 7].map(|()| random.within(-1.5, 1.5));
            assert!(gap(&standard(&q), &chain.forward(&coordinates(&q))) < 1e-12);
        }
    }

    #[test]
    fn the_master_reaches_as_far_as_its_links() {
        // Standard convention: 0.2794 m down, 0.3645 m out, 0.1506 m of platform.
        let home = DhTable::mtm().chain().forward(&coordinates(&[0.0; 7]));
        assert!((home.translation.vector - Vector3::new(0.0, -0.3645, -0.2794 + 0.1506)).norm() < 1e-12, "{home}");
    }
}
