//! Contact points of a world, as numbers.

use ambf_core::ids::BodyId;
use ambf_core::sim::Stepper;

/// For each contact point of a world calls `between` with its two bodies and appends 12 numbers: point, m, normal, distance, m, normal
/// force, N, force of friction on the first body, N, coefficient of friction.
pub fn gather(stepper: &Stepper, numbers: &mut Vec<f64>, mut between: impl FnMut(BodyId, BodyId)) {
    let simulation = stepper.simulation();
    let scene = simulation.scene();
    let per_second = 1.0 / simulation.sub_step();
    for (body, contact) in scene.world.contact_points() {
        let found = [body, contact.other].map(|handle| scene.bodies.id_of(handle));
        let [Some(first), Some(second)] = found else { continue };
        between(first, second);
        numbers.extend(contact.point.iter().chain(contact.normal.iter()));
        numbers.extend([contact.distance, contact.impulse * per_second]);
        numbers.extend((contact.friction * per_second).iter());
        numbers.push(contact.friction_coefficient);
    }
}
