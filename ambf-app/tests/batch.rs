//! The contract of `ambf_batch`: files, columns, exit status, and what it says about bad input.

mod batch_common;

use batch_common::{close, resources, Folder};

const BALL: &str = "bodies: [BODY Ball]\nBODY Ball: {name: Ball, mass: 2, location: {position: {x: 1, y: 2, z: 3}}, \
                    collision shape: Sphere, collision geometry: {radius: 0.1}, damping: {linear: 0, angular: 0}}\n";

fn pendulum() -> String {
    resources().join("models/pendulum.yaml").display().to_string()
}

#[test]
fn traces_have_the_agreed_columns_and_give_every_number_back() {
    let folder = Folder::new();
    folder.succeed(&format!("-a {} --steps 7 --every 3 --trace sub/t", pendulum()));
    let bodies = folder.csv("sub/t_bodies.csv");
    assert_eq!(bodies.heading.join(","), "sim_step,sim_time,body,px,py,pz,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz");
    let joints = folder.csv("sub/t_joints.csv");
    assert_eq!(joints.heading.join(","), "sim_step,sim_time,joint,type,parent,child,position,velocity,effort");
    assert!(!folder.exists("sub/t_softnodes.csv"), "there are no soft bodies");
    for csv in [&bodies, &joints] {
        // The last step is written although 3 does not divide 7.
        assert_eq!(csv.distinct("sim_step"), ["0", "3", "6", "7"]);
    }
    assert_eq!(bodies.distinct("body"), ["Base", "Link", "Plane"], "sorted by identifier");
    for line in &bodies.lines {
        let (step, time): (f64, f64) = (line[0].parse().unwrap(), line[1].parse().unwrap());
        close(time, step * 0.001, 1e-15);
        for cell in &line[3..] {
            let (mantissa, _) = cell.split_once('e').unwrap_or_else(|| panic!("{cell}"));
            let digits = mantissa.chars().filter(char::is_ascii_digit).count();
            assert_eq!(digits, 17, "{cell}");
        }
    }
    let joint = &joints.lines[0];
    assert_eq!(joint[3..6], ["0", "Base", "Link"]);
    assert!(joints.at(7, joint[2].as_str(), "position") != 0.0);
}

#[test]
fn only_what_exists_is_written() {
    let folder = Folder::new();
    folder.write("model.yaml", BALL);
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.succeed("-a model.yaml --world world.yaml --steps 3 --trace t");
    assert!(folder.exists("t_bodies.csv") && !folder.exists("t_joints.csv"));
    folder.succeed("-a model.yaml --world world.yaml --steps 3");
}

#[test]
fn full_traces_have_the_pose_at_the_end_of_the_step() {
    let folder = Folder::new();
    folder.write("model.yaml", &BALL.replace("mass: 2", "mass: 2, inertial offset: {position: {x: 0, y: 0, z: 0.5}}"));
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.succeed("-a model.yaml --world world.yaml --steps 40 --trace t --full");
    let csv = folder.csv("t_bodies.csv");
    assert!(csv.heading.join(",").ends_with(",wz,cx,cy,cz,cqx,cqy,cqz,cqw"));
    for step in 1..=40 {
        // The reported pose of the body frame is the inertial frame's of one step before.
        close(csv.at(step, "Ball", "pz"), csv.at(step - 1, "Ball", "cz") - 0.5, 1e-12);
        // Bullet's integrator: after k steps the fall is g·dt²·k·(k + 1)/2.
        let k = step as f64;
        close(csv.at(step, "Ball", "cz"), 3.5 - 10.0 * 1e-6 * k * (k + 1.0) / 2.0, 1e-12);
        close(csv.at(step, "Ball", "vz"), -10.0 * 0.001 * k, 1e-12);
        assert_eq!(csv.at(step, "Ball", "cqw"), 1.0);
    }
}

#[test]
fn another_dt_is_one_sub_step_of_that_length() {
    let folder = Folder::new();
    folder.write("model.yaml", BALL);
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.succeed("-a model.yaml --world world.yaml --steps 10 --trace t --full --dt 0.004");
    let csv = folder.csv("t_bodies.csv");
    close(csv.at(10, "Ball", "sim_time"), 0.04, 1e-15);
    close(csv.at(10, "Ball", "cz"), 3.0 - 10.0 * 0.004 * 0.004 * 55.0, 1e-12);
}

