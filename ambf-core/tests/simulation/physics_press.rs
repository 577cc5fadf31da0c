//! A body that something holds, pressed against what stands below it, in the accurate profile.
//!
//! Grip and ground contradict each other there: no motion keeps both. What was held used to be thrown off.

use crate::physics_common::{load_texts, Bench};
use ambf_core::comm::{ActuatorCommand, JointCommandType};
use ambf_core::ids::ActuatorId;
use ambf_core::sim::Simulation;
use nalgebra::{UnitQuaternion, Vector3};

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
    TwoStatic,
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

/// Of what is held.
const MASS: f64 = 0.1;
/// Edge of the box, diameter of the ball.
const EDGE: f64 = 0.04;
const G: f64 = 10.0;
/// Where the tool begins, above the height at which what it holds touches, and its speed.
const ABOVE: f64 = 0.002;
const SPEED: f64 = 0.02;
/// When it lets go, and the end.
const RELEASE: f64 = 0.6;
const END: f64 = 1.6;

#[derive(Debug, Clone, Copy)]
struct Case {
    tool: Tool,
    held: Held,
    below: Below,
    /// How deep it is pressed.
    press: f64,
    /// Sub-step.
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

    /// √(2E/m) of what is held, E its kinetic energy, m/s. A fall by z gives no more than √(2 g z), however it tumbles.
    fn speed(&self, (linear, angular): (Vector3<f64>, Vector3<f64>)) -> f64 {
        let gyration = match self.held {
            Held::Ball => 0.4 * (EDGE / 2.0).powi(2),
            _ => EDGE * EDGE / 6.0,
        };
        (linear.norm_squared() + gyration * angular.norm_squared()).sqrt()
    }

    fn top(&self) -> f64 {
        if self.below == Below::Ground {
            0.0
        } else {
            0.05
        }
    }

    /// Height of the tool while what is held just touches.
    fn touch(&self) -> f64 {
        self.top() + self.reach() + 0.1
    }

    fn bench(&self) -> Bench {
        let start = self.touch() + ABOVE;
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
             y: {yaw}}}}}, {shape}, friction: {{static: 0.5}}}}\n",
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
                         collision geometry: {{x: 0.01, y: 0.03, z: 0.06}}, friction: {{static: 1}}}}\n\
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
            Tool::TwoStatic => {
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
        let world = format!("gravity: {{x: 0, y: 0, z: -{G}}}\nmax iterations: 50\nphysics: {{profile: accurate}}\n");
        let loaded = load_texts(&world, &[&model]);
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Bench(Simulation::new(loaded.scene, self.step))
    }

    fn tools(&self) -> &'static [&'static str] {
        match self.tool {
            Tool::TwoStatic | Tool::TwoArms => &["Tool", "Other"],
            _ => &["Tool"],
        }
    }

    /// Moves the tools to a height, and the fingers towards each other.
    fn command(&self, bench: &mut Bench, z: f64) {
        for (i, tool) in self.tools().iter().enumerate() {
            if let Tool::Arm | Tool::TwoArms = self.tool {
                let post = bench.body(&format!("Post{tool}"));
                assert!(bench.0.command_joint(post, 0, JointCommandType::Position, z - 1.0));
                continue;
            }
            let x = if self.tools().len() == 1 { 0.0 } else { [0.03, -0.03][i] };
            let body = bench.body(tool);
            bench.0.follow_pose(body, Vector3::new(x, 0.0, z), [0.0, 0.0, 0.0, 1.0]);
        }
        if self.tool == Tool::Fingers {
            let tool = bench.body("Tool");
            assert!((0..2).all(|finger| bench.0.command_joint(tool, finger, JointCommandType::Position, 0.03)));
        }
    }

    /// Takes it, presses it down, lets it go.
    fn run(&self) {
        let mut bench = self.bench();
        let grip = |bench: &mut Bench, actuate: bool| {
            for tool in (0..self.tools().len()).map(ActuatorId::new) {
                let command = ActuatorCommand { actuate, body_name: "BODY Held".into(), ..Default::default() };
                assert_eq!(bench.0.command_actuator(tool, &command), None);
            }
        };
        grip(&mut bench, true);
        let from_tool = |bench: &Bench| (bench.pose("Tool").inverse() * bench.pose("Held")).translation.vector;
        let height = |bench: &Bench| bench.position("Held").z - self.top() - self.reach();
        let held_at = from_tool(&bench);
        // What a tilted box falls when it is let go.
        let fall = self.reach() - EDGE / 2.0;
        let mut t = 0.0;
        while t < END {
            let released = t >= RELEASE;
            if released && t - self.step < RELEASE {
                grip(&mut bench, false);
            }
            self.command(&mut bench, self.touch() + (ABOVE - SPEED * t).max(-self.press));
            bench.update(self.step);
            let speed = self.speed(bench.velocity("Held"));
            if released {
                let most = 0.1 + (2.0 * G * fall).sqrt();
                assert!(speed < most, "{self:?}: let go, it jumps: {speed} m/s at {t}");
                assert!(height(&bench) < 1e-3, "{self:?}: let go, it rises to {} at {t}", height(&bench));
            } else {
                let most = bench.velocity("Tool").0.norm().max(SPEED) + 0.1;
                assert!(speed < most, "{self:?}: held, it is thrown about: {speed} m/s at {t}");
                let gap = (from_tool(&bench) - held_at).norm();
                assert!(gap < 1e-3, "{self:?}: it is torn {gap} m out of the grip at {t}");
            }
            t += self.step;
        }
        let speed = self.speed(bench.velocity("Held"));
        // What fingers hold by its edges may turn slowly.
        let calm = if self.tool == Tool::Fingers { 0.1 } else { 0.01 };
        assert!(speed < calm, "{self:?}: it does not come to rest: {speed} m/s");
        let (fallen, away) = (-height(&bench), bench.position("Held").xy().norm());
        // Fingers go on holding it where it was pressed to.
        let deepest = if self.tool == Tool::Fingers { fall.max(self.press) } else { fall } + 1e-3;
        assert!(
            (-1e-3..deepest).contains(&fallen) && away < 0.02,
            "{self:?}: it ends {fallen} m lower and {away} m away"
        );
    }
}

fn press_with(tool: Tool) {
    for held in [Held::Flat, Held::Tilted, Held::Ball] {
        for below in [Below::Ground, Below::Plate(100.0), Below::Plate(1e-4)] {
            for step in [0.001, 0.004] {
                for press in [0.001, 0.003] {
                    Case { tool, held, below, press, step }.run();
                }
            }
        }
    }
}

#[test]
fn by_a_static_body() {
    press_with(Tool::Static);
}

#[test]
fn by_the_base_of_fingers_that_touch_it() {
    press_with(Tool::Fingers);
}

#[test]
fn by_a_driven_body() {
    press_with(Tool::Driven);
}

#[test]
fn by_an_arm() {
    press_with(Tool::Arm);
}

#[test]
fn by_two_static_bodies() {
    press_with(Tool::TwoStatic);
}

#[test]
fn by_two_arms() {
    press_with(Tool::TwoArms);
}
