use std::collections::HashSet;

use bullet_sys as sys;
use nalgebra::Isometry3;
use thiserror::Error;

pub use crate::adf::SoftConfig;

/// Most nodes of a soft body.
pub(super) const MAX_NODES: usize = 100_000;
/// Most links, and most bending links, of a soft body.
pub(super) const MAX_LINKS: usize = 1_000_000;
/// Most faces of a soft body.
const MAX_FACES: usize = 200_000;
/// Most nodes at one point: Bullet's trees of nodes become as deep.
const MAX_COINCIDENT: usize = 100;
/// Largest coordinate, m: squares of lengths must stay numbers, and Bullet's grids end at 1e7 m here.
const MAX_COORDINATE: f64 = 1e6;
/// Most iterations of each solver in a sub-step.
const MAX_ITERATIONS: i32 = 1000;
/// Most nodes × clusters: each of up to 8192 rounds of clustering takes time in proportion.
const MAX_CLUSTERING: usize = 1 << 20;
/// Most members of all clusters together: what they share is found in quadratic time.
const MAX_MEMBERS: usize = 30_000;

/// A soft body to be made: nodes held together by links, with faces for what it meets and what is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SoftBody {
    /// Positions of the nodes in the mesh frame, m. Up to 100 000.
    pub nodes: Vec<[f64; 3]>,
    /// Pairs of nodes at a fixed distance, in the order in which they are solved; see
    /// [`triangle_links`](Self::triangle_links). A link from a node to itself is left out. Up to 1 000 000.
    pub links: Vec<[u32; 2]>,
    /// Triangles. One with a node twice is left out. Up to 200 000.
    pub faces: Vec<[u32; 3]>,
    /// Mass of all nodes together before some are fixed, kg, positive.
    pub mass: f64,
    /// Collision margin, m, not negative.
    pub margin: f64,
    /// Pose of the mesh frame in the world.
    pub pose: Isometry3<f64>,
    /// Parameters.
    pub config: SoftConfig,
    /// Linear, area and volume stiffness, 0 to 1; `None`: 1 each.
    pub material: Option<[f64; 3]>,
    /// Whether the body is pulled towards its shape, as strongly as `kMT` says.
    pub pose_matching: bool,
    /// Nodes so many links apart are linked too, against bending; `None`, or below 2: none are.
    pub bending_distance: Option<i32>,
    /// Number of clusters, parts that collide as one; 0: each face is one. `None`: no clusters.
    pub clusters: Option<i32>,
    /// Nodes that do not move.
    pub fixed_nodes: Vec<u32>,
    /// Whether the order of links and faces is shuffled, always in the same way.
    pub randomize: bool,
}

impl SoftBody {
    /// The edges of triangles as links, each once, in the order in which Bullet makes them of a triangle mesh.
    pub fn triangle_links(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
        let mut seen = HashSet::new();
        let edges = faces.iter().flat_map(|&[a, b, c]| [[c, a], [a, b], [b, c]]);
        edges.filter(|&[a, b]| a != b && seen.insert([a.min(b), a.max(b)])).collect()
    }
}

/// Why a soft body was refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum SoftBodyError {
    /// Error when the world was made without soft bodies.
    #[error("the world was made without soft bodies")]
    NoSoftWorld,
    /// Error when there is no node.
    #[error("a soft body needs a mesh with at least one vertex")]
    Empty,
    /// Error when there is more of something than can be simulated in bounded time.
    #[error("{what}: {count}, where at most {limit} are possible; take a coarser mesh")]
    TooMany {
        /// The quantity that is too large.
        what: &'static str,
        /// How much there is, or a part of it that already is too much.
        count: usize,
        /// How much is possible.
        limit: usize,
    },
    /// Error when an index is not that of a node.
    #[error("{what} refer to vertex {index}, but there are {nodes}")]
    Index {
        /// The element that has the index.
        what: &'static str,
        /// The index.
        index: u32,
        /// Number of nodes.
        nodes: usize,
    },
    /// Error when a number is not finite.
    #[error("{0} must be finite")]
    NotFinite(&'static str),
    /// Error when a number is out of its range.
    #[error("`{what}` is {value}, expected {expected}")]
    OutOfRange {
        /// Name of the parameter.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its range.
        expected: &'static str,
    },
    /// Error when a pressure is given to a mesh that encloses no volume.
    #[error("`kPR` (pressure) needs a closed mesh; this one encloses no volume")]
    NoVolume,
}

