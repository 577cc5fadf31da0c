//! The tree of bodies.

use std::collections::{HashMap, HashSet};

use nalgebra::{Isometry3, Vector3};

use super::asset::Assets;
use super::classes::Classes;
use super::contact::Place;
use super::geom::Geom;
use super::joint::{Joint, Kind};
use super::mass::Mass;
use super::settings::{choice, finish, Compiler, FromGeoms, BOOLEANS, POSE};
use super::source::Source;
use crate::adf::{ProblemKind, Severity};
use crate::inertia::diagonalised;
use crate::xml::{quoted, Element};

/// A place on a body.
#[derive(Clone, Copy)]
pub(super) struct Site {
    pub body: usize,
    /// In the body's frame.
    pub pose: Isometry3<f64>,
}

/// A body as written.
pub(super) struct Body<'a> {
    pub name: String,
    pub element: Element<'a>,
    /// Index; the world's own is 0.
    pub parent: usize,
    /// In the parent's frame, as written.
    pub in_parent: Isometry3<f64>,
    pub in_world: Isometry3<f64>,
    pub joints: Vec<Joint<'a>>,
    pub geoms: Vec<Geom<'a>>,
    /// In the body's frame; mass 0: none.
    pub mass: Mass,
    /// Moments, kg·m², and their axes in the body's frame. Those of points may be 0, and so are all that were given and are of no use.
    pub principal: Option<(Vector3<f64>, Isometry3<f64>)>,
    /// Does not move.
    pub is_static: bool,
    /// Share of its weight that is taken away.
    pub lift: f64,
}

impl Body<'_> {
    /// Whether it moves freely.
    pub fn is_free(&self) -> bool {
        self.joints.iter().any(|joint| joint.kind == Kind::Free)
    }
}

/// What the worldbody holds.
pub(super) struct Bodies<'a> {
    /// The world first; each after its parent.
    pub all: Vec<Body<'a>>,
    pub by_name: HashMap<String, usize>,
    pub sites: HashMap<&'a str, Site>,
    /// Cameras and lights: element, body, pose of the frame around it, class of the children.
    pub views: Vec<(Element<'a>, usize, Isometry3<f64>, Option<&'a str>)>,
    /// Joints by name: whether they have one coordinate.
    pub joints: HashMap<String, bool>,
    /// Geoms by name.
    pub geoms: HashMap<String, Place>,
    written: Written<'a>,
}

/// Names that the file gives: what has none gets others, also where the file gives them further down.
#[derive(Default)]
struct Written<'a> {
    bodies: HashSet<&'a str>,
    joints: HashSet<&'a str>,
}

/// What reading bodies needs.
pub(super) struct Reading<'r, 'a> {
    pub source: &'r Source<'a>,
    pub classes: &'r Classes<'a>,
    pub assets: &'r Assets<'a>,
    pub compiler: &'r Compiler,
}

/// What a body may hold.
const INSIDE: [&str; 14] = [
    "body",
    "inertial",
    "joint",
    "freejoint",
    "geom",
    "site",
    "camera",
    "light",
    "frame",
    "attach",
    "composite",
    "flexcomp",
    "replicate",
    "plugin",
];

