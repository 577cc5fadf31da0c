/* Ray casts and contact points. */
#ifndef AMB_QUERY_H
#define AMB_QUERY_H
#include "types.h"

enum AmbTarget {
  AmbTarget_None = 0,
  AmbTarget_Body = 1,
  AmbTarget_SoftBody = 2,
  AmbTarget_Other = 3 /* a ghost */
};

/* From one point to another, world axes, m. */
typedef struct AmbRay {
  double from[3];
  double to[3];
} AmbRay;

typedef struct AmbRayHit {
  int target;       /* enum AmbTarget; the other members are set only if it is not AmbTarget_None */
  AmbHandle handle; /* of the body or soft body */
  double fraction;  /* of the ray's length, 0 to 1 */
  double point[3];  /* m, world axes */
  double normal[3]; /* unit, world axes, outward */
} AmbRayHit;

/* Closest hit of each of n rays with Bullet's default filter. A ray without length or with a coordinate that is not
   finite hits nothing. */
void amb_world_cast_rays(AmbWorld *world, const AmbRay *rays, int n, AmbRayHit *hits);

typedef struct AmbContact {
  AmbHandle other;
  double point[3];  /* m, world axes, on the body */
  double normal[3]; /* unit, world axes, from the other body to this one */
  double distance;  /* m; negative: penetration depth */
  double impulse;   /* N s along the normal in the last sub-step */
  double friction[3];         /* impulse of friction on the body in the last sub-step, N s, world axes */
  double friction_coefficient; /* of the pair */
} AmbContact;

/* Contact points of a body with other bodies at a distance of at most `threshold` m. Writes up to `capacity` points and
   returns the number of all. Visits every contact manifold of the world. */
int amb_body_contacts(const AmbWorld *world, const AmbBody *body, double threshold, AmbContact *out, int capacity);

/* Two bodies with contact points. */
typedef struct AmbTouching {
  AmbHandle bodies[2];
  int manifold; /* for amb_manifold_contacts, until something of the world is stepped, added or removed */
} AmbTouching;

/* All pairs of bodies with contact points, in the order in which amb_body_contacts visits them. Writes up to `capacity`
   pairs and returns the number of all. */
int amb_world_touching(const AmbWorld *world, AmbTouching *out, int capacity);
typedef struct AmbManifoldContacts {
  AmbContact points[4];
} AmbManifoldContacts;

/* Contact points of a manifold as amb_body_contacts gives them for body `side`, 0 or 1, of its pair, whatever their
   distance. Returns their number; 0 if `manifold` is not in range. */
int amb_manifold_contacts(const AmbWorld *world, int manifold, int side, AmbManifoldContacts *out);

#endif
