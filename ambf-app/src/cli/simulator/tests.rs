use super::super::PhysicsProfile;
use super::*;
use std::path::Path;

fn parse(words: &[&str]) -> Result<Parsed<SimulatorOptions>, CliError> {
    SimulatorOptions::parse(["ambf_simulator"].iter().chain(words).map(OsString::from))
}

fn run(words: &[&str]) -> (SimulatorOptions, Vec<String>) {
    match parse(words) {
        Ok(Parsed::Run { options, notes }) => (options, notes),
        other => panic!("{words:?} gave {other:?}"),
    }
}

fn quiet(words: &[&str]) -> SimulatorOptions {
    let (options, notes) = run(words);
    assert_eq!(notes, [] as [String; 0], "{words:?}");
    options
}

fn refused(words: &[&str]) -> String {
    match parse(words) {
        Err(error) => error.to_string(),
        other => panic!("{words:?} gave {other:?}"),
    }
}

#[test]
fn defaults_are_those_of_the_original() {
    let options = quiet(&[]);
    let expected = SimulatorOptions {
        devices: DeviceSelection::First(0),
        force_feedback: false,
        physics_frequency: 1000,
        haptic_frequency: 1000,
        fixed_physics_step: false,
        fixed_haptic_step: false,
        publish_frequency: None,
        show_gui: None,
        namespace: String::new(),
        speed_factor: 1.0,
        plugins: vec![],
        crtk: vec![],
        seed: None,
        record: None,
        record_from_reset: false,
        replay: None,
        launch_file: options.launch_file.clone(),
        model_files: vec![],
        model_indexes: vec![1],
        no_ros: false,
        ros: None,
        clock: false,
        tf: None,
        end_master: false,
        hold: false,
        verbose: false,
        physics: PhysicsOptions::default(),
        check: None,
        doctor: false,
    };
    assert_eq!(options, expected);
    assert!(options.launch_file.ends_with("launch.yaml"));
}

#[test]
fn every_long_name_sets_its_option() {
    let options = quiet(&[
        "--ndevs",
        "2",
        "--enableforces",
        "yes",
        "--phx_frequency",
        "2000",
        "--htx_frequency",
        "500",
        "--fixed_phx_timestep",
        "true",
        "--fixed_htx_timestep",
        "on",
        "--override_max_comm_freq",
        "2000",
        "--override_min_comm_freq",
        "1500",
        "--show_gui",
        "off",
        "--ns",
        "/sim1",
        "--sim_speed_factor",
        "0.5",
        "--plugins",
        "a.so, b.so,c.so",
        "--seed",
        "7",
        "--record",
        "a.mcap",
        "--crtk",
        "psm.yaml, ecm.yaml",
        "--launch_file",
        "x/launch.yaml",
        "--load_multibody_files",
        "a.yaml, b.yaml",
        "--load_multibodies",
        "1, 6,10",
        "--no_ros",
        "--ros",
        "both",
        "--clock",
        "--tf=100",
        "--hold",
        "--verbose",
        "--profile",
        "accurate",
        "--solver",
        "nncg",
        "--iterations",
        "30",
        "--integrator",
        "rk4",
        "--sleep=0",
        "--articulated=false",
    ]);
    let expected = SimulatorOptions {
        devices: DeviceSelection::First(2),
        force_feedback: true,
        physics_frequency: 2000,
        haptic_frequency: 500,
        fixed_physics_step: true,
        fixed_haptic_step: true,
        publish_frequency: Some(PublishFrequency { min: 1500, max: 2000 }),
        show_gui: Some(false),
        namespace: "/sim1".to_owned(),
        speed_factor: 0.5,
        plugins: ["a.so", "b.so", "c.so"].map(PathBuf::from).to_vec(),
        crtk: ["psm.yaml", "ecm.yaml"].map(PathBuf::from).to_vec(),
        seed: Some(7),
        record: Some("a.mcap".into()),
        record_from_reset: false,
        replay: None,
        launch_file: "x/launch.yaml".into(),
        model_files: ["a.yaml", "b.yaml"].map(PathBuf::from).to_vec(),
        model_indexes: vec![1, 6, 10],
        no_ros: true,
        ros: Some(RosVersions::Both),
        clock: true,
        tf: Some(100),
        end_master: false,
        hold: true,
        verbose: true,
        physics: PhysicsOptions {
            profile: Some(PhysicsProfile::Accurate),
            solver: Some("nncg".to_owned()),
            iterations: Some(30),
            integrator: Some("rk4".to_owned()),
            sleep: Some(false),
            articulated: Some(false),
        },
        check: None,
        doctor: false,
    };
    assert_eq!(options, expected);
}

