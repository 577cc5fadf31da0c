//! How a mouse moves a camera: pure functions of where it is and what it looks at.
//!
//! A camera looks along its −x axis; +y is right in its picture, +z up. "Up" is the z axis of its parent.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Steepest view that looking around reaches, rad: 89°, so that the picture never turns over.
const STEEPEST_LOOK: f64 = 89.0 / 180.0 * std::f64::consts::PI;
/// Highest elevation that orbiting reaches, rad.
const STEEPEST_ORBIT: f64 = 1.5;
/// Nearest that a camera comes to the point that it looks at, m: from there on it pushes the point on.
const NEAREST: f64 = 0.5;
/// Narrowest view of an orthographic camera, m.
const NARROWEST: f64 = 1e-3;

/// Where a camera is, and the point about which it orbits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraPlace {
    /// Pose in the parent's frame.
    pub pose: Isometry3<f64>,
    /// The point that it looks at, in the *camera's* frame, m: it travels with every motion but
    /// [`Dolly`](CameraGesture::Dolly).
    pub target: Vector3<f64>,
    /// Width of an orthographic view, m; without meaning for other views.
    pub width: f64,
}

/// A motion of a camera by mouse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CameraGesture {
    /// Moves in the plane of the picture.
    Pan {
        /// m.
        right: f64,
        /// m.
        up: f64,
    },
    /// Moves in any direction, with its target: what follows a body. In the camera's frame, m.
    Shift(Vector3<f64>),
    /// Turns about its own position; roll goes to 0.
    Look {
        /// About the parent's z axis, rad: positive turns the view to the left.
        left: f64,
        /// rad; the view stops 1° before the zenith.
        up: f64,
    },
    /// Moves about its target at constant distance and looks at it; roll goes to 0.
    Orbit {
        /// Length of the arc, m.
        right: f64,
        /// Length of the arc, m; the motion stops at an elevation of ± 1.5 rad.
        up: f64,
    },
    /// Moves along its axis. The target stays where it is, but is pushed on when it would be nearer than 0.5 m. An
    /// orthographic view becomes narrower by the same length, never empty.
    Dolly {
        /// m, towards the scene.
        forward: f64,
    },
}

impl CameraGesture {
    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        match *self {
            Self::Pan { right: a, up: b } | Self::Look { left: a, up: b } | Self::Orbit { right: a, up: b } => {
                a.is_finite() && b.is_finite()
            }
            Self::Dolly { forward } => forward.is_finite(),
            Self::Shift(by) => by.iter().all(|x| x.is_finite()),
        }
    }

    /// Both one after the other, if that is one gesture of the same kind.
    pub fn merged(self, next: Self) -> Option<Self> {
        Some(match (self, next) {
            (Self::Pan { right, up }, Self::Pan { right: r, up: u }) => Self::Pan { right: right + r, up: up + u },
            (Self::Shift(by), Self::Shift(then)) => Self::Shift(by + then),
            (Self::Look { left, up }, Self::Look { left: l, up: u }) => Self::Look { left: left + l, up: up + u },
            (Self::Orbit { right, up }, Self::Orbit { right: r, up: u }) => {
                Self::Orbit { right: right + r, up: up + u }
            }
            // Whether the target is pushed on depends on the single steps.
            _ => return None,
        })
    }
}

impl CameraPlace {
    /// The place after a gesture; unchanged if that holds numbers that are not finite.
    #[must_use]
    pub fn moved(mut self, gesture: CameraGesture) -> Self {
        if !gesture.is_finite() {
            return self;
        }
        match gesture {
            CameraGesture::Pan { right, up } => self.step(Vector3::new(0.0, right, up)),
            CameraGesture::Shift(by) => self.step(by),
            CameraGesture::Look { left, up } => {
                let (azimuth, elevation) = heading(&self.pose.rotation);
                let steepest = STEEPEST_LOOK.max(elevation.abs());
                let elevation = (elevation + up).clamp(-steepest, steepest);
                self.pose.rotation = looking(azimuth + left, elevation);
            }
            CameraGesture::Orbit { right, up } => self.orbit(right, up),
            CameraGesture::Dolly { forward } => {
                self.step(Vector3::new(-forward, 0.0, 0.0));
                // In the camera's frame the target comes nearer, unless it is pushed.
                if !(forward > 0.0 && -self.target.x - forward < NEAREST) {
                    self.target.x += forward;
                }
                let narrowest = NARROWEST.min(self.width);
                self.width = (self.width - forward).max(narrowest);
            }
        }
        self
    }

    fn step(&mut self, in_camera: Vector3<f64>) {
        self.pose.translation.vector += self.pose.rotation * in_camera;
    }

