// Pairs of objects whose bounding boxes overlap. C++ only.
#ifndef AMB_PAIR_CACHE_H
#define AMB_PAIR_CACHE_H

#include <algorithm>
#include <cstdint>

#include <btBulletDynamicsCommon.h>

#include "arena_memory.h"

struct AmbObject;

// Partners of an object in the pair cache.
using Partners = Vector<btBroadphaseProxy *>;

// Bullet's pair cache, which finds the pairs of a proxy by a look at all pairs. This one knows them: removing an object
// takes time in proportion to its own pairs. Pairs have the same order as in Bullet's at any time.
class PairCache : public btHashedOverlappingPairCache {
 public:
  btBroadphasePair *addOverlappingPair(btBroadphaseProxy *first, btBroadphaseProxy *second) override;
  void *removeOverlappingPair(btBroadphaseProxy *first, btBroadphaseProxy *second, btDispatcher *dispatcher) override;
  void removeOverlappingPairsContainingProxy(btBroadphaseProxy *proxy, btDispatcher *dispatcher) override;
  void cleanProxyFromPairs(btBroadphaseProxy *proxy, btDispatcher *dispatcher) override;

  // Makes no pairs of objects that are apart for good: links of a robot that are all at one point would have as many as
  // there are pairs of them.
  bool leaves_out_apart = false;

 private:
  // Indices of the pairs of a proxy, ascending.
  const Vector<int> &pairs_of(btBroadphaseProxy *proxy);
  void forget(const btBroadphasePair &pair, int side);

  Vector<int> found_;
};

#endif