#[test]
fn every_short_name_sets_its_option() {
    let spaced = quiet(&[
        "-n", "1", "-e", "1", "-p", "60", "-d", "70", "-t", "1", "-f", "1", "-g", "0", "-s", "2", "-a", "x", "-l", "3",
    ]);
    let attached = quiet(&["-n1", "-e1", "-p60", "-d70", "-t1", "-f1", "-g0", "-s2", "-ax", "-l3"]);
    assert_eq!(spaced, attached);
    assert_eq!((spaced.physics_frequency, spaced.haptic_frequency), (60, 70));
    assert_eq!((spaced.fixed_physics_step, spaced.fixed_haptic_step), (true, true));
    assert_eq!((spaced.devices, spaced.force_feedback), (DeviceSelection::First(1), true));
    assert_eq!((spaced.show_gui, spaced.speed_factor), (Some(false), 2.0));
    assert_eq!((spaced.model_files, spaced.model_indexes), (vec![PathBuf::from("x")], vec![3]));
}

#[test]
fn invocations_found_in_documents_of_the_original() {
    assert_eq!(quiet(&["-l", "4"]).model_indexes, [4]);
    assert_eq!(quiet(&["-l", "1,6,10"]).model_indexes, [1, 6, 10]);
    let options = quiet(&["-p60", "-t1", "--launch_file", "d/launch.yaml", "-l10", "-i0"]);
    assert_eq!(options.launch_file, Path::new("d/launch.yaml"));
    assert_eq!((options.physics_frequency, options.fixed_physics_step), (60, true));
    assert_eq!((options.model_indexes, options.devices), (vec![10], DeviceSelection::Indexes(vec![0])));
    let options = quiet(&["-g", "false", "-p", "2000", "-d", "1000", "--override_max_comm_freq", "500"]);
    assert_eq!(options.publish_frequency, Some(PublishFrequency { min: 50, max: 500 }));
}

#[test]
fn names_may_be_shortened_unless_ambiguous() {
    let options = quiet(&["--launch", "x", "--fixed_p", "1", "--override_ma=70", "--e=true", "--no"]);
    assert_eq!(options.launch_file, Path::new("x"));
    assert!(options.fixed_physics_step && options.force_feedback && options.no_ros);
    let message = refused(&["--load_m", "1"]);
    assert!(message.contains("--load_multibodies") && message.contains("--load_multibody_files"), "{message}");
}

#[test]
fn the_environment_says_which_ros_unless_an_option_does() {
    for (name, versions) in RosVersions::NAMES {
        assert_eq!(quiet(&["--ros", name]).ros, Some(versions));
    }
    assert!(refused(&["--ros", "3"]).contains("both"));
    assert_eq!((quiet(&["--tf"]).tf, quiet(&["--tf", "--hold"]).tf), (Some(50), Some(50)));
    assert!(refused(&["--tf=0"]).contains("--tf"));
    let chosen = |set: &[&str], version| RosVersions::from_environment(|name| set.contains(&name), version);
    assert_eq!(chosen(&[], None), RosVersions::One);
    assert_eq!(chosen(&[], Some("1")), RosVersions::One);
    assert_eq!(chosen(&[], Some("2")), RosVersions::Two);
    assert_eq!(chosen(&["ROS_DOMAIN_ID"], None), RosVersions::Two);
    assert_eq!(chosen(&["ROS_DOMAIN_ID", "ROS_MASTER_URI"], Some("2")), RosVersions::One);
    assert!(RosVersions::Both.has_one() && RosVersions::Both.has_two() && !RosVersions::None.has_one());
}

#[test]
fn models_come_from_index_one_only_if_none_are_named() {
    let files_only = quiet(&["-a", " a.yaml , b.yaml "]);
    assert_eq!(files_only.model_files, ["a.yaml", "b.yaml"].map(PathBuf::from));
    assert!(files_only.model_indexes.is_empty());
    assert_eq!(quiet(&["-a", ""]).model_indexes, [1]);
    assert_eq!(quiet(&["-l", "5,5"]).model_indexes, [5, 5]);
}

