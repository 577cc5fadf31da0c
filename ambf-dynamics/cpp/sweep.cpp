#include "sweep.h"

#include <algorithm>

#include <BulletCollision/CollisionShapes/btTriangleShape.h>
#include <BulletCollision/NarrowPhaseCollision/btGjkPairDetector.h>
#include <BulletCollision/NarrowPhaseCollision/btPointCollector.h>
#include <BulletCollision/NarrowPhaseCollision/btVoronoiSimplexSolver.h>

#include "articulation.h"

namespace {

// Radius of the swept sphere as a share of that of the largest sphere in the body: when the swept sphere touches, the
// body itself penetrates enough for the narrow phase to find the contact.
const btScalar SWEPT_SHARE = 0.9;
// Gap, in radii, up to which a sphere counts as touching.
const btScalar TOUCH_GAP = 0.01;
// Motion along the normal, in radii, up to which no sweep is needed: the centre of the sphere stays on its side of the
// surface.
const btScalar MAX_UNSWEPT_MOTION = 0.5;

// Smallest motion of a body that is stopped, in radii, so that it cannot stay in front of an obstacle without a
// contact.
const btScalar MIN_MOTION = 0.1;

// A sphere and its displacement in a sub-step, m.
struct Sweep {
  btVector3 from, motion;
  btScalar radius;

  void bounds(btVector3 &low, btVector3 &high) const {
    const btVector3 to = from + motion, size(radius, radius, radius);
    low = from;
    high = from;
    low.setMin(to);
    high.setMax(to);
    low -= size;
    high += size;
  }

  Sweep in(const btTransform &frame) const { return {frame.invXform(from), motion * frame.getBasis(), radius}; }
};

// Share of the motion at which the sphere touches a convex shape; 1: it does not, or moves along the normal by less
// than MAX_UNSWEPT_MOTION. Conservative advancement: the distance along the normal is never overestimated for a convex
// shape.
btScalar impact_convex(const Sweep &sweep, const btConvexShape &shape, const btTransform &pose) {
  const btSphereShape ball(sweep.radius);
  btVoronoiSimplexSolver simplex;
  btGjkPairDetector detector(&ball, &shape, &simplex, nullptr);
  btScalar share = 0;
  for (int i = 0; i < 64; ++i) {
    btGjkPairDetector::ClosestPointInput input;
    input.m_transformA = btTransform(btMatrix3x3::getIdentity(), sweep.from + sweep.motion * share);
    input.m_transformB = pose;
    btPointCollector nearest;
    detector.getClosestPoints(input, nearest, nullptr);
    if (!nearest.m_hasResult) return 1;
    const btScalar closing = -nearest.m_normalOnBInWorld.dot(sweep.motion);
    if (!(closing > MAX_UNSWEPT_MOTION * sweep.radius)) return 1;
    // A pair that overlaps has a contact, which the solver has seen. If it lets the sphere move, as the contact of a deep
    // penetration does that has another normal, a stop would hold the position while the velocity grows.
    if (i == 0 && nearest.m_distance <= 0) return 1;
    if (nearest.m_distance <= TOUCH_GAP * sweep.radius) return share;
    share += (nearest.m_distance - TOUCH_GAP * sweep.radius / 2) / closing;
    if (!(share < 1)) return 1;
  }
  return share;
}

btScalar impact_plane(const Sweep &sweep, const btStaticPlaneShape &plane) {
  const btScalar closing = -plane.getPlaneNormal().dot(sweep.motion);
  const btScalar distance = plane.getPlaneNormal().dot(sweep.from) - plane.getPlaneConstant() - sweep.radius;
  // A sphere that is completely below the plane is left to the penetration correction.
  if (!(closing > MAX_UNSWEPT_MOTION * sweep.radius) || distance < -2 * sweep.radius) return 1;
  return std::clamp((distance - TOUCH_GAP * sweep.radius / 2) / closing, btScalar(0), btScalar(1));
}

struct TriangleImpact : btTriangleCallback {
  explicit TriangleImpact(const Sweep &of) : sweep(of) {}

  void processTriangle(btVector3 *corners, int, int) override {
    btTriangleShape triangle(corners[0], corners[1], corners[2]);
    // The narrow phase ignores the margin of some pairs.
    triangle.setMargin(0);
    share = btMin(share, impact_convex(sweep, triangle, btTransform::getIdentity()));
  }

