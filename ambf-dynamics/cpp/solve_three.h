// Solution of three linear equations. C++ only.
#ifndef AMB_SOLVE_THREE_H
#define AMB_SOLVE_THREE_H

#include <LinearMath/btMatrix3x3.h>

// Solves m x = b; a singular m gives 0. btMatrix3x3::solve33 gives next to 0 for determinants below SIMD_EPSILON, which the
// inertia of a body of a few centimetres has in SI units.
inline btVector3 solve_three(const btMatrix3x3 &m, const btVector3 &b) {
  const btVector3 x = m.getColumn(0), y = m.getColumn(1), z = m.getColumn(2), normal = y.cross(z);
  const btScalar determinant = x.dot(normal);
  if (determinant == 0) return btVector3(0, 0, 0);
  return btVector3(b.dot(normal), x.dot(b.cross(z)), x.dot(y.cross(b))) / determinant;
}

#endif
