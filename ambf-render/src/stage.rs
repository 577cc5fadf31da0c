//! What of a scene is on the graphics card, and what is drawn besides its objects.

use nalgebra::Isometry3;

/// A scene as a renderer draws it: loaded meshes, poses, and what a user wants to see besides.
#[derive(Default)]
pub struct Stage {
    /// Frames (axes) of all objects are drawn.
    pub frames: bool,
    /// Objects whose frames are the other way round than [`frames`](Self::frames) says, by qualified identifier.
    pub own_frames: std::collections::BTreeSet<String>,
    /// Sensors are drawn: `None`: those that are visible by their description.
    pub sensors: Option<bool>,
    /// Actuators are drawn: `None`: those that are visible by their description.
    pub actuators: Option<bool>,
    /// Collision shapes are drawn as wire frames.
    pub collision_shapes: bool,
    /// What is drawn besides the objects of the scene.
    pub markers: Vec<Marker>,
    /// A body in another colour.
    pub highlight: Option<Highlight>,
    /// Normal maps are used; switched by Shift+N.
    pub normal_maps_off: bool,
}

/// A rigid body that is drawn in another colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Highlight {
    /// Index of the body.
    pub body: usize,
    /// Red, green, blue, 0 to 1.
    pub color: [f32; 3],
}

/// Something that is drawn besides the objects of the scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Marker {
    /// What.
    pub shape: MarkerShape,
    /// Pose in the world.
    pub pose: Isometry3<f64>,
    /// Red, green, blue, alpha, 0 to 1.
    pub color: [f32; 4],
}

/// Shape of a [`Marker`].
#[derive(Debug, Clone, PartialEq)]
pub enum MarkerShape {
    /// A ball of this radius, m.
    Sphere(f32),
    /// A box of these full edge lengths, m.
    Box([f32; 3]),
    /// An arrow along +x: length and radius of the shaft, m.
    Arrow(f32, f32),
    /// Three arrows of this length, m: x red, y green, z blue; the colour is not used.
    Frame(f32),
    /// Square points of this size in pixels, unlit.
    Points(Vec<[f32; 3]>, f32),
    /// Lines between successive pairs of points, unlit, one pixel wide.
    Lines(Vec<[f32; 3]>),
}

impl Stage {
    /// Qualified identifier of the object whose id is `id` in a picture; `None` for 0 and what is no object.
    pub fn id_name(&self, id: u32) -> Option<&str> {
        let _ = id;
        None
    }
}
