//! What arms a file offers, and how: the configuration of this crate, the dVRK simulators' arm files, and that of the
//! C++ simulator's CRTK plugin.

mod cpp;
mod read;

use std::collections::BTreeSet;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;

use ambf_model::adf::{Entry, LoadError, Outline, SourcePos};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use thiserror::Error;

use crate::arm::{Dialect, OnLimit};
use crate::grasp::GraspConfig;
use crate::kinematics::{Limits, MAX_JOINTS};
use crate::seed::ScatterConfig;
use crate::socket::{SocketConfig, Style, Told};
use read::Map;

/// Why a configuration is of no use.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// Error when a file cannot be read or is not YAML.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// Error when a key that is needed is not there.
    #[error("{place}: `{key}` is missing, expected {expected}")]
    Missing {
        /// Where it should be.
        place: SourcePos,
        /// The key.
        key: String,
        /// What it should hold.
        expected: String,
    },
    /// Error when a value is of no use.
    #[error("{place}: `{key}` is `{got}`, expected {expected}")]
    Value {
        /// Where.
        place: SourcePos,
        /// The key.
        key: String,
        /// What is written there.
        got: String,
        /// What it should be.
        expected: String,
    },
    /// Error when a key is not known.
    #[error("{place}: `{key}` is not known, expected one of {known}")]
    Unknown {
        /// Where.
        place: SourcePos,
        /// The key.
        key: String,
        /// Those that are known.
        known: String,
    },
    /// Error when two entries have one name.
    #[error("{place}: there is another entry `{name}`")]
    Duplicate {
        /// Where the second one is.
        place: SourcePos,
        /// The name.
        name: String,
    },
    /// Error when a file has none of the keys that tell what it is.
    #[error("{place}: neither `crtk` (a list of arms) nor `interface` (configuration of the C++ plugin) is there")]
    Nothing {
        /// The file.
        place: SourcePos,
    },
}

/// What an entry is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Patient side manipulator.
    Psm,
    /// Endoscope manipulator.
    Ecm,
    /// Master.
    Mtm,
    /// Any other arm.
    Generic,
    /// A body whose pose is published.
    Object,
}

/// Inverse kinematics that is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IkKind {
    /// Closed form of a PSM.
    Psm,
    /// Closed form of an ECM.
    Ecm,
    /// Iteration.
    Dls,
    /// None.
    None,
}

/// Which time stamps are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClockKind {
    /// Since 1970.
    Wall,
    /// Simulated; `/clock` tells it.
    Sim,
}

/// A joint that moves with another: position = ratio · that + offset.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower {
    /// Its name.
    pub joint: String,
    /// Index of the joint that it follows, in the order of the arm.
    pub of: usize,
    /// Default: 1.
    pub ratio: f64,
    /// rad or m. Default: such that it is true when the arm is loaded.
    pub offset: Option<f64>,
    /// Whether it is commanded with that joint; else the scene moves it along. Default: `true`.
    pub is_driven: bool,
}

/// A jaw.
#[derive(Debug, Clone, PartialEq)]
pub struct JawConfig {
    /// Joints of the fingers: name, ratio, offset (rad).
    pub joints: Vec<(String, f64, f64)>,
    /// rad.
    pub limits: Limits,
    /// rad/s.
    pub speed: f64,
    /// At the start, rad.
    pub home: f64,
}

/// The control point.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolConfig {
    /// Body that it is on.
    pub body: Option<String>,
    /// The tool's frame in the body's frame; without a body, in the table's tool frame.
    pub offset: Isometry3<f64>,
    /// Control point in the tool's frame, along z, m.
    pub tip: f64,
    /// Number of the instrument.
    pub instrument: Option<String>,
}

/// Further topics of an arm, for clients that expect other names.
#[derive(Debug, Clone, PartialEq)]
pub struct AlsoConfig {
    /// Name.
    pub name: String,
    /// Beginning of its topics.
    pub space: String,
    /// How it speaks.
    pub dialect: Dialect,
    /// Names of the joints on the wire.
    pub names: Vec<String>,
    /// Publications a second.
    pub rate: f64,
}

