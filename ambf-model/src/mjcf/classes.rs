//! Section `default`: what elements of a class have unless they say otherwise.

use std::collections::HashMap;

use super::actuator::ActuatorText;
use super::asset::{MaterialText, MeshText};
use super::contact::finish_pair;
use super::geom::GeomText;
use super::joint::JointText;
use super::relation::TendonText;
use super::settings::{choice, finish, Compiler, BOOLEANS, SOFT};
use super::source::Source;
use super::view::LightText;
use crate::adf::{ProblemKind, Severity};
use crate::xml::{quoted, Element};

/// Most classes of a description.
const MAX_CLASSES: usize = 10_000;

/// Elements that have defaults here.
const KINDS: [&str; 29] = [
    "mesh",
    "material",
    "texture",
    "joint",
    "geom",
    "site",
    "camera",
    "light",
    "pair",
    "equality",
    "tendon",
    "general",
    "motor",
    "position",
    "velocity",
    "intvelocity",
    "orientation",
    "pid",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
    "dcmotor",
    "default",
    "plugin",
    "include",
    "skin",
    "flex",
    "body",
];

/// What the elements of a class have.
#[derive(Debug, Clone)]
pub(super) struct Class<'a> {
    pub joint: JointText,
    pub geom: GeomText<'a>,
    pub mesh: MeshText,
    pub material: MaterialText,
    pub actuator: ActuatorText,
    pub tendon: TendonText,
    /// Equalities act from the start on.
    pub is_active: bool,
    pub fov: Option<f64>,
    pub light: LightText,
}

impl Default for Class<'_> {
    fn default() -> Self {
        Self {
            joint: JointText::default(),
            geom: GeomText::default(),
            mesh: MeshText::default(),
            material: MaterialText::default(),
            actuator: ActuatorText::default(),
            tendon: TendonText::default(),
            is_active: true,
            fov: None,
            light: LightText::default(),
        }
    }
}

/// All classes.
pub(super) struct Classes<'a> {
    /// The class without a name.
    main: Class<'a>,
    by_name: HashMap<&'a str, Class<'a>>,
}

impl<'a> Classes<'a> {
    pub fn read(sections: &[Element<'a>], source: &Source<'a>, compiler: &Compiler) -> Self {
        let mut classes = Self { main: Class::default(), by_name: HashMap::new() };
        // The main class first, wherever it is continued; then those inside, each with what the one around it has.
        for section in sections {
            let mut main = std::mem::take(&mut classes.main);
            main.apply(section, source, compiler);
            classes.main = main;
        }
        let mut waiting = Vec::new();
        for section in sections {
            if let Some(name) = section.attribute("class") {
                classes.by_name.insert(name, classes.main.clone());
            }
            let inside = source.children(section, "default");
            waiting.extend(inside.into_iter().rev().map(|element| (element, None)));
        }
        waiting.reverse();
        while let Some((element, outer)) = waiting.pop() {
            let name = element.need_name("class", "the name of a class");
            let mut class = match outer {
                Some(outer) => classes.by_name.get(outer).cloned().unwrap_or_default(),
                None => classes.main.clone(),
            };
            class.apply(&element, source, compiler);
            if classes.by_name.len() >= MAX_CLASSES {
                let (found, expected) = ("one class too many", format!("at most {MAX_CLASSES}"));
                element.problem(Severity::Fatal, ProblemKind::OutOfRange, "class", found, &expected, "");
                break;
            }
            if classes.by_name.insert(name, class).is_some() {
                element.error(ProblemKind::DuplicateKey, "class", "", "", "the last one counts");
            }
            waiting.extend(source.children(&element, "default").into_iter().rev().map(|element| (element, Some(name))));
        }
        classes
    }

    /// The class of an element: its own, or that which a body around it gives its children, or the main one.
    pub fn of(&self, element: &Element<'a>, child_class: Option<&'a str>) -> &Class<'a> {
        let own = element.attribute("class");
        let Some(name) = own.or(child_class) else { return &self.main };
        self.by_name.get(name).unwrap_or_else(|| {
            // That of a body was reported there.
            if own.is_some() && name != "main" {
                self.unknown(element, "class", name);
            }
            &self.main
        })
    }

    /// Whether an equality acts from the start on; one that does not is reported.
    pub fn is_active(&self, equality: &Element<'a>) -> bool {
        let is_active = choice(equality, "active", &BOOLEANS).unwrap_or(self.of(equality, None).is_active);
        if !is_active {
            equality.ignored("", "it is not active, and cannot be activated");
        }
        is_active
    }

    /// Names a class that is not there.
    pub fn check(&self, element: &Element<'a>, key: &'static str) {
        if let Some(name) = element.attribute(key).filter(|name| *name != "main" && !self.by_name.contains_key(name)) {
            self.unknown(element, key, name);
        }
    }

    fn unknown(&self, element: &Element<'a>, key: &str, name: &str) {
        let expected = "the name of a class in `default`";
        element.error(ProblemKind::UnknownValue, key, &quoted(name), expected, "the main class is used");
    }
}

impl<'a> Class<'a> {
    fn apply(&mut self, section: &Element<'a>, source: &Source<'a>, compiler: &Compiler) {
        finish(section, &["class"], &[], &KINDS);
        for element in source.elements(section) {
            match element.tag() {
                "joint" => self.joint.apply(&element),
                "geom" => self.geom.apply(&element, compiler),
                "mesh" => self.mesh.apply(&element),
                "material" => self.material.apply(&element),
                "camera" => self.fov = element.real("fovy").or(self.fov),
                "light" => self.light.apply(&element),
                "tendon" => self.tendon.apply(&element),
                "pair" => finish_pair(&element),
                "equality" => {
                    finish(&element, &["active"], &[SOFT], &[]);
                    self.is_active = choice(&element, "active", &BOOLEANS).unwrap_or(self.is_active);
                }
                tag if ActuatorText::is_kind(tag) => self.actuator.apply(&element),
                // Nothing of these is used that could have a default.
                _ => (),
            }
        }
    }
}
