//! Cutting: what a shape removes on its way from one pose to another.

use std::collections::BinaryHeap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use thiserror::Error;

use crate::grid::{Touched, Voxel, VoxelGrid};

/// Most poses between which a shape that is not a ball is moved in one stroke.
const MOST_POSES: f64 = 4096.0;
/// Most voxels in the box around a stroke, times the poses at which each is tested: a grid of 512³ voxels, once.
const MOST_TESTS: usize = 1 << 27;
/// Voxels for which a [`Carver`] keeps room after a stroke that needed more.
const KEPT: usize = 1 << 16;

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
    /// These voxels, wherever the shape is; with [`Rule::All`] only.
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
    /// Error when voxels that are named are to be removed in part.
    #[error("voxels that are named are all removed: their rule has to be `all`")]
    Rule,
    /// Error when a stroke would take too long: the physics waits for it.
    #[error("the stroke needs up to {tests} tests of voxels ({voxels} voxels around it at {poses} poses), at most {MOST_TESTS} are possible: \
             divide it into shorter strokes, or make the shape smaller")]
    TooMuch {
        /// In the box that the stroke sweeps, as far as it is in the grid.
        voxels: usize,
        /// At which each voxel is tested.
        poses: usize,
        /// Both multiplied.
        tests: usize,
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
    /// Room for `voxels`, so that as many take no memory later.
    pub fn with_room(voxels: usize) -> Self {
        let mut carved = Self::default();
        carved.indices.reserve(voxels);
        carved.colors.reserve(voxels);
        carved.labels.reserve(voxels);
        carved
    }

    /// Gives back room beyond that for `voxels`.
    pub fn shrink_to(&mut self, voxels: usize) {
        self.indices.shrink_to(voxels);
        self.colors.shrink_to(voxels);
        self.labels.shrink_to(voxels);
    }

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
    /// Voxels for which room is kept.
    room: usize,
    candidates: Vec<Candidate>,
    order: Vec<[usize; 3]>,
    /// Of a shape that is not a ball, along its way.
    poses: Vec<Isometry3<f64>>,
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
    /// Room for `voxels` in a stroke of a ball, so that finding and choosing them takes no memory then.
    pub fn with_room(voxels: usize) -> Self {
        Self {
            room: voxels,
            candidates: Vec::with_capacity(voxels),
            order: Vec::with_capacity(voxels),
            touched: Touched::with_room(voxels),
            carved: Carved::with_room(voxels),
            ..Self::default()
        }
    }

    /// What the last stroke has removed.
    pub fn carved(&self) -> &Carved {
        &self.carved
    }

    /// What the last stroke has removed, to keep: the carver knows nothing of it any more.
    pub fn take_carved(&mut self) -> Carved {
        let carved = std::mem::take(&mut self.carved);
        self.carved = Carved::with_room(self.room);
        carved
    }

    /// Forgets what the last stroke has removed, and gives back what memory that took beyond the usual room.
    pub fn forget(&mut self) {
        self.carved.clear();
        self.carved.shrink_to(self.room.max(KEPT));
    }

    /// Removes solid voxels whose centres the shape covers on its way.
    ///
    /// The way of a ball is exact. Other shapes are put at poses between which no point of them moves by more than half
    /// the smallest edge of a voxel. Room that only a large stroke needs is given back: that for what was removed by
    /// [`forget`](Self::forget), or the next stroke.
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
        self.plan(grid, shape, stroke, rule)?;
        Ok(self.remove(grid))
    }

    /// As [`carve`](Self::carve) of a grid that others hold: they keep it as it is. Where nothing is removed it stays
    /// the same grid, and nothing is copied.
    ///
    /// # Errors
    /// As [`carve`](Self::carve).
    pub fn carve_shared(
        &mut self,
        grid: &mut Arc<VoxelGrid>,
        shape: &Shape,
        stroke: &Stroke,
        rule: Rule,
    ) -> Result<&Carved, CarveError> {
        self.plan(grid, shape, stroke, rule)?;
        if self.order.is_empty() {
            return Ok(&self.carved);
        }
        Ok(self.remove(Arc::make_mut(grid)))
    }

    /// Finds what goes, in order.
    fn plan(&mut self, grid: &VoxelGrid, shape: &Shape, stroke: &Stroke, rule: Rule) -> Result<(), CarveError> {
        let kept = self.room.max(KEPT);
        self.carved.clear();
        self.carved.shrink_to(kept);
        self.candidates.clear();
        self.order.clear();
        shape.check()?;
        rule.check()?;
        let is_finite = |pose: &Isometry3<f64>| pose.to_homogeneous().iter().all(|c| c.is_finite());
        if !(is_finite(&stroke.from) && is_finite(&stroke.to)) {
            return Err(CarveError::Pose);
        }
        if let Shape::Voxels(voxels) = shape {
            if rule != Rule::All {
                return Err(CarveError::Rule);
            }
            let there = voxels.iter().filter_map(|voxel| {
                let size = grid.size();
                let inside = (0..3).all(|axis| (0..size[axis] as i64).contains(&voxel[axis]));
                let index = voxel.map(|i| i as usize);
                (inside && grid.voxel(index) != Some(Voxel::default())).then_some(index)
            });
            self.order.extend(there);
            return Ok(());
        }
        self.find(grid, shape, stroke)?;
        self.choose(grid, rule);
        self.candidates.clear();
        self.candidates.shrink_to(kept);
        Ok(())
    }

    /// Removes what goes.
    fn remove(&mut self, grid: &mut VoxelGrid) -> &Carved {
        let kept = self.room.max(KEPT);
        let Self { order, touched, carved, .. } = self;
        grid.erase(order.iter().copied(), touched, |index, voxel, color| {
            carved.indices.push(index.map(|i| i as u32));
            carved.colors.push(color);
            carved.labels.push(voxel.label);
        });
        carved.volume = grid.voxel_volume() * carved.indices.len() as f64;
        order.clear();
        order.shrink_to(kept);
        touched.shrink_to(kept);
        carved
    }

    /// Finds all voxels that may go.
    fn find(&mut self, grid: &VoxelGrid, shape: &Shape, stroke: &Stroke) -> Result<(), CarveError> {
        let size = grid.size();
        let Self { candidates, poses, .. } = self;
        let mut offer = |index: [usize; 3], square: f64| {
            // Squares are not negative: their bits are ordered as they are.
            let place = (index[2] * size[1] + index[1]) * size[0] + index[0];
            candidates.push(Candidate(std::cmp::Reverse((square.to_bits(), place))));
        };
        let origin = |pose: &Isometry3<f64>| Point3::from(pose.translation.vector);
        let (from, to) = (origin(&stroke.from), origin(&stroke.to));
        let affordable = |reach: f64, poses: usize| {
            let voxels = grid.count_near(&from, &to, reach);
            let tests = voxels.saturating_mul(poses);
            if tests > MOST_TESTS {
                return Err(CarveError::TooMuch { voxels, poses, tests });
            }
            Ok(())
        };
        if let Shape::Sphere { radius } = shape {
            affordable(*radius, 1)?;
            grid.each_solid_near(&from, &to, *radius, offer);
            return Ok(());
        }
        let turn = stroke.from.rotation.angle_to(&stroke.to.rotation);
        // A reach that overflows is not moved by no turn.
        let turned = if turn > 0.0 { turn * shape.reach() } else { 0.0 };
        let moved = (to - from).norm() + turned;
        let step = 0.5 * grid.spacing().min();
        if moved > MOST_POSES * step {
            return Err(CarveError::TooFar { moved, most: MOST_POSES * step });
        }
        let steps = (moved / step).ceil() as usize;
        affordable(shape.reach(), steps + 1)?;
        poses.clear();
        poses.extend((0..=steps).map(|at| {
            let part = at as f64 / steps.max(1) as f64;
            let rotation = stroke.from.rotation.try_slerp(&stroke.to.rotation, part, 1e-9);
            let rotation = rotation.unwrap_or(stroke.from.rotation);
            Isometry3::from_parts((from + (to - from) * part).into(), rotation)
        }));
        grid.each_solid_near(&from, &to, shape.reach(), |index, _| {
            let center = grid.center(index);
            let depths = poses.iter().filter_map(|pose| shape.depth(&pose.inverse_transform_point(&center)));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Label;

    fn full(edge: usize) -> VoxelGrid {
        let labels = vec![Label::of_color([255; 3])];
        let voxel = |_| Voxel { density: 255, label: 1 };
        VoxelGrid::from_fn([edge; 3], Vector3::repeat(1e-3 * edge as f64), 0.5, labels, voxel).unwrap()
    }

    fn stroke(by: f64) -> Stroke {
        Stroke { from: Isometry3::translation(-0.5 * by, 0.0, 0.0), to: Isometry3::translation(0.5 * by, 0.0, 0.0) }
    }

    #[test]
    fn a_stroke_that_would_take_hours_is_refused_before_a_voxel_is_visited() {
        let mut grid = full(64);
        let mut carver = Carver::default();
        let cube = Shape::Box { half_edges: Vector3::repeat(0.1) };
        let before = grid.clone();
        let refused = carver.carve(&mut grid, &cube, &stroke(2.0), Rule::All).unwrap_err();
        let CarveError::TooMuch { voxels, poses, tests } = refused else { panic!("{refused}") };
        assert_eq!((voxels, poses, tests), (64 * 64 * 64, 4001, 64 * 64 * 64 * 4001));
        assert!(refused.to_string().contains("shorter strokes"), "{refused}");
        assert!(grid == before && carver.carved().indices.is_empty());
        // A shorter one is not, and all at once is one test a voxel.
        carver.carve(&mut grid, &cube, &stroke(0.01), Rule::Count(7)).unwrap();
        assert_eq!(carver.carved().indices.len(), 7);
        carver.carve(&mut grid, &cube, &stroke(0.0), Rule::All).unwrap();
        assert_eq!((carver.carved().indices.len(), grid.count_solid()), (64 * 64 * 64 - 7, 0));
    }

    #[test]
    fn a_large_stroke_leaves_no_room_and_one_that_removes_nothing_copies_nothing() {
        let mut carver = Carver::with_room(100);
        let ball = Shape::Sphere { radius: 1.0 };
        let mut grid = Arc::new(full(64));
        let shown = Arc::clone(&grid);
        carver.carve_shared(&mut grid, &ball, &stroke(5.0), Rule::Rate { rate: 0.0, interval: 1.0 }).unwrap();
        carver.carve_shared(&mut grid, &Shape::Voxels(vec![[-1, 0, 0]]), &stroke(0.0), Rule::All).unwrap();
        assert!(Arc::ptr_eq(&grid, &shown));
        carver.carve_shared(&mut grid, &ball, &stroke(0.0), Rule::All).unwrap();
        assert_eq!((grid.count_solid(), shown.count_solid()), (0, 64 * 64 * 64));
        assert!(carver.candidates.capacity() <= KEPT && carver.order.capacity() <= KEPT);
        let named = Shape::Voxels(vec![[0; 3]]);
        assert_eq!(carver.carve_shared(&mut grid, &named, &stroke(0.0), Rule::Count(1)), Err(CarveError::Rule));
        let now = Arc::clone(&grid);
        carver.carve_shared(&mut grid, &named, &stroke(0.0), Rule::All).unwrap();
        assert!(Arc::ptr_eq(&grid, &now) && carver.carved.indices.capacity() <= KEPT);
        // What a large stroke has removed is taken along, or forgotten at once.
        let mut grid = full(64);
        carver.carve(&mut grid, &ball, &stroke(0.0), Rule::All).unwrap();
        assert!(carver.carved.indices.capacity() > KEPT);
        assert_eq!(carver.take_carved().indices.len(), 64 * 64 * 64);
        assert!(carver.carved.indices.is_empty() && carver.carved.indices.capacity() == 100);
        carver.carve(&mut full(64), &ball, &stroke(0.0), Rule::All).unwrap();
        carver.forget();
        assert!(carver.carved.indices.is_empty() && carver.carved.indices.capacity() <= KEPT);
    }
}
