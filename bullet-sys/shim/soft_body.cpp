#include "internal.h"

#include <BulletSoftBody/btSoftBodyConcaveCollisionAlgorithm.h>
#include <cmath>
#include <cstring>

namespace {

// Largest coordinate for which collisions are computed, m. The cell indices of Bullet's signed distance fields overflow
// at 10^9 m.
constexpr btScalar MAX_COORDINATE = 1e7;

bool within_reach(const btVector3 &v) {
  return std::fabs(v.x()) < MAX_COORDINATE && std::fabs(v.y()) < MAX_COORDINATE && std::fabs(v.z()) < MAX_COORDINATE;
}

// Planes are infinite, but the narrow phase sees only a patch of the size of the soft body.
bool within_reach(const btCollisionShape &shape) {
  if (shape.getShapeType() == STATIC_PLANE_PROXYTYPE || shape.getShapeType() == EMPTY_SHAPE_PROXYTYPE) return true;
  if (shape.isCompound()) {
    const auto &compound = static_cast<const btCompoundShape &>(shape);
    for (int i = 0; i < compound.getNumChildShapes(); ++i) {
      if (!within_reach(compound.getChildTransform(i).getOrigin()) || !within_reach(*compound.getChildShape(i)))
        return false;
    }
    return true;
  }
  btVector3 low, high;
  shape.getAabb(btTransform::getIdentity(), low, high);
  return within_reach(low) && within_reach(high);
}

// Bullet triangulates the patch of a plane below the soft body when the pair is created, and never again: a cloth that
// slides off the patch would fall through the plane. This marks the patch as stale when the soft body has moved or
// grown too far.
void follow_patch(AmbSoft &soft) {
  btVector3 low, high;
  soft.body.getAabb(low, high);
  const btVector3 center = (low + high) / 2;
  const btScalar radius = (high - low).length() / 2;
  const btScalar moved = (center - soft.patch_center).length();
  soft.left_patch = moved > soft.patch_radius / 8 || radius > soft.patch_radius * btScalar(1.2);
  if (!soft.left_patch) return;
  soft.patch_center = center;
  soft.patch_radius = radius;
}

bool may_touch(const btCollisionObject &object) {
  AmbObject &owner = *object_of(&object);
  // Bullet would create contact forces between clusters and a ghost.
  if (owner.kind == ObjectKind::Ghost) return false;
  if (owner.kind == ObjectKind::Body) {
    return within_reach(object.getWorldTransform().getOrigin()) && within_reach(*object.getCollisionShape());
  }
  auto &soft = static_cast<AmbSoft &>(owner);
  if (!soft.checked) {
    soft.checked = soft.sound = true;
    for (int i = 0; soft.sound && i < soft.body.m_nodes.size(); ++i)
      soft.sound = within_reach(soft.body.m_nodes[i].m_x);
    if (soft.sound) follow_patch(soft);
  }
  return soft.sound;
}

bool is_plane(const btCollisionObject &object) {
  return object.getCollisionShape()->getShapeType() == STATIC_PLANE_PROXYTYPE;
}

// btAlignedObjectArray::resize needs a default element, which these types cannot construct without compiler warnings.
template <typename T>
void shorten(btAlignedObjectArray<T> &array, int size) {
  while (array.size() > size) array.pop_back();
}

void clear_contacts(btSoftBody &body) {
  shorten(body.m_rcontacts, 0);
  shorten(body.m_scontacts, 0);
  for (int i = 0; i < body.m_joints.size(); ++i) btAlignedFree(body.m_joints[i]);
  shorten(body.m_joints, 0);
}

btDbvtVolume volume_of(const btSoftBody::Face &face) {
  const btVector3 corners[] = {face.m_n[0]->m_x, face.m_n[1]->m_x, face.m_n[2]->m_x};
  return btDbvtVolume::FromPoints(corners, 3);
}

// Builds the bounding-volume tree of the faces as Bullet 2 did. Bullet 3's initializeFaceTree, which it calls only when
// there is no tree, does not terminate when the faces are not connected, and takes quadratic time.
void build_face_tree(btSoftBody &body) {
  if (!body.m_fdbvt.empty()) return;
  for (int i = 0; i < body.m_faces.size(); ++i) {
    btSoftBody::Face &face = body.m_faces[i];
    face.m_leaf = body.m_fdbvt.insert(volume_of(face), &face);
  }
}

void forget_shape(btSparseSdf<3> &fields, const AmbShape &shape) {
  fields.RemoveReferences(shape.shape.get());
  for (const auto &child : shape.children) forget_shape(fields, *child);
}

template <typename F>
void each_soft(AmbWorld &world, F apply) {
  if (!world.soft) return;
  const btSoftBodyArray &bodies = world.soft->getSoftBodyArray();
  for (int i = 0; i < bodies.size(); ++i) apply(*soft_of(bodies[i]));
}

void pull(btSoftBody::Node &node, const btVector3 &goal, btScalar dt) {
  if (node.m_im == 0) {
    node.m_x = goal;
    return;
  }
  btVector3 way = goal - node.m_x;
  if (way.length() > 100) way *= 10 / way.length();
  node.m_v += way / dt;
}

}  // namespace

