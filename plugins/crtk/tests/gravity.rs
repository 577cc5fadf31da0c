//! An arm that is free stands still: what holds it against gravity is all that acts.

mod common;

use common::{Bench, PROFILES};

const POSES: [[f64; 6]; 3] = [[0.0, 0.0, 0.12, 0.0, 0.0, 0.0], [0.5, 0.3, 0.1, 1.0, 0.5, -0.4], [-0.7, -0.4, 0.2, -2.0, -0.6, 0.7]];

#[test]
fn a_free_arm_stands_still() {
    for profile in PROFILES {
        for pose in POSES {
            let mut bench = Bench::psm(profile);
            bench.run(0.5);
            bench.send_positions("/PSM1/move_jp", &pose);
            bench.run(3.0);
            let before = bench.body("tool");
            bench.topics.send("/PSM1/free", &[]);
            for k in 0..5 {
                bench.run(1.0);
                let now = bench.body("tool");
                let drift = (now.translation.vector - before.translation.vector).norm();
                println!("{profile:?} {pose:?} {k}: {:.5} mm", drift * 1e3);
            }
        }
    }
}
