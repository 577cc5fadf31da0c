#include <BulletCollision/CollisionDispatch/btManifoldResult.h>

#include "internal.h"

namespace {

// Points of contacts keep the coefficients with which they were made.
void refresh_contacts(AmbBody &body) {
  btDispatcher &dispatcher = body.world->dispatcher;
  for (int i = 0; i < dispatcher.getNumManifolds(); ++i) {
    btPersistentManifold &manifold = *dispatcher.getManifoldByIndexInternal(i);
    const btCollisionObject *a = manifold.getBody0(), *b = manifold.getBody1();
    if (a != body.collider && b != body.collider) continue;
    for (int p = 0; p < manifold.getNumContacts(); ++p) {
      btManifoldPoint &point = manifold.getContactPoint(p);
      point.m_combinedFriction = btManifoldResult::calculateCombinedFriction(a, b);
      point.m_combinedRollingFriction = btManifoldResult::calculateCombinedRollingFriction(a, b);
      point.m_combinedSpinningFriction = btManifoldResult::calculateCombinedSpinningFriction(a, b);
      point.m_combinedRestitution = btManifoldResult::calculateCombinedRestitution(a, b);
    }
  }
}

// Tells whoever has copies of what was set.
void note_change(AmbBody &body) {
  if (body.world && body.world->extension) body.world->extension->body_changed(body);
}

// To be called when what the body collides with has changed.
void note_partners(const AmbBody &body) {
  if (body.world) body.world->broadphase.is_unknown = true;
}

}  // namespace

