use ambf_dynamics::ffi as sys;

use super::World;

/// Where the mechanical energy of a [`World`] comes from and goes, all in J.
///
/// The first three are energies after the last sub-step. All others are sums of work since the ledger was switched on: positive where
/// the world gained energy. The change of the three energies is the sum of all works and [`unexplained`](Self::unexplained).
///
/// Soft bodies are left out; what they do to rigid bodies is in [`outside`](Self::outside).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EnergyLedger {
    /// Kinetic energy of all dynamic bodies. Where Bullet's leapfrog moves a body its velocity is that of half a sub-step before the pose;
    /// potential and elastic energy are then taken at that time too.
    pub kinetic: f64,
    /// Potential energy of the bodies' gravity, against that when the ledger was switched on.
    pub potential: f64,
    /// Elastic energy of springs, in articulations and as constraints.
    pub elastic: f64,
    /// Velocities and poses that were set, bodies and constraints that came or went, gravity that was changed.
    pub set_states: f64,
    /// Work of forces and torques that were applied to bodies: by commands, joint efforts, resistance sensors, devices and plugins.
    pub wrenches: f64,
    /// Work of motors and drives of joints, controllers included.
    pub motors: f64,
    /// Work of drives of bodies: pose controllers of the profile `accurate`.
    pub body_drives: f64,
    /// Work of the damping of bodies and of springs.
    pub damping: f64,
    /// Work of rows that hold joints. It vanishes with the sub-step.
    pub joints: f64,
    /// Work of limits of joints.
    pub limits: f64,
    /// Work of normal impulses: what impacts take.
    pub contacts: f64,
    /// Work of friction of contacts.
    pub friction: f64,
    /// Change of energy by pseudo-velocities that correct positions, and by continuous collision detection, which shortens ways.
    pub corrections: f64,
    /// Work of impulses outside the solver: wheels of vehicles, soft bodies.
    pub outside: f64,
    /// Change of energy that nothing above explains: error of the integration.
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
    /// Switches the energy ledger on, with all sums at 0, or off. Default: off; it costs one branch a sub-step then. The motion is the
    /// same to the last bit either way. The ledger is part of what [`save`](World::save) saves.
    pub fn set_energy_ledger(&mut self, enabled: bool) {
        let _arena = self.enter();
        // SAFETY: the world is alive and was made with the engine.
        unsafe { sys::amb_world_set_energy_ledger(self.raw.as_ptr(), enabled.into()) }
    }

    /// The energy ledger after the last sub-step; all 0 while it is off.
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
