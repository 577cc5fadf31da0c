//! Volumes: voxel data.

use std::path::PathBuf;

use nalgebra::{Isometry3, Vector3};

use super::body::{RigidBody, Surface};
use super::common::{Common, Material, ShaderProgram};
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::{beside, Base};
use crate::files::{look, Found};

/// A volume as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Identity and plugins.
    pub common: Common,
    /// Name of the parent object; empty: the world.
    pub parent: String,
    /// Pose in the parent's frame. Default: identity.
    pub location: Isometry3<f64>,
    /// Uniform scale; positive. Default: 1.
    pub scale: f64,
    /// The voxels as pictures; `None`: they are in [`nrrd`](Self::nrrd), or the volume is empty.
    pub images: Option<ImageStack>,
    /// A file with the voxels, instead of pictures, which gives edges and pose where these are not written.
    pub nrrd: Option<PathBuf>,
    /// Edge lengths, m; positive. Default: 1 each, or those of the NRRD file.
    pub dimensions: Vector3<f64>,
    /// Whether edges are written.
    pub has_dimensions: bool,
    /// Whether a pose is written.
    pub has_location: bool,
    /// What voxels of a colour are. Default: none.
    pub labels: Vec<VolumeLabel>,
    /// Whether bodies collide with the surface. `None`: they pass through it.
    pub contact: Option<VolumeContact>,
    /// Whether voxels may be cut. Default: `true`.
    pub carvable: bool,
    /// Bodies that touch and cut. Default: none.
    pub tools: Vec<VolumeTool>,
    /// Default: 0.5.
    pub iso_surface_value: f64,
    /// Default: 1.
    pub optical_density: f64,
    /// Default: 0.5.
    pub quality: f64,
    /// Material; `None`: the renderer's.
    pub material: Option<Material>,
    /// Own shaders.
    pub shaders: Option<ShaderProgram>,
}

/// How bodies collide with a volume that has no parent. One that hangs on a body is a part of that body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VolumeContact {
    /// Friction and restitution.
    pub surface: Surface,
    /// Collision groups, each 0 to 999, in file order. Default: none.
    pub groups: Vec<u32>,
}

impl VolumeContact {
    /// Key `contact`: `true`, `false`, or keys of its surface.
    fn read(map: &Map<'_>) -> Option<Self> {
        if !map.is_map("contact") {
            return map.boolean("contact").unwrap_or(false).then(Self::default);
        }
        let keys = map.map("contact");
        let contact = Self { surface: Surface::read(&keys), groups: keys.collision_groups() };
        keys.finish();
        let default = Self::default();
        if contact != default && map.is_filled("parent") {
            let (expected, action) = ("`true`", "surface and groups are those of the parent");
            map.warn(ProblemKind::IgnoredKey, "contact", expected, action);
        }
        Some(contact)
    }
}

/// What voxels of one colour are.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeLabel {
    /// Red, green and blue, 0 to 255.
    pub color: [u8; 3],
    /// Default: empty.
    pub name: String,
    /// Cost of cutting relative to other voxels; positive. Default: 1.
    pub hardness: f64,
}

impl VolumeLabel {
    fn read(map: &Map<'_>) -> Option<Self> {
        let color = map.map("color");
        let level = |key| {
            let level = color.need_real_in(key, Range::NotNegative);
            if level > 1.0 {
                color.reject(ProblemKind::OutOfRange, key, "a number from 0 to 1");
            }
            level
        };
        let levels = ["r", "g", "b"].map(level);
        color.finish();
        let label = Self {
            color: levels.map(|level| (255.0 * level).round() as u8),
            name: map.string("name").unwrap_or_default(),
            hardness: map.real_in("hardness", Range::Positive).unwrap_or(1.0),
        };
        map.finish();
        Some(label)
    }
}

/// A body whose balls touch a volume, and of which the first one cuts.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeTool {
    /// Name of the body.
    pub body: String,
    /// The ball that cuts.
    pub tip: ToolBall,
    /// Further balls, along a shaft. Default: none.
    pub cursors: Vec<ToolBall>,
    /// What it cuts while it touches, m³/s of hardness 1; not negative. Default: 0.
    pub rate: f64,
    /// Whether it cuts from the start on. Default: `true`.
    pub on: bool,
    /// N/m; positive. Default: 700.
    pub stiffness: f64,
    /// N·s/m; not negative. Default: 0.
    pub damping: f64,
    /// Coefficient of friction; not negative. Default: 0.
    pub friction: f64,
    /// Most of the force of each ball, N; positive. Default: 3.3.
    pub largest_force: f64,
    /// Tips that it can have, of which [`tip`](Self::tip) has the radius of one at the start. Default: that one only.
    pub burrs: Vec<ToolBurr>,
}

