//! What is worth saying about lights, cameras and worlds.

use std::collections::{BTreeSet, HashMap};

use ambf_core::adf::{Camera, Common, Light, PublishedFrame, World};
use ambf_core::scene::NameMap;

use super::finding::Level;
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
    let lights = world.lights.iter().map(|light| (&light.common, light.parent.as_str()));
    let cameras = world.cameras.iter().map(|camera| (&camera.common, camera.parent.as_str()));
    loops(pass, lights.chain(cameras));
    pass.shaders(&whole, &["shaders"], world.shaders.as_ref());
    if let Some(skybox) = &world.skybox {
        pass.keep("sky box");
        let place = pass.entry("skybox").map_or(whole, |entry| entry.source());
        for face in &skybox.faces {
            pass.other_file(&place, &["skybox"], face, "there is no sky box");
        }
        pass.shaders(&place, &["skybox", "shaders"], skybox.shaders.as_ref());
    }
    pass.plugins(&[], &world.common.plugins);
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

/// Names the loops of parents among elements that may be parents of each other.
pub(super) fn loops<'m>(pass: &mut Pass<'_>, elements: impl Iterator<Item = (&'m Common, &'m str)>) {
    let elements: Vec<_> = elements.collect();
    if elements.iter().all(|(_, parent)| parent.is_empty()) {
        return;
    }
    let mut names = NameMap::default();
    for (index, (common, _)) in elements.iter().enumerate() {
        names.insert(&format!("{}{}", common.namespace, common.identifier), index);
    }
    let mut found: HashMap<&str, Option<usize>> = HashMap::new();
    let parents: Vec<_> = (elements.iter())
        .map(|(common, text)| {
            let qualified = || names.exact(&format!("{}{text}", common.namespace));
            let mut anywhere = || *found.entry(text).or_insert_with(|| names.find(text).index());
            (!text.is_empty()).then(|| qualified().or_else(&mut anywhere)).flatten()
        })
        .collect();
    // Each element is walked over once: a walk ends where an earlier one came by.
    let mut walk_of = vec![usize::MAX; elements.len()];
    for start in 0..elements.len() {
        let mut at = Some(start);
        let mut way = Vec::new();
        while let Some(index) = at.filter(|&index| walk_of[index] == usize::MAX) {
            walk_of[index] = start;
            way.push(index);
            at = parents[index];
        }
        let Some(again) = at.filter(|&index| walk_of[index] == start) else { continue };
        let members: Vec<_> = way.into_iter().skip_while(|&index| index != again).collect();
        let ordered: BTreeSet<_> = members.iter().copied().collect();
        let Some(common) = ordered.first().map(|&index| elements[index].0) else { continue };
        let shown: Vec<_> = members.iter().take(10).map(|&index| elements[index].0.identifier.as_str()).collect();
        let rest = if members.len() > shown.len() {
            format!(" and {} more", members.len() - shown.len())
        } else {
            String::new()
        };
        let sentence = format!("is part of a loop of parents ({}{rest}), which leads nowhere", shown.join(", "));
        let place = pass.place(common, "parent");
        pass.say(Level::Warning, "loop", place, &[&common.identifier, "parent"], &sentence);
    }
}
