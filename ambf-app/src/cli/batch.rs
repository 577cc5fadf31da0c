//! Options of `ambf_batch`.

use super::values::{indexes, parts, positive};
use super::{launch_file, print_or_fail, utf8, CheckOptions, CliError, Parsed, PhysicsOptions};
use clap::{CommandFactory, Parser};
use std::ffi::OsString;
use std::path::PathBuf;

/// What `ambf_batch` was asked to do.
///
/// Paths are as typed: relative ones are relative to the working directory.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchOptions {
    /// Launch file. It need not exist; see [`BatchOptions::needs_launch_file`].
    pub launch_file: PathBuf,
    /// World file used instead of the launch file's.
    pub world: Option<PathBuf>,
    /// Model files, loaded first.
    pub model_files: Vec<PathBuf>,
    /// Indexes into the launch file's list of models, from 0, loaded after the files. May be out of range or repeated.
    pub model_indexes: Vec<usize>,
    /// Number of steps.
    pub steps: u64,
    /// Length of a step and of Bullet's sub-step, in s, above 0; default: 0.001.
    pub dt: f64,
    /// Command file.
    pub commands: Option<PathBuf>,
    /// Simulator plugins, in load order.
    pub plugins: Vec<PathBuf>,
    /// What the names of the trace files begin with; `None`: no traces.
    pub trace: Option<PathBuf>,
    /// File of the energy ledger, CSV; `None`: no ledger.
    pub energy: Option<PathBuf>,
    /// A row is written every so many steps, at least 1; default: 1.
    pub every: u64,
    /// Whether the trace of the bodies has the poses of the inertial frames too; default: `false`.
    pub full: bool,
    /// Whether to print one line of JSON about the run; default: `false`.
    pub json: bool,
    /// Solver and profile.
    pub physics: PhysicsOptions,
    /// Recording to write; `None`: none.
    pub record: Option<PathBuf>,
    /// Recording to replay instead of stepping a scene; `None`: step.
    pub replay: Option<ReplayOptions>,
    /// Pictures to take; `None`: none.
    pub pictures: Option<PictureOptions>,
    /// Files to check instead of stepping; `None`: step.
    pub check: Option<CheckOptions>,
}

/// What is replayed, and how far.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayOptions {
    /// The recording.
    pub file: PathBuf,
    /// Simulated time, s, from which commands of the user are followed instead of the recording; `None`: all of it is
    /// replayed.
    pub continue_at: Option<f64>,
    /// Whether files of the scene may have changed; default: `false`.
    pub changed_files: bool,
    /// Steps at most: of the recording or, with `continue_at`, after it; `None`: all of the recording.
    pub steps: Option<u64>,
}

/// Which pictures are taken, and where they go. There is a folder or a video at least.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureOptions {
    /// Names or qualified identifiers of cameras, one at least.
    pub cameras: Vec<String>,
    /// A picture is taken every so many steps, at least 1; `None`: so that a simulated second has about 30.
    pub every: Option<u64>,
    /// Folder of the files; `None`: no files.
    pub out: Option<PathBuf>,
    /// Width and height in pixels; `None`: the published resolution of the camera, else 640 x 480.
    pub size: Option<(u32, u32)>,
    /// Format of the depths: `npy`, `exr` or `png16`; `None`: no depths.
    pub depth: Option<String>,
    /// Whether the ids of objects are written; default: `false`.
    pub ids: bool,
    /// Samples a pixel, 1 to 8; default: 1.
    pub samples: u32,
    /// A video of all pictures; of several cameras one video each, with the camera's name behind the stem.
    pub video: Option<PathBuf>,
}

impl BatchOptions {
    /// The command line as clap knows it, for completions and manual pages.
    pub fn command() -> clap::Command {
        Arguments::command()
    }

