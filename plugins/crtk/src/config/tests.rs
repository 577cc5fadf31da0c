use std::fs;

use tempfile::TempDir;

use super::*;

fn read(text: &str) -> Result<Vec<ArmConfig>, ConfigError> {
    let outline = Outline::parse(text, Path::new("arms.yaml")).unwrap();
    from_outline(&outline, Path::new(".")).map(|read| read.arms)
}

const PSM: &str = "crtk:\n  - name: PSM1\n    kind: psm\n    base: psm1/base\n    joints: [a, b, c, d, e, f]\n    \
                   coupling: [{joint: g, of: 1, ratio: -1}, {joint: h, of: b}]\n    \
                   jaw: {joints: [{joint: l, ratio: 0.5}, {joint: r, ratio: -0.5}], lower: -0.3, upper: 1.3}\n    \
                   tool: {body: psm1/tool, instrument: 420006, tip_offset: 0.0102}\n    reference: ECM_view\n";

#[test]
fn an_entry_has_the_defaults_of_its_kind() {
    let arms = read(PSM).unwrap();
    let [arm] = arms.as_slice() else { panic!("one arm") };
    assert_eq!((arm.space.as_str(), arm.kind, arm.dialect), ("/PSM1", Kind::Psm, Dialect::Contract));
    assert_eq!(arm.names[2], "insertion");
    assert_eq!(arm.home.as_deref(), Some(&[0.0, 0.0, 0.12, 0.0, 0.0, 0.0][..]));
    assert_eq!((arm.speeds[2], arm.rate, arm.on_limit), (0.4, 100.0, OnLimit::Refuse));
    assert_eq!((arm.coupling[0].of, arm.coupling[1].of, arm.coupling[0].ratio), (1, 1, -1.0));
    let tool = arm.tool.as_ref().unwrap();
    assert_eq!((tool.instrument.as_deref(), tool.tip), (Some("420006"), 0.0102));
    assert_eq!(arm.jaw.as_ref().unwrap().limits, Limits { lower: -0.3, upper: 1.3 });
}

