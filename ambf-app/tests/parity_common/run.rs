//! Runs of our program, recorded like the traces.

use ambf_app::batch::{Commands, Targets};
use ambf_core::bullet::{BodyKinematics, Solver};
use ambf_core::ids::SoftBodyId;
use ambf_core::scene::{load, Loaded, Scene, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

use super::reference::{soft_nodes, BodyState, Case, JointState, Table};

/// How a run is started.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start {
    AsWritten,
    /// Dynamic bodies stand so far (m) along x and along z from where they should, by turns forwards and backwards.
    Shifted(f64),
    /// As written, but friction starts from nothing in each step, as Bullet 3 does it.
    ColdFriction,
}

/// A run of a scene.
pub struct Recording {
    pub bodies: Table<BodyState>,
    pub joints: Table<JointState>,
    /// First step after which there was a contact point.
    pub first_contact: Option<u64>,
}

/// The scene of a trace, built without a complaint.
pub fn load_case(case: &Case, start: Start) -> Scene {
    let mut options = SceneOptions::default();
    if start == Start::ColdFriction {
        options.physics.solver = Some(Solver::SequentialImpulse);
    }
    let Loaded { scene, report } = load(&case.files, &options);
    assert_eq!(report.errors(), 0, "{report}");
    scene
}

/// Runs a scene as `ambf_batch` does and records it at `steps`, which are in rising order.
pub fn simulate(case: &Case, steps: &[u64], start: Start) -> Recording {
    let mut scene = load_case(case, start);
    if let Start::Shifted(distance) = start {
        let dynamic = scene.bodies.ids().filter(|&body| scene.bodies[body].mass > 0.0);
        for (count, body) in dynamic.collect::<Vec<_>>().into_iter().enumerate() {
            let handle = scene.world.bodies()[body.index()];
            let mut pose = scene.world.pose(handle).expect("a live body");
            let shift = if count % 2 == 0 { distance } else { -distance };
            pose.translation.vector += Vector3::new(shift, 0.0, shift);
            scene.world.set_pose(handle, &pose);
        }
    }
    let mut simulation = Simulation::new(scene, 0.001);
    let names = simulation.scene().bodies.iter().map(|body| body.identity.communication_name()).collect::<Vec<_>>();
    let commands = match &case.commands {
        Some(file) => {
            let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
            Commands::parse(&text, &file.display().to_string(), &Targets::new(simulation.scene(), &names))
                .unwrap_or_else(|error| panic!("{error}"))
        }
        None => Commands::default(),
    };
    let mut recording = Recording {
        bodies: Table { names, rows: Vec::new() },
        joints: Table { names: Vec::new(), rows: Vec::new() },
        first_contact: None,
    };
    recording.joints.names = simulation.scene().joints.iter().map(|joint| joint.name.clone()).collect();
    let mut wanted = steps.iter().copied().peekable();
    commands.apply(&mut simulation, 0, 0.001).unwrap();
    for step in 0..=case.steps {
        if step > 0 {
            simulation.update(0.001).unwrap_or_else(|error| panic!("{}: {error}", case.name));
        }
        if recording.first_contact.is_none() && simulation.scene().world.contact_count() > 0 {
            recording.first_contact = Some(step);
        }
        if wanted.next_if_eq(&step).is_some() {
            record(&simulation, step, &mut recording);
        }
        if step > 0 {
            commands.apply(&mut simulation, step, 0.001).unwrap();
        }
    }
    assert_eq!(wanted.next(), None, "{}: more rows than steps", case.name);
    recording
}

fn record(simulation: &Simulation, step: u64, recording: &mut Recording) {
    let (scene, time) = (simulation.scene(), simulation.sim_time());
    let mut states = vec![BodyKinematics::default(); scene.bodies.len()];
    scene.world.read_bodies(&mut states);
    let bodies = scene.bodies.iter().zip(&states).map(|(body, state)| {
        let pose = state.body_pose(&body.inertial_offset_inverse);
        BodyState {
            position: pose.translation.vector,
            rotation: pose.rotation.into_inner(),
            linear: Vector3::from(state.linear_velocity),
            angular: Vector3::from(state.angular_velocity),
        }
    });
    recording.bodies.rows.push((step, time, bodies.collect()));
    let names = &recording.bodies.names;
    let joints = scene.joints.iter().map(|joint| JointState {
        kind: joint.joint_type.code(),
        parent: names[joint.parent.index()].clone(),
        child: names[joint.child.index()].clone(),
        position: joint.position,
        velocity: joint.velocity,
        effort: joint.effort,
    });
    recording.joints.rows.push((step, time, joints.collect()));
}

/// Largest distance of a soft body's nodes from the trace at each recorded step, m, in rising order of steps.
pub fn soft_distances(case: &Case) -> Vec<(u64, f64)> {
    let mut simulation = Simulation::new(load_case(case, Start::AsWritten), 0.001);
    let mut nodes = vec![[0.0; 3]; simulation.scene().soft_bodies[SoftBodyId::new(0)].nodes];
    let mut distances: Vec<(u64, f64)> = Vec::new();
    let mut done = 0;
    for (step, node, theirs) in soft_nodes(case) {
        while done < step {
            simulation.update(0.001).unwrap_or_else(|error| panic!("{}: {error}", case.name));
            done += 1;
        }
        if distances.last().is_none_or(|last| last.0 != step) {
            distances.push((step, 0.0));
            let scene = simulation.scene();
            scene.soft_bodies[SoftBodyId::new(0)].read_nodes(&scene.world, &mut nodes);
        }
        let apart = (Vector3::from(nodes[node]) - theirs).norm();
        let worst = &mut distances.last_mut().expect("just pushed").1;
        // NaN must not pass as small.
        if apart > *worst || apart.is_nan() {
            *worst = apart;
        }
    }
    distances
}
