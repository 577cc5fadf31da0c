//! Files that are no recordings, or no whole ones, are refused or read as far as they go.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use ambf_core::comm::RigidBodyCommand;
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{Entry, Simulation};
use ambf_recording::{Header, Recording, RecordingError, Writer};
use nalgebra::Vector3;

/// A recording of so many updates, in a folder.
fn recorded(folder: &Path, updates: u32) -> PathBuf {
    let file = folder.join("whole.mcap");
    let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
    let files = SceneFiles { world: None, models: vec![resources.join("models/pendulum.yaml")] };
    let mut simulation = Simulation::new(load(&files, &SceneOptions::default()).scene, 0.001);
    let writer = Writer::start(&file, &mut simulation, "test", true).expect("at the start");
    let body = simulation.scene().bodies.ids().last().expect("a body");
    for update in 0..updates {
        // Numbers that no compression makes small.
        simulation.apply_wrench(body, 0.1 * Vector3::repeat(f64::from(update).sin()), Vector3::zeros());
        simulation.iterate(0.001).expect("sound");
    }
    simulation.annotate("the end");
    simulation.stop_recording();
    assert_eq!(writer.finish().problem, None);
    file
}

fn updates(recording: &mut Recording) -> Result<u32, RecordingError> {
    let mut count = 0;
    while let Some(timed) = recording.next_entry()? {
        count += u32::from(matches!(timed.entry, Entry::Update { .. }));
    }
    Ok(count)
}

#[test]
fn only_who_asks_for_a_start_at_once_gets_folders() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut simulation = Simulation::new(load(&SceneFiles::default(), &SceneOptions::default()).scene, 0.001);
    let header = Header::of(&simulation, "test").expect("no file is needed");
    let file = folder.path().join("new/a.mcap");
    let error = Writer::create(&file, &header, true).map(drop).expect_err("there is no such folder");
    assert!(error.to_string().contains("new/a.mcap: No such file"), "{error}");
    assert!(!folder.path().join("new").exists());
    drop(Writer::start(&file, &mut simulation, "test", true).expect("at the start"));
    assert!(file.exists());
}

#[test]
fn a_file_that_was_cut_off_is_read_up_to_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = std::fs::read(recorded(folder.path(), 20_000)).expect("written");
    let cut = folder.path().join("cut.mcap");
    let (mut before, mut complete) = (0, 0);
    for parts in 0..=40 {
        let length = whole.len() * parts / 40;
        std::fs::write(&cut, &whole[..length]).expect("written");
        let Ok(mut recording) = Recording::open(&cut) else {
            assert_eq!(before, 0, "{length} bytes");
            continue;
        };
        let found = updates(&mut recording).unwrap_or_else(|error| panic!("{length} bytes: {error}"));
        assert!(found >= before, "{length} bytes");
        before = found;
        complete += u32::from(recording.end() == Some("stopped"));
    }
    assert_eq!(before, 20_000);
    assert!((1..5).contains(&complete), "only what is whole says so");
}

#[test]
fn damage_is_named_and_nothing_wrong_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = std::fs::read(recorded(folder.path(), 3000)).expect("written");
    let file = folder.path().join("damaged.mcap");
    let mut found = 0;
    for place in (8..whole.len()).step_by(whole.len() / 150) {
        let mut damaged = whole.clone();
        damaged[place] ^= 0x55;
        std::fs::write(&file, &damaged).expect("written");
        match Recording::open(&file).and_then(|mut recording| updates(&mut recording)) {
            // In what is not read, such as an index or a text beside it; or a length that reaches beyond the end.
            Ok(updates) => assert!(updates <= 3000, "byte {place}"),
            Err(error) => {
                found += 1;
                assert!(error.to_string().len() > 20, "byte {place}: {error}");
            }
        }
    }
    assert!(found > 50, "{found}");
}

