//! Tests of whole texts.

use nalgebra::Point3;

use super::*;
use crate::adf::{
    CollisionGeometry, ControllerOutput, Coupling, DriveTrain, Leader, Limits, PartGeometry, Primitive, RigidBody,
    VisualGeometry,
};

/// Model and problems, without those that say what MuJoCo's solver has.
fn read(text: &str) -> (Model, Vec<String>) {
    let (model, report) = parse(text, Path::new("dir/t.xml"), Surroundings::Nothing).expect("read");
    (model, report.problems().iter().map(|problem| problem.to_string()).collect())
}

/// As [`read`], of a text without problems.
fn clean(text: &str) -> Model {
    let (model, problems) = read(text);
    assert_eq!(problems, [""; 0]);
    model
}

/// Problems of a text that is refused.
fn refused(text: &str) -> Vec<String> {
    match parse(text, Path::new("t.xml"), Surroundings::Nothing) {
        Err(LoadError::Refused { report, .. }) => report.problems().iter().map(|p| p.to_string()).collect(),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("not refused"),
    }
}

fn world(inside: &str) -> String {
    format!("<mujoco model='m'><worldbody>{inside}</worldbody></mujoco>")
}

fn body<'m>(model: &'m Model, name: &str) -> &'m RigidBody {
    let identifier = format!("BODY {name}");
    model.bodies.iter().find(|body| body.common.identifier == identifier).unwrap_or_else(|| panic!("no {name}"))
}

fn joint<'m>(model: &'m Model, name: &str) -> &'m AdfJoint {
    let identifier = format!("JOINT {name}");
    model.joints.iter().find(|joint| joint.common.identifier == identifier).unwrap_or_else(|| panic!("no {name}"))
}

/// Where the child's frame is in the parent's at coordinate zero.
fn rest(joint: &AdfJoint) -> Isometry3<f64> {
    let rotation = joint.child_rotation.expect("given");
    Isometry3::from_parts((joint.parent_pivot - rotation * joint.child_pivot).into(), rotation)
}

#[test]
fn bodies_stand_as_they_are_written_and_joints_agree() {
    let model = clean(&world(
        "<body name='a' pos='1 2 3' euler='0 0 90'><joint name='j' axis='0 1 0' pos='0 0 1' ref='30' range='-60 60'/>
           <geom size='0.1'/>
           <body name='b' pos='0 1 0' quat='0 1 0 0'><joint name='s' type='slide' axis='1 0 0' ref='0.5'/><geom size='0.1'/></body>
         </body>",
    ));
    assert_eq!(model.namespace, "/ambf/env/m/");
    assert_eq!(model.gravity, Some(Vector3::new(0.0, 0.0, -9.81)));
    let (a, b) = (body(&model, "a"), body(&model, "b"));
    assert_eq!(a.location.translation.vector, Vector3::new(1.0, 2.0, 3.0));
    assert!((a.location.rotation * Vector3::x() - Vector3::y()).norm() < 1e-15, "degrees");
    assert!((b.location.translation.vector - Vector3::new(0.0, 2.0, 3.0)).norm() < 1e-15);
    assert_eq!(model.bodies[0].common.identifier, "BODY world", "the joint holds on it");
    assert_eq!((model.bodies[0].mass, body(&model, "a").mass > 0.0), (0.0, true));
    // As written the coordinates are the references: at zero the joints are that much before.
    let (j, s) = (joint(&model, "j"), joint(&model, "s"));
    let limits = j.limits.expect("limits");
    assert!(
        (limits.low + std::f64::consts::FRAC_PI_3).abs() < 1e-15
            && (limits.high - std::f64::consts::FRAC_PI_3).abs() < 1e-15
    );
    let turned = |joint: &AdfJoint, q: f64| {
        let about = Isometry3::from(joint.child_pivot)
            * Isometry3::rotation(joint.child_axis * q)
            * Isometry3::from(-joint.child_pivot);
        rest(joint) * about
    };
    let found = turned(j, 30f64.to_radians());
    assert!((found.to_homogeneous() - a.location.to_homogeneous()).amax() < 1e-15);
    let slid = rest(s) * Isometry3::from(s.child_axis * 0.5);
    assert!((slid.to_homogeneous() - (a.location.inverse() * b.location).to_homogeneous()).amax() < 1e-15);
}

#[test]
fn several_joints_of_a_body_have_bodies_without_a_mass_between() {
    let model = clean(&world(
        "<body name='a'><joint name='x' type='slide' axis='1 0 0'/><joint name='z' pos='0 0 1'/><joint name='y' axis='0 1 0'/>
         <geom size='0.1' mass='2'/></body>",
    ));
    assert!(model.has_massless_links);
    let names: Vec<_> = model.bodies.iter().map(|body| body.common.identifier.as_str()).collect();
    assert_eq!(names.len(), 4, "{names:?}");
    let chain: Vec<_> = model.joints.iter().map(|joint| (joint.parent.as_str(), joint.child.as_str())).collect();
    let expected = [("BODY world", "BODY a_x"), ("BODY a_x", "BODY a_z"), ("BODY a_z", "BODY a")];
    assert_eq!(chain, expected);
    let between = body(&model, "a_z");
    assert!(between.mass > 0.0 && between.mass < 1e-7 && between.common.passive && between.inertia.is_some());
    assert!((body(&model, "a").mass - 2.0).abs() < 1e-15);
}

#[test]
fn classes_inherit_and_bodies_give_them_to_their_children() {
    let model = clean(
        "<mujoco><default><geom density='500'/><joint damping='1'/>
           <default class='outer'><geom type='box' size='1 1 1'/><joint armature='0.1'/>
             <default class='inner'><geom size='2'/></default></default></default>
         <worldbody>
           <body name='a' childclass='outer'><freejoint/><geom/>
             <body name='b'><joint name='j'/><geom class='inner'/></body>
             <body name='c' childclass='main'><joint name='k'/><geom size='1'/></body></body>
         </worldbody></mujoco>",
    );
    assert!((body(&model, "a").mass - 4000.0).abs() < 1e-9, "a box of 8 m³");
    assert!((body(&model, "b").mass - 8000.0).abs() < 1e-9, "x from the inner class, y and z from the outer");
    assert!((body(&model, "c").mass - 500.0 * 4.0 / 3.0 * std::f64::consts::PI).abs() < 1e-9);
    let losses = |name| (joint(&model, name).drive_train.damping, joint(&model, name).drive_train.armature);
    assert_eq!((losses("j"), losses("k")), ((1.0, 0.1), (1.0, 0.0)));
}

#[test]
fn all_shapes_and_their_places() {
    let shapes = "<geom type='box' size='1 2 3' pos='1 0 0'/><geom type='capsule' size='0.5' fromto='0 0 0 0 0 2'/>
        <geom type='cylinder' size='0.5 1' zaxis='1 0 0'/><geom type='ellipsoid' size='1 2 3'/>
        <geom type='box' size='0.1' fromto='0 0 0 4 0 0' contype='0' conaffinity='0'/><geom size='2' group='3'/>";
    let model = clean(&world(&format!("<body name='a'><freejoint/>{shapes}</body>")));
    let CollisionGeometry::Parts { parts, .. } = &body(&model, "a").collision else { panic!() };
    let axis = crate::adf::Axis::Z;
    let expected = [
        Primitive::Box { size: Vector3::new(2.0, 4.0, 6.0) },
        Primitive::Capsule { radius: 0.5, height: 3.0, axis },
        Primitive::Cylinder { radius: 0.5, height: 2.0, axis },
        Primitive::Ellipsoid { radii: Vector3::new(1.0, 2.0, 3.0) },
        Primitive::Sphere { radius: 2.0 },
    ];
    let found: Vec<_> = parts.iter().map(|part| part.geometry.clone()).collect();
    assert_eq!(found, expected.map(PartGeometry::Primitive), "the fifth meets nothing");
    assert_eq!(parts[1].offset.translation.z, 1.0);
    assert!((parts[2].offset.rotation * Vector3::z() - Vector3::x()).norm() < 1e-15);
    let VisualGeometry::Parts(drawn) = &body(&model, "a").visual.geometry else { panic!() };
    assert_eq!(drawn.len(), 5, "group 3 is hidden");
    let PartGeometry::Primitive(Primitive::Box { size }) = drawn[4].part.geometry else { panic!() };
    assert_eq!(size, Vector3::new(0.2, 0.2, 4.0));
}

