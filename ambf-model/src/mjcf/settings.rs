//! Sections `compiler` and `option`: how the rest of the file is meant.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, Unit, UnitQuaternion, Vector3};

use super::source::written_path;
use crate::adf::{ProblemKind, Severity};
use crate::xml::{quoted, Element};

/// Why settings of MuJoCo's soft constraints and solver have no effect.
const SOLVER: &str = "it concerns MuJoCo's solver: constraints are not soft here";

/// When masses follow from geoms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FromGeoms {
    /// Where there is no `inertial`.
    Auto,
    Always,
    Never,
}

/// Section `compiler`.
#[derive(Debug, Clone)]
pub(super) struct Compiler {
    pub is_degree: bool,
    /// Axes of `euler`; lower case: those of the turned frame.
    pub euler_axes: [char; 3],
    pub auto_limits: bool,
    pub from_geoms: FromGeoms,
    /// Groups of geoms that have a mass.
    pub mass_groups: [f64; 2],
    /// Least mass, kg, and least moment, kg·m², of bodies that move.
    pub least_mass: f64,
    pub least_moment: f64,
    /// Mass of all bodies together, kg; not above 0: as they are.
    pub total_mass: f64,
    /// Moments against the triangle inequality become their mean.
    pub balances: bool,
    pub mesh_folder: PathBuf,
    pub strips_paths: bool,
}

impl Default for Compiler {
    fn default() -> Self {
        Self {
            is_degree: true,
            euler_axes: ['x', 'y', 'z'],
            auto_limits: true,
            from_geoms: FromGeoms::Auto,
            mass_groups: [0.0, 5.0],
            least_mass: 0.0,
            least_moment: 0.0,
            total_mass: -1.0,
            balances: false,
            mesh_folder: PathBuf::new(),
            strips_paths: false,
        }
    }
}

/// The value of an attribute that is one of a few words; `None` when it is absent or was reported.
pub(super) fn choice<T: Copy>(element: &Element<'_>, name: &'static str, words: &[(&str, T)]) -> Option<T> {
    let text = element.attribute(name)?;
    let found = words.iter().find(|(word, _)| *word == text).map(|(_, value)| *value);
    if found.is_none() {
        let expected = words.iter().map(|(word, _)| *word).collect::<Vec<_>>().join(", ");
        element.problem(Severity::Fatal, ProblemKind::UnknownValue, name, &quoted(text), &expected, "");
    }
    found
}

pub(super) const BOOLEANS: [(&str, bool); 2] = [("true", true), ("false", false)];

/// Names what of an element has no effect: attributes that are not known, and those in `unused`, in a word why.
pub(super) fn finish(element: &Element<'_>, read: &[&str], unused: &[(&str, &[&str])], inside: &[&str]) {
    let known: Vec<&str> = read.iter().chain(unused.iter().flat_map(|(_, names)| *names)).copied().collect();
    element.finish(&known, &[inside, &["include"]].concat());
    for name in element.attribute_names() {
        for (why, _) in unused.iter().filter(|(_, names)| names.contains(&name)) {
            element.problem(Severity::Info, ProblemKind::IgnoredKey, name, "", "", why);
        }
    }
}

/// Attributes of MuJoCo's solver that elements have.
pub(super) const SOFT: (&str, &[&str]) = (
    SOLVER,
    &["solref", "solimp", "solmix", "solreflimit", "solimplimit", "solreffriction", "solimpfriction", "margin", "gap"],
);

