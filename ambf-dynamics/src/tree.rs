//! Kinematics and dynamics of trees of bodies, as functions of their state: Jacobians, mass matrix, inverse dynamics, inverse
//! kinematics.
//!
//! They depend on masses, inertias, frames and coordinates only, not on the solver that moves the bodies: joints have no gap, and
//! friction, damping, springs, motors and contacts are not part of them. The inertia of rotors is. Couplings of joints are rows of
//! [`Tree::coupling_rows`], inverse kinematics keep to them, and nothing else here knows of them. The algorithms are those of Featherstone, *Rigid Body
//! Dynamics Algorithms* (2008): recursive Newton-Euler (§5.3), composite rigid bodies (§6.2); Jacobians §2.11 there. Quantities
//! are vectors at centres of mass in the axes of the world, not spatial vectors, so that nothing is lost far from the origin.
//!
//! Rates (n): if the base is free, first its 6: velocity of its centre of mass (x, y, z; m/s) and its angular velocity (rad/s),
//! axes of the world; then those of the joints (rad/s or m/s). Accelerations are the derivatives of these numbers, and forces what
//! makes power with them: N and N·m on the base's centre of mass, N·m or N along joints.

mod inverse;

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Matrix6xX, Translation3, Unit, UnitQuaternion, Vector3};

pub use inverse::{Goal, LimitsContradict, Reached};

/// How a link moves relative to its parent. The number is the index of the joint's coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// Not at all.
    Fixed,
    /// It turns about an axis, rad.
    Revolute(usize),
    /// It slides along an axis, m.
    Prismatic(usize),
}

/// A link and the joint to its parent. Its frame is its inertial frame: at the centre of mass, along the principal axes.
#[derive(Debug, Clone)]
pub struct Link {
    /// Index of the parent, which comes before it; the base's is not used.
    pub parent: usize,
    /// What the joint lets it do; that of the base is not used.
    pub motion: Motion,
    /// Point of the joint's axis in the parent's frame, m.
    pub pivot: Vector3<f64>,
    /// Axis of the joint in the parent's frame.
    pub axis: Unit<Vector3<f64>>,
    /// Pose of the link at coordinate 0, in axes parallel to the parent's with the origin at the pivot.
    pub rest: Isometry3<f64>,
    /// kg.
    pub mass: f64,
    /// Principal moments of inertia about the centre of mass, kg·m².
    pub inertia: Vector3<f64>,
    /// Acceleration of gravity that it feels, m/s², axes of the world.
    pub gravity: Vector3<f64>,
    /// Range of the coordinate, rad or m; infinite where there is none.
    pub limits: [f64; 2],
    /// Inertia of the joint's rotor as the joint has it, kg·m² or kg: effort = armature · acceleration of the coordinate.
    pub armature: f64,
}

/// A joint whose coordinate is the sum of those of others, each times a ratio, plus a number.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower {
    /// Index of its coordinate.
    pub coordinate: usize,
    /// Indices of the others' coordinates, and the rate of this one over that of each.
    pub leaders: Vec<(usize, f64)>,
    /// The number that is added, rad or m.
    pub offset: f64,
}

impl Link {
    /// A base: a link without a joint.
    pub fn base(mass: f64, inertia: Vector3<f64>, gravity: Vector3<f64>) -> Self {
        Self {
            parent: 0,
            motion: Motion::Fixed,
            pivot: Vector3::zeros(),
            axis: Vector3::z_axis(),
            rest: Isometry3::identity(),
            mass,
            inertia,
            gravity,
            limits: [f64::NEG_INFINITY, f64::INFINITY],
            armature: 0.0,
        }
    }
}

/// Links in a tree; the first is the base.
#[derive(Debug, Clone)]
pub struct Tree {
    links: Vec<Link>,
    is_free: bool,
    joints: usize,
    followers: Vec<Follower>,
}

