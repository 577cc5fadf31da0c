//! What a recording says about the scene it is of.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use ambf_core::bullet::{Gyroscopic, Integrator, Preset, Solver};
use ambf_core::control::Profile;
use ambf_core::scene::{load, Loaded, PhysicsOptions, SceneFiles, SceneOptions, SceneReport};
use ambf_core::sim::Simulation;
use serde_json::{json, Map, Value};
use sha2::{Digest, Sha256};

use crate::{RecordingError, FORMAT};

/// A file that a recorded scene was made of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsedFile {
    /// Absolute path.
    pub path: PathBuf,
    /// SHA-256 of what was in it, in hexadecimal digits.
    pub sha256: String,
}

/// What is needed to load the scene of a recording again.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// Program that recorded, with its version.
    pub program: String,
    /// Its processor.
    pub processor: String,
    /// Files of the scene, absolute.
    pub files: SceneFiles,
    /// Options that the scene was loaded with; publishing rates are not kept.
    pub options: SceneOptions,
    /// Length of a sub-step, s.
    pub sub_step: f64,
    /// All files that were used, with what was in them.
    pub used: Vec<UsedFile>,
}

impl Header {
    /// The header of a recording of `simulation` by `program`. Reads all files of its scene, which takes as long as that
    /// takes.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn of(simulation: &Simulation, program: &str) -> io::Result<Self> {
        let mut header = Self::without_sums(simulation, program)?;
        header.used.iter_mut().try_for_each(|file| {
            file.sha256 = sha256(&file.path)?;
            io::Result::Ok(())
        })?;
        Ok(header)
    }

    /// [`of`](Self::of), without what is in the files.
    fn without_sums(simulation: &Simulation, program: &str) -> io::Result<Self> {
        let scene = simulation.scene();
        let (files, options) = scene.origin();
        let absolute = |path: &PathBuf| std::path::absolute(path);
        let used = scene.used_files();
        let used = used.iter().map(|path| Ok(UsedFile { path: absolute(path)?, sha256: String::new() }));
        Ok(Self {
            program: format!("{program} {}", ambf_version::VERSION),
            processor: processor(),
            files: SceneFiles {
                world: files.world.as_ref().map(absolute).transpose()?,
                models: files.models.iter().map(absolute).collect::<io::Result<_>>()?,
            },
            options: SceneOptions { rates: None, ..options.clone() },
            sub_step: simulation.sub_step(),
            used: used.collect::<io::Result<_>>()?,
        })
    }

    /// Loads the scene as it was loaded.
    ///
    /// # Errors
    /// [`RecordingError::Files`] when files are missing or have changed, unless `tolerant`; [`RecordingError::Scene`] when
    /// one is of no use.
    pub fn load(&self, tolerant: bool) -> Result<(Simulation, SceneReport), RecordingError> {
        let changed = self.changed_files();
        if !changed.is_empty() && !tolerant {
            return Err(RecordingError::Files(changed.join("\n")));
        }
        let Loaded { scene, report } = load(&self.files, &self.options);
        if !report.refused.is_empty() {
            return Err(RecordingError::Scene(report.to_string().trim_end().to_owned()));
        }
        Ok((Simulation::new(scene, self.sub_step), report))
    }

    /// A sentence for each file that is not what it was.
    pub fn changed_files(&self) -> Vec<String> {
        let sentence = |file: &UsedFile| match sha256(&file.path) {
            Ok(found) if found == file.sha256 => None,
            Ok(_) => Some(format!("{}: has changed since the recording", file.path.display())),
            Err(error) => Some(format!("{}: {error}", file.path.display())),
        };
        self.used.iter().filter_map(sentence).collect()
    }

    /// As the fields of a metadata record.
    pub(crate) fn to_fields(&self) -> BTreeMap<String, String> {
        let path = |path: &PathBuf| path.display().to_string();
        let SceneOptions {
            prefix,
            rates: _,
            physics,
            default_profile,
            may_grow,
            is_one_of_many,
            savable,
            joint_wrenches,
        } = &self.options;
        let used: Vec<_> =
            self.used.iter().map(|file| json!({ "path": path(&file.path), "sha256": file.sha256 })).collect();
        let scene = json!({
            "world": self.files.world.as_ref().map(path),
            "models": self.files.models.iter().map(path).collect::<Vec<_>>(),
            "sub step": number(self.sub_step),
            "prefix": prefix,
            "physics": physics_to_json(physics),
            "default profile": default_profile.map(profile_name),
            "may grow": may_grow,
            "one of many": is_one_of_many,
            "savable": savable,
            "joint wrenches": joint_wrenches,
            "files": used,
        });
        [
            ("format", FORMAT.to_string()),
            ("program", self.program.clone()),
            ("processor", self.processor.clone()),
            ("scene", scene.to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }

    /// From the fields of a metadata record.
    pub(crate) fn from_fields(fields: &BTreeMap<String, String>) -> Result<Self, RecordingError> {
        let field = |key: &str| {
            fields.get(key).ok_or_else(|| RecordingError::Header(format!("`{key}` is missing"))).map(String::as_str)
        };
        let format = field("format")?;
        if format != FORMAT.to_string() {
            return Err(RecordingError::Format(format.to_owned()));
        }
        let scene: Value = serde_json::from_str(field("scene")?)
            .map_err(|error| RecordingError::Header(format!("`scene` is no JSON: {error}")))?;
        let scene = Fields { map: scene.as_object().ok_or_else(|| wrong("scene", "an object"))? };
        let files = scene.list("files")?.iter().map(|file| {
            let file = Fields { map: file.as_object().ok_or_else(|| wrong("files", "a list of objects"))? };
            Ok(UsedFile { path: file.text("path")?.into(), sha256: file.text("sha256")?.to_owned() })
        });
        let models = scene.list("models")?.iter();
        let models = models.map(|model| model.as_str().map(PathBuf::from).ok_or_else(|| wrong("models", "texts")));
        let physics = Fields { map: scene.get("physics")?.as_object().ok_or_else(|| wrong("physics", "an object"))? };
        let sub_step = scene.optional_number("sub step")?.filter(|length| length.is_finite() && *length > 0.0);
        Ok(Self {
            program: field("program")?.to_owned(),
            processor: field("processor")?.to_owned(),
            files: SceneFiles {
                world: scene.optional_text("world")?.map(PathBuf::from),
                models: models.collect::<Result<_, _>>()?,
            },
            options: SceneOptions {
                prefix: scene.text("prefix")?.to_owned(),
                rates: None,
                physics: physics_of(&physics)?,
                default_profile: scene.named("default profile", &PROFILES)?,
                may_grow: scene.flag("may grow")?,
                is_one_of_many: scene.flag("one of many")?,
                savable: scene.flag("savable")?,
                joint_wrenches: scene.flag("joint wrenches")?,
            },
            sub_step: sub_step.ok_or_else(|| wrong("sub step", "a length above 0"))?,
            used: files.collect::<Result<_, _>>()?,
        })
    }
}

/// What headers of recordings say that begin later, while the simulation is elsewhere.
#[derive(Debug, Clone)]
pub struct LaterHeader {
    header: Header,
    /// No file may have changed since.
    since: SystemTime,
}

impl LaterHeader {
    /// For recordings of `simulation` by `program`, whose scene was loaded not before `since`. Reads no file.
    ///
    /// # Errors
    /// When there is no working directory.
    pub fn of(simulation: &Simulation, program: &str, since: SystemTime) -> io::Result<Self> {
        Ok(Self { header: Header::without_sums(simulation, program)?, since })
    }

    /// The header; reads all files.
    ///
    /// # Errors
    /// When a file cannot be read, or has changed since it was loaded.
    pub fn read(&self) -> io::Result<Header> {
        let mut header = self.header.clone();
        for file in &mut header.used {
            if std::fs::metadata(&file.path)?.modified()? > self.since {
                let path = file.path.display();
                return Err(io::Error::other(format!("{path} has changed since it was loaded: restart the simulator")));
            }
            file.sha256 = sha256(&file.path)?;
        }
        Ok(header)
    }
}

const PROFILES: [(&str, Profile); 2] = [("legacy", Profile::Legacy), ("accurate", Profile::Accurate)];
const PRESETS: [(&str, Preset); 1] = [("pybullet", Preset::PyBullet)];

fn profile_name(profile: Profile) -> &'static str {
    name_of(profile, &PROFILES)
}

