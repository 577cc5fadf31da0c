//! Contact of a tool: a ball that follows a goal as far as the voxels let it (finger proxy, Ruspini, Kolarov and Khatib
//! 1997), and the force that holds the goal back.
//!
//! All is in the volume's frame, in which a tool at rest moves when the volume does. Up to three planes of contact are
//! found in one update, so that the ball is at rest at the place nearest to its goal.

use nalgebra::{Point3, Vector3};

use crate::grid::VoxelGrid;

/// What is left of a way, m, when the ball is said to have arrived.
const TOLERANCE: f64 = 1e-7;
/// Planes that hold the ball, and more searches than planes are needed where a surface is rough.
const SEARCHES: usize = 12;
/// Cosine of the angle between normals from which on planes of contact are one.
const PARALLEL: f64 = 0.95;
/// Steps along ways to the interpolated surface in one update: a ball that has to slide farther goes on in the next one.
const STEPS: usize = 24;
/// Steps in which a ball that is inside is pushed out.
const ESCAPES: usize = 64;
/// Updates after which the whole force is back when a ball had to be pushed out.
const RETURN: u32 = 50;

/// Which surface is touched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Surface {
    /// That of interpolated density, as it is drawn.
    #[default]
    Interpolated,
    /// Balls of [`BALL`](crate::query::BALL) edges around the centres of voxels, as in the C++ program's library.
    Balls,
}

/// How the goal is held back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// N/m; not negative. Default: 700.
    pub stiffness: f64,
    /// Against the goal's velocity along the normal, N·s/m; not negative. Default: 0.
    pub damping: f64,
    /// Coefficient of Coulomb friction; not negative. Default: 0.
    pub friction: f64,
    /// Largest force, N; positive. Default: 3.3.
    pub most: f64,
}

impl Default for Law {
    fn default() -> Self {
        Self { stiffness: 700.0, damping: 0.0, friction: 0.0, most: 3.3 }
    }
}

/// A ball that follows a goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proxy {
    /// m; positive.
    pub radius: f64,
    /// Where its centre is; `None`: it has not been put anywhere.
    pub position: Option<Point3<f64>>,
    /// The voxel that is touched.
    pub touched: Option<[usize; 3]>,
    /// Unit normal of the first contact, from the volume to the ball; zero without contact.
    pub normal: Vector3<f64>,
    /// Updates until the whole force is back.
    returning: u32,
    /// What the nearest solid voxel was: bounds the next search.
    guess: Option<[usize; 3]>,
}

struct Found {
    center: Point3<f64>,
    normal: Vector3<f64>,
    index: [usize; 3],
}

/// Distance to the interpolated surface, its normal, and the voxel that is nearest.
type Nearest = (f64, Vector3<f64>, [usize; 3]);

/// What is on a way.
enum Way {
    /// Nothing.
    Free,
    /// Nothing up to here; the rest has not been looked at.
    Open(Point3<f64>),
    /// A contact.
    Held(Found),
}

impl Proxy {
    /// A ball of a radius, m, that is nowhere yet.
    pub fn new(radius: f64) -> Self {
        Self { radius, position: None, touched: None, normal: Vector3::zeros(), returning: 0, guess: None }
    }

    /// Forgets where it was.
    pub fn reset(&mut self) {
        *self = Self::new(self.radius);
    }

