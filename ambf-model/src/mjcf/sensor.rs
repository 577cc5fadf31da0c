//! Section `sensor`: those that are sensors here, too.

use nalgebra::Vector3;

use super::body::Bodies;
use super::convert::{body_identifier, common};
use super::settings::finish;
use super::source::Source;
use crate::adf::{Model, ProblemKind, Ray, RaySource, Sensor, SensorKind, Severity};
use crate::xml::{quoted, Element};

/// Reach of a range finder without a cut-off, m.
const REACH: f64 = 10.0;

/// Adds the sensors of a description.
pub(super) fn add<'a>(model: &mut Model, sections: &[Element<'a>], source: &Source<'a>, bodies: &Bodies<'a>) {
    for (number, element) in sections.iter().flat_map(|section| source.elements(section)).enumerate() {
        let is_touch = element.tag() == "touch";
        if !is_touch && element.tag() != "rangefinder" {
            let why = "states of bodies, joints and contacts say it";
            element.problem(Severity::Info, ProblemKind::IgnoredKey, "", "", "", why);
            continue;
        }
        let unused = [("readings are what they are", &["noise", "user", "nsample", "interp", "delay", "interval"][..])];
        finish(&element, &["name", "site", "cutoff", "data", "camera"], &unused, &[]);
        let site = element.attribute("site").unwrap_or_default();
        let Some(place) = bodies.sites.get(site) else {
            let expected = "the name of a site";
            element.error(ProblemKind::UnknownValue, "site", &quoted(site), expected, "the sensor is left out");
            continue;
        };
        if place.body == 0 {
            let found = "is a site of the world";
            element.error(ProblemKind::Structure, "site", found, "a site of a body", "the sensor is left out");
            continue;
        }
        let name = element.attribute("name").map_or_else(|| format!("{}{number}", element.tag()), str::to_owned);
        let cutoff = element.real("cutoff").filter(|cutoff| *cutoff > 0.0 && !is_touch);
        model.sensors.push(Sensor {
            common: common(&format!("SENSOR {name}"), &name, &model.namespace, element.source()),
            kind: match is_touch {
                // All that touches the body, not only the site.
                true => SensorKind::Contact { threshold: 0.0, details: true },
                false => SensorKind::Proximity,
            },
            parent: body_identifier(&bodies.all[place.body].name),
            location: place.pose,
            range: cutoff.unwrap_or(REACH),
            visible: false,
            visible_size: 0.02,
            rays: match is_touch {
                true => RaySource::Array(Vec::new()),
                false => RaySource::Array(vec![Ray { offset: Vector3::zeros(), direction: Vector3::z() }]),
            },
        });
    }
}
