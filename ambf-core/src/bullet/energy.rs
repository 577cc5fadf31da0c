use ambf_dynamics::ffi as sys;

use super::World;

/// Balance of the mechanical energy of a [`World`], all in J.
///
/// The first three are energies after the last sub-step. All others are works since the ledger was enabled, positive
/// where the world gained energy. The change of the three energies is the sum of all works and
/// [`unexplained`](Self::unexplained).
///
/// Soft bodies are not included; the work of their impulses on rigid bodies is in [`outside`](Self::outside).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EnergyLedger {
    /// Kinetic energy of all dynamic bodies. The velocity of a body that Bullet's leapfrog method moves is that of half
    /// a sub-step before its pose; its potential and elastic energy are then evaluated at that time too.
    pub kinetic: f64,
    /// Potential energy of the bodies in gravity, relative to that when the ledger was enabled.
    pub potential: f64,
    /// Elastic energy of springs, in articulations and as constraints.
    pub elastic: f64,
    /// Change of energy by setting velocities, poses or gravity, and by adding or removing bodies and constraints.
    pub set_states: f64,
    /// Work of forces and torques that were applied to bodies: by commands, joint efforts, resistance sensors, devices
    /// and plugins.
    pub wrenches: f64,
    /// Work of motors and drives of joints, controllers included.
    pub motors: f64,
    /// Work of drives of bodies: pose controllers of the profile `accurate`.
    pub body_drives: f64,
    /// Work of the damping of bodies and of springs.
    pub damping: f64,
    /// Work of joint constraints. It converges to 0 with the sub-step.
    pub joints: f64,
    /// Work of limits of joints.
    pub limits: f64,
    /// Work of normal impulses of contacts, such as the energy dissipated in impacts.
    pub contacts: f64,
    /// Work of friction of contacts.
    pub friction: f64,
    /// Change of energy by pseudo-velocities that correct positions, and by continuous collision detection, which
    /// shortens displacements.
    pub corrections: f64,
    /// Work of impulses outside the solver: wheels of vehicles, soft bodies.
    pub outside: f64,
    /// Change of energy minus all works above: error of the integration.
    pub unexplained: f64,
}

impl EnergyLedger {
    /// Names of the numbers in the order of [`values`](Self::values), each with its unit.
    pub const NAMES: [&'static str; 15] = [
        "kinetic_J",
        "potential_J",
        "elastic_J",
        "set_states_J",
        "wrenches_J",
        "motors_J",
        "body_drives_J",
        "damping_J",
        "joints_J",
        "limits_J",
        "contacts_J",
        "friction_J",
        "corrections_J",
        "outside_J",
        "unexplained_J",
    ];

    /// The numbers in the order of their declaration.
    pub fn values(&self) -> [f64; 15] {
        [
            self.kinetic,
            self.potential,
            self.elastic,
            self.set_states,
            self.wrenches,
            self.motors,
            self.body_drives,
            self.damping,
            self.joints,
            self.limits,
            self.contacts,
            self.friction,
            self.corrections,
            self.outside,
            self.unexplained,
        ]
    }

    /// Kinetic, potential and elastic energy, J.
    pub fn total(&self) -> f64 {
        self.kinetic + self.potential + self.elastic
    }
}

impl World {
    /// Enables the energy ledger, with all works at 0, or disables it. Default: disabled, which costs one branch a
    /// sub-step. It does not change the motion by a bit. [`save`](World::save) saves the ledger too.
    pub fn set_energy_ledger(&mut self, enabled: bool) {
        let _arena = self.enter();
        // SAFETY: the world is alive and was made with the engine.
        unsafe { sys::amb_world_set_energy_ledger(self.raw.as_ptr(), enabled.into()) }
    }

    /// The energy ledger after the last sub-step; all 0 while it is disabled.
    pub fn energy(&self) -> EnergyLedger {
        let mut raw = sys::AmbEnergy::default();
        // SAFETY: the world is alive and was made with the engine; the struct is written before the call returns.
        unsafe { sys::amb_world_energy(self.raw.as_ptr(), &mut raw) }
        EnergyLedger {
            kinetic: raw.kinetic,
            potential: raw.potential,
            elastic: raw.elastic,
            set_states: raw.set_states,
            wrenches: raw.wrenches,
            motors: raw.motors,
            body_drives: raw.body_drives,
            damping: raw.damping,
            joints: raw.joints,
            limits: raw.limits,
            contacts: raw.contacts,
            friction: raw.friction,
            corrections: raw.corrections,
            outside: raw.outside,
            unexplained: raw.unexplained,
        }
    }
}
