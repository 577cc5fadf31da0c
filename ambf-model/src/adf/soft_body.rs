//! Soft bodies and ghost objects.

use std::path::PathBuf;

use nalgebra::Isometry3;

use super::common::Common;
use super::geometry::{collision_mesh, Visual};
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::Base;

/// A soft body as written.
#[derive(Clone, Debug, PartialEq)]
pub struct SoftBody {
    /// Identity, communication and plugins.
    pub common: Common,
    /// Initial pose in the world. Default: identity.
    pub location: Isometry3<f64>,
    /// Uniform scale of the meshes; positive. Default: 1.
    pub scale: f64,
    /// Total mass, kg, not negative. Default: 1.
    pub mass: f64,
    /// Appearance.
    pub visual: Visual,
    /// The mesh that is simulated; absolute or relative to the working directory; not looked for yet.
    pub collision_mesh: PathBuf,
    /// Collision margin, m, not negative. Default: 0.001.
    pub collision_margin: f64,
    /// Randomise the order of the constraints once: the key is present, whatever its value.
    pub randomize_constraints: bool,
    /// Solver and material parameters.
    pub config: SoftBodyConfig,
}

/// Bullet's parameters of a soft body under Bullet's names. The default is Bullet's.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(non_snake_case)] // Bullet's names, known to every user of it
pub struct SoftConfig {
    /// Velocities correction factor (Baumgarte).
    pub kVCF: f64,
    /// Damping, 0 to 1: share of the velocity lost in a sub-step.
    pub kDP: f64,
    /// Drag. There is no air: without effect.
    pub kDG: f64,
    /// Lift. There is no air: without effect.
    pub kLF: f64,
    /// Pressure; needs faces that enclose a volume.
    pub kPR: f64,
    /// Volume conservation.
    pub kVC: f64,
    /// Dynamic friction, 0 to 1.
    pub kDF: f64,
    /// Pose matching, 0 to 1.
    pub kMT: f64,
    /// Hardness of contacts with dynamic bodies, 0 to 1.
    pub kCHR: f64,
    /// Hardness of contacts with static bodies, 0 to 1.
    pub kKHR: f64,
    /// Hardness of contacts with soft bodies, 0 to 1.
    pub kSHR: f64,
    /// Hardness of anchors, 0 to 1.
    pub kAHR: f64,
    /// Clusters: hardness against dynamic bodies, 0 to 1.
    pub kSRHR_CL: f64,
    /// Clusters: hardness against static bodies, 0 to 1.
    pub kSKHR_CL: f64,
    /// Clusters: hardness against soft bodies, 0 to 1.
    pub kSSHR_CL: f64,
    /// Clusters: split of the impulse with dynamic bodies, 0 to 1.
    pub kSR_SPLT_CL: f64,
    /// Clusters: split of the impulse with static bodies, 0 to 1.
    pub kSK_SPLT_CL: f64,
    /// Clusters: split of the impulse with soft bodies, 0 to 1.
    pub kSS_SPLT_CL: f64,
    /// Maximum volume ratio for the pose.
    pub maxvolume: f64,
    /// Time scale, positive.
    pub timescale: f64,
    /// Iterations of the velocity solver, up to 1000.
    pub viterations: i32,
    /// Iterations of the position solver, up to 1000.
    pub piterations: i32,
    /// Iterations of the drift solver, up to 1000.
    pub diterations: i32,
    /// Iterations of the cluster solver, up to 1000.
    pub citerations: i32,
    /// Collision types, a bit mask: 1 nodes against bodies, 2 clusters against bodies, 16 nodes against faces of soft
    /// bodies, 32 clusters against clusters of soft bodies. Other bits are left out: Bullet 3 has no collision of a
    /// soft body's clusters with each other.
    pub flags: i32,
}

