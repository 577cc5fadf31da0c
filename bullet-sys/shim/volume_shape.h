// A volume as a collision shape. C++ only.
#ifndef AMB_VOLUME_SHAPE_H
#define AMB_VOLUME_SHAPE_H

#include <cmath>
#include <cstdint>
#include <memory>
#include <unordered_map>
#include <vector>

#include <BulletCollision/CollisionShapes/btConcaveShape.h>

#include "extension.h"

extern "C" {
#include "volume.h"
}

// A type of Bullet's that nobody uses, for which it has its algorithms of concave shapes.
constexpr int VOLUME_SHAPE_TYPE = FAST_CONCAVE_MESH_PROXYTYPE;

// The triangles at a brick, which were asked for.
struct VolumeBrick {
  std::vector<btVector3> vertices;
  std::vector<int> triangles;
  // The first so many triangles are the brick's, the others those around.
  int own = 0;
  // Number of the first triangle among all that were ever made: Bullet's algorithms tell triangles apart by it.
  unsigned first = 0;
  // When it was last asked for.
  uint64_t used = 0;
  // What the engine finds out of it.
  std::shared_ptr<const MeshTopology> topology;

  const btVector3 &corner(int triangle, int k) const { return vertices[triangles[3 * triangle + k]]; }
  bool overlaps(int triangle, const btVector3 &low, const btVector3 &high) const {
    const btVector3 &a = corner(triangle, 0), &b = corner(triangle, 1), &c = corner(triangle, 2);
    for (int k = 0; k < 3; ++k) {
      if (a[k] < low[k] && b[k] < low[k] && c[k] < low[k]) return false;
      if (a[k] > high[k] && b[k] > high[k] && c[k] > high[k]) return false;
    }
    return true;
  }
};

class VolumeShape final : public btConcaveShape {
 public:
  BT_DECLARE_ALIGNED_ALLOCATOR();

  explicit VolumeShape(const AmbVolumeSource &from);
  ~VolumeShape() override;

  // The bricks with triangles near a box, m: calls `use` with each whose ball, of a centre and a radius, m, `is_near` takes. What it
  // is given lives until the next one.
  template <typename Near, typename Use>
  void for_bricks(const btVector3 &low, const btVector3 &high, Near is_near, Use use) const {
    int first[3], last[3];
    if (!range(low, high, first, last)) return;
    for (int brick[3] = {first[0], first[1], first[2]}; source_.next(source_.data, first, last, brick); ++brick[0]) {
      btVector3 centre, half;
      for (int k = 0; k < 3; ++k) {
        centre[k] = source_.low[k] + (brick[k] + btScalar(0.5)) * source_.brick[k];
        // Triangles of a brick reach into its neighbours by up to a voxel.
        half[k] = source_.brick[k] / 2 + source_.voxel[k];
      }
      if (is_near(centre, half.length())) use(*brick_at(brick));
    }
  }

  // The triangles at a brick and at its neighbours are made again when they are asked for.
  void forget(const int brick[3]);

  void processAllTriangles(btTriangleCallback *callback, const btVector3 &low, const btVector3 &high) const override;
  void getAabb(const btTransform &pose, btVector3 &low, btVector3 &high) const override;
  void setLocalScaling(const btVector3 &) override {}
  const btVector3 &getLocalScaling() const override { return scale_; }
  void calculateLocalInertia(btScalar, btVector3 &inertia) const override { inertia.setZero(); }
  const char *getName() const override { return "Volume"; }

 private:
  // On the heap, in no arena: it depends on the voxels alone, and no saved state has it.
  struct Cache {
    std::unordered_map<uint64_t, std::unique_ptr<VolumeBrick>> bricks;
    uint64_t time = 0;
    unsigned triangles = 0;
  };

  bool range(const btVector3 &low, const btVector3 &high, int first[3], int last[3]) const;
  uint64_t key(const int brick[3]) const {
    return (uint64_t(brick[2]) * source_.bricks[1] + brick[1]) * source_.bricks[0] + brick[0];
  }
  VolumeBrick *brick_at(const int brick[3]) const;
  void make_room() const;
  void cast(class btTriangleRaycastCallback &ray) const;
  static void visit(const VolumeBrick &brick, btTriangleCallback &callback, const btVector3 &low, const btVector3 &high);

  const AmbVolumeSource source_;
  const btVector3 scale_{1, 1, 1};
  const std::unique_ptr<Cache> cache_;
};

#endif
