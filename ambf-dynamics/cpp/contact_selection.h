// Which contacts of two surfaces are kept, of many with similar normals. C++ only.
#ifndef AMB_CONTACT_SELECTION_H
#define AMB_CONTACT_SELECTION_H

#include "contact_feature.h"

struct SurfaceContact {
  // From one surface to the other.
  btVector3 normal;
  // On the first.
  btVector3 point;
  // Between the surfaces along the normal, m; negative if they overlap.
  btScalar distance;
  // The group that it is in is done.
  bool is_done;
};

// The lowest contact of a group and those that span the largest area with it.
struct ContactSelection {
  const SurfaceContact *kept[4];
  int count = 0;
};

// Selects among the contacts that are not done and have a normal like that of `seed`, the deepest of them; marks all of them as
// done. Of contacts of the same depth the farthest from `centre` is the lowest one. `threshold`: contact breaking threshold, m.
ContactSelection select_contacts(Vector<SurfaceContact> &contacts, const SurfaceContact &seed, const btVector3 &centre,
                                 btScalar threshold);

// Leaves those of the contacts from the `first`-th on that a selection may choose: of each group of similar normals the ones that
// are farthest in some directions, among all and among the deepest. `left`: scratch memory.
void thin_out_contacts(Vector<SurfaceContact> &contacts, size_t first, Vector<SurfaceContact> &left, btScalar threshold);

#endif