impl<'a> Reading<'_, 'a> {
    pub fn bodies(&self, sections: &[Element<'a>]) -> Bodies<'a> {
        let mut bodies = Bodies {
            all: Vec::new(),
            by_name: HashMap::new(),
            sites: HashMap::new(),
            views: Vec::new(),
            joints: HashMap::new(),
            geoms: HashMap::new(),
            written: self.written(sections),
        };
        let Some(first) = sections.first() else { return bodies };
        bodies.all.push(Body {
            name: "world".into(),
            element: *first,
            parent: 0,
            in_parent: Isometry3::identity(),
            in_world: Isometry3::identity(),
            joints: Vec::new(),
            geoms: Vec::new(),
            mass: Mass::default(),
            principal: None,
            is_static: true,
            lift: 0.0,
        });
        bodies.by_name.insert("world".into(), 0);
        // Bodies may lie in bodies without end: no recursion.
        let mut waiting: Vec<(Element<'a>, usize, Isometry3<f64>, Option<&'a str>)> = Vec::new();
        for section in sections {
            let mut own = Vec::new();
            self.contents(section, 0, &mut bodies, None, &mut own);
            waiting.extend(own);
        }
        waiting.reverse();
        while let Some((element, parent, outer, class)) = waiting.pop() {
            let class = element.attribute("childclass").or(class);
            let index = self.body(element, parent, &outer, &mut bodies);
            let mut own = Vec::new();
            self.contents(&element, index, &mut bodies, class, &mut own);
            self.complete(&mut bodies.all, index);
            waiting.extend(own.into_iter().rev());
        }
        bodies
    }

    /// The names of all bodies and joints that are read.
    fn written(&self, sections: &[Element<'a>]) -> Written<'a> {
        let mut written = Written::default();
        let mut waiting = sections.to_vec();
        while let Some(around) = waiting.pop() {
            for element in self.source.elements(&around) {
                let name = element.attribute("name");
                match element.tag() {
                    "body" => written.bodies.extend(name),
                    "joint" | "freejoint" => written.joints.extend(name),
                    "frame" => (),
                    _ => continue,
                }
                waiting.push(element);
            }
        }
        written
    }

    fn body(&self, element: Element<'a>, parent: usize, outer: &Isometry3<f64>, bodies: &mut Bodies<'a>) -> usize {
        let read = [&["name", "childclass", "mocap", "gravcomp"][..], &POSE].concat();
        let unused = [("it changes nothing that moves", &["user", "sleep", "simple", "fuse"][..])];
        finish(&element, &read, &unused, &INSIDE);
        self.classes.check(&element, "childclass");
        let index = bodies.all.len();
        let name = unique(&bodies.by_name, &bodies.written.bodies, &element, index);
        bodies.by_name.insert(name.clone(), index);
        let in_parent = outer * self.compiler.pose(&element, Isometry3::identity());
        let in_world = bodies.all[parent].in_world * in_parent;
        if choice(&element, "mocap", &BOOLEANS) == Some(true) && parent != 0 {
            element.error(
                ProblemKind::Structure,
                "mocap",
                "inside another body",
                "a body of the world",
                "it is fixed there",
            );
        }
        bodies.all.push(Body {
            name,
            element,
            parent,
            in_parent,
            in_world,
            joints: Vec::new(),
            geoms: Vec::new(),
            mass: Mass::default(),
            principal: None,
            is_static: false,
            lift: element.real("gravcomp").unwrap_or(0.0),
        });
        index
    }

    /// Reads what is in a body or the world, also in frames there, in the order of the file; bodies inside are put into `inside`.
    fn contents(
        &self,
        element: &Element<'a>,
        index: usize,
        bodies: &mut Bodies<'a>,
        class: Option<&'a str>,
        inside: &mut Vec<(Element<'a>, usize, Isometry3<f64>, Option<&'a str>)>,
    ) {
        if index == 0 {
            finish(element, &["name"], &[], &INSIDE);
        }
        // Each element with the pose of the frame around it. Frames may lie in frames without end: no recursion.
        let inside_of = |around: &Element<'a>, outer: Isometry3<f64>, class: Option<&'a str>| {
            self.source.elements(around).into_iter().rev().map(move |element| (element, outer, class))
        };
        let mut waiting: Vec<_> = inside_of(element, Isometry3::identity(), class).collect();
        let mut inertials = Vec::new();
        let has_inertial = element.children("inertial").next().is_some();
        while let Some((element, outer, class)) = waiting.pop() {
            match element.tag() {
                "body" => inside.push((element, index, outer, class)),
                "inertial" => inertials.push((element, outer)),
                "joint" | "freejoint" => self.joint(element, index, &outer, bodies, class),
                "geom" => self.geom(element, index, &outer, bodies, (class, has_inertial)),
                "site" => {
                    let pose = outer * self.compiler.pose(&element, Isometry3::identity());
                    if let Some(name) = element.attribute("name") {
                        bodies.sites.insert(name, Site { body: index, pose });
                    }
                }
                "camera" | "light" => bodies.views.push((element, index, outer, class)),
                "frame" => {
                    finish(&element, &[&["name", "childclass"][..], &POSE].concat(), &[], &INSIDE);
                    self.classes.check(&element, "childclass");
                    let pose = outer * self.compiler.pose(&element, Isometry3::identity());
                    waiting.extend(inside_of(&element, pose, element.attribute("childclass").or(class)));
                }
                tag @ ("attach" | "composite" | "flexcomp" | "replicate" | "plugin") => {
                    element.error(ProblemKind::IgnoredKey, "", "", "", &format!("the {tag} is left out"));
                }
                _ => (),
            }
        }
        if let Some((element, outer)) = inertials.first() {
            for (second, _) in &inertials[1..] {
                second.problem(Severity::Warning, ProblemKind::DuplicateKey, "", "", "", "the first counts");
            }
            self.inertial(element, outer, &mut bodies.all[index]);
        }
    }

    fn joint(
        &self,
        element: Element<'a>,
        index: usize,
        outer: &Isometry3<f64>,
        bodies: &mut Bodies<'a>,
        class: Option<&'a str>,
    ) {
        if index == 0 {
            element.error(ProblemKind::Structure, "", "is a joint of the world", "", "it is left out");
            return;
        }
        let count = bodies.all[index].joints.len();
        let is_free = element.tag() == "freejoint";
        let mut text = if is_free { Default::default() } else { self.classes.of(&element, class).joint.clone() };
        if is_free {
            finish(&element, &["name"], &[("it changes nothing that moves", &["group", "align"][..])], &[]);
            text.kind = Kind::Free;
        } else {
            text.apply(&element);
        }
        if bodies.all[index].is_free() || (text.kind == Kind::Free && (count > 0 || bodies.all[index].parent != 0)) {
            let expected = "a free joint as the only joint of a body of the world";
            element.error(
                ProblemKind::Structure,
                "",
                "is a joint beside another one, or inside",
                expected,
                "it is left out",
            );
            return;
        }
        let default = format!("{}_joint{}", bodies.all[index].name, count);
        let name = match element.attribute("name") {
            Some(_) => element.need_name("name", "a name").to_owned(),
            None => free(default, |name| bodies.joints.contains_key(name) || bodies.written.joints.contains(name)),
        };
        let joint = Joint::new(element, name, &text, outer, self.compiler);
        if bodies.joints.insert(joint.name.clone(), joint.has_coordinate()).is_some() {
            let found = format!("is not the first joint called {}", quoted(&joint.name));
            element.error(ProblemKind::Structure, "name", &found, "", "what names it means the last one");
        }
        bodies.all[index].joints.push(joint);
    }

    fn geom(
        &self,
        element: Element<'a>,
        index: usize,
        outer: &Isometry3<f64>,
        bodies: &mut Bodies<'a>,
        (class, has_inertial): (Option<&'a str>, bool),
    ) {
        let mut text = self.classes.of(&element, class).geom.clone();
        text.apply(&element, self.compiler);
        let [low, high] = self.compiler.mass_groups;
        let weighs = (low..=high).contains(&text.group) && self.compiler.from_geoms != FromGeoms::Never;
        let needs_mass = index != 0 && weighs && (self.compiler.from_geoms == FromGeoms::Always || !has_inertial);
        if let Some(mut geom) = Geom::new(element, text, outer, self.assets, needs_mass) {
            geom.mass = geom.mass.filter(|_| weighs);
            if let Some(name) = &geom.name {
                bodies.geoms.insert(name.clone(), (index, bodies.all[index].geoms.len()));
            }
            bodies.all[index].geoms.push(geom);
        }
    }

    fn inertial(&self, element: &Element<'a>, outer: &Isometry3<f64>, body: &mut Body<'a>) {
        let read = [&["mass", "diaginertia", "fullinertia"][..], &POSE].concat();
        finish(element, &read, &[], &[]);
        let pose = outer * self.compiler.pose(element, Isometry3::identity());
        let Some(mass) = element.need_real("mass") else { return };
        if mass < 0.0 {
            element.error(ProblemKind::OutOfRange, "mass", &mass.to_string(), "a mass in kg, at least 0", "0 is used");
        }
        body.mass.mass = mass.max(0.0);
        let full: Option<[f64; 6]> = element.numbers("fullinertia");
        let (moments, axes) = match full {
            Some([xx, yy, zz, xy, xz, yz]) => diagonalised(nalgebra::Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)),
            None => (element.vector("diaginertia").unwrap_or_default(), nalgebra::Rotation3::identity()),
        };
        let key = if full.is_some() { "fullinertia" } else { "diaginertia" };
        // What a joint carries needs a moment of its own; a mass that is fixed to another body may be a point.
        let is_point = moments.min() == 0.0 && (body.joints.is_empty() || body.mass.mass == 0.0);
        if moments.min() <= 0.0 && !is_point {
            let found = format!("the principal moments {:.3e}, {:.3e}, {:.3e}", moments.x, moments.y, moments.z);
            let is_fixed = body.joints.is_empty();
            let action = if is_fixed { "they are 0" } else { "it is estimated from the shapes that collide" };
            element.error(ProblemKind::OutOfRange, key, &found, "three moments above 0", action);
            body.principal = Some((Vector3::zeros(), pose));
            return;
        }
        let axes = nalgebra::UnitQuaternion::from_rotation_matrix(&axes);
        body.principal = Some((moments, pose * axes));
    }

    /// Completes a body whose contents are read.
    fn complete(&self, all: &mut [Body<'a>], index: usize) {
        let parent_is_static = all[all[index].parent].is_static;
        let body = &mut all[index];
        body.is_static = parent_is_static && body.joints.is_empty();
        let parts: Vec<Mass> = body.geoms.iter().filter_map(|geom| geom.mass).collect();
        let of_geoms = Mass::sum(&parts);
        if of_geoms.mass > 0.0 && (body.principal.is_none() || self.compiler.from_geoms == FromGeoms::Always) {
            (body.mass, body.principal) = (of_geoms, Some(of_geoms.principal()));
        }
        let is_usable = |number: f64| number == 0.0 || number > 0.0 && number.is_finite() && number.recip().is_finite();
        let moments = body.principal.map_or(Vector3::zeros(), |(moments, _)| moments);
        let place = body.principal.map_or(Vector3::zeros(), |(_, pose)| pose.translation.vector);
        let is_place = place.iter().all(|number| number.is_finite());
        if !(is_usable(body.mass.mass) && moments.iter().all(|moment| is_usable(*moment)) && is_place) {
            let [x, y, z]: [f64; 3] = moments.into();
            let found = format!("{:.1e} kg with the principal moments {x:.1e}, {y:.1e}, {z:.1e}", body.mass.mass);
            let expected = "numbers that can be divided by";
            body.element.error(ProblemKind::OutOfRange, "inertial", &found, expected, "the body has no mass");
            (body.mass, body.principal) = (Mass::default(), None);
        }
        let Compiler { least_mass, least_moment, .. } = *self.compiler;
        if body.principal.is_none() && (least_mass > 0.0 || least_moment > 0.0) {
            // Where MuJoCo has the centre of mass of a body that says nothing of it: as far from its frame as that is from the parent's.
            body.principal = Some((Vector3::zeros(), body.in_parent));
        }
        if let Some((moments, _)) = &mut body.principal {
            body.mass.mass = body.mass.mass.max(least_mass);
            *moments = moments.map(|moment| moment.max(least_moment));
            let misses = 2.0 * moments.max() > moments.sum() * (1.0 + ROUNDING);
            if self.compiler.balances && misses {
                *moments = Vector3::repeat(moments.mean());
            }
        }
    }
}

/// Share by which the numbers of a file may miss the sum of two moments.
const ROUNDING: f64 = 1e-6;

/// Name of a body: the written one, or else one that the file gives to no other; so, too, with an error, if it is taken.
fn unique(names: &HashMap<String, usize>, written: &HashSet<&str>, element: &Element<'_>, index: usize) -> String {
    let is_taken = |name: &str| names.contains_key(name) || written.contains(name);
    if element.attribute("name").is_none() {
        return free(format!("body{index}"), is_taken);
    }
    let name = element.need_name("name", "a name");
    if !names.contains_key(name) {
        return name.to_owned();
    }
    let found = format!("is not the first {} called {}", element.tag(), quoted(name));
    element.error(ProblemKind::Structure, "name", &found, "", "it gets another name");
    // Indices are not repeated.
    free(format!("{name}_{index}"), is_taken)
}

/// A name, made longer until it is not taken.
pub(super) fn free(mut name: String, is_taken: impl Fn(&str) -> bool) -> String {
    while is_taken(&name) {
        name.push('_');
    }
    name
}
