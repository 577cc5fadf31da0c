//! Which camera is meant.

use ambf_core::ids::CameraId;
use ambf_core::scene::{VisualObject, VisualScene};
use thiserror::Error;

/// Error when a name is that of no camera, or of several.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum NoSuchCamera {
    /// Error when no camera is called so.
    #[error("there is no camera `{wanted}`; {}", listed(.cameras))]
    Unknown {
        /// What was asked for.
        wanted: String,
        /// Labels of all cameras.
        cameras: Vec<String>,
    },
    /// Error when several cameras are called so.
    #[error("several cameras are called `{wanted}`; write {}", .cameras.join(" or "))]
    Ambiguous {
        /// What was asked for.
        wanted: String,
        /// Qualified identifiers of the cameras that are called so.
        cameras: Vec<String>,
    },
    /// Error when the scene has no camera at all.
    #[error("the scene has no camera; list one under `cameras` of the world file")]
    None,
}

fn listed(cameras: &[String]) -> String {
    format!("the scene has {}", cameras.join(", "))
}

/// Name of an object with its namespace, as its topics begin: `/ambf/env/cameras/main_camera`.
pub fn object_label(object: &VisualObject) -> String {
    let own = if object.name.is_empty() { "_" } else { &*object.name };
    let parts = object.namespace.split('/').chain(own.split('/')).filter(|part| !part.is_empty());
    parts.fold(String::new(), |label, part| {
        let legal = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        label + "/" + &part.chars().map(legal).collect::<String>()
    })
}

/// Labels ([`object_label`]) of all cameras that are in the scene.
pub fn camera_labels(visuals: &VisualScene) -> Vec<(CameraId, String)> {
    let here = visuals.cameras.entries().filter(|(_, camera)| !camera.object.removed);
    here.map(|(id, camera)| (id, object_label(&camera.object))).collect()
}

/// A camera by label, qualified identifier (prefix, namespace and mapping key), name or mapping key, in this
/// order; `None` stands for the first camera.
///
/// # Errors
/// [`NoSuchCamera`], which lists the cameras.
pub fn find_camera(visuals: &VisualScene, wanted: Option<&str>) -> Result<CameraId, NoSuchCamera> {
    let labels = camera_labels(visuals);
    let Some((first, _)) = labels.first() else { return Err(NoSuchCamera::None) };
    let Some(wanted) = wanted else { return Ok(*first) };
    let object = |id: CameraId| &visuals.cameras[id].object;
    let key = |id: CameraId| object(id).identifier.rsplit('/').next().unwrap_or_default();
    type Way<'a> = &'a dyn Fn(CameraId, &str) -> bool;
    let ending = format!("/{wanted}");
    let ways: [Way<'_>; 5] = [
        &|_, label| label == wanted,
        &|id, _| &*object(id).identifier == wanted,
        &|id, _| &*object(id).name == wanted,
        &|id, _| key(id) == wanted,
        // The name with a part of its namespace, as lists of cameras show it.
        &|_, label| label.ends_with(&ending),
    ];
    for way in ways {
        let found: Vec<CameraId> = labels.iter().filter(|(id, label)| way(*id, label)).map(|(id, _)| *id).collect();
        match found[..] {
            [] => continue,
            [id] => return Ok(id),
            _ => {
                let cameras = found.iter().map(|&id| object(id).identifier.to_string()).collect();
                return Err(NoSuchCamera::Ambiguous { wanted: wanted.to_owned(), cameras });
            }
        }
    }
    let cameras = labels.into_iter().map(|(_, label)| label).collect();
    Err(NoSuchCamera::Unknown { wanted: wanted.to_owned(), cameras })
}

#[cfg(test)]
mod tests {
    use ambf_core::scene::{load, SceneFiles, SceneOptions};

    use super::*;

    fn visuals(cameras: &[(&str, &str)]) -> VisualScene {
        let folder = std::env::temp_dir().join(format!("ambf_render_cameras_{}_{}", std::process::id(), cameras.len()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let keys: Vec<&str> = cameras.iter().map(|(key, _)| *key).collect();
        let mut text = format!("namespace: /w/\ncameras: [{}]\n", keys.join(", "));
        for (key, name) in cameras {
            text += &format!(
                "{key}: {{namespace: cameras/, name: {name}, location: {{x: 1, y: 0, z: 0}}, look at: {{x: 0, y: 0, z: 0}}}}\n"
            );
        }
        let world = folder.join("world.yaml");
        std::fs::write(&world, text).expect("written");
        let loaded = load(&SceneFiles { world: Some(world), models: vec![] }, &SceneOptions::default());
        std::fs::remove_dir_all(&folder).expect("removed");
        loaded.scene.visuals(0)
    }

    #[test]
    fn cameras_are_found_by_all_their_names() {
        let visuals = visuals(&[("one", "left_eye"), ("two", "right_eye")]);
        let identifier = visuals.cameras[CameraId::new(1)].object.identifier.to_string();
        assert!(identifier.ends_with("two"), "{identifier}");
        for name in ["/w/cameras/right_eye", "cameras/right_eye", "right_eye", "two", &identifier] {
            assert_eq!(find_camera(&visuals, Some(name)), Ok(CameraId::new(1)), "{name}");
        }
        assert_eq!(find_camera(&visuals, None), Ok(CameraId::new(0)));
        let error = find_camera(&visuals, Some("three")).expect_err("there is none");
        let text = error.to_string();
        assert_eq!(text, "there is no camera `three`; the scene has /w/cameras/left_eye, /w/cameras/right_eye");
    }

    #[test]
    fn a_name_of_two_cameras_is_refused() {
        let mut visuals = visuals(&[("one", "eye"), ("two", "eye"), ("three", "lens")]);
        // The second one of a name gets a suffix.
        visuals.cameras[CameraId::new(1)].object.name = "eye".into();
        let error = find_camera(&visuals, Some("eye")).expect_err("there are two");
        assert!(error.to_string().starts_with("several cameras are called `eye`; write "), "{error}");
        visuals.cameras[CameraId::new(0)].object.removed = true;
        assert_eq!(find_camera(&visuals, Some("eye")), Ok(CameraId::new(1)));
        for camera in &mut visuals.cameras {
            camera.object.removed = true;
        }
        assert_eq!(find_camera(&visuals, None), Err(NoSuchCamera::None));
    }
}