/// An entry.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmConfig {
    /// Name.
    pub name: String,
    /// Beginning of its topics.
    pub space: String,
    /// What it is.
    pub kind: Kind,
    /// How it speaks.
    pub dialect: Dialect,
    /// Body that is its base; `None`: that from which its chain begins.
    pub base: Option<String>,
    /// Joints, in order.
    pub joints: Vec<String>,
    /// Their names on the wire.
    pub names: Vec<String>,
    /// Joints that move with others.
    pub coupling: Vec<Follower>,
    /// Jaw.
    pub jaw: Option<JawConfig>,
    /// Rules by which its jaw holds objects; `None`: friction alone does.
    pub grasp: Option<GraspConfig>,
    /// Control point; `None`: no Cartesian topics.
    pub tool: Option<ToolConfig>,
    /// Reference frame: `world`, `base`, `ARM_view` for another arm's control point, or a body.
    pub reference: String,
    /// Limits, a pair a joint; `None`: the scene's.
    pub limits: Option<Vec<Limits>>,
    /// What is done with targets beyond them.
    pub on_limit: OnLimit,
    /// rad/s or m/s.
    pub speeds: Vec<f64>,
    /// rad/s² or m/s².
    pub accelerations: Vec<f64>,
    /// Largest efforts, N·m or N.
    pub efforts: Option<Vec<f64>>,
    /// Where it goes at the start.
    pub home: Option<Vec<f64>>,
    /// Publications a second.
    pub rate: f64,
    /// Stamps.
    pub clock: ClockKind,
    /// Inverse kinematics.
    pub ik: IkKind,
    /// Topics of the real dVRK too.
    pub extras: bool,
    /// Bounds of the errors of the first joints, rad or m, drawn where there is a seed; none: they have no errors.
    pub errors: Vec<f64>,
    /// How it is offered over UDP.
    pub socket: Option<SocketConfig>,
    /// Further topics, for clients that expect other names.
    pub also: Vec<AlsoConfig>,
    /// Without joints: the body that a virtual endoscope arm moves.
    pub body: Option<String>,
    /// Where it is written.
    pub source: SourcePos,
}

/// What a file asks for.
#[derive(Debug, Clone, PartialEq)]
pub struct Configuration {
    /// Arms.
    pub arms: Vec<ArmConfig>,
    /// Bodies whose places follow from the seed.
    pub scatter: Option<ScatterConfig>,
}

const KEYS: &[&str] = &[
    "accelerations",
    "also",
    "base",
    "clock",
    "coupling",
    "dialect",
    "efforts",
    "errors",
    "extras",
    "grasp",
    "home",
    "ik",
    "jaw",
    "joints",
    "kind",
    "limits",
    "name",
    "names",
    "on_limit",
    "prefix",
    "rate",
    "reference",
    "robot_file",
    "socket",
    "speeds",
    "tool",
    "body",
];

/// Reads a file of its own.
///
/// # Errors
/// [`ConfigError`].
pub fn load(path: &Path) -> Result<Configuration, ConfigError> {
    let outline = Outline::load(path)?;
    let directory = path.parent().unwrap_or(Path::new("")).to_owned();
    from_outline(&outline, &directory)
}

/// Reads what stands under `crtk` in a tree (a list, or the path of a file), or under `crtk_config`, or a configuration
/// of the C++ plugin at its root. Relative paths belong to `directory`.
///
/// # Errors
/// [`ConfigError`].
pub fn from_outline(outline: &Outline, directory: &Path) -> Result<Configuration, ConfigError> {
    let root = outline.root();
    let of_file = |text: &str| load(&directory.join(text));
    if let Some(own) = root.get("crtk") {
        return match own.text() {
            Some(text) => of_file(text),
            None => Ok(Configuration { arms: arms(own, directory)?, scatter: scatter(&Map::new(root))? }),
        };
    }
    let named = root.get("crtk_config").or_else(|| first_plugin_with_config(root));
    if let Some(text) = named.and_then(Entry::text) {
        return of_file(text);
    }
    if root.get("interface").is_some() {
        return Ok(Configuration { arms: cpp::read(root)?, scatter: None });
    }
    Err(ConfigError::Nothing { place: root.source() })
}