    fn orbit(&mut self, right: f64, up: f64) {
        let target = self.pose * nalgebra::Point3::from(self.target);
        let arm = self.pose.translation.vector - target.coords;
        let distance = arm.norm();
        if distance < 1e-9 {
            return;
        }
        // What lies behind the target as seen from the camera is what it looks at, so the arm's heading is that of the
        // view, reversed.
        let (azimuth, elevation) = match arm.xy().norm() > 1e-9 * distance {
            true => (arm.y.atan2(arm.x), (arm.z / distance).clamp(-1.0, 1.0).asin()),
            false => {
                let (view, elevation) = heading(&self.pose.rotation);
                (view + std::f64::consts::PI, -elevation)
            }
        };
        let steepest = STEEPEST_ORBIT.max(elevation.abs());
        let radius = distance * elevation.cos().max(STEEPEST_ORBIT.cos());
        let azimuth = azimuth + right / radius;
        let elevation = (elevation + up / distance).clamp(-steepest, steepest);
        self.pose.rotation = looking(azimuth + std::f64::consts::PI, -elevation);
        self.pose.translation.vector = target.coords + self.pose.rotation * Vector3::new(distance, 0.0, 0.0);
        self.target = Vector3::new(-distance, 0.0, 0.0);
    }
}

/// Azimuth about z and elevation of a view, rad. Of a view along z the azimuth is that of what is up in the picture, or
/// down.
fn heading(rotation: &UnitQuaternion<f64>) -> (f64, f64) {
    let (view, up) = (rotation * -Vector3::x(), rotation * Vector3::z());
    let elevation = view.z.clamp(-1.0, 1.0).asin();
    let level = match view.xy().norm() > 1e-9 {
        true => view,
        false => -up * view.z.signum(),
    };
    (level.y.atan2(level.x), elevation)
}

/// Rotation of a camera that looks in a direction without roll.
fn looking(azimuth: f64, elevation: f64) -> UnitQuaternion<f64> {
    let ((sa, ca), (se, ce)) = (azimuth.sin_cos(), elevation.sin_cos());
    let x = -Vector3::new(ca * ce, sa * ce, se);
    let y = Vector3::new(sa, -ca, 0.0);
    let columns = Matrix3::from_columns(&[x, y, x.cross(&y)]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns))
}

#[cfg(test)]
mod tests {
    use super::super::attached::camera_pose;
    use super::*;

    /// Multipliers of the C++ program: m/pixel, rad/pixel, m/pixel, m/tick.
    const PAN: f64 = 0.01;
    const LOOK: f64 = 0.3 * std::f64::consts::PI / 180.0;
    const ORBIT: f64 = 0.03;
    const DOLLY: f64 = 0.1;

    fn place(location: [f64; 3], look_at: [f64; 3]) -> CameraPlace {
        let (location, look_at) = (Vector3::from(location), Vector3::from(look_at));
        let pose = camera_pose(&location, &look_at, &Vector3::z());
        CameraPlace { pose, target: Vector3::new(-(location - look_at).norm(), 0.0, 0.0), width: 2.0 }
    }

    fn position(place: &CameraPlace) -> Vector3<f64> {
        place.pose.translation.vector
    }

    fn target_in_parent(place: &CameraPlace) -> Vector3<f64> {
        position(place) + place.pose.rotation * place.target
    }

    fn roll(place: &CameraPlace) -> f64 {
        (place.pose.rotation * Vector3::y()).z
    }

    #[test]
    fn row_59_a_left_drag_pans_a_centimetre_a_pixel() {
        let start = place([3.0, 0.0, 0.0], [0.0; 3]);
        let after = start.moved(CameraGesture::Pan { right: -100.0 * PAN, up: 0.0 });
        assert!((position(&after) - Vector3::new(3.0, -1.0, 0.0)).norm() < 1e-12, "the camera goes left");
        let after = start.moved(CameraGesture::Pan { right: 0.0, up: 50.0 * PAN });
        assert!((position(&after) - Vector3::new(3.0, 0.0, 0.5)).norm() < 1e-12, "down drags go up");
        assert_eq!(after.target, start.target, "the target travels along");
    }

