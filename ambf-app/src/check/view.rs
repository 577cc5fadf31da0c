//! What is worth saying about lights, cameras and worlds.

use ambf_core::adf::{Camera, Light, PublishedFrame, World};

use super::original;
use super::pass::Pass;

/// Walks over a world file; its environment is another file.
pub(super) fn world(pass: &mut Pass<'_>, world: &World) {
    let whole = pass.outline.root().source();
    if world.environment.is_none() {
        match world.enclosure {
            Some(_) => pass.root_differs(&original::ENCLOSURE),
            None => pass.root_differs(&original::NO_ENVIRONMENT),
        }
    }
    lights(pass, &world.lights);
    cameras(pass, &world.cameras);
    pass.shaders(&whole, &["shaders"], world.shaders.as_ref());
    if let Some(skybox) = &world.skybox {
        pass.keep("sky box");
        let place = pass.entry("skybox").map_or(whole, |entry| entry.source());
        for face in &skybox.faces {
            pass.other_file(&place, &["skybox"], face, "there is no sky box");
        }
        pass.shaders(&place, &["skybox", "shaders"], skybox.shaders.as_ref());
    }
    pass.plugins(&["plugins"], &world.common.plugins);
}

pub(super) fn lights(pass: &mut Pass<'_>, lights: &[Light]) {
    for light in lights {
        let identifier = &light.common.identifier;
        pass.common(&light.common, true);
        if pass.entry(identifier).is_some_and(|entry| entry.get("shadow quality").is_none()) {
            pass.differs(&original::SHADOW, identifier);
        }
    }
}

pub(super) fn cameras(pass: &mut Pass<'_>, cameras: &[Camera]) {
    for camera in cameras {
        let identifier = &camera.common.identifier;
        pass.common(&camera.common, true);
        if camera.stereo.as_ref().is_some_and(|stereo| !stereo.mode.to_lowercase().contains("passive")) {
            pass.differs(&original::STEREO_MODE, identifier);
        }
        if camera.intrinsics.is_some() || camera.projection_matrix.is_some() {
            pass.keep("camera intrinsics");
        }
        let size = |frame: &PublishedFrame| (frame.width, frame.height);
        let picture = camera.publish_image.as_ref().map_or((640, 480), size);
        if camera.publish_depth.as_ref().is_some_and(|depth| size(depth) != picture) {
            pass.differs(&original::DEPTH_RESOLUTION, identifier);
        }
        for (key, shaders) in [
            ("preprocessing shaders", &camera.preprocessing_shaders),
            ("depth compute shaders", &camera.depth_compute_shaders),
        ] {
            let place = pass.place(&camera.common, key);
            pass.shaders(&place, &[identifier, key], shaders.as_ref());
        }
    }
}
