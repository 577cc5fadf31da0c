//! Configurations of the C++ simulator's CRTK plugin: what was asked for of bodies and joints becomes one arm a name
//! space.

use std::collections::BTreeMap;

use ambf_model::adf::Entry;
use nalgebra::Isometry3;

use super::read::Map;
use super::{check_names, ArmConfig, ClockKind, ConfigError, IkKind, Kind, ToolConfig};
use crate::arm::{Dialect, OnLimit};
use crate::kinematics::MAX_JOINTS;

/// Lists of bodies.
const BODIES: [&str; 5] = ["measured_cp", "setpoint_cp", "servo_cp", "measured_cf", "servo_cf"];

/// Lists of joints; older files have a mapping instead of a list.
const JOINTS: [&str; 3] = ["measured_js", "setpoint_js", "servo_jp"];

/// What a name space was given.
#[derive(Default)]
struct Asked {
    body: Option<String>,
    reference: Option<String>,
    joints: Vec<String>,
}

/// Reads a configuration from its root.
pub(super) fn read(root: Entry<'_>) -> Result<Vec<ArmConfig>, ConfigError> {
    let map = Map::new(root);
    let interfaces = map.texts("interface")?.unwrap_or_default();
    let mut arms = Vec::new();
    for interface in &interfaces {
        let entry = root.get(interface).ok_or_else(|| map.missing(interface, "what the interface offers"))?;
        let mut asked: BTreeMap<String, Asked> = BTreeMap::new();
        for key in BODIES.iter().chain(&JOINTS) {
            let Some(list) = entry.get(key) else { continue };
            let items: Vec<Entry<'_>> = list.items().collect();
            // A mapping stands for a list of one.
            let items = if items.is_empty() { vec![list] } else { items };
            for item in items {
                take(interface, item, &mut asked)?;
            }
        }
        arms.extend(asked.into_iter().map(|(space, asked)| arm(space, asked, entry)));
    }
    check_names(&arms)?;
    Ok(arms)
}

fn take(interface: &str, item: Entry<'_>, asked: &mut BTreeMap<String, Asked>) -> Result<(), ConfigError> {
    let map = Map::new(item);
    let body = map.text("rigidbody").or_else(|| map.text("body"));
    let space = map.text("namespace").map_or_else(|| default_space(interface, body), clean);
    let asked = asked.entry(space).or_default();
    if let Some(body) = body {
        asked.body.get_or_insert_with(|| body.to_owned());
    }
    if let Some(reference) = map.text("reference") {
        asked.reference.get_or_insert_with(|| reference.to_owned());
    }
    if let Some(joints) = map.texts("joints")? {
        if joints.len() > MAX_JOINTS {
            return Err(map.wrong("joints", &format!("at most {MAX_JOINTS} joints")));
        }
        if asked.joints.is_empty() {
            asked.joints = joints;
        }
    }
    Ok(())
}

/// A name of a topic of what a file says.
fn clean(text: &str) -> String {
    let word = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '_' };
    let parts = text.split('/').filter(|part| !part.trim().is_empty());
    let part = |part: &str| {
        let part: String = part.trim().chars().map(word).collect();
        if part.starts_with(|c: char| c.is_ascii_alphabetic()) {
            part
        } else {
            format!("_{part}")
        }
    };
    parts.map(|text| format!("/{}", part(text))).collect()
}

fn default_space(interface: &str, body: Option<&str>) -> String {
    let body = body.unwrap_or("");
    let last = body.rsplit('/').next().unwrap_or(body).trim_start_matches("BODY ");
    clean(&format!("{interface}/{last}"))
}

fn arm(space: String, asked: Asked, entry: Entry<'_>) -> ArmConfig {
    let Asked { body, reference, joints } = asked;
    let count = joints.len();
    let tool =
        body.map(|body| ToolConfig { body: Some(body), offset: Isometry3::identity(), tip: 0.0, instrument: None });
    ArmConfig {
        name: space.trim_start_matches('/').replace('/', "_"),
        space,
        kind: if joints.is_empty() { Kind::Object } else { Kind::Generic },
        dialect: Dialect::Plugin,
        base: None,
        names: joints.iter().map(|joint| super::wire_name(joint)).collect(),
        joints,
        coupling: Vec::new(),
        jaw: None,
        grasp: None,
        errors: Vec::new(),
        socket: None,
        also: Vec::new(),
        body: None,
        ik: if tool.is_some() { IkKind::Dls } else { IkKind::None },
        tool,
        reference: reference.unwrap_or_else(|| "world".into()),
        limits: None,
        on_limit: OnLimit::Clamp,
        speeds: vec![1.0; count],
        accelerations: vec![5.0; count],
        efforts: None,
        home: None,
        rate: 100.0,
        clock: ClockKind::Wall,
        extras: false,
        source: entry.source(),
    }
}
