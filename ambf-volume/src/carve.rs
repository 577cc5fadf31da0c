//! Cutting: what a shape removes on its way from one pose to another.

use std::collections::BinaryHeap;

use nalgebra::{Isometry3, Point3, Vector3};
use thiserror::Error;

use crate::grid::{Touched, VoxelGrid};

/// Most poses between which a shape that is not a ball is moved in one stroke.
const MOST_POSES: f64 = 4096.0;

/// What cuts; in its own frame, m.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A ball around the origin.
    Sphere {
        /// Positive.
        radius: f64,
    },
    /// All that is within `radius` of a piece of the x axis.
    Capsule {
        /// Positive.
        radius: f64,
        /// The piece reaches from −`half_length` to `half_length`; not negative.
        half_length: f64,
    },
    /// A box around the origin.
    Box {
        /// Half of its edges, positive.
        half_edges: Vector3<f64>,
    },
    /// These voxels, wherever the shape is.
    Voxels(
        /// (voxels x 3) indices.
        Vec<[i64; 3]>,
    ),
}

/// The way of a shape, in the volume's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Where it begins.
    pub from: Isometry3<f64>,
    /// Where it ends. Between, positions are on a line, and orientations turn about one axis.
    pub to: Isometry3<f64>,
}

/// How much of what the shape meets is removed; the rest stays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rule {
    /// All of it.
    All,
    /// As much as `rate` · `interval` · (1 / hardness), with what an earlier stroke of the same [`Carver`] had left over
    /// because a voxel did not fit. The nearest to the shape's way go first.
    Rate {
        /// m³/s of hardness 1; not negative.
        rate: f64,
        /// s; not negative.
        interval: f64,
    },
    /// At most so many voxels, the nearest first: as the C++ program's drill, the rate depends on their size.
    Count(
        /// Voxels.
        usize,
    ),
}

/// Error when a cut is not described by usable numbers.
#[derive(Debug, Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum CarveError {
    /// Error when a number is not finite or has the wrong sign.
    #[error("{what} is {value}; it has to be finite{}", if *positive { " and positive" } else { " and not negative" })]
    Number {
        /// What.
        what: &'static str,
        /// What was given.
        value: f64,
        /// Whether 0 is refused, too.
        positive: bool,
    },
    /// Error when a pose has a number that is not finite.
    #[error("a pose of the shape is not finite")]
    Pose,
    /// Error when a shape moves too far in one stroke to be followed in steps of half a voxel.
    #[error("the shape moves by {moved} m in one stroke; at most {most} m are possible with these voxels: divide the stroke")]
    TooFar {
        /// Of the point that moves most, m.
        moved: f64,
        /// m.
        most: f64,
    },
}

/// What was removed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Carved {
    /// (voxels x 3) indices, the nearest to the shape's way first, equal ones by index.
    pub indices: Vec<[u32; 3]>,
    /// (voxels x 4) red, green, blue and alpha of before.
    pub colors: Vec<[u8; 4]>,
    /// (voxels x 1) labels of before.
    pub labels: Vec<u8>,
    /// m³.
    pub volume: f64,
}

impl Carved {
    /// Forgets everything, but keeps its room.
    pub fn clear(&mut self) {
        self.indices.clear();
        self.colors.clear();
        self.labels.clear();
        self.volume = 0.0;
    }

    /// Adds what another cut has removed.
    pub fn append(&mut self, other: &Self) {
        self.indices.extend_from_slice(&other.indices);
        self.colors.extend_from_slice(&other.colors);
        self.labels.extend_from_slice(&other.labels);
        self.volume += other.volume;
    }
}

/// A voxel that may go. The greatest in the order of the heap is the nearest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Candidate(std::cmp::Reverse<(u64, usize)>);

/// Cuts, and keeps room and what is left of a rate between strokes: one for each tool.
#[derive(Clone, Debug, Default)]
pub struct Carver {
    candidates: Vec<Candidate>,
    order: Vec<[usize; 3]>,
    touched: Touched,
    carved: Carved,
    /// m³ that a rate has left over.
    pub carry: f64,
}