void before_soft_sub_step(btDynamicsWorld *dynamics, btScalar dt) {
  each_soft(*static_cast<AmbWorld *>(dynamics->getWorldUserInfo()), [dt](AmbSoft &soft) {
    soft.checked = false;
    btSoftBody::tNodeArray &nodes = soft.body.m_nodes;
    for (const AmbSoft::Pull &p : soft.pulls) pull(nodes[p.node], p.goal, dt);
    if (soft.force.isZero()) return;
    const btScalar mass = soft.body.getTotalMass();
    for (int i = 0; i < nodes.size(); ++i) {
      if (nodes[i].m_im > 0) nodes[i].m_f += soft.force / (nodes[i].m_im * mass);
    }
  });
}

void after_soft_step(AmbWorld &world) {
  each_soft(world, [](AmbSoft &soft) { soft.force.setZero(); });
}

void TreeCopy::take(const btDbvt &tree) {
  leaves_ = tree.m_leaves;
  lookahead_ = tree.m_lkhd;
  path_ = tree.m_opath;
  nodes_.clear();
  if (!tree.m_root) return;
  Vector<const btDbvtNode *> originals{tree.m_root};
  nodes_.push_back({tree.m_root->volume, nullptr, -1, false, tree.m_root->isleaf()});
  for (size_t i = 0; i < originals.size(); ++i) {
    const btDbvtNode &original = *originals[i];
    if (original.isleaf()) {
      nodes_[i].data = original.data;
      continue;
    }
    for (int k = 0; k < 2; ++k) {
      const btDbvtNode &child = *original.childs[k];
      nodes_.push_back({child.volume, nullptr, static_cast<int>(i), k == 1, child.isleaf()});
      originals.push_back(&child);
    }
  }
}

template <typename Relink>
void TreeCopy::give(btDbvt &tree, Relink relink) const {
  tree.clear();
  Vector<btDbvtNode *> made;
  for (const Node &node : nodes_) {
    // As btDbvt makes its nodes, which it frees.
    auto *copy = new (btAlignedAlloc(sizeof(btDbvtNode), 16)) btDbvtNode;
    copy->volume = node.volume;
    copy->childs[0] = copy->childs[1] = nullptr;
    copy->parent = node.parent < 0 ? nullptr : made[node.parent];
    if (copy->parent) {
      copy->parent->childs[node.is_second] = copy;
    } else {
      tree.m_root = copy;
    }
    if (node.is_leaf) {
      copy->data = node.data;
      relink(copy);
    }
    made.push_back(copy);
  }
  tree.m_leaves = leaves_;
  tree.m_lkhd = lookahead_;
  tree.m_opath = path_;
}

void prepare_soft_rays(AmbWorld &world) {
  world.has_rays = true;
  each_soft(world, [](AmbSoft &soft) { build_face_tree(soft.body); });
}

void forget_in_soft_bodies(AmbWorld &world, AmbBody &body) {
  each_soft(world, [&body](AmbSoft &soft) {
    amb_soft_remove_anchors(&soft, &body);
    clear_contacts(soft.body);
  });
  // A shape allocated later may have the same address.
  forget_shape(world.soft->getWorldInfo().m_sparsesdf, *body.shape);
}

bool prepare_soft_pair(btBroadphasePair &pair, const btCollisionObject &a, const btCollisionObject &b) {
  if (!may_touch(a) || !may_touch(b)) return false;
  if (pair.m_algorithm && (is_plane(a) || is_plane(b))) {
    const auto &soft = static_cast<const AmbSoft &>(*object_of(is_plane(a) ? &b : &a));
    // The collision configuration creates this algorithm for a soft body and a concave shape.
    if (soft.left_patch) static_cast<btSoftBodyConcaveCollisionAlgorithm *>(pair.m_algorithm)->clearCache();
  }
  return true;
}

void exclude_distance_fields(AmbWorld &world) {
  btSparseSdf<3> &fields = world.soft->getWorldInfo().m_sparsesdf;
  const int size = fields.cells.size();
  AmbArena *const arena = amb_arena_enter(nullptr);
  fields.Reset();
  fields.cells.clear();
  fields.Initialize(size, fields.m_clampCells);
  amb_arena_enter(arena);
}

