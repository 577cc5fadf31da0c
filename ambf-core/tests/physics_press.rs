//! A body that something holds, pressed against what stands below it, in the accurate profile.
//!
//! Grip and ground contradict each other there: no motion keeps both. What was held used to be thrown off.

mod physics_common;

use ambf_core::comm::ActuatorCommand;
use ambf_core::sim::Simulation;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use physics_common::{load_texts, Bench};

/// What holds.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Tool {
    /// A static body.
    Static,
    /// A static body that is the base of a finger, which touches what is held.
    Fingers,
    /// A body of 1 kg with a pose controller.
    Driven,
    /// The last link of a tree: a slider from a static post.
    Arm,
    /// Two static bodies.
    Two,
    /// Two arms.
    TwoArms,
}

/// What is held.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Held {
    Flat,
    Tilted,
    Ball,
}

/// What it is pressed against.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Below {
    Ground,
    /// A plate of this mass on the ground, kg.
    Plate(f64),
}

const MASS: f64 = 0.1;
const EDGE: f64 = 0.04;
const G: f64 = 10.0;

#[derive(Debug, Clone, Copy)]
struct Case {
    tool: Tool,
    held: Held,
    below: Below,
    press: f64,
    step: f64,
}

impl Case {
    fn rotation(&self) -> UnitQuaternion<f64> {
        match self.held {
            Held::Tilted => UnitQuaternion::from_euler_angles(0.15, 0.1, 0.3),
            _ => UnitQuaternion::identity(),
        }
    }

    /// Of the lowest point of what is held, below its centre.
    fn reach(&self) -> f64 {
        let half = EDGE / 2.0;
        match self.held {
            Held::Ball => half,
            _ => (0..3).map(|i| (self.rotation().to_rotation_matrix()[(2, i)] * half).abs()).sum(),
        }
    }

    fn top(&self) -> f64 {
        if self.below == Below::Ground { 0.0 } else { 0.05 }
    }

    /// Height of the tool while what is held just touches.
    fn touch(&self) -> f64 {
        self.top() + self.reach() + 0.1
    }

