// Inertia of a body and of what hangs on it, as the articulated-body algorithm sees it. C++ only.
#ifndef AMB_ARTICULATED_INERTIA_H
#define AMB_ARTICULATED_INERTIA_H

#include <LinearMath/btMatrix3x3.h>

// A symmetric matrix.
struct Symmetric3 {
  btScalar xx, xy, xz, yy, yz, zz;

  btScalar element(int i, int j) const {
    const btScalar rows[3][3] = {{xx, xy, xz}, {xy, yy, yz}, {xz, yz, zz}};
    return rows[i][j];
  }
  btVector3 operator*(const btVector3 &v) const {
    return btVector3(xx * v.x() + xy * v.y() + xz * v.z(), xy * v.x() + yy * v.y() + yz * v.z(),
                     xz * v.x() + yz * v.y() + zz * v.z());
  }
  // Subtracts v v^T times a factor.
  void subtract_outer(const btVector3 &v, btScalar factor) {
    const btScalar x = v.x() * factor, y = v.y() * factor, z = v.z() * factor;
    xx -= x * v.x();
    xy -= x * v.y();
    xz -= x * v.z();
    yy -= y * v.y();
    yz -= y * v.z();
    zz -= z * v.z();
  }
  void add(const Symmetric3 &other) {
    xx += other.xx;
    xy += other.xy;
    xz += other.xz;
    yy += other.yy;
    yz += other.yz;
    zz += other.zz;
  }
  // Inertia tensor, kg m^2, of a body with these principal moments and this orientation.
  static Symmetric3 of(const btMatrix3x3 &rotation, const btVector3 &moments) {
    const btVector3 x = rotation[0] * moments, y = rotation[1] * moments, z = rotation[2] * moments;
    return {x.dot(rotation[0]), x.dot(rotation[1]), x.dot(rotation[2]),
            y.dot(rotation[1]), y.dot(rotation[2]), z.dot(rotation[2])};
  }
};

// Torque and force from angular and linear acceleration, about the centre of mass: [a b; b^T m].
struct ArticulatedInertia {
  Symmetric3 a, m;
  btScalar b[3][3];

  // That of a single body.
  void set(const Symmetric3 &inertia, btScalar mass) {
    a = inertia;
    m = {mass, 0, 0, mass, 0, mass};
    for (auto &row : b) row[0] = row[1] = row[2] = 0;
  }

  // Element of the lower triangle of the 6 x 6 matrix, angular first.
  btScalar element(int i, int j) const {
    return i < 3 ? a.element(i, j) : j < 3 ? b[j][i - 3] : m.element(i - 3, j - 3);
  }

  void multiply(const btVector3 &angular, const btVector3 &linear, btVector3 &torque, btVector3 &force) const {
    const btScalar *v = angular, *w = linear;
    btVector3 up = a * angular, low = m * linear;
    for (int i = 0; i < 3; ++i) up[i] += b[i][0] * w[0] + b[i][1] * w[1] + b[i][2] * w[2];
    for (int i = 0; i < 3; ++i) low[i] += b[0][i] * v[0] + b[1][i] * v[1] + b[2][i] * v[2];
    torque = up;
    force = low;
  }

  // Subtracts U D^-1 U^T: what is seen through a degree of freedom.
  void remove(const btVector3 &u_angular, const btVector3 &u_linear, btScalar d_inverse) {
    a.subtract_outer(u_angular, d_inverse);
    m.subtract_outer(u_linear, d_inverse);
    const btVector3 scaled = u_angular * d_inverse;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) b[i][j] -= scaled[i] * u_linear[j];
    }
  }

  // Adds that of a link whose centre of mass is at r from this one.
  void add(const ArticulatedInertia &link, const btVector3 &r) {
    const btScalar x = r.x(), y = r.y(), z = r.z();
    const btScalar(&s)[3][3] = link.b;
    // [r] m and b [r], where [r] v is r x v.
    const Symmetric3 &n = link.m;
    const btScalar t[3][3] = {{s[0][0] + (y * n.xz - z * n.xy), s[0][1] + (y * n.yz - z * n.yy), s[0][2] + (y * n.zz - z * n.yz)},
                              {s[1][0] + (z * n.xx - x * n.xz), s[1][1] + (z * n.xy - x * n.yz), s[1][2] + (z * n.xz - x * n.zz)},
                              {s[2][0] + (x * n.xy - y * n.xx), s[2][1] + (x * n.yy - y * n.xy), s[2][2] + (x * n.yz - y * n.xz)}};
    a.xx += link.a.xx - (s[0][1] * z - s[0][2] * y) + (y * t[0][2] - z * t[0][1]);
    a.xy += link.a.xy - (s[0][2] * x - s[0][0] * z) + (y * t[1][2] - z * t[1][1]);
    a.xz += link.a.xz - (s[0][0] * y - s[0][1] * x) + (y * t[2][2] - z * t[2][1]);
    a.yy += link.a.yy - (s[1][2] * x - s[1][0] * z) + (z * t[1][0] - x * t[1][2]);
    a.yz += link.a.yz - (s[1][0] * y - s[1][1] * x) + (z * t[2][0] - x * t[2][2]);
    a.zz += link.a.zz - (s[2][0] * y - s[2][1] * x) + (x * t[2][1] - y * t[2][0]);
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) b[i][j] += t[i][j];
    }
    m.add(link.m);
  }
};

#endif
