//! Ghost objects: sensing volumes that damp what overlaps them.

use nalgebra::Isometry3;

use super::common::Common;
use super::geometry::{CollisionGeometry, Visual};
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::Base;

/// A ghost object as written.
#[derive(Clone, Debug, PartialEq)]
pub struct GhostObject {
    /// Identity and plugins.
    pub common: Common,
    /// Name of the parent object; empty: the world.
    pub parent: String,
    /// Pose in the parent's body frame, or in the world. Default: identity.
    pub location: Isometry3<f64>,
    /// Uniform scale of the meshes; positive. Default: 1.
    pub scale: f64,
    /// Appearance.
    pub visual: Visual,
    /// The volume; never `None`. The offset of a single primitive is filled in (`collision offset`, else `inertial
    /// offset`, else identity).
    pub collision: CollisionGeometry,
    /// Collision margin, m, not negative. Default: 0.001.
    pub collision_margin: f64,
    /// Collision groups, each 0 to 999, in file order.
    pub collision_groups: Vec<u32>,
}

impl GhostObject {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let visual = Visual::read(map, base);
        let mut collision = CollisionGeometry::read(map, base);
        let inertial_offset = map.pose("inertial offset").unwrap_or_default();
        match &mut collision {
            CollisionGeometry::None => {
                let expected = "a collision shape or mesh";
                map.reject(ProblemKind::MissingKey, "collision geometry", expected);
            }
            CollisionGeometry::Primitive { offset, .. } => {
                offset.get_or_insert(inertial_offset);
            }
            CollisionGeometry::Compound(_) | CollisionGeometry::Mesh { .. } | CollisionGeometry::Parts { .. } => {}
        }
        let ghost = Self {
            common: map.common(base),
            parent: map.filled("parent").unwrap_or_default(),
            location: map.pose("location").unwrap_or_default(),
            scale: map.scale(),
            visual,
            collision,
            collision_margin: map.real_in("collision margin", Range::NotNegative).unwrap_or(0.001),
            collision_groups: map.collision_groups(),
        };
        map.finish();
        Some(ghost)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::super::Model;
    use super::*;

    #[test]
    fn the_offset_falls_back_to_the_inertial_offset() {
        let text = "ghost objects: [G]\nG: {parent: A, collision shape: Sphere, collision geometry: {radius: 1}, \
                    inertial offset: {position: {x: 1, y: 2, z: 3}}}\n";
        let ghost = clean::<Model>(text).ghosts.remove(0);
        assert_eq!(ghost.parent, "A");
        let CollisionGeometry::Primitive { offset, .. } = ghost.collision else { panic!() };
        assert_eq!(offset, Some(Isometry3::translation(1.0, 2.0, 3.0)));
    }

    #[test]
    fn no_volume_no_ghost() {
        let (model, problems) = read::<Model>("ghost objects: [G]\nG: {name: g}\n");
        assert!(model.ghosts.is_empty());
        assert!(problems[0].contains("the ghost object is dropped"));
    }
}
