#include "volume_shape.h"

#include <algorithm>

#include <BulletCollision/NarrowPhaseCollision/btRaycastCallback.h>

#include "internal.h"

namespace {

// Bricks whose triangles are kept; some 60 kB each.
constexpr size_t MOST_BRICKS = 2048;

// Bullet has 21 bits for the number of a triangle in its part, and 10 for that of the part.
constexpr int TRIANGLE_BITS = 21, PART_BITS = 10;

}  // namespace

VolumeShape::VolumeShape(const AmbVolumeSource &from) : source_(from), cache_(std::make_unique<Cache>()) {
  m_shapeType = VOLUME_SHAPE_TYPE;
  m_collisionMargin = 0;
}

VolumeShape::~VolumeShape() { source_.release(source_.data); }

bool VolumeShape::range(const btVector3 &low, const btVector3 &high, int first[3], int last[3]) const {
  for (int k = 0; k < 3; ++k) {
    const btScalar most = source_.bricks[k] - 1;
    // A coordinate that is not a number is in no brick.
    const btScalar from = std::floor((low[k] - source_.low[k] - source_.voxel[k]) / source_.brick[k]);
    const btScalar to = std::floor((high[k] - source_.low[k] + source_.voxel[k]) / source_.brick[k]);
    if (!(from <= most && to >= 0 && from <= to)) return false;
    first[k] = static_cast<int>(std::max(from, btScalar(0)));
    last[k] = static_cast<int>(std::min(to, most));
  }
  return true;
}

VolumeBrick *VolumeShape::brick_at(const int brick[3]) const {
  Cache &cache = *cache_;
  const uint64_t number = key(brick);
  auto found = cache.bricks.find(number);
  if (found == cache.bricks.end()) {
    make_room();
    AmbBrickMesh mesh{};
    source_.mesh(source_.data, brick, &mesh);
    auto made = std::make_unique<VolumeBrick>();
    made->vertices.reserve(mesh.vertex_count);
    for (int i = 0; i < mesh.vertex_count; ++i) made->vertices.push_back(vector_of(mesh.vertices + 3 * i));
    made->triangles.assign(mesh.triangles, mesh.triangles + 3 * mesh.triangle_count);
    made->own = mesh.own;
    made->first = cache.triangles;
    cache.triangles += static_cast<unsigned>(mesh.own);
    found = cache.bricks.emplace(number, std::move(made)).first;
  }
  found->second->used = ++cache.time;
  return found->second.get();
}

// Drops the half that was not asked for longest.
void VolumeShape::make_room() const {
  Cache &cache = *cache_;
  if (cache.bricks.size() < MOST_BRICKS) return;
  std::vector<uint64_t> used;
  used.reserve(cache.bricks.size());
  for (const auto &[number, brick] : cache.bricks) used.push_back(brick->used);
  const auto middle = used.begin() + used.size() / 2;
  std::nth_element(used.begin(), middle, used.end());
  for (auto i = cache.bricks.begin(); i != cache.bricks.end();) i = i->second->used < *middle ? cache.bricks.erase(i) : ++i;
}

void VolumeShape::forget(const int brick[3]) {
  Cache &cache = *cache_;
  if (cache.bricks.empty()) return;
  for (int z = brick[2] - 1; z <= brick[2] + 1; ++z) {
    for (int y = brick[1] - 1; y <= brick[1] + 1; ++y) {
      for (int x = brick[0] - 1; x <= brick[0] + 1; ++x) {
        const int at[3] = {x, y, z};
        bool is_inside = true;
        for (int k = 0; k < 3; ++k) is_inside &= at[k] >= 0 && at[k] < source_.bricks[k];
        if (is_inside) cache.bricks.erase(key(at));
      }
    }
  }
}

void VolumeShape::visit(const VolumeBrick &brick, btTriangleCallback &callback, const btVector3 &low, const btVector3 &high) {
  for (int i = 0; i < brick.own; ++i) {
    if (!brick.overlaps(i, low, high)) continue;
    btVector3 corners[3] = {brick.corner(i, 0), brick.corner(i, 1), brick.corner(i, 2)};
    const unsigned number = brick.first + i;
    callback.processTriangle(corners, number >> TRIANGLE_BITS & ((1 << PART_BITS) - 1), number & ((1 << TRIANGLE_BITS) - 1));
  }
}

void VolumeShape::processAllTriangles(btTriangleCallback *callback, const btVector3 &low, const btVector3 &high) const {
  // Bullet asks for all triangles in the box around a ray, which may be the whole volume.
  if (auto *const ray = dynamic_cast<btTriangleRaycastCallback *>(callback)) return cast(*ray);
  const auto any = [](const btVector3 &, btScalar) { return true; };
  for_bricks(low, high, any, [&](const VolumeBrick &brick) { visit(brick, *callback, low, high); });
}