fn first_plugin_with_config(root: Entry<'_>) -> Option<Entry<'_>> {
    root.get("plugins")?.items().find_map(|plugin| plugin.get("crtk_config"))
}

fn arms(list: Entry<'_>, directory: &Path) -> Result<Vec<ArmConfig>, ConfigError> {
    let arms = list.items().map(|entry| arm(entry, directory)).collect::<Result<Vec<_>, _>>()?;
    if arms.is_empty() {
        let (place, key) = (list.source(), "crtk".into());
        return Err(ConfigError::Missing { place, key, expected: "a list of arms, or the path of a file".into() });
    }
    check_names(&arms)?;
    Ok(arms)
}

fn check_names(arms: &[ArmConfig]) -> Result<(), ConfigError> {
    let mut seen = BTreeSet::new();
    for arm in arms {
        let further = arm.also.iter().map(|also| (&also.space, &also.name));
        for (space, name) in std::iter::once((&arm.space, &arm.name)).chain(further) {
            if !seen.insert(space) {
                return Err(ConfigError::Duplicate { place: arm.source.clone(), name: name.clone() });
            }
        }
    }
    Ok(())
}

/// Whether topics may be called so: letters, digits, `_` and `/`.
fn is_name(text: &str) -> bool {
    let is_part = |part: &str| part.starts_with(|c: char| c.is_ascii_alphabetic());
    text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '/') && text.split('/').all(is_part)
}

const DIALECTS: [(&str, Dialect); 4] =
    [("contract", Dialect::Contract), ("dvrk", Dialect::Dvrk), ("src", Dialect::Src), ("plugin", Dialect::Plugin)];

/// `name`, and the beginning of the topics with `prefix`.
fn names_of_topics(map: &Map<'_>) -> Result<(String, String), ConfigError> {
    let name = map.needed_text("name", "a name such as PSM1")?.to_owned();
    if !is_name(&name) {
        return Err(map.wrong("name", "letters, digits and _, beginning with a letter"));
    }
    let prefix = map.text("prefix").unwrap_or("").trim_matches('/').to_owned();
    if !prefix.is_empty() && !is_name(&prefix) {
        return Err(map.wrong("prefix", "a name space such as /CRTK"));
    }
    let space = if prefix.is_empty() { format!("/{name}") } else { format!("/{prefix}/{name}") };
    Ok((name, space))
}

/// `own`: names of the joints in the scene; `names`: those that the arm has on the wire.
fn also(map: &Map<'_>, kind: Kind, own: &[String], names: &[String]) -> Result<Vec<AlsoConfig>, ConfigError> {
    let Some(list) = map.get("also") else { return Ok(Vec::new()) };
    let further = |entry: Entry<'_>| {
        let map = Map::new(entry);
        map.only(&["dialect", "name", "prefix", "rate"])?;
        let (name, space) = names_of_topics(&map)?;
        let dialect = map.choice("dialect", &DIALECTS)?.unwrap_or_default();
        let rate = map.number("rate")?.unwrap_or(Defaults::of(kind, dialect).rate);
        if !(1.0..=1000.0).contains(&rate) {
            return Err(map.wrong("rate", "1 to 1000 a second"));
        }
        let names = if dialect == Dialect::Src { own } else { names }.to_vec();
        Ok(AlsoConfig { name, space, dialect, names, rate })
    };
    let all: Vec<AlsoConfig> = list.items().map(further).collect::<Result<_, _>>()?;
    if all.is_empty() {
        return Err(map.wrong("also", "a list of {name, prefix, dialect, rate}"));
    }
    Ok(all)
}