#[test]
fn planes_are_bodies_of_their_own() {
    let model = clean(&world(
        "<geom name='floor' type='plane' size='1 1 1' pos='0 0 2' zaxis='1 0 0'/><geom size='1'/>
         <body name='a'><freejoint/><geom size='1'/></body>",
    ));
    let names: Vec<_> = model.bodies.iter().map(|body| body.common.identifier.as_str()).collect();
    assert_eq!(names, ["BODY floor", "BODY world", "BODY a"]);
    let CollisionGeometry::Primitive { primitive: Primitive::Plane { normal, offset }, .. } =
        &model.bodies[0].collision
    else {
        panic!()
    };
    assert!((normal - Vector3::x()).norm() < 1e-15 && offset.abs() < 1e-15);
}

#[test]
fn who_collides_with_whom() {
    let model = clean(
        "<mujoco><worldbody><body name='a'><freejoint/><geom size='1'/>
           <body name='b'><geom size='1' contype='2' conaffinity='4'/>
             <body name='c'><joint/><geom size='1'/></body></body></body>
           <body name='d'><joint name='d'/><geom size='1'/></body><geom size='9'/></worldbody>
         <contact><exclude body1='a' body2='d'/></contact></mujoco>",
    );
    let filter = |name| body(&model, name).collision_filter.clone().expect("a filter");
    assert_eq!(filter("a").cluster, filter("b").cluster, "fixed to each other");
    assert_eq!((filter("b").kind, filter("b").affinity), (2, 4));
    assert_eq!(filter("c").outer, Some(filter("a").cluster));
    assert_eq!(filter("d").outer, None, "what hangs on the world collides with it");
    assert_eq!((filter("a").excluded, filter("d").excluded), (vec![filter("d").member], vec![filter("a").member]));
    assert!(model.joints.iter().all(|joint| !joint.ignore_inter_collision));
}

#[test]
fn pairs_collide_whatever_masks_and_parents_say() {
    let text = |pairs: &str| {
        format!(
            "<mujoco><worldbody><geom name='floor' type='plane' contype='0' conaffinity='0'/><geom name='block' size='1'/>
               <body name='a'><freejoint/><geom name='a' size='1' contype='0' conaffinity='0'/>
                 <body name='b'><joint/><geom name='b' size='1'/><geom name='shown' size='1' contype='0' conaffinity='0'/>
                   <body name='f'><geom name='f' size='1' contype='0' conaffinity='0'/></body></body></body></worldbody>
             <contact>{pairs}</contact></mujoco>"
        )
    };
    let without = clean(&text(""));
    assert_eq!(body(&without, "a").collision, CollisionGeometry::None);
    let model = clean(&text("<pair geom1='floor' geom2='a'/><pair geom1='b' geom2='a'/>"));
    let filter = |name| body(&model, name).collision_filter.clone().expect("a filter");
    let (a, b, floor, world) = (filter("a"), filter("b"), filter("floor"), filter("world"));
    assert_eq!((a.kind, a.affinity, a.included), (0, 0, vec![world.member, b.member]));
    assert_eq!((b.included, b.outer), (vec![a.member], Some(a.cluster)));
    // What else stands still has the member number of the floor, but does not list the body.
    assert_eq!((floor.included, floor.kind, world.included, world.kind), (vec![a.member], 0, vec![], 1));
    assert!(matches!(&body(&model, "a").collision, CollisionGeometry::Parts { parts, .. } if parts.len() == 1));

    let (model, problems) = read(&text(
        "<pair geom1='shown' geom2='floor'/><pair geom1='b' geom2='f'/><pair geom1='b' geom2='c'/>
         <pair geom1='b' geom2='floor' condim='1' friction='2' margin='1'/>",
    ));
    for (problem, expected) in problems.iter().zip([
        "error: `contact / pair / geom1` has neither contype nor conaffinity, unlike other geoms of its body",
        "info: `contact / pair` is not used; what is fixed to each other does not collide",
        "error: `contact / pair / geom2` is `c`, expected the name of a geom that is there; the pair is left out",
        "info: `contact / pair / margin` is not used",
        "warning: `contact / pair / condim` is not used; the contact has the friction of both bodies",
        "warning: `contact / pair / friction` is not used",
    ]) {
        assert!(problem.contains(expected), "{expected}: {problem}");
    }
    assert_eq!(problems.len(), 6, "{problems:#?}");
    assert_eq!(body(&model, "floor").collision_filter.clone().expect("a filter").included.len(), 1);
    let two =
        text("<pair geom1='b' geom2='a'/>").replace("name='shown' size='1' contype='0' conaffinity='0'", "size='1'");
    let (_, problems) = read(&two);
    assert!(
        problems.len() == 1 && problems[0].contains("all geoms of both bodies collide with each other"),
        "{problems:?}"
    );
}

#[test]
fn inertia_as_written_or_of_the_geoms() {
    let text = |compiler: &str| {
        format!(
            "<mujoco>{compiler}<worldbody><body name='a'><freejoint/><inertial mass='3' pos='0 0 1' diaginertia='1 2 3' euler='0 0 90'/>
             <geom type='box' size='0.5 0.5 0.5' mass='6' group='2'/></body></worldbody></mujoco>"
        )
    };
    let a = |compiler| body(&clean(&text(compiler)), "a").clone();
    let written = a("");
    assert_eq!((written.mass, written.inertia), (3.0, Some(Vector3::new(1.0, 2.0, 3.0))));
    let offset = written.inertial_offset.expect("given");
    assert_eq!(offset.translation.vector, Vector3::z());
    assert!((offset.rotation * Vector3::x() - Vector3::y()).norm() < 1e-15);
    let found = a("<compiler inertiafromgeom='true'/>");
    assert!((found.mass - 6.0).abs() < 1e-15 && (found.inertia.expect("found") - Vector3::repeat(1.0)).amax() < 1e-12);
    assert_eq!(a("<compiler settotalmass='1'/>").mass, 1.0);
    assert_eq!(a("<compiler boundmass='4' boundinertia='2.5'/>").inertia, Some(Vector3::new(2.5, 2.5, 3.0)));
    assert_eq!(a("<compiler inertiafromgeom='true' inertiagrouprange='0 1'/>").mass, 3.0, "no geom of these groups");
    let full = text("").replace("diaginertia='1 2 3' euler='0 0 90'", "fullinertia='2 2 3 1 0 0'");
    let found = body(&clean(&full), "a").clone();
    let mut moments: Vec<f64> = found.inertia.expect("given").iter().copied().collect();
    moments.sort_by(f64::total_cmp);
    assert!(moments.iter().zip([1.0, 3.0, 3.0]).all(|(a, b)| (a - b).abs() < 1e-14), "{moments:?}");
}

const ARM: &str = "<worldbody><body name='a'><joint name='p' armature='0.5'/><geom size='1'/></body>
    <body name='b'><joint name='q' type='slide' stiffness='3' springref='0.1'/><geom size='1'/></body>
    <body name='c'><joint name='r' ref='90'/><geom size='1'/></body></worldbody>";

