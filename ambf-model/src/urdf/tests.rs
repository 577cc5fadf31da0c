use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::*;
use crate::adf::{CollisionGeometry, CollisionMeshKind, Coupling, DriveTrain, JointKind, Leader, Limits, Severity};

/// Description and problems of a text that is read.
pub(super) fn read(text: &str) -> (Model, Vec<String>) {
    let (model, report) = parse(text, Path::new("dir/t.urdf"), &Packages::default()).unwrap_or_else(|e| panic!("{e}"));
    (model, report.problems().iter().map(|p| p.to_string()).collect())
}

/// As [`read`], of a text without problems.
pub(super) fn clean(text: &str) -> Model {
    let (model, problems) = read(text);
    assert_eq!(problems, [""; 0]);
    model
}

fn error(text: &str) -> String {
    match parse(text, Path::new("t.urdf"), &Packages::default()) {
        Ok((_, report)) => panic!("not refused: {report}"),
        Err(error) => error.to_string(),
    }
}

const MASS: &str = "<inertial><mass value='2'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>";
const SPHERE: &str = "<collision><geometry><sphere radius='1'/></geometry></collision>";

fn robot(inside: &str) -> String {
    format!("<robot name='r'>{}</robot>", inside.replace("MASS", MASS).replace("SPHERE", SPHERE))
}

/// Links from their names: capitals have a mass.
fn links(names: &[&str]) -> String {
    let link = |name: &&str| {
        let mass = if name.starts_with(char::is_uppercase) { MASS } else { "" };
        format!("<link name='{name}'>{mass}</link>")
    };
    names.iter().map(link).collect()
}

/// A joint called `parent-child`, one metre along x.
fn joint(kind: &str, parent: &str, child: &str) -> String {
    format!(
        "<joint name='{parent}-{child}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>\
         <origin xyz='1 0 0'/></joint>"
    )
}

fn names(model: &Model) -> Vec<(&str, f64, f64)> {
    let body = |b: &'_ crate::adf::RigidBody| (b.mass, b.location.translation.x);
    model.bodies.iter().map(|b| (b.common.name.as_str(), body(b).0, body(b).1)).collect()
}

fn joined(model: &Model) -> Vec<(&str, &str, &str)> {
    model.joints.iter().map(|j| (j.common.name.as_str(), j.parent.as_str(), j.child.as_str())).collect()
}

#[test]
fn names_and_defaults() {
    let model = clean(&robot("<link name='a b'>MASS</link>"));
    assert_eq!((model.name.as_str(), model.namespace.as_str()), ("t.urdf", "/ambf/env/r/"));
    assert!(model.ignore_inter_collision);
    let body = &model.bodies[0];
    assert_eq!((body.common.identifier.as_str(), body.common.name.as_str()), ("BODY a b", "ab"));
    assert_eq!(body.common.namespace, "/ambf/env/r/");
    assert_eq!((body.common.source.line, body.common.source.column), (1, 17));
    assert_eq!((body.mass, body.inertia, body.location), (2.0, Some(Vector3::repeat(1.0)), Isometry3::identity()));
    let (model, problems) = read("<robot><link name='a'/></robot>");
    assert_eq!(model.namespace, "/ambf/env/t/");
    assert_eq!(
        problems,
        ["dir/t.urdf:1:1: warning: `robot / name` is missing (the name of the robot); that of the file is used, `t`"]
    );
    for name in ["", "  "] {
        let (model, problems) = read(&format!("<robot name='{name}'><link name='a'/></robot>"));
        assert_eq!((model.namespace.as_str(), problems.len()), ("/ambf/env/t/", 1), "{problems:#?}");
        assert!(problems[0].starts_with("dir/t.urdf:1:8: warning: `robot / name` is `"), "{problems:#?}");
    }
    assert_eq!(clean("<robot name='/'><link name='a'/></robot>").namespace, "/ambf/env/");
}

#[test]
fn a_root_without_mass_stands_still_one_with_mass_does_not() {
    assert_eq!(names(&clean(&robot(&links(&["base"])))), [("base", 0.0, 0.0)]);
    assert_eq!(names(&clean(&robot(&links(&["Base"])))), [("Base", 2.0, 0.0)]);
    assert_eq!(names(&clean(&robot("<link name='world'>MASS</link>"))), [("world", 0.0, 0.0)]);
}

