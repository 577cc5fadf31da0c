//! Pictures of the C++ program beside ours, at the same poses.

mod render_common;

use ambf_render::{PictureRequest, Renderer};
use ambf_test_support::{legacy, shared};
use render_common::{keep, Shown};

/// How two pictures compare.
#[derive(Debug)]
struct Comparison {
    /// Pixels of something in both / in either.
    overlap: f64,
    /// Middle difference of the pixels that show a body of the model, levels.
    bodies: f64,
    /// Part of these that differ by at most 12 levels.
    alike: f64,
}

/// `is_body`: which pixels show a body of the model, and not the floor. The floor of these scenes is two triangles,
/// which the C++ program lights at their corners only; ours is lit at every pixel.
fn compare(ours: &[u8], theirs: &[u8], is_body: impl Fn(usize) -> bool) -> Comparison {
    let is_something = |pixel: &[u8]| pixel.iter().any(|&level| level < 250);
    let (mut both, mut either, mut differences) = (0, 0, Vec::new());
    for (index, (a, b)) in ours.chunks_exact(3).zip(theirs.chunks_exact(3)).enumerate() {
        let (seen_a, seen_b) = (is_something(a) || is_body(index), is_something(b) || is_body(index));
        either += usize::from(seen_a || seen_b);
        both += usize::from(seen_a && seen_b);
        if is_body(index) {
            differences.push(a.iter().zip(b).map(|(&a, &b)| a.abs_diff(b)).max().unwrap_or(0));
        }
    }
    differences.sort_unstable();
    let count = differences.len().max(1) as f64;
    Comparison {
        overlap: both as f64 / either.max(1) as f64,
        bodies: differences.get(differences.len() / 2).copied().unwrap_or(0).into(),
        alike: differences.iter().filter(|&&difference| difference <= 12).count() as f64 / count,
    }
}

fn check(name: &str, index: usize) {
    let (Some(shared), Some(legacy)) = (shared(), legacy()) else { return };
    let mut renderer = Renderer::offscreen().expect("a renderer");
    let mut shown = Shown::of_launch(&legacy.join("descriptions/launch.yaml"), &[index]);
    shown.pose(&shared.join(format!("pictures/{name}_poses.csv")));
    let camera = shown.camera("default_camera");
    let request = PictureRequest { ids: true, ..PictureRequest::color(640, 480) };
    let picture = shown.picture(&mut renderer, camera, &request);
    keep(&picture, &format!("{name}.png"));
    let theirs = image::open(shared.join(format!("pictures/{name}.png"))).expect("a picture").to_rgb8();
    // The environment is model 0.
    let comparison = compare(&picture.color, theirs.as_raw(), |index| picture.ids[index][1] > 1);
    eprintln!("{name}: {comparison:?}, {:?}", picture.messages);
    assert!(comparison.overlap >= 0.99, "{name}: {comparison:?}");
    assert!(comparison.bodies <= 8.0 && comparison.alike >= 0.6, "{name}: {comparison:?}");
}

#[test]
fn puzzle() {
    check("puzzle1", 11);
}

#[test]
fn car() {
    check("toycar2", 1);
}

#[test]
fn arm() {
    check("psm", 5);
}

#[test]
fn industrial_arm() {
    check("kuka", 8);
}

/// Depth of the C++ program's cloud, and the colour of the same picture.
#[test]
fn depth() {
    let Some(shared) = shared() else { return };
    let mut renderer = Renderer::offscreen().expect("a renderer");
    let mut shown = Shown::of_launch(&shared.join("pictures/scenes/launch_depth_box.yaml"), &[0]);
    let camera = shown.camera("cam");
    let request = PictureRequest { depth: true, ..PictureRequest::color(640, 480) };
    let picture = shown.picture(&mut renderer, camera, &request);
    keep(&picture, "depth_box.png");
    let theirs = image::open(shared.join("pictures/depth_box.png")).expect("a picture").to_rgb8();
    // The wall behind is two triangles, too.
    let comparison = compare(&picture.color, theirs.as_raw(), |index| picture.depth[index] < 1.0);
    eprintln!("depth_box: {comparison:?}");
    assert!(comparison.overlap >= 0.99 && comparison.bodies <= 8.0, "{comparison:?}");

    // The cloud, bottom row first, from a NumPy archive: stored or deflated members.
    let script = "import sys, zipfile\n\
        data = zipfile.ZipFile(sys.argv[1]).read('xyz.npy')\n\
        assert b\"'<f4'\" in data[:128] and b'False' in data[:128]\n\
        open(sys.argv[2], 'wb').write(data[-480 * 640 * 3 * 4:])\n";
    let raw = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("depth_box.f32");
    let status = std::process::Command::new("/usr/bin/python3")
        .args(["-c", script])
        .arg(shared.join("pictures/depth_box.npz"))
        .arg(&raw)
        .status();
    assert!(status.is_ok_and(|status| status.success()), "python3 reads the cloud");
    let bytes = std::fs::read(raw).expect("the cloud");
    let (numbers, _) = bytes.as_chunks::<4>();
    let theirs: Vec<f32> = numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let ours = picture.points();
    assert_eq!(theirs.len(), 3 * ours.len());
    let mut off = 0;
    for (ours, theirs) in ours.iter().zip(theirs.chunks_exact(3)) {
        let far = -f64::from(theirs[0]);
        let error = (0..3).map(|i| f64::from((ours[i] - theirs[i]).abs())).fold(0.0, f64::max);
        off += usize::from(error > 1e-3 * far);
    }
    eprintln!("depth: {off} of {} points differ by more than 0.1 %", ours.len());
    // Edges of boxes may fall on either of two pixels.
    assert!(off < ours.len() / 1000, "{off} points");
}

/// Cloth at the poses of its nodes is another matter: the list has rigid bodies only. The scene is drawn as it starts.
#[test]
fn cloth() {
    let Some(legacy) = legacy() else { return };
    let mut renderer = Renderer::offscreen().expect("a renderer");
    let model = legacy.join("descriptions/multi-bodies/sb/cloth.yaml");
    let mut shown = Shown::of_files(Some(&legacy.join("descriptions/world/world.yaml")), &[&model]);
    let camera = shown.camera("default_camera");
    let request = PictureRequest { ids: true, ..PictureRequest::color(640, 480) };
    let picture = shown.picture(&mut renderer, camera, &request);
    keep(&picture, "cloth.png");
    let seen = picture.ids.iter().filter(|id| id[1] > 1).count();
    assert!(seen > 2000, "{seen} pixels show the cloth; {:?}", picture.messages);
}
