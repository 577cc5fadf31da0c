// Contacts of two convex shapes that do not touch yet. C++ only.
//
// Boxes. All pairs of convex shapes have their contact from the contact breaking threshold on, so that their impact ends with a
// gap of 0, but Bullet's separating axis test finds contacts of boxes only where they overlap: boxes that were put exactly onto
// each other had none in the first sub-steps and sank into each other. Without restitution they have contacts from the
// threshold on, too. With restitution the impact is computed from where they are in it.
//
// Thin bodies. A pair that overlaps by more than half of its thickness is pushed apart to the wrong side. Where two shapes may
// get that far into each other within the sub-step, they have contacts wherever their surfaces may touch in it, with the
// distance that they have to close (speculative contacts; Catto, Continuous Collision, Game Developers Conference 2013), and all
// their contacts are marked as anticipated, so that those that rebound have their impact before they touch. The
// sphere within a body that is swept (sweep.h) does not see its ends, nor how it turns.
#ifndef AMB_NEAR_CONTACTS_H
#define AMB_NEAR_CONTACTS_H

#include <BulletCollision/CollisionDispatch/btCollisionObjectWrapper.h>
#include <BulletCollision/CollisionDispatch/btManifoldResult.h>

#include "contact_feature.h"

// Adds them to the manifold of a pair, of which Bullet has found what it finds, for a sub-step of h s. Of a pair that is
// complete, because it touches along a line, contacts are only marked.
class NearContacts {
 public:
  void add(const btCollisionObjectWrapper &first, const btCollisionObjectWrapper &second, btManifoldResult &result, btScalar h,
           bool is_complete = false);

 private:
  // Scratch memory.
  ContactFeature features_[2];
};

#endif
