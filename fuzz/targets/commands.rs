//! Command files of batch runs from any text, applied to a small scene.
#![no_main]

use std::cell::RefCell;
use std::path::Path;

use ambf_app::batch::{Commands, Targets};
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{Nearness, Simulation, DEFAULT_SUB_STEP};
use libfuzzer_sys::fuzz_target;

thread_local! {
    static ARM: RefCell<Simulation> = RefCell::new({
        let model = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../resources/models/chain.yaml"));
        let files = SceneFiles { world: None, models: vec![model.into()] };
        let loaded = load(&files, &SceneOptions::default());
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Simulation::new(loaded.scene, DEFAULT_SUB_STEP)
    });
}

fuzz_target!(|text: &str| ARM.with_borrow_mut(|simulation| {
    let names: Vec<String> = simulation.scene().bodies.iter().map(|body| body.identity.name.clone()).collect();
    match Commands::parse(text, "c.txt", &Targets::new(simulation.scene(), &names)) {
        Err(error) => assert!(error.to_string().starts_with("c.txt:"), "{error}"),
        Ok(commands) => {
            let lost = (0..3).any(|step| {
                let applied = commands.apply(simulation, step, DEFAULT_SUB_STEP);
                applied.is_err() || simulation.update(DEFAULT_SUB_STEP).is_err()
            });
            let _ = commands.latest(3, |_| Nearness::Apart);
            if lost {
                simulation.reset_bodies();
            }
        }
    }
}));
