use ambf_dynamics::ffi as sys;

use super::{Solver, SolverSettings, World};

/// Settings of [`Solver::Accurate`]. The switches are independent of each other. Worlds with another solver ignore
/// them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AccurateSettings {
    /// The friction impulse of a contact is set to 0 when its normal impulse becomes 0; Bullet keeps the last one.
    /// Default: `true`.
    pub release_friction: bool,
    /// Includes CFM in the effective mass of joint rows, 1/(d·(1 + CFM)) with d = J M⁻¹ Jᵀ (implicit soft constraint);
    /// Bullet, which takes CFM as a share of d, leaves it out. Default: `true`.
    pub diagonal_cfm: bool,
    /// The separation velocity of a contact follows from its restitution, whatever the gap or penetration depth at the
    /// impact. Default: `true`.
    pub restitution: bool,
    /// Islands are solved directly if the cost is within the budget. Default: `true`.
    pub direct: bool,
    /// Minimum CFM of joint rows in the direct solution, as a share of the row's response, which regularises redundant
    /// rows. Rows of joints that turn have up to 1e-6 (`ambf-dynamics/src/island/softness.rs`). Default: 1e-9.
    pub joint_softness: f64,
    /// The same of contacts. Default: 1e-7.
    pub contact_softness: f64,
    /// The same of friction. Default: 1e-7.
    pub friction_softness: f64,
    /// An island is ill-conditioned if it has joints or articulations, or if its masses differ by more than this
    /// factor. Default: 100.
    pub mass_ratio_threshold: f64,
    /// Well-conditioned islands with more contacts than this are solved by sequential impulses if a factorisation takes
    /// more multiplications per row than [`max_direct_cost_per_row`](Self::max_direct_cost_per_row). Default: 60.
    pub max_direct_contacts: u32,
    /// See [`max_direct_contacts`](Self::max_direct_contacts). Default: 500.
    pub max_direct_cost_per_row: f64,
    /// Budget of the solutions of a sub-step in multiplications: this number for all islands, plus
    /// [`budget_per_row`](Self::budget_per_row) for each row of an island. When it is used up, the best approximation found
    /// is the result. Default: 100 000.
    pub base_budget: f64,
    /// See [`base_budget`](Self::base_budget). Default: 2e4.
    pub budget_per_row: f64,
    /// Maximum unused budget that a world saves for later solutions, such as those of impacts, in multiplications.
    /// Default: 1 000 000.
    pub max_saved_budget: f64,
}

impl Default for AccurateSettings {
    fn default() -> Self {
        Self {
            release_friction: true,
            diagonal_cfm: true,
            restitution: true,
            direct: true,
            joint_softness: 1e-9,
            contact_softness: 1e-7,
            friction_softness: 1e-7,
            mass_ratio_threshold: 100.0,
            max_direct_contacts: 60,
            max_direct_cost_per_row: 500.0,
            base_budget: 1e5,
            budget_per_row: 2e4,
            max_saved_budget: 1e6,
        }
    }
}

impl AccurateSettings {
    /// The solver settings of [`Solver::Accurate`]: two friction directions, so that friction does not depend on the
    /// direction of sliding, and a joint ERP of 0.9. The iterations apply to islands that are not solved directly.
    pub fn solver_settings(settings: SolverSettings) -> SolverSettings {
        SolverSettings {
            iterations: 10,
            minimum_batch_size: 1,
            joint_erp: 0.9,
            residual_threshold: 1e-12,
            restitution_velocity_threshold: 0.05,
            two_friction_directions: true,
            ..settings
        }
    }
}