#[test]
fn other_files_are_refused_by_what_they_are() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.mcap");
    let refused = || Recording::open(&file).err().expect("no recording").to_string();
    assert!(refused().contains("No such file"), "{}", refused());
    for text in ["", "bodies: [a]\n", "\u{89}MCAP0\r\n"] {
        std::fs::write(&file, text).expect("written");
        assert!(refused().contains("is no recording of AMBF"), "{text:?}: {}", refused());
    }
    // MCAP of somebody else.
    let mut writer = mcap::Writer::new(std::fs::File::create(&file).expect("made")).expect("written");
    writer.add_channel(0, "/other", "json", &Default::default()).expect("written");
    writer.finish().expect("written");
    drop(writer);
    assert!(refused().contains("before its header"), "{}", refused());
    std::fs::remove_file(&file).expect("it is there");
    // A later version.
    let mut writer = mcap::Writer::new(std::fs::File::create(&file).expect("made")).expect("written");
    let metadata = [("format".to_owned(), "2".to_owned())].into();
    writer.write_metadata(&mcap::records::Metadata { name: "ambf.recording".into(), metadata }).expect("written");
    writer.finish().expect("written");
    drop(writer);
    assert!(refused().contains("later version"), "{}", refused());
}

/// A message of 20 MB that stands for 8 TB.
#[test]
fn repetitions_take_memory_one_by_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = std::fs::read(recorded(folder.path(), 10)).expect("written");
    let records = mcap::read::LinearReader::new(&whole).expect("MCAP");
    let header = records.map(|record| record.expect("whole")).find_map(|record| match record {
        mcap::records::Record::Metadata(metadata) if metadata.name == "ambf.recording" => Some(metadata),
        _ => None,
    });
    let mut message = Vec::new();
    let mut add = |entry: &Entry<'_>| {
        let mut bytes = Vec::new();
        entry.write(&mut bytes);
        message.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
        message.extend_from_slice(&bytes);
    };
    let command = RigidBodyCommand { joint_commands: vec![1.0; 1_000_000], ..RigidBodyCommand::default() };
    let large = Entry::Body { body: 0, command: Cow::Owned(command) };
    add(&large);
    (0..1_000_000).for_each(|_| add(&Entry::Same { kind: 4, object: 0 }));
    let file = folder.path().join("a.mcap");
    let mut writer = mcap::Writer::new(std::fs::File::create(&file).expect("made")).expect("written");
    writer.write_metadata(&header.expect("a header")).expect("written");
    let channel_id = writer.add_channel(0, "/ambf/recording", "ambf", &Default::default()).expect("written");
    let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
    writer.write_to_known_channel(&header, &message).expect("written");
    writer.finish().expect("written");
    drop(writer);
    let mut recording = Recording::open(&file).expect("a recording");
    for _ in 0..3 {
        assert!(recording.next_entry().expect("whole").is_some_and(|timed| timed.entry == large));
    }
}

#[test]
fn a_recording_names_its_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = Recording::open(&recorded(folder.path(), 10)).expect("whole");
    let Header { used, files, .. } = recording.header();
    assert!(files.models[0].is_absolute());
    assert!(used.iter().any(|file| file.path.ends_with("pendulum.yaml") && file.sha256.len() == 64), "{used:?}");
    assert_eq!(recording.header().changed_files(), Vec::<String>::new());
}

#[test]
fn files_that_a_description_includes_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let (model, included) = (folder.path().join("a.xml"), folder.path().join("b.xml"));
    std::fs::write(&model, "<mujoco><include file='b.xml'/></mujoco>").expect("written");
    let text =
        "<mujocoinclude><worldbody><body name='a'><freejoint/><geom size='0.1'/></body></worldbody></mujocoinclude>";
    std::fs::write(&included, text).expect("written");
    let files = SceneFiles { world: None, models: vec![model] };
    let loaded = load(&files, &SceneOptions::default());
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    let header = Header::of(&Simulation::new(loaded.scene, 0.001), "test").expect("readable");
    std::fs::write(&included, text.replace("0.1", "0.2")).expect("written");
    let changed = header.changed_files();
    assert!(changed.len() == 1 && changed[0].contains("b.xml: has changed"), "{changed:?}");
}
