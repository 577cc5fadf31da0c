#include "pair_cache.h"

#include "internal.h"

namespace {

AmbObject &owner_of(const btBroadphaseProxy &proxy) {
  return *object_of(static_cast<const btCollisionObject *>(proxy.m_clientObject));
}

btBroadphaseProxy *proxy_of(const btBroadphasePair &pair, int side) { return side ? pair.m_pProxy1 : pair.m_pProxy0; }

// Places of a pair among the partners of both of its objects, in the pointer that Bullet leaves to its users.
uint32_t place_of(const btBroadphasePair &pair, int side) {
  return static_cast<uint32_t>(reinterpret_cast<uintptr_t>(pair.m_internalInfo1) >> (32 * side));
}

void set_place(btBroadphasePair &pair, int side, size_t place) {
  const uintptr_t other = reinterpret_cast<uintptr_t>(pair.m_internalInfo1) & (uintptr_t(0xffffffff) << (32 * !side));
  pair.m_internalInfo1 = reinterpret_cast<void *>(other | uintptr_t(place) << (32 * side));
}

}  // namespace

btBroadphasePair *PairCache::addOverlappingPair(btBroadphaseProxy *first, btBroadphaseProxy *second) {
  AmbObject &a = owner_of(*first), &b = owner_of(*second);
  if (leaves_out_apart && a.is_apart_from(b)) return nullptr;
  const int before = getNumOverlappingPairs();
  btBroadphasePair *pair = btHashedOverlappingPairCache::addOverlappingPair(first, second);
  if (getNumOverlappingPairs() == before) return pair;
  pair->m_internalInfo1 = nullptr;
  for (int side : {0, 1}) {
    Partners &partners = owner_of(*proxy_of(*pair, side)).partners;
    set_place(*pair, side, partners.size());
    partners.push_back(proxy_of(*pair, !side));
  }
  return pair;
}

// Takes the pair out of the partners of one of its objects; the last partner takes its place.
void PairCache::forget(const btBroadphasePair &pair, int side) {
  btBroadphaseProxy *own = proxy_of(pair, side);
  Partners &partners = owner_of(*own).partners;
  const uint32_t place = place_of(pair, side);
  if (place + 1 < partners.size()) {
    partners[place] = partners.back();
    btBroadphasePair &moved = *findPair(own, partners[place]);
    set_place(moved, moved.m_pProxy0 == own ? 0 : 1, place);
  }
  partners.pop_back();
}

void *PairCache::removeOverlappingPair(btBroadphaseProxy *first, btBroadphaseProxy *second, btDispatcher *dispatcher) {
  if (const btBroadphasePair *pair = findPair(first, second)) {
    forget(*pair, 0);
    forget(*pair, 1);
  }
  return btHashedOverlappingPairCache::removeOverlappingPair(first, second, dispatcher);
}

const Vector<int> &PairCache::pairs_of(btBroadphaseProxy *proxy) {
  found_.clear();
  const btBroadphasePairArray &pairs = getOverlappingPairArray();
  for (btBroadphaseProxy *partner : owner_of(*proxy).partners)
    found_.push_back(static_cast<int>(findPair(proxy, partner) - &pairs[0]));
  std::sort(found_.begin(), found_.end());
  return found_;
}

// Bullet goes through all pairs from the first on; where it removes one the last takes its place, and is looked at next.
void PairCache::removeOverlappingPairsContainingProxy(btBroadphaseProxy *proxy, btDispatcher *dispatcher) {
  const Vector<int> &own = pairs_of(proxy);
  const btBroadphasePairArray &pairs = getOverlappingPairArray();
  for (size_t i = 0, end = own.size(); i < end;) {
    const int last = pairs.size() - 1;
    const btBroadphasePair &pair = pairs[own[i]];
    const bool is_replaced_by_own = own[end - 1] == last && own[i] != last;
    removeOverlappingPair(pair.m_pProxy0, pair.m_pProxy1, dispatcher);
    is_replaced_by_own ? --end : ++i;
  }
}

void PairCache::cleanProxyFromPairs(btBroadphaseProxy *proxy, btDispatcher *dispatcher) {
  for (int index : pairs_of(proxy)) cleanOverlappingPair(getOverlappingPairArray()[index], dispatcher);
}
