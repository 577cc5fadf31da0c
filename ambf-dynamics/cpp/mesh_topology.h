// Which triangles of a mesh meet at its edges and vertices. C++ only.
#ifndef AMB_MESH_TOPOLOGY_H
#define AMB_MESH_TOPOLOGY_H

#include <memory>
#include <vector>

#include <LinearMath/btVector3.h>

class btGImpactMeshShape;
struct VolumeBrick;

// Never changes once it is made, and is on the heap, in no arena: worlds in several threads share it.
struct MeshTopology {
  struct Triangle {
    // Indices of vertices.
    int corners[3];
    // Edge from corner k to the next: index in `edges` if the triangle owns the edge, else -1. An edge is owned by the first
    // of its triangles, and by none if it is smooth.
    int edges[3];
    bool is_degenerate;
  };

  // An edge that is the border of the surface or at which the surface bends.
  struct Edge {
    int ends[2];
    // Third corners of its triangles: `wings` from `first_wing` to before `last_wing`.
    int first_wing, last_wing;
  };

  explicit MeshTopology(btGImpactMeshShape &shape);
  // Of the brick's own triangles. Neither the others nor edges and vertices that are theirs alone have contacts.
  explicit MeshTopology(const VolumeBrick &brick);

  // Whether the surface lies below the plane that the normal, a unit vector, has at the edge or vertex, as far as the
  // triangles there show it: a contact with this normal is one with the edge or vertex, and else one with the inside of a
  // triangle beside it (Voronoi regions; Ericson, Real-Time Collision Detection, 2005, section 5.1).
  bool is_normal_of_edge(const Edge &edge, const btVector3 &normal) const;
  bool is_normal_of_vertex(int vertex, const btVector3 &normal) const;

  // Vertices at the same place are one, m.
  std::vector<btVector3> vertices;
  // As in the shape.
  std::vector<Triangle> triangles;
  std::vector<Edge> edges;
  std::vector<int> wings;
  // Vertices that an edge joins with vertex i: `neighbours` from first_neighbour[i] to before first_neighbour[i + 1].
  std::vector<int> neighbours, first_neighbour;

 private:
  // From vertices and the corners of triangles. Edges are those of the first `own` triangles.
  void connect(int own);
};

// Smallest sine of the angle by which the surface bends at an edge that is not smooth, and the largest by which a normal may
// miss the Voronoi region of its feature. The regions of faces are wider by this, too: between those of triangles that meet
// at a smooth edge there would otherwise be a gap through which bodies fall.
constexpr btScalar SMOOTH_BEND = 2e-4;

#endif
