// Contacts of cylinders, cones and capsules with planes. C++ only.
//
// Bullet finds the lowest point of a convex shape in each sub-step and keeps up to four of them while they hardly move;
// for polyhedra it also tilts the shape to find more. A base that lands flat is thus held by one point of its rim: the
// impact turns the body about it, the next sub-step finds a point on the other side, and the body sinks while it rocks, the
// longer the less inertia it has. Here all points are found on which such a shape can rest: three of the rim of a base and
// both ends of a line on its side.
#ifndef AMB_ROUND_ON_PLANE_H
#define AMB_ROUND_ON_PLANE_H

#include <BulletCollision/CollisionDispatch/btConvexPlaneCollisionAlgorithm.h>

class btCollisionDispatcher;

class RoundOnPlane final : public btConvexPlaneCollisionAlgorithm {
 public:
  RoundOnPlane(const btCollisionAlgorithmConstructionInfo &info, const btCollisionObjectWrapper *first,
               const btCollisionObjectWrapper *second, bool is_swapped)
      : btConvexPlaneCollisionAlgorithm(nullptr, info, first, second, is_swapped, 1, 0), is_swapped_(is_swapped) {}

  void processCollision(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                        const btDispatcherInfo &info, btManifoldResult *result) override;

 private:
  const bool is_swapped_;
};

// Creates these algorithms. It has to outlive the dispatcher.
class RoundOnPlaneFactory {
 public:
  RoundOnPlaneFactory() { plane_first_.m_swapped = true; }
  void enable(btCollisionDispatcher &dispatcher);

 private:
  struct Create final : btCollisionAlgorithmCreateFunc {
    btCollisionAlgorithm *CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                   const btCollisionObjectWrapper *first,
                                                   const btCollisionObjectWrapper *second) override;
  };
  Create plane_second_, plane_first_;
};

#endif