#[test]
fn json_has_the_agreed_keys() {
    let folder = Folder::new();
    let ran = folder.succeed(&format!("-a {} --steps 50 --json", pendulum()));
    let line = ran.stdout.strip_suffix('\n').expect("one line");
    let inside = line.strip_prefix('{').and_then(|rest| rest.strip_suffix('}')).unwrap_or_else(|| panic!("{line}"));
    let pairs: Vec<(&str, f64)> = inside
        .split(',')
        .map(|pair| {
            let (key, value) = pair.split_once(':').unwrap_or_else(|| panic!("{pair}"));
            (key.trim_matches('"'), value.parse().unwrap_or_else(|_| panic!("{pair}")))
        })
        .collect();
    let keys: Vec<_> = pairs.iter().map(|pair| pair.0).collect();
    let expected = [
        "steps",
        "sim_s",
        "load_s",
        "wall_s",
        "us_per_step",
        "bullet_us_per_step",
        "peak_rss_mb",
        "bodies",
        "joints",
        "cpu_s",
        "tail_us_per_step",
        "islands_solved",
        "islands_approximate",
        "islands_iterated",
        "position_problems",
        "divided_sub_steps",
        "rows",
        "factorisations",
        "pivots",
        "sweeps",
        "residual",
        "joint_gap_m",
        "joint_angle_rad",
        "penetration_m",
    ];
    assert_eq!(keys, expected);
    let value = |key: &str| pairs.iter().find(|pair| pair.0 == key).expect("present").1;
    assert_eq!((value("steps"), value("bodies"), value("joints")), (50.0, 3.0, 1.0));
    close(value("sim_s"), 0.05, 1e-12);
    assert!(value("wall_s") > 0.0 && value("load_s") > 0.0 && value("peak_rss_mb") > 1.0);
    assert!(value("bullet_us_per_step") > 0.0 && value("bullet_us_per_step") <= value("us_per_step"));
    close(value("us_per_step"), value("wall_s") * 1e6 / 50.0, 0.1);
    assert_eq!(folder.succeed(&format!("-a {} --steps 1", pendulum())).stdout, "", "silent without --json");
}

#[test]
fn the_energy_of_a_fall_is_written() {
    let folder = Folder::new();
    folder.write("model.yaml", BALL);
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.succeed("-a model.yaml --world world.yaml --steps 45 --energy out/e.csv --every 10 --profile accurate");
    let csv = folder.csv("out/e.csv");
    assert_eq!(csv.distinct("sim_step"), ["0", "10", "20", "30", "40", "45"]);
    let last = |name: &str| csv.text(&csv.lines[5], name).parse::<f64>().expect("a number");
    // A ball of 2 kg falls for 45 ms.
    close(last("kinetic_J"), 2.0 / 2.0 * 0.45 * 0.45, 1e-9);
    close(last("potential_J"), -last("kinetic_J"), 1e-9);
    close(last("unexplained_J"), 0.0, 1e-9);
}

#[test]
fn no_steps_give_row_zero() {
    let folder = Folder::new();
    folder.succeed(&format!("-a {} --steps 0 --trace t --json", pendulum()));
    assert_eq!(folder.csv("t_bodies.csv").distinct("sim_step"), ["0"]);
}

#[test]
fn names_that_occur_twice_get_suffixes() {
    let folder = Folder::new();
    let twins = "bodies: [BODY A, BODY B]\nBODY A: {name: Twin, mass: 1}\nBODY B: {name: Twin, mass: 1}\n";
    folder.write("twins.yaml", twins);
    folder.write("ball.yaml", BALL);
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.write("commands.txt", "0|0|TW|Ball1|1 0 0 0 0 0\n");
    folder.succeed(
        "-a ball.yaml,twins.yaml,ball.yaml,ball.yaml --world world.yaml --steps 1 --trace t --commands commands.txt",
    );
    let csv = folder.csv("t_bodies.csv");
    assert_eq!(csv.distinct("body"), ["Twin", "Twin1", "Ball", "Ball1", "Ball2"], "BODY A comes first");
    assert_eq!(csv.at(0, "Ball1", "vx"), 1.0);
    assert_eq!(csv.at(0, "Ball", "vx"), 0.0);
}