impl Default for SoftConfig {
    fn default() -> Self {
        Self {
            kVCF: 1.0,
            kDP: 0.0,
            kDG: 0.0,
            kLF: 0.0,
            kPR: 0.0,
            kVC: 0.0,
            kDF: 0.2,
            kMT: 0.0,
            kCHR: 1.0,
            kKHR: 0.1,
            kSHR: 1.0,
            kAHR: 0.7,
            kSRHR_CL: 0.1,
            kSKHR_CL: 1.0,
            kSSHR_CL: 0.5,
            kSR_SPLT_CL: 0.5,
            kSK_SPLT_CL: 0.5,
            kSS_SPLT_CL: 0.5,
            maxvolume: 1.0,
            timescale: 1.0,
            viterations: 0,
            piterations: 1,
            diterations: 0,
            citerations: 4,
            flags: 1,
        }
    }
}

/// Parameters of a soft body. All are written to Bullet, absent ones with their default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SoftBodyConfig {
    /// Bullet's numbers.
    pub numbers: SoftConfig,
    /// Whether the shape at the start is kept for pose matching: `kMT` is present.
    pub pose_matching: bool,
    /// Stiffness of material 0; `None`: none of the three keys is present, the material stays Bullet's.
    pub material: Option<SoftMaterial>,
    /// Distance of generated bending constraints; `None`: none are generated.
    pub bending_constraint: Option<i32>,
    /// Number of generated clusters; `None`: none are generated.
    pub clusters: Option<i32>,
    /// Vertex indices that get mass 0; not negative.
    pub fixed_nodes: Vec<u32>,
}

/// Stiffness coefficients of a soft body's material, each 0 to 1. Default: 1 each.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(non_snake_case)] // Bullet's and ADF's names
pub struct SoftMaterial {
    /// Linear stiffness.
    pub kLST: f64,
    /// Area stiffness.
    pub kAST: f64,
    /// Volume stiffness.
    pub kVST: f64,
}

impl Default for SoftMaterial {
    fn default() -> Self {
        Self { kLST: 1.0, kAST: 1.0, kVST: 1.0 }
    }
}

impl SoftBodyConfig {
    /// The coefficients for which `btSoftBody.h` gives a range from 0 on, with the upper end of it: beyond it Bullet's
    /// solver can make positions that are no numbers.
    fn bounded(&mut self) -> impl Iterator<Item = (&'static str, &mut f64, f64)> {
        let (any, numbers) = (f64::INFINITY, &mut self.numbers);
        let material = self.material.as_mut();
        let material =
            material.map(|SoftMaterial { kLST, kAST, kVST }| [("kLST", kLST), ("kAST", kAST), ("kVST", kVST)]);
        let material = material.into_iter().flatten().map(|(key, value)| (key, value, 1.0));
        [
            ("kDP", &mut numbers.kDP, 1.0),
            ("kDG", &mut numbers.kDG, any),
            ("kLF", &mut numbers.kLF, any),
            ("kVC", &mut numbers.kVC, any),
            ("kDF", &mut numbers.kDF, 1.0),
            ("kCHR", &mut numbers.kCHR, 1.0),
            ("kKHR", &mut numbers.kKHR, 1.0),
            ("kSHR", &mut numbers.kSHR, 1.0),
            ("kAHR", &mut numbers.kAHR, 1.0),
            ("kSRHR_CL", &mut numbers.kSRHR_CL, 1.0),
            ("kSKHR_CL", &mut numbers.kSKHR_CL, 1.0),
            ("kSSHR_CL", &mut numbers.kSSHR_CL, 1.0),
            ("kSR_SPLT_CL", &mut numbers.kSR_SPLT_CL, 1.0),
            ("kSK_SPLT_CL", &mut numbers.kSK_SPLT_CL, 1.0),
            ("kSS_SPLT_CL", &mut numbers.kSS_SPLT_CL, 1.0),
            ("kMT", &mut numbers.kMT, 1.0),
        ]
        .into_iter()
        .chain(material)
    }

    /// The same with each coefficient within the range that Bullet gives for it.
    pub fn within_range(&self) -> Self {
        let mut config = self.clone();
        config.bounded().for_each(|(_, value, high)| *value = value.clamp(0.0, high));
        config
    }
}

