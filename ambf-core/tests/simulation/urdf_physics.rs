//! Masses, drives and surfaces of robots read from URDF, in both profiles. What an element of the format is without effect, or becomes
//! something else, showed here: links without a mass had 1 kg, a zero moment replaced the whole tensor, damping, friction, efforts and
//! velocities were not bounded, angles beyond π drove joints to their other limit, balls did not roll.

use ambf_core::comm::JointCommandType::{Effort, Position, Velocity};
use ambf_core::control::Profile;
use ambf_core::scene::{load, Loaded, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use tempfile::TempDir;

use crate::physics_common::{close, Bench, DT, HEAVY, WEIGHTLESS};

const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];

/// A simulation of texts: robots, or models of ADF.
fn bench(profile: Profile, world: &str, models: &[&str]) -> Bench {
    let folder = TempDir::new().expect("a temporary folder");
    let write = |name: String, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let name = |i: usize, text: &str| format!("m{i}.{}", if text.starts_with('<') { "urdf" } else { "yaml" });
    let files = SceneFiles {
        world: Some(write("world.yaml".into(), world)),
        models: models.iter().enumerate().map(|(i, text)| write(name(i, text), text)).collect(),
    };
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let Loaded { scene, report } = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(report.errors(), 0, "{report}");
    Bench(Simulation::new(scene, DT))
}

fn link(name: &str, mass: f64, moment: f64) -> String {
    format!(
        "<link name='{name}'><inertial><mass value='{mass}'/><inertia ixx='{moment}' iyy='{moment}' izz='{moment}' ixy='0' \
         ixz='0' iyz='0'/></inertial></link>"
    )
}

fn joint(name: &str, kind: &str, parent: &str, child: &str, axis: &str, extra: &str) -> String {
    format!(
        "<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/><axis xyz='{axis}'/>{extra}</joint>"
    )
}

/// A link of `moment` kg·m² that turns about z of the world.
fn turntable(moment: f64, kind: &str, extra: &str) -> String {
    let joint = joint("j", kind, "world", "a", "0 0 1", extra);
    format!("<robot name='r'><link name='world'/>{}{joint}</robot>", link("a", 1.0, moment))
}

/// Angular velocity of link `a` about z, rad/s.
fn spin(bench: &Bench) -> f64 {
    bench.velocity("a").1.z
}

#[test]
fn links_without_mass_have_none() {
    let slide = |name, parent, child, axis| {
        joint(name, "prismatic", parent, child, axis, "<limit lower='-99' upper='99' effort='1000'/>")
    };
    let text = format!(
        "<robot name='r'><link name='world'/><link name='x'/><link name='y'/>{}{}{}{}{}{}</robot>",
        link("base", 10.0, 0.5),
        link("arm", 2.0, 0.02),
        slide("jx", "world", "x", "1 0 0"),
        slide("jy", "x", "y", "0 1 0"),
        joint("jz", "continuous", "y", "base", "0 0 1", ""),
        joint("ja", "fixed", "base", "arm", "0 0 1", "<origin xyz='0 0 0.3'/>"),
    );
    for profile in PROFILES {
        let mut bench = bench(profile, HEAVY, &[&text]);
        let world = bench.body("world");
        for _ in 0..100 {
            (0..2).for_each(|index| assert!(bench.0.command_joint(world, index, Effort, 12.0)));
            bench.update(DT);
        }
        let (velocity, _) = bench.velocity("base");
        close(velocity.x, 0.1, 1e-3);
        close(velocity.y, 0.1, 1e-3);
        close(bench.position("base").z, 0.0, 1e-4);
        close(bench.velocity("base").0.z, 0.0, 1e-3);
    }
}

#[test]
fn a_universal_joint_turns_what_hangs_on_it_and_holds_its_weight() {
    let arm = link("arm", 3.0, 0.02).replace("<inertial>", "<inertial><origin xyz='0 0 -0.4'/>");
    let text = format!(
        "<robot name='r'><link name='world'/><link name='cross'/>{arm}{}{}</robot>",
        joint("j1", "continuous", "world", "cross", "1 0 0", ""),
        joint("j2", "continuous", "cross", "arm", "0 1 0", ""),
    );
    for profile in PROFILES {
        let mut bench = bench(profile, HEAVY, &[&text]);
        // (0.02 + 3 · 0.4²) kg·m², small angles.
        bench.command("world", 0, Effort, 0.5, 50);
        close(bench.velocity("arm").1.x, 0.05, 1.5e-3);
        bench.command("world", 0, Effort, 0.0, 2000);
        let pivot = bench.pose("arm").translation.vector;
        assert!(pivot.norm() < 1e-3, "{profile:?}: the joints are open by {pivot}");
    }
}

