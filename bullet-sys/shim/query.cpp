#include "internal.h"

#include <cmath>

namespace {

// Bullet normalises the direction by the square of its length, which must not be zero, subnormal or infinite.
bool castable(const btVector3 &from, const btVector3 &to) { return std::isnormal((to - from).length2()); }

// Skips objects whose pose is not finite: Bullet's support function finds no farthest point among NaNs.
struct ClosestHit : btCollisionWorld::ClosestRayResultCallback {
  using btCollisionWorld::ClosestRayResultCallback::ClosestRayResultCallback;

  bool needsCollision(btBroadphaseProxy *proxy) const override {
    const auto &object = *static_cast<const btCollisionObject *>(proxy->m_clientObject);
    const btTransform &pose = object.getWorldTransform();
    return finite(pose.getOrigin() + pose.getBasis()[0] + pose.getBasis()[1] + pose.getBasis()[2]) &&
           ClosestRayResultCallback::needsCollision(proxy);
  }
};

int target_of(const AmbObject &object) {
  switch (object.kind) {
    case ObjectKind::Body: return AmbTarget_Body;
    case ObjectKind::SoftBody: return AmbTarget_SoftBody;
    default: return AmbTarget_Other;
  }
}

// A contact as the first or second body of the manifold has it.
void write_contact(const AmbWorld &world, const btManifoldPoint &point, bool first, const AmbBody &other,
                   AmbContact &contact) {
  contact.other = other.handle;
  write_vector(first ? point.getPositionWorldOnA() : point.getPositionWorldOnB(), contact.point);
  // Bullet's normal points from its second body to its first.
  write_vector(first ? point.m_normalWorldOnB : -point.m_normalWorldOnB, contact.normal);
  contact.distance = point.getDistance();
  contact.impulse = point.getAppliedImpulse() * world.contact_impulse_scale;
  // Along the directions, on Bullet's first body.
  const btVector3 friction = point.m_lateralFrictionDir1 * point.m_appliedImpulseLateral1 +
                             point.m_lateralFrictionDir2 * point.m_appliedImpulseLateral2;
  write_vector(friction * ((first ? 1 : -1) * world.contact_impulse_scale), contact.friction);
  contact.friction_coefficient = point.m_combinedFriction;
}

}  // namespace

extern "C" {

void amb_world_cast_rays(AmbWorld *world, const AmbRay *rays, int n, AmbRayHit *hits) {
  prepare_soft_rays(*world);
  for (int i = 0; i < n; ++i) {
    AmbRayHit &hit = hits[i];
    hit.target = AmbTarget_None;
    const btVector3 from = vector_of(rays[i].from), to = vector_of(rays[i].to);
    if (!castable(from, to)) continue;
    ClosestHit closest(from, to);
    world->world->rayTest(from, to, closest);
    if (!closest.hasHit()) continue;
    const AmbObject &object = *object_of(closest.m_collisionObject);
    hit.target = target_of(object);
    hit.handle = object.handle;
    hit.fraction = closest.m_closestHitFraction;
    write_vector(closest.m_hitPointWorld, hit.point);
    write_vector(closest.m_hitNormalWorld, hit.normal);
  }
}

int amb_body_contacts(const AmbWorld *world, const AmbBody *body, double threshold, AmbContact *out, int capacity) {
  int count = 0;
  for (int i = 0; i < world->dispatcher.getNumManifolds(); ++i) {
    const btPersistentManifold &manifold = *world->dispatcher.getManifoldByIndexInternal(i);
    const bool first = manifold.getBody0() == body->collider;
    if (!first && manifold.getBody1() != body->collider) continue;
    const AmbBody *other = body_of(first ? manifold.getBody1() : manifold.getBody0());
    if (!other) continue;
    for (int p = 0; p < manifold.getNumContacts(); ++p) {
      const btManifoldPoint &point = manifold.getContactPoint(p);
      if (!(point.getDistance() <= threshold)) continue;
      if (count < capacity) write_contact(*world, point, first, *other, out[count]);
      ++count;
    }
  }
  return count;
}

int amb_world_touching(const AmbWorld *world, AmbTouching *out, int capacity) {
  int count = 0;
  for (int i = 0; i < world->dispatcher.getNumManifolds(); ++i) {
    const btPersistentManifold &manifold = *world->dispatcher.getManifoldByIndexInternal(i);
    if (manifold.getNumContacts() == 0) continue;
    const AmbBody *a = body_of(manifold.getBody0()), *b = body_of(manifold.getBody1());
    if (!a || !b) continue;
    if (count < capacity) out[count] = {{a->handle, b->handle}, i};
    ++count;
  }
  return count;
}

int amb_manifold_contacts(const AmbWorld *world, int number, int side, AmbManifoldContacts *out) {
  static_assert(MANIFOLD_CACHE_SIZE == sizeof(out->points) / sizeof(out->points[0]), "the points of a manifold fit");
  if (number < 0 || number >= world->dispatcher.getNumManifolds()) return 0;
  const btPersistentManifold &manifold = *world->dispatcher.getManifoldByIndexInternal(number);
  const AmbBody *other = body_of(side == 0 ? manifold.getBody1() : manifold.getBody0());
  if (!other) return 0;
  int count = 0;
  for (int p = 0; p < manifold.getNumContacts(); ++p) {
    const btManifoldPoint &point = manifold.getContactPoint(p);
    // A distance that is not a number is no contact.
    if (point.getDistance() == point.getDistance()) write_contact(*world, point, side == 0, *other, out->points[count++]);
  }
  return count;
}

}  // extern "C"
