//! Draws one picture of a scene as it is when it is loaded: `cargo run --release -p ambf-render --example picture --
//! WORLD MODEL PNG`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use ambf_core::ids::CameraId;
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use ambf_render::{PictureRequest, Renderer, Stage, View};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [world, models @ .., file] = &arguments[..] else {
        return Err("usage: picture WORLD.yaml [MODEL.yaml]... PICTURE.png".into());
    };
    let loaded = load(&SceneFiles { world: Some(world.clone()), models: models.to_vec() }, &SceneOptions::default());
    eprint!("{}", loaded.report);
    let simulation = Simulation::new(loaded.scene, 0.001);
    let (visuals, snapshot) = (Arc::new(simulation.scene().visuals(0)), simulation.snapshot());
    let camera = visuals.cameras.first().ok_or("the scene has no camera")?;
    let view = View::of_camera(&camera.description, &snapshot.views[CameraId::new(0)]);

    let mut renderer = Renderer::offscreen()?;
    println!("{}", renderer.device());
    let mut stage = Stage::default();
    for message in renderer.prepare(&mut stage, &visuals, &snapshot) {
        eprintln!("{message}");
    }
    let request = PictureRequest { depth: true, ..PictureRequest::color(640, 480) };
    let picture = renderer.render(&mut stage, &view, &request)?;
    let started = Instant::now();
    renderer.prepare(&mut stage, &visuals, &snapshot);
    renderer.render(&mut stage, &view, &request)?;
    println!("another one takes {:.1} ms", started.elapsed().as_secs_f64() * 1e3);
    let kind = image::ExtendedColorType::Rgb8;
    image::save_buffer(file, &picture.color, picture.width, picture.height, kind)?;
    Ok(())
}
