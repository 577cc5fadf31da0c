/* Soft bodies: nodes held together by links, with faces for what others see and touch. They are made in the order of the functions below
   and only then added to a world. Node indices are below the number of nodes everywhere. */
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

/* n nodes (n x 3) of mass 1 in the mesh frame. The world, made for soft bodies, must outlive the soft body. */
AmbSoft *amb_soft_new(AmbWorld *world, const double *nodes, int n);
void amb_soft_append_links(AmbSoft *soft, const unsigned *links, int n, int bending);
void amb_soft_append_faces(AmbSoft *soft, const unsigned *faces, int n);
void amb_soft_set_margin(AmbSoft *soft, double margin);
/* kg, spread as the nodes' masses are. */
void amb_soft_set_mass(AmbSoft *soft, double mass);
/* Moves the nodes to the world. */
void amb_soft_transform(AmbSoft *soft, const double pose[12]);
/* Linear, area and volume stiffness, 0 to 1. */
void amb_soft_set_material(AmbSoft *soft, const double stiffness[3]);
void amb_soft_set_config(AmbSoft *soft, const AmbSoftConfig *config);
/* The present shape is what pose matching pulls towards. */
void amb_soft_match_pose(AmbSoft *soft);
void amb_soft_fix_node(AmbSoft *soft, int node);
/* n = 0: one a face. */
void amb_soft_make_clusters(AmbSoft *soft, int n);
void amb_soft_randomize(AmbSoft *soft);
/* Volume that the faces enclose, m^3; with the sign of their orientation. */
double amb_soft_volume(const AmbSoft *soft);

/* Takes the present shape as the shape at rest. */
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
/* Index of the first node whose position or velocity is not finite; of the farthest, if the soft body has become so large, 10^6 m, that
   Bullet has switched it off; or -1. */
int amb_soft_first_lost(const AmbSoft *soft);

/* Nodes back to where they were when the body was added, at rest and without contacts. Anchors and pulls stay. */
void amb_soft_restore(AmbSoft *soft);
/* N, spread over the nodes by mass, in every sub-step of the next step. */
void amb_soft_apply_force(AmbSoft *soft, const double force[3]);

/* Ties a node to a point of a body, in its inertial frame. One of both must be able to move. */
void amb_soft_add_anchor(AmbSoft *soft, int node, AmbBody *body, const double pivot[3], double influence, int disable_collision);
int amb_soft_is_fixed(const AmbSoft *soft, int node);
/* Unties all nodes from a body. Returns how many there were. */
int amb_soft_remove_anchors(AmbSoft *soft, AmbBody *body);

/* Before each sub-step the node is drawn towards goal; a fixed node is put there. Replaces the node's goal; null: lets go. */
void amb_soft_pull(AmbSoft *soft, int node, const double *goal);

#endif