#[test]
fn what_is_fixed_to_the_world_stands_still() {
    let text = links(&["world", "frame", "Base", "Arm"])
        + &joint("fixed", "world", "frame")
        + &joint("fixed", "frame", "Base")
        + &joint("continuous", "Base", "Arm");
    let model = clean(&robot(&text));
    assert_eq!(names(&model), [("world", 0.0, 0.0), ("frame", 0.0, 1.0), ("Base", 0.0, 2.0), ("Arm", 2.0, 3.0)]);
    let passive: Vec<_> = model.joints.iter().map(|joint| joint.common.passive).collect();
    assert_eq!(passive, [true, true, false]);
}

#[test]
fn a_root_that_is_a_frame_of_a_body_moves_with_it() {
    // As robots on wheels are written.
    let text = links(&["footprint", "frame", "Base", "Wheel"])
        + &joint("fixed", "footprint", "frame")
        + &joint("fixed", "frame", "Base")
        + &joint("continuous", "footprint", "Wheel");
    let (model, problems) = read(&robot(&text));
    assert_eq!(names(&model), [("Base", 2.0, 2.0), ("Wheel", 2.0, 1.0)]);
    assert_eq!(joined(&model), [("footprint-Wheel", "BODY Base", "BODY Wheel")]);
    assert_eq!(model.joints[0].parent_pivot, Vector3::new(-1.0, 0.0, 0.0));
    assert_eq!(problems.len(), 2, "{problems:#?}");
    assert!(problems[0].contains("`link footprint / inertial` is missing (a mass above 0); the link is part of"));
}

#[test]
fn links_without_mass_become_part_of_what_they_are_fixed_to() {
    let tool = format!("<link name='tool'>{SPHERE}</link>");
    let text = links(&["Arm", "Claw"]) + &tool + &joint("fixed", "Arm", "tool") + &joint("prismatic", "tool", "Claw");
    let text = text.replace("type='prismatic'>", "type='prismatic'><limit lower='-1' upper='1'/>");
    let (model, problems) = read(&robot(&text));
    assert_eq!(names(&model), [("Arm", 2.0, 0.0), ("Claw", 2.0, 2.0)]);
    let CollisionGeometry::Parts { parts, kind } = &model.bodies[0].collision else { panic!() };
    assert_eq!(parts[0].offset, Isometry3::translation(1.0, 0.0, 0.0));
    assert!(matches!(kind, CollisionMeshKind::ConvexParts(_)), "{kind:?}");
    assert_eq!(model.joints[0].parent_pivot.x, 2.0);
    assert_eq!(problems.len(), 1);
}

#[test]
fn a_link_without_mass_on_a_moving_joint() {
    // Its mass is that of the link fixed to it, if there is one.
    let text = links(&["Arm", "frame", "Tip"]) + &joint("continuous", "Arm", "frame") + &joint("fixed", "frame", "Tip");
    let (model, _) = read(&robot(&text));
    assert_eq!(names(&model), [("Arm", 2.0, 0.0), ("Tip", 2.0, 2.0)]);
    assert_eq!(joined(&model), [("Arm-frame", "BODY Arm", "BODY Tip")]);
    assert_eq!((model.joints[0].parent_pivot.x, model.joints[0].child_pivot.x), (1.0, -1.0));
    // Otherwise next to nothing of what it carries, or else of what it hangs on.
    let inertia = |model: &Model, i: usize| model.bodies[i].inertia.map(|moments| (moments * 1e7).map(f64::round));
    let chain = links(&["world", "x", "y", "Base", "Arm", "tip"])
        + &joint("continuous", "world", "x")
        + &joint("continuous", "x", "y")
        + &joint("continuous", "y", "Base")
        + &joint("fixed", "Base", "Arm")
        + &joint("continuous", "Arm", "tip");
    let (model, problems) = read(&robot(&chain));
    let masses: Vec<_> = names(&model).into_iter().map(|(name, mass, _)| (name, mass)).collect();
    assert_eq!(masses, [("world", 0.0), ("x", 4e-4), ("y", 4e-4), ("Base", 2.0), ("Arm", 2.0), ("tip", 2e-4)]);
    assert_eq!([1, 5].map(|i| inertia(&model, i)), [Some(Vector3::repeat(2000.0)), Some(Vector3::repeat(1000.0))]);
    assert!(problems[0].contains("info: `link x / inertial` is missing (a mass above 0); it moves without: 4.0e-4 kg"));
    assert_eq!(problems.len(), 3, "{problems:#?}");
    // What is fixed to a link without a mass is carried, too.
    let text = links(&["world", "x", "frame", "Tip"])
        + &joint("continuous", "world", "x")
        + &joint("continuous", "x", "frame")
        + &joint("fixed", "frame", "Tip");
    let (model, _) = read(&robot(&text));
    assert_eq!(names(&model), [("world", 0.0, 0.0), ("x", 2e-4, 1.0), ("Tip", 2.0, 3.0)]);
    assert!(model.has_massless_links);
    // Where nothing has a mass that of a body without in ADF, and something that can turn.
    let (model, problems) = read(&robot(&(links(&["world", "frame"]) + &joint("continuous", "world", "frame"))));
    assert_eq!(names(&model), [("world", 0.0, 0.0), ("frame", 1.0, 1.0)]);
    assert_eq!(inertia(&model, 1), Some(Vector3::repeat(40_000.0)), "a sphere of 0.1 m");
    assert!(problems[0].contains("it has 1 kg, since it can move"), "{problems:#?}");
}