    /// Moves the ball to the place nearest to `goal` that can be reached. A ball that is inside, because the volume
    /// changed around it, is put at the nearest free place first.
    pub fn update(&mut self, grid: &VoxelGrid, surface: Surface, law: &Law, goal: &Point3<f64>) -> Point3<f64> {
        if !goal.iter().all(|c| c.is_finite()) {
            return self.position.unwrap_or_else(Point3::origin);
        }
        let mut at = self.position.unwrap_or(*goal);
        self.returning = self.returning.saturating_sub(1);
        let (free, mut known) = self.escape(grid, surface, &at);
        if let Some(free) = free {
            at = free;
            self.returning = RETURN;
        }
        self.touched = None;
        self.normal = Vector3::zeros();
        let mut planes: [(Vector3<f64>, Point3<f64>); 3] = [(Vector3::zeros(), at); 3];
        let mut held = 0;
        // The goal, less what friction holds back.
        let mut aim = *goal;
        let mut target = aim;
        let mut steps = STEPS;
        for _ in 0..SEARCHES {
            let found = match self.touch(grid, surface, (&at, &target), known.take(), &mut steps) {
                Way::Held(found) => found,
                Way::Open(free) => {
                    at = free;
                    if steps == 0 {
                        break;
                    }
                    continue;
                }
                Way::Free => {
                    at = target;
                    if target == aim {
                        break;
                    }
                    // Beside a plane of contact the surface falls away: on from there.
                    (held, target) = (0, aim);
                    continue;
                }
            };
            at = found.center;
            let is_first = self.touched.is_none();
            if is_first {
                (self.touched, self.normal) = (Some(found.index), found.normal);
            }
            // What is nearly the same plane, seen from another place, is not a corner.
            let mut kept = 0;
            for place in 0..held {
                if planes[place].0.dot(&found.normal) < PARALLEL {
                    planes[kept] = planes[place];
                    kept += 1;
                }
            }
            if kept == 3 {
                planes.rotate_left(1);
                kept = 2;
            }
            planes[kept] = (found.normal, at);
            held = kept + 1;
            target = nearest_allowed(&planes[..held], &aim);
            if is_first && law.friction > 0.0 {
                // Within the cone the ball stays; beyond it, it slides as far as the cone's edge.
                let depth = (at - goal).dot(&found.normal).max(0.0);
                let slide = target - at;
                let held_back = law.friction * depth;
                if slide.norm() <= held_back {
                    break;
                }
                let shorter = slide.normalize() * held_back;
                (aim, target) = (aim - shorter, target - shorter);
            }
            if (target - at).norm() < TOLERANCE {
                break;
            }
        }
        if (at - goal).norm() < TOLERANCE {
            (self.touched, self.normal) = (None, Vector3::zeros());
        }
        self.position = Some(at);
        at
    }

    /// Force on the goal, N, for its velocity in m/s, both in the volume's frame; after [`update`](Self::update).
    pub fn force(&self, law: &Law, goal: &Point3<f64>, velocity: &Vector3<f64>) -> Vector3<f64> {
        let (Some(at), Some(_)) = (self.position, self.touched) else { return Vector3::zeros() };
        let mut force = (at - goal) * law.stiffness;
        let approach = -velocity.dot(&self.normal);
        if approach > 0.0 && approach.is_finite() {
            force += self.normal * (law.damping * approach);
        }
        force *= 1.0 - f64::from(self.returning) / f64::from(RETURN);
        let size = force.norm();
        if size > law.most {
            force * (law.most / size)
        } else {
            force
        }
    }

    /// First touch on a straight way; `known`: what is nearest to its beginning, if that was looked for.
    fn touch(
        &mut self,
        grid: &VoxelGrid,
        surface: Surface,
        (from, to): (&Point3<f64>, &Point3<f64>),
        known: Option<Nearest>,
        steps: &mut usize,
    ) -> Way {
        match surface {
            Surface::Balls => self.touch_balls(grid, from, to).map_or(Way::Free, Way::Held),
            Surface::Interpolated => self.touch_interpolated(grid, (from, to), known, steps).unwrap_or(Way::Free),
        }
    }

