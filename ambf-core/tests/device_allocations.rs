//! After the start, neither the loops of devices nor the physics thread that drives their end-effectors allocate.

mod device_common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use ambf_core::control::Profile;
use ambf_core::sim::{Runner, RunnerOptions};
use device_common::{coupled, puppets, until, Folder, BOXES, GRIPPER};
use nalgebra::UnitQuaternion;

/// Counts what any thread allocates while it is armed. Bullet's own allocations are not seen.
struct Counting;

static ARMED: AtomicBool = AtomicBool::new(false);
static COUNT: AtomicU64 = AtomicU64::new(0);

// SAFETY: everything is done by the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if ARMED.load(Ordering::Relaxed) {
            COUNT.fetch_add(1, Ordering::Relaxed);
        }
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

/// Allocations of all threads in half a second.
fn allocations() -> u64 {
    COUNT.store(0, Ordering::Relaxed);
    ARMED.store(true, Ordering::Relaxed);
    std::thread::sleep(Duration::from_millis(500));
    ARMED.store(false, Ordering::Relaxed);
    COUNT.load(Ordering::Relaxed)
}

// One test only: what another one allocates would count.
#[test]
fn nothing_is_allocated_per_tick() {
    ARMED.store(true, Ordering::Relaxed);
    drop(std::hint::black_box(Box::new(1)));
    assert!(COUNT.load(Ordering::Relaxed) > 0, "the counter counts");
    for profile in [Profile::Legacy, Profile::Accurate] {
        let folder = Folder::new();
        folder.write("gripper.yaml", GRIPPER);
        let text = "input devices: [A, B]\n\
            A: {hardware name: Puppet, simulated multibody: gripper.yaml, haptic gain: {linear: 10, angular: 1}, \
              enable on button: false, button mapping: {a1: 1, a2: 2}}\n\
            B: {hardware name: Puppet, root link: BODY left, button mapping: {a1: 1}}\n";
        let (puppets, drivers) = puppets(&["one", "two"]);
        let mut simulation = folder.simulation(&[BOXES], profile);
        let host = coupled(&folder.entries(text), &drivers, true, &mut simulation);
        let hub = simulation.connect();
        hub.set_listening();
        let options = RunnerOptions { frequency: 1000.0, fixed_step: false, speed_factor: 1.0 };
        let runner = Runner::start(simulation, options);
        until("both run", || puppets.iter().all(|puppet| puppet.reads() > 1000));
        // A hand that moves, presses, opens and closes.
        for (k, buttons) in [0, 0b10, 0b100, 0].into_iter().enumerate() {
            for puppet in &puppets {
                puppet.set(|pose| {
                    pose.position.z += 0.02;
                    pose.rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.1 * k as f64);
                    pose.gripper = Some(0.25 * k as f64);
                    pose.buttons = buttons;
                });
            }
            assert_eq!(allocations(), 0, "{profile:?}, buttons {buttons:b}");
        }
        let reads: Vec<_> = puppets.iter().map(|puppet| puppet.reads()).collect();
        assert!(reads.iter().all(|&reads| reads > 1500), "{reads:?}");
        drop(host);
        drop(runner);
    }
}