#[test]
fn inertials() {
    let body = |inertial: &str| {
        let (mut model, problems) =
            read(&robot(&format!("<link name='a'><inertial>{inertial}</inertial>SPHERE</link>")));
        (model.bodies.remove(0), problems)
    };
    let tensor = "<mass value='1'/><inertia ixx='2' iyy='2' izz='3' ixy='1' ixz='0' iyz='0'/>";
    let (turned, problems) = body(&format!("<origin xyz='0 0 1' rpy='0 0 0.5'/>{tensor}"));
    assert!(problems.is_empty());
    let (moments, offset) = (turned.inertia.unwrap(), turned.inertial_offset.unwrap());
    assert!((moments - Vector3::new(1.0, 3.0, 3.0)).norm() < 1e-14);
    let lightest = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.5) * Vector3::new(1.0, -1.0, 0.0).normalize();
    assert!(((offset * Vector3::x()).dot(&lightest).abs() - 1.0).abs() < 1e-14);
    assert_eq!(offset.translation.z, 1.0);

    // A zero leaves the others, also where it is one of a turned tensor that rounding made negative.
    for (text, expected) in [
        ("ixx='0' iyy='.2' izz='.2' ixy='0'", [2e-4, 0.2, 0.2]),
        ("ixx='.1' iyy='.1' izz='.2' ixy='.1000000001'", [2e-4, 0.2, 0.2]),
        ("ixx='0' iyy='0' izz='3' ixy='0'", [3e-3, 3e-3, 3.0]),
    ] {
        let (rod, problems) = body(&format!("<mass value='1'/><inertia {text} ixz='0' iyz='0'/>"));
        let mut moments: Vec<_> = rod.inertia.unwrap().iter().copied().collect();
        moments.sort_by(f64::total_cmp);
        assert!(moments.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{text}: {moments:?}");
        assert!(problems.len() == 1 && problems[0].contains("0.001 times the largest for it"), "{problems:#?}");
    }

    for (inertial, message, mass) in [
        ("<mass value='-1'/>", "`link a / inertial / mass / value` is -1, expected a mass", 0.0),
        ("<mass value='0'/><inertia/>", "", 0.0),
        ("", "`link a / inertial / mass` is missing", 0.0),
        ("<mass value='0'/>x", "`link a / inertial` is mixed with text, expected elements only", 0.0),
        ("<mass value='1'/>", "`link a / inertial / inertia` is missing", 1.0),
        (
            &tensor.replace("ixx='2'", "ixx='-2'"),
            "error: `link a / inertial / inertia` is a tensor with the principal moments -2.236e0",
            1.0,
        ),
        (
            &tensor.replace("'2'", "'0'").replace("'1' ixz", "'0' ixz"),
            "warning: `link a / inertial / inertia` is a tensor with the principal moments 0, 0, 3.000e0",
            1.0,
        ),
        (&tensor.replace("ixx='2'", "ixx='-2'"), "expected three moments above 0; it is estimated", 1.0),
        (&tensor.replace("'2'", "'0'").replace("'3'", "'0'"), "expected three moments above 0", 1.0),
        (&tensor.replace("'3'", "'9'"), "expected none larger than the sum of the others", 1.0),
    ] {
        let (body, problems) = body(inertial);
        assert_eq!(body.mass, mass, "{inertial}");
        assert_eq!(problems.is_empty(), message.is_empty(), "{problems:#?}");
        assert!(problems.iter().all(|p| p.contains(message)), "{problems:#?}");
    }
}