extern "C" {

AmbBody *amb_body_new(double mass, const double inertia[3], AmbShape *shape, const double pose[12]) {
  return new AmbBody(mass, vector_of(inertia), shape, transform_of(pose));
}

void amb_body_free(AmbBody *body) { delete body; }

void amb_body_set_apart(AmbBody *body, unsigned family, const unsigned *groups, int n) {
  body->family = family;
  body->groups.assign(groups, groups + n);
  note_partners(*body);
}

void amb_body_set_filter(AmbBody *body, unsigned model, unsigned member, unsigned cluster, unsigned outer, unsigned kind,
                         unsigned affinity, const unsigned *excluded, int n, const unsigned *included, int m) {
  body->filter = std::make_unique<CollisionFilter>();
  CollisionFilter &filter = *body->filter;
  filter.model = model;
  filter.member = member;
  filter.cluster = cluster;
  filter.outer = outer;
  filter.kind = kind;
  filter.affinity = affinity;
  filter.excluded.assign(excluded, excluded + n);
  filter.included.assign(included, included + m);
  note_partners(*body);
}

void amb_body_set_surface(AmbBody *body, double friction, double rolling_friction, double restitution) {
  body->body.setFriction(friction);
  body->body.setRollingFriction(rolling_friction);
  body->body.setRestitution(restitution);
  note_change(*body);
  if (!body->world) return;
  refresh_contacts(*body);
  body->body.activate();
}

void amb_body_set_damping(AmbBody *body, double linear, double angular) {
  body->body.setDamping(linear, angular);
  if (body->world) set_sleeping_thresholds(*body->world, *body);
  note_change(*body);
}

void amb_body_set_mass(AmbBody *body, double mass, const double inertia[3]) {
  btRigidBody &rigid = body->body;
  if (rigid.getInvMass() <= 0 || !(mass > 0)) return;
  rigid.setMassProps(mass, vector_of(inertia));
  rigid.updateInertiaTensor();
  note_change(*body);
  rigid.activate();
}

// activate() wakes a sleeping body and has no effect on a body that never sleeps.

void amb_body_set_gravity(AmbBody *body, const double gravity[3]) {
  const btVector3 before = body->body.getGravity();
  body->body.setGravity(vector_of(gravity));
  if (before == body->body.getGravity()) return;
  body->body.activate();
  if (body->world) set_sleeping_thresholds(*body->world, *body);
}

void amb_body_apply_wrench(AmbBody *body, const double force[3], const double torque[3]) {
  const btVector3 f = vector_of(force), t = vector_of(torque);
  body->body.applyCentralForce(f);
  body->body.applyTorque(t);
  if (!f.isZero() || !t.isZero()) body->body.activate();
}

void amb_body_clear_forces(AmbBody *body) { body->body.clearForces(); }

void amb_body_set_velocity(AmbBody *body, const double linear[3], const double angular[3]) {
  body->body.setLinearVelocity(vector_of(linear));
  body->body.setAngularVelocity(vector_of(angular));
  if (body->world && body->world->extension) body->world->extension->velocity_set(*body);
  body->body.activate();
}

void amb_body_set_pose(AmbBody *body, const double pose[12]) {
  const btTransform transform = transform_of(pose);
  amb_body_rest(body);
  if (body->world) {
    set_pose(*body->world, *body, transform);
  } else {
    body->body.setWorldTransform(transform);
    body->motion.setWorldTransform(transform);
  }
}

void amb_body_move(AmbBody *body, const double pose[12], const double velocity[6]) {
  btRigidBody &rigid = body->body;
  if (!rigid.isStaticObject() || !body->world) return;
  // Bullet takes the velocity of static objects for 0 in contacts, unless they are kinematic, too. A body without mass may
  // have moments of inertia, by which impulses would turn it.
  rigid.setCollisionFlags(rigid.getCollisionFlags() | btCollisionObject::CF_KINEMATIC_OBJECT);
  rigid.setMassProps(0, btVector3(0, 0, 0));
  rigid.updateInertiaTensor();
  rigid.setLinearVelocity(vector_of(velocity));
  rigid.setAngularVelocity(vector_of(velocity + 3));
  body->world->moved.push_back({body, transform_of(pose)});
  activate_neighbours(*body->world, *body);
}

void amb_body_rest(AmbBody *body) {
  btRigidBody &rigid = body->body;
  if (!rigid.isKinematicObject()) return;
  const btVector3 zero(0, 0, 0);
  rigid.setLinearVelocity(zero);
  rigid.setAngularVelocity(zero);
  rigid.setCollisionFlags(rigid.getCollisionFlags() & ~btCollisionObject::CF_KINEMATIC_OBJECT);
}

void amb_body_reset(AmbBody *body, const double pose[12], const double *gravity) {
  btRigidBody &rigid = body->body;
  const btVector3 zero(0, 0, 0);
  amb_body_rest(body);
  rigid.clearForces();
  rigid.setLinearVelocity(zero);
  rigid.setAngularVelocity(zero);
  if (!rigid.isStaticObject() && (gravity || body->world))
    rigid.setGravity(gravity ? vector_of(gravity) : body->world->world->getGravity());
  // As Bullet's constructor: the body takes its pose from the motion state, which is the same but for the signs of zeros.
  const btTransform start = transform_of(pose);
  btTransform transform;
  body->motion.place(start);
  body->motion.getWorldTransform(transform);
  if (!body->world) return rigid.setWorldTransform(transform);
  set_pose(*body->world, *body, transform);
  body->motion.place(start);
  if (Extension *extension = body->world->extension.get()) {
    extension->velocity_set(*body);
    extension->body_reset(*body);
  }
  set_sleeping_thresholds(*body->world, *body);
}

void amb_body_pose(const AmbBody *body, double pose[12]) { write_pose(body->body.getWorldTransform(), pose); }

void amb_body_motion_state(const AmbBody *body, double pose[12]) { write_pose(body->motion.pose(), pose); }

void amb_body_velocity(const AmbBody *body, double velocity[6]) {
  write_vector(body->body.getLinearVelocity(), velocity);
  write_vector(body->body.getAngularVelocity(), velocity + 3);
}

void amb_bodies_read(AmbBody *const *bodies, int n, double *out) {
  for (int i = 0; i < n; ++i, out += 18) {
    if (!bodies[i]) continue;
    amb_body_motion_state(bodies[i], out);
    amb_body_velocity(bodies[i], out + 12);
  }
}

int amb_bodies_first_lost(AmbBody *const *bodies, int n, double speed, double distance) {
  for (int i = 0; i < n; ++i) {
    if (!bodies[i]) continue;
    const btRigidBody &body = bodies[i]->body;
    const btVector3 &origin = body.getWorldTransform().getOrigin();
    const btVector3 &linear = body.getLinearVelocity(), &angular = body.getAngularVelocity();
    // One row of the rotation is enough: where another one is not finite, the angular velocity is not finite either.
    if (!finite(origin + body.getWorldTransform().getBasis()[0] + linear + angular)) return i;
    // Poses of static bodies are set by the caller and not checked against the bounds.
    if (body.isStaticOrKinematicObject()) continue;
    if (linear.length2() > speed * speed || angular.length2() > speed * speed || origin.length2() > distance * distance)
      return i;
  }
  return -1;
}

}  // extern "C"
