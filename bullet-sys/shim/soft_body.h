/* Soft bodies: nodes joined by links, with faces for collisions and rendering. A soft body is constructed by the
   functions below in their order and then added to a world. Node indices must be below the number of nodes. */
#ifndef AMB_SOFT_BODY_H
#define AMB_SOFT_BODY_H
#include "types.h"

/* Bullet's parameters under Bullet's names. */
typedef struct AmbSoftConfig {
  double kVCF, kDP, kDG, kLF, kPR, kVC, kDF, kMT, kCHR, kKHR, kSHR, kAHR;
  double kSRHR_CL, kSKHR_CL, kSSHR_CL, kSR_SPLT_CL, kSK_SPLT_CL, kSS_SPLT_CL;
  double maxvolume, timescale;
  int viterations, piterations, diterations, citerations, flags;
} AmbSoftConfig;

/* n nodes (n x 3), m, each of mass 1 kg, in the mesh frame. The world, of kind AmbWorldKind_Soft, must outlive the soft
   body. */
AmbSoft *amb_soft_new(AmbWorld *world, const double *nodes, int n);
void amb_soft_append_links(AmbSoft *soft, const unsigned *links, int n, int bending);
void amb_soft_append_faces(AmbSoft *soft, const unsigned *faces, int n);
void amb_soft_set_margin(AmbSoft *soft, double margin);
/* Total mass, kg, distributed in proportion to the masses of the nodes. */
void amb_soft_set_mass(AmbSoft *soft, double mass);
/* Transforms the nodes from the mesh frame to world axes. */
void amb_soft_transform(AmbSoft *soft, const double pose[12]);
/* Linear, area and volume stiffness, 0 to 1. */
void amb_soft_set_material(AmbSoft *soft, const double stiffness[3]);
void amb_soft_set_config(AmbSoft *soft, const AmbSoftConfig *config);
/* Makes the present shape the reference shape of pose matching. */
void amb_soft_match_pose(AmbSoft *soft);
void amb_soft_fix_node(AmbSoft *soft, int node);
/* n: number of clusters; 0: one per face. */
void amb_soft_make_clusters(AmbSoft *soft, int n);
void amb_soft_randomize(AmbSoft *soft);
/* Volume enclosed by the faces, m^3; negative if they are oriented inwards. */
double amb_soft_volume(const AmbSoft *soft);

/* Makes the present shape the rest shape. */
void amb_world_add_soft(AmbWorld *world, AmbSoft *soft, AmbHandle handle);
void amb_world_remove_soft(AmbWorld *world, AmbSoft *soft);
/* The soft body must have been removed from its world. */
void amb_soft_free(AmbSoft *soft);

int amb_soft_node_count(const AmbSoft *soft);
/* The first n nodes into out (n x 3), world axes: m, or m/s. */
void amb_soft_positions(const AmbSoft *soft, double *out, int n);
void amb_soft_velocities(const AmbSoft *soft, double *out, int n);
void amb_soft_position(const AmbSoft *soft, int node, double out[3]);
/* Centre of mass, m; of nodes that are all fixed: their mean. */
void amb_soft_center(const AmbSoft *soft, double center[3]);
/* The node that is nearest to point within radius, or -1. */
int amb_soft_nearest_node(const AmbSoft *soft, const double point[3], double radius);
/* The nodes of the face whose centroid is nearest to point within radius; 0 when there is none. */
int amb_soft_nearest_face(const AmbSoft *soft, const double point[3], double radius, int face[3]);
/* Index of the first node whose position or velocity is not finite; or of the node farthest from the origin, if Bullet
   has disabled the soft body because it is larger than 10^6 m; else -1. */
int amb_soft_first_lost(const AmbSoft *soft);

/* The state when the body was added to its world: at rest, without contacts, forces and pulls. Anchors are kept. The broad
   phase follows with amb_world_recover. */
void amb_soft_restore(AmbSoft *soft);
/* Force, N, distributed over the nodes in proportion to mass, in every sub-step of the next step. */
void amb_soft_apply_force(AmbSoft *soft, const double force[3]);

/* Anchors a node to a point of a body, in its inertial frame, m. The node or the body must be movable. */
void amb_soft_add_anchor(AmbSoft *soft, int node, AmbBody *body, const double pivot[3], double influence,
                         int disable_collision);
int amb_soft_is_fixed(const AmbSoft *soft, int node);
/* Removes all anchors on a body. Returns their number. */
int amb_soft_remove_anchors(AmbSoft *soft, AmbBody *body);

/* Before each sub-step the node is accelerated towards `goal`, m; a fixed node is moved to it. Replaces the node's
   earlier goal; null: removes it. */
void amb_soft_pull(AmbSoft *soft, int node, const double *goal);

#endif
