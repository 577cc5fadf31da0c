#include "hull_pairs.h"

#include <BulletCollision/CollisionDispatch/btCompoundCompoundCollisionAlgorithm.h>
#include <LinearMath/btAabbUtil2.h>

namespace {

// Planes that are tried for a pair; those that are apart are mostly separated by the first or second.
constexpr int PLANES = 6;

// A part in the world.
struct Part {
  // Whether `shape` is a part of `object`; then the others are set.
  bool enter(const btCollisionObject &object, const btCollisionShape &shape) {
    // The tree of one compound is searched for each part of the other, so that one of the two is often that of the last pair.
    if (hull == &shape) return true;
    const auto &compound = static_cast<const btCompoundShape &>(*object.getCollisionShape());
    const int index = shape.getUserIndex();
    if (index >= compound.getNumChildShapes() || compound.getChildShape(index) != &shape) return false;
    hull = static_cast<const btConvexHullShape *>(&shape);
    pose = object.getWorldTransform() * compound.getChildTransform(index);
    hull->getAabb(pose, low, high);
    return true;
  }

  // The point farthest along a direction, without the margin.
  btVector3 farthest(const btVector3 &direction) const {
    return pose(hull->localGetSupportingVertexWithoutMargin(direction * pose.getBasis()));
  }

  const btConvexHullShape *hull = nullptr;
  btTransform pose;
  // Bounding box.
  btVector3 low, high;
};

// The pair of compounds whose children this thread compares, and the children that were compared last.
struct Compounds {
  const btCollisionObject *first = nullptr, *second = nullptr;
  // Contacts at a larger distance of the surfaces are not kept, m: as the dispatcher chooses it for manifolds of the two.
  // Negative: not asked for yet.
  btScalar threshold = -1;
  Part a, b;
};
thread_local Compounds current;

btScalar threshold_of(const btCollisionObject &object) {
  return object.getCollisionShape()->getContactBreakingThreshold(gContactBreakingThreshold);
}

// Chung and Wang, "Quick collision detection of polytopes in virtual environments", VRST 1996: a direction that does not
// separate is mirrored at the plane that the two extreme points give.
bool may_touch(const btCollisionShape *shape_a, const btCollisionShape *shape_b) {
  if (shape_a->getUserIndex() < 0 || shape_b->getUserIndex() < 0) return true;
  Compounds &pair = current;
  Part &a = pair.a, &b = pair.b;
  if (!pair.first || !a.enter(*pair.first, *shape_a) || !b.enter(*pair.second, *shape_b)) return true;
  // Bullet would find the same next.
  if (!TestAabbAgainstAabb2(a.low, a.high, b.low, b.high)) return false;
  if (pair.threshold < 0) pair.threshold = std::min(threshold_of(*pair.first), threshold_of(*pair.second));
  const btScalar reach = a.hull->getMargin() + b.hull->getMargin() + pair.threshold;
  btVector3 direction = b.low + b.high - a.low - a.high;
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
  if (!is_entered) return;
  current.first = &first;
  current.second = &second;
  current.threshold = -1;
  current.a.hull = current.b.hull = nullptr;
}

HullPairs::~HullPairs() {
  if (is_entered) current.first = current.second = nullptr;
}