impl Tree {
    /// A tree whose base is free, or stands still.
    ///
    /// # Panics
    /// If there is no link, a link comes before its parent, or the coordinates are not numbered 0, 1, … without a gap.
    pub fn new(links: Vec<Link>, is_free: bool) -> Self {
        assert!(!links.is_empty(), "a tree has a base");
        let mut numbers = Vec::new();
        for (index, link) in links.iter().enumerate().skip(1) {
            assert!(link.parent < index, "link {index} comes before its parent {}", link.parent);
            if let Motion::Revolute(number) | Motion::Prismatic(number) = link.motion {
                numbers.push(number);
            }
        }
        numbers.sort_unstable();
        assert!(numbers.iter().copied().eq(0..numbers.len()), "coordinates are numbered {numbers:?}");
        Self { links, is_free, joints: numbers.len(), followers: Vec::new() }
    }

    /// The same tree with joints that follow others.
    ///
    /// # Panics
    /// If one of their coordinates is not there, one is named twice, or one follows itself by way of others.
    #[must_use]
    pub fn with_followers(mut self, followers: Vec<Follower>) -> Self {
        let all = followers.iter().flat_map(|follower| {
            std::iter::once(follower.coordinate).chain(follower.leaders.iter().map(|(leader, _)| *leader))
        });
        assert!(all.max().is_none_or(|most| most < self.joints), "coordinates of followers");
        // Each after its leaders.
        let mut waiting: Vec<Option<Follower>> = vec![None; self.joints];
        let count = followers.len();
        for follower in followers {
            let coordinate = follower.coordinate;
            assert!(waiting[coordinate].replace(follower).is_none(), "coordinate {coordinate} follows twice");
        }
        self.followers.clear();
        while self.followers.len() < count {
            let is_next = |place: &Option<Follower>| {
                place.as_ref().is_some_and(|one| one.leaders.iter().all(|(leader, _)| waiting[*leader].is_none()))
            };
            let next = waiting.iter().position(is_next);
            let follower = next.and_then(|place| waiting[place].take());
            self.followers.push(follower.expect("a coordinate follows itself"));
        }
        self
    }

    /// Joints that follow others, each after those of its leaders that follow.
    pub fn followers(&self) -> &[Follower] {
        &self.followers
    }

    /// (followers x n) what couplings ask of the rates: the product with them is 0. A row has 1 for the follower, and minus its ratio
    /// for each of its leaders. Forces of couplings are Cᵀ·λ: those that keep accelerations in line are found with
    /// M·a + bias = forces + Cᵀ·λ, C·a = 0.
    pub fn coupling_rows(&self) -> DMatrix<f64> {
        let mut rows = DMatrix::zeros(self.followers.len(), self.rates());
        for (row, Follower { coordinate, leaders, .. }) in self.followers.iter().enumerate() {
            rows[(row, self.first_joint() + coordinate)] += 1.0;
            for &(leader, ratio) in leaders {
                rows[(row, self.first_joint() + leader)] -= ratio;
            }
        }
        rows
    }

    /// (n) what the rotors add to the diagonal of the mass matrix, kg·m² or kg.
    fn armatures(&self) -> Vec<f64> {
        let mut armatures = vec![0.0; self.rates()];
        for link in &self.links[1..] {
            if let Motion::Revolute(number) | Motion::Prismatic(number) = link.motion {
                armatures[self.first_joint() + number] = link.armature;
            }
        }
        armatures
    }

    /// The links, each after its parent.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// Whether the base is free.
    pub fn is_free(&self) -> bool {
        self.is_free
    }

    /// Number of coordinates of joints.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// Number of rates: 6 more if the base is free.
    pub fn rates(&self) -> usize {
        self.joints + self.first_joint()
    }

    fn first_joint(&self) -> usize {
        if self.is_free {
            6
        } else {
            0
        }
    }

