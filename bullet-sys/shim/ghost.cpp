#include "internal.h"

extern "C" {

AmbGhost *amb_ghost_new(AmbShape *shape, const double pose[12]) { return new AmbGhost(shape, transform_of(pose)); }

void amb_ghost_free(AmbGhost *ghost) { delete ghost; }

void amb_world_add_ghost(AmbWorld *world, AmbGhost *ghost, AmbHandle handle) {
  if (!world->ghost_pairs) {
    world->ghost_pairs = std::make_unique<btGhostPairCallback>();
    world->broadphase.getOverlappingPairCache()->setInternalGhostPairCallback(world->ghost_pairs.get());
  }
  world->adopt(*ghost, ghost->shape, handle);
  world->world->addCollisionObject(&ghost->ghost, btBroadphaseProxy::DefaultFilter, btBroadphaseProxy::AllFilter);
}

void amb_world_remove_ghost(AmbWorld *world, AmbGhost *ghost) { world->world->removeCollisionObject(&ghost->ghost); }

void amb_ghost_set_pose(AmbGhost *ghost, const double pose[12]) { ghost->ghost.setWorldTransform(transform_of(pose)); }

void amb_world_ignore_ghost(AmbWorld *world, AmbGhost *ghost, AmbBody *body) {
  world->ignore_pair(*ghost, ghost->ghost, *body, *body->collider);
}

int amb_ghost_overlaps(AmbWorld *world, AmbGhost *ghost, AmbHandle *out, int capacity) {
  int count = 0;
  btManifoldArray manifolds;
  const btBroadphasePairArray &pairs = ghost->ghost.getOverlappingPairCache()->getOverlappingPairArray();
  for (int i = 0; i < pairs.size(); ++i) {
    // The ghost's pair cache has no collision algorithms; contacts are found through the pair cache of the world.
    btBroadphasePair *pair =
        world->broadphase.getOverlappingPairCache()->findPair(pairs[i].m_pProxy0, pairs[i].m_pProxy1);
    if (!pair || !pair->m_algorithm) continue;
    manifolds.resize(0);
    pair->m_algorithm->getAllContactManifolds(manifolds);
    for (int m = 0; m < manifolds.size(); ++m) {
      const btPersistentManifold &manifold = *manifolds[m];
      const bool first = manifold.getBody0() == &ghost->ghost;
      const AmbBody *other = body_of(first ? manifold.getBody1() : manifold.getBody0());
      if (!other) continue;
      for (int p = 0; p < manifold.getNumContacts(); ++p) {
        if (!(manifold.getContactPoint(p).getDistance() < 0)) continue;
        if (count < capacity) out[count] = other->handle;
        ++count;
      }
    }
  }
  return count;
}

}  // extern "C"