fn name_of<T: PartialEq>(value: T, names: &[(&'static str, T)]) -> &'static str {
    names.iter().find(|(_, known)| *known == value).map_or("", |(name, _)| name)
}

/// With as many digits as give the same number back.
fn number(number: f64) -> Value {
    serde_json::Number::from_f64(number).map_or(Value::Null, Value::Number)
}

fn physics_to_json(physics: &PhysicsOptions) -> Value {
    // All fields by name, so that no new one is forgotten.
    let PhysicsOptions {
        profile,
        preset,
        solver,
        iterations,
        integrator,
        articulated,
        sub_step,
        sleep,
        joint_erp,
        gyroscopic,
        kinematic_bodies,
    } = *physics;
    json!({
        "profile": profile.map(profile_name),
        "preset": preset.map(|preset| name_of(preset, &PRESETS)),
        "solver": solver.map(|solver| name_of(solver, &Solver::NAMES)),
        "iterations": iterations,
        "integrator": integrator.map(|integrator| name_of(integrator, &Integrator::NAMES)),
        "articulated": articulated,
        "sub step": sub_step.map(number),
        "sleep": sleep,
        "joint erp": joint_erp.map(number),
        "gyroscopic": gyroscopic.map(|gyroscopic| name_of(gyroscopic, &Gyroscopic::NAMES)),
        "kinematic bodies": kinematic_bodies,
    })
}

fn physics_of(fields: &Fields<'_>) -> Result<PhysicsOptions, RecordingError> {
    let iterations = fields.optional_number("iterations")?.map(|iterations| iterations as u32);
    Ok(PhysicsOptions {
        profile: fields.named("profile", &PROFILES)?,
        preset: fields.named("preset", &PRESETS)?,
        solver: fields.named("solver", &Solver::NAMES)?,
        iterations,
        integrator: fields.named("integrator", &Integrator::NAMES)?,
        articulated: fields.optional_flag("articulated")?,
        sub_step: fields.optional_number("sub step")?,
        sleep: fields.optional_flag("sleep")?,
        joint_erp: fields.optional_number("joint erp")?,
        gyroscopic: fields.named("gyroscopic", &Gyroscopic::NAMES)?,
        kinematic_bodies: fields.optional_flag("kinematic bodies")?,
    })
}

fn wrong(key: &str, expected: &str) -> RecordingError {
    RecordingError::Header(format!("`{key}`: expected {expected}"))
}

/// An object of JSON whose fields must be there.
struct Fields<'a> {
    map: &'a Map<String, Value>,
}

impl<'a> Fields<'a> {
    fn get(&self, key: &str) -> Result<&'a Value, RecordingError> {
        self.map.get(key).ok_or_else(|| RecordingError::Header(format!("`{key}` is missing")))
    }

    fn list(&self, key: &str) -> Result<&'a Vec<Value>, RecordingError> {
        self.get(key)?.as_array().ok_or_else(|| wrong(key, "a list"))
    }

    fn text(&self, key: &str) -> Result<&'a str, RecordingError> {
        self.get(key)?.as_str().ok_or_else(|| wrong(key, "a text"))
    }

    fn flag(&self, key: &str) -> Result<bool, RecordingError> {
        self.get(key)?.as_bool().ok_or_else(|| wrong(key, "true or false"))
    }

    fn optional<T>(
        &self,
        key: &str,
        expected: &str,
        get: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Result<Option<T>, RecordingError> {
        match self.get(key)? {
            Value::Null => Ok(None),
            value => get(value).map(Some).ok_or_else(|| wrong(key, expected)),
        }
    }

    fn optional_text(&self, key: &str) -> Result<Option<&'a str>, RecordingError> {
        self.optional(key, "a text", Value::as_str)
    }

    fn optional_flag(&self, key: &str) -> Result<Option<bool>, RecordingError> {
        self.optional(key, "true or false", Value::as_bool)
    }

    fn optional_number(&self, key: &str) -> Result<Option<f64>, RecordingError> {
        self.optional(key, "a number", Value::as_f64)
    }

    fn named<T: Copy>(&self, key: &str, names: &[(&str, T)]) -> Result<Option<T>, RecordingError> {
        let known = || names.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
        let find = |name: &str| names.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
        match self.optional_text(key)? {
            None => Ok(None),
            Some(name) => find(name).map(Some).ok_or_else(|| wrong(key, &format!("one of {}, not `{name}`", known()))),
        }
    }
}