#[test]
fn actuators_drive_joints() {
    let drive = |actuators: &str| clean(&format!("<mujoco>{ARM}<actuator>{actuators}</actuator></mujoco>"));
    let gains = |model: &Model| {
        let p = joint(model, "p");
        (p.controller.output, p.controller.gains.p, p.controller.gains.d, p.drive_train.max_effort)
    };
    let motor = drive("<motor joint='p' gear='20' ctrlrange='-1 0.5'/>");
    let p = joint(&motor, "p");
    assert_eq!((p.drive_train.max_effort, p.drive_train.armature, p.controller), (Some(20.0), 0.5, Default::default()));
    assert!((p.max_motor_impulse - 0.02).abs() < 1e-15);
    let force = ControllerOutput::Force;
    let position = drive("<position joint='p' kp='5' kv='0.5' gear='2' forcerange='-3 3'/>");
    assert_eq!(gains(&position), (force, 20.0, 2.0, Some(6.0)));
    let general = "<general joint='p' gainprm='5' biastype='affine' biasprm='0 -5 -0.5' gear='2' forcerange='-3 3'/>";
    assert_eq!(gains(&drive(general)), (force, 20.0, 2.0, Some(6.0)));
    let pair = drive("<position joint='p' kp='5'/><velocity joint='p' kv='2'/>");
    assert_eq!(gains(&pair), (force, 5.0, 2.0, None));
    let (_, problems) =
        read(&format!("<mujoco>{ARM}<actuator><muscle joint='p'/><motor joint='z'/></actuator></mujoco>"));
    assert!(problems.len() == 2 && problems[0].contains("`muscle`, expected motor, position"), "{problems:?}");
    assert!(problems[1].contains("motor / joint` is `z`, expected the name of a joint"), "{problems:?}");
}

#[test]
fn biases_count_where_their_type_says_so() {
    let text = |default: &str, actuator: &str| {
        format!(
            "<mujoco><default>{default}<default class='affine'><general biastype='affine'/></default></default>{ARM}
             <actuator>{actuator}</actuator></mujoco>"
        )
    };
    let found = |model: &Model| {
        let p = joint(model, "p");
        (p.controller.output, p.controller.gains.p, p.controller.gains.d, p.drive_train.max_effort)
    };
    let numbers = "gainprm='5' biasprm='0 -5 -0.5' ctrlrange='-1 1'";
    let servo = (ControllerOutput::Force, 5.0, 0.5, None);
    let none = format!("<general joint='p' {numbers}/>");
    let (model, problems) = read(&text("", &none));
    assert_eq!((joint(&model, "p").controller, found(&model).3), (Default::default(), Some(5.0)));
    assert!(problems.len() == 1 && problems[0].contains("general / biastype` is missing"), "{problems:?}");
    let written = text("", &format!("<general joint='p' biastype='none' {numbers}/>"));
    assert_eq!(joint(&clean(&written), "p").controller, Default::default());
    // The type and the numbers may come from different places.
    let default = format!("<general {numbers}/>");
    assert_eq!(found(&clean(&text(&default, "<general joint='p' class='affine'/>"))), servo);
    assert_eq!(found(&clean(&text(&default, "<general joint='p' biastype='affine'/>"))), servo);
    assert_eq!(found(&clean(&text("<general biastype='affine'/>", &none))), servo);
    let off = format!("<general biastype='none' {numbers}/>");
    assert_eq!(found(&clean(&text(&off, "<general joint='p' class='affine'/>"))), servo);
    // Short forms say the type, too, and inherit the gain.
    assert_eq!(found(&clean(&text("<position kp='5' kv='0.5'/>", "<general joint='p'/>"))), servo);
    assert_eq!(found(&clean(&text(&default, "<position joint='p'/>"))), servo);
    let velocity = clean(&text(&default, "<velocity joint='p'/>"));
    assert_eq!((joint(&velocity, "p").controller, found(&velocity).3), (Default::default(), None));
    let motor = clean(&text("<position kp='5' kv='0.5'/>", "<motor joint='p' ctrlrange='-2 2'/>"));
    assert_eq!(joint(&motor, "p").controller, Default::default());
    assert_eq!(joint(&motor, "p").drive_train.max_effort, Some(2.0));
}

#[test]
fn springs_stand_beside_their_joints() {
    let model = clean(&format!("<mujoco>{ARM}</mujoco>"));
    let spring = joint(&model, "q_spring");
    assert_eq!(
        (spring.kind.clone(), spring.stiffness, spring.equilibrium_point),
        (JointKind::LinearSpring, 3.0, Some(0.1))
    );
    assert!(spring.limits.is_some_and(|Limits { low, high }| low > high) && spring.common.passive);
    assert_eq!(spring.parent_pivot, joint(&model, "q").parent_pivot);
    let off = clean(&format!("<mujoco><option><flag spring='disable'/></option>{ARM}</mujoco>"));
    assert!(off.joints.iter().all(|joint| joint.kind != JointKind::LinearSpring));
}

/// Numbers of MuJoCo 4.0.0: `jnt_stiffness`, `dof_damping`, and `actuator_biasprm` times the square of the gear.
#[test]
fn time_constants_and_damping_ratios_are_about_the_inertia_of_the_start() {
    let text = |c: &str| {
        format!(
            "<mujoco><default><joint springdamper='0.5 0.2'/></default><worldbody>
               <body name='a' pos='100 -50 3'><joint name='p' armature='0.1' axis='0 1 0' stiffness='9' damping='9'/>
                 <geom size='0.1' mass='2' pos='0.3 0 0'/>
                 <body name='b' pos='0.6 0 0'><joint name='q' type='slide' axis='0 0 1' springdamper='0.1 1'/>
                   <joint name='r' axis='0 1 0' springdamper='2 0.5' pos='0 0 0.1'/><geom type='box' size='.1 .2 .3' mass='3' pos='0.1 0 0.2'/>
                   <body name='c' pos='0.1 0 0.5'><joint name='t' type='ball' springdamper='{c}'/><geom size='.1' mass='1' pos='0 0.1 0'/></body></body></body>
               <body name='f' pos='0 0 3'><freejoint/><geom size='.1' mass='1'/><body pos='0 0 0.5'><geom size='.1' mass='1'/>
                 <body name='g'><joint name='s' axis='1 0 0' springdamper='0.3 1.5'/><geom size='.05' mass='0.5' pos='0 0.2 0'/></body></body></body>
             </worldbody><actuator><position joint='p' kp='50' dampratio='0.7' gear='3' armature='0.3'/>
               <general joint='s' gainprm='5' biastype='affine' biasprm='0 -5 0.2'/></actuator></mujoco>"
        )
    };
    let model = clean(&text("0 0"));
    let close = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-11, "{found} {expected}");
    for (name, stiffness, damping) in [
        ("p", 301.1089430894304, 12.044357723577217),
        ("q", 212.04190071655304, 42.408380143310616),
        ("r", 0.16133646976825156, 0.16133646976825156),
        ("s", 0.07377692879125544, 0.09959885386819485),
    ] {
        close(joint(&model, &format!("{name}_spring")).stiffness, stiffness);
        close(joint(&model, name).drive_train.damping, damping);
    }
    close(joint(&model, "p").controller.gains.d, 9.0 * 5.726029885314585);
    close(joint(&model, "s").controller.gains.d, 0.10932457392637476);
    let (_, problems) = read(&text("1 1"));
    let expected = "joint t / springdamper` is 1.000e0, expected none of a ball joint; the joint moves without";
    assert!(problems.len() == 1 && problems[0].contains(expected), "{problems:?}");
}

#[test]
fn what_has_no_inertia_has_no_time_constant() {
    let text = "<mujoco><worldbody><body name='a'><joint name='p' springdamper='1 1'/></body></worldbody></mujoco>";
    let (model, problems) = read(text);
    assert!(problems.iter().any(|problem| problem.contains("springdamper` is with the inertia 0.0e0")), "{problems:?}");
    assert_eq!(joint(&model, "p").drive_train.damping, 0.0);
}

