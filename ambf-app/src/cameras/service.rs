//! Makes what cameras publish.

use std::io::Write;
use std::sync::Arc;

use ambf_core::adf;
use ambf_core::comm::Snapshot;
use ambf_core::scene::{VisualObject, VisualScene};
use ambf_render::{published_size, Picture, PictureRequest, Renderer, Stage, View};
use image::codecs::jpeg::JpegEncoder;
use image::ExtendedColorType;

use super::clouds::CloudMarkers;
use super::messages::{self, Header, Pinhole, Points};
use super::noise::Noise;
use crate::report;
use crate::ros::messages::time;
use crate::ros::{CameraTopics, PictureTopic, PictureTopics, PointClouds};

/// Quality of compressed images, percent: that of `image_transport`.
const JPEG_QUALITY: u8 = 80;

/// Makes the images, clouds and intrinsics of all cameras, once a graphics frame. It has no renderer of its own: it is
/// called where one is.
pub struct CameraService {
    topics: Arc<PictureTopics>,
    /// Of the topics when they were last looked at.
    generation: Option<u64>,
    cameras: Vec<Camera>,
    clouds: CloudMarkers,
    /// Frames since the first.
    frames: u64,
}

/// A camera that publishes.
struct Camera {
    topics: Arc<CameraTopics>,
    noise: Option<Noise>,
    /// (height x width) noise of the present depth, m, top row first; empty without.
    numbers: Vec<f32>,
    /// What is asked of pictures, and the description that it follows from.
    request: Option<(Arc<adf::Camera>, PictureRequest)>,
    /// The last thing that went wrong, which is said once.
    trouble: String,
}

/// What of a camera is to be made in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Due {
    image: bool,
    compressed: bool,
    cloud: bool,
    depth_image: bool,
    info: bool,
}

impl Due {
    /// What is due in the frame number `frame`, and wanted.
    fn of(topics: &CameraTopics, frame: u64) -> Self {
        Self::of_wanted(topics, frame, PictureTopic::is_due)
    }

    fn of_wanted(topics: &CameraTopics, frame: u64, is_wanted: impl Fn(&PictureTopic) -> bool) -> Self {
        let is_due = |interval: Option<u32>| interval.is_some_and(|n| frame.is_multiple_of(u64::from(n.max(1))));
        let (image, depth) = (is_due(topics.image_interval), is_due(topics.depth_interval));
        Self {
            image: image && is_wanted(&topics.image),
            compressed: image && is_wanted(&topics.compressed),
            cloud: depth && is_wanted(&topics.cloud),
            depth_image: depth && is_wanted(&topics.depth_image),
            info: (image || depth) && is_wanted(&topics.info),
        }
    }

    fn anything(self) -> bool {
        self != Self::default()
    }
}

impl CameraService {
    /// Serves the cameras that have `topics`, and shows `clouds` of clients in all pictures.
    pub fn new(topics: Arc<PictureTopics>, clouds: Arc<PointClouds>) -> Self {
        Self { topics, generation: None, cameras: Vec::new(), clouds: CloudMarkers::new(clouds), frames: 0 }
    }

    /// Whether anybody subscribes to anything of any camera. Subscribers that have stopped reading don't count.
    pub fn is_wanted(&self) -> bool {
        self.topics.is_wanted()
    }

    /// Whether the next call of [`frame`](Self::frame) will render. What is not due needs no renderer:
    /// [`pass`](Self::pass) is enough.
    pub fn is_due(&mut self) -> bool {
        self.follow_topics();
        self.cameras.iter().any(|camera| Due::of(&camera.topics, self.frames).anything())
    }

    /// A graphics frame in which nothing is made.
    pub fn pass(&mut self) {
        self.frames += 1;
    }

    /// A graphics frame: renders and publishes what is due in it and subscribed to. `stage` must have been
    /// [prepared](Renderer::prepare) with `visuals` and `snapshot`. Never waits for a subscriber; what goes wrong is
    /// reported once.
    ///
    /// All pictures show `snapshot` and carry its stamp. The first frame is due for every camera; after that every
    /// n-th, n being the interval in the camera's description.
    pub fn frame(
        &mut self,
        renderer: &mut Renderer,
        stage: &mut Stage,
        visuals: &Arc<VisualScene>,
        snapshot: &Arc<Snapshot>,
    ) {
        self.clouds.refresh(stage, visuals, snapshot);
        self.follow_topics();
        for camera in &mut self.cameras {
            let due = Due::of(&camera.topics, self.frames);
            if due.anything() {
                camera.publish(due, visuals, snapshot, |view, request| {
                    renderer.render(stage, view, request).map_err(|error| error.to_string())
                });
            }
        }
        self.frames += 1;
    }

