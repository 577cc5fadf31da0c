// Contacts of convex shapes with triangle meshes and with the surfaces of volumes, which are meshes that come brick by brick.
// C++ only.
//
// Bullet finds the shallowest way out of each triangle near a body by itself. Where the body lies over the edge between two
// triangles of a floor, the shallowest way out of one of them is often sideways, over the edge, although the surface goes on
// there: bodies hit internal edges. And of the points of all triangles it keeps four, whichever came last.
//
// Here a triangle has contacts
//
// * on its inside, with its normal: the face, edge or vertex of the body that is lowest along the normal, clipped by the
//   triangle's prism;
// * on those of its edges and vertices at which the surface bends away or ends, with a normal that points into the Voronoi
//   region of the edge or vertex (mesh_topology.h), by the Gilbert–Johnson–Keerthi algorithm, or the expanding polytope
//   algorithm where the cores (shapes without their margins) overlap.
//
// A core that the plane of a triangle cuts may be beside the triangle, above an edge of it, or deep in it. The contact on the
// inside is then one only if the expanding polytope algorithm finds the same normal, or one that is outside its Voronoi region.
// Contacts with similar normals are one group, of which the deepest and those that span the largest area are kept, four in a
// manifold. A body that moves fast enough to get through the surface has contacts where it will touch (approach.h).
// Triangles have two sides: the one that the body is less deep on. Of the many contacts that a brick of a volume has with a flat
// body those are left that span the area.
#ifndef AMB_MESH_CONTACTS_H
#define AMB_MESH_CONTACTS_H

#include <BulletCollision/NarrowPhaseCollision/btConvexPenetrationDepthSolver.h>
#include <BulletCollision/CollisionDispatch/btCollisionCreateFunc.h>

#include "contact_selection.h"

class btCollisionDispatcher;
class btGImpactMeshShape;

// Registers the algorithm that finds them, and has what it works with. It has to outlive the dispatcher.
class MeshContacts {
 public:
  explicit MeshContacts(btConvexPenetrationDepthSolver &solver) : depth_solver(solver) {}

  // For meshes of a type of shape: those of GImpact, after Bullet has registered its own algorithm for them, or volumes.
  void enable(btCollisionDispatcher &dispatcher, int type_of_mesh);
  // To be called before the mesh collides with anything.
  static void prepare(const struct AmbShape &shape);

  btConvexPenetrationDepthSolver &depth_solver;
  // Scratch memory.
  ContactFeature feature;
  // In the frame of the mesh, from the mesh to the body.
  Vector<SurfaceContact> found, left;

 private:
  struct Pairs final : btCollisionAlgorithmCreateFunc {
    btCollisionAlgorithm *CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                   const btCollisionObjectWrapper *first,
                                                   const btCollisionObjectWrapper *second) override;
    MeshContacts *owner = nullptr;
  };

  Pairs mesh_second_, mesh_first_;
};

#endif