impl Shape {
    /// Refuses numbers that describe no shape.
    ///
    /// # Errors
    /// [`CarveError::Number`].
    pub fn check(&self) -> Result<(), CarveError> {
        let positive = |what, value| check(what, value, true);
        match self {
            Self::Sphere { radius } => positive("the radius", *radius),
            Self::Capsule { radius, half_length } => {
                positive("the radius", *radius)?;
                check("half the length", *half_length, false)
            }
            Self::Box { half_edges } => half_edges.iter().try_for_each(|&half| positive("half an edge", half)),
            Self::Voxels(_) => Ok(()),
        }
    }

    /// Radius of a ball around the origin that has all of it, m.
    fn reach(&self) -> f64 {
        match self {
            Self::Sphere { radius } => *radius,
            Self::Capsule { radius, half_length } => radius + half_length,
            Self::Box { half_edges } => half_edges.norm(),
            Self::Voxels(_) => 0.0,
        }
    }

    /// How far inside a point of the shape's frame is, as a square that is 0 in the middle; `None` outside.
    fn depth(&self, point: &Point3<f64>) -> Option<f64> {
        match self {
            Self::Sphere { radius } => Some(point.coords.norm_squared()).filter(|square| *square <= radius * radius),
            Self::Capsule { radius, half_length } => {
                let along = point.x.clamp(-half_length, *half_length);
                let square = (point.coords - Vector3::x() * along).norm_squared();
                (square <= radius * radius).then_some(square)
            }
            Self::Box { half_edges } => {
                let inside = (0..3).all(|axis| point[axis].abs() <= half_edges[axis]);
                inside.then(|| point.coords.norm_squared())
            }
            Self::Voxels(_) => None,
        }
    }
}

fn check(what: &'static str, value: f64, positive: bool) -> Result<(), CarveError> {
    let fits = value.is_finite() && if positive { value > 0.0 } else { value >= 0.0 };
    if fits {
        Ok(())
    } else {
        Err(CarveError::Number { what, value, positive })
    }
}

impl Rule {
    /// Refuses numbers that are no rate.
    ///
    /// # Errors
    /// [`CarveError::Number`].
    pub fn check(&self) -> Result<(), CarveError> {
        match *self {
            Self::Rate { rate, interval } => {
                check("the rate", rate, false)?;
                check("the interval", interval, false)
            }
            Self::All | Self::Count(_) => Ok(()),
        }
    }
}

impl Carver {
    /// Room for `voxels` in a stroke, so that it takes no memory then.
    pub fn with_room(voxels: usize) -> Self {
        let mut carver = Self::default();
        carver.candidates.reserve(voxels);
        carver.order.reserve(voxels);
        carver.carved.indices.reserve(voxels);
        carver.carved.colors.reserve(voxels);
        carver.carved.labels.reserve(voxels);
        carver
    }

    /// What the last stroke has removed.
    pub fn carved(&self) -> &Carved {
        &self.carved
    }

    /// Removes solid voxels whose centres the shape covers on its way.
    ///
    /// The way of a ball is exact. Other shapes are put at poses between which no point of them moves by more than half
    /// the smallest edge of a voxel.
    ///
    /// # Errors
    /// [`CarveError`]; nothing is removed then.
    pub fn carve(
        &mut self,
        grid: &mut VoxelGrid,
        shape: &Shape,
        stroke: &Stroke,
        rule: Rule,
    ) -> Result<&Carved, CarveError> {
        self.carved.clear();
        shape.check()?;
        rule.check()?;
        let is_finite = |pose: &Isometry3<f64>| pose.to_homogeneous().iter().all(|c| c.is_finite());
        if !(is_finite(&stroke.from) && is_finite(&stroke.to)) {
            return Err(CarveError::Pose);
        }
        self.candidates.clear();
        self.order.clear();
        if let Shape::Voxels(voxels) = shape {
            let size = grid.size();
            let inside = |voxel: &&[i64; 3]| (0..3).all(|axis| (0..size[axis] as i64).contains(&voxel[axis]));
            self.order.extend(voxels.iter().filter(inside).map(|voxel| voxel.map(|i| i as usize)));
        } else {
            self.find(grid, shape, stroke)?;
            self.choose(grid, rule);
        }
        let Self { order, touched, carved, .. } = self;
        grid.erase(order.iter().copied(), touched, |index, voxel, color| {
            carved.indices.push(index.map(|i| i as u32));
            carved.colors.push(color);
            carved.labels.push(voxel.label);
        });
        self.carved.volume = grid.voxel_volume() * self.carved.indices.len() as f64;
        Ok(&self.carved)
    }

