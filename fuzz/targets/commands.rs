//! Command files of batch runs from any text, applied to a small scene.
#![no_main]

use std::cell::RefCell;
use std::path::Path;

use ambf_app::batch::Commands;
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{Simulation, DEFAULT_SUB_STEP};
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
    let active: Vec<usize> = (0..names.len()).map(|body| simulation.scene().graph.active(body).count()).collect();
    match Commands::parse(text, "c.txt", &names, |body| active[body]) {
        Err(error) => assert!(error.to_string().starts_with("c.txt:"), "{error}"),
        Ok(commands) => {
            let lost = (0..3).any(|step| {
                commands.apply(simulation, step);
                simulation.update(DEFAULT_SUB_STEP).is_err()
            });
            let _ = commands.latest(0, 3);
            if lost {
                simulation.reset_bodies();
            }
        }
    }
}));