use SoftBodyError as E;

impl SoftBody {
    /// Checks all that Bullet would crash, hang or lose its numbers on.
    pub(super) fn check(&self) -> Result<(), SoftBodyError> {
        self.check_sizes()?;
        self.check_indices()?;
        self.check_numbers()?;
        self.check_clusters()?;
        self.check_coincidence()
    }

    fn check_sizes(&self) -> Result<(), SoftBodyError> {
        if self.nodes.is_empty() {
            return Err(E::Empty);
        }
        for (what, count, limit) in [
            ("vertices", self.nodes.len(), MAX_NODES),
            ("links", self.links.len(), MAX_LINKS),
            ("triangles", self.faces.len(), MAX_FACES),
        ] {
            at_most(what, count, limit)?;
        }
        Ok(())
    }

    fn check_indices(&self) -> Result<(), SoftBodyError> {
        let nodes = self.nodes.len();
        let in_range = |what, indices: &[u32]| match indices.iter().find(|&&index| index as usize >= nodes) {
            Some(&index) => Err(E::Index { what, index, nodes }),
            None => Ok(()),
        };
        in_range("links", self.links.as_flattened())?;
        in_range("triangles", self.faces.as_flattened())?;
        in_range("fixed nodes", &self.fixed_nodes)
    }

    fn check_numbers(&self) -> Result<(), SoftBodyError> {
        let c = &self.config;
        let finite = |what, numbers: &[f64]| match numbers.iter().all(|x| x.is_finite()) {
            true => Ok(()),
            false => Err(E::NotFinite(what)),
        };
        let orientation = self.pose.rotation.coords;
        finite("vertices", self.nodes.as_flattened())?;
        finite("location", self.pose.translation.vector.as_slice())?;
        finite("location", orientation.as_slice())?;
        finite("stiffness", self.material.as_ref().map_or(&[], |m| m.as_slice()))?;
        finite("k… of the config", &[c.kVCF, c.kDP, c.kDG, c.kLF, c.kPR, c.kVC, c.kDF, c.kMT])?;
        finite("k… of the config", &[c.kCHR, c.kKHR, c.kSHR, c.kAHR, c.kSRHR_CL, c.kSKHR_CL, c.kSSHR_CL])?;
        finite("k… of the config", &[c.kSR_SPLT_CL, c.kSK_SPLT_CL, c.kSS_SPLT_CL, c.maxvolume])?;
        let range = |what, value: f64, good, expected| match good {
            true => Ok(()),
            false => Err(E::OutOfRange { what, value, expected }),
        };
        let near = |what, numbers: &[f64]| match numbers.iter().find(|x| x.abs() > MAX_COORDINATE) {
            Some(&value) => range(what, value, false, "at most 1e6 m"),
            None => Ok(()),
        };
        near("vertices", self.nodes.as_flattened())?;
        near("location", self.pose.translation.vector.as_slice())?;
        // If the mass is too small or too large the inverse mass of a node is not finite or 0.
        range("mass", self.mass, (1e-9..=1e12).contains(&self.mass), "1e-9 to 1e12 kg")?;
        let good = self.margin.is_finite() && self.margin >= 0.0;
        range("collision margin", self.margin, good, "0 m or more")?;
        range("timescale", c.timescale, (1e-6..=1e6).contains(&c.timescale), "1e-6 to 1e6")?;
        for (what, value) in [
            ("viterations", c.viterations),
            ("piterations", c.piterations),
            ("diterations", c.diterations),
            ("citerations", c.citerations),
        ] {
            range(what, value.into(), (0..=MAX_ITERATIONS).contains(&value), "0 to 1000")?;
        }
        let clusters = self.clusters.unwrap_or(0);
        range("clusters", clusters.into(), clusters >= 0, "0 or more")
    }

    fn check_clusters(&self) -> Result<(), SoftBodyError> {
        match self.clusters {
            None => Ok(()),
            Some(0) => at_most("triangles as clusters", 3 * self.faces.len(), MAX_MEMBERS),
            Some(clusters) => {
                let clusters = (clusters as usize).min(self.nodes.len());
                // Each node is in its cluster and in the one that holds all.
                at_most("vertices in clusters", 2 * self.nodes.len(), MAX_MEMBERS)?;
                at_most("vertices × clusters", self.nodes.len() * clusters, MAX_CLUSTERING)
            }
        }
    }