fn arm(entry: Entry<'_>, directory: &Path) -> Result<ArmConfig, ConfigError> {
    let map = Map::new(entry);
    map.only(KEYS)?;
    let (name, space) = names_of_topics(&map)?;
    let kinds = [
        ("psm", Kind::Psm),
        ("ecm", Kind::Ecm),
        ("mtm", Kind::Mtm),
        ("generic", Kind::Generic),
        ("object", Kind::Object),
    ];
    let kind = map.choice("kind", &kinds)?.unwrap_or(Kind::Generic);
    let dialect = map.choice("dialect", &DIALECTS)?.unwrap_or_default();
    let defaults = Defaults::of(kind, dialect);
    let described = map.text("robot_file").map(|path| Described::load(&directory.join(path))).transpose()?;
    let described = described.unwrap_or_default();
    let joints: Vec<String> = map.texts("joints")?.unwrap_or_default();
    let count = joints.len();
    // An endoscope arm without joints moves a body as its table says.
    let is_virtual = kind == Kind::Ecm && map.get("body").is_some() && map.get("joints").is_none();
    let count = if is_virtual { VIRTUAL.len() } else { count };
    if kind != Kind::Object && !(1..=MAX_JOINTS).contains(&count) {
        let expected = format!("1 to {MAX_JOINTS} joints, in order");
        return Err(match map.get("joints") {
            Some(_) => map.wrong("joints", &expected),
            None => map.missing("joints", &expected),
        });
    }
    let own_names: Vec<String> = match is_virtual {
        true => VIRTUAL.iter().map(|&name| name.into()).collect(),
        false => joints.iter().map(|joint| wire_name(joint)).collect(),
    };
    let named = described.names.filter(|names| names.len() == count);
    // The challenge's interface has the scene's names.
    let by_kind = (defaults.names.len() == count && dialect != Dialect::Src)
        .then(|| defaults.names.iter().map(|&name| name.into()).collect());
    let names = map.texts("names")?.or(named).or(by_kind).unwrap_or_else(|| own_names.clone());
    if names.len() != count {
        return Err(map.wrong("names", &format!("{count} names, one a joint")));
    }
    let limits = limits(&map, count)?.or(described.limits);
    let numbers = |key: &str, usual: Vec<f64>| {
        let list = map.numbers(key, count)?;
        Ok::<_, ConfigError>(list.unwrap_or(usual))
    };
    let fit = |list: &[f64], other: f64| {
        if list.len() == count {
            list.to_vec()
        } else {
            vec![other; count]
        }
    };
    let speeds = numbers("speeds", described.speeds.unwrap_or_else(|| fit(defaults.speeds, 1.0)))?;
    let accelerations = numbers("accelerations", speeds.iter().map(|speed| speed * 5.0).collect())?;
    for (key, list) in [("speeds", &speeds), ("accelerations", &accelerations)] {
        if list.iter().any(|&value| value <= 0.0) {
            return Err(map.wrong(key, "numbers above 0"));
        }
    }
    let home = match map.get("home").and_then(Entry::text) {
        Some("here") => None,
        _ => map
            .numbers("home", count)?
            .or(described.home)
            .or_else(|| (defaults.home.len() == count && !is_virtual).then(|| defaults.home.to_vec())),
    };
    let errors = map.list("errors")?.unwrap_or_default();
    if errors.len() > count || errors.iter().any(|&bound| bound < 0.0) {
        return Err(map.wrong("errors", &format!("at most {count} bounds of 0 or more, rad or m")));
    }
    let rate = map.number("rate")?.unwrap_or(defaults.rate);
    if !(1.0..=1000.0).contains(&rate) {
        return Err(map.wrong("rate", "1 to 1000 a second"));
    }
    let on_limits = [("refuse", OnLimit::Refuse), ("clamp", OnLimit::Clamp)];
    let clocks = [("wall", ClockKind::Wall), ("sim", ClockKind::Sim)];
    let iks = [("psm", IkKind::Psm), ("ecm", IkKind::Ecm), ("dls", IkKind::Dls), ("none", IkKind::None)];
    Ok(ArmConfig {
        base: map.text("base").map(str::to_owned),
        coupling: coupling(&map, &joints)?,
        jaw: jaw(&map, described.jaw.as_ref())?,
        grasp: grasp(&map)?,
        tool: if is_virtual { None } else { tool(&map, kind)? },
        reference: map.text("reference").map(str::to_owned).or(described.reference).unwrap_or_else(|| {
            if is_virtual {
                "world".into()
            } else {
                defaults.reference.into()
            }
        }),
        limits,
        on_limit: map.choice("on_limit", &on_limits)?.unwrap_or(defaults.on_limit),
        efforts: map.numbers("efforts", count)?,
        home,
        rate,
        clock: map.choice("clock", &clocks)?.unwrap_or(ClockKind::Wall),
        ik: map.choice("ik", &iks)?.unwrap_or(IkKind::Dls),
        extras: map.boolean("extras")?.unwrap_or(false),
        errors,
        socket: socket(&map, kind)?,
        also: also(&map, kind, &own_names, &names)?,
        body: is_virtual.then(|| map.text("body").unwrap_or_default().to_owned()),
        source: entry.source(),
        name,
        space,
        kind,
        dialect,
        joints,
        names,
        speeds,
        accelerations,
    })
}

