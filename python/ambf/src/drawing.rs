//! Pictures of a world, in the thread that asks for them.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::Arc;

use ambf_core::comm::Snapshot;
use ambf_core::ids::CameraId;
use ambf_core::scene::VisualScene;
use ambf_render::{camera_labels, find_camera, object_label, published_size, NoSuchCamera};
use ambf_render::{PictureRequest, Planes, Projection, RenderError, Renderer, Stage, View};
use nalgebra::Isometry3;
use parking_lot::Mutex;

/// Messages that are kept; further ones are dropped.
const MAX_MESSAGES: usize = 1000;

/// What of a world is drawn, at one moment.
pub struct Moment {
    pub visuals: Arc<VisualScene>,
    pub snapshot: Snapshot,
}

/// What is wanted of a picture.
pub struct Wanted {
    /// Of which camera.
    pub camera: CameraId,
    /// What it is taken with.
    pub view: View,
    pub size: (u32, u32),
    pub rgb: bool,
    pub depth: bool,
    pub ids: bool,
    pub normals: bool,
    pub samples: u32,
}

/// Arrays that a picture is drawn into; those that are not wanted are empty.
pub struct Arrays<'a> {
    /// (height x width x 3).
    pub rgb: &'a mut [u8],
    /// (height x width) m.
    pub depth: &'a mut [f32],
    /// (height x width) ids of objects.
    pub ids: &'a mut [i32],
    /// (height x width x 3).
    pub normals: &'a mut [f32],
}

/// Renderer and stage of a world, made when they are used for the first time.
#[derive(Default)]
pub struct Drawing {
    /// The process that draws; 0 before.
    process: AtomicU32,
    studio: Mutex<Option<Studio>>,
    messages: Arc<Mutex<Vec<String>>>,
}

struct Studio {
    renderer: Renderer,
    stage: Stage,
    /// Objects and models of the last picture with ids.
    ids: Vec<[u32; 2]>,
}

impl Moment {
    /// The camera of that name; a part of a label that no other has is enough. `None`: the first.
    pub fn camera(&self, wanted: Option<&str>) -> Result<CameraId, NoSuchCamera> {
        let found = find_camera(&self.visuals, wanted);
        let (Err(NoSuchCamera::Unknown { wanted, .. }), true) = (&found, wanted.is_some_and(|name| !name.is_empty()))
        else {
            return found;
        };
        let labels = camera_labels(&self.visuals);
        let parts: Vec<_> = labels.into_iter().filter(|(_, label)| label.contains(wanted)).collect();
        match &parts[..] {
            [] => found,
            [(id, _)] => Ok(*id),
            _ => {
                let cameras = parts.into_iter().map(|(_, label)| label).collect();
                Err(NoSuchCamera::Ambiguous { wanted: wanted.clone(), cameras })
            }
        }
    }

    /// Size of a picture: as given; else the published resolution, or what keeps its shape.
    pub fn size(&self, camera: CameraId, width: Option<u32>, height: Option<u32>) -> (u32, u32) {
        let (w, h) = published_size(&self.visuals.cameras[camera].description);
        let other = |given: u32, from: u32, to: u32| {
            let size = (f64::from(given) * f64::from(to) / f64::from(from)).round();
            (size as u32).max(1)
        };
        match (width, height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, other(width, w, h)),
            (None, Some(height)) => (other(height, h, w), height),
            (None, None) => (w, h),
        }
    }

    /// View of a camera.
    pub fn view(&self, camera: CameraId) -> View {
        View::of_camera(&self.visuals.cameras[camera].description, &self.snapshot.views[camera])
    }

    /// View of a camera, from another pose and with another vertical field of view, rad, where these are given.
    pub fn view_from(&self, camera: CameraId, pose: Option<Isometry3<f64>>, angle: Option<f64>) -> View {
        let view = self.view(camera);
        View {
            pose: pose.unwrap_or(view.pose),
            projection: angle.map_or(view.projection, Projection::Perspective),
            ..view
        }
    }
}