    /// Cameras come and go with their topics. Those that stay keep their noise.
    fn follow_topics(&mut self) {
        let generation = self.topics.generation();
        if self.generation == Some(generation) {
            return;
        }
        self.generation = Some(generation);
        let all = self.topics.all();
        self.cameras.retain(|camera| all.iter().any(|topics| topics.index == camera.topics.index));
        for topics in all {
            // They are others when another version of ROS has joined.
            match self.cameras.iter_mut().find(|camera| camera.topics.index == topics.index) {
                Some(camera) => camera.topics = topics,
                None => self.cameras.push(Camera {
                    topics,
                    noise: None,
                    numbers: Vec::new(),
                    request: None,
                    trouble: String::new(),
                }),
            }
        }
        // Pictures of one frame are made in the order of the cameras.
        self.cameras.sort_by_key(|camera| camera.topics.index);
    }
}

impl Camera {
    /// Makes what is `due` of `snapshot` with `render` and publishes it.
    fn publish(
        &mut self,
        due: Due,
        visuals: &VisualScene,
        snapshot: &Snapshot,
        mut render: impl FnMut(&View, &PictureRequest) -> Result<Picture, String>,
    ) {
        let index = self.topics.index;
        // What is drawn may be newer than the snapshot, for one step.
        let (Some(camera), Some(state)) = (visuals.cameras.get(index), snapshot.views.get(index)) else { return };
        if camera.object.removed {
            return;
        }
        let description = &camera.description;
        let view = View::of_camera(description, state);
        let topics = Arc::clone(&self.topics);
        let header = Header { stamp: time(snapshot.stamp), frame_id: &camera.object.name };
        let image_size = published_size(description);
        let depth_size = description.publish_depth.map_or(image_size, |frame| (frame.width, frame.height));
        let (wants_color, wants_depth) = (due.image || due.compressed, due.cloud || due.depth_image);

        if due.info {
            let eyes = view.eyes(image_size.0, image_size.1);
            if let [Some(mut pinhole)] = eyes.iter().map(Pinhole::of).collect::<Vec<_>>()[..] {
                if let Some(left) = left_of_pair(&camera.object, visuals, snapshot) {
                    pinhole = pinhole.beside(&eyes[0], &left.eyes(image_size.0, image_size.1)[0]);
                }
                topics.info.send(|bytes, seq| {
                    messages::camera_info(bytes, seq, header, image_size, &pinhole);
                });
            }
        }
        let is_one_picture = wants_color && wants_depth && image_size == depth_size;
        if wants_color {
            let picture = self.picture(description, image_size, (true, is_one_picture), &view, &mut render);
            let Some(picture) = picture else { return };
            send_color(&topics, due, header, &picture);
            if is_one_picture {
                self.send_depth(due, header, &picture, description);
            }
        }
        if wants_depth && !is_one_picture {
            let picture = self.picture(description, depth_size, (due.cloud, true), &view, &mut render);
            let Some(picture) = picture else { return };
            self.send_depth(due, header, &picture, description);
        }
    }

    /// A picture with colour, depth or both; `None` after a report.
    fn picture(
        &mut self,
        description: &Arc<adf::Camera>,
        (width, height): (u32, u32),
        (color, depth): (bool, bool),
        view: &View,
        render: &mut impl FnMut(&View, &PictureRequest) -> Result<Picture, String>,
    ) -> Option<Picture> {
        if self.request.as_ref().is_none_or(|(of, _)| !Arc::ptr_eq(of, description)) {
            let (preprocessing, samples) = (description.preprocessing_shaders.clone(), description.image_samples);
            self.request = Some((
                Arc::clone(description),
                PictureRequest { preprocessing, samples, ..PictureRequest::color(width, height) },
            ));
        }
        let (_, request) = self.request.as_mut()?;
        (request.width, request.height, request.color, request.depth) = (width, height, color, depth);
        let name = self.topics.name();
        match render(view, request) {
            Ok(picture) => {
                picture.messages.iter().for_each(|message| report!("{name}: {message}"));
                let pixels = width as usize * height as usize;
                let is_whole = picture.color.len() == if color { 3 * pixels } else { 0 }
                    && (!depth || picture.depth.len() == pixels);
                // A message of another length would be misread.
                debug_assert!(is_whole, "{} {}", picture.color.len(), picture.depth.len());
                is_whole.then_some(picture)
            }
            Err(error) => {
                if error != self.trouble {
                    report!("{name}: {error}; there are no pictures of it as long as this lasts");
                    self.trouble = error;
                }
                None
            }
        }
    }