impl SoftBody {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let common = map.common(base);
        if !map.has("mass") {
            map.warn(ProblemKind::Absent, "mass", "a mass in kg", "1 kg is used");
        }
        let collision_mesh = collision_mesh(map, base);
        if collision_mesh.is_none() {
            let expected = "a mesh file";
            map.reject(ProblemKind::MissingKey, "collision mesh", expected);
        }
        if map.is_null("config") {
            map.warn(ProblemKind::EmptyElement, "config", "", "defaults are used");
        }
        let config = map.map("config");
        let body = Self {
            common,
            location: map.pose("location").unwrap_or_default(),
            scale: map.scale(),
            mass: map.real_in("mass", Range::NotNegative).unwrap_or(1.0),
            visual: Visual::read(map, base),
            collision_mesh: collision_mesh?,
            collision_margin: map.real_in("collision margin", Range::NotNegative).unwrap_or(0.001),
            randomize_constraints: map.boolean("randomize constraints").is_some(),
            config: SoftBodyConfig::read(&config),
        };
        let why = "it has no effect on soft bodies";
        map.ignore(&["inertial offset", "gravity", "inertia"], why);
        map.ignore(&["collision groups", "collision shape"], why);
        map.ignore(&["collision geometry", "collision offset"], why);
        map.ignore(&["compound collision shape", "collision mesh type"], why);
        map.ignore(&["controller", "controller output type"], why);
        map.ignore(&["linear gain", "angular gain"], why);
        map.skip(&["low resolution path"]);
        map.finish();
        Some(body)
    }
}

impl SoftBodyConfig {
    fn read(map: &Map<'_>) -> Self {
        let mut config = Self {
            pose_matching: map.has("kMT"),
            bending_constraint: map.int("bending constraint"),
            clusters: map.int("clusters"),
            material: SoftMaterial::read(map),
            fixed_nodes: fixed_nodes(map),
            ..Self::default()
        };
        let numbers = &mut config.numbers;
        for (key, value) in [
            ("kVCF", &mut numbers.kVCF),
            ("kDP", &mut numbers.kDP),
            ("kDG", &mut numbers.kDG),
            ("kLF", &mut numbers.kLF),
            ("kPR", &mut numbers.kPR),
            ("kVC", &mut numbers.kVC),
            ("kDF", &mut numbers.kDF),
            ("kMT", &mut numbers.kMT),
            ("kCHR", &mut numbers.kCHR),
            ("kKHR", &mut numbers.kKHR),
            ("kSHR", &mut numbers.kSHR),
            ("kAHR", &mut numbers.kAHR),
            ("kSRHR_CL", &mut numbers.kSRHR_CL),
            ("kSKHR_CL", &mut numbers.kSKHR_CL),
            ("kSSHR_CL", &mut numbers.kSSHR_CL),
            ("kSR_SPLT_CL", &mut numbers.kSR_SPLT_CL),
            ("kSK_SPLT_CL", &mut numbers.kSK_SPLT_CL),
            ("kSS_SPLT_CL", &mut numbers.kSS_SPLT_CL),
            ("maxvolume", &mut numbers.maxvolume),
            ("timescale", &mut numbers.timescale),
        ] {
            if let Some(x) = map.real(key) {
                *value = x;
            }
        }
        for (key, value) in [
            ("viterations", &mut numbers.viterations),
            ("piterations", &mut numbers.piterations),
            ("diterations", &mut numbers.diterations),
            ("citerations", &mut numbers.citerations),
            ("flags", &mut numbers.flags),
        ] {
            if let Some(x) = map.int(key) {
                *value = x;
            }
        }
        for (key, value, high) in config.bounded() {
            if !(0.0..=high).contains(value) {
                let range = if high.is_finite() { format!("0 to {high}") } else { "at least 0".to_owned() };
                let expected = format!("{range}, the range that Bullet gives for it");
                let used = value.clamp(0.0, high);
                let action = format!("profile `accurate` uses {used}, profile `legacy` uses it as it is, which can make positions that are no numbers");
                map.warn(ProblemKind::OutOfRange, key, &expected, &action);
            }
        }
        let why = "Bullet's soft bodies have no such parameter here";
        map.ignore(&["margin", "cutting"], why);
        map.finish();
        config
    }
}

