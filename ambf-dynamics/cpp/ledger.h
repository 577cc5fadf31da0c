// The energy ledger of a world, see energy.h. C++ only.
//
// Bullet moves a body by x += v h after its velocity has changed: velocities belong to the time halfway between two
// poses (leapfrog method), and the conserved energy does too. The ledger evaluates the energy of such a body half a
// sub-step before its pose, `pose_lead` = h / 2; the work of a force F is then exactly F h times the mean of the
// velocities before and after. Bodies with exact integration and articulations have pose and velocity of the same time,
// `pose_lead` = 0. When a body changes from one to the other its potential energy changes by F v h / 2. Contacts cause
// this change, so it is added to their work.
#ifndef AMB_LEDGER_H
#define AMB_LEDGER_H

#include "arena_memory.h"
#include "articulation_tree.h"

#include <btBulletDynamicsCommon.h>

extern "C" {
#include "energy.h"
}

struct AmbBody;
class EngineWorld;

// The sum to which the work of a row is added. The work of a spring is that of its elastic energy and its damping.
enum class WorkKind { Ignored, Motor, BodyDrive, Damping, Joint, Limit, Contact, Friction };

struct MechanicalEnergy {
  double kinetic = 0, potential = 0, elastic = 0;

  double total() const { return kinetic + potential + elastic; }
  void operator+=(const MechanicalEnergy &other) {
    kinetic += other.kinetic;
    potential += other.potential;
    elastic += other.elastic;
  }
};

class EnergyLedger {
 public:
  void start(EngineWorld &engine);
  void stop() { enabled = false; }
  AmbEnergy read() const;

  // Called before and after a sub-step of h s; after_motion is called after the integration of poses, before vehicles
  // and soft bodies change velocities.
  void before_sub_step(EngineWorld &engine, double h);
  void after_motion(EngineWorld &engine);
  void after_sub_step(EngineWorld &engine, double h);

  void book(WorkKind kind, double work) {
    switch (kind) {
      case WorkKind::Ignored: break;
      case WorkKind::Motor: sums.motors += work; break;
      case WorkKind::BodyDrive: sums.body_drives += work; break;
      case WorkKind::Damping: sums.damping += work; break;
      case WorkKind::Joint: sums.joints += work; break;
      case WorkKind::Limit: sums.limits += work; break;
      case WorkKind::Contact: sums.contacts += work; break;
      case WorkKind::Friction: sums.friction += work; break;
    }
  }

  // Takes over the works of an articulation, which become 0.
  void take(Tree::Sums &of) {
    sums.set_states += of.set_states;
    sums.corrections += of.corrections;
    sums.contacts += of.contacts;
    sums.wrenches += of.wrenches;
    sums.damping += of.damping;
    sums.motors += of.motors;
    sums.limits += of.limits;
    of = {};
  }

  bool enabled = false;
  AmbEnergy sums{};

 private:
  // A spring constraint between bodies that are not links: its coordinates at the last two poses, m and rad.
  struct SpringState {
    const btTypedConstraint *spring = nullptr;
    double before[6] = {}, now[6] = {};

    // A rotation vector changes its sign at an angle of pi, for the same orientation: the earlier coordinates are given
    // the new sign.
    void keep_sign(double x, double y, double z) {
      if (now[3] * x + now[4] * y + now[5] * z > -1) return;
      for (int k = 3; k < 6; ++k) {
        before[k] = -before[k];
        now[k] = -now[k];
      }
    }
  };

  MechanicalEnergy free_bodies(EngineWorld &engine) const;
  MechanicalEnergy articulations(EngineWorld &engine) const;
  double springs(double h);
  void update_spring_states(EngineWorld &engine);
  void account(EngineWorld &engine, AmbBody &owner, double h);

  // Spring constraints are implicit: damped by the velocity after the sub-step. Bullet's are damped by the velocity
  // before.
  bool implicit_springs = false;
  // Energies after the last sub-step.
  MechanicalEnergy last;
  double start_total = 0, start_potential = 0;
  Vector<SpringState> spring_states;
};

#endif