impl Drawing {
    /// Draws into arrays of the size of the picture. Nobody else draws this world meanwhile.
    pub fn picture(&self, moment: &Moment, wanted: &Wanted, arrays: Arrays<'_>) -> Result<(), RenderError> {
        let request = PictureRequest {
            color: wanted.rgb,
            depth: wanted.depth,
            ids: wanted.ids,
            normals: wanted.normals,
            samples: wanted.samples,
            preprocessing: moment.visuals.cameras[wanted.camera].description.preprocessing_shaders.clone(),
            ..PictureRequest::color(wanted.size.0, wanted.size.1)
        };
        let messages = self.with(moment, |Studio { renderer, stage, ids }| {
            ids.resize(arrays.ids.len(), [0; 2]);
            let (normals, _) = arrays.normals.as_chunks_mut();
            let planes = Planes { color: arrays.rgb, depth: arrays.depth, ids, normals };
            let (_, messages) = renderer.render_into(stage, &wanted.view, &request, planes)?;
            for (to, [object, _]) in arrays.ids.iter_mut().zip(ids) {
                *to = i32::try_from(*object).unwrap_or(i32::MAX);
            }
            Ok(messages)
        })??;
        self.say(messages);
        Ok(())
    }

    /// Labels of the objects by id; the first is nothing.
    pub fn id_names(&self, moment: &Moment) -> Result<Vec<String>, RenderError> {
        let visuals = &moment.visuals;
        let objects = (visuals.bodies.iter().map(|body| &body.object))
            .chain(visuals.ghosts.iter().map(|ghost| &ghost.object))
            .chain(visuals.soft_bodies.iter().map(|soft| &soft.object))
            .chain(visuals.vehicles.iter().map(|vehicle| &vehicle.object))
            .chain(visuals.cameras.iter().map(|camera| &camera.object))
            .chain(visuals.lights.iter().map(|light| &light.object))
            .chain(visuals.sensors.iter().map(|sensor| &sensor.object))
            .chain(visuals.actuators.iter().map(|actuator| &actuator.object));
        let labels: HashMap<&str, String> = objects.map(|object| (&*object.identifier, object_label(object))).collect();
        self.with(moment, |Studio { stage, .. }| {
            let identifiers = (1..).map_while(|id| stage.id_name(id));
            let named = identifiers.map(|name| labels.get(name).cloned().unwrap_or_else(|| name.to_owned()));
            std::iter::once(String::new()).chain(named).collect()
        })
    }

    /// Takes what there is to say about files that cannot be drawn as described.
    pub fn take_messages(&self) -> Vec<String> {
        std::mem::take(&mut *self.messages.lock())
    }

    /// Where messages are left.
    pub fn messages(&self) -> Arc<Mutex<Vec<String>>> {
        Arc::clone(&self.messages)
    }

    /// Drops the renderer.
    pub fn close(&self) {
        if self.is_ours() {
            drop(self.studio.lock().take());
        }
    }

    /// Whether no other process draws with it: this one may have been forked while that one held the lock.
    fn is_ours(&self) -> bool {
        let process = self.process.load(Ordering::Acquire);
        process == 0 || process == std::process::id()
    }

    fn with<R>(&self, moment: &Moment, use_studio: impl FnOnce(&mut Studio) -> R) -> Result<R, RenderError> {
        if !self.is_ours() {
            return Err(RenderError::Forked);
        }
        self.process.store(std::process::id(), Ordering::Release);
        let mut place = self.studio.lock();
        let studio = match &mut *place {
            Some(studio) => studio,
            None => place.insert(Studio { renderer: Renderer::offscreen()?, stage: Stage::default(), ids: Vec::new() }),
        };
        self.say(studio.renderer.prepare(&mut studio.stage, &moment.visuals, &moment.snapshot));
        Ok(use_studio(studio))
    }

    fn say(&self, messages: Vec<String>) {
        let mut said = self.messages.lock();
        let room = MAX_MESSAGES.saturating_sub(said.len());
        said.extend(messages.into_iter().take(room));
    }
}