    /// Finds all voxels that may go.
    fn find(&mut self, grid: &VoxelGrid, shape: &Shape, stroke: &Stroke) -> Result<(), CarveError> {
        let size = grid.size();
        let candidates = &mut self.candidates;
        let mut offer = |index: [usize; 3], square: f64| {
            // Squares are not negative: their bits are ordered as they are.
            let place = (index[2] * size[1] + index[1]) * size[0] + index[0];
            candidates.push(Candidate(std::cmp::Reverse((square.to_bits(), place))));
        };
        let origin = |pose: &Isometry3<f64>| Point3::from(pose.translation.vector);
        let (from, to) = (origin(&stroke.from), origin(&stroke.to));
        if let Shape::Sphere { radius } = shape {
            grid.each_solid_near(&from, &to, *radius, offer);
            return Ok(());
        }
        let turn = stroke.from.rotation.angle_to(&stroke.to.rotation);
        let moved = (to - from).norm() + turn * shape.reach();
        let step = 0.5 * grid.spacing().min();
        if moved > MOST_POSES * step {
            return Err(CarveError::TooFar { moved, most: MOST_POSES * step });
        }
        let steps = (moved / step).ceil().max(1.0) as usize;
        let pose_at = |at: usize| {
            let part = at as f64 / steps as f64;
            let rotation = stroke.from.rotation.try_slerp(&stroke.to.rotation, part, 1e-9);
            let rotation = rotation.unwrap_or(stroke.from.rotation);
            Isometry3::from_parts((from + (to - from) * part).into(), rotation)
        };
        grid.each_solid_near(&from, &to, shape.reach(), |index, _| {
            let center = grid.center(index);
            let depths = (0..=steps).filter_map(|at| shape.depth(&pose_at(at).inverse_transform_point(&center)));
            if let Some(square) = depths.reduce(f64::min) {
                offer(index, square);
            }
        });
        Ok(())
    }

    /// Puts what goes in order.
    fn choose(&mut self, grid: &VoxelGrid, rule: Rule) {
        let size = grid.size();
        let index = |place: usize| [place % size[0], place / size[0] % size[1], place / size[0] / size[1]];
        let carry = std::mem::take(&mut self.carry);
        let (mut budget, most) = match rule {
            Rule::All => {
                self.candidates.sort_unstable_by(|a, b| b.cmp(a));
                self.order.extend(self.candidates.iter().map(|candidate| index(candidate.0 .0 .1)));
                return;
            }
            Rule::Rate { rate, interval } => (rate * interval + carry, usize::MAX),
            Rule::Count(most) => (f64::INFINITY, most),
        };
        // As many as go are taken from a heap: cheaper than to sort all.
        let mut heap = BinaryHeap::from(std::mem::take(&mut self.candidates));
        while let Some(nearest) = heap.peek() {
            let index = index(nearest.0 .0 .1);
            let label = grid.voxel(index).map_or(0, |voxel| voxel.label);
            let hardness = grid.labels().get(usize::from(label)).map_or(1.0, |label| label.hardness);
            let cost = grid.voxel_volume() * hardness;
            if cost > budget || self.order.len() >= most {
                break;
            }
            budget -= cost;
            self.order.push(index);
            heap.pop();
        }
        // What a voxel that did not fit leaves is used later; where there is nothing to cut, nothing is saved up.
        if budget.is_finite() && !heap.is_empty() {
            self.carry = budget;
        }
        self.candidates = heap.into_vec();
    }
}