#[test]
fn losses_of_free_joints_are_named() {
    let text = "<mujoco><default><joint damping='1'/></default><worldbody><body><freejoint/><geom size='1'/></body>
         <body><joint name='j' type='free' armature='0.5' stiffness='1'/><geom size='1'/></body>
         <body><joint name='k' type='free'/><body><geom size='1'/></body></body></worldbody></mujoco>";
    let (_, problems) = read(text);
    for (problem, expected) in problems.iter().zip(["joint j / stiffness", "joint j / armature", "joint k / damping"]) {
        assert!(problem.contains(expected) && problem.contains("expected none of a free joint"), "{problem}");
    }
    assert_eq!(problems.len(), 3, "{problems:?}");
}

/// d v / d t = −d v / m, and so on: after 1 s exp(−d / m) of the velocity is left.
#[test]
fn bodies_have_the_damping_of_their_free_joints() {
    let text = |damping: &str, geom: &str| {
        world(&format!(
            "<body name='a'><joint type='free' damping='{damping}'/><geom type='box' mass='2' {geom}/></body>"
        ))
    };
    let surface = |model: &Model| body(model, "a").surface;
    let cube = surface(&clean(&text("0.01", "size='0.1 0.1 0.1'")));
    let moment = 2.0 * 0.2 * 0.2 / 6.0;
    assert!((cube.linear_damping - (1.0 - (-0.005f64).exp())).abs() < 1e-15);
    assert!((cube.angular_damping - (1.0 - (-0.01f64 / moment).exp())).abs() < 1e-15);
    let off = text("0.01", "size='0.1 0.1 0.1'")
        .replace("<worldbody>", "<option><flag damper='disable'/></option><worldbody>");
    assert_eq!(surface(&clean(&off)).linear_damping, 0.0);
    for (damping, geom) in
        [("0.01", "size='0.1 0.2 0.1'"), ("0.01", "size='0.1 0.1 0.1' pos='0.1 0 0'"), ("10", "size='0.1 0.1 0.1'")]
    {
        let (model, problems) = read(&text(damping, geom));
        assert!(problems.len() == 1 && problems[0].contains("expected at most 30/s of a body with"), "{problems:?}");
        assert!(surface(&model).angular_damping < 1.0);
    }
}

#[test]
fn equalities_and_tendons_couple_joints() {
    let model = |rest: &str| clean(&format!("<mujoco>{ARM}{rest}</mujoco>"));
    let coupling = |model: &Model, name| joint(model, name).coupling.clone();
    let leader = |name: &str, ratio| Leader { joint: format!("JOINT {name}"), ratio };
    let quarter = std::f64::consts::FRAC_PI_2;
    // r − π/2 = 0.1 + 2 p
    let one = model("<equality><joint joint1='r' joint2='p' polycoef='0.1 2 0 0 0'/></equality>");
    assert_eq!(coupling(&one, "r"), Some(Coupling { leaders: vec![leader("p", 2.0)], offset: quarter + 0.1 }));
    let tendons = "<tendon><fixed name='t'><joint joint='p' coef='0.5'/><joint joint='q' coef='2'/></fixed>
        <fixed name='u'><joint joint='p' coef='3'/></fixed></tendon>";
    // 0.5 p + 2 q = 0
    let two = model(&format!("{tendons}<equality><tendon tendon1='t'/></equality>"));
    assert_eq!(coupling(&two, "q"), Some(Coupling { leaders: vec![leader("p", -0.25)], offset: 0.0 }));
    // A tendon over joints that are coupled is an actuator of the leader: with q = 4 p it is 8.5 p long.
    let three = model(&format!(
        "{tendons}<equality><joint joint1='q' joint2='p' polycoef='0 4'/></equality>
         <actuator><position tendon='t' kp='2'/><motor tendon='u' gear='2' ctrlrange='-1 1'/></actuator>"
    ));
    let p = joint(&three, "p");
    assert_eq!((p.controller.gains.p, p.drive_train.max_effort), (2.0 * 8.5 * 8.5, Some(6.0)));
    let still = model("<equality><joint joint1='r' polycoef='0.25'/></equality>");
    let (low, high) = joint(&still, "r").limits.map(|Limits { low, high }| (low, high)).expect("limits");
    assert!(low == high && (low - quarter - 0.25).abs() < 1e-15);
    let circle = "<equality><joint joint1='p' joint2='q'/><joint joint1='q' joint2='p'/></equality>";
    let (model, problems) = read(&format!("<mujoco>{ARM}{circle}</mujoco>"));
    assert!(!problems.is_empty() && problems.iter().all(|p| p.contains("follows itself")), "{problems:?}");
    assert_eq!(coupling(&model, "p"), None);
    let free = format!("<mujoco>{ARM}{tendons}<actuator><position tendon='t'/></actuator></mujoco>");
    assert!(read(&free).1[0].contains("expected a fixed tendon of one joint"), "{:?}", read(&free).1);
}

/// Stiffness, rest and losses of joints are those that `qfrc_spring`, `qfrc_damper` and `mj_fullM` of MuJoCo 4.0.0 have.
#[test]
fn what_a_tendon_of_one_joint_has_is_that_of_the_joint() {
    let text = |p: &str| {
        format!(
            "<mujoco><default><tendon damping='0.5'/><default class='soft'><tendon stiffness='3'/></default></default><worldbody>
               <body name='a'><joint name='p' stiffness='4' springref='30' ref='10' damping='1' range='-60 60'/><geom size='0.1'/></body>
               <body name='b'><joint name='q' type='slide'/><geom size='0.1'/></body></worldbody>
             <tendon><fixed name='t' class='soft' range='-1 1.5' frictionloss='0.2' armature='0.05'>{p}</fixed>
               <fixed name='u' stiffness='6' springlength='0.4' limited='false' range='0 1'><joint joint='q' coef='0.5'/></fixed></tendon></mujoco>"
        )
    };
    let model = clean(&text("<joint joint='p' coef='-2'/>"));
    let (p, q) = (joint(&model, "p"), joint(&model, "q"));
    assert_eq!(p.limits.map(|limits| [limits.low, limits.high]), Some([-0.75, 0.5]));
    let losses = DriveTrain { damping: 3.0, friction: 0.4, armature: 0.2, ..DriveTrain::default() };
    assert_eq!(p.drive_train, losses);
    assert_eq!((q.limits, q.drive_train.damping), (None, 0.125));
    let spring = |name| (joint(&model, name).stiffness, joint(&model, name).equilibrium_point.expect("a rest"));
    assert_eq!(spring("p_spring"), (16.0, 30f64.to_radians()));
    assert_eq!(spring("q_spring"), (1.5, 0.8));

    let (model, problems) = read(&text("<joint joint='p' coef='1'/><joint joint='q' coef='1'/>"));
    for (problem, key) in problems.iter().zip(["range", "stiffness", "damping", "frictionloss", "armature"]) {
        let expected = format!("fixed t / {key}` is not used; tendons of several joints have nothing of their own");
        assert!(problem.contains(&expected), "{problem}");
    }
    assert_eq!((problems.len(), joint(&model, "p").drive_train.damping), (5, 1.0), "{problems:?}");
    let (model, problems) = read(&text("<joint joint='p' coef='1e-3'/>").replace("-1 1.5", "1 1.5"));
    assert!(problems.len() == 1 && problems[0].contains("range` is outside the range of `p`"), "{problems:?}");
    assert_eq!(joint(&model, "p").limits.map(|limits| limits.low), Some((-60f64).to_radians()));
}

#[test]
fn defaults_of_equalities_and_pairs_count_or_are_named() {
    let text = "<mujoco><default><pair friction='2' condim='1'/><equality active='false'/></default><worldbody>
           <body name='a'><freejoint/><geom size='1'/></body></worldbody>
         <equality><connect body1='a' anchor='0 0 0'/><weld body1='a' active='true'/></equality></mujoco>";
    let (model, problems) = read(text);
    for (problem, expected) in problems.iter().zip([
        "default / pair / condim` is not used; the contact has the friction of both bodies",
        "default / pair / friction` is not used",
        "equality / connect` is not used; it is not active, and cannot be activated",
    ]) {
        assert!(problem.contains(expected), "{problem}");
    }
    assert_eq!((problems.len(), model.joints.len()), (3, 1), "{problems:?}");
}