impl Compiler {
    /// Takes over what one section says. `file`: the main one.
    pub fn apply(&mut self, element: &Element<'_>, file: &Path) {
        let read = [
            "angle",
            "eulerseq",
            "autolimits",
            "inertiafromgeom",
            "inertiagrouprange",
            "boundmass",
            "boundinertia",
            "settotalmass",
            "balanceinertia",
            "meshdir",
            "assetdir",
            "texturedir",
            "strippath",
            "coordinate",
        ];
        let alike =
            ["usethread", "discardvisual", "fusestatic", "saveinertial", "alignfree", "savecompiled", "savecanonical"];
        let unused = [
            ("it changes how MuJoCo keeps the model, not what the model is", &alike[..]),
            ("only capsules, boxes and so on that are given are used", &["fitaabb"][..]),
            ("attached models are not read", &["conflict", "passthrough"][..]),
        ];
        finish(element, &read, &unused, &["lengthrange"]);
        if let Some(is_degree) = choice(element, "angle", &[("degree", true), ("radian", false)]) {
            self.is_degree = is_degree;
        }
        if let Some(text) = element.attribute("eulerseq") {
            let axes: Vec<char> = text.chars().take(4).collect();
            match <[char; 3]>::try_from(axes) {
                Ok(axes) if axes.iter().all(|axis| "xyzXYZ".contains(*axis)) => self.euler_axes = axes,
                _ => {
                    let expected = "three of x, y, z, X, Y, Z";
                    element.problem(
                        Severity::Fatal,
                        ProblemKind::UnknownValue,
                        "eulerseq",
                        &quoted(text),
                        expected,
                        "",
                    );
                }
            }
        }
        let words = [("auto", FromGeoms::Auto), ("true", FromGeoms::Always), ("false", FromGeoms::Never)];
        self.from_geoms = choice(element, "inertiafromgeom", &words).unwrap_or(self.from_geoms);
        self.auto_limits = choice(element, "autolimits", &BOOLEANS).unwrap_or(self.auto_limits);
        self.balances = choice(element, "balanceinertia", &BOOLEANS).unwrap_or(self.balances);
        self.strips_paths = choice(element, "strippath", &BOOLEANS).unwrap_or(self.strips_paths);
        self.mass_groups = element.numbers("inertiagrouprange").unwrap_or(self.mass_groups);
        self.least_mass = element.real("boundmass").unwrap_or(self.least_mass);
        self.least_moment = element.real("boundinertia").unwrap_or(self.least_moment);
        self.total_mass = element.real("settotalmass").unwrap_or(self.total_mass);
        let beside = |folder| file.parent().unwrap_or(Path::new("")).join(written_path(folder));
        let folder = |name| element.attribute(name).map(beside);
        if let Some(folder) = folder("meshdir").or_else(|| folder("assetdir")) {
            self.mesh_folder = folder;
        }
        if element.attribute("coordinate") == Some("global") {
            let expected = "local; MuJoCo has not read global ones since version 2.3.4";
            element.problem(Severity::Fatal, ProblemKind::UnknownValue, "coordinate", "`global`", expected, "");
        }
    }

    /// An angle as written, in rad.
    pub fn angle(&self, written: f64) -> f64 {
        match self.is_degree {
            true => written.to_radians(),
            false => written,
        }
    }

    /// Orientation of an element by whichever of `quat`, `axisangle`, `xyaxes`, `zaxis`, `euler` it has; `None`: by none.
    pub fn orientation(&self, element: &Element<'_>) -> Option<UnitQuaternion<f64>> {
        let names = ["quat", "axisangle", "xyaxes", "zaxis", "euler"];
        let mut given = names.into_iter().filter(|name| element.attribute(name).is_some());
        let name = given.next()?;
        if let Some(second) = given.next() {
            element.error(ProblemKind::DuplicateKey, second, "", "", &format!("`{name}` says the orientation"));
        }
        let found = match name {
            "quat" => {
                let [w, x, y, z] = element.numbers("quat")?;
                UnitQuaternion::try_new(Quaternion::new(w, x, y, z), f64::MIN_POSITIVE)
            }
            "axisangle" => {
                let [x, y, z, angle] = element.numbers("axisangle")?;
                direction([x, y, z]).map(|axis| UnitQuaternion::from_axis_angle(&axis, self.angle(angle)))
            }
            "xyaxes" => {
                let [a, b, c, d, e, f] = element.numbers("xyaxes")?;
                frame_of([a, b, c], [d, e, f])
            }
            "zaxis" => z_to(element.numbers("zaxis")?),
            _ => {
                let angles: [f64; 3] = element.numbers("euler")?;
                let turns = angles.iter().zip(&self.euler_axes);
                Some(turns.fold(UnitQuaternion::identity(), |turned, (angle, axis)| {
                    let index = match axis.to_ascii_lowercase() {
                        'x' => 0,
                        'y' => 1,
                        _ => 2,
                    };
                    let about = Unit::new_unchecked(Vector3::ith(index, 1.0));
                    let turn = UnitQuaternion::from_axis_angle(&about, self.angle(*angle));
                    if axis.is_lowercase() {
                        turned * turn
                    } else {
                        turn * turned
                    }
                }))
            }
        };
        let found = found.filter(|rotation| rotation.coords.iter().all(|number| number.is_finite()));
        if found.is_none() {
            let text = quoted(element.attribute(name).unwrap_or_default());
            element.error(
                ProblemKind::OutOfRange,
                name,
                &text,
                "a direction or orientation",
                "the element is not turned",
            );
        }
        found
    }

    /// `pos` and orientation of an element; each is that of `default` where it is not given.
    pub fn pose(&self, element: &Element<'_>, default: Isometry3<f64>) -> Isometry3<f64> {
        let position = element.vector("pos").map_or(default.translation, Into::into);
        Isometry3::from_parts(position, self.orientation(element).unwrap_or(default.rotation))
    }
}

/// Attributes of [`Compiler::pose`].
pub(super) const POSE: [&str; 6] = ["pos", "quat", "axisangle", "xyaxes", "zaxis", "euler"];

