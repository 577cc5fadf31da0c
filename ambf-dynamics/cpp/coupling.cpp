#include "coupling.h"

#include <algorithm>

#include "articulation.h"

namespace {

btVector3 axis_of_hinge(btHingeConstraint &hinge) {
  return (hinge.getRigidBodyA().getCenterOfMassTransform() * hinge.getAFrame()).getBasis().getColumn(2);
}

// The bodies of all joints of a coupling, dynamic ones first.
std::vector<btRigidBody *> bodies_of(const AmbCoupling &coupling) {
  std::vector<btRigidBody *> found;
  for (const AmbCoupling::Term &term : coupling.terms) {
    for (btRigidBody *body : {&first_of(*term.joint).body, &second_of(*term.joint).body}) {
      if (std::find(found.begin(), found.end(), body) == found.end()) found.push_back(body);
    }
  }
  std::stable_partition(found.begin(), found.end(), [](const btRigidBody *body) { return body->getInvMass() > 0; });
  return found;
}

}  // namespace

CoordinateRow coordinate_row(const AmbConstraint &joint) {
  CoordinateRow row;
  const btTransform &a = joint.constraint->getRigidBodyA().getCenterOfMassTransform();
  const btTransform &b = joint.constraint->getRigidBodyB().getCenterOfMassTransform();
  if (joint.kind == Kind::Hinge) {
    auto &hinge = static_cast<btHingeConstraint &>(*joint.constraint);
    row.coordinate = hinge.getHingeAngle();
    row.angular[1] = axis_of_hinge(hinge);
    row.angular[0] = -row.angular[1];
    return row;
  }
  // See DrivenSlider in drive.cpp.
  const auto &slider = static_cast<const btSliderConstraint &>(*joint.constraint);
  const btTransform joint_a = a * slider.getFrameOffsetA();
  const btVector3 point = b * slider.getFrameOffsetB().getOrigin(), axis = joint_a.getBasis().getColumn(0);
  row.coordinate = axis.dot(point - joint_a.getOrigin());
  row.linear[0] = -axis;
  row.linear[1] = axis;
  row.angular[0] = -(point - a.getOrigin()).cross(axis);
  row.angular[1] = (point - b.getOrigin()).cross(axis);
  return row;
}

bool AmbCoupling::moves(const AmbBody &body) const {
  const auto is_on_it = [&](const Term &term) { return &first_of(*term.joint) == &body || &second_of(*term.joint) == &body; };
  return std::any_of(terms.begin(), terms.end(), is_on_it);
}

AmbArticulation *AmbCoupling::articulation() const {
  AmbArticulation *const first = terms[0].joint->articulation;
  const auto is_of_it = [&](const Term &term) { return term.joint->articulation == first; };
  return std::all_of(terms.begin(), terms.end(), is_of_it) ? first : nullptr;
}

void AmbCoupling::follow_articulation(AmbWorld &world) {
  const bool wants_links = !articulation();
  if (wants_links == is_linked) return;
  is_linked = wants_links;
  for (const auto &link : links) {
    if (wants_links) {
      world.world->addConstraint(link.get());
    } else {
      world.world->removeConstraint(link.get());
    }
  }
  is_known = false;
}

void AmbCoupling::reset() {
  has_jumped = is_known = false;
  guess = 0;
  for (Term &term : terms) term.last = 0;
}

extern "C" {

AmbCoupling *amb_world_couple(AmbWorld *world, AmbConstraint *const *joints, const double *factors, int n, double offset) {
  auto *coupling = new AmbCoupling;
  coupling->terms.push_back({joints[0], 1});
  for (int i = 1; i < n; ++i) coupling->terms.push_back({joints[i], -factors[i]});
  coupling->offset = offset;
  const std::vector<btRigidBody *> bodies = bodies_of(*coupling);
  for (size_t i = 1; i < bodies.size() && (i == 1 || bodies[i]->getInvMass() > 0); ++i) {
    coupling->links.push_back(std::make_unique<CouplingLink>(*coupling, *bodies[i - 1], *bodies[i]));
  }
  engine_of(*world).couplings.push_back(coupling);
  coupling->follow_articulation(*world);
  return coupling;
}

void amb_world_uncouple(AmbWorld *world, AmbCoupling *coupling) {
  for (const auto &link : coupling->links) {
    if (coupling->is_linked) world->world->removeConstraint(link.get());
  }
  auto &couplings = engine_of(*world).couplings;
  couplings.erase(std::find(couplings.begin(), couplings.end(), coupling));
  delete coupling;
}

double amb_coupling_error(const AmbCoupling *coupling) {
  const size_t n = coupling->terms.size();
  Vector<btScalar> q(n);
  const auto coordinate = [&](size_t i) -> btScalar & { return q[i]; };
  if (AmbArticulation *const articulation = coupling->articulation()) {
    for (size_t i = 0; i < n; ++i) q[i] = articulation->coordinate(*coupling->terms[i].joint);
    return q[0] - coupling->wanted(coordinate);
  }
  for (size_t i = 0; i < n; ++i) q[i] = coordinate_row(*coupling->terms[i].joint).coordinate;
  // Of a copy: a look from outside changes nothing.
  AmbCoupling look;
  look.terms = coupling->terms;
  look.offset = coupling->offset;
  return look.complete(coordinate, coupling->has_jumped);
}

}  // extern "C"