  const Sweep &sweep;
  btScalar share = 1;
};

btScalar impact(const Sweep &sweep, const btCollisionShape &shape, const btTransform &pose) {
  if (shape.getShapeType() == EMPTY_SHAPE_PROXYTYPE) return 1;
  if (shape.isConvex()) return impact_convex(sweep, static_cast<const btConvexShape &>(shape), pose);
  const Sweep local = sweep.in(pose);
  btVector3 low, high;
  local.bounds(low, high);
  if (shape.isCompound()) {
    const auto &compound = static_cast<const btCompoundShape &>(shape);
    btScalar share = 1;
    for (int i = 0; i < compound.getNumChildShapes(); ++i) {
      const btCollisionShape &child = *compound.getChildShape(i);
      btVector3 child_low, child_high;
      child.getAabb(compound.getChildTransform(i), child_low, child_high);
      if (!TestAabbAgainstAabb2(low, high, child_low, child_high)) continue;
      share = btMin(share, impact(local, child, compound.getChildTransform(i)));
    }
    return share;
  }
  if (shape.getShapeType() == STATIC_PLANE_PROXYTYPE) {
    return impact_plane(local, static_cast<const btStaticPlaneShape &>(shape));
  }
  if (!shape.isConcave()) return 1;
  TriangleImpact triangles(local);
  static_cast<const btConcaveShape &>(shape).processAllTriangles(&triangles, low, high);
  return triangles.share;
}

// Finds the first object that a body hits within dt s.
struct FirstImpact : btBroadphaseAabbCallback {
  FirstImpact(AmbWorld &in, const btRigidBody &of, btScalar radius, btScalar step)
      : world(in),
        body(of),
        dt(step),
        sweep{of.getWorldTransform().getOrigin(), of.getLinearVelocity() * step, radius} {}

  bool process(const btBroadphaseProxy *proxy) override {
    auto *object = static_cast<btCollisionObject *>(proxy->m_clientObject);
    if (object == &body || !collides(*object)) return true;
    Sweep relative = sweep;
    const btRigidBody *other = btRigidBody::upcast(object);
    if (other) relative.motion -= other->getLinearVelocity() * dt;
    const btScalar way = relative.motion.length();
    if (way <= sweep.radius) return true;
    const btScalar found = impact(relative, *object->getCollisionShape(), object->getWorldTransform());
    // Also where it is not a number.
    if (!(found < share)) return true;
    share = btMax(found, MIN_MOTION * sweep.radius / way);
    drift = other ? drift_with(*other, way) : btVector3(0, 0, 0);
    return true;
  }

  // Velocity of the two bodies for the rest of the sub-step. Without it the bodies of a mechanism that falls at 3 m/s
  // by more than their size in a sub-step, two of which touch, would be left behind by it. A body that is stopped for
  // its part moves on with the common centre of mass.
  btVector3 drift_with(const btRigidBody &other, btScalar way) const {
    const btVector3 theirs = other.getLinearVelocity();
    const AmbBody *owner = body_of(&other);
    const btScalar radius = owner ? owner->swept_radius : 0;
    if (other.isStaticOrKinematicObject() || radius <= 0 || way <= radius || theirs.length() * dt <= radius) return theirs;
    const btScalar mine = other.getInvMass() / (body.getInvMass() + other.getInvMass());
    return body.getLinearVelocity() * mine + theirs * (1 - mine);
  }

  bool collides(const btCollisionObject &object) const {
    const AmbObject &me = *object_of(&body), &other = *object_of(&object);
    if (other.kind == ObjectKind::SoftBody || me.ignores(other)) return false;
    auto *a = const_cast<btRigidBody *>(&body);
    auto *b = const_cast<btCollisionObject *>(&object);
    return world.broadphase.getOverlappingPairCache()->needsBroadphaseCollision(a->getBroadphaseHandle(),
                                                                                b->getBroadphaseHandle()) &&
           world.dispatcher.needsCollision(a, b) && world.dispatcher.needsResponse(a, b);
  }