    /// The tree with its base at a pose and its joints (rad, m) at `positions`.
    ///
    /// # Panics
    /// If there are not as many positions as [joints](Self::joints).
    pub fn posture(&self, base: &Isometry3<f64>, positions: &[f64]) -> Posture<'_> {
        assert_eq!(positions.len(), self.joints, "positions");
        let mut poses = Vec::with_capacity(self.links.len());
        let nothing = Freedom { link: 0, axis: Vector3::zeros(), about: None };
        let mut freedoms = vec![nothing; self.rates()];
        poses.push(*base);
        if self.is_free {
            for (number, freedom) in freedoms.iter_mut().take(6).enumerate() {
                let about = (number >= 3).then_some(base.translation.vector);
                *freedom = Freedom { link: 0, axis: Vector3::ith(number % 3, 1.0), about };
            }
        }
        for (index, link) in self.links.iter().enumerate().skip(1) {
            let parent: Isometry3<f64> = poses[link.parent];
            let axis = parent.rotation * link.axis.into_inner();
            let at = |along: f64| Translation3::from(link.pivot + link.axis.into_inner() * along);
            let in_parent = match link.motion {
                Motion::Fixed => at(0.0) * link.rest,
                Motion::Revolute(number) => {
                    let about = Some((parent * nalgebra::Point3::from(link.pivot)).coords);
                    freedoms[self.first_joint() + number] = Freedom { link: index, axis, about };
                    at(0.0) * (UnitQuaternion::from_axis_angle(&link.axis, positions[number]) * link.rest)
                }
                Motion::Prismatic(number) => {
                    freedoms[self.first_joint() + number] = Freedom { link: index, axis, about: None };
                    at(positions[number]) * link.rest
                }
            };
            poses.push(parent * in_parent);
        }
        Posture { tree: self, poses, freedoms }
    }

    /// (joints) ranges of the coordinates.
    pub fn limits(&self) -> Vec<[f64; 2]> {
        let mut limits = vec![[f64::NEG_INFINITY, f64::INFINITY]; self.joints];
        for link in &self.links[1..] {
            if let Motion::Revolute(number) | Motion::Prismatic(number) = link.motion {
                limits[number] = link.limits;
            }
        }
        limits
    }
}

/// One way in which a tree can move, in the axes of the world.
#[derive(Debug, Clone, Copy)]
struct Freedom {
    /// The link that it moves, with all below.
    link: usize,
    axis: Vector3<f64>,
    /// A point of the axis about which it turns; `None`: it slides.
    about: Option<Vector3<f64>>,
}

impl Freedom {
    /// Velocity of a point that moves along at a rate of 1, and angular velocity.
    fn velocity(&self, point: &Vector3<f64>) -> [Vector3<f64>; 2] {
        match self.about {
            Some(about) => [self.axis.cross(&(point - about)), self.axis],
            None => [self.axis, Vector3::zeros()],
        }
    }

    /// What a force at a point and a torque do along it.
    fn share(&self, force: &Vector3<f64>, torque: &Vector3<f64>, point: &Vector3<f64>) -> f64 {
        let [linear, angular] = self.velocity(point);
        linear.dot(force) + angular.dot(torque)
    }
}

/// Velocities or accelerations of the links' centres of mass: linear, angular; axes of the world.
type Rates = Vec<[Vector3<f64>; 2]>;

/// A [`Tree`] at one place.
#[derive(Debug, Clone)]
pub struct Posture<'a> {
    tree: &'a Tree,
    poses: Vec<Isometry3<f64>>,
    freedoms: Vec<Freedom>,
}