#[test]
fn types_limits_and_efforts_of_joints() {
    let read_joint = |kind: &str, inside: &str| {
        let text = joint(kind, "A", "B").replace("</joint>", &format!("{inside}</joint>"));
        let (mut model, problems) = read(&robot(&(links(&["A", "B"]) + &text)));
        (model.joints.remove(0), problems.join("\n"))
    };
    let limit = |attributes: &str| format!("<limit {attributes}/>");
    let (j, problems) = read_joint("revolute", &limit("lower='-1' upper='2' effort='30'"));
    assert_eq!((j.kind, j.limits), (JointKind::Revolute, Some(Limits { low: -1.0, high: 2.0 })));
    assert_eq!((j.max_motor_impulse, j.parent_axis, problems.as_str()), (0.03, Vector3::x(), ""));
    let all = "<limit lower='-1' upper='2' effort='30' velocity='4'/><dynamics damping='0.5' friction='2'/>";
    let (j, problems) = read_joint("prismatic", all);
    let expected =
        DriveTrain { damping: 0.5, armature: 0.0, friction: 2.0, max_effort: Some(30.0), max_rate: Some(4.0) };
    assert_eq!((j.drive_train, problems.as_str()), (expected, ""));
    let (j, problems) = read_joint("prismatic", &limit("lower='1' upper='2'"));
    assert_eq!(j.drive_train, DriveTrain::default());
    assert_eq!((j.kind, j.max_motor_impulse, problems.as_str()), (JointKind::Prismatic, 0.1, ""));
    let (j, _) = read_joint("continuous", "<axis xyz='0 0 1e-200'/>");
    assert_eq!((j.limits, j.child_axis), (None, Vector3::z()));
    assert_eq!(read_joint("fixed", "<axis xyz='0 0 0'/>").0.kind, JointKind::Fixed);
    assert_eq!(read_joint("floating", "").0.kind, JointKind::Unknown("floating".into()));
    let (j, _) = read_joint("planar", "<axis xyz='0 1 0'/>");
    let JointKind::SixDof(limits) = j.kind else { panic!() };
    assert!(limits.linear_low.x > limits.linear_high.x && limits.linear_low.z == limits.linear_high.z);
    assert!(limits.angular_low.z > limits.angular_high.z && limits.angular_low.x == limits.angular_high.x);

    for (kind, inside, message) in [
        ("screw", "", "`joint A-B / type` is `screw`, expected revolute"),
        ("revolute", "", "`joint A-B / limit` is missing"),
        ("revolute", "<limit effort='1'/>", "the joint cannot move"),
        ("revolute", "<limit lower='1' upper='0'/>", "`lower` below `upper`; the joint is unlimited"),
        ("revolute", "<limit lower='-6.29' upper='6.29'/>", "less than a turn"),
        ("continuous", "<limit lower='-1' upper='1'/>", "a continuous joint has no limits"),
        ("continuous", "<limit velocity='0'/>", "`joint A-B / limit / velocity` is 0, expected a rate above 0"),
        ("continuous", "<limit effort='0'/>", "motors have that of a joint without, 100"),
        ("continuous", "<axis xyz='0 0 0'/>", "expected a direction; 1 0 0 is used"),
        (
            "continuous",
            "<mimic joint='x'/>",
            "`joint A-B / mimic / joint` is `x`, expected joints of this file: there is no `x`",
        ),
        ("continuous", "<mimic joint='A-B'/>", "no joint follows itself; the joint moves on its own"),
        ("continuous", "<mimic joint='x' ratio='2'/>", "`joint A-B / mimic / ratio` is not known"),
        ("fixed", "<mimic joint='x'/>", "expected a revolute or prismatic joint"),
        (
            "continuous",
            "<dynamics damping='-1' friction='0'/>",
            "`joint A-B / dynamics / damping` is -1, expected at least 0",
        ),
        ("fixed", "<dynamics damping='1' friction='0'/>", "`joint A-B / dynamics / damping` is not used"),
        ("continuous", "<dynamic damping='1'/>", "`joint A-B / dynamic` is not known"),
    ] {
        let (_, problems) = read_joint(kind, inside);
        assert!(problems.contains(message), "{kind} {inside}: {problems}");
    }
}