  AmbWorld &world;
  const btRigidBody &body;
  btScalar dt;
  Sweep sweep;
  // Share of the sub-step until the first impact, and the velocity after it, m/s.
  btScalar share = 1;
  btVector3 drift = btVector3(0, 0, 0);
};

// Radius of the largest sphere about `centre` within a convex shape: the least value of its support function over all
// directions, found by descent from many of them. Not positive if the centre lies outside.
btScalar inner_radius(const btConvexShape &shape, const btVector3 &centre) {
  btScalar least = BT_LARGE_FLOAT;
  for (int start = 0; start < 27; ++start) {
    btVector3 direction(start % 3 - 1, start / 3 % 3 - 1, start / 9 - 1);
    if (direction.fuzzyZero()) continue;
    direction.normalize();
    btScalar step = 0.5;
    for (int i = 0; i < 24; ++i, step *= 0.75) {
      const btVector3 vertex = shape.localGetSupportingVertex(direction) - centre;
      const btScalar height = direction.dot(vertex);
      least = btMin(least, height);
      const btVector3 aside = vertex - direction * height;
      if (aside.length2() < 1e-20 * vertex.length2()) break;
      direction = (direction - aside.normalized() * step).normalized();
    }
  }
  return least;
}

btScalar inner_radius(const btCollisionShape &shape, const btTransform &pose) {
  if (shape.isConvex())
    return inner_radius(static_cast<const btConvexShape &>(shape), pose.invXform(btVector3(0, 0, 0)));
  if (!shape.isCompound()) return 0;
  const auto &compound = static_cast<const btCompoundShape &>(shape);
  btScalar most = 0;
  for (int i = 0; i < compound.getNumChildShapes(); ++i) {
    most = btMax(most, inner_radius(*compound.getChildShape(i), pose * compound.getChildTransform(i)));
  }
  return most;
}

// Makes two bodies on a joint stop at the same time, the earlier one, and drift alike. Returns whether that changed any.
bool join(EngineWorld &engine, AmbBody *a, AmbBody *b) {
  const auto has_impact = [](const AmbBody *body) { return body && body->impact >= 0; };
  if (!has_impact(a)) std::swap(a, b);
  if (!has_impact(a)) return false;
  AmbImpact &first = engine.impacts[a->impact];
  if (!b || b->body.isStaticOrKinematicObject()) {
    const bool is_new = !first.is_anchored;
    first.is_anchored = true;
    first.drift.setZero();
    return is_new;
  }
  if (b->articulation) {
    const bool is_new = !first.is_held;
    first.is_held = true;
    return is_new;
  }
  if (!has_impact(b)) {
    AmbImpact copy = first;
    copy.body = b;
    b->impact = static_cast<int>(engine.impacts.size());
    engine.impacts.push_back(copy);
    return true;
  }
  AmbImpact &second = engine.impacts[b->impact];
  const bool differ = first.share != second.share || first.is_anchored != second.is_anchored ||
                      first.is_held != second.is_held;
  if (!differ) return false;
  const bool anchored = first.is_anchored || second.is_anchored, held = first.is_held || second.is_held;
  const AmbImpact &earlier = first.share <= second.share ? first : second;
  const btScalar share = earlier.share;
  const btVector3 drift = anchored ? btVector3(0, 0, 0) : earlier.drift;
  for (AmbImpact *impact : {&first, &second}) {
    impact->share = share;
    impact->drift = drift;
    impact->is_anchored = anchored;
    impact->is_held = held;
  }
  return true;
}

// A body that stops alone opens its joints by what is left of its motion. All bodies that joints hold to it stop with
// it, unless one of them is a link of an articulation, whose motion is not swept: then none stops.
void spread_along_joints(EngineWorld &engine) {
  AmbWorld &world = engine.world;
  const auto is_jointed = [](const AmbImpact &impact) { return impact.body->constraint_count > 0; };
  if (std::none_of(engine.impacts.begin(), engine.impacts.end(), is_jointed)) return;
  for (bool has_changed = true; has_changed;) {
    has_changed = false;
    for (int i = 0; i < world.world->getNumConstraints(); ++i) {
      const btTypedConstraint &constraint = *world.world->getConstraint(i);
      if (!constraint.isEnabled()) continue;
      has_changed |= join(engine, body_of(&constraint.getRigidBodyA()), body_of(&constraint.getRigidBodyB()));
    }
    if (!world.articulated) continue;
    for (const AmbConstraint *constraint : world.articulated->external_constraints) {
      has_changed |= join(engine, &first_of(*constraint), &second_of(*constraint));
    }
  }
}

}  // namespace

void find_impacts(EngineWorld &engine, const btAlignedObjectArray<btRigidBody *> &bodies, btScalar dt) {
  AmbWorld &world = engine.world;
  engine.impacts.clear();
  for (int i = 0; i < bodies.size(); ++i) {
    btRigidBody &body = *bodies[i];
    AmbBody *owner = body_of(&body);
    if (!owner || owner->swept_radius <= 0 || !body.isActive()) continue;
    const btScalar radius = owner->swept_radius, way = body.getLinearVelocity().length2() * dt * dt;
    // A displacement that is not finite is reported by amb_bodies_first_lost.
    if (way <= radius * radius || !std::isfinite(way)) continue;
    FirstImpact first(world, body, radius, dt);
    btVector3 low, high;
    first.sweep.bounds(low, high);
    world.broadphase.aabbTest(low, high, first);
    if (first.share >= 1) continue;
    owner->impact = static_cast<int>(engine.impacts.size());
    engine.impacts.push_back({owner, first.share, first.drift, false, false, btTransform::getIdentity()});
  }
  if (engine.impacts.empty()) return;
  spread_along_joints(engine);
  for (AmbImpact &impact : engine.impacts) {
    impact.body->impact = -1;
    impact.body->body.predictIntegratedTransform(dt * impact.share, impact.pose);
    impact.pose.getOrigin() += impact.drift * (dt * (1 - impact.share));
  }
}

void stop_at_impacts(EngineWorld &engine) {
  for (const AmbImpact &impact : engine.impacts) {
    if (impact.is_held) continue;
    impact.body->body.proceedToTransform(impact.pose);
    // The body is not to be integrated as a free body in this sub-step.
    impact.body->contact_sub_step = engine.sub_step + 1;
  }
}

extern "C" {

int amb_world_set_continuous(AmbWorld *world, AmbBody *body, int enabled) {
  std::atomic<double> &known = *body->shape->inner_radius;
  if (enabled && known < 0) {
    const btScalar found = inner_radius(*body->shape->shape, btTransform::getIdentity());
    // Threads that find it at the same time find the same.
    known = std::isfinite(found) ? btMax(found, btScalar(0)) : 0;
  }
  const btScalar radius = enabled ? known.load() : 0;
  body->swept_radius = SWEPT_SHARE * radius;
  body->is_continuous = enabled;
  engine_of(*world).has_continuous |= body->swept_radius > 0;
  return body->swept_radius > 0;
}

}  // extern "C"