impl Posture<'_> {
    /// (links) poses of the links' frames in the world.
    pub fn poses(&self) -> &[Isometry3<f64>] {
        &self.poses
    }

    /// (6 x n) velocity of a point that is fixed to a link, m/s (rows 0 to 2), and angular velocity of the link, rad/s (rows 3
    /// to 5), axes of the world, for each rate. The point is given where it is in the world, m.
    ///
    /// # Panics
    /// If the link is not there.
    pub fn jacobian(&self, link: usize, point: &Vector3<f64>) -> Matrix6xX<f64> {
        let mut jacobian = Matrix6xX::zeros(self.freedoms.len());
        let carries = self.links_up(link);
        for (column, freedom) in self.freedoms.iter().enumerate().filter(|(_, freedom)| carries[freedom.link]) {
            let [linear, angular] = freedom.velocity(point);
            jacobian.fixed_view_mut::<3, 1>(0, column).copy_from(&linear);
            jacobian.fixed_view_mut::<3, 1>(3, column).copy_from(&angular);
        }
        jacobian
    }

    /// (links) whether a link is `link`, or above it.
    fn links_up(&self, link: usize) -> Vec<bool> {
        let mut is_up = vec![false; self.poses.len()];
        let mut next = link;
        is_up[next] = true;
        while next > 0 {
            next = self.tree.links[next].parent;
            is_up[next] = true;
        }
        is_up
    }

    fn centre(&self, link: usize) -> Vector3<f64> {
        self.poses[link].translation.vector
    }

    /// Inertia about the centre of mass, axes of the world, kg·m².
    fn inertia(&self, link: usize) -> Matrix3<f64> {
        let rotation = self.poses[link].rotation.to_rotation_matrix();
        rotation.matrix() * Matrix3::from_diagonal(&self.tree.links[link].inertia) * rotation.matrix().transpose()
    }

    /// (n x n) mass matrix: the kinetic energy, that of rotors included, is half of rates · M · rates. Symmetric and positive
    /// definite. Composite rigid bodies: what a rate moves is one body whose momentum the rates above it feel. Rotors add to the
    /// diagonal: they turn with their joints, and what turns the joints with them is not felt.
    pub fn mass_matrix(&self) -> DMatrix<f64> {
        let count = self.poses.len();
        let mut below: Vec<(f64, Vector3<f64>, Matrix3<f64>)> =
            (0..count).map(|link| (self.tree.links[link].mass, self.centre(link), self.inertia(link))).collect();
        for link in (1..count).rev() {
            let parent = self.tree.links[link].parent;
            below[parent] = joined(&below[parent], &below[link]);
        }
        let mut matrix = DMatrix::zeros(self.freedoms.len(), self.freedoms.len());
        for (column, freedom) in self.freedoms.iter().enumerate() {
            let (mass, centre, inertia) = &below[freedom.link];
            let [linear, angular] = freedom.velocity(centre);
            let (momentum, spin) = (linear * *mass, inertia * angular);
            let carries = self.links_up(freedom.link);
            for (row, above) in self.freedoms.iter().enumerate().filter(|(_, above)| carries[above.link]) {
                let value = above.share(&momentum, &spin, centre);
                (matrix[(row, column)], matrix[(column, row)]) = (value, value);
            }
        }
        for (index, armature) in self.tree.armatures().into_iter().enumerate() {
            matrix[(index, index)] += armature;
        }
        matrix
    }

    /// (links) velocity of the centre of mass and angular velocity.
    fn velocities(&self, rates: &[f64]) -> Rates {
        let mut found: Rates = Vec::with_capacity(self.poses.len());
        let own = self.own(rates);
        for (index, link) in self.tree.links.iter().enumerate() {
            let carried = match found.get(link.parent) {
                Some([linear, angular]) if index > 0 => {
                    [linear + angular.cross(&(self.centre(index) - self.centre(link.parent))), *angular]
                }
                _ => [Vector3::zeros(); 2],
            };
            found.push([carried[0] + own[index][0], carried[1] + own[index][1]]);
        }
        found
    }

    /// (links) what the rates of a link's own joint, or of the free base, add to its motion.
    fn own(&self, rates: &[f64]) -> Rates {
        assert_eq!(rates.len(), self.freedoms.len(), "rates");
        let mut own = vec![[Vector3::zeros(); 2]; self.poses.len()];
        for (freedom, rate) in self.freedoms.iter().zip(rates) {
            let [linear, angular] = freedom.velocity(&self.centre(freedom.link));
            own[freedom.link][0] += linear * *rate;
            own[freedom.link][1] += angular * *rate;
        }
        own
    }

    /// Kinetic energy, J.
    ///
    /// # Panics
    /// If there are not as many rates as the tree [has](Tree::rates).
    pub fn kinetic_energy(&self, rates: &[f64]) -> f64 {
        let of = |(link, [linear, angular]): (usize, &[Vector3<f64>; 2])| {
            0.5 * (self.tree.links[link].mass * linear.norm_squared() + angular.dot(&(self.inertia(link) * angular)))
        };
        let rotors = self.tree.armatures().into_iter().zip(rates).map(|(armature, rate)| 0.5 * armature * rate * rate);
        self.velocities(rates).iter().enumerate().map(of).sum::<f64>() + rotors.sum::<f64>()
    }

    /// (n) forces that give the tree these accelerations at these rates, against gravity: recursive Newton-Euler.
    ///
    /// # Panics
    /// If there are not as many rates and accelerations as the tree [has](Tree::rates).
    pub fn inverse_dynamics(&self, rates: &[f64], accelerations: &[f64]) -> DVector<f64> {
        self.newton_euler(rates, accelerations, true)
    }

    /// (n) forces that hold the tree at rest against gravity.
    pub fn gravity_forces(&self) -> DVector<f64> {
        let zeros = vec![0.0; self.freedoms.len()];
        self.newton_euler(&zeros, &zeros, true)
    }

    /// (n) forces that keep the rates as they are: those against gravity, and those of Coriolis, centrifugal and gyroscopic effects.
    ///
    /// # Panics
    /// If there are not as many rates as the tree [has](Tree::rates).
    pub fn bias_forces(&self, rates: &[f64]) -> DVector<f64> {
        self.newton_euler(rates, &vec![0.0; rates.len()], true)
    }

    /// (n) the part of [`bias_forces`](Self::bias_forces) that is not gravity's.
    ///
    /// # Panics
    /// If there are not as many rates as the tree [has](Tree::rates).
    pub fn coriolis_forces(&self, rates: &[f64]) -> DVector<f64> {
        self.newton_euler(rates, &vec![0.0; rates.len()], false)
    }

    fn newton_euler(&self, rates: &[f64], accelerations: &[f64], has_gravity: bool) -> DVector<f64> {
        let velocities = self.velocities(rates);
        let (own_velocities, own_accelerations) = (self.own(rates), self.own(accelerations));
        let count = self.poses.len();
        let mut found: Rates = vec![own_accelerations[0]; count];
        for (index, link) in self.tree.links.iter().enumerate().skip(1) {
            let [linear, angular] = found[link.parent];
            let [_, spin] = velocities[link.parent];
            let arm = self.centre(index) - self.centre(link.parent);
            let [own_linear, own_angular] = own_velocities[index];
            // The motion relative to the parent turns with it, and moves on in it; a joint's own turn about its pivot is a circle.
            let turning = own_angular.cross(&own_linear);
            found[index] = [
                linear
                    + angular.cross(&arm)
                    + spin.cross(&spin.cross(&arm))
                    + 2.0 * spin.cross(&own_linear)
                    + turning
                    + own_accelerations[index][0],
                angular + spin.cross(&own_angular) + own_accelerations[index][1],
            ];
        }
        // Wrench on each link from its parent, at its centre of mass.
        let mut wrenches: Vec<[Vector3<f64>; 2]> = (0..count)
            .map(|index| {
                let Link { mass, gravity, .. } = &self.tree.links[index];
                let ([_, spin], [linear, angular]) = (velocities[index], found[index]);
                let inertia = self.inertia(index);
                let gravity = if has_gravity { *gravity } else { Vector3::zeros() };
                [*mass * (linear - gravity), inertia * angular + spin.cross(&(inertia * spin))]
            })
            .collect();
        for index in (1..count).rev() {
            let parent = self.tree.links[index].parent;
            let ([force, torque], arm) = (wrenches[index], self.centre(index) - self.centre(parent));
            wrenches[parent][0] += force;
            wrenches[parent][1] += torque + arm.cross(&force);
        }
        let shares = self.freedoms.iter().map(|freedom| {
            let [force, torque] = &wrenches[freedom.link];
            freedom.share(force, torque, &self.centre(freedom.link))
        });
        let rotors = self.tree.armatures().into_iter().zip(accelerations).map(|(armature, by)| armature * by);
        DVector::from_iterator(self.freedoms.len(), shares.zip(rotors).map(|(share, rotor)| share + rotor))
    }
}

/// Two bodies as one: mass, centre of mass, and inertia about it.
fn joined(
    a: &(f64, Vector3<f64>, Matrix3<f64>),
    b: &(f64, Vector3<f64>, Matrix3<f64>),
) -> (f64, Vector3<f64>, Matrix3<f64>) {
    let mass = a.0 + b.0;
    if mass == 0.0 {
        return *a;
    }
    let apart = b.1 - a.1;
    let centre = a.1 + apart * (b.0 / mass);
    // Parallel axes: about the common centre of mass.
    let reduced = a.0 * b.0 / mass;
    let about = Matrix3::from_diagonal_element(apart.norm_squared()) - apart * apart.transpose();
    (mass, centre, a.2 + b.2 + about * reduced)
}

#[cfg(test)]
mod tests;