#[test]
fn masses_that_are_fixed_to_bodies_may_be_points() {
    let text = |joint: &str| {
        world(&format!(
            "<body name='a'><freejoint/><geom size='0.1'/>
               <body name='p'>{joint}<inertial mass='2' pos='0 0 1' diaginertia='0 0 0'/><geom size='0.1'/></body></body>"
        ))
    };
    let point = clean(&text(""));
    let p = body(&point, "p");
    assert!(p.mass == 2.0 && p.inertia.expect("tiny").amax() < 1e-8, "{:?}", p.inertia);
    let (_, problems) = read(&text("").replace("0 0 0'/>", "-1 1 1'/>"));
    assert!(problems.len() == 1 && problems[0].contains("moments above 0; they are 0"), "{problems:?}");
    let light = world(
        "<body name='a'><freejoint/><inertial mass='1e-9' pos='0 0 0' diaginertia='1e-9 1e-9 1e-9'/><body><geom size='1'/></body></body>",
    );
    assert_eq!(body(&clean(&light), "a").mass, 1e-9, "as it is written, however much hangs on it");
    let (model, problems) = read(&text("<joint/>"));
    assert!(problems.len() == 1 && problems[0].contains("moments above 0; it is estimated"), "{problems:?}");
    assert_eq!(body(&model, "p").inertia, None, "that of the shape");
}

#[test]
fn surfaces_weigh() {
    let text = "<mujoco><asset><mesh name='m' inertia='shell' vertex='0 0 0 1 0 0 0 2 0 0 0 3 1 1 1'
           face='0 2 1 0 1 3 0 3 2 1 2 4 2 3 4 3 1 4'/></asset><worldbody>
         <body name='a'><freejoint/><geom type='box' size='0.1 0.2 0.3' shellinertia='true' density='10'/></body>
         <body name='b'><freejoint/><geom type='mesh' mesh='m' density='10'/></body></worldbody></mujoco>";
    let model = clean(text);
    let a = body(&model, "a");
    assert!((a.mass - 8.8).abs() < 1e-14 && (a.inertia.expect("moments").sum() - 1.2053333333333334).abs() < 1e-14);
    // MuJoCo 4.0.0.
    let b = body(&model, "b");
    let mut moments: Vec<f64> = b.inertia.expect("moments").iter().copied().collect();
    moments.sort_by(|a, b| b.total_cmp(a));
    let expected = [83.61153027492016, 70.54103380656348, 32.02464549016047];
    assert!(moments.iter().zip(expected).all(|(a, b)| (a / b - 1.0).abs() < 1e-6), "{moments:?}");
    assert!((b.mass / 102.53885959956261 - 1.0).abs() < 1e-7, "{}", b.mass);
}

/// Numbers of MuJoCo 4.0.0: `body_mass`, `body_inertia`, `body_ipos`.
#[test]
fn bounds_are_of_bodies_without_a_mass_too() {
    let read = |compiler: &str, a: &str| {
        let text = format!(
            "<mujoco><compiler {compiler}/><worldbody><body name='a' pos='1 2 3'><joint name='p'/>{a}
               <body name='b' pos='0 0 1'><geom size='0.1'/></body></body></worldbody></mujoco>"
        );
        let a = body(&clean(&text), "a").clone();
        let place = a.inertial_offset.map(|offset| offset.translation.vector);
        (a.mass, a.inertia.map(|moments| moments.x), place.map(|place| place.x))
    };
    let both = "boundmass='0.5' boundinertia='0.2'";
    assert_eq!(read(both, ""), (0.5, Some(0.2), Some(1.0)));
    assert_eq!(read(both, "<geom size='.1' mass='0' pos='4 0 0'/>"), (0.5, Some(0.2), Some(1.0)));
    assert_eq!(read(both, "<inertial mass='0' pos='0.3 0 0' diaginertia='0 0 0'/>"), (0.5, Some(0.2), Some(0.3)));
    let (mass, ..) = read("", "<inertial mass='0' pos='0 0 0' diaginertia='0 0 0'/><geom size='.1'/>");
    assert!(mass < 1e-6, "geoms do not count beside an inertial");
    let (mass, moment, _) = read("boundinertia='0.2'", "");
    assert!(mass < 1e-6 && moment == Some(0.2));
    let (mass, moment, _) = read("", "<inertial mass='0' pos='0.3 0 0' diaginertia='1 1 1'/>");
    assert!(mass < 1e-6 && moment == Some(1.0));
    let (mass, ..) = read(
        "inertiafromgeom='true'",
        "<inertial mass='3' pos='0 0 0' diaginertia='1 1 1'/><geom mass='0' size='.1'/>",
    );
    assert_eq!(mass, 3.0);
}

/// MuJoCo 4.0.0 has the centre of mass at (0.36363636, 1.72727273, -0.61363636).
#[test]
fn meshes_are_turned_and_then_scaled() {
    let text = |rest: &str| {
        format!(
            "<mujoco><asset><mesh name='m' {rest} vertex='0 0 0 1 0 0 0 2 0 0 0 3 1 1 1' face='0 2 1 0 1 3 0 3 2 1 2 4 2 3 4 3 1 4'/></asset>
             <worldbody><body name='a'><freejoint/><geom type='mesh' mesh='m'/></body></worldbody></mujoco>"
        )
    };
    let centre = |model: &Model| body(model, "a").inertial_offset.expect("a centre").translation.vector;
    let found = centre(&clean(&text("scale='1 2 1' refquat='1 1 0 0'")));
    assert!((found - Vector3::new(0.36363636, 1.72727273, -0.61363636)).amax() < 1e-8, "{found}");
    let (_, problems) = read(&text("scale='1 2 1' refquat='2 1 0 0'"));
    assert!(problems.len() == 1 && problems[0].contains("scale` is `1 2 1`, expected one factor"), "{problems:?}");
}

/// Numbers of MuJoCo 4.0.0: `body_mass`.
#[test]
fn hulls_weigh() {
    // A cube from which a pyramid is cut out, with its top at the centre.
    let faces = "0 1 8 1 3 8 3 2 8 2 0 8 4 6 5 5 6 7 0 4 1 1 4 5 2 3 6 3 7 6 0 2 4 2 6 4 1 5 3 3 5 7";
    let mass = |inertia: &str, faces: &str| {
        let (model, _) = read(&format!(
            "<mujoco><asset><mesh name='m' inertia='{inertia}' vertex='0 0 0 0 0 1 0 1 0 0 1 1 1 0 0 1 0 1 1 1 0 1 1 1 0.5 0.5 0.5' {faces}/></asset>
             <worldbody><body name='a'><freejoint/><geom type='mesh' mesh='m' density='6'/></body></worldbody></mujoco>"
        ));
        body(&model, "a").mass
    };
    let with_faces = format!("face='{faces}'");
    for (inertia, faces, expected) in
        [("exact", with_faces.as_str(), 5.0), ("convex", &with_faces, 6.0), ("legacy", "", 6.0), ("shell", "", 36.0)]
    {
        let found = mass(inertia, faces);
        assert!((found - expected).abs() < 1e-12, "{inertia}: {found}");
    }
}

#[test]
fn equalities_close_loops() {
    let model = clean(&format!(
        "<mujoco>{}<equality><connect name='k' body1='a' body2='b' anchor='0 0 1'/><weld body1='c'/></equality></mujoco>",
        ARM.replace("<body name='b'>", "<body name='b' pos='3 0 0'>")
    ));
    let k = joint(&model, "k");
    assert_eq!((k.kind.clone(), k.parent.as_str(), k.child.as_str()), (JointKind::PointToPoint, "BODY a", "BODY b"));
    let at = |name: &str, pivot: &Vector3<f64>| body(&model, name).location * Point3::from(*pivot);
    assert!((at("a", &k.parent_pivot) - at("b", &k.child_pivot)).norm() < 1e-15);
    let weld = model.joints.last().expect("a joint");
    assert_eq!((weld.kind.clone(), weld.child.as_str()), (JointKind::Fixed, "BODY world"));
    let (_, problems) = read(&format!("<mujoco>{ARM}<equality><weld body1='c' active='false'/></equality></mujoco>"));
    assert!(problems.len() == 1 && problems[0].contains("cannot be activated"), "{problems:?}");
}