    fn check_coincidence(&self) -> Result<(), SoftBodyError> {
        let mut points: Vec<_> = self.nodes.iter().map(|node| node.map(|x| (x + 0.0).to_bits())).collect();
        points.sort_unstable();
        let most = points.chunk_by(|a, b| a == b).map(<[_]>::len).max().unwrap_or(0);
        at_most("vertices at one point", most, MAX_COINCIDENT)
    }

    /// Size of the bounding box of the nodes, m.
    pub(super) fn size(&self) -> f64 {
        let extent = |axis: usize| {
            let along = self.nodes.iter().map(|node| node[axis]);
            along.clone().fold(f64::MIN, f64::max) - along.fold(f64::MAX, f64::min)
        };
        extent(0).hypot(extent(1)).hypot(extent(2))
    }

    /// Links between nodes that are `bending_distance` links apart, in the order in which Bullet's
    /// `generateBendingConstraints` adds them. Bullet itself takes memory quadratic and time cubic in the number of
    /// nodes.
    pub(super) fn bending_links(&self) -> Result<Vec<[u32; 2]>, SoftBodyError> {
        let distance = self.bending_distance.unwrap_or(0);
        let mut bending = Vec::new();
        if distance < 2 {
            return Ok(bending);
        }
        let mut neighbours = vec![Vec::new(); self.nodes.len()];
        for &[a, b] in &self.links {
            neighbours[a as usize].push(b);
            neighbours[b as usize].push(a);
        }
        let (mut seen_from, mut visited) = (vec![u32::MAX; self.nodes.len()], 0);
        for from in 0..self.nodes.len() as u32 {
            seen_from[from as usize] = from;
            let mut frontier = vec![from];
            for _ in 0..distance {
                let mut next = Vec::new();
                for &to in frontier.iter().flat_map(|&node| &neighbours[node as usize]) {
                    visited += 1;
                    if seen_from[to as usize] != from {
                        seen_from[to as usize] = from;
                        next.push(to);
                    }
                }
                frontier = next;
                if frontier.is_empty() {
                    break;
                }
            }
            at_most("steps from link to link for `bending constraint`", visited, 100 * MAX_LINKS)?;
            frontier.retain(|&to| to > from);
            frontier.sort_unstable();
            bending.extend(frontier.iter().map(|&to| [to, from]));
            at_most("links by `bending constraint`", bending.len(), MAX_LINKS)?;
        }
        Ok(bending)
    }
}

fn at_most(what: &'static str, count: usize, limit: usize) -> Result<(), SoftBodyError> {
    match count <= limit {
        true => Ok(()),
        false => Err(E::TooMany { what, count, limit }),
    }
}