    /// Reads a command line, program name included. There are never notes.
    ///
    /// # Errors
    /// [`CliError::Usage`] when an option is unknown, malformed, given twice or missing; [`CliError::NotUtf8`] when an
    /// argument isn't text.
    pub fn parse(argv: impl IntoIterator<Item = OsString>) -> Result<Parsed<Self>, CliError> {
        match Arguments::try_parse_from(utf8(argv)?) {
            Ok(arguments) => match arguments.files.first() {
                Some(file) if !arguments.check => Err(CliError::Usage(format!(
                    "error: unexpected argument '{file}': only --check takes files without an option (try --help)",
                    file = file.display()
                ))),
                _ if arguments.replay.is_some() && arguments.continue_at.is_none() && arguments.commands.is_some() => {
                    let problem = "error: --commands needs --continue-at when something is replayed (try --help)";
                    Err(CliError::Usage(problem.into()))
                }
                // Clap forgives what is missing where something else excludes it.
                _ if arguments.replay.is_none() && arguments.continue_at.is_some() => {
                    let problem = "error: --continue-at needs --replay (try --help)";
                    Err(CliError::Usage(problem.into()))
                }
                _ if arguments.replay.is_some() && arguments.describes_a_scene() => {
                    let problem = "error: --replay takes scene, physics and plugins from the recording: leave --world, --plugins and \
                                   the options of physics out (try --help)";
                    Err(CliError::Usage(problem.into()))
                }
                _ if !arguments.render.is_empty() && arguments.out.is_none() && arguments.video.is_none() => {
                    let problem = "error: --render needs --out DIR for files, or --video FILE (try --help)";
                    Err(CliError::Usage(problem.into()))
                }
                _ => Ok(Parsed::Run { options: arguments.into_options(), notes: Vec::new() }),
            },
            Err(error) => print_or_fail(&error),
        }
    }

    /// Whether the launch file has to be read: for the world or for models named by index.
    pub fn needs_launch_file(&self) -> bool {
        self.world.is_none() || !self.model_indexes.is_empty()
    }
}

/// The command line as it is written; help texts are for the user.
#[derive(Debug, clap::Parser)]
#[command(
    name = "ambf_batch",
    version = ambf_version::VERSION,
    about = "Steps a scene as fast as it can, without ROS and without a clock, and writes traces.",
    after_help = "At least one of -l and -a is needed, except with --check.\n\n\
                  Exit status: 0 done; 1 wrong usage; 2 a file could not be loaded, or not be written; 3 the state became non-finite.\n\
                  Of --check: 0 nothing is dropped; 1 wrong usage; 2 something is refused or dropped.\n\n\
                  Examples:\n  ambf_batch -a pendulum.yaml --steps 3000 --trace out/pendulum --every 20 --json\n  \
                  ambf_batch --check robot.yaml world.yaml"
)]
struct Arguments {
    /// Models to load: indexes into the launch file's list, from 0
    #[arg(short = 'l', long = "load_multibodies", value_name = "INDEX,…", value_parser = strict_indexes)]
    #[arg(required_unless_present_any = ["check", "model_files", "replay"], conflicts_with = "replay", help_heading = "Scene")]
    model_indexes: Option<List<usize>>,
    /// Model files to load, before those of -l
    #[arg(short = 'a', long = "load_multibody_files", value_name = "FILE,…", value_parser = strict_paths)]
    #[arg(conflicts_with = "replay", help_heading = "Scene")]
    model_files: Option<List<PathBuf>>,
    /// Launch file [default: launch.yaml in $AMBF_ROOT_PATH/ambf_models/descriptions, $AMBF_RESOURCES or resources]
    #[arg(long = "launch_file", value_name = "FILE", help_heading = "Scene")]
    launch_file: Option<PathBuf>,
    /// World file [default: the launch file's]
    #[arg(long, value_name = "FILE", help_heading = "Scene")]
    world: Option<PathBuf>,
    /// Commands to apply
    #[arg(long, value_name = "FILE", help_heading = "Scene")]
    commands: Option<PathBuf>,
    /// Simulator plugins to load
    #[arg(long, value_name = "FILE,…", value_parser = strict_paths, help_heading = "Scene")]
    plugins: Option<List<PathBuf>>,

    /// Number of steps
    #[arg(long, value_name = "N", value_parser = steps, help_heading = "Time")]
    #[arg(required_unless_present_any = ["check", "replay"])]
    steps: Option<u64>,
    /// Length of a step, s
    #[arg(long, value_name = "SECONDS", default_value = "0.001", value_parser = positive, help_heading = "Time")]
    dt: f64,

    /// Write a recording, from which the run can be made again
    #[arg(long, value_name = "FILE", help_heading = "Recordings")]
    record: Option<PathBuf>,
    /// Replay a recording instead of stepping a scene; --steps then says how many steps at most
    #[arg(long, value_name = "FILE", help_heading = "Recordings")]
    replay: Option<PathBuf>,
    /// Replay up to this simulated time, then make --steps steps with --commands, whose steps count from there
    #[arg(long, value_name = "SECONDS", requires_all = ["replay", "steps"], value_parser = positive, help_heading = "Recordings")]
    continue_at: Option<f64>,
    /// Replay also when files of the scene have changed since
    #[arg(long, requires = "replay", help_heading = "Recordings")]
    changed_files: bool,