#[test]
fn joints_start_at_zero_or_the_limit_next_to_it() {
    let text = joint("prismatic", "A", "B").replace("</joint>", "<limit lower='0.25' upper='2'/></joint>");
    let model = clean(&robot(&(links(&["A", "B"]) + &text)));
    assert_eq!(model.bodies[1].location.translation.x, 1.25);
    assert_eq!(model.joints[0].parent_pivot.x, 1.0, "the coordinate still starts at the origin");
}

#[test]
fn joints_beyond_a_tree_close_loops() {
    let revolute = |a, b| joint("continuous", a, b);
    for (text, message, left) in [
        (revolute("A", "A"), "error: `joint A-A` joins a link with itself; the joint is dropped", 0),
        (revolute("A", "X"), "`joint A-X / child / link` is `X`, expected the name of a link; the joint is dropped", 0),
        (
            revolute("A", "B") + &revolute("C", "B"),
            "info: `joint C-B` leads to the same link as joint `A-B`; the joint closes a loop",
            2,
        ),
        (
            revolute("A", "B") + &revolute("B", "C") + &revolute("C", "A"),
            "warning: `joint C-A` closes a loop of links without a root: `A` becomes one; the joint closes a loop",
            3,
        ),
        (revolute("A", "B") + &revolute("C", "A") + &revolute("B", "C"), "closes a loop", 3),
        (revolute("B", "C") + &revolute("C", "B"), "closes a loop", 2),
        (revolute("A", "B") + &revolute("A", "B"), "`joint A-B` is not the first joint called `A-B`", 1),
        (links(&["A"]), "`link A` is not the first link called `A`; this link is dropped", 0),
    ] {
        let (model, problems) = read(&robot(&(links(&["A", "B", "C"]) + &text)));
        assert_eq!((model.bodies.len(), model.joints.len()), (3, left), "{problems:#?}");
        assert!(problems.iter().any(|p| p.contains(message)), "{problems:#?}");
    }
    let parallel = joint("fixed", "A", "b") + &joint("continuous", "A", "b").replace("A-b", "x");
    let (model, problems) = read(&robot(&(links(&["A", "b"]) + &parallel)));
    assert!(
        model.joints.is_empty() && problems.iter().any(|p| p.contains("fixed to each other; the joint is dropped"))
    );
    let (_, problems) = read(&robot(&links(&["A", "B"])));
    assert!(problems[0].contains("error: `link B` is a root beside `A`: no joint leads to it"), "{problems:#?}");
    let (model, problems) = read("<robot name='r'/>");
    assert!(model.bodies.is_empty() && problems[0].contains("`robot r / link` is missing"), "{problems:#?}");
}

#[test]
fn a_frame_with_two_parents_belongs_to_the_one_it_is_fixed_to() {
    // In either order: a frame of C that B leads to, too.
    let (of_c, of_b) = (joint("fixed", "C", "pin"), joint("continuous", "B", "pin"));
    let tree = joint("continuous", "A", "B") + &joint("continuous", "A", "C");
    for pair in [of_c.clone() + &of_b, of_b + &of_c] {
        let (model, problems) = read(&robot(&(links(&["A", "B", "C", "pin"]) + &tree + &pair)));
        assert_eq!(model.bodies.len(), 3, "{problems:#?}");
        assert_eq!(joined(&model).last(), Some(&("B-pin", "BODY B", "BODY C")));
        let closing = model.joints.last().unwrap();
        assert_eq!((closing.parent_pivot.x, closing.child_pivot.x), (1.0, 1.0));
        let what = "`joint B-pin` leads to the same link as joint `C-pin`; the joint closes a loop";
        assert!(problems.iter().any(|problem| problem.contains(what)), "{problems:#?}");
    }
}

