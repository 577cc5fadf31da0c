// The energy ledger of a world, see energy.h. C++ only.
//
// Bullet moves a body by x += v h after its velocity has changed: velocities are those between two poses (leapfrog method), and so is the
// energy that is conserved. The ledger evaluates the energy of such a body half a sub-step before its pose, `ahead` = h / 2; work of a
// force F is then F h times the mean of the velocities before and after, exactly. Bodies in exact flight and articulations that
// integrate their motion have pose and velocity of one instant, `ahead` = 0. Between the two the potential energy changes by F v h / 2, which
// is booked where the change comes from: under contacts.
#ifndef AMB_LEDGER_H
#define AMB_LEDGER_H

#include "arena_memory.h"

#include <btBulletDynamicsCommon.h>

extern "C" {
#include "energy.h"
}

struct AmbBody;
class EngineWorld;

// Where a row's work is booked. A spring's is what its elastic energy loses, and its damping.
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

  // Around a sub-step of h s, and between the integration of poses and what else changes velocities.
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

  bool enabled = false;
  AmbEnergy sums{};

 private:
  // A spring between bodies that are no links: its coordinates at the last two poses, m and rad.
  struct SpringState {
    const btTypedConstraint *spring = nullptr;
    double before[6] = {}, now[6] = {};

    // A rotation vector that has changed its sign at pi is the same orientation: the earlier ones follow.
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

  // Springs between bodies are damped by the velocity after the sub-step; Bullet's by that before.
  bool implicit_springs = false;
  // After the last sub-step.
  MechanicalEnergy last;
  double start_total = 0, start_potential = 0;
  Vector<SpringState> spring_states;
};

#endif