    /// Write PREFIX_bodies.csv, PREFIX_joints.csv and PREFIX_softnodes.csv
    #[arg(long, value_name = "PREFIX", help_heading = "Output")]
    trace: Option<PathBuf>,
    /// Write where the mechanical energy comes from and goes, J, as CSV
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    energy: Option<PathBuf>,
    /// Write every K-th step, and the last in traces [default: 1; pictures: 30 a simulated second]
    #[arg(long, value_name = "K", value_parser = interval, help_heading = "Output")]
    every: Option<u64>,
    /// Write the poses of the inertial frames too
    #[arg(long, help_heading = "Output")]
    full: bool,
    /// Print one line of JSON about the run, or what --check finds as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,

    /// Take pictures with a camera, by name or qualified identifier; may be given several times
    #[arg(long, value_name = "CAMERA", help_heading = "Pictures")]
    render: Vec<String>,
    /// Write DIR/CAMERA_STEP.png, and DIR/pictures.csv with times, poses and intrinsics
    #[arg(long, value_name = "DIR", requires = "render", help_heading = "Pictures")]
    out: Option<PathBuf>,
    /// Size of the pictures in pixels [default: the published resolution, else 640x480]
    #[arg(long, value_name = "WxH", requires = "render", value_parser = size, help_heading = "Pictures")]
    size: Option<(u32, u32)>,
    /// Write depths along the camera's axis too: npy and exr in m, png16 in mm
    #[arg(long, value_name = "FORMAT", requires = "out", value_parser = ["npy", "exr", "png16"], help_heading = "Pictures")]
    render_depth: Option<String>,
    /// Write which object each pixel shows too, and ids_STEP.csv with their names
    #[arg(long, requires = "out", help_heading = "Pictures")]
    render_ids: bool,
    /// Samples a pixel, 1 to 8: more than 1 smooths edges
    #[arg(long, value_name = "N", default_value = "1", requires = "render", help_heading = "Pictures")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=8))]
    render_samples: u32,
    /// Make a video in real time, such as run.mp4, with the program ffmpeg
    #[arg(long, value_name = "FILE", requires = "render", help_heading = "Pictures")]
    video: Option<PathBuf>,

    /// Check files instead of stepping: say what is wrong with them, what they hold and what becomes of it
    #[arg(long, help_heading = "Check")]
    check: bool,
    /// Files to check [default: what -l and -a name, else the launch file]
    #[arg(value_name = "FILE", help_heading = "Check")]
    files: Vec<PathBuf>,

    #[command(flatten)]
    physics: PhysicsOptions,
}

/// A value of one option; clap would take a plain `Vec` for a repeated option.
#[derive(Debug, Clone)]
struct List<T>(Vec<T>);

fn steps(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| "expected a whole number, 0 or more".to_owned())
}

fn interval(text: &str) -> Result<u64, String> {
    match text.parse() {
        Ok(number) if number > 0 => Ok(number),
        _ => Err("expected a whole number, 1 or more".to_owned()),
    }
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let pixels = |text: &str| text.trim().parse().ok().filter(|number| (1..=16384).contains(number));
    let parts = text.split_once(['x', 'X']).and_then(|(width, height)| Some((pixels(width)?, pixels(height)?)));
    parts.ok_or_else(|| "expected width and height from 1 to 16384, such as 640x480".to_owned())
}

fn strict_indexes(text: &str) -> Result<List<usize>, String> {
    match indexes(text) {
        (indexes, others) if others.is_empty() && !indexes.is_empty() => Ok(List(indexes)),
        (_, others) => Err(format!("expected indexes (0, 1, 2, …) between commas, not {:?}", others.join(","))),
    }
}

fn strict_paths(text: &str) -> Result<List<PathBuf>, String> {
    match parts(text).map(PathBuf::from).collect::<Vec<_>>() {
        paths if paths.is_empty() => Err("expected file names between commas".to_owned()),
        paths => Ok(List(paths)),
    }
}

impl Arguments {
    fn describes_a_scene(&self) -> bool {
        self.world.is_some() || self.plugins.is_some() || self.physics != PhysicsOptions::default()
    }

