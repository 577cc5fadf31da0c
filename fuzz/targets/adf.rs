//! Every kind of ADF file from any text: messages or a description, and messages that can be shown.
#![no_main]

use std::path::Path;

use ambf_model::adf::{parse, ColorTable, Description, InputDevices, Launch, Model, World};
use libfuzzer_sys::fuzz_target;

/// More would be a flood: a report is at most a handful of lines for each line of the file.
fn read<T: Description>(text: &str) -> Option<T> {
    match parse::<T>(text, Path::new("folder/f.yaml")) {
        Ok((value, report)) => {
            assert_eq!(report.is_empty(), report.to_string().is_empty());
            let _ = report.verbose().to_string();
            Some(value)
        }
        Err(error) => {
            assert!(error.to_string().starts_with("folder/f.yaml"), "{error}");
            None
        }
    }
}

fuzz_target!(|text: &str| {
    if let Some(model) = read::<Model>(text) {
        for body in &model.bodies {
            assert!(body.mass.is_finite() && body.mass >= 0.0);
            assert!(body.location.to_homogeneous().iter().all(|x| x.is_finite()));
            assert!(body.scale.is_finite() && body.collision_margin.is_finite());
        }
        for joint in &model.joints {
            for vector in [&joint.parent_axis, &joint.child_axis, &joint.parent_pivot, &joint.child_pivot] {
                assert!(vector.iter().all(|x| x.is_finite()));
            }
        }
    }
    read::<World>(text);
    read::<Launch>(text);
    read::<InputDevices>(text);
    read::<ColorTable>(text);
});
