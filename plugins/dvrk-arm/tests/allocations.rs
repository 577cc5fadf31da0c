//! What the haptic loop calls does not allocate, whatever the threads that talk ROS do.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use ambf_device::DeviceForce;
use common::*;
use fake_dvrk::{Curve, Fake, FakeOptions, Motion};
use nalgebra::{UnitQuaternion, Vector3};

/// Counts for each thread by itself.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: all is left to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_thousand_ticks_allocate_nothing() {
    share_master();
    let motion = Motion::Curve(Curve::default(), UnitQuaternion::identity());
    let arms = vec!["MTMR".into()];
    let fake = Fake::start(FakeOptions { arms, rate: 500.0, motion, ..Default::default() }).unwrap();
    let mut device = Device::open("MTMR", &[]);
    device.wait_valid();
    device.wait_felt(&fake, "MTMR", Vector3::x());
    let (first, before) = (device.read().sequence, ALLOCATIONS.get());
    assert!(before > 0, "the counter counts");
    device.ticks(Vector3::new(0.0, 0.5, 0.0), 1000);
    device.device.write(&DeviceForce::zero()).unwrap();
    assert_eq!(ALLOCATIONS.get() - before, 0);
    assert!(device.read().sequence > first + 100, "poses came meanwhile");
}