#[test]
fn a_launch_file_needs_neither_devices_nor_colours() {
    let folder = Folder::new();
    folder.write("ball.yaml", BALL);
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.write("launch.yaml", "world config: world.yaml\nmultibody configs: [ball.yaml]\n");
    folder.succeed("-l 0 --launch_file launch.yaml --steps 1 --trace t");
    // No ground: the world file has no environment.
    assert_eq!(folder.csv("t_bodies.csv").distinct("body"), ["Ball"]);
    // With its own world no launch file is read.
    folder.write("broken.yaml", "[");
    folder.succeed("-a ball.yaml --world world.yaml --launch_file broken.yaml --steps 1");
    folder.succeed("-a ball.yaml --world world.yaml --launch_file absent.yaml --steps 1");
    assert_eq!(folder.run("-l 0 --world world.yaml --launch_file absent.yaml --steps 1").status, 2);
}

#[test]
fn the_default_launch_file_is_the_shipped_one() {
    let folder = Folder::new();
    folder.succeed("-l 0 --steps 1 --trace t");
    assert!(folder.csv("t_bodies.csv").distinct("body").contains(&"Plane".to_owned()));
}

#[test]
fn wrong_usage_is_status_1_and_names_the_word() {
    let folder = Folder::new();
    for (arguments, part) in [
        ("", "-l"),
        ("-a m.yaml", "--steps"),
        ("-a m.yaml --steps 1 --frobnicate", "--frobnicate"),
        ("-a m.yaml --steps -4", "-4"),
        ("-a m.yaml --steps 1 --dt 0", "--dt"),
        ("-a m.yaml --steps 1 --dt inf", "--dt"),
        ("-a m.yaml --steps 1 --every 0", "--every"),
        ("-a m.yaml --steps 1 --profile magic", "magic"),
        ("-a m.yaml --steps 1 --solver magic", "magic"),
        ("-a m.yaml --steps 1 --iterations x", "x"),
    ] {
        let ran = folder.run(arguments);
        assert_eq!(ran.status, 1, "{arguments}: {ran:?}");
        assert!(ran.stderr.contains(part) && ran.stdout.is_empty(), "{arguments}: {ran:?}");
    }
}

#[test]
fn what_cannot_be_loaded_is_status_2_and_named() {
    let folder = Folder::new();
    folder.write("ok.yaml", BALL);
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.write("syntax.yaml", "bodies: [BODY A\njoints: []\n");
    let mesh = "high resolution path: ./\nlow resolution path: ./\nbodies: [BODY M]\n\
                BODY M: {name: M, mass: 1, mesh: absent.stl, collision shape type: CONVEX_HULL}\n";
    folder.write("mesh.yaml", mesh);
    folder.write("nan.yaml", &BALL.replace("mass: 2", "mass: .nan"));
    folder.write("negative.yaml", &BALL.replace("mass: 2", "mass: -1"));
    folder.write("binary.yaml", "\u{0}\u{1}\u{2}");
    for (arguments, parts) in [
        ("-a absent.yaml --world world.yaml --steps 1", vec!["absent.yaml"]),
        ("-a ok.yaml --world absent_world.yaml --steps 1", vec!["absent_world.yaml"]),
        ("-a syntax.yaml --world world.yaml --steps 1", vec!["syntax.yaml:2"]),
        ("-a mesh.yaml --world world.yaml --steps 1", vec!["mesh.yaml:4", "absent.stl"]),
        ("-a nan.yaml --world world.yaml --steps 1", vec!["nan.yaml:2", "mass"]),
        ("-a negative.yaml --world world.yaml --steps 1", vec!["negative.yaml:2", "mass"]),
        ("-a binary.yaml --world world.yaml --steps 1", vec!["binary.yaml"]),
        ("-a . --world world.yaml --steps 1", vec!["."]),
        ("-l 99 --steps 1", vec!["99"]),
        ("-a ok.yaml --world world.yaml --steps 1 --commands absent.txt", vec!["absent.txt"]),
        ("-a ok.yaml --world world.yaml --steps 1 --trace ok.yaml/t", vec!["ok.yaml/t"]),
    ] {
        let ran = folder.run(arguments);
        assert_eq!(ran.status, 2, "{arguments}: {ran:?}");
        for part in parts {
            assert!(ran.stderr.contains(part), "{arguments}: {ran:?} should name {part}");
        }
    }
}

