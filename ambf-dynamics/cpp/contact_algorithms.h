// Contacts that Bullet's algorithms do not find: of convex shapes, here; of those that do not touch yet, near_contacts.h; of
// lines and faces on faces, face_contacts.h; of meshes, mesh_contacts.h. C++ only.
//
// Deep pairs. Bullet finds one point of a pair of convex shapes in each sub-step, the deepest, and keeps up to four of
// them while they hardly move. A shape that lands flat, or a rod on a rod beside it, is thus held by one point of its
// surface: the impact turns the body about it, the next sub-step finds a point at the other end, and the body sinks while
// it rocks, the longer the less inertia it has (I / (m r^2) << 1 for the arm r of the point). Where a pair is deeper than
// its contact breaking threshold, 2 % of the smaller shape, all points are found on which the body can rest: for two
// convex shapes by Bullet's perturbation of their orientation (btConvexConvexAlgorithm), and on planes exactly. Pairs that
// are not deep are as in Bullet: more points than needed are degenerate and cost time.
//
// Spheres near each other. All pairs of convex shapes have their contact from the contact breaking threshold on, so that
// their impact ends with a gap of 0, but two spheres have none before they penetrate each other: by the motion in up to
// one sub-step. Without restitution they have it from the threshold on, too. With restitution the impact is computed from
// where the spheres are in it (`apply_restitution`), and a contact before would only take energy.
#ifndef AMB_CONTACT_ALGORITHMS_H
#define AMB_CONTACT_ALGORITHMS_H

#include <BulletCollision/CollisionDispatch/btBoxBoxCollisionAlgorithm.h>
#include <BulletCollision/CollisionDispatch/btConvexConvexAlgorithm.h>
#include <BulletCollision/CollisionDispatch/btConvexPlaneCollisionAlgorithm.h>
#include <BulletCollision/NarrowPhaseCollision/btGjkEpaPenetrationDepthSolver.h>

#include "face_contacts.h"
#include "mesh_contacts.h"
#include "near_contacts.h"

class btCollisionConfiguration;
class btCollisionDispatcher;

// Registers algorithms that find them. It has to outlive the dispatcher.
class ContactAlgorithms {
 public:
  ContactAlgorithms() : pairs_(&depth_solver_), meshes_(depth_solver_) {
    plane_first_.m_swapped = true;
    compound_second_.m_swapped = true;
    pairs_.near = boxes_.near = &near_;
    pairs_.faces = &faces_;
  }
  void enable(btCollisionDispatcher &dispatcher, btCollisionConfiguration &configuration);
  // To be called with each shape that is or has a mesh, after Bullet has registered its algorithms for meshes.
  void add_mesh(const AmbShape &shape, btCollisionDispatcher &dispatcher);
  // To be called when the first volume comes, also where `enable` is not.
  void add_volumes(btCollisionDispatcher &dispatcher);

 private:
  struct Pairs final : btConvexConvexAlgorithm::CreateFunc {
    using CreateFunc::CreateFunc;
    btCollisionAlgorithm *CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                   const btCollisionObjectWrapper *first,
                                                   const btCollisionObjectWrapper *second) override;
    NearContacts *near = nullptr;
    FaceContacts *faces = nullptr;
  };
  struct Boxes final : btCollisionAlgorithmCreateFunc {
    btCollisionAlgorithm *CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                   const btCollisionObjectWrapper *first,
                                                   const btCollisionObjectWrapper *second) override;
    NearContacts *near = nullptr;
  };
  struct Compounds final : btCollisionAlgorithmCreateFunc {
    btCollisionAlgorithm *CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                   const btCollisionObjectWrapper *first,
                                                   const btCollisionObjectWrapper *second) override;
  };
  struct Spheres final : btCollisionAlgorithmCreateFunc {
    btCollisionAlgorithm *CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                   const btCollisionObjectWrapper *first,
                                                   const btCollisionObjectWrapper *second) override;
  };
  struct Planes final : btCollisionAlgorithmCreateFunc {
    btCollisionAlgorithm *CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                   const btCollisionObjectWrapper *first,
                                                   const btCollisionObjectWrapper *second) override;
  };

  btGjkEpaPenetrationDepthSolver depth_solver_;
  NearContacts near_;
  FaceContacts faces_;
  Pairs pairs_;
  Boxes boxes_;
  Spheres spheres_;
  Planes plane_second_, plane_first_;
  Compounds compound_first_, compound_second_;
  MeshContacts meshes_;
};

#endif