/// A tip that a tool can have.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolBurr {
    /// Name of the body that shows it where the volume lets it be; those of others are not drawn. Empty: none.
    pub body: String,
    /// m; positive.
    pub radius: f64,
    /// What it cuts while it touches, m³/s of hardness 1; not negative. Default: that of the tool.
    pub rate: f64,
    /// Voxels that it removes in every second update in which it touches, whatever they are, instead of a rate: what the
    /// C++ drilling plugin does. Default: 0, none.
    pub count: u32,
}

impl VolumeTool {
    /// Whether all numbers are as a reader lets them through.
    pub fn is_usable(&self) -> bool {
        let Self { tip, cursors, rate, stiffness, damping, friction, largest_force, burrs, body: _, on: _ } = self;
        let positive = |number: f64| number.is_finite() && number > 0.0;
        let not_negative = |number: f64| number.is_finite() && number >= 0.0;
        let mut balls = std::iter::once(tip).chain(cursors);
        balls.all(|ball| ball.position.iter().all(|c| c.is_finite()) && positive(ball.radius))
            && [stiffness, largest_force].iter().all(|&&number| positive(number))
            && [rate, damping, friction].iter().all(|&&number| not_negative(number))
            && burrs.iter().all(|burr| positive(burr.radius) && not_negative(burr.rate))
    }
}

/// A ball of a tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolBall {
    /// Centre in the body frame, m. Default: its origin.
    pub position: Vector3<f64>,
    /// m; positive.
    pub radius: f64,
}

impl ToolBall {
    fn read(map: &Map<'_>) -> Self {
        let position = map.vector("position").unwrap_or_default();
        let ball = Self { position, radius: map.need_real_in("radius", Range::Positive) };
        map.finish();
        ball
    }
}

impl VolumeTool {
    fn read(map: &Map<'_>) -> Self {
        let or = |key, range, default| map.real_in(key, range).unwrap_or(default);
        let tool = Self {
            body: map.need_string("body"),
            tip: ToolBall::read(&map.map("tip")),
            cursors: map.maps("cursors").iter().map(ToolBall::read).collect(),
            rate: or("rate", Range::NotNegative, 0.0),
            on: map.boolean("on").unwrap_or(true),
            stiffness: or("stiffness", Range::Positive, 700.0),
            damping: or("damping", Range::NotNegative, 0.0),
            friction: or("friction", Range::NotNegative, 0.0),
            largest_force: or("largest force", Range::Positive, 3.3),
            burrs: map
                .maps("burrs")
                .iter()
                .map(|burr| ToolBurr::read(burr, or("rate", Range::NotNegative, 0.0)))
                .collect(),
        };
        map.finish();
        tool
    }
}

impl ToolBurr {
    fn read(map: &Map<'_>, rate: f64) -> Self {
        let burr = Self {
            body: map.string("body").unwrap_or_default(),
            radius: map.need_real_in("radius", Range::Positive),
            rate: map.real_in("rate", Range::NotNegative).unwrap_or(rate),
            count: map.uint("count").unwrap_or(0),
        };
        map.finish();
        burr
    }
}

/// A stack of images `path/prefix<i>.format`, i from 0 to `count` (the C++ program reads one more than it counts).
#[derive(Clone, Debug, PartialEq)]
pub struct ImageStack {
    /// Directory, joined to the file's directory when it was relative.
    pub path: PathBuf,
    /// Start of each file name.
    pub prefix: String,
    /// File extension without a dot.
    pub format: String,
    /// Number of images.
    pub count: u32,
}