#[test]
fn a_bad_command_is_status_2_with_its_line() {
    let folder = Folder::new();
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    for (line, part) in [
        ("0|1|WR|Nobody|1 2 3 4 5 6", "Nobody"),
        ("0|1|FLY|Link|1", "FLY"),
        ("0|1|J|Base|0 7 1", "type"),
        ("0|1|J|Base|1 0 1", "no joint 1"),
        ("0|1|JS|Link|0 0 1 1 1", "no active joint"),
        ("0|1|J|Base|0.5 0 1", "0.5"),
        ("0|1|WR|Link|1 2 3", "6 numbers"),
        ("0|1|TW|Link|nan 0 0 0 0 0", "nan"),
        ("0|1|J|Base|0 0 1e39", "3.4"),
        ("3|2|TW|Link|0 0 0 0 0 0", "3"),
        ("-1|2|TW|Link|0 0 0 0 0 0", "-1"),
        ("0|1|VEH|Base|0 0 0", "vehicle"),
        ("gibberish", "fields"),
    ] {
        folder.write("commands.txt", &format!("# first line\n\n{line}\n"));
        let ran = folder.run(&format!("-a {} --world world.yaml --steps 2 --commands commands.txt", pendulum()));
        assert_eq!(ran.status, 2, "{line}: {ran:?}");
        assert!(ran.stderr.contains("commands.txt:3:") && ran.stderr.contains(part), "{line}: {ran:?}");
    }
}

#[test]
fn a_scene_with_a_dropped_body_runs_and_is_status_2() {
    let folder = Folder::new();
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.write(
        "model.yaml",
        &(BALL.replace("[BODY Ball]", "[BODY Ball, BODY Bad]") + "BODY Bad: {name: Bad, mass: -1}\n"),
    );
    let ran = folder.run("-a model.yaml --world world.yaml --steps 10 --trace t --json");
    assert_eq!(ran.status, 2, "{ran:?}");
    assert!(ran.stderr.contains("model.yaml:3") && ran.stdout.contains("\"bodies\":1,"), "{ran:?}");
    assert_eq!(folder.csv("t_bodies.csv").distinct("body"), ["Ball"]);
}

#[test]
fn warnings_do_not_fail_a_run() {
    let folder = Folder::new();
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.write("model.yaml", "bodies: [BODY A]\nBODY A: {name: A, mass: 1, colour of the sky: blue}\n");
    let ran = folder.succeed("-a model.yaml --world world.yaml --steps 1");
    assert!(ran.stderr.contains("colour of the sky"), "{ran:?}");
}

#[test]
fn a_state_that_becomes_non_finite_is_status_3_and_said_where() {
    let folder = Folder::new();
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    folder.write("model.yaml", BALL);
    for command in ["TW|Ball|1e308 1e308 1e308 0 0 0", "TW|Ball|0 0 0 1e308 1e308 0", "WR|Ball|1e308 0 0 0 0 0"] {
        folder.write("commands.txt", &format!("2|9999|{command}\n"));
        let ran = folder.run("-a model.yaml --world world.yaml --steps 5000 --trace t --commands commands.txt --json");
        assert_eq!(ran.status, 3, "{command}: {ran:?}");
        for part in ["BODY Ball", "step ", "last command: commands.txt:1"] {
            assert!(ran.stderr.contains(part), "{command}: {ran:?} should say {part}");
        }
        let csv = folder.csv("t_bodies.csv");
        // What went before is kept, and nothing that is no number.
        assert!(csv.lines.len() >= 3, "{command}");
        let numbers = csv.lines.iter().flat_map(|line| &line[3..]).map(|cell| cell.parse::<f64>().expect("a number"));
        assert!(numbers.into_iter().all(f64::is_finite), "{command}");
    }
}