#[test]
fn a_moment_of_zero_leaves_the_two_others() {
    let link = |tensor: &str| {
        format!(
            "<robot name='r'><link name='a'><inertial><mass value='5'/><inertia {tensor} ixz='0' iyz='0'/></inertial>\
             <collision><geometry><box size='2 2 2'/></geometry></collision></link></robot>"
        )
    };
    for profile in PROFILES {
        for tensor in ["ixx='0' iyy='.2' izz='.2' ixy='0'", "ixx='.1' iyy='.1' izz='.2' ixy='.1'"] {
            let mut bench = bench(profile, WEIGHTLESS, &[&link(tensor)]);
            let body = bench.body("a");
            bench.0.apply_wrench(body, nalgebra::Vector3::zeros(), nalgebra::Vector3::z());
            bench.update(DT);
            close(spin(&bench) / DT, 5.0, 0.01);
        }
    }
}

#[test]
fn rotors_resist_acceleration_in_both_formats() {
    // 0.01 kg·m² of the link and 0.03 kg·m² of the rotor.
    let urdf = turntable(0.01, "continuous", "<dynamics armature='0.03'/>");
    let adf = "bodies: [BODY base, BODY a]\njoints: [JOINT j]\nBODY base: {name: world, mass: 0}\nBODY a: {name: a, mass: 1, \
               inertia: {ix: 0.01, iy: 0.01, iz: 0.01}}\nJOINT j: {name: j, type: revolute, parent: BODY base, child: BODY a, \
               parent axis: {x: 0, y: 0, z: 1}, child axis: {x: 0, y: 0, z: 1}, parent pivot: {x: 0, y: 0, z: 0}, \
               child pivot: {x: 0, y: 0, z: 0}, drive train: {armature: 0.03}}\n";
    let rows = "physics: {articulated: false}\n";
    for profile in PROFILES {
        for model in [urdf.as_str(), adf] {
            for world in [WEIGHTLESS.to_owned(), format!("{WEIGHTLESS}{rows}")] {
                let mut bench = bench(profile, &world, &[model]);
                bench.command("world", 0, Effort, 1.0, 100);
                // In `accurate` forces act on bodies with constraints for half of the first sub-step.
                close(spin(&bench) / 0.1, 25.0, 0.3);
                let before = spin(&bench);
                bench.command("world", 0, Effort, 0.0, 100);
                close(spin(&bench), before, 0.02 * before);
            }
        }
    }
}

#[test]
fn efforts_end_at_their_limit_and_damping_takes_speed_away() {
    let light = turntable(1e-5, "continuous", "<limit effort='1e-4'/><dynamics damping='1e-4'/>");
    let heavy = turntable(0.02, "continuous", "<dynamics damping='0.05'/>");
    for profile in PROFILES {
        let mut bench = bench(profile, WEIGHTLESS, &[&light]);
        bench.command("world", 0, Effort, 1e-3, 2000);
        close(spin(&bench), 1.0, 0.02);
        let mut bench = self::bench(profile, WEIGHTLESS, &[&heavy]);
        bench.command("world", 0, Effort, 1.0, 100);
        bench.command("world", 0, Effort, 0.0, 2);
        let before = spin(&bench);
        bench.command("world", 0, Effort, 0.0, 500);
        // The body's own damping takes 5 % in half a second.
        close(spin(&bench) / before, (-1.25_f64).exp(), 0.02);
    }
}

#[test]
fn dry_friction_holds_up_to_its_effort_and_brakes_with_it() {
    let text = turntable(0.1, "continuous", "<dynamics friction='2'/>");
    for profile in PROFILES {
        let mut bench = bench(profile, WEIGHTLESS, &[&text]);
        bench.command("world", 0, Effort, 1.9, 500);
        close(spin(&bench), 0.0, 1e-6);
        bench.command("world", 0, Effort, 3.0, 500);
        // (3 − 2) N·m / 0.1 kg·m² · 0.5 s, less the body's own damping.
        close(spin(&bench), 5.0, 0.15);
        bench.command("world", 0, Effort, 0.0, 150);
        close(spin(&bench), 1.85, 0.1);
        bench.command("world", 0, Effort, 0.0, 150);
        close(spin(&bench), 0.0, 1e-6);
    }
}

