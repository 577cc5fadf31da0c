//! Pictures of the C++ program beside ours, at the same poses.

mod render_common;

use ambf_render::{PictureRequest, Renderer};
use render_common::{keep, legacy, shared, Shown};

/// How two pictures compare.
#[derive(Debug)]
struct Comparison {
    /// Pixels of something in both / in either.
    overlap: f64,
    /// Mean difference of the pixels that show something in both, levels.
    mean: f64,
    /// Part of these that differ by more than 30 levels.
    far: f64,
}

fn compare(ours: &[u8], theirs: &[u8]) -> Comparison {
    let is_something = |pixel: &[u8]| pixel.iter().any(|&level| level < 250);
    let (mut both, mut either, mut sum, mut far) = (0, 0, 0.0, 0);
    for (a, b) in ours.chunks_exact(3).zip(theirs.chunks_exact(3)) {
        let (seen_a, seen_b) = (is_something(a), is_something(b));
        either += usize::from(seen_a || seen_b);
        if seen_a && seen_b {
            both += 1;
            let difference = a.iter().zip(b).map(|(&a, &b)| f64::from(a.abs_diff(b))).fold(0.0, f64::max);
            sum += difference;
            far += usize::from(difference > 30.0);
        }
    }
    let both_or_one = both.max(1) as f64;
    Comparison { overlap: both as f64 / either.max(1) as f64, mean: sum / both_or_one, far: far as f64 / both_or_one }
}

fn check(name: &str, index: usize, overlap: f64, mean: f64) {
    let (Some(shared), Some(legacy)) = (shared(), legacy()) else { return };
    let mut renderer = Renderer::offscreen().expect("a renderer");
    let mut shown = Shown::of_launch(&legacy.join("descriptions/launch.yaml"), &[index]);
    shown.pose(&shared.join(format!("pictures/{name}_poses.csv")));
    let camera = shown.camera("default_camera");
    let picture = shown.picture(&mut renderer, camera, &PictureRequest::color(640, 480));
    keep(&picture, &format!("{name}.png"));
    let theirs = image::open(shared.join(format!("pictures/{name}.png"))).expect("a picture").to_rgb8();
    let comparison = compare(&picture.color, theirs.as_raw());
    eprintln!("{name}: {comparison:?}, {:?}", picture.messages);
    assert!(comparison.overlap >= overlap, "{name}: {comparison:?}");
    assert!(comparison.mean <= mean, "{name}: {comparison:?}");
}

#[test]
fn puzzle() {
    check("puzzle1", 11, 0.99, 6.0);
}

#[test]
fn car() {
    check("toycar2", 1, 0.99, 6.0);
}

#[test]
fn arm() {
    check("psm", 5, 0.99, 6.0);
}

#[test]
fn industrial_arm() {
    check("kuka", 8, 0.99, 6.0);
}
