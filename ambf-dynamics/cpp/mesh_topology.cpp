#include "mesh_topology.h"

#include <algorithm>
#include <tuple>

#include <BulletCollision/Gimpact/btGImpactShape.h>

#include "volume_shape.h"

namespace {

// A triangle's edge, with the lower vertex first.
struct Side {
  int low, high, triangle, corner;
  bool operator<(const Side &other) const {
    return std::tie(low, high, triangle, corner) < std::tie(other.low, other.high, other.triangle, other.corner);
  }
  bool is_same_edge(const Side &other) const { return low == other.low && high == other.high; }
};

// Unit vector from an edge towards a point, at a right angle with the edge.
btVector3 direction_from(const btVector3 &start, const btVector3 &end, const btVector3 &point) {
  const btVector3 along = end - start, to = point - start;
  const btVector3 across = to - along * (to.dot(along) / along.length2());
  return across / across.length();
}

}  // namespace

MeshTopology::MeshTopology(btGImpactMeshShape &shape) {
  btGImpactMeshShapePart &part = *shape.getMeshPart(0);
  const btGImpactMeshShapePart::TrimeshPrimitiveManager &mesh = *part.getTrimeshPrimitiveManager();
  part.lockChildShapes();
  const int n = mesh.get_vertex_count(), m = mesh.get_primitive_count();
  std::vector<btVector3> given(n);
  for (int i = 0; i < n; ++i) mesh.get_vertex(i, given[i]);
  triangles.resize(m);
  for (int i = 0; i < m; ++i) {
    auto *const corners = triangles[i].corners;
    unsigned int indices[3];
    mesh.get_indices(i, indices[0], indices[1], indices[2]);
    std::copy(indices, indices + 3, corners);
  }
  part.unlockChildShapes();

  // Files repeat vertices where normals or texture coordinates differ.
  std::vector<int> order(n), unique(n);
  for (int i = 0; i < n; ++i) order[i] = i;
  const auto place = [&](int i) { return std::make_tuple(given[i].x(), given[i].y(), given[i].z()); };
  std::sort(order.begin(), order.end(), [&](int a, int b) { return place(a) < place(b); });
  for (int i = 0; i < n; ++i) {
    if (i == 0 || place(order[i - 1]) != place(order[i])) vertices.push_back(given[order[i]]);
    unique[order[i]] = static_cast<int>(vertices.size()) - 1;
  }

  for (Triangle &triangle : triangles) {
    for (int &corner : triangle.corners) corner = unique[corner];
  }
  connect(m);
}

MeshTopology::MeshTopology(const VolumeBrick &brick) : vertices(brick.vertices), triangles(brick.triangles.size() / 3) {
  for (size_t i = 0; i < brick.triangles.size(); ++i) triangles[i / 3].corners[i % 3] = brick.triangles[i];
  connect(brick.own);
}

void MeshTopology::connect(int own) {
  std::vector<Side> sides;
  sides.reserve(3 * triangles.size());
  for (int i = 0; i < static_cast<int>(triangles.size()); ++i) {
    Triangle &triangle = triangles[i];
    std::fill(triangle.edges, triangle.edges + 3, -1);
    const btVector3 &a = vertices[triangle.corners[0]], &b = vertices[triangle.corners[1]],
                    &c = vertices[triangle.corners[2]];
    const btScalar longest = std::max({a.distance2(b), b.distance2(c), c.distance2(a)});
    triangle.is_degenerate = !((b - a).cross(c - a).length() > btScalar(1e-10) * longest);
    if (triangle.is_degenerate) continue;
    for (int k = 0; k < 3; ++k) {
      const auto [low, high] = std::minmax(triangle.corners[k], triangle.corners[(k + 1) % 3]);
      sides.push_back({low, high, i, k});
    }
  }
  std::sort(sides.begin(), sides.end());

  std::vector<std::pair<int, int>> joined;
  for (size_t first = 0, last; first < sides.size(); first = last) {
    const Side &side = sides[first];
    for (last = first; last < sides.size() && sides[last].is_same_edge(side);) ++last;
    joined.emplace_back(side.low, side.high);
    joined.emplace_back(side.high, side.low);
    if (side.triangle >= own) continue;
    const auto opposite = [&](size_t i) { return triangles[sides[i].triangle].corners[(sides[i].corner + 2) % 3]; };
    const auto across = [&](size_t i) {
      return direction_from(vertices[side.low], vertices[side.high], vertices[opposite(i)]);
    };
    bool is_smooth = false;
    for (size_t i = first; i < last; ++i) {
      for (size_t k = i + 1; k < last; ++k) is_smooth |= (across(i) + across(k)).length() < SMOOTH_BEND;
    }
    if (is_smooth) continue;
    triangles[side.triangle].edges[side.corner] = static_cast<int>(edges.size());
    const int first_wing = static_cast<int>(wings.size());
    for (size_t i = first; i < last; ++i) wings.push_back(opposite(i));
    edges.push_back({{side.low, side.high}, first_wing, static_cast<int>(wings.size())});
  }

  std::sort(joined.begin(), joined.end());
  first_neighbour.assign(vertices.size() + 1, 0);
  for (const auto &pair : joined) {
    ++first_neighbour[pair.first + 1];
    neighbours.push_back(pair.second);
  }
  for (size_t i = 0; i < vertices.size(); ++i) first_neighbour[i + 1] += first_neighbour[i];
}

bool MeshTopology::is_normal_of_edge(const Edge &edge, const btVector3 &normal) const {
  const btVector3 &start = vertices[edge.ends[0]], &end = vertices[edge.ends[1]];
  for (int i = edge.first_wing; i < edge.last_wing; ++i) {
    if (normal.dot(direction_from(start, end, vertices[wings[i]])) > SMOOTH_BEND) return false;
  }
  return true;
}

bool MeshTopology::is_normal_of_vertex(int vertex, const btVector3 &normal) const {
  for (int i = first_neighbour[vertex]; i < first_neighbour[vertex + 1]; ++i) {
    const btVector3 along = vertices[neighbours[i]] - vertices[vertex];
    if (normal.dot(along) > SMOOTH_BEND * along.length()) return false;
  }
  return true;
}
