//! Vectors, matrices and inertias. In C++ the first two are `btVector3` and `btMatrix3x3`; operations are in their order.

use std::ops::{Add, AddAssign, Mul, Neg, Sub, SubAssign};

use super::scalar::Scalar;

/// A vector.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Vector<S: Scalar> {
    /// Components.
    pub x: S,
    /// See [`x`](Self::x).
    pub y: S,
    /// See [`x`](Self::x).
    pub z: S,
    pad: S::Pad,
}

impl<S: Scalar> Vector<S> {
    /// Of three components.
    #[inline(always)]
    pub fn new(x: S, y: S, z: S) -> Self {
        Self { x, y, z, pad: S::Pad::default() }
    }

    /// The vector 0.
    #[inline(always)]
    pub fn zero() -> Self {
        let zero = S::splat(0.0);
        Self::new(zero, zero, zero)
    }

    /// The same vector in all worlds.
    #[inline(always)]
    pub fn splat(of: &Vector<f64>) -> Self {
        Self::new(S::splat(of.x), S::splat(of.y), S::splat(of.z))
    }

    /// Scalar product.
    #[inline(always)]
    pub fn dot(self, other: Self) -> S {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Vector product.
    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// Square of the length.
    #[inline(always)]
    pub fn square(self) -> S {
        self.dot(self)
    }

    /// Length.
    #[inline(always)]
    pub fn length(self) -> S {
        self.square().sqrt()
    }

    /// Products of components.
    #[inline(always)]
    pub fn times(self, other: Self) -> Self {
        Self::new(self.x * other.x, self.y * other.y, self.z * other.z)
    }
}

impl<S: Scalar> Add for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y, self.z + other.z)
    }
}

impl<S: Scalar> Sub for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y, self.z - other.z)
    }
}

impl<S: Scalar> Neg for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}

impl<S: Scalar> Mul<S> for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: S) -> Self {
        Self::new(self.x * factor, self.y * factor, self.z * factor)
    }
}

impl<S: Scalar> AddAssign for Vector<S> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<S: Scalar> SubAssign for Vector<S> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl From<[f64; 4]> for Vector<f64> {
    /// The fourth number fills the vector up.
    #[inline(always)]
    fn from([x, y, z, pad]: [f64; 4]) -> Self {
        Self { x, y, z, pad }
    }
}

/// A quaternion x, y, z, w.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Quaternion<S>(pub [S; 4]);

impl<S: Scalar> Quaternion<S> {
    /// No rotation.
    #[inline(always)]
    pub fn identity() -> Self {
        let zero = S::splat(0.0);
        Self([zero, zero, zero, S::splat(1.0)])
    }

    /// The rotation by an angle, rad, about an axis of any length but 0.
    #[inline(always)]
    fn about(axis: Vector<S>, angle: S) -> Self {
        let (sine, cosine) = (angle * S::splat(0.5)).sin_cos();
        let scale = sine / axis.length();
        Self([axis.x * scale, axis.y * scale, axis.z * scale, cosine])
    }

    /// The derivative by time of a rotation at this angular velocity.
    #[inline(always)]
    pub fn spin(self, omega: Vector<S>) -> Self {
        (Self([omega.x, omega.y, omega.z, S::splat(0.0)]) * self) * S::splat(0.5)
    }

    /// Of length 1.
    #[inline(always)]
    pub fn normalised(self) -> Self {
        let [x, y, z, w] = self.0;
        self * (S::splat(1.0) / (x * x + y * y + z * z + w * w).sqrt())
    }

    /// This one where a number is positive, else another.
    #[inline(always)]
    pub fn where_positive(self, number: S, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([
            number.if_positive(a[0], b[0]),
            number.if_positive(a[1], b[1]),
            number.if_positive(a[2], b[2]),
            number.if_positive(a[3], b[3]),
        ])
    }

    /// Turned for h s at an angular velocity, by the exponential map.
    #[inline(always)]
    pub fn turned(self, omega: Vector<S>, h: S) -> Self {
        let speed = omega.length();
        let turned = (Self::about(omega * (S::splat(1.0) / speed), speed * h) * self).normalised();
        turned.where_positive((speed * h).abs(), self)
    }
}

impl<S: Scalar> Mul for Quaternion<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([
            a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
            a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2],
            a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0],
            a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
        ])
    }
}

impl<S: Scalar> Mul<S> for Quaternion<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: S) -> Self {
        let [x, y, z, w] = self.0;
        Self([x * factor, y * factor, z * factor, w * factor])
    }
}

impl<S: Scalar> Add for Quaternion<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]])
    }
}

/// A matrix, by rows.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Matrix<S: Scalar>(pub [Vector<S>; 3]);

