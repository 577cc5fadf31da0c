//! Section `contact`: which bodies never collide, and which geoms do although their bodies would not.

use super::body::Bodies;
use super::convert::clusters;
use super::geom::Geom;
use super::settings::{finish, SOFT};
use super::source::Source;
use crate::adf::{ProblemKind, Severity};
use crate::xml::{quoted, Element};

/// A geom: its body, and its place among the geoms of that.
pub(super) type Place = (usize, usize);

/// Exceptions from what masks, joints and parents say.
#[derive(Default)]
pub(super) struct Exceptions {
    /// Pairs of bodies, by index, that never collide.
    pub excluded: Vec<(usize, usize)>,
    /// Pairs of geoms whose bodies collide.
    pub pairs: Vec<[Place; 2]>,
}

/// Reads the sections. Geoms of pairs that have no masks collide from now on, if they can alone.
pub(super) fn read<'a>(sections: &[Element<'a>], source: &Source<'a>, bodies: &mut Bodies<'a>) -> Exceptions {
    let clusters = clusters(&bodies.all);
    let masked = Counts::of(bodies, |geom| geom.has_masks());
    let mut exceptions = Exceptions::default();
    let mut paired = Vec::new();
    for section in sections {
        finish(section, &[], &[], &["pair", "exclude"]);
        for element in source.elements(section) {
            if element.tag() == "exclude" {
                exceptions.excluded.extend(excluded(&element, bodies));
            } else if element.tag() == "pair" {
                if let Some(places) = pair(&element, bodies, &clusters, &masked) {
                    exceptions.pairs.push(places);
                    paired.push(element);
                }
            }
        }
    }
    for (body, geom) in exceptions.pairs.iter().flatten() {
        bodies.all[*body].geoms[*geom].is_paired = true;
    }
    let colliding = Counts::of(bodies, |geom| geom.collides());
    for (element, places) in paired.iter().zip(&exceptions.pairs) {
        // Filters are those of bodies.
        if places.iter().any(|&place| colliding.has_others(bodies, place)) {
            let action = "all geoms of both bodies collide with each other";
            element.problem(Severity::Info, ProblemKind::IgnoredKey, "", "", "", action);
        }
    }
    exceptions
}

fn excluded(element: &Element<'_>, bodies: &Bodies<'_>) -> Option<(usize, usize)> {
    finish(element, &["name", "body1", "body2"], &[], &[]);
    let body = |key: &'static str| {
        let name = element.need(key, "the name of a body");
        let found = bodies.by_name.get(name).copied();
        if found.is_none() && !name.is_empty() {
            let expected = "the name of a body";
            element.error(ProblemKind::UnknownValue, key, &quoted(name), expected, "the pair is not excluded");
        }
        found
    };
    body("body1").zip(body("body2"))
}

/// The geoms of a pair; `None`, reported, if they cannot be made to collide.
fn pair(element: &Element<'_>, bodies: &Bodies<'_>, clusters: &[usize], masked: &Counts) -> Option<[Place; 2]> {
    finish_pair(element);
    let left_out = "the pair is left out";
    let geom = |key: &'static str| {
        let name = element.need(key, "the name of a geom");
        let found = bodies.geoms.get(name).copied();
        if found.is_none() && !name.is_empty() {
            let expected = "the name of a geom that is there";
            element.error(ProblemKind::UnknownValue, key, &quoted(name), expected, left_out);
        }
        found
    };
    let (a, b) = geom("geom1").zip(geom("geom2"))?;
    if clusters[a.0] == clusters[b.0] {
        let action = "what is fixed to each other does not collide";
        element.problem(Severity::Info, ProblemKind::IgnoredKey, "", "", "", action);
        return None;
    }
    for (key, place) in [("geom1", a), ("geom2", b)] {
        if !bodies.all[place.0].geoms[place.1].has_masks() && masked.has_others(bodies, place) {
            let found = "has neither contype nor conaffinity, unlike other geoms of its body";
            let expected = "masks, or a body of its own";
            element.error(ProblemKind::Structure, key, found, expected, left_out);
            return None;
        }
    }
    Some([a, b])
}

/// Names what of a pair, or of the defaults of pairs, has no effect.
pub(super) fn finish_pair(element: &Element<'_>) {
    finish(element, &["name", "class", "geom1", "geom2", "condim", "friction", "adhesion"], &[SOFT], &[]);
    for name in ["condim", "friction", "adhesion"] {
        if element.attribute(name).is_some() {
            element.ignored(name, "the contact has the friction of both bodies");
        }
    }
}

/// Of each body how many of the geoms that are one body here have a property.
struct Counts(Vec<usize>, fn(&Geom<'_>) -> bool);

impl Counts {
    fn of(bodies: &Bodies<'_>, has: fn(&Geom<'_>) -> bool) -> Self {
        let count = |geoms: &[Geom<'_>]| geoms.iter().filter(|geom| !geom.is_apart() && has(geom)).count();
        Self(bodies.all.iter().map(|body| count(&body.geoms)).collect(), has)
    }

    /// Whether a geom is one body with others that have it.
    fn has_others(&self, bodies: &Bodies<'_>, (body, geom): Place) -> bool {
        let own = &bodies.all[body].geoms[geom];
        !own.is_apart() && self.0[body] > usize::from((self.1)(own))
    }
}
