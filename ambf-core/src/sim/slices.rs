/// The shortest slice that Linux grants, ns.
const SLICE: u64 = 100_000;

/// Asks the scheduler for short slices of time for this thread. Its share stays the same, but when it wakes up it need
/// not wait until a thread of lower priority, such as one that draws, has used up a slice of some 3 ms. Linux since
/// 6.12 heeds it, others ignore or refuse it.
pub fn request_short_slices() {
    // SAFETY: `sched_attr` is a plain structure of numbers, whose first field is its size: no more of it is written or
    // read.
    unsafe {
        let mut attributes: libc::sched_attr = std::mem::zeroed();
        let size = std::mem::size_of_val(&attributes);
        if libc::syscall(libc::SYS_sched_getattr, 0, &raw mut attributes, size, 0) == 0
            && attributes.sched_policy == libc::SCHED_OTHER as u32
        {
            attributes.sched_runtime = SLICE;
            libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_are_short_and_the_priority_stays() {
        std::thread::spawn(|| {
            let nice = rustix::process::getpriority_process(None).unwrap().min(18) + 1;
            rustix::process::setpriority_process(None, nice).unwrap();
            request_short_slices();
            assert_eq!(rustix::process::getpriority_process(None), Ok(nice));
            // The second line after the head of the table: "se.slice : 100000" where the kernel shows it.
            let shown = std::fs::read_to_string("/proc/thread-self/sched").unwrap_or_default();
            if let Some(line) = shown.lines().find(|line| line.starts_with("se.slice")) {
                let slice: u64 = line.rsplit(' ').next().unwrap().parse().unwrap();
                // Longer: an older kernel, which ignores it.
                assert!(slice == SLICE || slice >= 700_000, "{line}");
            }
        })
        .join()
        .unwrap();
    }
}
