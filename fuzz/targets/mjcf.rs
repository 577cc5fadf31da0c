//! Descriptions in MJCF from any text; no other file is looked for.
#![no_main]

mod numbers;

use std::path::Path;

use ambf_model::mjcf::{parse, Surroundings};

libfuzzer_sys::fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    numbers::mutate(data, size, max_size, seed)
});

libfuzzer_sys::fuzz_target!(|text: &str| {
    match parse(text, Path::new("r.xml"), Surroundings::Nothing) {
        Ok((model, report)) => {
            assert_eq!(report.is_empty(), report.to_string().is_empty());
            for body in &model.bodies {
                assert!(body.mass.is_finite() && body.mass >= 0.0);
                assert!(body.location.to_homogeneous().iter().all(|x| x.is_finite()));
            }
            for joint in &model.joints {
                for vector in [&joint.parent_axis, &joint.child_axis, &joint.parent_pivot, &joint.child_pivot] {
                    assert!(vector.iter().all(|x| x.is_finite()));
                }
            }
        }
        Err(error) => assert!(error.to_string().starts_with("r.xml"), "{error}"),
    }
});
