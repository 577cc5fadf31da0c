// Contact impulses of the last sub-step, for warm starting. C++ only.
#ifndef AMB_CONTACT_CACHE_H
#define AMB_CONTACT_CACHE_H

#include <BulletCollision/NarrowPhaseCollision/btPersistentManifold.h>

#include <initializer_list>

#include "arena_memory.h"

class ContactCache {
 public:
  struct Contact {
    // Contact point in the frame of the first object, m.
    btVector3 local_position{0, 0, 0};
    // Impulses of the contact and of its friction, N s, and of rolling and spinning friction, N m s.
    btScalar normal = 0;
    btVector3 friction{0, 0, 0}, torque{0, 0, 0};
    // It was matched to a contact of the last sub-step.
    bool is_known = false;
    // The solution had it closed; its impulse may be 0.
    bool is_closed = false;
    // A contact of the next sub-step was matched to it.
    bool is_taken = false;
  };

  // To be called at the beginning of a sub-step, before any island.
  void begin() {
    before_.swap(contacts_);
    contacts_.clear();
    pairs_before_.swap(pairs_);
    pairs_.clear();
  }

  void clear() {
    begin();
    begin();
  }

  // Matches the contact points of an island to those of the last sub-step. m_userPersistentData of a point holds the
  // index of its contact plus 1 until the next sub-step. Points of concave meshes, which Bullet creates anew in each
  // sub-step, are matched by position.
  void match(btPersistentManifold **manifolds, int n) {
    for (int i = 0; i < n; ++i) {
      const btPersistentManifold &manifold = *manifolds[i];
      const Pair pair{manifold.getBody0(), manifold.getBody1(), contacts_.size(),
                      contacts_.size() + manifold.getNumContacts()};
      pairs_.push_back(pair);
      for (int k = 0; k < manifold.getNumContacts(); ++k) {
        btManifoldPoint &point = manifolds[i]->getContactPoint(k);
        Contact contact;
        if (Contact *before = find(pair, point, manifold.getContactBreakingThreshold())) {
          before->is_taken = true;
          contact = *before;
          contact.is_known = true;
          contact.is_taken = false;
          point.m_appliedImpulse = contact.normal;
        }
        contact.local_position = point.m_localPointA;
        contacts_.push_back(contact);
        point.m_userPersistentData = reinterpret_cast<void *>(contacts_.size());
      }
    }
  }

  // The contact of a normal row, of rigid bodies or of articulations.
  template <class Row>
  Contact &of(const Row &normal) {
    const auto &point = *static_cast<const btManifoldPoint *>(normal.m_originalContactPoint);
    return contacts_[reinterpret_cast<size_t>(point.m_userPersistentData) - 1];
  }

  // Stores the impulses of all contact rows of an island.
  template <class Rows>
  void store(const Rows &normals, const Rows &frictions, std::initializer_list<const Rows *> rolling) {
    for (int i = 0; i < normals.size(); ++i) {
      Contact &contact = of(normals[i]);
      contact.normal = normals[i].m_appliedImpulse;
      contact.is_closed = contact.normal > 0;
      contact.friction.setZero();
      contact.torque.setZero();
    }
    for (int i = 0; i < frictions.size(); ++i) {
      const auto &row = frictions[i];
      of(normals[row.m_frictionIndex]).friction += direction_of(row) * btScalar(row.m_appliedImpulse);
    }
    for (const Rows *rows : rolling) {
      for (int i = 0; i < rows->size(); ++i) {
        const auto &row = (*rows)[i];
        of(normals[row.m_frictionIndex]).torque += row.m_relpos1CrossNormal * btScalar(row.m_appliedImpulse);
      }
    }
  }

 private:
  // Contacts of two objects, from `begin` to before `end`.
  struct Pair {
    const btCollisionObject *first, *second;
    size_t begin, end;
  };

  // Direction of the impulse on the first object. Bullet leaves it out of rows on static ones.
  template <class Row>
  static btVector3 direction_of(const Row &friction) {
    return friction.m_contactNormal1.isZero() ? -friction.m_contactNormal2 : friction.m_contactNormal1;
  }

  // The same contact in the last sub-step, or else the nearest unmatched one of the same objects within `farthest` m;
  // null: none.
  Contact *find(const Pair &like, const btManifoldPoint &point, btScalar farthest) {
    const size_t number = reinterpret_cast<size_t>(point.m_userPersistentData);
    Contact *nearest = nullptr;
    btScalar least = farthest * farthest;
    for (const Pair &pair : pairs_before_) {
      if (pair.first != like.first || pair.second != like.second) continue;
      for (size_t i = pair.begin; i < pair.end; ++i) {
        Contact &before = before_[i];
        if (i + 1 == number) return &before;
        const btScalar distance = point.m_localPointA.distance2(before.local_position);
        if (before.is_taken || distance > least) continue;
        least = distance;
        nearest = &before;
      }
    }
    return nearest;
  }

  // Contacts and pairs of all islands of this sub-step and of the last one.
  Vector<Contact> contacts_, before_;
  Vector<Pair> pairs_, pairs_before_;
};

#endif