#[test]
fn cameras_lights_and_sensors() {
    let model = clean(
        "<mujoco><compiler autolimits='true'/><worldbody><light pos='0 0 3' dir='0 0 -1' cutoff='30'/>
           <body name='a'><freejoint/><geom size='1'/><site name='s' pos='0 0 1' zaxis='1 0 0'/>
           <camera name='eye' pos='1 0 0' xyaxes='0 1 0 0 0 1' fovy='60'/></body></worldbody>
         <sensor><touch name='t' site='s'/><rangefinder site='s' cutoff='2'/></sensor></mujoco>",
    );
    let camera = &model.cameras[0];
    assert_eq!((camera.parent.as_str(), camera.visible), ("BODY a", false));
    assert!((camera.look_at - Vector3::zeros()).norm() < 1e-15 && (camera.up - Vector3::z()).norm() < 1e-15);
    assert!((camera.field_view_angle - 60f64.to_radians()).abs() < 1e-15);
    assert_eq!(model.lights[0].direction, Some(-Vector3::z()));
    assert!((model.lights[0].cutoff_angle - 30f64.to_radians()).abs() < 1e-15);
    assert_eq!(model.sensors.len(), 2);
    assert_eq!((model.sensors[1].range, model.sensors[1].parent.as_str()), (2.0, "BODY a"));
    assert!((model.sensors[1].location.rotation * Vector3::z() - Vector3::x()).norm() < 1e-15);
}

#[test]
fn orientations() {
    let turned = |attribute: &str| {
        let model = clean(&world(&format!("<body name='a' {attribute}><freejoint/><geom size='1'/></body>")));
        body(&model, "a").location.rotation
    };
    let about = |x: f64, y: f64, z: f64| UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z));
    let half = std::f64::consts::FRAC_PI_2;
    for (attribute, expected) in [
        ("axisangle='0 0 2 90'", about(0.0, 0.0, half)),
        ("euler='90 0 90'", about(half, 0.0, 0.0) * about(0.0, 0.0, half)),
        ("quat='2 0 0 2'", about(0.0, 0.0, half)),
        ("xyaxes='0 1 0 -1 5 0'", about(0.0, 0.0, half)),
        ("zaxis='0 1 0'", about(-half, 0.0, 0.0)),
        ("zaxis='0 0 -1'", about(std::f64::consts::PI, 0.0, 0.0)),
    ] {
        assert!(turned(attribute).angle_to(&expected) < 1e-7, "{attribute}: {}", turned(attribute));
    }
    let text = "<mujoco><compiler angle='radian' eulerseq='XYZ'/><worldbody><body name='a' euler='1 2 3'><freejoint/>\
                <geom size='1'/></body></worldbody></mujoco>";
    let expected = about(0.0, 0.0, 3.0) * about(0.0, 2.0, 0.0) * about(1.0, 0.0, 0.0);
    assert!(body(&clean(text), "a").location.rotation.angle_to(&expected) < 1e-7);
}

#[test]
fn frames_move_what_is_in_them() {
    let model = clean(&world(
        "<frame pos='1 0 0' euler='0 0 90'><body name='a' pos='1 0 0'><freejoint/><frame pos='0 0 1'><geom size='1'/></frame></body></frame>",
    ));
    assert!((body(&model, "a").location.translation.vector - Vector3::new(1.0, 1.0, 0.0)).norm() < 1e-15);
    let offset = body(&model, "a").inertial_offset.expect("given").translation.vector;
    assert!((offset - Vector3::z()).norm() < 1e-15);
}

#[test]
fn frames_move_joints_and_keep_their_order() {
    let model = clean(&world(
        "<body name='a'><joint name='x' axis='1 0 0'/>
           <frame pos='1 0 0' euler='0 0 90'><joint name='y' axis='1 0 0' pos='0 2 0'/>
             <frame pos='0 0 3'><joint name='s' type='slide' axis='0 1 0'/></frame><joint name='b' type='ball' pos='1 0 0'/></frame>
           <joint name='z'/><geom size='1' mass='1'/></body>",
    ));
    let names: Vec<_> = model.joints.iter().map(|joint| joint.common.name.as_str()).collect();
    assert_eq!(names, ["x", "y", "s", "b", "z"]);
    for (name, pivot, axis) in [
        ("x", Vector3::zeros(), Vector3::x()),
        ("y", Vector3::new(-1.0, 0.0, 0.0), Vector3::y()),
        ("s", Vector3::new(1.0, 0.0, 3.0), -Vector3::x()),
        ("b", Vector3::new(1.0, 1.0, 0.0), Vector3::z()),
        ("z", Vector3::zeros(), Vector3::z()),
    ] {
        let found = joint(&model, name);
        assert!((found.child_pivot - pivot).norm() < 1e-15, "{name}: {}", found.child_pivot);
        assert!((found.child_axis - axis).norm() < 1e-15, "{name}: {}", found.child_axis);
    }
}

#[test]
fn generated_names_leave_those_that_the_file_gives() {
    let model = clean(&world(
        "<body><joint/><geom size='1'/></body>
         <frame><body name='body1'><joint name='body1__joint0'/><geom size='1'/>
           <body name='body1_'><joint name='j'/><geom size='1'/></body></body></frame>",
    ));
    let names: Vec<_> = model.bodies.iter().map(|body| body.common.name.as_str()).collect();
    assert_eq!(names, ["world", "body1__", "body1", "body1_"]);
    assert_eq!(joint(&model, "body1__joint0").child, "BODY body1");
    assert_eq!(joint(&model, "body1___joint0").child, "BODY body1__");
    let model = clean(&world(
        "<body name='a'><joint/><geom size='1'/><body name='b'><joint name='a_joint0'/><geom size='1'/></body></body>",
    ));
    assert_eq!((joint(&model, "a_joint0").child.as_str(), model.joints.len()), ("BODY b", 2));
    assert_eq!(joint(&model, "a_joint0_").child, "BODY a");
    // What is made beside bodies and joints: bodies between joints, fixed joints, springs, planes and loops.
    let model = clean(
        "<mujoco><worldbody><geom name='a_x' type='plane'/>
           <body name='a'><joint name='x' stiffness='1'/><joint name='y' axis='0 1 0'/><geom size='1'/>
             <body name='a_x'><joint name='x_spring'/><geom size='1'/></body>
             <body name='f'><geom size='1'/><body name='g'><joint name='f_fixed'/><geom size='1'/></body></body></body>
         </worldbody><equality><connect name='x' body1='g' body2='a_x' anchor='0 0 1'/></equality></mujoco>",
    );
    let mut all: Vec<_> = model.bodies.iter().map(|body| &body.common.identifier).collect();
    all.extend(model.joints.iter().map(|joint| &joint.common.identifier));
    let count = all.len();
    all.sort();
    all.dedup();
    assert_eq!((all.len(), count), (14, 14), "{all:?}");
    assert_eq!(
        (joint(&model, "x").child.as_str(), joint(&model, "x_spring").child.as_str()),
        ("BODY a_x_", "BODY a_x")
    );
    assert_eq!(
        (joint(&model, "f_fixed").child.as_str(), joint(&model, "f_fixed_").child.as_str()),
        ("BODY g", "BODY f")
    );
    assert_eq!(
        (joint(&model, "x_spring_").stiffness, joint(&model, "x_").kind.clone()),
        (1.0, JointKind::PointToPoint)
    );
}