#[test]
fn mimics_are_couplings_and_start_closed() {
    let mimic = |kind, of: &str, inside: &str| joint(kind, "A", of).replace("</joint>", &format!("{inside}</joint>"));
    let limit = |low: f64, high: f64| format!("<limit lower='{low}' upper='{high}' effort='1' velocity='1'/>");
    let follows =
        |of: &str, ratio: f64, offset: f64| format!("<mimic joint='{of}' multiplier='{ratio}' offset='{offset}'/>");
    // D follows C, which follows B; C may not go below 0.5, so that B starts at 1.
    let text = mimic("prismatic", "D", &(limit(-9.0, 9.0) + &follows("A-C", 1.0, 1.0)))
        + &mimic("revolute", "C", &(limit(0.5, 3.0) + &follows("A-B", 2.0, -1.5)))
        + &mimic("continuous", "B", "");
    let model = clean(&robot(&(links(&["A", "B", "C", "D"]) + &text)));
    let coupling = |index: usize| model.joints[index].coupling.clone().unwrap();
    let leader = |joint: &str, ratio| vec![Leader { joint: joint.to_owned(), ratio }];
    assert_eq!(coupling(0), Coupling { leaders: leader("JOINT A-C", 1.0), offset: 1.0 });
    assert_eq!(coupling(1), Coupling { leaders: leader("JOINT A-B", 2.0), offset: -1.5 });
    assert_eq!(model.joints[2].coupling, None);
    let angle = |index: usize| model.bodies[index].location.rotation.angle();
    assert!((angle(1) - 1.0).abs() < 1e-15 && (angle(2) - 0.5).abs() < 1e-15);
    assert_eq!(model.bodies[3].location.translation.x, 2.5);

    let cycle =
        mimic("continuous", "B", &follows("A-C", 1.0, 0.0)) + &mimic("continuous", "C", &follows("A-B", 1.0, 0.0));
    let (model, problems) = read(&robot(&(links(&["A", "B", "C"]) + &cycle)));
    assert!(model.joints.iter().all(|joint| joint.coupling.is_none()));
    let said = problems
        .iter()
        .filter(|p| p.contains("joints that do not follow this one in turn; the joint moves on its own"));
    assert_eq!(said.count(), 2, "{problems:#?}");
}

#[test]
fn what_other_programs_read_is_named_and_self_collision_is_gazebos() {
    let text = "<transmission name='t'><type>x</type></transmission><gazebo><static>true</static></gazebo>\
                <gazebo reference='A'><selfCollide> true </selfCollide></gazebo><camera/>";
    let (model, problems) = read(&robot(&(links(&["A", "B"]) + &joint("continuous", "A", "B") + text)));
    assert_eq!(model.bodies.iter().map(|body| body.self_collision).collect::<Vec<_>>(), [true, false]);
    assert!(model.ignore_inter_collision);
    assert_eq!(problems.len(), 3, "{problems:#?}");
    let all = |value| {
        let (model, _) =
            read(&robot(&(links(&["A"]) + &format!("<gazebo><self_collide>{value}</self_collide></gazebo>"))));
        !model.ignore_inter_collision
    };
    assert!(all("1") && all("true") && !all("false"));
}

#[test]
fn places_of_problems() {
    let text = "<robot name='r'>\n  <link name='é'><inertial><mass value='ä'/></inertial></link>\n\
                <link name='b'>\n<inertial><mass value='1'/><inertia ixx='1'/></inertial></link></robot>";
    let message = error(text);
    assert!(
        message.contains("t.urdf:2:34: error: `link é / inertial / mass / value` is `ä`, expected a number"),
        "{message}"
    );
    assert!(message.contains("t.urdf:4:28: error: `link b / inertial / inertia / iyy` is missing"), "{message}");
    assert!(error("<robot name='r'>\n<link></robot>").starts_with("t.urdf:2:7: syntax error: "));
    assert_eq!(error("\n <sdf/>"), "t.urdf:2:2: the root element is <sdf>, expected <robot> (URDF) or <mujoco> (MJCF)");
    for numbers in ["nan 0 0", "0 inf 0", "1e999 0 0", "1 2", "1 2 3 4", "", "1,2,3", "${x} 0 0"] {
        let text = robot(&(links(&["A", "B"]) + &joint("fixed", "A", "B").replace("1 0 0", numbers)));
        assert!(error(&text).contains("`joint A-B / origin / xyz` is "), "{numbers}");
    }
    let long = robot(&links(&["A".repeat(300).as_str()]));
    assert!(error(&long).contains("expected a name of 1 to 255 bytes") && error(&long).len() < 1000);
}