impl<S: Scalar> Matrix<S> {
    /// The same matrix in all worlds.
    #[inline(always)]
    pub fn splat(of: &Matrix<f64>) -> Self {
        let [x, y, z] = &of.0;
        Self([Vector::splat(x), Vector::splat(y), Vector::splat(z)])
    }

    /// A column.
    #[inline(always)]
    pub fn column(&self, index: usize) -> Vector<S> {
        let [a, b, c] = &self.0;
        match index {
            0 => Vector::new(a.x, b.x, c.x),
            1 => Vector::new(a.y, b.y, c.y),
            _ => Vector::new(a.z, b.z, c.z),
        }
    }

    /// The rotation of a quaternion x, y, z, w of any length but 0.
    #[inline(always)]
    pub fn of_quaternion(Quaternion([x, y, z, w]): Quaternion<S>) -> Self {
        let one = S::splat(1.0);
        let scale = S::splat(2.0) / (x * x + y * y + z * z + w * w);
        let (xs, ys, zs) = (x * scale, y * scale, z * scale);
        let (wx, wy, wz) = (w * xs, w * ys, w * zs);
        let (xx, xy, xz) = (x * xs, x * ys, x * zs);
        let (yy, yz, zz) = (y * ys, y * zs, z * zs);
        Self([
            Vector::new(one - (yy + zz), xy - wz, xz + wy),
            Vector::new(xy + wz, one - (xx + zz), yz - wx),
            Vector::new(xz - wy, yz + wx, one - (xx + yy)),
        ])
    }
}

impl<S: Scalar> Matrix<S> {
    /// Product of the transposed matrix with a vector.
    #[inline(always)]
    pub fn transposed_times(&self, v: Vector<S>) -> Vector<S> {
        let [a, b, c] = self.0;
        a * v.x + b * v.y + c * v.z
    }
}

impl<S: Scalar> Mul<Vector<S>> for &Matrix<S> {
    type Output = Vector<S>;

    #[inline(always)]
    fn mul(self, vector: Vector<S>) -> Vector<S> {
        let [a, b, c] = &self.0;
        Vector::new(a.dot(vector), b.dot(vector), c.dot(vector))
    }
}

impl<S: Scalar> Mul for &Matrix<S> {
    type Output = Matrix<S>;

    #[inline(always)]
    fn mul(self, other: &Matrix<S>) -> Matrix<S> {
        let (x, y, z) = (other.column(0), other.column(1), other.column(2));
        let [a, b, c] = self.0;
        Matrix([
            Vector::new(x.dot(a), y.dot(a), z.dot(a)),
            Vector::new(x.dot(b), y.dot(b), z.dot(b)),
            Vector::new(x.dot(c), y.dot(c), z.dot(c)),
        ])
    }
}

/// A symmetric matrix.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Symmetric<S> {
    xx: S,
    xy: S,
    xz: S,
    yy: S,
    yz: S,
    zz: S,
}

impl<S: Scalar> Symmetric<S> {
    /// The matrix 0.
    #[inline(always)]
    pub fn zero() -> Self {
        let zero = S::splat(0.0);
        Self { xx: zero, xy: zero, xz: zero, yy: zero, yz: zero, zz: zero }
    }

    /// Inertia tensor, kg·m², of a body with these principal moments and this orientation.
    #[inline(always)]
    pub fn of_moments(rotation: &Matrix<S>, moments: Vector<S>) -> Self {
        let [a, b, c] = rotation.0;
        let (x, y, z) = (a.times(moments), b.times(moments), c.times(moments));
        Self { xx: x.dot(a), xy: x.dot(b), xz: x.dot(c), yy: y.dot(b), yz: y.dot(c), zz: z.dot(c) }
    }

    /// Product with a vector.
    #[inline(always)]
    pub fn times(&self, v: Vector<S>) -> Vector<S> {
        Vector::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
    }

    /// Subtracts v vᵀ times a factor.
    #[inline(always)]
    fn subtract_outer(&mut self, v: Vector<S>, factor: S) {
        let (x, y, z) = (v.x * factor, v.y * factor, v.z * factor);
        self.xx -= x * v.x;
        self.xy -= x * v.y;
        self.xz -= x * v.z;
        self.yy -= y * v.y;
        self.yz -= y * v.z;
        self.zz -= z * v.z;
    }

    #[inline(always)]
    fn add(&mut self, other: &Self) {
        self.xx += other.xx;
        self.xy += other.xy;
        self.xz += other.xz;
        self.yy += other.yy;
        self.yz += other.yz;
        self.zz += other.zz;
    }

    #[inline(always)]
    fn element(&self, row: usize, column: usize) -> S {
        [[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]][row][column]
    }
}