void restore_soft_bodies(AmbWorld &world, AmbArena &arena, const unsigned char *copy, size_t size) {
  btSparseSdf<3> &fields = world.soft->getWorldInfo().m_sparsesdf;
  // Shapes that Bullet allocates in the arena, such as patches of planes, may be at the addresses of other shapes after
  // the restore.
  for (int i = 0; i < fields.cells.size(); ++i) {
    for (btSparseSdf<3>::Cell **at = &fields.cells[i]; *at;) {
      btSparseSdf<3>::Cell *cell = *at;
      if (is_in_arena(arena, cell->pclient)) {
        *at = cell->next;
        delete cell;
        --fields.ncells;
      } else {
        at = &cell->next;
      }
    }
  }
  alignas(btSparseSdf<3>) unsigned char kept[sizeof(btSparseSdf<3>)];
  memcpy(kept, static_cast<const void *>(&fields), sizeof(kept));
  restore_arena(arena, copy, size);
  memcpy(static_cast<void *>(&fields), kept, sizeof(kept));
}

extern "C" {

AmbSoft *amb_soft_new(AmbWorld *world, const double *nodes, int n) {
  std::vector<btVector3> positions;
  positions.reserve(n);
  for (int i = 0; i < n; ++i) positions.push_back(vector_of(nodes + 3 * i));
  return new AmbSoft(&world->soft->getWorldInfo(), n, positions.data());
}

void amb_soft_append_links(AmbSoft *soft, const unsigned *links, int n, int bending) {
  btSoftBody &body = soft->body;
  for (int i = 0; i < n; ++i) {
    body.appendLink(static_cast<int>(links[2 * i]), static_cast<int>(links[2 * i + 1]));
    body.m_links[body.m_links.size() - 1].m_bbending = bending != 0 ? 1 : 0;
  }
}

void amb_soft_append_faces(AmbSoft *soft, const unsigned *faces, int n) {
  for (const unsigned *f = faces; f != faces + 3 * n; f += 3) {
    soft->body.appendFace(static_cast<int>(f[0]), static_cast<int>(f[1]), static_cast<int>(f[2]));
  }
}

void amb_soft_set_margin(AmbSoft *soft, double margin) { soft->body.getCollisionShape()->setMargin(margin); }

void amb_soft_set_mass(AmbSoft *soft, double mass) { soft->body.setTotalMass(mass, false); }

void amb_soft_transform(AmbSoft *soft, const double pose[12]) { soft->body.transform(transform_of(pose)); }

void amb_soft_set_material(AmbSoft *soft, const double stiffness[3]) {
  btSoftBody::Material &material = *soft->body.m_materials[0];
  material.m_kLST = stiffness[0];
  material.m_kAST = stiffness[1];
  material.m_kVST = stiffness[2];
}

void amb_soft_set_config(AmbSoft *soft, const AmbSoftConfig *config) {
  btSoftBody::Config &c = soft->body.m_cfg;
  c.kVCF = config->kVCF;
  c.kDP = config->kDP;
  c.kDG = config->kDG;
  c.kLF = config->kLF;
  c.kPR = config->kPR;
  c.kVC = config->kVC;
  c.kDF = config->kDF;
  c.kMT = config->kMT;
  c.kCHR = config->kCHR;
  c.kKHR = config->kKHR;
  c.kSHR = config->kSHR;
  c.kAHR = config->kAHR;
  c.kSRHR_CL = config->kSRHR_CL;
  c.kSKHR_CL = config->kSKHR_CL;
  c.kSSHR_CL = config->kSSHR_CL;
  c.kSR_SPLT_CL = config->kSR_SPLT_CL;
  c.kSK_SPLT_CL = config->kSK_SPLT_CL;
  c.kSS_SPLT_CL = config->kSS_SPLT_CL;
  c.maxvolume = config->maxvolume;
  c.timescale = config->timescale;
  c.viterations = config->viterations;
  c.piterations = config->piterations;
  c.diterations = config->diterations;
  c.citerations = config->citerations;
  // Bullet 3 added flags for deformable bodies, whose contacts a soft-body world never clears. Its mask of soft against
  // soft includes CL_SELF, with which neither clusters nor faces would collide.
  using Collision = btSoftBody::fCollision;
  c.collisions = config->flags & (Collision::SDF_RS | Collision::CL_RS | Collision::VF_SS | Collision::CL_SS);
}

void amb_soft_match_pose(AmbSoft *soft) { soft->body.setPose(false, true); }

void amb_soft_fix_node(AmbSoft *soft, int node) { soft->body.setMass(node, 0); }

void amb_soft_make_clusters(AmbSoft *soft, int n) {
  soft->body.generateClusters(n);
  for (int i = 0; i < soft->body.m_clusters.size(); ++i) {
    btSoftBody::Cluster &cluster = *soft->body.m_clusters[i];
    const btMatrix3x3 &inverse = cluster.m_locii;
    if (finite(inverse[0]) && finite(inverse[1]) && finite(inverse[2])) continue;
    // For a single node or collinear nodes Bullet has inverted a singular inertia matrix.
    const btVector3 zero(0, 0, 0);
    for (int row = 0; row < 3; ++row) cluster.m_locii[row] = cluster.m_invwi[row] = zero;
    cluster.m_av = zero;
  }
}

void amb_soft_randomize(AmbSoft *soft) { soft->body.randomizeConstraints(); }

double amb_soft_volume(const AmbSoft *soft) { return soft->body.getVolume(); }

void amb_world_add_soft(AmbWorld *world, AmbSoft *soft, AmbHandle handle) {
  btSoftBody &body = soft->body;
  // Bullet would do this in the first sub-step, and would build the face tree in its own way.
  body.updateConstants();
  body.m_bUpdateRtCst = false;
  if (world->has_rays || (body.m_cfg.collisions & btSoftBody::fCollision::VF_SS)) build_face_tree(body);
  world->adopt(*soft, nullptr, handle);
  world->soft->addSoftBody(&body);
  AmbSoft::Start &start = soft->start;
  for (int i = 0; i < body.m_nodes.size(); ++i) start.positions.push_back(body.m_nodes[i].m_x);
  for (int i = 0; i < body.m_clusters.size(); ++i) start.clusters.push_back(*body.m_clusters[i]);
  start.solver = body.m_sst;
  start.centre = body.m_pose.m_com;
  start.rotation = body.m_pose.m_rot;
  start.scale = body.m_pose.m_scl;
  for (int i = 0; i < 2; ++i) start.bounds[i] = body.m_bounds[i];
  start.nodes.take(body.m_ndbvt);
  start.faces.take(body.m_fdbvt);
  start.cluster_tree.take(body.m_cdbvt);
}

void amb_world_remove_soft(AmbWorld *world, AmbSoft *soft) {
  world->soft->removeSoftBody(&soft->body);
  // Contacts of other soft bodies may refer to its faces.
  each_soft(*world, [](AmbSoft &other) { clear_contacts(other.body); });
}

void amb_soft_free(AmbSoft *soft) { delete soft; }

int amb_soft_node_count(const AmbSoft *soft) { return soft->body.m_nodes.size(); }

void amb_soft_positions(const AmbSoft *soft, double *out, int n) {
  for (int i = 0; i < n; ++i) write_vector(soft->body.m_nodes[i].m_x, out + 3 * i);
}

void amb_soft_position(const AmbSoft *soft, int node, double out[3]) {
  write_vector(soft->body.m_nodes[node].m_x, out);
}

void amb_soft_velocities(const AmbSoft *soft, double *out, int n) {
  for (int i = 0; i < n; ++i) write_vector(soft->body.m_nodes[i].m_v, out + 3 * i);
}

void amb_soft_center(const AmbSoft *soft, double center[3]) {
  btVector3 weighted(0, 0, 0), sum(0, 0, 0);
  btScalar mass = 0;
  const int n = soft->body.m_nodes.size();
  for (int i = 0; i < n; ++i) {
    const btVector3 &x = soft->body.m_nodes[i].m_x;
    weighted += x * soft->body.getMass(i);
    mass += soft->body.getMass(i);
    sum += x;
  }
  write_vector(mass > 0 ? weighted / mass : sum / n, center);
}

int amb_soft_nearest_node(const AmbSoft *soft, const double point[3], double radius) {
  int nearest = -1;
  btScalar best = radius;
  for (int i = 0; i < soft->body.m_nodes.size(); ++i) {
    const btScalar distance = (soft->body.m_nodes[i].m_x - vector_of(point)).length();
    // Of several nodes at the same distance the first one is returned; a distance equal to the radius counts.
    if (nearest < 0 ? distance <= best : distance < best) {
      nearest = i;
      best = distance;
    }
  }
  return nearest;
}

int amb_soft_nearest_face(const AmbSoft *soft, const double point[3], double radius, int face[3]) {
  const btSoftBody &body = soft->body;
  const btSoftBody::Face *nearest = nullptr;
  btScalar best = radius;
  for (int i = 0; i < body.m_faces.size(); ++i) {
    const btSoftBody::Face &f = body.m_faces[i];
    const btVector3 centroid = (f.m_n[0]->m_x + f.m_n[1]->m_x + f.m_n[2]->m_x) / 3;
    const btScalar distance = (centroid - vector_of(point)).length();
    if (nearest ? distance < best : distance <= best) {
      nearest = &f;
      best = distance;
    }
  }
  for (int i = 0; nearest && i < 3; ++i) face[i] = static_cast<int>(nearest->m_n[i] - &body.m_nodes[0]);
  return nearest != nullptr;
}

int amb_soft_first_lost(const AmbSoft *soft) {
  int farthest = 0;
  for (int i = 0; i < soft->body.m_nodes.size(); ++i) {
    const btSoftBody::Node &node = soft->body.m_nodes[i];
    if (!finite(node.m_x + node.m_v)) return i;
    if (node.m_x.length2() > soft->body.m_nodes[farthest].m_x.length2()) farthest = i;
  }
  return soft->body.isActive() ? -1 : farthest;
}

void amb_soft_restore(AmbSoft *soft) {
  btSoftBody &body = soft->body;
  const AmbSoft::Start &start = soft->start;
  const btVector3 zero(0, 0, 0);
  clear_contacts(body);
  for (int i = 0; i < body.m_nodes.size(); ++i) {
    btSoftBody::Node &node = body.m_nodes[i];
    node.m_x = node.m_q = start.positions[i];
    node.m_v = node.m_vn = node.m_f = node.m_splitv = zero;
  }
  start.nodes.give(body.m_ndbvt,
                   [](btDbvtNode *leaf) { static_cast<btSoftBody::Node *>(leaf->data)->m_leaf = leaf; });
  // A tree that rays have needed since is made again for the next ray.
  for (int i = 0; i < body.m_faces.size(); ++i) body.m_faces[i].m_leaf = nullptr;
  start.faces.give(body.m_fdbvt,
                   [](btDbvtNode *leaf) { static_cast<btSoftBody::Face *>(leaf->data)->m_leaf = leaf; });
  for (int i = 0; i < body.m_clusters.size(); ++i) *body.m_clusters[i] = start.clusters[i];
  start.cluster_tree.give(body.m_cdbvt,
                          [](btDbvtNode *leaf) { static_cast<btSoftBody::Cluster *>(leaf->data)->m_leaf = leaf; });
  body.m_sst = start.solver;
  body.m_pose.m_com = start.centre;
  body.m_pose.m_rot = start.rotation;
  body.m_pose.m_scl = start.scale;
  for (int i = 0; i < 2; ++i) body.m_bounds[i] = start.bounds[i];
  body.m_softSoftCollision = false;
  body.updateNormals();
  body.forceActivationState(ACTIVE_TAG);
  soft->pulls.clear();
  soft->force = zero;
  soft->checked = soft->sound = soft->left_patch = false;
  soft->patch_center = zero;
  soft->patch_radius = 0;
}

void amb_soft_apply_force(AmbSoft *soft, const double force[3]) { soft->force += vector_of(force); }

void amb_soft_add_anchor(AmbSoft *soft, int node, AmbBody *body, const double pivot[3], double influence,
                         int disable_collision) {
  soft->body.appendAnchor(node, &body->body, vector_of(pivot), disable_collision != 0, influence);
}

int amb_soft_is_fixed(const AmbSoft *soft, int node) { return soft->body.m_nodes[node].m_im == 0; }

int amb_soft_remove_anchors(AmbSoft *soft, AmbBody *body) {
  btSoftBody::tAnchorArray &anchors = soft->body.m_anchors;
  int kept = 0;
  for (int i = 0; i < anchors.size(); ++i) {
    if (anchors[i].m_body == &body->body) {
      anchors[i].m_node->m_battach = 0;
    } else {
      if (kept != i) anchors[kept] = anchors[i];
      ++kept;
    }
  }
  const int removed = anchors.size() - kept;
  if (removed > 0) {
    shorten(anchors, kept);
    // A node may be anchored to several bodies.
    for (int i = 0; i < kept; ++i) anchors[i].m_node->m_battach = 1;
    soft->body.m_collisionDisabledObjects.remove(&body->body);
  }
  return removed;
}

void amb_soft_pull(AmbSoft *soft, int node, const double *goal) {
  Vector<AmbSoft::Pull> &pulls = soft->pulls;
  for (auto pull = pulls.begin(); pull != pulls.end(); ++pull) {
    if (pull->node == node) {
      pulls.erase(pull);
      break;
    }
  }
  if (goal) pulls.push_back({node, vector_of(goal)});
}

}  // extern "C"
