//! Every model file of the original's repository is drawn: nothing panics, what can be loaded is seen, what cannot is
//! named.

mod render_common;

use std::path::{Path, PathBuf};

use ambf_core::adf;
use ambf_render::{PictureRequest, Projection, Renderer, View};
use ambf_test_support::legacy;
use nalgebra::{Isometry3, Point3, Translation3};
use render_common::Shown;

fn yaml_files(directory: &Path, found: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(directory).expect("a directory");
    for path in entries.map(|entry| entry.expect("an entry").path()) {
        match path.is_dir() {
            true => yaml_files(&path, found),
            false if path.extension().is_some_and(|extension| extension == "yaml") => found.push(path),
            false => {}
        }
    }
    found.sort();
}

#[test]
fn every_legacy_file_is_drawn() {
    let Some(legacy) = legacy() else { return };
    let mut files = Vec::new();
    yaml_files(&legacy.join("descriptions/multi-bodies"), &mut files);
    let mut renderer = Renderer::offscreen().expect("a renderer");
    let (mut seen, mut empty) = (0, Vec::new());
    for file in &files {
        if adf::load::<adf::Model>(file).is_err() {
            continue;
        }
        let mut shown = Shown::of_files(None, &[file]);
        let messages = renderer.prepare(&mut shown.stage, &shown.visuals, &shown.snapshot);
        for message in &messages {
            assert!(!message.contains("OpenGL"), "{}: {message}", file.display());
        }
        let Some((center, radius)) = shown.stage.bounds() else {
            empty.push(file);
            continue;
        };
        // From outside, so that all is in the picture.
        let eye = center + nalgebra::Vector3::new(1.0, 0.7, 0.6).normalize() * (3.0 * radius);
        let back = (eye - center).normalize();
        let right = nalgebra::Vector3::z().cross(&back).normalize();
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[
            back,
            right,
            back.cross(&right),
        ]));
        let view = View {
            pose: Isometry3::from_parts(Translation3::from(eye - Point3::origin()), rotation.into()),
            near: 0.5 * radius,
            far: 6.0 * radius,
            projection: Projection::Perspective(0.8),
            stereo: None,
        };
        let request = PictureRequest { depth: true, ids: true, ..PictureRequest::color(160, 120) };
        let picture = renderer.render(&mut shown.stage, &view, &request).expect("a picture");
        let shows = picture.ids.iter().filter(|id| id[0] > 0).count();
        assert!(shows > 0, "{}: nothing is seen; {messages:?}", file.display());
        assert!(picture.depth.iter().all(|depth| depth.is_finite()), "{}", file.display());
        seen += 1;
    }
    eprintln!("{seen} files are seen; nothing to draw in {empty:?}");
    assert!(seen >= 55, "{seen} of {}", files.len());
}