/// `config` as the shim takes it.
pub(super) fn raw(config: &SoftConfig) -> sys::AmbSoftConfig {
    sys::AmbSoftConfig {
        kVCF: config.kVCF,
        kDP: config.kDP,
        kDG: config.kDG,
        kLF: config.kLF,
        kPR: config.kPR,
        kVC: config.kVC,
        kDF: config.kDF,
        kMT: config.kMT,
        kCHR: config.kCHR,
        kKHR: config.kKHR,
        kSHR: config.kSHR,
        kAHR: config.kAHR,
        kSRHR_CL: config.kSRHR_CL,
        kSKHR_CL: config.kSKHR_CL,
        kSSHR_CL: config.kSSHR_CL,
        kSR_SPLT_CL: config.kSR_SPLT_CL,
        kSK_SPLT_CL: config.kSK_SPLT_CL,
        kSS_SPLT_CL: config.kSS_SPLT_CL,
        maxvolume: config.maxvolume,
        timescale: config.timescale,
        viterations: config.viterations,
        piterations: config.piterations,
        diterations: config.diterations,
        citerations: config.citerations,
        flags: config.flags,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of three triangles.
    fn strip() -> SoftBody {
        let faces = vec![[0, 1, 2], [1, 3, 2], [2, 3, 4]];
        SoftBody {
            nodes: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 2.0, 0.0]],
            links: SoftBody::triangle_links(&faces),
            faces,
            mass: 1.0,
            margin: 0.01,
            pose: Isometry3::identity(),
            config: SoftConfig::default(),
            material: None,
            pose_matching: false,
            bending_distance: None,
            clusters: None,
            fixed_nodes: vec![],
            randomize: false,
        }
    }

    #[test]
    fn each_edge_is_one_link() {
        assert_eq!(strip().links, [[2, 0], [0, 1], [1, 2], [1, 3], [3, 2], [4, 2], [3, 4]]);
        assert_eq!(SoftBody::triangle_links(&[[0, 0, 1]]), [[1, 0]], "a degenerate triangle");
    }

    #[test]
    fn bending_links_join_nodes_at_their_distance() {
        let bending = |distance| SoftBody { bending_distance: distance, ..strip() }.bending_links().unwrap();
        for none in [None, Some(-3), Some(0), Some(1), Some(4), Some(i32::MAX)] {
            assert!(bending(none).is_empty(), "{none:?}");
        }
        assert_eq!(bending(Some(2)), [[3, 0], [4, 0], [4, 1]]);
        // 4 is two links from 0: nothing is three away, until that link is taken out.
        assert!(bending(Some(3)).is_empty());
        let chain = SoftBody { links: vec![[0, 1], [1, 2], [2, 2], [2, 3], [3, 4]], ..strip() };
        assert_eq!(SoftBody { bending_distance: Some(3), ..chain }.bending_links().unwrap(), [[3, 0], [4, 1]]);
    }

    #[test]
    fn what_bullet_cannot_deal_with_is_refused() {
        let config = SoftConfig::default();
        let far = Isometry3::translation(0.0, 2e6, 0.0);
        let lost = Isometry3::translation(0.0, f64::NAN, 0.0);
        for (bad, part) in [
            (SoftBody { nodes: vec![], ..strip() }, "at least one vertex"),
            (SoftBody { links: vec![[0, 5]], ..strip() }, "links refer to vertex 5, but there are 5"),
            (SoftBody { faces: vec![[0, 1, 7]], ..strip() }, "triangles refer to vertex 7"),
            (SoftBody { fixed_nodes: vec![5], ..strip() }, "fixed nodes refer to vertex 5"),
            (SoftBody { nodes: vec![[f64::NAN; 3]; 5], ..strip() }, "vertices must be finite"),
            (SoftBody { nodes: vec![[1e300; 3]; 5], ..strip() }, "expected at most 1e6 m"),
            (SoftBody { nodes: vec![[1.0; 3]; 200], ..strip() }, "vertices at one point: 200"),
            (SoftBody { nodes: vec![[0.0; 3]; MAX_NODES + 1], ..strip() }, "take a coarser mesh"),
            (SoftBody { mass: 0.0, ..strip() }, "`mass` is 0"),
            (SoftBody { mass: f64::NAN, ..strip() }, "`mass` is NaN"),
            (SoftBody { margin: -0.1, ..strip() }, "`collision margin` is -0.1"),
            (SoftBody { pose: far, ..strip() }, "`location` is 2000000"),
            (SoftBody { pose: lost, ..strip() }, "location must be finite"),
            (SoftBody { material: Some([f64::INFINITY, 1.0, 1.0]), ..strip() }, "stiffness must be finite"),
            (SoftBody { config: SoftConfig { kDP: f64::NAN, ..config }, ..strip() }, "config must be finite"),
            (SoftBody { config: SoftConfig { timescale: 0.0, ..config }, ..strip() }, "`timescale` is 0"),
            (
                SoftBody { config: SoftConfig { piterations: i32::MAX, ..config }, ..strip() },
                "`piterations` is 2147483647",
            ),
            (SoftBody { config: SoftConfig { citerations: -1, ..config }, ..strip() }, "`citerations` is -1"),
            (SoftBody { clusters: Some(-1), ..strip() }, "`clusters` is -1"),
        ] {
            let error = bad.check().unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
        assert_eq!(strip().check(), Ok(()));
    }

    #[test]
    fn too_much_work_is_refused() {
        let nodes: Vec<_> = (0..20_000).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        // A star: every pair of leaves is two links apart.
        let star = SoftBody {
            links: (1..20_000).map(|i| [0, i]).collect(),
            nodes,
            faces: vec![],
            bending_distance: Some(2),
            ..strip()
        };
        assert!(matches!(star.bending_links(), Err(SoftBodyError::TooMany { .. })));
        assert!(matches!(SoftBody { clusters: Some(10), ..star }.check(), Err(SoftBodyError::TooMany { .. })));
        let faces = vec![[0, 1, 2]; 20_000];
        let many = SoftBody { faces, clusters: Some(0), ..strip() };
        assert!(matches!(many.check(), Err(SoftBodyError::TooMany { .. })));
    }
}
