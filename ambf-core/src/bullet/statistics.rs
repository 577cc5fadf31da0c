use ambf_dynamics::ffi as sys;

use super::World;

/// Counters of [`Solver::Accurate`](super::Solver::Accurate) since they were taken the last time: sums over islands
/// and sub-steps, and maxima. They are 0 in worlds with another solver.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SolverStatistics {
    /// Islands whose complementarity problem was solved to tolerance.
    pub islands_solved: u64,
    /// Islands whose complementarity problem was solved approximately within the budget.
    pub islands_approximate: u64,
    /// Islands solved by sequential impulses.
    pub islands_iterated: u64,
    /// Solved position problems.
    pub position_problems: u64,
    /// Sub-steps that were [divided](World::step) because jointed bodies turn fast.
    pub divided_sub_steps: u64,
    /// Rows of all complementarity problems.
    pub rows: u64,
    /// Factorisations of the matrix of a problem or of its active set.
    pub factorisations: u64,
    /// Changes of the active set.
    pub pivots: u64,
    /// Sweeps of projected Gauss-Seidel.
    pub sweeps: u64,
    /// Multiplications of all solutions, of velocities and of positions: what the
    /// [budget](super::AccurateSettings::budget_per_row) counts.
    pub multiplications: f64,
    /// Largest violation of complementarity of a solution, m/s or rad/s.
    pub residual: f64,
    /// Largest position error along one axis of a joint that is a constraint, m. Joints of articulations are exact and
    /// do not count.
    pub joint_gap: f64,
    /// Largest orientation error about one axis of such a joint, rad.
    pub joint_angle: f64,
    /// Largest penetration depth of a contact whose island was solved, m.
    pub penetration: f64,
}

impl World {
    /// Reads the statistics of the solver and resets them to 0. [`save`](World::save) saves them too.
    pub fn take_statistics(&mut self) -> SolverStatistics {
        let mut raw = sys::AmbSolverStatistics::default();
        // SAFETY: the world is alive and was made with the engine; the struct is written before the call returns.
        unsafe { sys::amb_world_take_statistics(self.raw.as_ptr(), &mut raw) }
        SolverStatistics {
            islands_solved: raw.islands_solved,
            islands_approximate: raw.islands_approximate,
            islands_iterated: raw.islands_iterated,
            position_problems: raw.position_problems,
            divided_sub_steps: raw.divided_sub_steps,
            rows: raw.rows,
            factorisations: raw.factorisations,
            pivots: raw.pivots,
            sweeps: raw.sweeps,
            multiplications: raw.multiplications,
            residual: raw.residual,
            joint_gap: raw.joint_gap,
            joint_angle: raw.joint_angle,
            penetration: raw.penetration,
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::super::tests::{ball, hinge};
    use super::super::{AccurateSettings, Constraint, RigidBody, Shape, Solver};
    use super::*;

    #[test]
    fn penetration_and_problems_are_counted_and_taken() {
        let mut world = World::new(Solver::Accurate);
        world.set_gravity(Vector3::new(0.0, 0.0, -9.81));
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), 0.0, 0.0), ..ball(0.0, 0.0) });
        world.add_body(RigidBody { pose: Isometry3::translation(0.0, 0.0, 0.09), ..ball(1.0, 0.0) });
        world.step(0.001, 1, 0.001);
        let found = world.take_statistics();
        assert_eq!((found.islands_solved, found.islands_iterated, found.rows), (1, 0, 3), "{found:?}");
        assert!((found.penetration - 0.01).abs() < 1e-9, "{found:?}");
        assert_eq!(world.take_statistics(), SolverStatistics::default());
    }

    /// The bounding boxes of two balls of radius 1 m on the ground overlap at both distances.
    #[test]
    fn islands_are_of_bodies_that_touch() {
        let islands = |along: f64| {
            let mut world = World::with_articulations(Solver::Accurate);
            world.set_gravity(Vector3::new(0.0, 0.0, -9.81));
            world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), 0.0, 0.0), ..ball(0.0, 0.0) });
            for at in [0.0, along] {
                let pose = Isometry3::translation(at, at, 1.0);
                world.add_body(RigidBody { pose, shape: Shape::sphere(1.0, 0.0), ..ball(1.0, 0.0) });
            }
            world.step(0.001, 1, 0.001);
            world.take_statistics().islands_solved
        };
        assert_eq!((islands(1.5), islands(1.41)), (2, 1));
    }

    fn run(world: &mut World, steps: u32) {
        for _ in 0..steps {
            world.step(0.001, 1, 0.001);
        }
    }

    /// Factorisations in 0.1 s of a body of 1 kg that has lain on the ground for a while, and the islands that were
    /// solved in that time.
    fn factorisations_at_rest(shape: Shape, height: f64) -> (u64, u64) {
        let mut world = World::new(Solver::Accurate);
        world.set_solver_settings(&AccurateSettings::solver_settings(world.solver_settings()));
        world.set_gravity(Vector3::new(0.0, 0.0, -9.81));
        let ground = Shape::cuboid(Vector3::new(1.0, 1.0, 0.05), 0.0);
        let pose = Isometry3::translation(0.0, 0.0, -0.05);
        world.add_body(RigidBody { pose, shape: ground, friction: 0.5, rolling_friction: 0.1, ..ball(0.0, 0.0) });
        let pose = Isometry3::translation(0.0, 0.0, height);
        let inertia = shape.inertia(1.0);
        world.add_body(RigidBody { pose, inertia, shape, friction: 0.5, rolling_friction: 0.1, ..ball(1.0, 0.0) });
        run(&mut world, 1000);
        world.take_statistics();
        run(&mut world, 100);
        let found = world.take_statistics();
        (found.factorisations, found.islands_solved)
    }

    #[test]
    fn what_rests_needs_no_factorisation() {
        assert_eq!(factorisations_at_rest(Shape::cuboid(Vector3::new(0.2, 0.2, 0.1), 0.0), 0.1), (0, 100));
    }

    /// All points of contact of a concave mesh are new in each step: their impulses are found again by their places.
    #[test]
    fn concave_meshes_at_rest_need_few_factorisations() {
        let side = |k: u32, axis: u32, half: f64| if k >> axis & 1 == 1 { half } else { -half };
        let corners: Vec<[f64; 3]> = (0..8).map(|k| [side(k, 0, 0.2), side(k, 1, 0.2), side(k, 2, 0.1)]).collect();
        let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles: Vec<[u32; 3]> = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let mesh = Shape::concave_mesh(&corners, &triangles, 0.001).expect("triangles");
        let (factorisations, islands) = factorisations_at_rest(mesh, 0.101);
        assert!(islands == 100 && factorisations < 60, "{factorisations} in {islands} islands");
    }

    #[test]
    fn the_gap_of_a_joint_is_found() {
        let mut world = World::new(Solver::Accurate);
        let base = world.add_body(ball(0.0, 0.0));
        // Its pivot is 1 cm beside that of the base.
        let bob = world.add_body(ball(1.0, 1.01));
        world.add_constraint(base, bob, &Constraint { parameters: vec![], ..hinge() }).unwrap();
        world.step(0.001, 1, 0.001);
        let found = world.take_statistics();
        assert!((found.joint_gap - 0.01).abs() < 1e-9 && found.joint_angle < 1e-12, "{found:?}");
    }
}
