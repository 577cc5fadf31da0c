// Contacts of a convex shape that lies with a straight line or a face on a face. C++ only.
//
// Bullet finds one point of a pair of convex shapes, the deepest. On the line of a capsule or the face of a hull that lies on a face
// all points are, and which one it takes says nothing about the turn of the line or face on the other: no friction holds it,
// and its whole load is at one place. Such a shape touches at the ends of the part of the line, or at the corners of the part of
// the face, that is over the other face, as a box does on a box. Their distances follow from the plane of the face.
#ifndef AMB_FACE_CONTACTS_H
#define AMB_FACE_CONTACTS_H

#include <BulletCollision/CollisionDispatch/btCollisionObjectWrapper.h>
#include <BulletCollision/CollisionDispatch/btManifoldResult.h>

#include "contact_selection.h"

// What Bullet has found of a pair is replaced by ends of a line, or by corners of faces, if one of them lies on a face.
enum class Replaced { None, Line, Face };

class FaceContacts {
 public:
  Replaced replace(const btCollisionObjectWrapper &first, const btCollisionObjectWrapper &second, btManifoldResult &result);

 private:
  bool find_line(const btCollisionObjectWrapper &object, const btVector3 &down);
  bool find_corners(const btCollisionObjectWrapper &object, const btVector3 &normal, btScalar threshold);
  bool find_face(const btCollisionObjectWrapper &object, btVector3 &normal, btScalar unevenness);

  // The face, and the line or face that lies on it, with the margins about them; scratch memory.
  ContactFeature face_, lying_;
  btScalar face_margin_ = 0, lying_margin_ = 0;
  Vector<SurfaceContact> found_;
};

#endif
