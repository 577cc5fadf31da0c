//! A [`Scene`] as the text of an ADF model file. Gravity is a key of the model, so that no world file is needed.

use std::f64::consts::TAU;
use std::fmt::Write;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::scene::{Body, Ghost, Joint, Kind, Scene, Sensor, Shape};

/// Text of the model file, without commands.
pub fn model(scene: &Scene) -> String {
    let mut text = String::from("namespace: /ambf/env/\n");
    let mut line = |words: String| writeln!(text, "{words}").expect("a text takes everything");
    let list = |names: Vec<String>| format!("[{}]", names.join(", "));
    line(format!("gravity: {}", vector(&scene.gravity)));
    if scene.ignore_collision {
        line("ignore inter-collision: true".into());
    }
    line(format!("bodies: {}", list(scene.bodies.iter().map(|body| format!("BODY b{}", body.id)).collect())));
    line(format!("joints: {}", list(scene.joints.iter().map(|joint| format!("JOINT j{}", joint.id)).collect())));
    let numbered = |word: &str, n: usize| list((0..n).map(|i| format!("{word}{i}")).collect());
    if !scene.sensors.is_empty() {
        line(format!("sensors: {}", numbered("SENSOR s", scene.sensors.len())));
    }
    if !scene.actuators.is_empty() {
        line(format!("actuators: {}", numbered("ACTUATOR a", scene.actuators.len())));
    }
    if !scene.ghosts.is_empty() {
        line(format!("ghost objects: {}", numbered("GHOST g", scene.ghosts.len())));
    }
    scene.bodies.iter().for_each(|it| line(body(it)));
    scene.joints.iter().for_each(|it| line(joint(scene, it)));
    scene.sensors.iter().enumerate().for_each(|(i, it)| line(sensor(scene, i, it)));
    for (i, &parent) in scene.actuators.iter().enumerate() {
        let parent = scene.bodies[parent].id;
        line(format!("ACTUATOR a{i}: {{name: a{i}, type: Constraint, parent: BODY b{parent}}}"));
    }
    scene.ghosts.iter().enumerate().for_each(|(i, it)| line(ghost(i, it)));
    text
}

fn body(body: &Body) -> String {
    let mut text = format!("BODY b{0}: {{name: b{0}, mesh: '', mass: {1:?}", body.id, body.mass);
    let mut add = |words: String| write!(text, ", {words}").expect("a text takes everything");
    if let Some(inertia) = body.inertia {
        add(format!("inertia: {{ix: {:?}, iy: {:?}, iz: {:?}}}", inertia.x, inertia.y, inertia.z));
    }
    add(format!("location: {}", pose(&body.pose)));
    add(format!("inertial offset: {{position: {}}}", vector(&body.offset)));
    if let Some(shape) = body.shape {
        add(self::shape(&shape));
    }
    if let Some((fixed, rolling)) = body.friction {
        add(format!("friction: {{static: {fixed:?}, rolling: {rolling:?}}}"));
    }
    if let Some((linear, angular)) = body.damping {
        add(format!("damping: {{linear: {linear:?}, angular: {angular:?}}}"));
    }
    if let Some(restitution) = body.restitution {
        add(format!("restitution: {restitution:?}"));
    }
    if let Some(margin) = body.margin {
        add(format!("collision margin: {margin:?}"));
    }
    if !body.groups.is_empty() {
        add(format!("collision groups: {:?}", body.groups));
    }
    if let Some(gains) = body.controller {
        let block = |(p, d): (f64, f64)| format!("{{P: {p:?}, I: 0, D: {d:?}}}");
        add(format!("controller: {{linear: {}, angular: {}}}", block(gains.linear), block(gains.angular)));
        if let Some(output) = gains.output {
            add(format!("controller output type: {output}"));
        }
    }
    text + "}"
}

