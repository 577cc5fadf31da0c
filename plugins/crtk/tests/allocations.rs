//! After the start the physics thread allocates nothing for the arms, whatever they are told to do.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use common::{Bench, PROFILES};
use crtk::arm::JointMessage;
use crtk::messages::{Header, Message};
use nalgebra::{Isometry3, Vector6};

/// Counts what a thread allocates while it is armed. Bullet's own allocations are not seen.
struct Counting;

thread_local! {
    static ARMED: Cell<bool> = const { Cell::new(false) };
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: everything is done by the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if ARMED.get() {
            COUNT.set(COUNT.get() + 1);
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

/// Allocations of this thread while it does something.
fn allocations(work: impl FnOnce()) -> u64 {
    COUNT.set(0);
    ARMED.set(true);
    work();
    ARMED.set(false);
    COUNT.get()
}

#[test]
fn nothing_is_allocated_per_step() {
    assert!(allocations(|| drop(std::hint::black_box(Box::new(1)))) > 0, "the counter counts");
    let joints = |position: &[f64], velocity: &[f64], effort: &[f64]| {
        let list = |values: &[f64]| values.to_vec();
        let (position, velocity, effort) = (list(position), list(velocity), list(effort));
        Message::Joints(Header::default(), JointMessage { names: Vec::new(), position, velocity, effort }).encode()
    };
    let away = [0.2, 0.1, 0.14, 0.3, 0.2, -0.1];
    let text = |text: &str| Message::StampedText(Header::default(), text.into()).encode();
    let wrench = Message::Wrench(Header::default(), Vector6::new(0.0, 0.0, 0.1, 0.0, 0.0, 0.0)).encode();
    let twist = Message::Twist(Header::default(), Vector6::new(0.0, 0.0, 0.01, 0.0, 0.0, 0.0)).encode();
    let far = Message::Pose(Header::default(), Isometry3::translation(5.0, 0.0, 0.0)).encode();
    let commands = [
        ("servo_jp", joints(&away, &[], &[])),
        ("move_jp", joints(&[0.0, 0.0, 0.12, 0.0, 0.0, 0.0], &[], &[])),
        ("move_cp", far),
        ("servo_jv", joints(&[], &[0.1; 6], &[])),
        ("servo_cv", twist),
        ("servo_jf", joints(&[], &[], &[0.001; 6])),
        ("body/servo_cf", wrench),
        ("free", Vec::new()),
        ("hold", Vec::new()),
        ("jaw/move_jp", joints(&[0.5], &[], &[])),
        ("jaw/servo_jf", joints(&[], &[], &[0.01])),
        ("state_command", text("pause")),
        ("state_command", text("enable")),
        ("trajectory_j/set_ratio", Message::Number(0.5).encode()),
        ("set_base_frame", Message::Pose(Header { stamp: 0, frame: "camera".into() }, Isometry3::identity()).encode()),
        ("emulate_tool_present", Message::Bool(true).encode()),
        ("set_tool_type", Message::Text("400006".into()).encode()),
    ];
    for profile in PROFILES {
        let mut bench = Bench::psm(profile);
        bench.run(1.0);
        // In the first round the solver meets each number of rows for the first time, and contacts differ from round to
        // round: what a command makes the arm allocate would be there in each.
        let mut least = [u64::MAX; 17];
        for _ in 0..4 {
            for ((name, message), least) in commands.iter().zip(&mut least) {
                bench.topics.send(&format!("/PSM1/{name}"), message);
                *least = allocations(|| bench.run(0.05)).min(*least);
            }
        }
        assert_eq!(least, [0; 17], "{profile:?}");
    }
}
