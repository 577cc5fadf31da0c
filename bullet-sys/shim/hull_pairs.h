#ifndef AMB_HULL_PAIRS_H
#define AMB_HULL_PAIRS_H
#include "internal.h"

// While it lives, pairs of hulls of these two objects that are apart are left out, if both hulls are parts of a
// decomposition (AmbShape::is_part) and the objects are compounds.
//
// Bullet makes a collision algorithm and a contact manifold for each pair of children whose axis-aligned bounding boxes
// overlap. The parts of a curved wall are oblique, so that most of these boxes overlap where the parts are far apart: 45 cups
// of 15 parts each in a heap had some ten thousand manifolds without contact. A pair is left out only if a plane separates
// the hulls by more than the distance at which Bullet keeps a contact, so that no contact is lost.
class HullPairs {
 public:
  HullPairs(const btCollisionObject &first, const btCollisionObject &second);
  ~HullPairs();
  HullPairs(const HullPairs &) = delete;
  HullPairs &operator=(const HullPairs &) = delete;

 private:
  bool is_entered;
};

#endif