#[test]
fn rules_of_grasping_have_defaults_and_need_a_jaw() {
    let grasp = |rules: &str| read(&PSM.replace("    tool:", &format!("    grasp: {rules}\n    tool:")));
    let rules = grasp("{close: 0.1, only: [Needle]}").unwrap()[0].grasp.clone().unwrap();
    assert_eq!((rules.close, rules.open, rules.distance), (0.1, 0.1 + 0.04, 0.008));
    assert!((rules.centre + 0.003).abs() < 1e-12, "3 mm behind a tip of 10.2 mm");
    assert_eq!(rules.only, ["Needle"]);
    for (text, word) in [("{open: 0.01}", "above `close`"), ("{distance: 0}", "above 0"), ("{shut: 1}", "shut")] {
        let error = grasp(text).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
    let error = read("crtk:\n  - {name: A, joints: [x], grasp: {}}\n").unwrap_err().to_string();
    assert!(error.contains("jaw"), "{error}");
}

#[test]
fn sockets_have_the_defaults_of_their_style() {
    let socket = |keys: &str| read(&PSM.replace("    tool:", &format!("    socket: {keys}\n    tool:")));
    let bridge = socket("{style: bridge, listen: 5701, to: 127.0.0.1:48051}").unwrap()[0].socket.clone().unwrap();
    assert_eq!((bridge.listen.to_string().as_str(), bridge.rate), ("0.0.0.0:5701", 60.0));
    assert_eq!(bridge.to.unwrap().port(), 48051);
    assert_eq!(bridge.tell, [Told::SetPointPose, Told::SetPointJaw]);
    let turned = bridge.offset * nalgebra::Vector3::new(1.0, 2.0, 3.0);
    assert!((turned - nalgebra::Vector3::new(-1.0, 2.0, -3.0)).norm() < 1e-12, "diag(-1, 1, -1)");
    let streamer = socket("{listen: '127.0.0.1:5702', send: [measured_js]}").unwrap()[0].socket.clone().unwrap();
    assert_eq!((streamer.style, streamer.to, streamer.rate), (Style::Streamer, None, 100.0));
    assert_eq!(streamer.tell, [Told::MeasuredJoints]);
    assert_eq!(streamer.offset, UnitQuaternion::identity());
    for (keys, word) in [
        ("{listen: 70000}", "a port"),
        ("{to: sender}", "listen"),
        ("{listen: 1, to: headset}", "an address"),
        ("{listen: 1, style: loud}", "bridge, streamer"),
        ("{listen: 1, rate: 0}", "1 to 1000"),
        ("{listen: 1, send: [everything]}", "jaw/measured_js"),
        ("{listen: 1, offset_rpy: [1]}", "3 finite numbers"),
        ("{listen: 1, port: 2}", "offset_rpy"),
    ] {
        let error = socket(keys).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn what_a_seed_draws_is_configured_beside_the_arms() {
    let arms = "crtk:\n  - {name: A, joints: [x, y], errors: [0.1, 0.2]}\n  - {name: ecm, kind: ecm, dialect: src, body: CameraFrame}\n";
    let text = format!("{arms}scatter: {{bodies: [b1, b2], places: [[1, 2], [3, 4], [5, 6]]}}\n");
    let whole = |text: &str| from_outline(&Outline::parse(text, Path::new("arms.yaml")).unwrap(), Path::new("."));
    let read = whole(&text).unwrap();
    assert_eq!(read.arms[0].errors, [0.1, 0.2]);
    let ecm = &read.arms[1];
    assert_eq!((ecm.body.as_deref(), ecm.names.len(), ecm.home.as_ref()), (Some("CameraFrame"), 4, None));
    assert_eq!((ecm.names[0].as_str(), ecm.reference.as_str()), ("j0", "world"));
    let scatter = read.scatter.unwrap();
    assert_eq!((scatter.bodies.len(), scatter.places[2]), (2, [5.0, 6.0]));
    for (text, word) in [
        (format!("{arms}scatter: {{bodies: [b1, b2], places: [[1, 2]]}}\n"), "at least one a body"),
        (format!("{arms}scatter: {{bodies: [b1], places: [[1, 2, 3]]}}\n"), "places [x, y]"),
        (format!("{arms}scatter: {{places: [[1, 2]]}}\n"), "bodies"),
        (arms.replace("[0.1, 0.2]", "[0.1, 0.2, 0.3]"), "at most 2 bounds"),
        (arms.replace("[0.1, 0.2]", "[-0.1]"), "0 or more"),
    ] {
        let error = whole(&text).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn mistakes_say_where_they_are_and_what_was_expected() {
    let entry = |lines: &str| format!("crtk:\n  - name: A\n    joints: [x, y]\n    {lines}\n");
    for (text, words) in [
        ("a: 1\n".into(), ["arms.yaml:1", "crtk"]),
        ("crtk: []\n".into(), ["arms.yaml:1", "a list of arms"]),
        ("crtk: [{joints: [x]}]\n".into(), ["arms.yaml:1", "name"]),
        ("crtk: [{name: 7up, joints: [x]}]\n".into(), ["7up", "letters"]),
        ("crtk: [{name: A}]\n".into(), ["joints", "1 to 8"]),
        ("crtk: [{name: A, joints: [x]}, {name: A, joints: [y]}]\n".into(), ["arms.yaml:1", "another"]),
        (entry("color: red"), ["arms.yaml:4", "on_limit"]),
        (entry("kind: octopus"), ["arms.yaml:4", "psm, ecm"]),
        (entry("dialect: french"), ["french", "contract"]),
        (entry("speeds: [1, -1]"), ["speeds", "above 0"]),
        (entry("speeds: [1]"), ["speeds", "2 finite numbers"]),
        (entry("limits: [[0, 1]]"), ["limits", "2 pairs"]),
        (entry("limits: [[0, 1], [1, 0]]"), ["limits", "2 pairs"]),
        (entry("rate: 5000"), ["rate", "1 to 1000"]),
        (entry("home: [0, nan]"), ["home", "finite"]),
        (entry("names: [a]"), ["names", "2 names"]),
        (entry("coupling: [{joint: z, of: 2}]"), ["arms.yaml:4", "of"]),
        (entry("jaw: {joints: [{joint: j, ratio: 0}]}"), ["ratio", "other than 0"]),
        (entry("tool: {instrument: big}"), ["big", "six digits"]),
    ] {
        let error = read(&text).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

#[test]
fn arm_files_of_the_simulators_give_limits_speeds_and_home() {
    let folder = TempDir::new().unwrap();
    let robot = "robot:\n  name: PSM1\n  joints:\n    \
                 - {name: yaw, type: revolute, lower: -1.5, upper: 1.5, velocity: 5}\n    \
                 - {name: pitch, type: revolute, lower: -0.7, upper: 0.7, velocity: 4}\n  home_position: [0.1, 0.2]\n  \
                 jaw: {lower: 0, upper: 1, velocity: 0.3}\n  cartesian: {reference_frame: ECM_view}\n";
    fs::write(folder.path().join("PSM1.yaml"), robot).unwrap();
    let own = "crtk:\n  - {name: PSM1, joints: [a, b], robot_file: PSM1.yaml, jaw: {joints: [{joint: j}]}}\n";
    fs::write(folder.path().join("arms.yaml"), own).unwrap();
    let arms = load(&folder.path().join("arms.yaml")).unwrap().arms;
    assert_eq!(arms[0].names, ["yaw", "pitch"]);
    assert_eq!(arms[0].limits.as_ref().unwrap()[1], Limits { lower: -0.7, upper: 0.7 });
    assert_eq!((arms[0].home.as_deref(), arms[0].speeds[1]), (Some(&[0.1, 0.2][..]), 4.0));
    assert_eq!((arms[0].reference.as_str(), arms[0].jaw.as_ref().unwrap().speed), ("ECM_view", 0.3));
    // A launch or model file may name the file.
    let outline = Outline::parse("crtk: arms.yaml\n", &folder.path().join("launch.yaml")).unwrap();
    assert_eq!(from_outline(&outline, folder.path()).unwrap().arms, arms);
}

#[test]
fn configurations_of_the_cpp_plugin_are_read_in_both_forms() {
    let text = "interface: [PSM1]\nPSM1:\n  \
                measured_cp: [{rigidbody: psm1/BODY tool yaw link, namespace: /PSM1/, reference: CameraFrame}]\n  \
                servo_cp: [{rigidbody: psm1/BODY tool yaw link, namespace: /PSM1/}]\n  \
                measured_js: {namespace: /PSM1, joints: [psm1/JOINT base link-yaw link, psm1/JOINT b]}\n  \
                servo_jp: [{namespace: /PSM1/gripper, joints: [psm1/JOINT c]}]\n  \
                measured_cf: [{rigidbody: psm1/BODY main insertion link}]\n";
    let arms = read(text).unwrap();
    let spaces: Vec<&str> = arms.iter().map(|arm| arm.space.as_str()).collect();
    assert_eq!(spaces, ["/PSM1", "/PSM1/gripper", "/PSM1/main_insertion_link"]);
    assert_eq!((arms[0].joints.len(), arms[0].kind, arms[0].reference.as_str()), (2, Kind::Generic, "CameraFrame"));
    assert_eq!(arms[0].names[0], "base link-yaw link");
    assert_eq!((arms[1].tool.as_ref(), arms[1].dialect), (None, Dialect::Plugin));
    assert_eq!(arms[2].kind, Kind::Object);
}

#[test]
fn model_files_name_their_configuration_in_both_forms() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("c.yaml"), "interface: [A]\nA:\n  measured_js: [{joints: [x]}]\n").unwrap();
    for text in [
        "plugins: [{name: p, filename: libambf_crtk_model_plugin.so, crtk_config: c.yaml}]\n",
        "plugins: [{name: p, filename: libambf_crtk_model_plugin.so}]\ncrtk_config: c.yaml\n",
    ] {
        let outline = Outline::parse(text, &folder.path().join("m.yaml")).unwrap();
        assert_eq!(from_outline(&outline, folder.path()).unwrap().arms[0].space, "/A");
    }
}
