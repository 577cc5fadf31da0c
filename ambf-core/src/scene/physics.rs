//! What users choose of the physics, by name, and what that stands for.

use crate::adf::{PhysicsProfile, PhysicsSettings};
use crate::bullet::{Gyroscopic, Integrator, Preset, Solver};
use crate::control::Profile;

/// How physics is solved; what is `None` comes from the world file, else from the profile.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PhysicsOptions {
    /// Legacy or accurate.
    pub profile: Option<Profile>,
    /// Settings of the solver and of shapes instead of the profile's. A `profile` here is without the preset of the
    /// world file.
    pub preset: Option<Preset>,
    /// Constraint solver.
    pub solver: Option<Solver>,
    /// Iterations of the solver.
    pub iterations: Option<u32>,
    /// How free bodies are moved.
    pub integrator: Option<Integrator>,
    /// Whether joints that form trees are put into reduced coordinates. Default: `true` in the accurate profile with
    /// its own solver.
    pub articulated: Option<bool>,
    /// Length of a sub-step, s.
    pub sub_step: Option<f64>,
    /// Whether bodies at rest sleep: no, unless asked for.
    pub sleep: Option<bool>,
    /// Share of the position error of joints that is corrected in a sub-step.
    pub joint_erp: Option<f64>,
    /// How the gyroscopic torque is integrated.
    pub gyroscopic: Option<Gyroscopic>,
    /// Whether bodies without mass that commands move have the velocity of their motion. Default: `false` in the legacy
    /// profile without preset, else `true`.
    pub kinematic_bodies: Option<bool>,
}

impl PhysicsOptions {
    /// What users chose. `unknown` is called with each name that stands for nothing, which then chooses nothing: what it
    /// should name, the name, and the names that are known.
    pub fn new(chosen: &PhysicsSettings, mut unknown: impl FnMut(&str, &str, &str)) -> Self {
        Self {
            profile: chosen.profile.map(|profile| match profile {
                PhysicsProfile::Legacy | PhysicsProfile::PyBullet => Profile::Legacy,
                PhysicsProfile::Accurate => Profile::Accurate,
            }),
            preset: (chosen.profile == Some(PhysicsProfile::PyBullet)).then_some(Preset::PyBullet),
            solver: named("solver", &chosen.solver, &Solver::NAMES, &mut unknown),
            iterations: chosen.iterations,
            integrator: named("integrator", &chosen.integrator, &Integrator::NAMES, &mut unknown),
            articulated: chosen.articulated,
            sub_step: chosen.sub_step,
            sleep: chosen.sleep,
            joint_erp: chosen.joint_erp,
            gyroscopic: named("gyroscopic", &chosen.gyroscopic, &Gyroscopic::NAMES, &mut unknown),
            kinematic_bodies: chosen.kinematic_bodies,
        }
    }

    /// These options; where there is none, that of `others`.
    pub(super) fn or(self, others: Self) -> Self {
        Self {
            profile: self.profile.or(others.profile),
            // A preset is that of its profile.
            preset: if self.profile.is_some() { self.preset } else { others.preset.or(self.preset) },
            solver: self.solver.or(others.solver),
            iterations: self.iterations.or(others.iterations),
            integrator: self.integrator.or(others.integrator),
            articulated: self.articulated.or(others.articulated),
            sub_step: self.sub_step.or(others.sub_step),
            sleep: self.sleep.or(others.sleep),
            joint_erp: self.joint_erp.or(others.joint_erp),
            gyroscopic: self.gyroscopic.or(others.gyroscopic),
            kinematic_bodies: self.kinematic_bodies.or(others.kinematic_bodies),
        }
    }
}

fn named<T: Copy>(
    what: &str,
    name: &Option<String>,
    known: &[(&str, T)],
    unknown: &mut impl FnMut(&str, &str, &str),
) -> Option<T> {
    let name = name.as_deref()?;
    let found = known.iter().find(|(known, _)| *known == name).map(|&(_, value)| value);
    if found.is_none() {
        let names: Vec<&str> = known.iter().map(|&(name, _)| name).collect();
        unknown(what, name, &names.join(", "));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_chooses_what_it_names() {
        let mut said = Vec::new();
        let mut of = |chosen: PhysicsSettings| {
            PhysicsOptions::new(&chosen, |what, name, known| said.push(format!("{what} {name} {known}")))
        };
        for (name, solver) in Solver::NAMES {
            let chosen = PhysicsSettings { solver: Some(name.into()), ..PhysicsSettings::default() };
            assert_eq!((of(chosen).solver, solver.name()), (Some(solver), name));
        }
        for (name, integrator) in Integrator::NAMES {
            let chosen = PhysicsSettings { integrator: Some(name.into()), ..PhysicsSettings::default() };
            assert_eq!((of(chosen).integrator, integrator.name()), (Some(integrator), name));
        }
        let chosen = PhysicsSettings { integrator: Some("best".into()), ..PhysicsSettings::default() };
        assert_eq!(of(chosen).integrator, None);
        assert_eq!(said, ["integrator best euler, ballistic, rk4"]);
    }

    #[test]
    fn a_profile_comes_with_its_preset() {
        let of = |profile| {
            let chosen = PhysicsSettings { profile: Some(profile), ..PhysicsSettings::default() };
            PhysicsOptions::new(&chosen, |_, _, _| ())
        };
        let [legacy, pybullet] = [PhysicsProfile::Legacy, PhysicsProfile::PyBullet].map(of);
        assert_eq!((pybullet.profile, pybullet.preset), (Some(Profile::Legacy), Some(Preset::PyBullet)));
        assert_eq!((legacy.or(pybullet), pybullet.or(legacy)), (legacy, pybullet));
        assert_eq!(PhysicsOptions::default().or(pybullet), pybullet);
    }
}