#[test]
fn blanks_and_comments_may_stand_before_the_declaration() {
    let declared = "<?xml version='1.0'?>\n<robot name='r'>\n<link name='a' colour='red'/></robot>";
    for (before, line) in [("", 3), ("\n", 4), ("  \t", 3), ("<!-- by\nhand -->\n\n<!-- -->", 6), ("\u{feff}\n", 4)] {
        let (model, problems) = read(&format!("{before}{declared}"));
        assert_eq!(model.bodies.len(), 1);
        assert_eq!(problems.len(), 1, "{problems:#?}");
        assert!(problems[0].starts_with(&format!("dir/t.urdf:{line}:16: warning: ")), "{before:?}: {problems:#?}");
    }
    assert!(error("\n\n<?xml version='1.0'?><robot name='r'></link></robot>").starts_with("t.urdf:3:"));
    let message = error("<!-- c --><?xml version='1.0'?><robot name='r'><!</robot>");
    assert!(message.starts_with("t.urdf:1:48: syntax error: "), "{message}");
    for broken in
        ["<!-- <?xml version='1.0'?><robot name='r'/>", "x<?xml version='1.0'?><robot name='r'/>", "<!-->", "<?xml"]
    {
        assert!(error(broken).contains("syntax error"), "{broken}");
    }
}

#[test]
fn a_spherical_joint_is_a_ball_joint_without_a_coordinate() {
    let model = clean(&robot(&(links(&["A", "B"]) + &joint("spherical", "A", "B"))));
    let ball = &model.joints[0];
    assert_eq!((&ball.kind, ball.common.passive, ball.limits), (&JointKind::PointToPoint, true, None));
    assert_eq!((ball.parent_pivot, ball.child_pivot), (Vector3::x(), Vector3::zeros()));
    let (_, problems) = read(&robot(&(links(&["A", "B"]) + &joint("ball-and-socket", "A", "B"))));
    assert!(problems[0].contains("floating, planar or spherical; the joint is fixed"), "{problems:#?}");
}

#[test]
fn xacro_is_refused_with_what_to_do() {
    let uri = "xmlns:xacro='http://www.ros.org/wiki/xacro'";
    let message = error(&format!("<robot name='r' {uri}>\n<xacro:property name='x' value='1'/></robot>"));
    assert_eq!(message, "t.urdf:2:1: this is xacro, which has to become URDF first: xacro t.urdf > robot.urdf");
    assert!(error("<robot name='r'><xacro:x/></robot>").contains("this is xacro"));
    let by_name = parse("", Path::new("r.urdf.xacro"), &Packages::default()).unwrap_err().to_string();
    assert!(by_name.contains("xacro r.urdf.xacro > robot.urdf"), "{by_name}");
    // What xacro leaves behind.
    clean(&format!("<robot name='r' {uri}><link name='a'/></robot>"));
}

#[test]
fn texts_made_to_exhaust_a_reader_are_refused_at_once() {
    let bomb = "<!DOCTYPE robot [<!ENTITY a 'aaaaaaaaaa'><!ENTITY b '&a;&a;&a;'>]>\n<robot name='&b;'/>";
    assert_eq!(error(bomb), "t.urdf:1:1: syntax error: a DOCTYPE is not read; write out its entities and delete it");
    let attributes: String = (0..200_000).map(|i| format!("a{i}='' ")).collect();
    assert!(error(&format!("<robot {attributes}/>")).contains("too many attributes in one tag"));
    let namespaces: String = (0..50_000).map(|i| format!("<a xmlns:n{i}='{i}'>")).collect();
    assert!(error(&namespaces).contains("too many declarations of namespaces"));
    assert!(error(&"<a/>".repeat(2_100_000)).contains("too many elements"));
    let deep = "<link>".repeat(500_000);
    assert!(error(&format!("<robot name='r'>{deep}")).contains("syntax error"));
    let closed = format!("<robot name='r'><link name='a'>{deep}{}</link></robot>", "</link>".repeat(500_000));
    let (model, problems) = read(&closed);
    assert_eq!((model.bodies.len(), problems.len()), (1, 1));
}