fn fixed_nodes(map: &Map<'_>) -> Vec<u32> {
    let key = "fixed nodes";
    let nodes = map.ints(key);
    let valid: Vec<u32> = nodes.iter().filter_map(|&i| i.try_into().ok()).collect();
    if valid.len() < nodes.len() {
        let expected = "vertex indices of at least 0";
        let action = "the others are left out";
        map.error(ProblemKind::OutOfRange, key, expected, action);
    }
    valid
}

impl SoftMaterial {
    fn read(map: &Map<'_>) -> Option<Self> {
        let default = Self::default();
        let keys = ["kLST", "kAST", "kVST"];
        let present = keys.iter().any(|key| map.has(key));
        present.then(|| Self {
            kLST: map.real("kLST").unwrap_or(default.kLST),
            kAST: map.real("kAST").unwrap_or(default.kAST),
            kVST: map.real("kVST").unwrap_or(default.kVST),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::super::Model;
    use super::*;

    #[test]
    fn config() {
        let text = "soft bodies: [S]\nS:\n  mass: 1\n  mesh: a.obj\n  randomize constraints: false\n  \
                    config: {kLST: 0.5, kMT: 0.1, piterations: 6, bending constraint: 2, fixed nodes: [0, 3]}\n";
        let body = clean::<Model>(text).soft_bodies.remove(0);
        assert!(!body.common.passive && body.randomize_constraints);
        assert_eq!(body.collision_mesh, std::path::Path::new("dir/a.obj"));
        let expected = SoftBodyConfig {
            numbers: SoftConfig { kMT: 0.1, piterations: 6, ..SoftConfig::default() },
            pose_matching: true,
            bending_constraint: Some(2),
            fixed_nodes: vec![0, 3],
            material: Some(SoftMaterial { kLST: 0.5, ..SoftMaterial::default() }),
            ..SoftBodyConfig::default()
        };
        assert_eq!(body.config, expected);
    }

    #[test]
    fn coefficients_beyond_the_range_of_bullet_are_named() {
        let text =
            "soft bodies: [S]\nS:\n  mass: 1\n  mesh: a.obj\n  config:\n    kDF: 10\n    kDP: -0.5\n    kDG: 7\n    \
                    kPR: -3\n    kVC: -1\n    kMT: 1.5\n    kLST: 2\n    kCHR: 1\n    timescale: 3\n";
        let (model, problems) = read::<Model>(text);
        let config = &model.soft_bodies[0].config;
        assert_eq!((config.numbers.kDF, config.numbers.kDP, config.numbers.kMT), (10.0, -0.5, 1.5), "as written");
        let SoftBodyConfig { numbers: clamped, material, .. } = config.within_range();
        assert_eq!((clamped.kDF, clamped.kDP, clamped.kVC, clamped.kMT), (1.0, 0.0, 0.0, 1.0));
        assert_eq!((clamped.kDG, clamped.kPR, clamped.timescale), (7.0, -3.0, 3.0));
        assert_eq!(material.map(|material| material.kLST), Some(1.0));
        assert_eq!(problems.len(), 5, "{problems:#?}");
        assert!(
            problems.contains(
                &"dir/t.yaml:6:10: warning: `S / config / kDF` is `10`, expected 0 to 1, the range that Bullet gives for it; profile \
                  `accurate` uses 1, profile `legacy` uses it as it is, which can make positions that are no numbers"
                    .to_owned()
            ),
            "{problems:#?}"
        );
        assert!(
            problems.iter().any(|line| line.contains("kVC` is `-1`, expected at least 0, the range")),
            "{problems:#?}"
        );
        assert_eq!(SoftBodyConfig::default().within_range(), SoftBodyConfig::default());
    }

    #[test]
    fn a_mesh_is_required_and_negative_nodes_are_left_out() {
        let (model, problems) = read::<Model>("soft bodies: [S]\nS: {mass: 1}\n");
        assert!(model.soft_bodies.is_empty());
        assert!(problems[0].contains("`S / collision mesh` is missing"));
        let text = "soft bodies: [S]\nS: {mass: 1, mesh: m, config: {fixed nodes: [-1, 2]}}\n";
        let (model, problems) = read::<Model>(text);
        assert_eq!(model.soft_bodies[0].config.fixed_nodes, [2]);
        assert_eq!(problems.len(), 1);
    }
}
