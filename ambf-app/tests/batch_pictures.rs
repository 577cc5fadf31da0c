//! Pictures of `ambf_batch`: files, what is in them, and that they change nothing of the physics.
#![cfg(feature = "pictures")]

mod batch_common;

use std::path::Path;
use std::process::Command;

use batch_common::{close, resources, Folder};

/// A red box of 0.4 m that falls, with two cameras 2 m away that look along −x and along +x.
const BOX: &str = "bodies: [BODY Box]\nBODY Box: {name: Box, mass: 1, collision shape: Box, collision geometry: {x: 0.4, y: 0.4, z: 0.4}, \
                   geometry: {x: 0.4, y: 0.4, z: 0.4}, shape: Box, color rgba: {r: 1, g: 0, b: 0, a: 1}}\n";
const WORLD: &str = "namespace: /w/\ngravity: {x: 0, y: 0, z: -10}\ncameras: [front, back]\nlights: [sun]\n\
                     front: {name: front, location: {x: 2, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}, up: {x: 0, y: 0, z: 1}, \
                     clipping plane: {near: 0.1, far: 20}, field view angle: 0.8, publish image: true, \
                     publish image resolution: {width: 64, height: 48}}\n\
                     back: {name: back, location: {x: -2, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}, up: {x: 0, y: 0, z: 1}, \
                     clipping plane: {near: 0.1, far: 20}, orthographic view width: 2}\n\
                     sun: {name: sun, location: {x: 3, y: 1, z: 3}, direction: {x: -1, y: -0.3, z: -1}}\n";

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("box.yaml", BOX);
    folder.write("world.yaml", WORLD);
    folder
}