/// Joints of an endoscope arm that is not in the scene, as the challenge's interface calls them.
const VIRTUAL: [&str; 4] = ["j0", "j1", "j2", "j3"];

fn scatter(root: &Map<'_>) -> Result<Option<ScatterConfig>, ConfigError> {
    let Some(entry) = root.get("scatter") else { return Ok(None) };
    let map = Map::new(entry);
    map.only(&["bodies", "places"])?;
    let bodies = map.texts("bodies")?.ok_or_else(|| map.missing("bodies", "a list of names"))?;
    let list = map.get("places").ok_or_else(|| map.missing("places", "a list of places [x, y]"))?;
    let number = |entry: Entry<'_>| entry.text()?.trim().parse().ok().filter(|value: &f64| value.is_finite());
    let place = |entry: Entry<'_>| {
        let numbers: Vec<f64> = entry.items().map(number).collect::<Option<_>>()?;
        <[f64; 2]>::try_from(numbers).ok()
    };
    let places: Option<Vec<[f64; 2]>> = list.items().map(place).collect();
    let places = places.filter(|places| places.len() >= bodies.len());
    let places = places.ok_or_else(|| map.wrong("places", "places [x, y] in m, at least one a body"))?;
    Ok(Some(ScatterConfig { bodies, places }))
}

fn socket(map: &Map<'_>, kind: Kind) -> Result<Option<SocketConfig>, ConfigError> {
    let Some(entry) = map.get("socket") else { return Ok(None) };
    let map = Map::new(entry);
    map.only(&["listen", "to", "style", "rate", "send", "offset_rpy"])?;
    let style = map.choice("style", &[("bridge", Style::Bridge), ("streamer", Style::Streamer)])?;
    let style = style.unwrap_or(Style::Streamer);
    let text = map.needed_text("listen", "a port, or an address such as 127.0.0.1:5701")?;
    let port = text.parse().map(|port| SocketAddr::new(IpAddr::V4(Ipv4Addr::UNSPECIFIED), port));
    let listen = port.ok().or_else(|| text.parse().ok());
    let listen = listen.ok_or_else(|| map.wrong("listen", "a port, or an address such as 127.0.0.1:5701"))?;
    let expected = "an address such as 127.0.0.1:48051, or sender";
    let to = match map.text("to") {
        None | Some("sender") => None,
        Some(text) => Some(text.parse().map_err(|_| map.wrong("to", expected))?),
    };
    let rate = map.number("rate")?.unwrap_or(if style == Style::Bridge { 60.0 } else { 100.0 });
    if !(1.0..=1000.0).contains(&rate) {
        return Err(map.wrong("rate", "1 to 1000 a second"));
    }
    let usual: &[Told] = match (style, kind) {
        (Style::Bridge, Kind::Ecm) => &[Told::SetPointPose, Told::SetPointJoints],
        (Style::Bridge, _) => &[Told::SetPointPose, Told::SetPointJaw],
        (Style::Streamer, _) => {
            &[Told::MeasuredJoints, Told::MeasuredJaw, Told::SetPointPose, Told::SetPointJaw, Told::OperatingState]
        }
    };
    let tell = match map.texts("send")? {
        None => usual.to_vec(),
        Some(keys) => {
            let named = |key: &String| Told::ALL.iter().find(|(known, _)| known == key).map(|(_, told)| *told);
            let known = Told::ALL.map(|(known, _)| known).join(", ");
            let told: Option<Vec<Told>> = keys.iter().map(named).collect();
            told.ok_or_else(|| map.wrong("send", &format!("a list of {known}")))?
        }
    };
    // The headset's axes: x to the other side, and z towards the user.
    let turned = if style == Style::Bridge && kind == Kind::Psm { std::f64::consts::PI } else { 0.0 };
    let rpy = map.numbers("offset_rpy", 3)?.unwrap_or_else(|| vec![turned, 0.0, turned]);
    let offset = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Ok(Some(SocketConfig { listen, to, style, rate, tell, offset }))
}

