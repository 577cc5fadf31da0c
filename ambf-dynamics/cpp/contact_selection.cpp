#include "contact_selection.h"

namespace {

// Cosine of the largest angle between the normals of a group.
constexpr btScalar GROUP_COSINE = 0.9;
// Share of the contact breaking threshold by which a point has to be deeper than others to be kept for its depth.
constexpr btScalar SAME_DEPTH = 0.01;

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