#[test]
fn what_is_not_known_or_used_is_named_with_its_place() {
    let text = "<mujoco>\n<option timestep='0.01' integrator='RK4' wind='1 0 0'/>\n<worldbody>\n<body name='a' posi='1 2 3'><freejoint/>\n\
                <geom size='1' class='none'/><geom type='mesh' mesh='m'/><geom size='0'/><blob/></body></worldbody>\n\
                <tendon><spatial/></tendon>\n<keyframe><key ctrl='1'/></keyframe></mujoco>";
    let (_, problems) = read(text);
    for expected in [
        "dir/t.xml:2:9: info: `option / timestep` is not used",
        "dir/t.xml:2:25: info: `option / integrator` is not used; it concerns MuJoCo's solver",
        "dir/t.xml:2:42: warning: `option / wind` is not used",
        "dir/t.xml:4:16: warning: `worldbody / body a / posi` is not known; it is ignored",
        "dir/t.xml:5:16: error: `worldbody / body a / geom / class` is `none`, expected the name of a class",
        "geom / mesh` is `m`, expected the name of a mesh in `asset`; the geom is left out",
        "geom / size` is [0.0], expected 1 lengths above 0; the geom is left out",
        "`worldbody / body a / blob` is not known",
        "dir/t.xml:6:9: error: `tendon / spatial` is not used; only fixed tendons are read",
        "dir/t.xml:7:16: info: `keyframe / key / ctrl` is not used; commands are not part of a state",
    ] {
        assert!(problems.iter().any(|problem| problem.contains(expected)), "{expected}: {problems:#?}");
    }
    assert_eq!(problems.len(), 10, "{problems:#?}");
}

#[test]
fn what_cannot_be_read_refuses_the_file() {
    for (text, expected) in [
        (
            "<mujoco><worldbody><geom size='a'/></worldbody></mujoco>",
            "`worldbody / geom / size` is `a`, expected 1 to 3 numbers",
        ),
        ("<mujoco><worldbody><geom pos='1 2'/></worldbody></mujoco>", "is `1 2`, expected 3 numbers"),
        ("<mujoco><worldbody><geom type='ball'/></worldbody></mujoco>", "is `ball`, expected plane, hfield, sphere"),
        ("<mujoco><compiler angle='grad'/></mujoco>", "`compiler / angle` is `grad`, expected degree, radian"),
        ("<mujoco><include file='no.xml'/></mujoco>", "expected a file: there is no no.xml"),
        ("<mujoco><compiler coordinate='global'/></mujoco>", "expected local"),
    ] {
        let problems = refused(text);
        assert!(problems.iter().any(|problem| problem.contains(expected)), "{expected}: {problems:?}");
    }
    let error = parse("<robot/>", Path::new("t.xml"), Surroundings::Nothing).unwrap_err();
    assert!(error.to_string().contains("t.xml:1:1: the root element is <robot>"), "{error}");
}