#[test]
fn no_command_makes_a_joint_faster_than_its_largest_velocity() {
    let limit = "<limit lower='-2.9' upper='2.9' effort='87' velocity='2.175'/>";
    for profile in PROFILES {
        for (kind, value, moment) in
            [(Effort, 50.0, 0.5), (Effort, -50.0, 1e-3), (Velocity, 9.0, 0.5), (Position, 2.8, 0.5)]
        {
            let mut bench = bench(profile, WEIGHTLESS, &[&turntable(moment, "revolute", limit)]);
            let mut fastest = 0.0_f64;
            for _ in 0..600 {
                bench.command("world", 0, kind, value, 1);
                fastest = fastest.max(spin(&bench).abs());
            }
            assert!((2.1..2.2).contains(&fastest), "{profile:?}, {kind:?}: {fastest} rad/s");
        }
    }
}

/// A joint of ADF with limits, between a body that stands still and one that turns about z.
fn adf_joint(low: f64, high: f64) -> String {
    format!(
        "bodies: [BODY world, BODY a]\njoints: [JOINT j]\nnamespace: /ambf/env/\nBODY world: {{name: world, mass: 0}}\n\
         BODY a: {{name: a, mass: 1, inertia: {{ix: 0.01, iy: 0.01, iz: 0.01}}}}\n\
         JOINT j: {{name: j, type: revolute, parent: BODY world, child: BODY a, parent axis: {{x: 0, y: 0, z: 1}}, \
         child axis: {{x: 0, y: 0, z: 1}}, parent pivot: {{x: 0, y: 0, z: 0}}, child pivot: {{x: 0, y: 0, z: 0}}, \
         max motor impulse: 0.05, joint limits: {{low: {low}, high: {high}}}}}\n"
    )
}

#[test]
fn joints_follow_everywhere_between_limits_beyond_half_a_turn() {
    for profile in PROFILES {
        for (low, high) in [(0.82, 5.46), (-5.46, -0.82), (4.0, 6.0)] {
            let limit = format!("<limit lower='{low}' upper='{high}' effort='50'/>");
            for text in [turntable(0.01, "revolute", &limit), adf_joint(low, high)] {
                let mut bench = bench(profile, WEIGHTLESS, &[&text]);
                for share in [0.02, 0.5, 0.75, 0.98, 0.3] {
                    let goal = low + share * (high - low);
                    bench.command("world", 0, Position, goal, 2000);
                    close(bench.joint("j").position, goal, 5e-3);
                    assert!(bench.joint("j").velocity.abs() < 0.01, "{}", bench.joint("j").velocity);
                }
                // An effort ends at each limit.
                for (effort, end) in [(0.05, high), (-0.05, low)] {
                    bench.command("world", 0, Effort, effort, 3000);
                    close(bench.joint("j").position, end, 0.02);
                }
            }
        }
    }
}

#[test]
fn balls_roll_unless_a_file_says_otherwise() {
    let (radius, angle) = (0.02, 0.1_f64);
    let normal = nalgebra::Vector3::new(angle.sin(), 0.0, angle.cos());
    let slope = format!(
        "<robot name='p'><link name='world'><collision><origin xyz='{} 0 {}' rpy='0 {angle} 0'/><geometry><box size='20 4 1'/>\
         </geometry></collision></link></robot>",
        -(radius + 0.5) * normal.x,
        -(radius + 0.5) * normal.z
    );
    let ball = link("a", 0.1, 0.4 * 0.1 * radius * radius)
        .replace("</link>", &format!("<collision><geometry><sphere radius='{radius}'/></geometry></collision></link>"));
    let ball = format!("<robot name='r'>{ball}</robot>");
    let adf = |friction: &str| {
        format!(
            "bodies: [BODY a]\nBODY a: {{name: a, mass: 0.1, collision shape: Sphere, collision geometry: {{radius: {radius}}}\
             {friction}}}\n"
        )
    };
    let free = 10.0 * angle.sin() * 5.0 / 7.0 * 0.4;
    for (profile, text, rolls) in [
        (Profile::Legacy, &ball, true),
        (Profile::Accurate, &ball, true),
        (Profile::Legacy, &adf(""), false),
        (Profile::Accurate, &adf(""), true),
        (Profile::Accurate, &adf(", friction: {rolling: 0.01}"), false),
    ] {
        let mut bench = bench(profile, HEAVY, &[text, &slope]);
        bench.steps(400);
        let speed = bench.velocity("a").0.norm();
        assert!(
            if rolls { (speed - free).abs() < 0.03 * free } else { speed < 0.05 * free },
            "{profile:?}: {speed} of {free}"
        );
    }
}