/// The direction of a vector; `None` of one without a length.
pub(super) fn direction(vector: [f64; 3]) -> Option<Unit<Vector3<f64>>> {
    let vector = Vector3::from(vector);
    // Scaled first: the squares of small and large numbers are none.
    let size = vector.amax();
    if size == 0.0 {
        return None;
    }
    Unit::try_new(vector / size, 0.5).filter(|unit| unit.iter().all(|number| number.is_finite()))
}

fn frame_of(x: [f64; 3], y: [f64; 3]) -> Option<UnitQuaternion<f64>> {
    let (x, y) = (direction(x)?, direction(y)?);
    let y = direction((y.into_inner() - x.into_inner() * x.dot(&y)).into())?;
    let axes = Matrix3::from_columns(&[x.into_inner(), y.into_inner(), x.cross(&y)]);
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)))
}

/// The least turn of the z axis into a direction; of half a turn, that about x.
pub(super) fn z_to(vector: [f64; 3]) -> Option<UnitQuaternion<f64>> {
    let to = direction(vector)?;
    let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Some(UnitQuaternion::rotation_between(&Vector3::z(), &to).unwrap_or_else(half_turn))
}

/// Section `option`.
#[derive(Debug, Clone)]
pub(super) struct Options {
    /// m/s².
    pub gravity: Vector3<f64>,
    pub has_contacts: bool,
    pub has_equalities: bool,
    pub has_limits: bool,
    pub has_actuators: bool,
    pub has_springs: bool,
    pub has_damping: bool,
    pub has_friction: bool,
    /// Links that a joint connects do not collide.
    pub filters_parents: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            gravity: Vector3::new(0.0, 0.0, -9.81),
            has_contacts: true,
            has_equalities: true,
            has_limits: true,
            has_actuators: true,
            has_springs: true,
            has_damping: true,
            has_friction: true,
            filters_parents: true,
        }
    }
}

impl Options {
    pub fn apply(&mut self, element: &Element<'_>) {
        let solver = [
            "actuatorgroupdisable",
            "ccd_iterations",
            "ccd_tolerance",
            "cone",
            "impratio",
            "integrator",
            "iterations",
            "jacobian",
            "ls_iterations",
            "ls_tolerance",
            "noslip_iterations",
            "noslip_tolerance",
            "o_friction",
            "o_margin",
            "o_solimp",
            "o_solref",
            "sdf_initpoints",
            "sdf_iterations",
            "sleep_tolerance",
            "solver",
            "tolerance",
            "apirate",
            "mpr_iterations",
            "mpr_tolerance",
            "collision",
        ];
        let unused = [
            (SOLVER, &solver[..]),
            ("sub-steps are those of the world file, the command line or the caller", &["timestep"][..]),
        ];
        finish(element, &["gravity", "density", "viscosity", "wind", "magnetic"], &unused, &["flag"]);
        self.gravity = element.vector("gravity").unwrap_or(self.gravity);
        for medium in ["density", "viscosity", "wind", "magnetic"] {
            if element.numbers_in(medium, 1..=3).is_some_and(|numbers| numbers.iter().any(|number| *number != 0.0)) {
                element.ignored(medium, "there is neither air, water nor a magnetic field here");
            }
        }
        for flag in element.children("flag") {
            self.apply_flags(&flag);
        }
    }

    fn apply_flags(&mut self, flag: &Element<'_>) {
        let switch = |name| choice(flag, name, &[("enable", true), ("disable", false)]);
        let mut known = vec!["constraint", "gravity"];
        let is_constrained = switch("constraint") != Some(false);
        let mut take = |name: &'static str, has: &mut bool, needs_constraints: bool| {
            known.push(name);
            *has = switch(name).unwrap_or(*has) && (is_constrained || !needs_constraints);
        };
        take("contact", &mut self.has_contacts, true);
        take("equality", &mut self.has_equalities, true);
        take("limit", &mut self.has_limits, true);
        take("frictionloss", &mut self.has_friction, true);
        take("actuation", &mut self.has_actuators, false);
        take("spring", &mut self.has_springs, false);
        take("damper", &mut self.has_damping, false);
        take("filterparent", &mut self.filters_parents, false);
        if let Some(is_passive) = switch("passive") {
            (self.has_springs, self.has_damping) = (self.has_springs && is_passive, self.has_damping && is_passive);
        }
        known.push("passive");
        if switch("gravity") == Some(false) {
            self.gravity = Vector3::zeros();
        }
        let solver = [
            "autoreset",
            "clampctrl",
            "diagexact",
            "energy",
            "eulerdamp",
            "fwdinv",
            "invdiscrete",
            "ipc",
            "island",
            "midphase",
            "multiccd",
            "nativeccd",
            "override",
            "refsafe",
            "sensor",
            "sleep",
            "speculative",
            "warmstart",
        ];
        finish(flag, &known, &[(SOLVER, &solver[..])], &[]);
    }
}
