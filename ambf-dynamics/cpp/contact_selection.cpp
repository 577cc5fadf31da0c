#include "contact_selection.h"

#include <algorithm>

namespace {

// Cosine of the largest angle between the normals of a group.
constexpr btScalar GROUP_COSINE = 0.9;
// Share of the contact breaking threshold by which a point has to be deeper than others to be kept for its depth.
constexpr btScalar SAME_DEPTH = 0.01;
// Contacts that are not worth to be thinned out, and the directions in which the farthest ones stay.
constexpr size_t ENOUGH = 24;
constexpr int DIRECTIONS = 8;

}  // namespace

ContactSelection select_contacts(Vector<SurfaceContact> &contacts, const SurfaceContact &seed, const btVector3 &centre,
                                 btScalar threshold) {
  const btVector3 normal = seed.normal;
  const btScalar deepest = seed.distance;
  ContactSelection selection;
  const auto is_in = [&](const SurfaceContact &contact) { return !contact.is_done && normal.dot(contact.normal) > GROUP_COSINE; };
  // Points nearer to each other than this are one. Of two surfaces below the same point of the body the nearer one counts.
  const btScalar apart = btScalar(0.1) * threshold;
  // The contact of the highest value, if that is above `least`.
  const auto keep_best = [&](btScalar least, auto value) {
    const SurfaceContact *best = nullptr;
    for (const SurfaceContact &contact : contacts) {
      if (!is_in(contact)) continue;
      const btScalar found = value(contact);
      const bool is_better = best && found > least - apart ? found > least + apart || contact.distance < best->distance
                                                           : found > least;
      if (!is_better) continue;
      least = found;
      best = &contact;
    }
    if (best) selection.kept[selection.count++] = best;
    return best;
  };
  const auto on_body = [](const SurfaceContact &contact) { return contact.point + contact.normal * contact.distance; };
  const SurfaceContact *a = keep_best(-1, [&](const SurfaceContact &contact) {
    return contact.distance <= deepest + SAME_DEPTH * threshold ? on_body(contact).distance(centre) : btScalar(-1);
  });
  const SurfaceContact *b =
      a ? keep_best(apart, [&](const SurfaceContact &contact) { return on_body(contact).distance(on_body(*a)); }) : nullptr;
  if (b) {
    const btVector3 side = normal.cross(on_body(*b) - on_body(*a)).normalized();
    const auto beside = [&](const SurfaceContact &contact) { return side.dot(on_body(contact) - on_body(*a)); };
    keep_best(apart, beside);
    keep_best(apart, [&](const SurfaceContact &contact) { return -beside(contact); });
  }
  for (SurfaceContact &contact : contacts) {
    if (is_in(contact)) contact.is_done = true;
  }
  return selection;
}

void thin_out_contacts(Vector<SurfaceContact> &contacts, size_t first, Vector<SurfaceContact> &left, btScalar threshold) {
  if (contacts.size() - first <= ENOUGH) return;
  left.clear();
  // As for a selection.
  const btScalar apart = btScalar(0.1) * threshold;
  const auto begin = contacts.begin() + first, end = contacts.end();
  for (;;) {
    const SurfaceContact *seed = nullptr;
    for (auto i = begin; i != end; ++i) {
      if (!i->is_done && (!seed || i->distance < seed->distance)) seed = &*i;
    }
    if (!seed) break;
    const btVector3 normal = seed->normal;
    const btScalar deep = seed->distance + SAME_DEPTH * threshold;
    btVector3 ways[DIRECTIONS];
    btPlaneSpace1(normal, ways[0], ways[1]);
    ways[2] = (ways[0] + ways[1]) * SIMDSQRT12;
    ways[3] = (ways[0] - ways[1]) * SIMDSQRT12;
    for (int k = 0; k < 4; ++k) ways[4 + k] = -ways[k];
    // Among all, then among the deepest.
    const SurfaceContact *best[2 * DIRECTIONS] = {};
    btScalar far[2 * DIRECTIONS];
    for (auto i = begin; i != end; ++i) {
      if (i->is_done || !(normal.dot(i->normal) > GROUP_COSINE)) continue;
      i->is_done = true;
      const btVector3 on_body = i->point + i->normal * i->distance;
      for (int k = 0; k < (i->distance <= deep ? 2 : 1) * DIRECTIONS; ++k) {
        const btScalar value = ways[k % DIRECTIONS].dot(on_body);
        const bool is_better =
            !best[k] || value > far[k] + apart || (value > far[k] - apart && i->distance < best[k]->distance);
        if (!is_better) continue;
        best[k] = &*i;
        far[k] = value;
      }
    }
    for (int k = 0; k < 2 * DIRECTIONS; ++k) {
      if (!best[k] || std::find(best, best + k, best[k]) != best + k) continue;
      left.push_back(*best[k]);
      left.back().is_done = false;
    }
    // A normal that is not a number is in no group.
    if (!best[0]) break;
  }
  contacts.resize(first);
  contacts.insert(contacts.end(), left.begin(), left.end());
}