/// A joint's name without what stands before the last `/` or the first word.
pub(crate) fn wire_name(joint: &str) -> String {
    let last = joint.rsplit('/').next().unwrap_or(joint);
    last.trim_start_matches("JOINT ").to_owned()
}

fn limits(map: &Map<'_>, count: usize) -> Result<Option<Vec<Limits>>, ConfigError> {
    let Some(entry) = map.get("limits") else { return Ok(None) };
    if entry.text() == Some("from_scene") {
        return Ok(None);
    }
    let pair = |entry: Entry<'_>| -> Option<Limits> {
        let ends: Vec<f64> = entry.items().filter_map(|end| end.text()?.parse().ok()).collect();
        let &[lower, upper] = ends.as_slice() else { return None };
        (lower.is_finite() && upper.is_finite() && lower <= upper).then_some(Limits { lower, upper })
    };
    let pairs: Option<Vec<Limits>> = entry.items().map(pair).collect();
    let pairs = pairs.filter(|pairs| pairs.len() == count);
    let expected = format!("from_scene, or {count} pairs [lower, upper]");
    pairs.map(Some).ok_or_else(|| map.wrong("limits", &expected))
}

fn coupling(map: &Map<'_>, joints: &[String]) -> Result<Vec<Follower>, ConfigError> {
    let Some(list) = map.get("coupling") else { return Ok(Vec::new()) };
    let read = |entry| {
        let map = Map::new(entry);
        map.only(&["joint", "of", "ratio", "offset", "driven"])?;
        let of = map.needed_text("of", "the index or the name of a joint of the arm")?;
        let by_index = of.parse().ok().filter(|&index: &usize| index < joints.len());
        let of = by_index.or_else(|| joints.iter().position(|joint| joint == of));
        Ok(Follower {
            joint: map.needed_text("joint", "the name of a joint")?.to_owned(),
            of: of.ok_or_else(|| map.wrong("of", "the index (from 0) or the name of a joint of the arm"))?,
            ratio: map.number("ratio")?.unwrap_or(1.0),
            offset: map.number("offset")?,
            is_driven: map.boolean("driven")?.unwrap_or(true),
        })
    };
    list.items().map(read).collect()
}