    fn send_depth(&mut self, due: Due, header: Header<'_>, picture: &Picture, description: &adf::Camera) {
        match &description.depth_noise {
            Some(described) => {
                let noise = self.noise.get_or_insert_with(|| Noise::new(described));
                noise.fill(&mut self.numbers, picture.depth.len());
            }
            None => self.numbers.clear(),
        }
        let (noise, size) = (self.numbers.as_slice(), (picture.width, picture.height));
        if due.cloud {
            let points = Points { color: &picture.color, depth: &picture.depth, noise, eyes: &picture.eyes };
            self.topics.cloud.send(|bytes, seq| messages::cloud(bytes, seq, header, size, &points));
        }
        if due.depth_image {
            self.topics.depth_image.send(|bytes, seq| {
                messages::depth_image(bytes, seq, header, size, &picture.depth, noise);
            });
        }
    }
}

/// The camera with `left` in its name where a camera's own has `right`, if there is one.
fn left_of_pair(object: &VisualObject, visuals: &VisualScene, snapshot: &Snapshot) -> Option<View> {
    let name = object.name.contains("right").then(|| object.name.replace("right", "left"))?;
    let is_left = |of: &VisualObject| !of.removed && of.namespace == object.namespace && *of.name == *name;
    let index = visuals.cameras.position(|camera| is_left(&camera.object))?;
    Some(View::of_camera(&visuals.cameras.get(index)?.description, snapshot.views.get(index)?))
}

fn send_color(topics: &CameraTopics, due: Due, header: Header<'_>, picture: &Picture) {
    let (width, height) = (picture.width, picture.height);
    if due.image {
        topics.image.send(|bytes, seq| messages::image(bytes, seq, header, (width, height), &picture.color));
    }
    if due.compressed {
        topics.compressed.send(|bytes, seq| {
            messages::compressed(bytes, seq, header, |bytes| {
                let begin = bytes.len();
                if let Err(error) = encode(&mut *bytes, picture) {
                    // Only a picture of no size; nothing is better than half a file.
                    bytes.truncate(begin);
                    report!("{}: {error}", topics.name());
                }
            });
        });
    }
}