#[test]
fn what_is_no_index_is_skipped_and_named() {
    let (options, notes) = run(&["-l", "2,x,-1", "-i", "0,y"]);
    assert_eq!((options.model_indexes, options.devices), (vec![2], DeviceSelection::Indexes(vec![0])));
    assert_eq!(notes.len(), 3, "{notes:?}");
    assert!(notes[0].contains("-l") && notes[0].contains("\"x\"") && notes[2].contains("-i"), "{notes:?}");
    let (options, notes) = run(&["-l", "-1"]);
    assert_eq!((options.model_indexes.len(), notes.len()), (0, 1));
}

#[test]
fn the_list_of_devices_goes_before_their_number() {
    assert_eq!(quiet(&["-n", "3", "-i", "4, 1"]).devices, DeviceSelection::Indexes(vec![4, 1]));
    assert_eq!(quiet(&["-n", "3", "-i", ""]).devices, DeviceSelection::First(3));
}

#[test]
fn unknown_options_and_stray_words_are_ignored_and_named() {
    let (options, notes) = run(&["--foo", "bar", "-x9", "-p", "500", "__name:=me", "--zap=1", "-", "--", "-l", "7"]);
    assert_eq!((options.physics_frequency, options.model_indexes), (500, vec![1]));
    let named: Vec<&str> = notes.iter().map(|note| note.rsplit(' ').next().unwrap()).collect();
    assert_eq!(named, ["--foo", "bar", "-x9", "__name:=me", "--zap=1", "-", "-l", "7"]);
}

#[test]
fn malformed_values_are_refused_with_the_name_of_the_option() {
    for (option, value) in [
        ("--phx_frequency", "0"),
        ("--phx_frequency", "fast"),
        ("--htx_frequency", "-5"),
        ("--htx_frequency", "10"),
        ("--htx_frequency", "20000"),
        ("--phx_frequency", "1e3"),
        ("--phx_frequency", "100001"),
        ("--fixed_phx_timestep", "maybe"),
        ("--show_gui", ""),
        ("--ndevs", "-1"),
        ("--sim_speed_factor", "nan"),
        ("--sim_speed_factor", "0"),
        ("--override_min_comm_freq", "0"),
        ("--profile", "fastest"),
        ("--iterations", "0"),
        ("--no_ros", "="),
    ] {
        let message = refused(&[&format!("{option}={value}")]);
        assert!(message.contains(option), "{option}={value}: {message}");
    }
}

#[test]
fn a_value_may_not_be_missing() {
    for words in [&["-t"][..], &["-l"], &["--launch_file"], &["-t", "-p", "60"], &["--launch_file", "--ns=x"]] {
        let message = refused(words);
        assert!(message.contains(words[0]) && message.contains("needs a value"), "{message}");
    }
}

#[test]
fn options_given_twice_are_refused() {
    for words in [
        &["-l", "1", "-l", "2"][..],
        &["-t1", "--fixed_phx_timestep=1"],
        &["--no_ros", "--no_ros"],
        &["--ns=", "--ns=a"],
    ] {
        let message = refused(words);
        assert!(message.contains("multiple times"), "{words:?}: {message}");
    }
}

#[test]
fn switches_take_a_boolean_word_but_no_other() {
    assert!(!quiet(&["--no_ros", "0"]).no_ros);
    assert!(quiet(&["--no_ros=on"]).no_ros);
    let (options, notes) = run(&["--verbose", "word"]);
    assert!(options.verbose);
    assert_eq!(notes.len(), 1);
}

#[test]
fn crossing_publish_frequencies_are_refused_one_by_one() {
    let frequency = |words: &[&str]| {
        let (options, notes) = run(words);
        (options.publish_frequency, notes.len())
    };
    let pair = |min, max| Some(PublishFrequency { min, max });
    assert_eq!(frequency(&["--override_min_comm_freq", "1500"]), (pair(50, 1000), 1));
    assert_eq!(frequency(&["--override_max_comm_freq", "20"]), (pair(50, 1000), 1));
    assert_eq!(
        frequency(&["--override_min_comm_freq", "2000", "--override_max_comm_freq", "2000"]),
        (pair(2000, 2000), 0)
    );
}

