//! What the accurate profile reaches in cases of the accuracy benchmark whose errors depend on the branch that a loop takes.

use std::time::Duration;

use ambf_bench::{jointed, own};

/// A row of parallelograms goes through a singular configuration, all rods in line, in each half turn.
#[test]
fn ten_windows_stay_on_their_branch() {
    let case = jointed::window10();
    let setting = own::settings(&case).into_iter().find(|setting| setting.name == own::ACCURATE).expect("a profile");
    let error =
        |step| case.error(&own::run(&case, &setting, step, Duration::MAX).expect("it loads").expect("no limit"));
    // 0.43 mm and 0.21 m; 45 mm and another branch where the CFM of the joints does not depend on the motion.
    assert!(error(0.001) < 0.002);
    assert!(error(0.004) < 0.5);
}