fn jaw(map: &Map<'_>, described: Option<&JawConfig>) -> Result<Option<JawConfig>, ConfigError> {
    let Some(entry) = map.get("jaw") else { return Ok(None) };
    let jaw = Map::new(entry);
    jaw.only(&["joints", "lower", "upper", "speed", "home"])?;
    let list = jaw.get("joints").ok_or_else(|| jaw.missing("joints", "a list of {joint, ratio}"))?;
    let finger = |entry| {
        let map = Map::new(entry);
        map.only(&["joint", "ratio", "offset"])?;
        let joint = map.needed_text("joint", "the name of a joint")?.to_owned();
        let ratio = map.number("ratio")?.unwrap_or(1.0);
        if ratio == 0.0 {
            return Err(map.wrong("ratio", "a number other than 0"));
        }
        Ok((joint, ratio, map.number("offset")?.unwrap_or(0.0)))
    };
    let joints = list.items().map(finger).collect::<Result<Vec<_>, ConfigError>>()?;
    if joints.is_empty() {
        return Err(jaw.wrong("joints", "a list of {joint, ratio}"));
    }
    let usual = described.map_or((-0.349_066, 1.396_26, 0.4), |jaw| (jaw.limits.lower, jaw.limits.upper, jaw.speed));
    let limits =
        Limits { lower: jaw.number("lower")?.unwrap_or(usual.0), upper: jaw.number("upper")?.unwrap_or(usual.1) };
    if limits.lower > limits.upper {
        return Err(jaw.wrong("upper", "an angle that is not below `lower`"));
    }
    let speed = jaw.number("speed")?.unwrap_or(usual.2);
    if speed <= 0.0 {
        return Err(jaw.wrong("speed", "a number above 0"));
    }
    let home = jaw.number("home")?.unwrap_or(0.0);
    Ok(Some(JawConfig { joints, limits, speed, home }))
}

fn grasp(map: &Map<'_>) -> Result<Option<GraspConfig>, ConfigError> {
    let Some(entry) = map.get("grasp") else { return Ok(None) };
    if map.get("jaw").is_none() {
        return Err(map.wrong("grasp", "it only where there is a `jaw`"));
    }
    let rules = Map::new(entry);
    rules.only(&["close", "open", "only", "distance", "centre"])?;
    let tip = map.get("tool").map(Map::new).map_or(Ok(None), |tool| tool.number("tip_offset"))?;
    let close = rules.number("close")?.unwrap_or(0.04);
    let open = rules.number("open")?.unwrap_or(close + 0.04);
    if open <= close {
        return Err(rules.wrong("open", "an angle above `close`"));
    }
    let distance = rules.number("distance")?.unwrap_or(0.008);
    if distance <= 0.0 {
        return Err(rules.wrong("distance", "a number above 0"));
    }
    let centre = rules.number("centre")?.unwrap_or(0.0072 - tip.unwrap_or(0.0));
    Ok(Some(GraspConfig { close, open, only: rules.texts("only")?.unwrap_or_default(), distance, centre }))
}

fn tool(map: &Map<'_>, kind: Kind) -> Result<Option<ToolConfig>, ConfigError> {
    let plain = |body: Option<&str>| ToolConfig {
        body: body.map(str::to_owned),
        offset: Isometry3::identity(),
        tip: 0.0,
        instrument: None,
    };
    if kind == Kind::Object {
        return Ok(Some(plain(Some(map.needed_text("body", "the name of a body")?))));
    }
    let Some(entry) = map.get("tool") else { return Ok(None) };
    let tool = Map::new(entry);
    tool.only(&["body", "offset", "tip_offset", "instrument"])?;
    let mut read = plain(tool.text("body"));
    if let Some(entry) = tool.get("offset") {
        read.offset = pose(&Map::new(entry))?;
    }
    read.tip = tool.number("tip_offset")?.unwrap_or(0.0);
    if let Some(number) = tool.text("instrument") {
        if number.len() != 6 || !number.chars().all(|c| c.is_ascii_digit()) {
            return Err(tool.wrong("instrument", "six digits"));
        }
        read.instrument = Some(number.to_owned());
    }
    Ok(Some(read))
}

/// `position: [x, y, z]` in m, `rpy: [r, p, y]` in rad about fixed axes.
fn pose(map: &Map<'_>) -> Result<Isometry3<f64>, ConfigError> {
    map.only(&["position", "rpy"])?;
    let position = map.numbers("position", 3)?.unwrap_or_else(|| vec![0.0; 3]);
    let rpy = map.numbers("rpy", 3)?.unwrap_or_else(|| vec![0.0; 3]);
    let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Ok(Isometry3::from_parts(Translation3::new(position[0], position[1], position[2]), rotation))
}