    #[test]
    fn row_60_a_right_drag_turns_to_the_left_and_up_without_roll() {
        let start = place([3.0, 0.0, 0.0], [0.0; 3]);
        let after = start.moved(CameraGesture::Look { left: 50.0 * LOOK, up: 30.0 * LOOK });
        let view = after.pose.rotation * -Vector3::x();
        // It looked along −x: left of that is −y.
        let left = (-view.y).atan2(-view.x).to_degrees();
        assert!((left - 15.0).abs() < 1e-9, "{left}");
        assert!((view.z.asin().to_degrees() - 9.0).abs() < 1e-9);
        assert!(roll(&after).abs() < 1e-12);
        assert_eq!(position(&after), position(&start));
        let rolled =
            CameraPlace { pose: start.pose * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.4), ..start };
        assert!(roll(&rolled).abs() > 0.1);
        assert!(roll(&rolled.moved(CameraGesture::Look { left: 0.01, up: 0.0 })).abs() < 1e-12);
    }

    #[test]
    fn looking_stops_before_the_zenith_and_comes_back_from_it() {
        let start = place([3.0, 0.0, 0.0], [0.0; 3]);
        let up = start.moved(CameraGesture::Look { left: 0.0, up: 10.0 });
        let view = up.pose.rotation * -Vector3::x();
        assert!((view.z.asin().to_degrees() - 89.0).abs() < 1e-9);
        assert!((up.pose.rotation * Vector3::z()).z > 0.0, "not turned over");
        let pose = camera_pose(&Vector3::z(), &Vector3::zeros(), &Vector3::x());
        let down = CameraPlace { pose, ..start };
        let same = down.moved(CameraGesture::Look { left: 0.0, up: 0.0 });
        assert!(down.pose.rotation.angle_to(&same.pose.rotation) < 1e-7, "a view straight down does not jump");
        assert!(!down
            .moved(CameraGesture::Look { left: 0.0, up: 0.3 })
            .pose
            .rotation
            .coords
            .iter()
            .any(|x| x.is_nan()));
    }

    #[test]
    fn row_61_a_middle_drag_orbits_at_constant_distance() {
        // Elevation 19.8° and 2.5 m beside the target, as in the C++ program where the angles were measured.
        let height = 2.5 * (19.8_f64).to_radians().tan();
        let start = place([2.5, 0.0, height], [0.0; 3]);
        let distance = position(&start).norm();
        let drag = |start: CameraPlace, right: f64, down: f64| {
            (0..10).fold(start, |place, _| {
                place.moved(CameraGesture::Orbit { right: -right / 10.0 * ORBIT, up: down / 10.0 * ORBIT })
            })
        };
        let sideways = drag(start, 60.0, 0.0);
        let azimuth = position(&sideways).y.atan2(position(&sideways).x).to_degrees();
        assert!((azimuth + 41.0).abs() < 0.5, "41° clockwise as seen from above: {azimuth}");
        let up = drag(start, 0.0, 30.0);
        let elevation = (position(&up).z / distance).asin().to_degrees();
        assert!((elevation - 39.2).abs() < 0.1, "{elevation}");
        for place in [sideways, up, drag(start, 30.0, -200.0), drag(start, 0.0, 2000.0)] {
            assert!((position(&place).norm() - distance).abs() < 1e-12);
            assert!(target_in_parent(&place).norm() < 1e-9, "the target is in the middle");
            assert!(roll(&place).abs() < 1e-12);
            assert!((position(&place).z / distance).asin().abs() <= 1.5 + 1e-9);
        }
        let overhead = place([0.0, 0.0, 2.0], [0.0; 3]);
        let moved = overhead.moved(CameraGesture::Orbit { right: 0.1, up: 0.1 });
        assert!(moved.pose.to_homogeneous().iter().all(|x| x.is_finite()));
    }

    #[test]
    fn row_62_the_wheel_comes_nearer_and_never_passes_the_target() {
        let start = place([3.0, 0.0, 0.0], [0.0; 3]);
        let nearer = start.moved(CameraGesture::Dolly { forward: DOLLY });
        assert!((position(&nearer) - Vector3::new(2.9, 0.0, 0.0)).norm() < 1e-12);
        assert!(target_in_parent(&nearer).norm() < 1e-12, "the target stays");
        assert!((nearer.width - 1.9).abs() < 1e-12);
        let mut place = start;
        for _ in 0..100 {
            place = place.moved(CameraGesture::Dolly { forward: DOLLY });
            assert!(-place.target.x >= NEAREST - 1e-9, "{}", place.target.x);
        }
        assert!((position(&place).x - -7.0).abs() < 1e-9, "it goes on, and the target before it");
        assert!(place.width > 0.0);
        let leap = start.moved(CameraGesture::Dolly { forward: 50.0 });
        assert!(-leap.target.x >= NEAREST);
        let back = place.moved(CameraGesture::Dolly { forward: -2.0 });
        assert!((back.target.x - (place.target.x - 2.0)).abs() < 1e-12);
    }

    #[test]
    fn numbers_that_are_not_finite_move_nothing() {
        let start = place([3.0, 0.0, 0.0], [0.0; 3]);
        assert_eq!(start.moved(CameraGesture::Pan { right: f64::NAN, up: 0.0 }), start);
        assert_eq!(start.moved(CameraGesture::Dolly { forward: f64::INFINITY }), start);
    }

    #[test]
    fn merged_drags_lead_to_the_same_place() {
        let start = place([3.0, 1.0, 1.0], [0.0; 3]);
        for (a, b) in [
            (CameraGesture::Pan { right: 0.1, up: 0.2 }, CameraGesture::Pan { right: -0.3, up: 0.1 }),
            (CameraGesture::Look { left: 0.1, up: 0.2 }, CameraGesture::Look { left: -0.3, up: 0.1 }),
        ] {
            let (one, two) = (start.moved(a.merged(b).unwrap()), start.moved(a).moved(b));
            assert!((one.pose.to_homogeneous() - two.pose.to_homogeneous()).norm() < 1e-12);
        }
        assert!(CameraGesture::Dolly { forward: 1.0 }.merged(CameraGesture::Dolly { forward: 1.0 }).is_none());
    }
}