#[test]
fn ten_thousand_links_in_one_line() {
    let started = std::time::Instant::now();
    let text: String = (0..10_000).map(|i| format!("<link name='l{i}'>{MASS}{SPHERE}</link>")).collect();
    let chain: String = (1..10_000).map(|i| joint("continuous", &format!("l{}", i - 1), &format!("l{i}"))).collect();
    let model = clean(&robot(&(text.clone() + &chain)));
    assert_eq!((model.bodies.len(), model.joints.len()), (10_000, 9_999));
    assert_eq!(model.bodies[9_999].location.translation.x, 9_999.0);
    let mut names = std::collections::HashSet::new();
    assert!(model.joints.iter().all(|joint| names.insert(&joint.child)));
    let (report, severity) = match parse(&robot(&text), Path::new("t"), &Packages::default()) {
        Ok((_, report)) => (report.errors(), report.problems()[0].severity),
        Err(error) => panic!("{error}"),
    };
    assert_eq!((report, severity), (9_999, Severity::Error), "a root each");
    assert!(started.elapsed().as_secs() < 60, "{:?}", started.elapsed());
}

/// Texts that a damaged disk or an unfinished edit leaves behind.
#[test]
fn damaged_texts_give_a_report_and_finite_numbers() {
    let whole = robot(
        &(links(&["base", "A", "B", "frame", "C"])
            + &joint("fixed", "base", "A")
            + &joint("revolute", "A", "B").replace("</joint>", "<axis xyz='0 1 0'/><limit lower='-1' upper='1'/></joint>")
            + &joint("fixed", "B", "frame")
            + &joint("prismatic", "frame", "C").replace("<origin", "<origin rpy='0.1 -2 3e0'")
            + "<link name='m'><collision><geometry><mesh filename='a.stl' scale='1 -1 2'/></geometry></collision></link>"),
    );
    let pieces = ["'", "<", ">", "/>", "-", "e300", "nan", "<link", "</link>", "&amp;", "&#0;", "é", "0"];
    let values =
        ["", "nan", "-1", "1e99", "1e-320", "0 0 0", "1e99 -1e-99 1", "A", "C", "m", "fixed", "planar", "revolute"];
    let (mut random, mut read) = (0x2545_f491_4f6c_dd1d_u64, 0);
    let mut next = |below: usize| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        (random % below as u64) as usize
    };
    for damage in 0..6000 {
        let mut bytes = whole.clone().into_bytes();
        for _ in 0..=next(4) {
            let (range, piece) = if damage % 3 == 0 {
                let start = next(bytes.len());
                (start..(start + next(12)).min(bytes.len()), pieces[next(pieces.len())])
            } else {
                // Another value of an attribute.
                let quotes: Vec<_> = (0..bytes.len()).filter(|&i| bytes[i] == b'\'').collect();
                let attribute = 2 * next(quotes.len() / 2);
                (quotes[attribute] + 1..quotes[attribute + 1], values[next(values.len())])
            };
            bytes.splice(range, piece.bytes());
        }
        let text = String::from_utf8_lossy(&bytes);
        let Ok((model, _)) = parse(&text, Path::new("t.urdf"), &Packages::default()) else { continue };
        read += 1;
        let poses = model.bodies.iter().flat_map(|b| [b.location, b.inertial_offset.unwrap_or_default()]);
        let moments = model.bodies.iter().filter_map(|b| b.inertia);
        let axes = model.joints.iter().flat_map(|j| [j.parent_axis, j.child_axis, j.parent_pivot, j.child_pivot]);
        assert!(poses
            .flat_map(|p| [p.translation.vector, p.rotation.scaled_axis()])
            .chain(axes)
            .all(|v| v.iter().all(|x| x.is_finite())));
        assert!(moments.flat_map(|m| [m.x, m.y, m.z]).all(|x| x.is_finite() && x > 0.0), "{text}");
        assert!(model.bodies.iter().all(|b| b.mass.is_finite() && b.mass >= 0.0), "{text}");
    }
    assert!(read > 1000, "{read} of the texts still are robots");
}