#[test]
fn two_runs_are_the_same_to_the_last_bit() {
    let folder = Folder::new();
    for scene in ["stack", "joints", "gripper"] {
        let model = resources().join(format!("models/{scene}.yaml"));
        for run in ["a", "b"] {
            folder.succeed(&format!("-a {} --steps 300 --every 50 --trace {run} --full", model.display()));
        }
        for kind in ["bodies", "joints"] {
            let (a, b) = (format!("a_{kind}.csv"), format!("b_{kind}.csv"));
            if folder.exists(&a) {
                assert_eq!(folder.csv(&a).lines, folder.csv(&b).lines, "{scene}");
            }
        }
    }
}

#[test]
fn coefficients_of_soft_bodies_beyond_the_range_of_bullet_are_clamped_in_the_accurate_profile() {
    let folder = Folder::new();
    let mesh = resources().join("meshes/cloth.obj").display().to_string();
    folder.write(
        "m.yaml",
        &format!("bodies: []\nsoft bodies: [S]\nS:\n  name: S\n  mass: 0.2\n  mesh: {mesh}\n  config:\n    kLST: 5\n"),
    );
    for (profile, status) in [("legacy", 3), ("accurate", 0)] {
        let ran = folder.run(&format!("-a m.yaml --steps 200 --profile {profile}"));
        assert_eq!(ran.status, status, "{ran:?}");
        let expected =
            "m.yaml:8:11: warning: `S / config / kLST` is `5`, expected 0 to 1, the range that Bullet gives for it";
        assert!(ran.stderr.contains(expected), "{ran:?}");
    }
}

#[test]
fn what_cannot_be_written_is_said_and_no_half_file_is_left() {
    let folder = Folder::new();
    folder.write("model.yaml", BALL);
    folder.write("world.yaml", "gravity: {x: 0, y: 0, z: -10}\n");
    // No file may be larger than 8 blocks of 512 bytes.
    let small = "trap '' XFSZ && ulimit -f 8 && exec \"$0\" \"$@\"";
    let run =
        |outputs: &str| folder.run_in_shell(small, &format!("-a model.yaml --world world.yaml --steps 200 {outputs}"));
    for (outputs, file) in [("--trace t --energy e --every 10", "t_bodies.csv"), ("--energy e", "e")] {
        folder.write(file, "before");
        let ran = run(outputs);
        assert_eq!(ran.status, 2, "{ran:?}");
        assert_eq!(ran.stderr, format!("{file} cannot be written: File too large (os error 27)\n"));
        assert_eq!(std::fs::read_to_string(folder.path().join(file)).expect("there"), "before");
    }
    let ran = run("--trace none/t --every 100");
    assert_eq!((ran.status, ran.stderr.as_str()), (0, ""), "folders are made");
    assert_eq!(
        folder.names(),
        ["e", "model.yaml", "none", "t_bodies.csv", "world.yaml"],
        "what fits, and nothing else"
    );
}

#[test]
fn standard_output_that_is_full_is_an_error_and_one_that_nobody_reads_is_none() {
    let folder = Folder::new();
    folder.write("model.yaml", BALL);
    for arguments in ["-a model.yaml --steps 1 --json", "--check model.yaml", "--help"] {
        let full = folder.run_in_shell("exec \"$0\" \"$@\" >/dev/full", arguments);
        assert_eq!(full.status, 2, "{arguments}: {full:?}");
        let sentence = "standard output cannot be written: No space left on device (os error 28)\n";
        assert!(full.stderr.ends_with(sentence), "{arguments}: {full:?}");
        // The pipe has no reader by the time that the program writes.
        let unread = "{ sleep 0.2; \"$0\" \"$@\"; echo $? >status; } | true; wait; until [ -s status ]; do sleep 0.01; done; cat status";
        let unread = folder.run_in_shell(unread, arguments);
        assert_eq!(unread.stdout, "0\n", "{arguments}: {unread:?}");
        assert!(!unread.stderr.contains("cannot be written"), "{arguments}: {unread:?}");
        std::fs::remove_file(folder.path().join("status")).expect("there");
    }
}