    fn into_options(self) -> BatchOptions {
        let launch_file = self.launch_file.unwrap_or_else(launch_file::default);
        let model_files = self.model_files.map(|list| list.0).unwrap_or_default();
        let model_indexes = self.model_indexes.map(|list| list.0).unwrap_or_default();
        let check = self.check.then(|| CheckOptions {
            world: self.world.clone(),
            ..CheckOptions::new(self.files, model_files.clone(), model_indexes.clone(), launch_file.clone(), self.json)
        });
        let replay = self.replay.map(|file| ReplayOptions {
            file,
            continue_at: self.continue_at,
            changed_files: self.changed_files,
            steps: self.steps,
        });
        let pictures = (!self.render.is_empty()).then_some(PictureOptions {
            cameras: self.render,
            every: self.every,
            out: self.out,
            size: self.size,
            depth: self.render_depth,
            ids: self.render_ids,
            samples: self.render_samples,
            video: self.video,
        });
        BatchOptions {
            launch_file,
            world: self.world,
            model_files,
            model_indexes,
            // Not needed for a check only.
            steps: self.steps.unwrap_or(0),
            dt: self.dt,
            commands: self.commands,
            plugins: self.plugins.map(|list| list.0).unwrap_or_default(),
            trace: self.trace,
            energy: self.energy,
            every: self.every.unwrap_or(1),
            full: self.full,
            json: self.json,
            physics: self.physics,
            record: self.record,
            replay,
            pictures,
            check,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::PhysicsProfile;
    use super::*;

    fn parse(line: &str) -> Result<Parsed<BatchOptions>, CliError> {
        BatchOptions::parse(std::iter::once("ambf_batch").chain(line.split_whitespace()).map(OsString::from))
    }

    fn run(line: &str) -> BatchOptions {
        match parse(line) {
            Ok(Parsed::Run { options, notes }) if notes.is_empty() => options,
            other => panic!("{line} gave {other:?}"),
        }
    }

    #[test]
    fn the_shortest_line_uses_defaults() {
        let options = run("-l 3,0 --steps 10");
        let expected = BatchOptions {
            launch_file: options.launch_file.clone(),
            world: None,
            model_files: vec![],
            model_indexes: vec![3, 0],
            steps: 10,
            dt: 0.001,
            commands: None,
            plugins: vec![],
            trace: None,
            energy: None,
            every: 1,
            full: false,
            json: false,
            physics: PhysicsOptions::default(),
            record: None,
            replay: None,
            pictures: None,
            check: None,
        };
        assert_eq!(options, expected);
        assert!(options.needs_launch_file());
    }

    #[test]
    fn every_option_is_read() {
        let options = run(
            "-a a.yaml,b.yaml --launch_file l.yaml --world w.yaml --steps 7 --dt 0.0005 --commands c.txt --plugins p.so,builtin:q --trace out/t --energy e.csv \
             --every 20 --full --profile legacy --solver nncg --iterations 5 --integrator rk4 --sleep --articulated=no --json",
        );
        let expected = BatchOptions {
            launch_file: "l.yaml".into(),
            world: Some("w.yaml".into()),
            model_files: ["a.yaml", "b.yaml"].map(PathBuf::from).to_vec(),
            model_indexes: vec![],
            steps: 7,
            dt: 0.0005,
            commands: Some("c.txt".into()),
            plugins: ["p.so", "builtin:q"].map(PathBuf::from).to_vec(),
            trace: Some("out/t".into()),
            energy: Some("e.csv".into()),
            every: 20,
            full: true,
            json: true,
            physics: PhysicsOptions {
                profile: Some(PhysicsProfile::Legacy),
                solver: Some("nncg".to_owned()),
                iterations: Some(5),
                integrator: Some("rk4".to_owned()),
                sleep: Some(true),
                articulated: Some(false),
            },
            record: None,
            replay: None,
            pictures: None,
            check: None,
        };
        assert_eq!(options, expected);
        assert!(!options.needs_launch_file());
        assert!(run("-a a.yaml -l 1 --world w.yaml --steps 1").needs_launch_file());
    }

    #[test]
    fn wrong_usage_is_refused_by_name() {
        for (line, part) in [
            ("--steps 10", "-l"),
            ("-l 1", "--steps"),
            ("-l 1 --steps -1", "-1"),
            ("-l 1 --steps x", "--steps"),
            ("-l 1,x --steps 1", "\"x\""),
            ("-l , --steps 1", "expected indexes"),
            ("-a , --steps 1", "expected file names"),
            ("-l 1 --steps 1 --foo", "--foo"),
            ("-l 1 --steps 1 word", "word"),
            ("-l 1 --steps 1 --steps 2", "multiple times"),
            ("-l 1 --steps 1 --dt 0", "--dt"),
            ("-l 1 --steps 1 --dt nan", "--dt"),
            ("-l 1 --steps 1 --every 0", "--every"),
            ("-l 1 --step 1", "--step"),
        ] {
            match parse(line) {
                Err(error) => assert!(error.to_string().contains(part), "{line}: {error}"),
                other => panic!("{line} gave {other:?}"),
            }
        }
    }

    #[test]
    fn pictures_have_options_of_their_own() {
        let pictures = |line: &str| run(line).pictures.expect("pictures");
        let options = pictures("-l 1 --steps 1 --render cam --out d");
        let expected = PictureOptions {
            cameras: vec!["cam".into()],
            every: None,
            out: Some("d".into()),
            size: None,
            depth: None,
            ids: false,
            samples: 1,
            video: None,
        };
        assert_eq!(options, expected);
        let options = pictures(
            "-l 1 --steps 1 --render /a/b --render c --every 5 --out d --size 320x200 --render-depth exr --render-ids --render-samples 4 --video v.mp4",
        );
        let expected = PictureOptions {
            cameras: vec!["/a/b".into(), "c".into()],
            every: Some(5),
            out: Some("d".into()),
            size: Some((320, 200)),
            depth: Some("exr".into()),
            ids: true,
            samples: 4,
            video: Some("v.mp4".into()),
        };
        assert_eq!(options, expected);
        for (line, part) in [
            ("--render c", "--out"),
            ("--out d", "--render"),
            ("--video v", "--render"),
            ("--render c --video v --render-ids", "--out"),
            ("--render c --out d --size 640", "640x480"),
            ("--render c --out d --size 0x5", "640x480"),
            ("--render c --out d --size 20000x5", "640x480"),
            ("--render c --out d --render-depth jpg", "npy"),
            ("--render c --out d --render-samples 9", "9"),
            ("--render", "--render"),
        ] {
            match parse(&format!("-l 1 --steps 1 {line}")) {
                Err(error) => assert!(error.to_string().contains(part), "{line}: {error}"),
                other => panic!("{line} gave {other:?}"),
            }
        }
    }

    #[test]
    fn recordings_are_written_and_replayed() {
        assert_eq!(run("-l 1 --steps 1 --record a.mcap").record, Some("a.mcap".into()));
        let replay = |line: &str| run(line).replay.expect("a replay");
        let expected = ReplayOptions { file: "a.mcap".into(), continue_at: None, changed_files: false, steps: None };
        assert_eq!(replay("--replay a.mcap"), expected);
        let expected = ReplayOptions { continue_at: Some(2.5), changed_files: true, steps: Some(7), ..expected };
        let line = "--replay a.mcap --continue-at 2.5 --steps 7 --commands c --changed-files";
        assert_eq!(replay(line), expected);
        for (line, part) in [
            ("--replay a -l 1", "cannot be used"),
            ("--replay a --world w", "--world"),
            ("--replay a --profile legacy", "physics"),
            ("--replay a --continue-at 1", "--steps"),
            ("--replay a --commands c", "--continue-at"),
            ("-l 1 --steps 1 --continue-at 1", "--replay"),
        ] {
            let error = parse(line).expect_err(line).to_string();
            assert!(error.contains(part), "{line}: {error}");
        }
    }

    #[test]
    fn check_takes_files_or_models() {
        let check = |line| run(line).check.expect("a check");
        let options = check("--check a.yaml b.yaml --json");
        assert_eq!(options.files, ["a.yaml", "b.yaml"].map(PathBuf::from));
        assert_eq!((options.together, options.json), (None, true));
        let options = check("--check -a a.yaml,b.yaml -l 1 --world w.yaml --launch_file l.yaml");
        assert_eq!(options.together, Some((["a.yaml", "b.yaml"].map(PathBuf::from).to_vec(), vec![1])));
        assert_eq!((options.world, options.launch_file), (Some("w.yaml".into()), "l.yaml".into()));
        assert_eq!(check("--check --launch_file l.yaml").files, [PathBuf::from("l.yaml")]);
        assert!(run("-l 1 --steps 1").check.is_none());
    }

    #[test]
    fn help_is_a_text() {
        match parse("--help") {
            Ok(Parsed::Print(text)) => assert!(text.contains("--trace") && text.contains("Exit status"), "{text}"),
            other => panic!("{other:?}"),
        }
    }
}