    fn bench(&self, profile: &str) -> Bench {
        let start = self.touch() + 0.01;
        let (roll, pitch, yaw) = self.rotation().euler_angles();
        let shape = match self.held {
            Held::Ball => format!("collision shape: Sphere, collision geometry: {{radius: {}}}", EDGE / 2.0),
            _ => format!("collision shape: Box, collision geometry: {{x: {EDGE}, y: {EDGE}, z: {EDGE}}}"),
        };
        let mut names = vec!["BODY Ground", "BODY Held"];
        let (mut actuators, mut joints) = (vec!["ACTUATOR grip"], Vec::new());
        let mut text = format!(
            "BODY Ground: {{name: Ground, mass: 0, location: {{position: {{x: 0, y: 0, z: -0.5}}}}, collision shape: Box, \
             collision geometry: {{x: 4, y: 4, z: 1}}, friction: {{static: 0.5}}}}\n\
             BODY Held: {{name: Held, mass: {MASS}, location: {{position: {{x: 0, y: 0, z: {}}}, orientation: {{r: {roll}, p: {pitch}, \
             y: {yaw}}}}}, {shape}, friction: {{static: 0.5}}, restitution: 0}}\n",
            start - 0.1
        );
        if let Below::Plate(mass) = self.below {
            names.push("BODY Plate");
            text += &format!(
                "BODY Plate: {{name: Plate, mass: {mass}, location: {{position: {{x: 0, y: 0, z: 0.025}}}}, collision shape: Box, \
                 collision geometry: {{x: 0.3, y: 0.3, z: 0.05}}, friction: {{static: 0.5}}}}\n"
            );
        }
        let controller = "controller: {linear: {P: 2000, I: 0, D: 80}, angular: {P: 20, I: 0, D: 0.5}}, \
                          inertia: {ix: 0.001, iy: 0.001, iz: 0.001}";
        let tool = |name: &str, x: f64, mass: f64, more: &str| {
            format!("BODY {name}: {{name: {name}, mass: {mass}, location: {{position: {{x: {x}, y: 0, z: {start}}}}}{more}}}\n")
        };
        let inertia = ", inertia: {ix: 0.001, iy: 0.001, iz: 0.001}";
        let post = |name: &str, x: f64| {
            format!(
                "BODY Post{name}: {{name: Post{name}, mass: 0, location: {{position: {{x: {x}, y: 0, z: 1}}}}}}\n\
                 JOINT slide{name}: {{name: slide{name}, type: prismatic, parent: BODY Post{name}, child: BODY {name}, \
                 parent pivot: {{x: 0, y: 0, z: 0}}, child pivot: {{x: 0, y: 0, z: 0}}, parent axis: {{x: 0, y: 0, z: 1}}, \
                 child axis: {{x: 0, y: 0, z: 1}}, offset: 0, joint limits: {{low: -2, high: 2}}, \
                 controller: {{P: 2000, I: 0, D: 80}}}}\n"
            )
        };
        let grip = |name: &str, tool: &str| {
            format!("ACTUATOR {name}: {{name: {name}, type: Constraint, parent: BODY {tool}, location: {{position: {{x: 0, y: 0, z: -0.05}}}}}}\n")
        };
        names.push("BODY Tool");
        text += &grip("grip", "Tool");
        match self.tool {
            Tool::Static => text += &tool("Tool", 0.0, 0.0, ""),
            Tool::Fingers => {
                text += &tool("Tool", 0.0, 0.0, "");
                for (side, name, slide) in [(-1.0, "Left", "left"), (1.0, "Right", "right")] {
                    names.push(if side < 0.0 { "BODY Left" } else { "BODY Right" });
                    joints.push(if side < 0.0 { "JOINT left" } else { "JOINT right" });
                    text += &format!(
                        "BODY {name}: {{name: {name}, mass: 0.05, location: {{position: {{x: {}, y: 0, z: {}}}}}, collision shape: Box, \
                         collision geometry: {{x: 0.01, y: 0.03, z: 0.06}}, friction: {{static: 1}}, restitution: 0}}\n\
                         JOINT {slide}: {{name: {slide}, type: prismatic, parent: BODY Tool, child: BODY {name}, parent pivot: \
                         {{x: {}, y: 0, z: -0.04}}, child pivot: {{x: 0, y: 0, z: 0.05}}, parent axis: {{x: {}, y: 0, z: 0}}, child axis: \
                         {{x: {}, y: 0, z: 0}}, joint limits: {{low: 0, high: 0.04}}, controller: {{P: 300, I: 0, D: 10}}}}\n",
                        side * 0.045,
                        start - 0.09,
                        side * 0.045,
                        -side,
                        -side
                    );
                }
            }
            Tool::Driven => text += &tool("Tool", 0.0, 1.0, &format!(", {controller}")),
            Tool::Arm => {
                text += &tool("Tool", 0.0, 1.0, inertia);
                text += &post("Tool", 0.0);
                names.push("BODY PostTool");
                joints.push("JOINT slideTool");
            }
            Tool::Two => {
                text += &tool("Tool", 0.03, 0.0, "");
                text += &tool("Other", -0.03, 0.0, "");
                text += &grip("other", "Other");
                names.push("BODY Other");
                actuators.push("ACTUATOR other");
            }
            Tool::TwoArms => {
                for (name, x) in [("Tool", 0.03), ("Other", -0.03)] {
                    text += &tool(name, x, 1.0, inertia);
                    text += &post(name, x);
                }
                text += &grip("other", "Other");
                names.extend(["BODY Other", "BODY PostTool", "BODY PostOther"]);
                actuators.push("ACTUATOR other");
                joints.extend(["JOINT slideTool", "JOINT slideOther"]);
            }
        }
        let model = format!(
            "bodies: [{}]\nactuators: [{}]\njoints: [{}]\n{text}",
            names.join(", "),
            actuators.join(", "),
            joints.join(", ")
        );
        let world = format!("gravity: {{x: 0, y: 0, z: -{G}}}\nmax iterations: 50\nphysics: {profile}\n");
        let loaded = load_texts(&world, &[&model]);
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Bench(Simulation::new(loaded.scene, self.step))
    }