    fn touch_balls(&self, grid: &VoxelGrid, from: &Point3<f64>, to: &Point3<f64>) -> Option<Found> {
        let reach = self.radius + grid.ball();
        let way = to - from;
        let mut touch = grid.sweep(from, to, reach)?;
        // A ball at rest on a surface moves away from it freely.
        if touch.part == 0.0 && way.dot(&touch.normal) > -1e-9 * way.norm() {
            let lift = touch.normal * TOLERANCE;
            touch = grid.sweep(&(from + lift), &(to + lift), reach)?;
        }
        Some(Found { center: touch.center + touch.normal * TOLERANCE, normal: touch.normal, index: touch.index })
    }

    /// `None`: nothing is near the way.
    fn touch_interpolated(
        &mut self,
        grid: &VoxelGrid,
        (from, to): (&Point3<f64>, &Point3<f64>),
        mut known: Option<Nearest>,
        steps: &mut usize,
    ) -> Option<Way> {
        let way = to - from;
        let length = way.norm();
        if length == 0.0 {
            return None;
        }
        let direction = way / length;
        let reach = self.radius + length + grid.spacing().norm();
        let mut along = 0.0;
        // As far as it is known to be free.
        let mut free = 0.0;
        loop {
            let at = from + direction * along;
            let (distance, normal, index) = match known.take() {
                Some(nearest) => nearest,
                None if *steps == 0 => return Some(Way::Open(from + direction * free)),
                None => {
                    *steps -= 1;
                    grid.interpolated_distance(&at, reach, self.guess)?
                }
            };
            self.guess = Some(index);
            let gap = distance - self.radius;
            let approach = -direction.dot(&normal);
            if gap < 2.0 * TOLERANCE && approach > 1e-9 {
                // Out of what rounding or a rough surface has left.
                return Some(Way::Held(Found { center: at + normal * (TOLERANCE - gap).max(0.0), normal, index }));
            }
            free = along;
            if gap < 2.0 * TOLERANCE {
                // It slides along, or leaves: as far as a voxel's part, then it is looked again.
                along += (0.25 * grid.spacing().min()).min(length);
            } else {
                along += gap;
                free = along.min(length);
            }
            if along >= length {
                let (distance, normal, index) = grid.interpolated_distance(to, reach, self.guess)?;
                let center = to + normal * (self.radius + TOLERANCE - distance);
                let is_held = distance < self.radius - TOLERANCE;
                return is_held.then_some(Way::Held(Found { center, normal, index }));
            }
        }
    }

    /// The nearest free place, if the ball is inside by more than a hundredth of a voxel; else what is nearest to it, if
    /// that is near and the surface is interpolated.
    fn escape(
        &mut self,
        grid: &VoxelGrid,
        surface: Surface,
        at: &Point3<f64>,
    ) -> (Option<Point3<f64>>, Option<Nearest>) {
        let slack = 0.01 * grid.spacing().min();
        let gap = |at: &Point3<f64>, guess| match surface {
            Surface::Balls => {
                let reach = self.radius + grid.ball();
                let near = grid.nearest_solid_near(at, reach, guess)?;
                let inside = grid.is_solid(grid.index_at(at)?);
                let center = if inside {
                    grid.center(grid.nearest_free(at, f64::INFINITY)?.index)
                } else {
                    grid.center(near.index)
                };
                let away = if inside { center - at } else { at - center };
                let gap = if inside { -away.norm() - reach } else { near.distance - reach };
                Some((gap, away.try_normalize(1e-12)?, near.index))
            }
            Surface::Interpolated => {
                let found = grid.interpolated_distance(at, self.radius + grid.spacing().norm(), guess)?;
                Some((found.0 - self.radius, found.1, found.2))
            }
        };
        let Some((mut by, mut normal, index)) = gap(at, self.guess) else { return (None, None) };
        self.guess = Some(index);
        if by >= -slack {
            let is_interpolated = surface == Surface::Interpolated;
            return (None, is_interpolated.then_some((by + self.radius, normal, index)));
        }
        let mut free = *at;
        for _ in 0..ESCAPES {
            free += normal * (TOLERANCE - by);
            match gap(&free, None) {
                Some((next, away, _)) if next < 0.0 => (by, normal) = (next, away),
                _ => break,
            }
        }
        (Some(free), None)
    }
}

