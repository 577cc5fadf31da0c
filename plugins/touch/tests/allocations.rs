//! Neither the scheduler's callback nor the host's side of it allocates. The only test of its program, because it counts for all threads.

use std::alloc::{GlobalAlloc, Layout, System};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use ambf_core::device::{DeviceForce, DeviceInfo, DeviceLog, InputDevice, Setting, Settings};
use touch::TouchDriver;

struct Counting;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

// SAFETY: all is left to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
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
    let fake = fake_hd::Fake::new(&[("Arm", "Touch")]).unwrap();
    let library = Setting { value: fake.path().to_str().unwrap().to_owned(), place: String::new() };
    let settings = Settings::new(BTreeMap::from([(String::from("library"), library)]), PathBuf::new());
    let info = DeviceInfo { model: String::from("Touch"), identity: String::from("Arm") };
    let mut touch = TouchDriver.open_touch(&info, &settings, &DeviceLog::new().0).unwrap();
    let mut force = DeviceForce::zero();
    let start = Instant::now();
    // The calibration is said once.
    while !touch.read().unwrap().valid {
        assert!(start.elapsed() < Duration::from_secs(20));
    }
    touch.read().unwrap();
    let (first, before) = (touch.read().unwrap().sequence, ALLOCATIONS.load(Ordering::Relaxed));
    while touch.read().unwrap().sequence < first + 1000 {
        force.force.x += 1e-3;
        touch.write(&force).unwrap();
        assert!(start.elapsed() < Duration::from_secs(20));
        sleep(Duration::from_micros(500));
    }
    assert_eq!(ALLOCATIONS.load(Ordering::Relaxed) - before, 0);
}