impl World {
    /// Sets the settings of [`Solver::Accurate`].
    pub fn set_accurate(&mut self, settings: &AccurateSettings) {
        let raw = sys::AmbAccurateSettings {
            release_friction: settings.release_friction.into(),
            diagonal_cfm: settings.diagonal_cfm.into(),
            restitution: settings.restitution.into(),
            direct: settings.direct.into(),
            joint_softness: settings.joint_softness,
            contact_softness: settings.contact_softness,
            friction_softness: settings.friction_softness,
            mass_ratio_threshold: settings.mass_ratio_threshold,
            max_direct_contacts: settings.max_direct_contacts.min(i32::MAX as u32) as i32,
            max_direct_cost_per_row: settings.max_direct_cost_per_row,
            base_budget: settings.base_budget,
            budget_per_row: settings.budget_per_row,
            max_saved_budget: settings.max_saved_budget,
        };
        // SAFETY: the world is alive; the struct is read before the call returns.
        unsafe { sys::amb_world_set_accurate(self.raw.as_ptr(), &raw) }
    }

    /// Sets the default settings of the solver of a new world.
    pub(super) fn set_defaults(&mut self, solver: Solver) {
        if solver == Solver::Accurate {
            self.set_accurate(&AccurateSettings::default());
            self.set_solver_settings(&AccurateSettings::solver_settings(self.solver_settings()));
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, UnitQuaternion, Vector3};

    use super::super::tests::ball;
    use super::super::{
        BodyHandle, Constraint, ConstraintKind, ConstraintParameter, Integrator, PlausibleBounds, RigidBody, Shape,
        SolverSettings,
    };
    use super::*;

    const DT: f64 = 1e-3;
    const G: f64 = 9.81;

    fn world() -> World {
        let mut world = World::new(Solver::Accurate);
        world.set_gravity(Vector3::new(0.0, 0.0, -G));
        world.set_integrator(Integrator::RungeKutta);
        world
    }

    fn run(world: &mut World, seconds: f64) {
        for _ in 0..(seconds / DT).round() as usize {
            world.step(DT, 1, DT);
        }
    }

    fn height(world: &World, body: BodyHandle) -> f64 {
        world.pose(body).unwrap().translation.z
    }

    /// A cube of 1 m and `mass` kg with its centre at height `z`; a static one is a floor below the plane z = 0.
    fn cube(mass: f64, z: f64) -> RigidBody {
        let half = if mass > 0.0 { 0.5 } else { 50.0 };
        RigidBody {
            inertia: Vector3::repeat(mass / 6.0),
            shape: Shape::cuboid(Vector3::repeat(half), 0.04),
            pose: Isometry3::translation(0.0, 0.0, if mass > 0.0 { z } else { -half }),
            ..ball(mass, 0.0)
        }
    }

    /// Heights of the peaks between bounces of a ball that falls from 1 m.
    fn peaks(settings: &AccurateSettings, restitution: f64, n: usize) -> Vec<f64> {
        let mut world = world();
        world.set_accurate(settings);
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), 0.0, 0.0), restitution: 1.0, ..ball(0.0, 0.0) });
        let pose = Isometry3::translation(0.0, 0.0, 1.1);
        let ball = world.add_body(RigidBody { pose, restitution, ..ball(1.0, 0.0) });
        let (mut found, mut rises) = (vec![], false);
        for _ in 0..20_000 {
            world.step(DT, 1, DT);
            let (z, v) = (height(&world, ball) - 0.1, world.velocity(ball).unwrap().0.z);
            if rises && v <= 0.0 {
                // From the state just after the peak.
                found.push(z + v * v / (2.0 * G));
            }
            rises = v > 0.0;
            if found.len() == n {
                break;
            }
        }
        found
    }

    #[test]
    fn bounces_keep_the_energy_that_restitution_asks_for() {
        let elastic = peaks(&AccurateSettings::default(), 1.0, 10);
        assert!(elastic.len() == 10 && (0.995..1.002).contains(&elastic[9]), "{elastic:?}");
        let half = peaks(&AccurateSettings::default(), 0.5, 4);
        for (i, peak) in half.iter().enumerate() {
            let expected = 0.25f64.powi(i as i32 + 1);
            assert!((peak - expected).abs() < 0.002 * expected + 2e-4, "{i}: {half:?}");
        }
        let without = peaks(&AccurateSettings { restitution: false, ..AccurateSettings::default() }, 1.0, 2);
        assert!(without.iter().sum::<f64>() < 1.8, "Bullet's own loses a lot: {without:?}");
    }

    #[test]
    fn what_bounces_comes_to_rest() {
        let mut world = world();
        world.add_body(RigidBody { restitution: 0.5, ..cube(0.0, 0.0) });
        let body = world.add_body(RigidBody { restitution: 0.5, ..cube(1.0, 0.6) });
        run(&mut world, 3.0);
        let (linear, angular) = world.velocity(body).unwrap();
        assert!(linear.norm() < 1e-9 && angular.norm() < 1e-9, "{linear} {angular}");
        assert!((height(&world, body) - 0.5).abs() < 1e-4);
    }

    /// Error of the acceleration of a box that slides down a slope of 0.5 rad, relative, with its edges turned by
    /// `turn` rad.
    fn sliding_error(solver: Solver, turn: f64) -> f64 {
        let mut world = World::new(solver);
        let (slope, friction) = (0.5f64, 0.3);
        let down = Vector3::new(turn.cos(), turn.sin(), 0.0);
        world.set_gravity(down * (G * slope.sin()) - Vector3::z() * (G * slope.cos()));
        world.add_body(RigidBody { friction: 1.0, ..cube(0.0, 0.0) });
        let body = world.add_body(RigidBody { friction, ..cube(1.0, 0.5) });
        run(&mut world, 0.2);
        let before = world.velocity(body).unwrap().0;
        run(&mut world, 1.0);
        let expected = G * (slope.sin() - friction * slope.cos());
        ((world.velocity(body).unwrap().0 - before) / expected - down).norm()
    }

    #[test]
    fn sliding_boxes_accelerate_as_coulomb_says_in_every_direction() {
        for turn in [0.0, 0.3, std::f64::consts::FRAC_PI_4] {
            let error = sliding_error(Solver::Accurate, turn);
            assert!(error < 1e-4, "{turn}: {error:e}");
        }
        assert!(sliding_error(Solver::SequentialImpulse, 0.0) > 1e-3);
    }

    #[test]
    fn a_box_sticks_below_the_friction_angle() {
        let mut world = world();
        world.set_gravity(Vector3::new(G * 0.3f64.sin(), 0.0, -G * 0.3f64.cos()));
        world.add_body(RigidBody { friction: 1.0, ..cube(0.0, 0.0) });
        let body = world.add_body(RigidBody { friction: 0.4, ..cube(1.0, 0.5) });
        run(&mut world, 5.0);
        assert!(world.pose(body).unwrap().translation.x.abs() < 1e-5, "{}", world.pose(body).unwrap().translation.x);
    }

    #[test]
    fn stacks_of_very_different_masses_stand() {
        for masses in [&[1.0, 1000.0][..], &[1.0, 1.0, 1.0, 1.0, 1000.0], &[1.0, 1000.0, 1.0, 1000.0, 1.0], &[1.0; 10]]
        {
            let mut world = world();
            world.add_body(cube(0.0, 0.0));
            let bodies: Vec<_> =
                masses.iter().enumerate().map(|(i, &mass)| world.add_body(cube(mass, i as f64 + 0.5))).collect();
            run(&mut world, 5.0);
            for (i, &body) in bodies.iter().enumerate() {
                let offset = world.pose(body).unwrap().translation.vector - Vector3::z() * (i as f64 + 0.5);
                assert!(offset.norm() < 1e-3, "{masses:?}: body {i} moved {offset}");
            }
        }
    }

    /// A chain of `n` rods of 0.1 m and 1 kg from a fixed body, level at first, about the y axis.
    fn chain(world: &mut World, n: usize, erp: f64) -> Vec<BodyHandle> {
        let rod = |mass: f64, x: f64| RigidBody {
            inertia: Vector3::new(1e-4, 8.5e-4, 8.5e-4) * mass,
            shape: Shape::empty(),
            pose: Isometry3::translation(x, 0.0, 0.0),
            ..ball(mass, x)
        };
        let along = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        let mut bodies = vec![world.add_body(rod(0.0, -0.05))];
        for i in 0..n {
            bodies.push(world.add_body(rod(1.0, 0.1 * i as f64 + 0.05)));
            let at = |x: f64| Isometry3::from_parts(Vector3::new(x, 0.0, 0.0).into(), along);
            let hinge = Constraint {
                kind: ConstraintKind::Hinge { limits: None },
                frame_a: at(0.05),
                frame_b: at(-0.05),
                parameters: vec![(ConstraintParameter::Erp, erp, -1)],
                feedback: false,
                disable_collisions: true,
            };
            assert!(world.add_constraint(bodies[i], bodies[i + 1], &hinge).is_some());
        }
        bodies
    }

    /// Widest gap of the joints of a chain of `n` that swings for 1 s, m.
    fn gap(solver: Solver, settings: &AccurateSettings, n: usize) -> f64 {
        let mut world = World::new(solver);
        world.set_gravity(Vector3::new(0.0, 0.0, -G));
        world.set_accurate(settings);
        world.set_iterations(10);
        let bodies = chain(&mut world, n, 0.9);
        run(&mut world, 1.0);
        let end = |body, x: f64| world.pose(body).unwrap() * nalgebra::Point3::new(x, 0.0, 0.0);
        bodies.windows(2).map(|pair| (end(pair[0], 0.05) - end(pair[1], -0.05)).norm()).fold(0.0, f64::max)
    }

    #[test]
    fn chains_hold_together_at_any_length() {
        let settings = AccurateSettings::default();
        for n in [2, 10, 100] {
            let direct = gap(Solver::Accurate, &settings, n);
            assert!(direct < 2e-4, "{n}: {direct:e}");
        }
        let iterated = gap(Solver::Accurate, &AccurateSettings { direct: false, ..settings }, 100);
        assert!(iterated > 3.0 * gap(Solver::Accurate, &settings, 100), "{iterated:e}");
    }

    #[test]
    fn a_joint_that_exists_twice_does_no_harm() {
        let mut world = world();
        let bodies = chain(&mut world, 2, 0.9);
        let twin = Constraint {
            kind: ConstraintKind::PointToPoint,
            frame_a: Isometry3::translation(0.05, 0.0, 0.0),
            frame_b: Isometry3::translation(-0.05, 0.0, 0.0),
            parameters: vec![(ConstraintParameter::Erp, 0.9, -1)],
            feedback: true,
            disable_collisions: true,
        };
        let twins = [0, 1].map(|i| world.add_constraint(bodies[i], bodies[i + 1], &twin).unwrap());
        run(&mut world, 2.0);
        assert_eq!(world.first_lost(&PlausibleBounds::default()), None);
        for twin in twins {
            let force = world.joint_wrench(twin).unwrap().force_a.norm();
            assert!(force < 1000.0, "{force}");
        }
    }

    #[test]
    fn tall_stacks_stand() {
        let mut world = world();
        world.add_body(cube(0.0, 0.0));
        let bodies: Vec<_> = (0..40).map(|i| world.add_body(cube(1.0, f64::from(i) + 0.5))).collect();
        run(&mut world, 1.0);
        for (i, &body) in bodies.iter().enumerate() {
            let offset = world.pose(body).unwrap().translation.vector - Vector3::z() * (i as f64 + 0.5);
            assert!(offset.norm() < 2e-3, "body {i} moved {offset}");
        }
    }

    #[test]
    fn bodies_in_each_other_part_slowly() {
        for depth in [0.03, 0.2, 0.9] {
            let mut world = world();
            world.set_gravity(Vector3::zeros());
            let bodies = [0.0, 1.0 - depth].map(|z| world.add_body(cube(1.0, z)));
            run(&mut world, 1.5);
            let [a, b] = bodies.map(|body| world.velocity(body).unwrap().0);
            assert!((b - a).norm() < 1.05, "{depth}: {a} {b}");
            let apart = height(&world, bodies[1]) - height(&world, bodies[0]);
            assert!(apart > 0.999, "{depth}: {apart}");
        }
    }

    #[test]
    fn joints_return_slowly_from_beyond_their_limits() {
        // Position or angle and its speed; fastest return, and slowest where a hinge bounces: by 0.3.
        let slider = ConstraintKind::Slider { limits: Some([-0.5, 0.5]) };
        let hinge = ConstraintKind::Hinge { limits: Some([-0.5, 0.5]) };
        for (kind, start, speed, most, bounce) in [
            (&slider, 1.0, 0.0, 1.0, 0.0),
            (&slider, 0.499, 3.0, 1.0, 0.0),
            (&hinge, 1.0, 0.0, 5.0, 0.0),
            (&hinge, 0.499, 10.0, 5.0, 2.5),
            (&hinge, 0.499, 30.0, 9.1, 8.0),
        ] {
            let mut world = world();
            world.set_gravity(Vector3::zeros());
            let turns = matches!(kind, ConstraintKind::Hinge { .. });
            let base = world.add_body(ball(0.0, 0.0));
            let body = world.add_body(ball(1.0, 0.0));
            let joint = Constraint { kind: kind.clone(), ..super::super::tests::hinge() };
            let joint = Constraint { frame_a: Isometry3::identity(), frame_b: Isometry3::identity(), ..joint };
            world.add_constraint(base, body, &joint).unwrap();
            if turns {
                world.set_pose(body, &Isometry3::rotation(Vector3::z() * start));
                world.set_velocity(body, &Vector3::zeros(), &(Vector3::z() * speed));
            } else {
                world.set_pose(body, &Isometry3::translation(start, 0.0, 0.0));
                world.set_velocity(body, &(Vector3::x() * speed), &Vector3::zeros());
            }
            let mut fastest = 0.0_f64;
            for _ in 0..700 {
                run(&mut world, DT);
                let (linear, angular) = world.velocity(body).unwrap();
                fastest = fastest.max(if turns { -angular.z } else { -linear.x });
                if fastest > 0.0 && start < 0.5 {
                    break;
                }
            }
            assert!(fastest < most * 1.001 && fastest >= bounce, "{kind:?} from {start} at {speed}: {fastest}");
            let pose = world.pose(body).unwrap();
            let at = if turns { pose.rotation.angle() } else { pose.translation.x.abs() };
            assert!(at < 0.55, "{kind:?} from {start} at {speed}: {at}");
        }
    }

    #[test]
    fn elastic_crowds_gain_no_energy() {
        let mut world = world();
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), 0.0, 0.0), restitution: 1.0, ..ball(0.0, 0.0) });
        let bodies: Vec<_> = (0..64)
            .map(|i| {
                let [x, y, z] = [i % 4, i / 4 % 4, i / 16].map(f64::from);
                let pose = Isometry3::translation(0.25 * x + 0.03 * z, 0.25 * y - 0.02 * z, 0.6 + 0.25 * z);
                world.add_body(RigidBody { pose, restitution: 1.0, friction: 0.0, ..ball(1.0, 0.0) })
            })
            .collect();
        let energy = |world: &World| -> f64 {
            let of = |&body| world.velocity(body).unwrap().0.norm_squared() / 2.0 + G * height(world, body);
            bodies.iter().map(of).sum()
        };
        let before = energy(&world);
        run(&mut world, 1.0);
        let kept = energy(&world) / before;
        assert!((0.97..1.003).contains(&kept), "{kept}");
    }

    #[test]
    fn fast_spin_keeps_its_momentum() {
        let mut world = world();
        world.set_gravity(Vector3::zeros());
        let inertia = Vector3::new(0.1, 0.2, 0.3);
        let body = world.add_body(RigidBody { inertia, ..ball(1.0, 0.0) });
        world.set_velocity(body, &Vector3::zeros(), &Vector3::new(20.0, 1000.0, 20.0));
        let momentum = |world: &World| {
            let turn = world.pose(body).unwrap().rotation;
            turn * inertia.component_mul(&(turn.inverse() * world.velocity(body).unwrap().1))
        };
        let before = momentum(&world);
        run(&mut world, 1.0);
        let error = (momentum(&world) - before).norm() / before.norm();
        assert!(error < 1e-5, "{error}");
    }

    #[test]
    fn piles_settle_without_a_direct_solution() {
        let mut world = world();
        world.add_body(cube(0.0, 0.0));
        let bodies: Vec<_> = (0..64)
            .map(|i| {
                let [x, y, z] = [i % 4, i / 4 % 4, i / 16].map(f64::from);
                let pose = Isometry3::translation(1.01 * x + 0.1 * z, 1.01 * y, 0.5 + 1.02 * z);
                world.add_body(RigidBody { pose, ..cube(1.0, 0.0) })
            })
            .collect();
        run(&mut world, 1.5);
        for body in bodies {
            assert!(height(&world, body) > 0.49 && world.velocity(body).unwrap().0.norm() < 0.05);
        }
    }

    #[test]
    fn iterations_and_erp_come_with_the_solver() {
        let settings = World::new(Solver::Accurate).solver_settings();
        assert!(settings.two_friction_directions);
        assert_eq!((settings.minimum_batch_size, settings.joint_erp), (1, 0.9));
        let default: SolverSettings = World::new(Solver::default()).solver_settings();
        assert!(!default.two_friction_directions, "others keep Bullet's");
    }

    /// Where a body of three different inertias that hangs on a ball joint, tumbling, is after 0.5 s of steps of `dt`.
    fn tumbled(dt: f64) -> Vector3<f64> {
        let mut world = world();
        let post = world.add_body(RigidBody { pose: Isometry3::translation(0.0, 0.0, 2.0), ..ball(0.0, 0.0) });
        let pose = Isometry3::new(Vector3::new(0.3, 0.0, 2.0), Vector3::new(0.2, 0.1, 0.0));
        let body = world.add_body(RigidBody { inertia: Vector3::new(0.02, 0.05, 0.04), pose, ..ball(1.0, 0.0) });
        let turn = Vector3::new(4.0, 2.0, -3.0);
        world.set_velocity(body, &turn.cross(&Vector3::new(0.3, 0.0, 0.0)), &turn);
        let joint = Constraint {
            kind: ConstraintKind::PointToPoint,
            frame_a: Isometry3::identity(),
            frame_b: Isometry3::from_parts(
                (pose.inverse() * nalgebra::Point3::new(0.0, 0.0, 2.0)).coords.into(),
                UnitQuaternion::identity(),
            ),
            parameters: vec![],
            feedback: false,
            disable_collisions: true,
        };
        world.add_constraint(post, body, &joint).unwrap();
        for _ in 0..(0.5 / dt).round() as usize {
            world.step(dt, 1, dt);
        }
        world.pose(body).unwrap().translation.vector
    }

    #[test]
    fn joined_bodies_move_to_second_order() {
        let truth = tumbled(1.0 / 32_000.0);
        let [coarse, fine] = [2e-3, 1e-3].map(|dt| (tumbled(dt) - truth).norm());
        assert!(fine < 2e-5, "{fine}");
        assert!(coarse > 3.5 * fine, "{coarse} {fine}");
    }
}
