//! What the haptic loop calls does not allocate.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::{Duration, Instant};

use ambf_device::{DeviceForce, DeviceLog, Driver, Setting, Settings};
use falcon::MODEL;
use nalgebra::Vector3;

/// Counts for each thread by itself: the fakes have theirs.
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
    let driver = fake_falcon::driver();
    let fake = Setting { value: "fake".into(), place: String::new() };
    let settings = Settings::new([("transport".to_owned(), fake)].into(), ".".into());
    let info = driver.find(MODEL, &settings).unwrap().remove(0);
    let mut device = driver.open(&info, &settings, &DeviceLog::new().0).unwrap();
    let begin = Instant::now();
    while !device.read().unwrap().valid {
        assert!(begin.elapsed() < Duration::from_secs(60), "it does not home");
        std::thread::sleep(Duration::from_millis(5));
    }
    let (first, before) = (device.read().unwrap().sequence, ALLOCATIONS.get());
    assert!(before > 0, "the counter counts");
    for tick in 0..1000 {
        device.read().unwrap();
        let force = Vector3::new(f64::from(tick) * 1e-3, 0.0, 0.0);
        device.write(&DeviceForce { force, ..DeviceForce::zero() }).unwrap();
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(ALLOCATIONS.get() - before, 0);
    assert!(device.read().unwrap().sequence > first + 100, "it was measured meanwhile");
}