/// Inertia of a body and of what hangs on it: torque and force from angular and linear acceleration, about the centre of mass:
/// [a b; bᵀ m].
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Inertia<S> {
    a: Symmetric<S>,
    m: Symmetric<S>,
    b: [[S; 3]; 3],
}

impl<S: Scalar> Inertia<S> {
    /// That of a single body.
    #[inline(always)]
    pub fn of_body(inertia: Symmetric<S>, mass: S) -> Self {
        let zero = S::splat(0.0);
        Self {
            a: inertia,
            m: Symmetric { xx: mass, xy: zero, xz: zero, yy: mass, yz: zero, zz: mass },
            b: [[zero; 3]; 3],
        }
    }

    /// Element of the lower triangle of the 6 × 6 matrix, angular first.
    #[inline(always)]
    pub fn element(&self, row: usize, column: usize) -> S {
        match (row < 3, column < 3) {
            (true, _) => self.a.element(row, column),
            (false, true) => self.b[column][row - 3],
            (false, false) => self.m.element(row - 3, column - 3),
        }
    }

    /// Torque and force for angular and linear accelerations.
    #[inline(always)]
    pub fn times(&self, angular: Vector<S>, linear: Vector<S>) -> (Vector<S>, Vector<S>) {
        let (b, v, w) = (&self.b, angular, linear);
        let mut torque = self.a.times(v);
        let mut force = self.m.times(w);
        torque.x += b[0][0] * w.x + b[0][1] * w.y + b[0][2] * w.z;
        torque.y += b[1][0] * w.x + b[1][1] * w.y + b[1][2] * w.z;
        torque.z += b[2][0] * w.x + b[2][1] * w.y + b[2][2] * w.z;
        force.x += b[0][0] * v.x + b[1][0] * v.y + b[2][0] * v.z;
        force.y += b[0][1] * v.x + b[1][1] * v.y + b[2][1] * v.z;
        force.z += b[0][2] * v.x + b[1][2] * v.y + b[2][2] * v.z;
        (torque, force)
    }

    /// Subtracts U D⁻¹ Uᵀ: what is seen through a degree of freedom.
    #[inline(always)]
    pub fn remove(&mut self, u_angular: Vector<S>, u_linear: Vector<S>, d_inverse: S) {
        self.a.subtract_outer(u_angular, d_inverse);
        self.m.subtract_outer(u_linear, d_inverse);
        let scaled = u_angular * d_inverse;
        for (row, scale) in self.b.iter_mut().zip([scaled.x, scaled.y, scaled.z]) {
            row[0] -= scale * u_linear.x;
            row[1] -= scale * u_linear.y;
            row[2] -= scale * u_linear.z;
        }
    }

    /// Adds that of a link whose centre of mass is at r from this one.
    #[inline(always)]
    pub fn add(&mut self, link: &Self, r: Vector<S>) {
        let (x, y, z) = (r.x, r.y, r.z);
        let (s, n) = (&link.b, &link.m);
        // [r] m and b [r], where [r] v is r × v.
        let t = [
            [s[0][0] + (y * n.xz - z * n.xy), s[0][1] + (y * n.yz - z * n.yy), s[0][2] + (y * n.zz - z * n.yz)],
            [s[1][0] + (z * n.xx - x * n.xz), s[1][1] + (z * n.xy - x * n.yz), s[1][2] + (z * n.xz - x * n.zz)],
            [s[2][0] + (x * n.xy - y * n.xx), s[2][1] + (x * n.yy - y * n.xy), s[2][2] + (x * n.yz - y * n.xz)],
        ];
        let (a, l) = (&mut self.a, &link.a);
        a.xx += l.xx - (s[0][1] * z - s[0][2] * y) + (y * t[0][2] - z * t[0][1]);
        a.xy += l.xy - (s[0][2] * x - s[0][0] * z) + (y * t[1][2] - z * t[1][1]);
        a.xz += l.xz - (s[0][0] * y - s[0][1] * x) + (y * t[2][2] - z * t[2][1]);
        a.yy += l.yy - (s[1][2] * x - s[1][0] * z) + (z * t[1][0] - x * t[1][2]);
        a.yz += l.yz - (s[1][0] * y - s[1][1] * x) + (z * t[2][0] - x * t[2][2]);
        a.zz += l.zz - (s[2][0] * y - s[2][1] * x) + (x * t[2][1] - y * t[2][0]);
        for (row, shifted) in self.b.iter_mut().zip(t) {
            row[0] += shifted[0];
            row[1] += shifted[1];
            row[2] += shifted[2];
        }
        self.m.add(&link.m);
    }
}