fn shape(shape: &Shape) -> String {
    let round = |name: &str, radius: f64, height: f64| {
        format!("collision shape: {name}, collision geometry: {{radius: {radius:?}, height: {height:?}, axis: Z}}")
    };
    match shape {
        Shape::Box(size) => format!("collision shape: Box, collision geometry: {}", vector(size)),
        Shape::Sphere(radius) => format!("collision shape: Sphere, collision geometry: {{radius: {radius:?}}}"),
        Shape::Cylinder(radius, height) => round("Cylinder", *radius, *height),
        Shape::Capsule(radius, height) => round("Capsule", *radius, *height),
        Shape::Cone(radius, height) => round("Cone", *radius, *height),
        Shape::Plane => "collision shape: Plane, collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}".into(),
        Shape::Ring(inner, outer, height, boxes) => ring(*inner, *outer, *height, *boxes),
        Shape::Ground(ground, side) => format!("collision mesh: {}, scale: {side:?}", ground.file()),
    }
}

/// Boxes whose inner faces touch the circle of the hole, and which meet at the outer radius.
fn ring(inner: f64, outer: f64, height: f64, boxes: usize) -> String {
    let angle = TAU / boxes as f64;
    let size = Vector3::new(outer - inner, 2.0 * outer * (angle / 2.0).tan(), height);
    let part = |n: usize| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), n as f64 * angle);
        let offset = Isometry3::from_parts((turn * Vector3::x() * ((inner + outer) / 2.0)).into(), turn);
        format!("{{shape: Box, geometry: {}, offset: {}}}", vector(&size), pose(&offset))
    };
    format!("compound collision shape: [{}]", (0..boxes).map(part).collect::<Vec<_>>().join(", "))
}

fn joint(scene: &Scene, joint: &Joint) -> String {
    let [parent, child] = [joint.parent, joint.child].map(|body| scene.bodies[body].id);
    let mut text = format!(
        "JOINT j{0}: {{name: j{0}, type: {1}, parent: BODY b{parent}, child: BODY b{child}, parent pivot: {2}, child pivot: {3}, \
         parent axis: {4}, child axis: {5}",
        joint.id,
        type_name(&joint.kind),
        vector(&joint.pivots[0]),
        vector(&joint.pivots[1]),
        vector(&joint.axes[0]),
        vector(&joint.axes[1]),
    );
    let mut add = |words: String| write!(text, ", {words}").expect("a text takes everything");
    if joint.offset != 0.0 {
        add(format!("offset: {:?}", joint.offset));
    }
    if let Some((low, high)) = joint.limits {
        add(format!("joint limits: {{low: {low:?}, high: {high:?}}}"));
    }
    for words in kind_keys(&joint.kind) {
        add(words);
    }
    if let Some([p, i, d]) = joint.controller {
        add(format!("controller: {{P: {p:?}, I: {i:?}, D: {d:?}}}"));
    }
    if let Some(output) = joint.output {
        add(format!("controller output type: {output}"));
    }
    if let Some(impulse) = joint.max_impulse {
        add(format!("max motor impulse: {impulse:?}"));
    }
    if let Some((erp, cfm)) = joint.softness {
        add(format!("joint erp: {erp:?}, joint cfm: {cfm:?}"));
    }
    if let Some(ignore) = joint.ignore_collision {
        add(format!("ignore inter-collision: {ignore}"));
    }
    if joint.feedback {
        add("enable feedback: true".into());
    }
    if joint.passive {
        add("passive: true".into());
    }
    // The leader may have been taken out.
    let coupling = joint.coupling.filter(|(leader, ..)| scene.joints.iter().any(|joint| joint.id == *leader));
    if let Some((leader, ratio, offset)) = coupling {
        add(format!("coupling: {{joint: JOINT j{leader}, ratio: {ratio:?}, offset: {offset:?}}}"));
    }
    text + "}"
}