/// The point nearest to `goal` on the free sides of up to three planes: of all planes, lines and points in which they
/// meet, the nearest that none of them forbids.
fn nearest_allowed(planes: &[(Vector3<f64>, Point3<f64>)], goal: &Point3<f64>) -> Point3<f64> {
    let mut best: Option<(f64, Point3<f64>)> = None;
    for chosen in 0_u32..1 << planes.len() {
        let mut active = [(Vector3::zeros(), Point3::origin()); 3];
        let mut count = 0;
        for (place, plane) in planes.iter().enumerate() {
            if chosen >> place & 1 == 1 {
                active[count] = *plane;
                count += 1;
            }
        }
        let Some(point) = project(&active[..count], goal) else { continue };
        let allowed = planes.iter().all(|(normal, on)| normal.dot(&(point - on)) >= -1e-9);
        let square = (point - goal).norm_squared();
        if allowed && best.is_none_or(|(least, _)| square < least) {
            best = Some((square, point));
        }
    }
    // Planes that leave nothing in common hold the ball where it is.
    best.map_or(planes[planes.len() - 1].1, |(_, point)| point)
}

/// The point nearest to `goal` in which planes meet; `None` where they are as good as parallel.
fn project(planes: &[(Vector3<f64>, Point3<f64>)], goal: &Point3<f64>) -> Option<Point3<f64>> {
    let offset = |(normal, on): &(Vector3<f64>, Point3<f64>)| normal.dot(&(on - goal));
    match planes {
        [] => Some(*goal),
        [a] => Some(goal + a.0 * offset(a)),
        [a, b] => {
            let along = a.0.dot(&b.0);
            let determinant = 1.0 - along * along;
            if determinant < 1e-6 {
                return None;
            }
            let (da, db) = (offset(a), offset(b));
            Some(goal + a.0 * ((da - along * db) / determinant) + b.0 * ((db - along * da) / determinant))
        }
        [a, b, c, ..] => {
            let normals = nalgebra::Matrix3::from_rows(&[a.0.transpose(), b.0.transpose(), c.0.transpose()]);
            if normals.determinant().abs() < 1e-6 {
                return None;
            }
            Some(goal + normals.try_inverse()? * Vector3::new(offset(a), offset(b), offset(c)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Label, Voxel};

    #[test]
    fn a_ball_that_passes_close_to_a_surface_does_not_touch_it() {
        let voxel = |[_, _, k]: [usize; 3]| if k < 8 { Voxel { density: 255, label: 1 } } else { Voxel::default() };
        let edges = Vector3::new(0.064, 0.016, 0.016);
        let grid = VoxelGrid::from_fn([64, 16, 16], edges, 0.5, vec![Label::of_color([255; 3])], voxel).unwrap();
        let (law, mut proxy) = (Law::default(), Proxy::new(1e-3));
        let mut start = Point3::new(-0.015, 0.0, 0.003);
        let (distance, ..) = grid.interpolated_distance(&start, 0.01, None).unwrap();
        start.z -= distance - proxy.radius - 1e-5;
        proxy.update(&grid, Surface::Interpolated, &law, &start);
        // Steps as long as the gap do not reach the goal in one search, nor in all of an update.
        let goal = start + Vector3::x() * 0.03;
        let mut updates = 0;
        while proxy.position != Some(goal) {
            let before = proxy.position.unwrap();
            let at = proxy.update(&grid, Surface::Interpolated, &law, &goal);
            assert_eq!((proxy.touched, proxy.force(&law, &goal, &Vector3::zeros())), (None, Vector3::zeros()));
            assert!(at.x > before.x && (at.z - start.z).abs() < 1e-9, "{before} to {at}");
            updates += 1;
        }
        assert!(updates > 1, "{updates}");
    }
}
