#include "hull_pairs.h"

#include <BulletCollision/CollisionDispatch/btCompoundCompoundCollisionAlgorithm.h>

namespace {

// Planes that are tried for a pair; those that are apart are mostly separated by the first or second.
constexpr int PLANES = 6;

// The pair of compounds whose children this thread compares.
struct Compounds {
  const btCollisionObject *first = nullptr, *second = nullptr;
  // Contacts at a larger distance of the surfaces are not kept, m: as the dispatcher chooses it for manifolds of the two.
  // Negative: not asked for yet.
  btScalar threshold = -1;
};
thread_local Compounds current;

// A part in the world.
struct Part {
  // Whether `shape` is a part of `object`; then the others are set.
  Part(const btCollisionObject &object, const btCollisionShape &shape) {
    const auto &compound = static_cast<const btCompoundShape &>(*object.getCollisionShape());
    const int index = shape.getUserIndex();
    if (index >= compound.getNumChildShapes() || compound.getChildShape(index) != &shape) return;
    hull = static_cast<const btConvexHullShape *>(&shape);
    pose = object.getWorldTransform() * compound.getChildTransform(index);
  }

  btVector3 centre() const {
    btVector3 low, high;
    hull->getAabb(pose, low, high);
    return (low + high) / 2;
  }

  // The point farthest along a direction, without the margin.
  btVector3 farthest(const btVector3 &direction) const {
    return pose(hull->localGetSupportingVertexWithoutMargin(direction * pose.getBasis()));
  }

  const btConvexHullShape *hull = nullptr;
  btTransform pose;
};

btScalar threshold_of(const btCollisionObject &object) {
  return object.getCollisionShape()->getContactBreakingThreshold(gContactBreakingThreshold);
}

// Chung and Wang, "Quick collision detection of polytopes in virtual environments", VRST 1996: a direction that does not
// separate is mirrored at the plane that the two extreme points give.
bool may_touch(const btCollisionShape *shape_a, const btCollisionShape *shape_b) {
  if (shape_a->getUserIndex() < 0 || shape_b->getUserIndex() < 0 || !current.first) return true;
  const Part a(*current.first, *shape_a), b(*current.second, *shape_b);
  if (!a.hull || !b.hull) return true;
  if (current.threshold < 0) {
    current.threshold = std::min(threshold_of(*current.first), threshold_of(*current.second));
  }
  const btScalar reach = a.hull->getMargin() + b.hull->getMargin() + current.threshold;
  btVector3 direction = b.centre() - a.centre();
  for (int i = 0; i < PLANES; ++i) {
    const btScalar length = direction.length();
    if (!(length > SIMD_EPSILON)) return true;
    direction /= length;
    const btVector3 gap = b.farthest(-direction) - a.farthest(direction);
    const btScalar distance = gap.dot(direction);
    if (distance > reach) return false;
    const btScalar square = gap.length2();
    if (!(square > SIMD_EPSILON)) return true;
    direction -= 2 * distance / square * gap;
  }
  return true;
}

// Set before any thread can step a world; other compounds have children without an index.
[[maybe_unused]] const bool is_installed = (gCompoundCompoundChildShapePairCallback = may_touch, true);

}  // namespace

HullPairs::HullPairs(const btCollisionObject &first, const btCollisionObject &second)
    : is_entered(first.getCollisionShape()->isCompound() && second.getCollisionShape()->isCompound()) {
  if (is_entered) current = {&first, &second};
}

HullPairs::~HullPairs() {
  if (is_entered) current = {};
}