#[test]
fn included_files_and_meshes() {
    let folder = std::env::temp_dir().join(format!("ambf_mjcf_{}", std::process::id()));
    std::fs::create_dir_all(folder.join("parts")).expect("made");
    let write = |name: &str, text: &str| {
        std::fs::write(folder.join(name), text).expect("written");
        folder.join(name)
    };
    // A tetrahedron of 1/6 m³.
    write("parts/t.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n");
    write(
        "parts/body.xml",
        "<mujocoinclude>\n<body name='b'><freejoint/><geom type='mesh' mesh='t'/><geo/></body></mujocoinclude>",
    );
    let main = write(
        "m.xml",
        "<mujoco><compiler meshdir='.\\parts'/><asset><mesh file='.\\t.obj' scale='2 2 -2'/></asset>
         <worldbody><include file='parts\\body.xml'/></worldbody></mujoco>",
    );
    let text = std::fs::read_to_string(&main).expect("read");
    let (model, report, sources) = parse_with_files(&text, &main, Surroundings::Disk).expect("read");
    let b = body(&model, "b");
    assert!((b.mass - 8000.0 / 6.0).abs() < 1e-9, "{}", b.mass);
    let centre = b.inertial_offset.expect("given").translation.vector;
    assert!((centre - Vector3::new(0.5, 0.5, -0.5)).norm() < 1e-12, "{centre}");
    let problems: Vec<_> = report.problems().iter().map(|problem| problem.to_string()).collect();
    assert!(
        problems.len() == 1 && problems[0].contains("parts/body.xml:2:56: warning: `body b / geo`"),
        "{problems:?}"
    );
    assert!(sources.are_current());
    write("parts/body.xml", "<mujocoinclude><include file='parts/body.xml'/></mujocoinclude>");
    assert!(!sources.are_current());
    let twice = load(&main).unwrap_err().to_string();
    assert!(twice.contains("`include / file` `parts/body.xml`, again"), "{twice}");
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn bodies_in_bodies_without_end() {
    let depth = 20_000;
    let text = format!(
        "<mujoco><worldbody>{}{}</worldbody></mujoco>",
        "<body><joint/><geom size='1'/><x/>".repeat(depth),
        "</body>".repeat(depth)
    );
    let (model, report) = parse(&text, Path::new("t.xml"), Surroundings::Nothing).expect("read");
    assert_eq!((model.bodies.len(), model.joints.len()), (depth + 1, depth));
    assert!(report.to_string().len() < 1000);
}

/// The corner of a cube: 1/6 m³ at scale 1, with its surface looking outwards.
const CORNER: &str = "vertex='0 0 0 1 0 0 0 1 0 0 0 1' face='0 2 1 0 1 3 1 2 3 2 0 3'";

#[test]
fn meshes_whose_vertices_are_in_the_text() {
    let text = |mesh: &str| {
        format!(
            "<mujoco><asset><mesh name='m' {mesh}/></asset>
             <worldbody><body name='b'><freejoint/><geom type='mesh' mesh='m' pos='0 0 5'/></body></worldbody></mujoco>"
        )
    };
    let model = clean(&text(&format!("{CORNER} scale='2 2 -2' refpos='1 0 0'")));
    let b = body(&model, "b");
    assert!((b.mass - 8000.0 / 6.0).abs() < 1e-9, "{}", b.mass);
    let centre = b.inertial_offset.expect("given").translation.vector;
    assert!((centre - Vector3::new(0.5 - 2.0, 0.5, 5.0 - 0.5)).norm() < 1e-12, "{centre}");
    let CollisionGeometry::Parts { parts, .. } = &b.collision else { panic!("{:?}", b.collision) };
    let PartGeometry::Triangles(mesh) = &parts[0].geometry else { panic!("{parts:?}") };
    assert_eq!((mesh.vertex_count(), mesh.triangle_count()), (4, 4));
    let surface = &mesh.sub_meshes[0];
    assert_eq!(
        crate::mesh::enclosed_volume(&surface.vertices, &surface.triangles).map(|v| (v * 6.0).round()),
        Some(8.0)
    );

    let with_mass = |mesh: &str| text(mesh).replace("pos='0 0 5'", "mass='0'/><geom size='1'");
    let (model, problems) = read(&with_mass("vertex='0 0 0 1 0 0 0 1 0 0 0 1'"));
    assert!(
        problems.len() == 1 && problems[0].contains("it collides and weighs as the hull of its vertices"),
        "{problems:?}"
    );
    assert!(matches!(&body(&model, "b").collision, CollisionGeometry::Parts { parts, .. } if parts.len() == 2));
    for (mesh, expected) in [
        ("", "mesh m / vertex` is absent, as `file` is, expected three numbers each vertex, or a file"),
        ("vertex='0 0'", "mesh m / vertex` is 2 numbers, expected three numbers each vertex"),
        (
            "vertex='0 0 0' face='0 0 1'",
            "mesh m / face` is 3 numbers, expected three indices each triangle, from 0 to 0",
        ),
        ("vertex='0 0 0' face='0 -1 0'", "expected three indices each triangle"),
        ("vertex='0 0 0' face='0 0.5 0'", "expected three indices each triangle"),
        ("vertex='0 0 0' face='0 0'", "is 2 numbers, expected three indices each triangle"),
    ] {
        let (model, problems) = read(&with_mass(mesh));
        assert!(problems.len() == 1 && problems[0].contains(expected), "{expected}: {problems:?}");
        assert!(problems[0].contains("geoms that use the mesh are left out"), "{problems:?}");
        assert!(matches!(&body(&model, "b").collision, CollisionGeometry::Parts { parts, .. } if parts.len() == 1));
    }
}

#[test]
fn height_fields_are_bodies_of_their_own() {
    let text = |field: &str, rest: &str| {
        format!(
            "<mujoco><asset><hfield name='h' {field}/></asset><worldbody><geom name='box' type='box' size='1 1 1'/>
               <body name='hill' pos='0 0 1'><geom type='hfield' hfield='h' pos='0 1 0' contype='2' rgba='0 1 0 1'/></body>{rest}</worldbody></mujoco>"
        )
    };
    let size = "size='2 1 3 0.5'";
    let model = clean(&text(&format!("nrow='2' ncol='3' elevation='1 2 3 4 5 7' {size}"), ""));
    let field = body(&model, "hill_hfield0");
    assert_eq!((field.mass, field.collision_filter.as_ref().map(|filter| filter.kind)), (0.0, Some(2)));
    let CollisionGeometry::Parts { parts, kind } = &field.collision else { panic!("{:?}", field.collision) };
    assert_eq!(*kind, crate::adf::CollisionMeshKind::ConcaveMesh, "not its hull");
    assert_eq!(parts[0].offset.translation.vector, Vector3::new(0.0, 1.0, 1.0));
    let PartGeometry::Triangles(mesh) = &parts[0].geometry else { panic!("{parts:?}") };
    assert_eq!(mesh.sub_meshes[0].vertices[2], [2.0, -1.0, 3.0], "the first row of the text is that of the largest y");
    assert!(matches!(&field.visual.geometry, VisualGeometry::Parts(drawn) if drawn[0].part == parts[0]));
    assert_eq!(body(&model, "hill").collision, CollisionGeometry::None);
    let flat = clean(&text(&format!("nrow='2' ncol='2' {size}"), ""));
    assert!(flat.bodies.iter().any(|body| body.common.identifier == "BODY hill_hfield0"));

    // A few letters don't ask for more than one large one.
    let large = format!("nrow='2000' ncol='2000' {size}/><hfield name='g' nrow='2000' ncol='2000' {size}");
    let (_, problems) = read(&text(&large, "<geom type='hfield' hfield='h'/>"));
    assert!(problems.len() == 2 && problems[0].contains("`asset / hfield g / nrow` is of 2000 rows"), "{problems:?}");
    let expected = "geom / hfield` is one height field too many, expected 10000000 triangles of all of them";
    assert!(problems[1].contains(expected), "{problems:?}");
    for (field, rest, expected) in [
        (
            format!("nrow='2' ncol='3' elevation='1 2' {size}"),
            "",
            "hfield h / nrow` is 2 elevations, expected 2 times 3",
        ),
        (
            format!("nrow='1e9' ncol='1e9' {size}"),
            "",
            "is of 1000000000 rows and 1000000000 columns, expected 2 or more",
        ),
        (size.to_owned(), "", "hfield h / nrow` is of 0 rows and 0 columns"),
        (
            "nrow='2' ncol='2' size='1 1 0 1'".to_owned(),
            "",
            "hfield h / size` is `1 1 0 1`, expected four lengths above 0",
        ),
        (
            format!("file='h.bin' {size}"),
            "",
            "hfield h / file` is a file that is not there, expected a file; geoms that use",
        ),
        (
            format!("nrow='2' ncol='2' {size}"),
            "<body name='m'><freejoint/><geom size='1'/><geom type='hfield' hfield='h'/></body>",
            "moves, and has a height field; the height field is left out",
        ),
        (
            format!("nrow='2' ncol='2' {size}"),
            "<geom type='hfield' hfield='g'/>",
            "geom / hfield` is `g`, expected the name of a hfield in `asset`; the geom is left out",
        ),
    ] {
        let (_, problems) = read(&text(&field, rest));
        assert!(problems.len() == 1 && problems[0].contains(expected), "{expected}: {problems:?}");
    }
}

/// Numbers are in the order of the joints in the file: a body, then what hangs on it.
#[test]
fn keyframes_are_states_of_joints_and_free_bodies() {
    let text = |keys: &str| {
        format!(
            "<mujoco><worldbody>
               <body name='f' pos='0 0 1'><freejoint/><geom size='0.1' pos='0.5 0 0'/>
                 <body name='a'><joint name='x' type='slide' axis='1 0 0'/><joint name='y' axis='0 1 0' stiffness='1'/><geom size='0.1'/></body>
               </body>
               <body name='b'><joint name='z' type='ball'/><geom size='0.1'/></body><body name='c'><joint name='w' ref='90' range='0 90'/><geom size='0.1'/></body>
             </worldbody><keyframe>{keys}</keyframe></mujoco>"
        )
    };
    let model = clean(&text(
        "<key name='home' qpos='1 2 3 0 0 0 2 0.4 0.5 1 0 0 0 0.6' qvel='0 0 0 0 0 1 7 8 0 0 0 9'/>
         <key qvel='1 0 0 0 0 0 0 0 0 0 0 0'/>",
    ));
    let joints = |values: &[(usize, f64)]| -> Vec<(String, f64)> {
        values.iter().map(|&(index, value)| (model.joints[index].common.name.clone(), value)).collect()
    };
    let expected = |[x, y, w]: [f64; 3]| vec![("x".to_owned(), x), ("y".to_owned(), y), ("w".to_owned(), w)];
    let [home, moving] = &model.keyframes[..] else { panic!("{:?}", model.keyframes) };
    assert_eq!((home.name.as_str(), moving.name.as_str()), ("home", "1"));
    assert_eq!(joints(&home.positions), expected([0.4, 0.5, 0.6]), "rad and m, with `ref`, as MuJoCo's");
    assert_eq!(joints(&home.rates), expected([7.0, 8.0, 9.0]));
    let [(index, pose)] = home.poses[..] else { panic!("{:?}", home.poses) };
    assert_eq!(model.bodies[index].common.identifier, "BODY f");
    assert_eq!(pose.translation.vector, Vector3::new(1.0, 2.0, 3.0));
    assert!((pose * Point3::new(1.0, 0.0, 0.0) - Point3::new(0.0, 2.0, 3.0)).norm() < 1e-15, "half a turn about z");
    // Of the body frame in the file, of the centre of mass here, which is at -0.5 m along x after half a turn.
    let (_, [linear, angular]) = home.twists[0];
    assert!((linear - Vector3::new(0.0, -0.5, 0.0)).norm() < 1e-15 && angular == Vector3::z(), "{linear} {angular}");
    assert_eq!((&moving.positions[..], &moving.poses[..], moving.twists[0].1[0]), (&[][..], &[][..], Vector3::x()));
    assert_eq!(model.bodies, clean(&text("")).bodies, "the start is that of the bodies");

    let (model, problems) = read(&text(
        "<key name='short' qpos='1 2 3'/><key name='turned' qpos='1 2 3 1 0 0 0 0 0 0 1 0 0 -1e-3' mpos='1 2 3'/>",
    ));
    assert_eq!(model.keyframes.len(), 1);
    assert_eq!(model.keyframes[0].positions.last().map(|(_, position)| *position), Some(0.0));
    for (problem, expected) in problems.iter().zip([
        "error: `keyframe / key short / qpos` is 3 numbers, expected 14, those of all joints; the key is left out",
        "info: `keyframe / key turned / mpos` is not used",
        "warning: `keyframe / key turned / qpos` is not used; the ball joint z has no coordinate, and stays as it is",
        "warning: `keyframe / key turned / qpos` is -0.001 for w, expected its limits, 0 to 1.57079632",
    ]) {
        assert!(problem.contains(expected), "{expected}: {problem}");
    }
    assert_eq!(problems.len(), 4, "{problems:#?}");
}