// Goes along the ray in pieces of a brick, until it has hit something.
void VolumeShape::cast(btTriangleRaycastCallback &ray) const {
  btVector3 low, high;
  getAabb(btTransform::getIdentity(), low, high);
  const btVector3 way = ray.m_to - ray.m_from;
  btScalar begin = 0, end = 1;
  for (int k = 0; k < 3; ++k) {
    const btScalar reach = source_.voxel[k];
    if (way[k] == 0) {
      if (ray.m_from[k] < low[k] - reach || ray.m_from[k] > high[k] + reach) return;
      continue;
    }
    const btScalar a = (low[k] - reach - ray.m_from[k]) / way[k], b = (high[k] + reach - ray.m_from[k]) / way[k];
    begin = std::max(begin, std::min(a, b));
    end = std::min(end, std::max(a, b));
  }
  if (!(begin < end)) return;
  // No more than there are bricks along an axis.
  btScalar bricks = 0;
  for (int k = 0; k < 3; ++k) {
    const btScalar along = btFabs(way[k]) * (end - begin) / source_.brick[k];
    bricks = std::max(bricks, std::min(along, btScalar(source_.bricks[k] + 2)));
  }
  const int pieces = static_cast<int>(std::ceil(bricks)) + 1;
  for (int i = 0; i < pieces; ++i) {
    const btScalar from = begin + (end - begin) * i / pieces, to = begin + (end - begin) * (i + 1) / pieces;
    if (from > ray.m_hitFraction) return;
    btVector3 first = ray.m_from + way * from, last = first;
    first.setMin(ray.m_from + way * to);
    last.setMax(ray.m_from + way * to);
    const auto any = [](const btVector3 &, btScalar) { return true; };
    for_bricks(first, last, any, [&](const VolumeBrick &brick) { visit(brick, ray, first, last); });
  }
}

void VolumeShape::getAabb(const btTransform &pose, btVector3 &low, btVector3 &high) const {
  btTransformAabb(vector_of(source_.bounds), vector_of(source_.bounds + 3), 0, pose, low, high);
}

namespace {

// Takes a body out of its world and puts it back: pairs and their algorithms are those of its shape.
void put_again(AmbWorld &world, AmbBody &body) {
  btRigidBody &rigid = body.body;
  // Which adding a body sets.
  const btVector3 gravity = rigid.getGravity();
  const bool is_visual_only = rigid.getBroadphaseHandle()->m_collisionFilterMask == 0;
  world.world->removeRigidBody(&rigid);
  rigid.setCollisionShape(body.shape->shape.get());
  if (is_visual_only) {
    world.world->addRigidBody(&rigid, 0, 0);
  } else {
    world.world->addRigidBody(&rigid);
  }
  rigid.setGravity(gravity);
  set_activation_state(world, body);
}

}  // namespace

extern "C" {

AmbShape *amb_shape_volume(const AmbVolumeSource *source) {
  auto *owner = new AmbShape;
  owner->shape.reset(new VolumeShape(*source));
  owner->has_volume = true;
  return owner;
}

void amb_shape_volume_changed(AmbShape *volume, const int brick[3]) {
  static_cast<VolumeShape &>(*volume->shape).forget(brick);
}

void amb_shape_add_part(AmbShape *shape, AmbShape *part, const double pose[12]) {
  const double identity[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
  if (!shape->shape->isCompound()) {
    auto whole = std::make_unique<AmbShape>(std::move(*shape));
    *shape = AmbShape();
    // The place of a part is written to its shape, which twins share; this one has the place 0 already.
    whole->is_part = false;
    shape->shape.reset(new btCompoundShape);
    if (whole->shape->getShapeType() == EMPTY_SHAPE_PROXYTYPE) {
      // Nothing of it collides, but the body still refers to it.
      shape->original = whole->shape;
    } else {
      amb_shape_compound_add(shape, whole.release(), identity);
    }
  }
  amb_shape_compound_add(shape, part, pose);
}

void amb_body_shape_changed(AmbBody *body) {
  AmbWorld &world = *body->world;
  world.prepare_for(*body->shape);
  activate_neighbours(world, *body);
  put_again(world, *body);
  activate_neighbours(world, *body);
}

int amb_body_is_link(const AmbBody *body) { return body->collider != &body->body; }

void amb_body_wake_neighbours(AmbBody *body) {
  if (body->world) activate_neighbours(*body->world, *body);
}

}  // extern "C"