/// (width, height, values) of a NumPy file of 4 byte numbers.
fn array<T>(file: &Path, kind: &str, number: impl Fn([u8; 4]) -> T) -> (usize, usize, Vec<T>) {
    let bytes = std::fs::read(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let text = std::str::from_utf8(&bytes[10..header]).expect("text");
    assert!(text.contains(kind), "{text}");
    let (_, shape) = text.split_once("'shape': (").expect("a shape");
    let mut sizes = shape.split(',').map_while(|size| size.trim().parse().ok());
    let (height, width) = (sizes.next().expect("a height"), sizes.next().expect("a width"));
    let values = bytes[header..].as_chunks::<4>().0.iter().map(|bytes| number(*bytes)).collect();
    (width, height, values)
}

fn depths(file: &Path) -> (usize, usize, Vec<f32>) {
    array(file, "<f4", f32::from_le_bytes)
}

fn bytes_of(folder: &Folder, name: &str) -> Vec<u8> {
    std::fs::read(folder.path().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Size of a PNG file.
fn size(png: &[u8]) -> (u32, u32) {
    assert_eq!(png[..8], *b"\x89PNG\r\n\x1a\n");
    let number = |place: usize| u32::from_be_bytes(std::array::from_fn(|i| png[place + i]));
    (number(16), number(20))
}

#[test]
fn each_picture_is_a_file_with_a_line_in_the_list() {
    let folder = folder();
    folder.succeed("-a box.yaml --world world.yaml --steps 100 --render front --render /w/back --out out/p --render-depth npy --render-ids");
    let list = folder.csv("out/p/pictures.csv");
    // 30 a simulated second are every 33rd step of 1 ms; the last step has none of its own.
    assert_eq!(list.distinct("sim_step"), ["0", "33", "66", "99"]);
    assert_eq!(list.lines.len(), 8);
    for line in &list.lines {
        let (name, camera) = (list.text(line, "file"), list.text(line, "camera"));
        let png = bytes_of(&folder, &format!("out/p/{name}"));
        assert_eq!(
            size(&png),
            if camera == "front" { (64, 48) } else { (640, 480) },
            "its published size, else 640x480"
        );
        assert_eq!(list.text(line, "px"), if camera == "front" { "2.0" } else { "-2.0" });
        let fx = list.text(line, "fx");
        match camera {
            // H / (2 tan(φ / 2)).
            "front" => close(fx.parse().expect("a number"), 24.0 / 0.4_f64.tan(), 1e-9),
            _ => assert_eq!(fx, "", "an orthographic camera has no intrinsics"),
        }
    }
    let table = folder.csv("out/p/ids_00000000.csv");
    let (width, height, depth) = depths(&folder.path().join("out/p/front_00000000_depth.npy"));
    let (_, _, ids) = array(&folder.path().join("out/p/front_00000000_ids.npy"), "<i4", i32::from_le_bytes);
    assert_eq!((width, height, ids.len()), (64, 48, 64 * 48));
    let middle = 24 * 64 + 32;
    let name = table.lines.iter().find(|line| line[0] == ids[middle].to_string()).expect("in the table")[1].clone();
    assert!(name.ends_with("BODY Box"), "{name}");
    close(f64::from(depth[middle]), 1.8, 1e-3);
    assert_eq!((ids[0], table.lines[0][1].as_str()), (0, ""));
    close(f64::from(depth[0]), 20.0, 1e-2);
    // It has fallen by 5 cm after 0.1 s.
    let (_, _, later) = array(&folder.path().join("out/p/front_00000099_ids.npy"), "<i4", i32::from_le_bytes);
    let top = |ids: &[i32]| ids.iter().position(|&id| id == ids[middle]).expect("seen") / 64;
    let fallen = (top(&later) - top(&ids)) as f64;
    close(fallen, 0.0495 * 24.0 / 0.4_f64.tan() / 1.8, 1.0);
}

#[test]
fn pictures_change_nothing_and_are_the_same_each_time() {
    let folder = folder();
    folder.write("commands.txt", "10|60|WR|Box|3 1 20 0.1 0.2 0.3\n");
    let model = resources().join("models/cloth.yaml");
    let scene = format!("-a box.yaml,{} --world world.yaml --steps 120 --commands commands.txt", model.display());
    folder.succeed(&format!("{scene} --trace without --full"));
    for name in ["first", "second"] {
        let pictures = format!("--render front --every 7 --out {name} --size 80x60 --render-depth png16 --render-ids");
        folder.succeed(&format!("{scene} {pictures}"));
    }
    folder.succeed(&format!(
        "{scene} --trace with --full --every 1 --render front --render back --out third --size 80x60"
    ));
    for file in ["bodies", "softnodes"] {
        let (without, with) = (format!("without_{file}.csv"), format!("with_{file}.csv"));
        assert!(bytes_of(&folder, &without) == bytes_of(&folder, &with), "{file} differ");
    }
    let mut names: Vec<_> = std::fs::read_dir(folder.path().join("first")).expect("a folder").collect();
    names.sort_by_key(|entry| entry.as_ref().expect("an entry").file_name());
    assert_eq!(names.len(), 3 * 18 + 2);
    for name in names {
        let name = name.expect("an entry").file_name().into_string().expect("text");
        let (first, second) = (format!("first/{name}"), format!("second/{name}"));
        assert!(bytes_of(&folder, &first) == bytes_of(&folder, &second), "{name} differs");
    }
    // What moves is seen to move.
    assert_ne!(bytes_of(&folder, "first/front_00000000.png"), bytes_of(&folder, "first/front_00000119.png"));
    assert!(bytes_of(&folder, "first/front_00000063.png") == bytes_of(&folder, "third/front_00000063.png"));
}

#[test]
fn a_scene_without_cameras_has_the_default_one() {
    let folder = Folder::new();
    folder.write("box.yaml", &BOX.replace("mass: 1", "mass: 0, location: {position: {x: -1, y: 0, z: 0}}"));
    folder.write("world.yaml", "namespace: /w/\n");
    folder.succeed(
        "-a box.yaml --world world.yaml --steps 0 --render default_camera --out . --size 20x10 --render-depth npy",
    );
    let (width, height, depth) = depths(&folder.path().join("default_camera_00000000_depth.npy"));
    assert_eq!((width, height), (20, 10));
    close(f64::from(depth[5 * 20 + 10]), 0.8, 1e-3);
    close(f64::from(depth[0]), 10.0, 1e-2);
}

#[test]
fn other_formats_of_depth() {
    let folder = folder();
    for (format, extension) in [("exr", "exr"), ("png16", "png")] {
        let line = format!("--render front --out {format} --render-depth {format} --render-samples 4");
        folder.succeed(&format!("-a box.yaml --world world.yaml --steps 0 {line}"));
        let bytes = bytes_of(&folder, &format!("{format}/front_00000000_depth.{extension}"));
        if format == "exr" {
            let middle = bytes.len() - 24 * (8 + 4 * 64) + 8 + 4 * 32;
            let depth = f32::from_le_bytes(std::array::from_fn(|i| bytes[middle + i]));
            close(f64::from(depth), 1.8, 1e-3);
        } else {
            assert_eq!((size(&bytes), bytes[24]), ((64, 48), 16), "16 bits a pixel");
        }
    }
}

#[test]
fn what_is_asked_for_in_vain_is_named() {
    let folder = folder();
    let run = |line: &str| folder.run(&format!("-a box.yaml --world world.yaml --steps 3 {line}"));
    let ran = run("--render middle --out p");
    assert_eq!(ran.status, 1, "{ran:?}");
    assert!(ran.stderr.contains("no camera `middle`; the scene has /w/front, /w/back"), "{ran:?}");
    assert!(!folder.exists("p"), "nothing is written");
    let ran = run("--render front --render /w/front --out p");
    assert_eq!(ran.status, 1, "{ran:?}");
    assert!(ran.stderr.contains("given twice"), "{ran:?}");
    folder.write("file", "");
    let ran = run("--render front --out file/p");
    assert_eq!(ran.status, 2, "{ran:?}");
    assert!(ran.stderr.contains("file/p"), "{ran:?}");
}

#[test]
fn videos_are_made_in_real_time() {
    let folder = folder();
    let line = "-a box.yaml --world world.yaml --steps 100 --every 10 --render front --render back --size 65x49 --video v/run.mp4";
    let ran = folder.run(line);
    if ran.stderr.contains("ffmpeg cannot be started") {
        return eprintln!("SKIPPED: there is no ffmpeg on this machine");
    }
    assert_eq!(ran.status, 0, "{ran:?}");
    for name in ["v/run_front.mp4", "v/run_back.mp4"] {
        let probe = Command::new("ffprobe")
            .args(["-v", "error", "-count_frames", "-show_entries", "stream=width,height,nb_read_frames,r_frame_rate"])
            .args(["-of", "csv=p=0"])
            .arg(folder.path().join(name))
            .output()
            .expect("ffprobe comes with ffmpeg");
        assert_eq!(String::from_utf8_lossy(&probe.stdout).trim(), "66,50,100/1,11", "{name}: {probe:?}");
    }
    assert!(!folder.exists("pictures.csv") && !folder.exists("front_00000000.png"));
    let first = bytes_of(&folder, "v/run_front.mp4");
    folder.succeed(line);
    assert!(first == bytes_of(&folder, "v/run_front.mp4"), "the same bytes each time");
    let ran = folder.run(&line.replace("run.mp4", "run.nonsense"));
    assert_eq!(ran.status, 2, "{ran:?}");
    // Whichever of the two ends first is named.
    assert!(ran.stderr.contains(".nonsense"), "{ran:?}");
}

#[test]
fn without_ffmpeg_there_is_advice() {
    let folder = folder();
    let output = Command::new(env!("CARGO_BIN_EXE_ambf_batch"))
        .args("-a box.yaml --world world.yaml --steps 3 --render front --video v.mp4".split(' '))
        .current_dir(folder.path())
        .env("PATH", "/nothing")
        .output()
        .expect("ambf_batch runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("apt install ffmpeg"), "{said}");
}

#[test]
fn pictures_and_videos_that_do_not_fit_are_said_and_none_is_left_half() {
    let folder = folder();
    let run = |blocks: u32, line: &str| {
        let limited = format!("trap '' XFSZ && ulimit -f {blocks} && exec \"$0\" \"$@\"");
        folder.run_in_shell(&limited, &format!("-a box.yaml --world world.yaml --steps 3 {line}"))
    };
    let ran = run(2, "--render front --out p --size 320x240 --render-depth npy");
    assert_eq!(ran.status, 2, "{ran:?}");
    assert!(ran.stderr.contains("p/front_00000000.png cannot be written: File too large"), "{ran:?}");
    let left: Vec<_> = std::fs::read_dir(folder.path().join("p")).expect("a folder").collect();
    assert_eq!(left.len(), 1, "the list: {left:?}");
    // The frames fit, the index behind them does not: ffmpeg 5.1 ends with status 0 then.
    let ran = run(3, "--render front --video v.mp4 --size 320x240 --every 1");
    if ran.stderr.contains("ffmpeg cannot be started") {
        return eprintln!("SKIPPED: there is no ffmpeg on this machine");
    }
    assert_eq!(ran.status, 2, "{ran:?}");
    assert!(ran.stderr.contains("v.mp4 cannot be written") && !ran.stderr.contains("unfinished"), "{ran:?}");
    assert_eq!(folder.names(), ["box.yaml", "p", "world.yaml"]);
}