/// What follows from kind and dialect.
struct Defaults {
    names: &'static [&'static str],
    speeds: &'static [f64],
    home: &'static [f64],
    on_limit: OnLimit,
    rate: f64,
    reference: &'static str,
}

impl Defaults {
    fn of(kind: Kind, dialect: Dialect) -> Self {
        let (names, speeds, home): (&[&str], &[f64], &[f64]) = match kind {
            Kind::Psm => (
                &["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"],
                &[5.0, 5.0, 0.4, 50.0, 50.0, 50.0],
                &[0.0, 0.0, 0.12, 0.0, 0.0, 0.0],
            ),
            Kind::Ecm => (&["yaw", "pitch", "insertion", "roll"], &[1.0, 1.0, 0.4, 1.0], &[0.0, 0.0, 0.02, 0.0]),
            Kind::Mtm => (
                &[
                    "outer_yaw",
                    "shoulder_pitch",
                    "elbow_pitch",
                    "wrist_platform",
                    "wrist_pitch",
                    "wrist_yaw",
                    "wrist_roll",
                ],
                &[],
                &[],
            ),
            Kind::Generic | Kind::Object => (&[], &[], &[]),
        };
        let refuses = matches!(dialect, Dialect::Contract | Dialect::Plugin);
        let on_limit = if refuses { OnLimit::Refuse } else { OnLimit::Clamp };
        let rate = if dialect == Dialect::Src { 120.0 } else { 100.0 };
        let reference = match (kind, dialect) {
            (Kind::Object, _) | (_, Dialect::Plugin | Dialect::Contract) => "world",
            _ => "base",
        };
        Self { names, speeds, home, on_limit, rate, reference }
    }
}

/// What an arm file of the dVRK simulators says.
#[derive(Default)]
struct Described {
    names: Option<Vec<String>>,
    limits: Option<Vec<Limits>>,
    speeds: Option<Vec<f64>>,
    home: Option<Vec<f64>>,
    jaw: Option<JawConfig>,
    reference: Option<String>,
}

impl Described {
    fn load(path: &Path) -> Result<Self, ConfigError> {
        let outline = Outline::load(path)?;
        let root = outline.root();
        let robot =
            Map::new(root.get("robot").ok_or_else(|| Map::new(root).missing("robot", "the description of an arm"))?);
        let list = robot.get("joints").ok_or_else(|| robot.missing("joints", "a list of joints"))?;
        let mut described = Self::default();
        let (mut names, mut limits, mut speeds) = (Vec::new(), Vec::new(), Vec::new());
        for entry in list.items() {
            let joint = Map::new(entry);
            let needed = |key| joint.number(key)?.ok_or_else(|| joint.missing(key, "a number"));
            names.push(joint.needed_text("name", "the name of a joint")?.to_owned());
            limits.push(Limits { lower: needed("lower")?, upper: needed("upper")? });
            speeds.push(needed("velocity")?);
        }
        if let Some(entry) = robot.get("jaw") {
            let jaw = Map::new(entry);
            let needed = |key| jaw.number(key)?.ok_or_else(|| jaw.missing(key, "a number"));
            let limits = Limits { lower: needed("lower")?, upper: needed("upper")? };
            described.jaw = Some(JawConfig { joints: Vec::new(), limits, speed: needed("velocity")?, home: 0.0 });
        }
        described.home = robot.numbers("home_position", names.len())?;
        let cartesian = robot.get("cartesian").and_then(|cartesian| cartesian.get("reference_frame"));
        described.reference = cartesian.and_then(Entry::text).map(str::to_owned);
        (described.names, described.limits, described.speeds) = (Some(names), Some(limits), Some(speeds));
        Ok(described)
    }
}

#[cfg(test)]
mod tests;
