// Contacts of a convex shape that lies with a straight line on a face. C++ only.
//
// Bullet finds one point of a pair of convex shapes, the deepest. On the line of a capsule or cylinder that lies on a face all
// points are, and the one that it takes, the middle of the capsule, or one after the other, says nothing about the turn of the
// line in the face: no friction holds it. Such a line touches at both ends of the part that is over the face, as a box does at
// its corners.
#ifndef AMB_LINE_CONTACTS_H
#define AMB_LINE_CONTACTS_H

#include <BulletCollision/CollisionDispatch/btCollisionObjectWrapper.h>
#include <BulletCollision/CollisionDispatch/btManifoldResult.h>

#include "contact_feature.h"

// Replaces what Bullet has found of a pair by the ends of the line. Returns false where there is none.
class LineContacts {
 public:
  bool replace(const btCollisionObjectWrapper &first, const btCollisionObjectWrapper &second, btManifoldResult &result);

 private:
  struct Line {
    btVector3 ends[2];
    btScalar margin;
    void clip(const HalfSpace &space, bool &is_empty);
  };
  static bool line_of(const btCollisionObjectWrapper &object, const btVector3 &down, Line &line);
  bool face_of(const btCollisionObjectWrapper &object, btVector3 &normal, btScalar band);

  // Corners of the face in order, and the margin about it; scratch memory.
  ContactFeature feature_;
  Vector<btVector3> corners_;
  btScalar face_margin_ = 0;
};

#endif
