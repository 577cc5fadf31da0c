//! Recordings from any bytes: as a file, as the entries of a whole file, and as what a simulation does of them.
#![no_main]

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{Entry, Replayer, Simulation, Unpacker, DEFAULT_SUB_STEP};
use ambf_recording::Recording;
use libfuzzer_sys::fuzz_target;

thread_local! {
    /// A place for files, in memory where `TMPDIR` is.
    static FILE: PathBuf = std::env::temp_dir().join(format!("recording.{}.mcap", std::process::id()));
    /// Bytes of a recording without entries.
    static EMPTY: RefCell<BTreeMap<String, String>> = RefCell::new(header());
}

fn files() -> SceneFiles {
    let model = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../resources/models/pendulum.yaml"));
    SceneFiles { world: None, models: vec![model.into()] }
}

fn simulation() -> Simulation {
    let loaded = load(&files(), &SceneOptions { savable: true, ..SceneOptions::default() });
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Simulation::new(loaded.scene, DEFAULT_SUB_STEP)
}

/// What a recording of the simulation says at its head.
fn header() -> BTreeMap<String, String> {
    let path = FILE.with(PathBuf::clone);
    let _ = std::fs::remove_file(&path);
    let mut simulation = simulation();
    let writer = ambf_recording::Writer::start(&path, &mut simulation, "fuzz", true).expect("at the start");
    simulation.stop_recording();
    assert_eq!(writer.finish().problem, None);
    let bytes = std::fs::read(&path).expect("written");
    let mut records = mcap::read::LinearReader::new(&bytes).expect("MCAP").map(|record| record.expect("whole"));
    let found = records.find_map(|record| match record {
        mcap::records::Record::Metadata(found) if found.name == "ambf.recording" => Some(found.metadata),
        _ => None,
    });
    found.expect("a header")
}

/// A whole file, whose only message is `entries`.
fn file(entries: &[u8]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = mcap::Writer::new(&mut bytes).expect("memory");
    let metadata = EMPTY.with_borrow(BTreeMap::clone);
    writer.write_metadata(&mcap::records::Metadata { name: "ambf.recording".into(), metadata }).expect("memory");
    let channel_id = writer.add_channel(0, "/ambf/recording", "ambf", &BTreeMap::new()).expect("memory");
    let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
    writer.write_to_known_channel(&header, entries).expect("memory");
    writer.finish().expect("memory");
    drop(writer);
    bytes.into_inner()
}

/// Reads a file to its end, or as far as it goes; how many entries were read.
fn read(bytes: &[u8]) -> usize {
    FILE.with(|path| {
        std::fs::write(path, bytes).expect("written");
        let mut recording = match Recording::open(path) {
            Ok(recording) => recording,
            Err(error) => {
                assert!(error.to_string().len() < 2000, "{error}");
                return 0;
            }
        };
        let mut count = 0;
        loop {
            match recording.next_entry() {
                Ok(Some(_)) => count += 1,
                Ok(None) => return count,
                Err(error) => {
                    assert!(error.to_string().len() < 2000, "{error}");
                    return count;
                }
            }
        }
    })
}

/// What may be done of an entry here: nothing that opens files, no more than a second of motion, and no more than some
/// thousand voxels.
fn is_modest(entry: &Entry<'_>) -> bool {
    match entry {
        Entry::Update { interval, .. } => !(*interval > 0.1),
        Entry::AddModel { .. } | Entry::Device { .. } => false,
        _ => true,
    }
}

fuzz_target!(|data: &[u8]| {
    read(data);
    let whole = read(&file(data));
    let mut rest = data;
    let (mut unpacker, mut entries) = (Unpacker::default(), Vec::new());
    while let Some((length, behind)) = rest.split_first_chunk::<4>() {
        let Some((bytes, behind)) = behind.split_at_checked(u32::from_le_bytes(*length) as usize) else { break };
        let Ok(entry) = unpacker.unpack(bytes) else { break };
        // What was read is written as it was, and read again.
        let mut written = Vec::new();
        entry.write(&mut written);
        let again = Entry::read(&written).expect("it was written");
        assert_eq!(format!("{again:?}"), format!("{entry:?}"));
        entries.push(entry);
        rest = behind;
    }
    assert_eq!(whole, entries.len(), "a file holds the same entries");
    if !entries.iter().all(is_modest) || entries.len() > 200 {
        return;
    }
    let restored = entries.iter().filter_map(|entry| match entry {
        Entry::Restore { position, .. } => Some(*position),
        _ => None,
    });
    let (mut replayer, mut simulation) = (Replayer::new(restored), simulation());
    for entry in &entries {
        if let Err(error) = replayer.apply(&mut simulation, entry) {
            assert!(error.to_string().len() < 4000, "{error}");
            break;
        }
    }
});