impl Volume {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let r = map.reader();
        let images = if map.has("images") {
            let images = r.tolerant_element("volume", || ImageStack::read(map));
            if images.is_none() {
                r.spoil();
            }
            images
        } else {
            None
        };
        let nrrd = map.path_beside("nrrd");
        if nrrd.is_some() && images.is_some() {
            map.warn(ProblemKind::IgnoredKey, "nrrd", "either `images` or `nrrd`", "`images` are used");
        }
        let dimensions = map.vector("dimensions").unwrap_or(Vector3::repeat(1.0));
        if dimensions.min() <= 0.0 && map.has("dimensions") {
            let expected = "edge lengths above 0";
            map.reject(ProblemKind::OutOfRange, "dimensions", expected);
        }
        let volume = Self {
            common: map.common(base),
            parent: map.filled("parent").unwrap_or_default(),
            location: map.pose("location").unwrap_or_default(),
            scale: map.real_in("scale", Range::Positive).unwrap_or(1.0),
            images,
            nrrd,
            dimensions,
            has_dimensions: map.has("dimensions"),
            has_location: map.has("location"),
            labels: map.maps("labels").iter().filter_map(VolumeLabel::read).collect(),
            tools: map.maps("tools").iter().map(VolumeTool::read).collect(),
            contact: VolumeContact::read(map),
            carvable: map.boolean("carvable").unwrap_or(true),
            iso_surface_value: map.real("iso-surface value").unwrap_or(0.5),
            optical_density: map.real("optical density").unwrap_or(1.0),
            quality: map.real("quality").unwrap_or(0.5),
            material: map.material(),
            shaders: map.shaders("shaders"),
        };
        map.finish();
        Some(volume)
    }

    /// The body that carries a volume with contact that has no parent, and is its parent from now on: a body without mass, of
    /// the volume's name, at its place. `None`: none is needed.
    pub(super) fn take_carrier(&mut self) -> Option<RigidBody> {
        let VolumeContact { surface, groups } = self.contact.as_ref().filter(|_| self.parent.is_empty())?;
        let own = self.common.identifier.as_str();
        // What no body of a file is called: else the volume would hang on that one.
        let identifier = format!("BODY {} (volume)", own.strip_prefix("VOLUME ").unwrap_or(own));
        let common = Common { identifier: identifier.clone(), plugins: Vec::new(), ..self.common.clone() };
        let location = std::mem::replace(&mut self.location, Isometry3::identity());
        let body = RigidBody::fixed(common, location, *surface, groups.clone());
        self.parent = identifier;
        Some(body)
    }
}

