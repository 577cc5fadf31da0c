//! Links as written.

use super::geometry::{collisions, visuals, Materials};
use super::inertia::Inertial;
use super::package::Packages;
use crate::adf::{Part, VisualPart};
use crate::xml::Element;

/// A link as written.
pub(super) struct Link<'a> {
    pub name: &'a str,
    pub element: Element<'a>,
    /// `None`: no mass.
    pub inertial: Option<Inertial>,
    /// In the link frame.
    pub collisions: Vec<Part>,
    /// In the link frame.
    pub visuals: Vec<VisualPart>,
}

impl<'a> Link<'a> {
    pub fn read(element: Element<'a>, packages: &Packages, materials: &Materials<'a>) -> Self {
        element.finish(&["name"], &["inertial", "visual", "collision"]);
        Self {
            name: element.need_name("name", "a name"),
            element,
            inertial: Inertial::read(&element),
            collisions: collisions(&element, packages),
            visuals: visuals(&element, packages, materials),
        }
    }
}