/// SHA-256 of what is in a regular file.
pub(crate) fn sha256(path: &Path) -> io::Result<String> {
    let (mut file, _) = ambf_core::files::open(path)?;
    hash(&mut file)
}

fn hash(file: &mut File) -> io::Result<String> {
    let (mut hasher, mut block) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut block)? {
            0 => break,
            read => hasher.update(&block[..read]),
        }
    }
    let digits = hasher.finalize().iter().fold(String::new(), |mut digits, byte| {
        let _ = write!(digits, "{byte:02x}");
        digits
    });
    Ok(digits)
}

/// The model of this computer's processor.
fn processor() -> String {
    let about = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = about.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    model.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_read_as_it_was_written() {
        let physics = PhysicsOptions {
            profile: Some(Profile::Accurate),
            solver: Some(Solver::Nncg),
            iterations: Some(7),
            integrator: Some(Integrator::Ballistic),
            sub_step: Some(0.1 + 0.2),
            sleep: Some(false),
            gyroscopic: Some(Gyroscopic::Explicit),
            ..PhysicsOptions::default()
        };
        let options = SceneOptions { physics, savable: true, prefix: "/a/".into(), ..SceneOptions::default() };
        let header = Header {
            program: "test 1".into(),
            processor: "any".into(),
            files: SceneFiles { world: None, models: vec!["/a/b c.yaml".into()] },
            options,
            sub_step: 1.0 / 3000.0,
            used: vec![UsedFile { path: "/a/b c.yaml".into(), sha256: "00".into() }],
        };
        let fields = header.to_fields();
        let again = Header::from_fields(&fields).expect("a header");
        assert_eq!(format!("{again:?}"), format!("{header:?}"));
        for (key, value, part) in [
            ("format", "2", "later"),
            ("format", "", "later"),
            ("scene", "[]", "object"),
            ("scene", "{", "JSON"),
            ("scene", "{}", "missing"),
        ] {
            let mut damaged = fields.clone();
            damaged.insert(key.into(), value.into());
            let error = Header::from_fields(&damaged).expect_err("damaged").to_string();
            assert!(error.contains(part), "{key} {value}: {error}");
        }
    }

    #[test]
    fn files_are_told_apart_by_what_is_in_them() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a");
        std::fs::write(&path, "abc").expect("written");
        // FIPS 180-2, B.1.
        assert_eq!(sha256(&path).expect("there"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