impl ImageStack {
    /// What is looked for as the image of an index: the number as it is, then with leading zeros, at most to as many
    /// digits as `count` has.
    pub fn candidates(&self, index: u32) -> impl Iterator<Item = PathBuf> + '_ {
        let digits = |number: u32| number.checked_ilog10().unwrap_or(0) as usize + 1;
        let widths = digits(index)..=digits(self.count).max(digits(index));
        widths.map(move |width| self.path.join(format!("{}{index:0width$}.{}", self.prefix, self.format)))
    }

    /// The images that are there, in order; numbers without one are skipped, and what is no file is listed, so that who
    /// reads it says so. At most `most` numbers are tried.
    pub fn files(&self, most: u32) -> Vec<PathBuf> {
        let indices = (0..=self.count).take(most as usize);
        let named = |index| self.candidates(index).map(|path| (look(&path), path)).collect::<Vec<_>>();
        let best = |found: Vec<(Found, PathBuf)>| {
            let is_file = found.iter().position(|(found, _)| *found == Found::File);
            let place = is_file.or_else(|| found.iter().position(|(found, _)| *found != Found::Nothing))?;
            found.into_iter().nth(place).map(|(_, path)| path)
        };
        indices.filter_map(|index| best(named(index))).collect()
    }

    fn read(map: &Map<'_>) -> Option<Self> {
        let images = map.map("images");
        let stack = Self {
            path: beside(map.reader().dir(), images.need_string("path")),
            prefix: images.need_string("prefix"),
            format: images.need_string("format"),
            count: images.need_uint("count"),
        };
        images.finish();
        Some(stack)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::super::Model;
    use super::*;

    #[test]
    fn images() {
        let text = "volumes: [V, W]\nV: {images: {path: p, prefix: a, format: png, count: 3}}\nW: {}\n";
        let volumes = clean::<Model>(text).volumes;
        let images = volumes[0].images.as_ref().expect("images");
        assert_eq!((images.path.to_str(), images.count), (Some("dir/p"), 3));
        assert_eq!((&volumes[1].images, volumes[1].dimensions.x), (&None, 1.0));
        assert!(volumes[1].carvable && volumes[1].labels.is_empty() && !volumes[1].has_location);
    }

    #[test]
    fn a_file_instead_of_images_and_what_colours_are() {
        let text = "volumes: [V]\nV: {nrrd: s.nrrd, carvable: false, dimensions: {x: 1, y: 2, z: 3}, \
                    labels: [{color: {r: 1, g: 0.5, b: 0}, name: nerve, hardness: 2}]}\n";
        let volume = &clean::<Model>(text).volumes[0];
        assert_eq!(volume.nrrd.as_deref(), Some(std::path::Path::new("dir/s.nrrd")));
        assert!(volume.has_dimensions && !volume.has_location && !volume.carvable);
        let nerve = VolumeLabel { color: [255, 128, 0], name: "nerve".into(), hardness: 2.0 };
        assert_eq!(volume.labels, [nerve]);
        let tool = "volumes: [V]\nV: {tools: [{body: drill, tip: {position: {x: 0, y: 0, z: 1}, radius: 0.003}, rate: 3.0e-8, \
                    cursors: [{radius: 0.001}], largest force: 2}]}\n";
        let tools = &clean::<Model>(tool).volumes[0].tools;
        assert_eq!((tools[0].body.as_str(), tools[0].tip.position.z, tools[0].rate), ("drill", 1.0, 3e-8));
        assert_eq!((tools[0].cursors.len(), tools[0].stiffness, tools[0].largest_force), (1, 700.0, 2.0));
        assert_eq!(tools[0].burrs, []);
        let burrs = "volumes: [V]\nV: {tools: [{body: drill, tip: {radius: 0.003}, rate: 3.0e-8, \
                     burrs: [{body: 6mm, radius: 0.003}, {radius: 0.001, rate: 0, count: 3}]}]}\n";
        let burr = |body: &str, radius, rate, count| ToolBurr { body: body.into(), radius, rate, count };
        let burrs = &clean::<Model>(burrs).volumes[0].tools[0].burrs;
        assert_eq!(burrs, &[burr("6mm", 0.003, 3e-8, 0), burr("", 0.001, 0.0, 3)]);
        let wrong = "volumes: [V]\nV: {labels: [{color: {r: 2, g: 0, b: 0}, hardness: 0}]}\nbodies: []\n";
        assert!(read::<Model>(wrong).1.len() >= 2);
    }

    #[test]
    fn numbers_may_have_leading_zeros_and_gaps() {
        let folder = tempfile::tempdir().expect("a folder");
        let stack = |count| ImageStack { path: folder.path().into(), prefix: "p".into(), format: "png".into(), count };
        for name in ["p000.png", "p1.png", "p03.png", "p100.png", "p0004.png", "p101.png"] {
            std::fs::write(folder.path().join(name), "").expect("a file");
        }
        let names = |stack: ImageStack, most| -> Vec<String> {
            let name = |path: PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
            stack.files(most).into_iter().filter_map(name).collect()
        };
        assert_eq!(names(stack(100), 1000), ["p000.png", "p1.png", "p03.png", "p100.png"]);
        assert_eq!(names(stack(100), 3), ["p000.png", "p1.png"]);
        assert_eq!(names(stack(0), 1000), [""; 0], "count 0 has one digit");
    }

    #[test]
    fn contact_makes_a_body_where_there_is_no_parent() {
        let place = "location: {position: {x: 1, y: 2, z: 3}}";
        let text = format!(
            "volumes: [VOLUME v, W, X]\nbodies: [B]\nB: {{mass: 0}}\n\
             VOLUME v: {{name: v, {place}, contact: {{friction: {{static: 0.2}}, restitution: 0, collision groups: [3]}}}}\n\
             W: {{contact: true, parent: B, {place}}}\nX: {{contact: false, {place}}}\n"
        );
        let model = clean::<Model>(&text);
        let [body, carrier] = &model.bodies[..] else { panic!("{:?}", model.bodies) };
        assert_eq!((body.common.identifier.as_str(), carrier.common.identifier.as_str()), ("B", "BODY v (volume)"));
        assert_eq!((carrier.common.name.as_str(), carrier.mass, &carrier.collision_groups), ("v", 0.0, &vec![3]));
        assert_eq!((carrier.surface.static_friction, carrier.surface.restitution), (0.2, 0.0));
        assert_eq!(carrier.location.translation.vector, Vector3::new(1.0, 2.0, 3.0));
        let [v, w, x] = &model.volumes[..] else { panic!() };
        assert_eq!((v.parent.as_str(), v.location, v.has_location), ("BODY v (volume)", Isometry3::identity(), true));
        assert_eq!(
            (w.parent.as_str(), &w.contact, w.location.translation.x),
            ("B", &Some(VolumeContact::default()), 1.0)
        );
        assert_eq!((x.parent.as_str(), &x.contact), ("", &None));
        let text = "volumes: [V]\nbodies: [B]\nB: {mass: 0}\nV: {parent: B, contact: {restitution: 0}}\n";
        let (_, problems) = read::<Model>(text);
        assert!(problems[0].contains("`V / contact`") && problems[0].contains("those of the parent"), "{problems:?}");
    }

    #[test]
    fn wrong_images_drop_only_the_volume() {
        let text =
            "volumes: [V, W]\nV: {images: {path: p, count: x}}\nW: {dimensions: {x: 1, y: 0, z: 1}}\nbodies: []\n";
        let (model, problems) = read::<Model>(text);
        assert!(model.volumes.is_empty());
        assert_eq!(problems.len(), 4, "{problems:#?}");
        assert!(problems.iter().all(|p| p.ends_with("the volume is dropped")));
    }
}