#[test]
fn what_was_written_before_an_interruption_is_kept() {
    let folder = Folder::new();
    folder.write("model.yaml", BALL);
    // Sent when the trace has begun.
    let script = "\"$0\" \"$@\" & until ls -A | grep -q unfinished; do sleep 0.01; done; kill -INT $!; wait $!";
    let ran = folder.run_in_shell(script, "-a model.yaml --steps 1000000000 --trace t");
    assert_eq!(ran.status, 130, "{ran:?}");
    assert_eq!(folder.names(), ["model.yaml", "t_bodies.csv"]);
    assert!(!folder.csv("t_bodies.csv").lines.is_empty());
}

#[test]
fn nothing_that_files_or_command_lines_hold_reaches_the_terminal_as_it_is() {
    let folder = Folder::new();
    let text = r#"bodies: [BODY a, "BODY \x1b[31m\r\u202e"]
joints: [J, JOINT j]
BODY a:
  name: "x\x1b[2J\n\r\0\u202e\x07y"
  mass: 1
  "col\x1bour": 7
  location: {position: {x: "1e3\x1b00", y: 1e300, z: 0}}
  collision shape: "Bo\x08x"
  gravity: {x: 1e300, y: -1e-300, z: 0}
J: {name: "j\x1b", type: "revo\x1blute", parent: "BODY no\x1b", child: BODY a}
"#;
    folder.write("m.yaml", text);
    folder.write("c.txt", "1|2|TW|x\u{1b}[2J|1e300 0 0 0 0 0\n");
    let name = "no\u{1b}[2Jsuch\u{9b}.yaml";
    for arguments in [
        "-a m.yaml --steps 3".to_owned(),
        "--check m.yaml".to_owned(),
        format!("-a {name} --steps 3"),
        format!("-a m.yaml --steps {name}"),
        format!("-a m.yaml --{name} 3"),
        format!("-a m.yaml --steps 3 --profile {name}"),
        format!("-a m.yaml --steps 3 --render {name} --out p"),
        format!("-a m.yaml --steps 3 --trace {name}/\u{7}/t"),
        "-a m.yaml --steps 3 --commands c.txt".to_owned(),
    ] {
        let ran = folder.run(&arguments);
        let said = ran.stdout.clone() + &ran.stderr;
        assert!(said.chars().all(|c| c == '\n' || !c.is_control() && c != '\u{202e}'), "{arguments:?}: {ran:?}");
        assert!(!said.is_empty(), "{arguments:?}");
        let longest = said.split(|c: char| !c.is_ascii_digit()).map(str::len).max();
        assert!(longest <= Some(40), "{arguments:?}: {ran:?}");
        for rust in ["Some(", "Os {", "kind:", "Err("] {
            assert!(!said.contains(rust), "{arguments:?}: {ran:?}");
        }
    }
}

#[test]
fn what_is_no_file_is_named_and_never_waited_for() {
    let folder = Folder::new();
    folder.write("model.yaml", BALL);
    let made = std::process::Command::new("mkfifo").arg(folder.path().join("pipe.yaml")).status().expect("mkfifo runs");
    assert!(made.success());
    for arguments in [
        "-a pipe.yaml --steps 1",
        "-a model.yaml --world pipe.yaml --steps 1",
        "-a model.yaml --commands pipe.yaml --steps 1",
        "--launch_file pipe.yaml -l 0 --steps 1",
        "--check pipe.yaml",
    ] {
        let ran = folder.run(arguments);
        let said = ran.stdout.clone() + &ran.stderr;
        assert_eq!(ran.status, 2, "{arguments}: {ran:?}");
        assert!(
            said.contains("pipe.yaml") && said.contains("is a named pipe, expected a file"),
            "{arguments}: {ran:?}"
        );
    }
    let ran = folder.run("-a . --steps 1");
    assert!(ran.stderr.contains("it is a folder, expected a file"), "{ran:?}");
}
