//! Neither the scheduler's callback nor the host's side of it allocates. The only test of its program, because it
//! counts for all threads.

use std::alloc::{GlobalAlloc, Layout, System};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use ambf_device::{DeviceForce, DeviceInfo, DeviceLog, InputDevice, Setting, Settings};
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
    let (log, said) = DeviceLog::new();
    let mut touch = TouchDriver.open_touch(&info, &settings, &log).unwrap();
    let mut force = DeviceForce::zero();
    let start = Instant::now();
    // The calibration is said once.
    while !touch.read().unwrap().valid {
        assert!(start.elapsed() < Duration::from_secs(20));
    }
    // A sentence to the user allocates: on a busy machine one says that forces were late.
    let mut rounds = (0..5).map(|_| {
        touch.read().unwrap();
        said.try_iter().for_each(drop);
        let (first, before) = (touch.read().unwrap().sequence, ALLOCATIONS.load(Ordering::Relaxed));
        while touch.read().unwrap().sequence < first + 1000 {
            force.force.x = (force.force.x + 1e-3) % 1.0;
            touch.write(&force).unwrap();
            assert!(start.elapsed() < Duration::from_secs(100));
            sleep(Duration::from_micros(500));
        }
        let allocations = ALLOCATIONS.load(Ordering::Relaxed) - before;
        (allocations, said.try_iter().collect::<Vec<_>>())
    });
    let quiet = rounds.find(|(_, sentences)| sentences.is_empty());
    assert_eq!(quiet.expect("a round without a sentence").0, 0);
}
