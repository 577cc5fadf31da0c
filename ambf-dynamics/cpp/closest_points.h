// Bullet's search for the closest points of two convex shapes, with small ones enlarged. C++ only.
//
// Bullet's implementation of the algorithm of Gilbert, Johnson and Keerthi (GJK) takes tetrahedra of less than 1e-8 m^3 for flat.
// For parts of millimetres it then ends too early, in one of ten poses with a distance that is wrong by up to a quarter of the
// part. Here both shapes are enlarged until the smaller one has a size for which that is next to nothing.
#ifndef AMB_CLOSEST_POINTS_H
#define AMB_CLOSEST_POINTS_H

#include <BulletCollision/CollisionDispatch/btCollisionObjectWrapper.h>
#include <BulletCollision/CollisionDispatch/btManifoldResult.h>
#include <BulletCollision/CollisionShapes/btUniformScalingShape.h>
#include <BulletCollision/NarrowPhaseCollision/btGjkPairDetector.h>
#include <BulletCollision/NarrowPhaseCollision/btPointCollector.h>
#include <BulletCollision/NarrowPhaseCollision/btVoronoiSimplexSolver.h>

#include <algorithm>

// Radius of the bounding sphere of a shape, m.
inline btScalar size_of(const btConvexShape &shape) {
  btVector3 centre;
  btScalar radius;
  shape.getBoundingSphere(centre, radius);
  return radius;
}

// By how much shapes of which the smaller has this size, m, are enlarged.
inline btScalar scale_of(btScalar size) {
  // 1e-8 m^3 are 1e-4 of the cube of this, m.
  constexpr btScalar LARGE = 0.05;
  return size > SIMD_EPSILON ? std::max(LARGE / size, btScalar(1)) : 1;
}

// A shape and its pose, enlarged about a point.
struct ScaledShape {
  ScaledShape(const btConvexShape &of, const btTransform &at, const btVector3 &about, btScalar scale)
      // The shape is only read.
      : shape(const_cast<btConvexShape *>(&of), scale), pose(at.getBasis(), (at.getOrigin() - about) * scale) {}

  btUniformScalingShape shape;
  btTransform pose;
};

// The closest points of two shapes up to a distance, m, as Bullet gives them: of which the smaller has this size, m. Without a
// solver for depths, shapes of which the cores overlap have none.
inline btPointCollector closest_points(const btConvexShape &first, const btTransform &first_pose, const btConvexShape &second,
                                       const btTransform &second_pose, btScalar size, btScalar farthest,
                                       btConvexPenetrationDepthSolver *depth_solver) {
  const btScalar scale = scale_of(size);
  const btVector3 &about = second_pose.getOrigin();
  const ScaledShape one(first, first_pose, about, scale), two(second, second_pose, about, scale);
  btVoronoiSimplexSolver simplex;
  btGjkPairDetector detector(&one.shape, &two.shape, &simplex, depth_solver);
  btGjkPairDetector::ClosestPointInput input;
  input.m_maximumDistanceSquared = std::min(farthest * scale * farthest * scale, BT_LARGE_FLOAT);
  input.m_transformA = one.pose;
  input.m_transformB = two.pose;
  btPointCollector found;
  detector.getClosestPoints(input, found, nullptr);
  if (!found.m_hasResult) return found;
  found.m_distance /= scale;
  found.m_pointInWorld = found.m_pointInWorld / scale + about;
  return found;
}

// Takes the contacts of enlarged shapes on to the result of the shapes themselves. `threshold`: contact breaking threshold, m.
class ScaledResult final : public btManifoldResult {
 public:
  ScaledResult(btManifoldResult &result, const btVector3 &about, btScalar scale, btScalar threshold)
      : btManifoldResult(result.getBody0Wrap(), result.getBody1Wrap()), result_(result), about_(about), scale_(scale) {
    // Bullet adds the threshold in metres.
    m_closestPointDistanceThreshold = scale * (threshold + result.m_closestPointDistanceThreshold) - threshold;
  }

  void setShapeIdentifiersA(int part, int index) override { result_.setShapeIdentifiersA(part, index); }
  void setShapeIdentifiersB(int part, int index) override { result_.setShapeIdentifiersB(part, index); }
  void addContactPoint(const btVector3 &normal, const btVector3 &point, btScalar depth) override {
    result_.setPersistentManifold(getPersistentManifold());
    result_.addContactPoint(normal, point / scale_ + about_, depth / scale_);
  }

 private:
  btManifoldResult &result_;
  const btVector3 about_;
  const btScalar scale_;
};

#endif