#[test]
fn the_speed_factor_needs_a_fixed_step() {
    assert_eq!(quiet(&["-t1", "-s", "2"]).speed_factor, 2.0);
    let (options, notes) = run(&["-s", "2"]);
    assert_eq!((options.speed_factor, notes.len()), (1.0, 1));
}

#[test]
fn help_and_version_are_texts() {
    for words in [&["--help"][..], &["-h"], &["-l1", "--help"]] {
        match parse(words) {
            Ok(Parsed::Print(text)) => {
                for part in [
                    "Scene",
                    "Time",
                    "Input devices",
                    "ROS",
                    "Physics",
                    "--load_multibodies",
                    "--no_ros",
                    "AMBF_RESOURCES",
                ] {
                    assert!(text.contains(part), "{part} is missing in:\n{text}");
                }
            }
            other => panic!("{other:?}"),
        }
    }
    let version = format!("ambf_simulator {}\n", ambf_version::VERSION);
    assert_eq!(parse(&["--version"]), Ok(Parsed::Print(version)));
}

#[cfg(unix)]
#[test]
fn arguments_that_are_no_text_are_refused() {
    use std::os::unix::ffi::OsStringExt;
    let argument = OsString::from_vec(vec![b'-', b'a', 0xff]);
    let result = SimulatorOptions::parse([OsString::from("ambf_simulator"), argument.clone()]);
    assert_eq!(result, Err(CliError::NotUtf8(argument)));
}

#[test]
fn words_without_an_option_are_files_only_for_check() {
    let check = |words: &[&str]| quiet(words).check.expect("a check");
    let options = check(&["--check", "a.yaml", "--json", "-g", "0", "b.yaml"]);
    assert_eq!(options.files, ["a.yaml", "b.yaml"].map(PathBuf::from));
    assert_eq!((options.together, options.json), (None, true));
    let options = check(&["--check", "-l", "2,3", "-a", "c.yaml"]);
    assert_eq!(options.files, [] as [PathBuf; 0]);
    assert_eq!(options.together, Some((vec!["c.yaml".into()], vec![2, 3])));
    let options = check(&["--check", "--launch_file", "x.yaml"]);
    assert_eq!((options.files, options.together), (vec![PathBuf::from("x.yaml")], None));

    let (options, notes) = run(&["a.yaml", "--json"]);
    assert_eq!((options.check, notes.len()), (None, 2));
    let (options, notes) = run(&["--check", "--unknown", "a.yaml"]);
    assert_eq!(options.check.expect("a check").files, [PathBuf::from("a.yaml")]);
    assert!(notes.len() == 1 && notes[0].contains("--unknown"), "{notes:?}");
    assert!(refused(&["--check=x"]).contains("--check"));
}

#[test]
fn recordings_are_replayed_and_say_what_is_simulated() {
    let whole =
        FollowedRecording { file: "a.mcap".into(), speed: 1.0, from: 0.0, continue_at: None, changed_files: false };
    assert_eq!(quiet(&["--replay", "a.mcap"]).replay, Some(whole.clone()));
    let options = quiet(&["--replay", "a.mcap", "-s", "0.5", "--replay-from", "3", "--changed-files"]);
    assert_eq!(options.replay, Some(FollowedRecording { speed: 0.5, from: 3.0, changed_files: true, ..whole.clone() }));
    assert_eq!(options.speed_factor, 1.0);
    let options = quiet(&["--replay", "a.mcap", "--continue-at", "2.5", "-t", "1", "-s", "2"]);
    assert_eq!(options.replay, Some(FollowedRecording { speed: 2.0, continue_at: Some(2.5), ..whole }));
    assert_eq!(options.speed_factor, 2.0, "from there on");
    let (_, notes) = run(&["--replay", "a.mcap", "-l", "3", "-n", "1", "--profile", "legacy"]);
    assert_eq!(notes.len(), 3, "{notes:?}");
    assert!(notes.iter().all(|note| note.contains("the recording of --replay says what is simulated")), "{notes:?}");
    let (options, notes) = run(&["--continue-at", "1"]);
    assert!(options.replay.is_none() && notes[0].contains("only with --replay"), "{notes:?}");
    assert!(refused(&["--record-from-reset"]).contains("--record"));
    assert!(quiet(&["--record", "a.mcap", "--record-from-reset"]).record_from_reset);
    assert!(refused(&["--replay", "a.mcap", "--continue-at", "-1"]).contains("--continue-at"));
}
