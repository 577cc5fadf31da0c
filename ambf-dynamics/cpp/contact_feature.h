// What of a convex shape touches a surface. C++ only.
#ifndef AMB_CONTACT_FEATURE_H
#define AMB_CONTACT_FEATURE_H

#include <BulletCollision/CollisionShapes/btConvexShape.h>

#include <initializer_list>

#include "arena_memory.h"

// The inside of a plane: direction . p >= offset.
struct HalfSpace {
  btVector3 direction;
  btScalar offset;
  btScalar height(const btVector3 &point) const { return direction.dot(point) - offset; }
};

// A point, the ends of an edge, or the corners of a face in order, seen along a normal. Boxes have their sharp corners, as on
// planes; of other shapes it is the core, about which the surface lies at `margin_of` m.
class ContactFeature {
 public:
  // Finds what is lowest along the normal, up to `band` m above the lowest point.
  void find(const btConvexShape &shape, const btTransform &pose, const btVector3 &normal, btScalar band);
  // What `find` found last is found again.
  void find_again() { points_ = found_; }
  // Takes points that are known.
  void set(std::initializer_list<btVector3> points) { points_.assign(points); }
  // By how much the points, at least three in order, are off a plane, m, and its normal; infinite where they span none.
  btScalar unevenness(btVector3 &normal) const;
  // Leaves what is in a half space (Sutherland and Hodgman, Reentrant polygon clipping, 1974).
  void clip(const HalfSpace &space);
  // Leaves what is seen within a polygon, in order, along the normal.
  void clip_by(const ContactFeature &polygon, const btVector3 &normal);
  const Vector<btVector3> &points() const { return points_; }

  static btScalar margin_of(const btConvexShape &shape);

 private:
  void take_points(const btConvexShape &shape, const btTransform &pose, const btVector3 &normal);
  void keep_lowest(const btVector3 &normal, btScalar band);
  void order(const btVector3 &normal, btScalar band);

  Vector<btVector3> points_, other_, found_;
};

#endif