fn type_name(kind: &Kind) -> &'static str {
    match kind {
        Kind::Revolute => "revolute",
        Kind::Continuous => "continuous",
        Kind::Prismatic => "prismatic",
        Kind::Fixed => "fixed",
        Kind::PointToPoint => "p2p",
        Kind::LinearSpring(..) => "linear spring",
        Kind::TorsionSpring(..) => "torsion spring",
        Kind::ConeTwist(_) => "cone twist",
        Kind::SixDof(..) => "six dof",
        Kind::SixDofSpring { .. } => "six dof spring",
    }
}

fn kind_keys(kind: &Kind) -> Vec<String> {
    let all = |value: f64| vector(&Vector3::repeat(value));
    let ranges = |linear: f64, angular: f64| {
        let side = |range: f64| format!("{{low: {}, high: {}}}", all(-range), all(range));
        format!("joint limits: {{linear: {}, angular: {}}}", side(linear), side(angular))
    };
    let pair = |word: &str, (linear, angular): (f64, f64)| {
        format!("{word}: {{linear: {}, angular: {}}}", all(linear), all(angular))
    };
    match *kind {
        Kind::LinearSpring(stiffness, damping, rest) | Kind::TorsionSpring(stiffness, damping, rest) => {
            let mut keys = vec![format!("stiffness: {stiffness:?}"), format!("damping: {damping:?}")];
            keys.extend(rest.map(|rest| format!("equilibrium point: {rest:?}")));
            keys
        }
        Kind::ConeTwist([x, y, z]) => vec![format!("joint limits: {{x: {x:?}, y: {y:?}, z: {z:?}}}")],
        Kind::SixDof(linear, angular) => vec![ranges(linear, angular)],
        Kind::SixDofSpring { ranges: (linear, angular), stiffness, damping } => vec![
            ranges(linear, angular),
            pair("stiffness", stiffness),
            pair("damping", damping),
            pair("equilibrium point", (0.0, 0.0)),
        ],
        _ => Vec::new(),
    }
}

fn sensor(scene: &Scene, index: usize, sensor: &Sensor) -> String {
    let middle = (sensor.rays as f64 - 1.0) / 2.0;
    let ray = |i: usize| {
        let (x, y) = ((i % sensor.rays) as f64 - middle, (i / sensor.rays) as f64 - middle);
        let offset = vector(&Vector3::new(x * sensor.pitch, y * sensor.pitch, 0.0));
        format!("{{offset: {offset}, direction: {{x: 0, y: 0, z: 1}}}}")
    };
    let rays: Vec<_> = (0..sensor.rays * sensor.rays).map(ray).collect();
    let law = sensor.resistance.map_or(String::new(), |[stiffness, damping, friction]| {
        format!(
            ", contact area: 0.1, contact stiffness: {stiffness:?}, contact damping: {damping:?}, \
             friction: {{static: {friction:?}, damping: 0.1, dynamic: {friction:?}, variable: false}}"
        )
    });
    format!(
        "SENSOR s{index}: {{name: s{index}, type: {}, parent: BODY b{}, location: {{position: {}}}, range: {:?}{law}, array: [{}]}}",
        if sensor.resistance.is_some() { "Resistance" } else { "Proximity" },
        scene.bodies[sensor.parent].id,
        vector(&sensor.location),
        sensor.range,
        rays.join(", ")
    )
}

fn ghost(index: usize, ghost: &Ghost) -> String {
    format!(
        "GHOST g{index}: {{name: g{index}, location: {}, collision shape: Box, collision geometry: {}}}",
        pose(&ghost.pose),
        vector(&ghost.size)
    )
}

fn pose(pose: &Isometry3<f64>) -> String {
    let (r, p, y) = pose.rotation.euler_angles();
    format!("{{position: {}, orientation: {{r: {r:?}, p: {p:?}, y: {y:?}}}}}", vector(&pose.translation.vector))
}

fn vector(v: &Vector3<f64>) -> String {
    format!("{{x: {:?}, y: {:?}, z: {:?}}}", v.x, v.y, v.z)
}