fn encode(bytes: impl Write, picture: &Picture) -> Result<(), image::ImageError> {
    JpegEncoder::new_with_quality(bytes, JPEG_QUALITY).encode(
        &picture.color,
        picture.width,
        picture.height,
        ExtendedColorType::Rgb8,
    )
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use ambf_core::scene::{load, SceneFiles, SceneOptions};
    use ambf_core::sim::{Simulation, DEFAULT_SUB_STEP};
    use std::sync::atomic::{AtomicU32, Ordering};

    const MODEL: &str = "bodies: [BODY Red, BODY Blue]\n\
        BODY Red: {name: Red, mass: 0, collision shape: Sphere, collision geometry: {radius: 0.05}, location: {position: {x: 1, y: 2, z: 3}}}\n\
        BODY Blue: {name: Blue, mass: 0, collision shape: Sphere, collision geometry: {radius: 0.05}}\n\
        cameras: [both, differing, stereo]\n\
        both: {name: both, publish image: true, publish image interval: 2, publish depth: true, publish depth interval: 3,\n  \
          publish image resolution: {width: 8, height: 6}, publish depth noise: {mean: 0.1, std dev: 0, seed: 1}}\n\
        differing: {name: differing, publish image: true, publish depth: true, publish depth interval: 1,\n  \
          publish image resolution: {width: 8, height: 6}, publish depth resolution: {width: 4, height: 2}}\n\
        stereo: {name: stereo, publish image: true, stereo: {mode: PASSIVE, eye separation: 0.1, focal length: 1}}\n";

    /// Two bodies, and cameras of several kinds.
    pub fn simulation() -> Simulation {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("ambf_app_cameras_{}_{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let file = std::env::temp_dir().join(name).with_extension("yaml");
        std::fs::write(&file, MODEL).unwrap();
        let files = SceneFiles { world: None, models: vec![file.clone()] };
        let loaded = load(&files, &SceneOptions::default());
        let _ = std::fs::remove_file(file);
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Simulation::new(loaded.scene, DEFAULT_SUB_STEP)
    }

    struct Fixture {
        visuals: VisualScene,
        snapshot: Snapshot,
    }

    impl Fixture {
        fn new() -> Self {
            let simulation = simulation();
            Self { visuals: simulation.scene().visuals(0), snapshot: simulation.snapshot() }
        }

        fn camera(&self, name: &str) -> Camera {
            let index = self.visuals.cameras.position(|camera| &*camera.object.name == name).unwrap();
            let described = &self.visuals.cameras[index].description;
            let (topics, _) = CameraTopics::of_ros1(index, &format!("/e/{name}"), described, |topic| topic).unwrap();
            Camera { topics: Arc::new(topics), noise: None, numbers: Vec::new(), request: None, trouble: String::new() }
        }

        /// What is asked of the renderer when `due` is due: size, colour and depth of each picture.
        fn requests(&self, camera: &mut Camera, due: Due) -> Vec<((u32, u32), bool, bool)> {
            let mut requests = Vec::new();
            camera.publish(due, &self.visuals, &self.snapshot, |view, request| {
                requests.push(((request.width, request.height), request.color, request.depth));
                assert_eq!(request.samples, 1);
                let pixels = (request.width * request.height) as usize;
                Ok(Picture {
                    width: request.width,
                    height: request.height,
                    color: vec![0; if request.color { 3 * pixels } else { 0 }],
                    depth: vec![1.0; if request.depth { pixels } else { 0 }],
                    eyes: view.eyes(request.width, request.height),
                    ..Picture::default()
                })
            });
            requests
        }
    }

    /// Rows 20 and 24 of the checklist.
    #[test]
    fn what_is_due_follows_the_count_of_frames_and_is_made_when_wanted() {
        let fixture = Fixture::new();
        let topics = fixture.camera("both").topics;
        for frame in 0..30 {
            let due = Due::of_wanted(&topics, frame, |_| true);
            let (image, depth) = (frame % 2 == 0, frame % 3 == 0);
            let expected = Due { image, compressed: image, cloud: depth, depth_image: depth, info: image || depth };
            assert_eq!(due, expected, "frame {frame}");
            assert!(!Due::of(&topics, frame).anything(), "nobody subscribes");
        }
    }

    #[test]
    fn one_picture_serves_image_and_depth_of_one_size() {
        let fixture = Fixture::new();
        let (image, cloud, depth_image) = (
            Due { image: true, ..Due::default() },
            Due { cloud: true, ..Due::default() },
            Due { depth_image: true, ..Due::default() },
        );
        let both = Due { image: true, cloud: true, ..Due::default() };
        let mut camera = fixture.camera("both");
        assert_eq!(fixture.requests(&mut camera, both), [((8, 6), true, true)]);
        assert_eq!(fixture.requests(&mut camera, image), [((8, 6), true, false)]);
        assert_eq!(fixture.requests(&mut camera, cloud), [((8, 6), true, true)]);
        assert_eq!(fixture.requests(&mut camera, depth_image), [((8, 6), false, true)]);
        assert_eq!(camera.numbers, vec![0.1_f32; 48]);
        let info = Due { info: true, ..Due::default() };
        assert!(fixture.requests(&mut camera, info).is_empty());
        let mut camera = fixture.camera("differing");
        assert_eq!(fixture.requests(&mut camera, both), [((8, 6), true, false), ((4, 2), true, true)]);
        assert!(camera.numbers.is_empty());
    }

    #[test]
    fn topics_are_those_that_the_camera_has_something_for() {
        let fixture = Fixture::new();
        let of = |name: &str| {
            let index = fixture.camera(name).topics.index;
            let described = &fixture.visuals.cameras[index].description;
            let (_, all) = CameraTopics::of_ros1(index, &format!("/e/{name}"), described, |topic| topic).unwrap();
            let mut all: Vec<_> = all.iter().map(|one| one.registration()).map(|r| (r.topic, r.message_type)).collect();
            all.sort();
            all
        };
        let text = |list: &[(&str, &str)]| -> Vec<(String, String)> {
            list.iter().map(|(topic, kind)| (format!("/e/{topic}"), format!("sensor_msgs/{kind}"))).collect()
        };
        let all = [
            ("both/CameraInfo", "CameraInfo"),
            ("both/DepthData", "PointCloud2"),
            ("both/DepthImage", "Image"),
            ("both/ImageData", "Image"),
            ("both/ImageData/compressed", "CompressedImage"),
        ];
        assert_eq!(of("both"), text(&all));
        assert_eq!(
            of("stereo"),
            text(&[("stereo/ImageData", "Image"), ("stereo/ImageData/compressed", "CompressedImage")])
        );
    }

    #[test]
    fn a_picture_that_fails_is_reported_once_and_tried_again() {
        let fixture = Fixture::new();
        let mut camera = fixture.camera("both");
        let due = Due { image: true, ..Due::default() };
        for _ in 0..3 {
            camera.publish(due, &fixture.visuals, &fixture.snapshot, |_, _| Err("no memory".into()));
            assert_eq!(camera.trouble, "no memory");
        }
        assert_eq!(fixture.requests(&mut camera, due).len(), 1);
    }

    #[test]
    fn jpegs_decode_to_the_picture() {
        let color = [[200, 30, 60]; 64].concat();
        let picture = Picture { width: 8, height: 8, color, ..Picture::default() };
        let mut bytes = Vec::new();
        encode(&mut bytes, &picture).unwrap();
        let decoded = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!(decoded.dimensions(), (8, 8));
        for (found, expected) in decoded.get_pixel(4, 4).0.iter().zip([200, 30, 60]) {
            assert!(found.abs_diff(expected) < 6, "{decoded:?}");
        }
    }
}
