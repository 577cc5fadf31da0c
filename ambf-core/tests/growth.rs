//! Loading a scene and dropping it takes time and memory in proportion to what its files say, in both profiles, wherever the
//! bodies are and however they are joined: four times as much for a file of four times the length.

use std::alloc::{GlobalAlloc, Layout, System};
use std::fmt::Write as _;
use std::sync::atomic::{AtomicU64, Ordering};

use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use rustix::time::{clock_gettime, ClockId};

/// Counts the bytes that are allocated. Bullet's own allocations are not seen.
struct Counting;

static BYTES: AtomicU64 = AtomicU64::new(0);

// SAFETY: everything is done by the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        BYTES.fetch_add(layout.size() as u64, Ordering::Relaxed);
        // SAFETY: the caller keeps the rules of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the rules of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A robot description: for each joint the links that it joins and where it is, m.
fn urdf(links: usize, joints: impl Iterator<Item = (usize, usize, f64)>) -> String {
    let mut text = String::from("<robot name=\"r\">");
    for link in 0..links {
        let _ = write!(
            text,
            "<link name=\"l{link}\"><inertial><mass value=\"1\"/><inertia ixx=\"1\" ixy=\"0\" ixz=\"0\" iyy=\"1\" iyz=\"0\" \
             izz=\"1\"/></inertial></link>"
        );
    }
    for (joint, (parent, child, x)) in joints.enumerate() {
        let _ = write!(
            text,
            "<joint name=\"j{joint}\" type=\"continuous\"><parent link=\"l{parent}\"/><child link=\"l{child}\"/><origin \
             xyz=\"{x} 0 0\"/><axis xyz=\"0 0 1\"/></joint>"
        );
    }
    text + "</robot>"
}

/// A model file of boxes in a row, and joints between two of them each, with what they call their parent.
fn adf(bodies: usize, joints: impl Iterator<Item = (String, usize)>) -> String {
    let (mut names, mut text) = (String::new(), String::new());
    for body in 0..bodies {
        let _ = write!(names, "BODY b{body}, ");
        let _ = writeln!(
            text,
            "BODY b{body}: {{name: same, mass: 1, location: {{position: {{x: {}, y: 0, z: 0}}}}, collision shape: Box, \
             collision geometry: {{x: 0.1, y: 0.1, z: 0.1}}}}",
            0.2 * body as f64
        );
    }
    let mut joint_names = String::new();
    for (joint, (parent, child)) in joints.enumerate() {
        let _ = write!(joint_names, "JOINT j{joint}, ");
        let _ = writeln!(
            text,
            "JOINT j{joint}: {{name: j{joint}, parent: {parent}, child: BODY b{child}, type: revolute, parent pivot: {{x: 0.1}}, \
             child pivot: {{x: -0.1}}, parent axis: {{z: 1}}, child axis: {{z: 1}}}}"
        );
    }
    format!("bodies: [{names}]\njoints: [{joint_names}]\n{text}")
}

/// Bytes that are allocated, and seconds of this thread.
fn cost(file: &str, text: &str, profile: Profile) -> [f64; 2] {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(file);
    std::fs::write(&path, text).expect("written");
    let files = SceneFiles { world: None, models: vec![path] };
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let options = SceneOptions { physics, ..SceneOptions::default() };
    let now = || {
        let time = clock_gettime(ClockId::ThreadCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
    };
    let (bytes, begin) = (BYTES.load(Ordering::Relaxed), now());
    drop(load(&files, &options));
    [(BYTES.load(Ordering::Relaxed) - bytes) as f64, now() - begin]
}

// One test only: what another one allocates would count.
#[test]
fn four_times_as_much_costs_about_four_times_as_much() {
    type Make = fn(usize) -> String;
    let kinds: [(&str, &str, Make); 8] = [
        ("star at a point", "r.urdf", |n| urdf(n + 1, (0..n).map(|i| (0, i + 1, 0.0)))),
        ("chain", "r.urdf", |n| urdf(n + 1, (0..n).map(|i| (i, i + 1, 0.1)))),
        ("chain from its end", "r.urdf", |n| urdf(n + 1, (0..n).rev().map(|i| (i, i + 1, 0.1)))),
        ("comb", "r.urdf", |n| urdf(2 * n + 1, (0..2 * n).map(|i| (if i < n { i } else { i - n }, i + 1, 0.1)))),
        ("boxes in a row of one name", "m.yaml", |n| adf(n, std::iter::empty())),
        ("pairs", "m.yaml", |n| adf(2 * n, (0..n).map(|i| (format!("BODY b{}", 2 * i), 2 * i + 1)))),
        ("many joints between two", "m.yaml", |n| adf(2, (0..n).map(|_| (String::from("BODY b0"), 1)))),
        ("parents that are not there", "m.yaml", |n| adf(n + 1, (0..n).map(|i| (format!("nobody{i}"), i)))),
    ];
    // The first scene also makes what all have in common.
    cost("r.urdf", &urdf(2, std::iter::once((0, 1, 0.0))), Profile::Accurate);
    for (name, file, make) in kinds {
        for profile in [Profile::Legacy, Profile::Accurate] {
            let [few, many] = [1000, 4000].map(|n| cost(file, &make(n), profile));
            println!("{name}, {profile:?}: {few:?} {many:?}");
            let [memory, time] = [many[0] / few[0], many[1] / few[1]];
            assert!(memory < 6.0, "{name}, {profile:?}: {memory} times the memory");
            // Twice as much is allowed for what else the machine does; in proportion to the square it would be 16.
            assert!(time < 9.0, "{name}, {profile:?}: {time} times the time");
        }
    }
}
