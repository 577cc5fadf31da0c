// Normals of contacts turn with the bodies. C++ only.
#ifndef AMB_CONTACT_NORMALS_H
#define AMB_CONTACT_NORMALS_H

#include <BulletCollision/CollisionDispatch/btCollisionObjectWrapper.h>
#include <BulletCollision/CollisionDispatch/btManifoldResult.h>

// Bullet keeps a contact point that it did not find again in this sub-step, fixed to both bodies, with the normal that it had in
// the world. Of two bodies that turn together, such as what jaws hold, all points but one could be old ones, and the normals
// of a grip that turned by 40 degrees pushed out what it held. They turn as that body of the two which turned less: a wheel does
// not take the normal of the ground along.
class ContactNormals {
 public:
  // To be called before the contacts of the pair are found.
  void turn(const btCollisionObjectWrapper &first, const btCollisionObjectWrapper &second) {
    if (!manifold_) return;
    const btQuaternion one = rotation_of(first) * first_.inverse(), two = rotation_of(second) * second_.inverse();
    const btQuaternion &less = btFabs(one.w()) > btFabs(two.w()) ? one : two;
    for (int i = 0; i < manifold_->getNumContacts(); ++i) {
      btVector3 &normal = manifold_->getContactPoint(i).m_normalWorldOnB;
      normal = quatRotate(less, normal);
    }
  }

  // To be called after that.
  void keep(const btCollisionObjectWrapper &first, const btCollisionObjectWrapper &second, const btManifoldResult &result) {
    btPersistentManifold *const manifold = const_cast<btPersistentManifold *>(result.getPersistentManifold());
    manifold_ = manifold && manifold->getNumContacts() > 0 ? manifold : nullptr;
    if (!manifold_) return;
    first_ = rotation_of(first);
    second_ = rotation_of(second);
  }

 private:
  static btQuaternion rotation_of(const btCollisionObjectWrapper &object) {
    return object.getCollisionObject()->getWorldTransform().getRotation();
  }

  // That of the pair, while it has contacts.
  btPersistentManifold *manifold_ = nullptr;
  // Orientations when they were found.
  btQuaternion first_, second_;
};

#endif