    fn run(&self, profile: &str, show: bool) -> Seen {
        let mut bench = self.bench(profile);
        let touch = self.touch();
        let start = touch + 0.01;
        let tools: &[&str] = match self.tool {
            Tool::Two | Tool::TwoArms => &["Tool", "Other"],
            _ => &["Tool"],
        };
        let mut seen = Seen::default();
        let held = bench.body("Held");
        let at = bench.pose("Tool").inverse() * bench.pose("Held");
        let total = 2.5;
        let mut last = 0.0;
        let n = (total / self.step) as usize;
        for i in 0..n {
            let t = i as f64 * self.step;
            let z = if t < 0.1 {
                start
            } else {
                (start - 0.02 * (t - 0.1)).max(touch - self.press)
            };
            if i == 1 {
                for a in 0..tools.len() {
                    let grip = ActuatorCommand { actuate: true, body_name: "BODY Held".into(), ..Default::default() };
                    assert_eq!(bench.0.command_actuator(a, &grip), None);
                }
            }
            let released = t >= 1.5;
            if released && last < 1.5 {
                for a in 0..tools.len() {
                    bench.0.command_actuator(a, &ActuatorCommand::default());
                }
            }
            for tool in tools {
                let body = bench.body(tool);
                match self.tool {
                    Tool::Arm | Tool::TwoArms => {
                        let post = bench.body(&format!("Post{tool}"));
                        bench.0.command_joint(post, 0, ambf_core::comm::JointCommandType::Position, z - 1.0);
                    }
                    _ => {
                        let x = bench.position(tool).x;
                        let x = if tools.len() == 1 { 0.0 } else { 0.03 * x.signum() };
                        bench.0.follow_pose(body, Vector3::new(x, 0.0, z), [0.0, 0.0, 0.0, 1.0]);
                    }
                }
            }
            if self.tool == Tool::Fingers {
                let tool = bench.body("Tool");
                for j in 0..2 {
                    bench.0.command_joint(tool, j, ambf_core::comm::JointCommandType::Position, 0.03);
                }
            }
            bench.update(self.step);
            let (v, w) = bench.velocity("Held");
            let pose = bench.pose("Held");
            let off: Isometry3<f64> = bench.pose("Tool").inverse() * pose;
            let gap = (off.translation.vector - at.translation.vector).norm();
            let tool_speed = bench.velocity("Tool").0.norm();
            if show && (i % (n / 50) == 0 || v.norm() > 0.12) {
                println!(
                    "{} {t:.4} z {:.5} tool {:.5} v {:.4} {:.4} {:.4} w {:.3} gap {:.5} contacts {}",
                    if self.below == Below::Ground { String::new() } else { let (v, w) = bench.velocity("Plate"); let p = bench.pose("Plate"); format!("[plate z {:.5} tilt {:.4} v {:.3} w {:.2}]", p.translation.z - 0.025, (p.rotation * Vector3::z()).xy().norm(), v.norm(), w.norm()) },
                    pose.translation.z - self.top() - self.reach(),
                    bench.pose("Tool").translation.z - touch,
                    v.x, v.y, v.z,
                    w.norm(),
                    gap,
                    bench.0.scene().world.contact_count()
                );
            }
            let _ = held;
            if released {
                seen.after = seen.after.max(v.norm());
                seen.spin_after = seen.spin_after.max(w.norm() * EDGE / 2.0);
                seen.rise = seen.rise.max(pose.translation.z - self.top() - self.reach());
            } else {
                seen.speed = seen.speed.max(v.norm());
                seen.spin = seen.spin.max(w.norm() * EDGE / 2.0);
                seen.tool = seen.tool.max(tool_speed);
                seen.gap = seen.gap.max(gap);
            }
            seen.rest = v.norm() + w.norm() * EDGE / 2.0;
            seen.low = seen.low.min(pose.translation.z - self.top() - self.reach());
            last = t;
        }
        seen.far = bench.position("Held").xy().norm();
        seen
    }
}

#[derive(Debug, Default, Clone, Copy)]
struct Seen {
    speed: f64,
    spin: f64,
    tool: f64,
    gap: f64,
    low: f64,
    after: f64,
    spin_after: f64,
    rise: f64,
    rest: f64,
    far: f64,
}

#[test]
fn explore() {
    let profile = std::env::var("PROFILE").unwrap_or("{profile: accurate}".into());
    let only = std::env::var("ONLY").unwrap_or_default();
    for tool in [Tool::Static, Tool::Fingers, Tool::Driven, Tool::Arm, Tool::Two, Tool::TwoArms] {
        for held in [Held::Flat, Held::Tilted, Held::Ball] {
            for below in [Below::Ground, Below::Plate(100.0), Below::Plate(1e-4)] {
                for step in [0.001, 0.004] {
                    for press in [0.001, 0.003] {
                        let case = Case { tool, held, below, press, step };
                        let name = format!("{case:?}");
                        if !only.is_empty() && !only.split(';').all(|part| name.contains(part)) {
                            continue;
                        }
                        let seen = case.run(&profile, std::env::var("SHOW").is_ok());
                        let mm = |x: f64| x * 1e3;
                        println!(
                            "{tool:?} {held:?} {below:?} {:.0}ms {:.0}mm: v {:.3} spin {:.3} tool {:.3} gap {:.2}mm low {:.2}mm | after v {:.3} spin {:.3} rise {:.2}mm rest {:.4} far {:.1}mm",
                            mm(step), mm(press), seen.speed, seen.spin, seen.tool, mm(seen.gap), mm(seen.low),
                            seen.after, seen.spin_after, mm(seen.rise), seen.rest, mm(seen.far)
                        );
                    }
                }
            }
        }
    }
}
