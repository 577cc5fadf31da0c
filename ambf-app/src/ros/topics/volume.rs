//! Volumes on the wire: what was cut, as the C++ drilling plugin publishes it, and cuts that clients ask for.
//!
//! They belong to the world: volumes have no State. A scene that has none when the program starts has no such topics.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use ambf_core::comm::{CarveCommand, Cut, Hub, PostError, Rates, Snapshot, ToolReading, VolumeCommand};
use ambf_core::ids::VolumeId;
use ambf_core::scene::{VisualScene, VisualVolume};
use ambf_core::volume::{Rule, Shape};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use super::Builder;
use crate::ros::messages::{
    ambf_msgs, from_point, from_quaternion, geometry_msgs, narrow, pose, std_msgs, time, vector,
    volumetric_drilling_msgs,
};
use crate::ros::received::{FromClient, Wire, POSE};
use crate::ros::scheduler::Watch;
use crate::ros::signal::RateLimitedLog;

/// What the topics of the C++ drilling plugin begin with, behind the namespace of the world.
const PREFIX: &str = "plugin/volumetric_drilling";

/// Voxels of one message; of more, the rest comes with the next one.
const MOST: usize = 100_000;

/// Cuts are told at once, Hz.
const CUTS: Rates = Rates { min: 1000, max: 1000 };

/// What a tool does, Hz: each update, as the C++ plugin tells it.
const FORCES: Rates = Rates { min: 1000, max: 1000 };

/// How often it is looked whether a tool has another burr, Hz.
const SIZES: Rates = Rates { min: 20, max: 20 };

/// What waited for longer than this is not told.
const STALE: Duration = Duration::from_secs(2);

/// Where volumes are, Hz: what the C++ plugin says once to all who come.
const INFO: Rates = Rates { min: 1, max: 1 };

/// Cuts of one volume in one message; others, and what would be too much, are left for the next one: a cut, and how many
/// of its voxels were told.
fn voxels(
    cuts: impl Iterator<Item = Arc<Cut>>,
    left: &mut Option<(Arc<Cut>, usize)>,
    visuals: &VisualScene,
) -> Option<volumetric_drilling_msgs::Voxels> {
    let mut message = volumetric_drilling_msgs::Voxels::default();
    let mut of = None;
    for (cut, told) in left.take().into_iter().chain(cuts.map(|cut| (cut, 0))) {
        let room = MOST - message.indices.len();
        if of.is_some_and(|volume| volume != cut.volume) || room == 0 {
            *left = Some((cut, told));
            break;
        }
        of = Some(cut.volume);
        message.header.stamp = time(cut.stamp);
        let index = |&[x, y, z]: &[u32; 3]| volumetric_drilling_msgs::Index { x: x.into(), y: y.into(), z: z.into() };
        message.indices.extend(cut.carved.indices.iter().skip(told).take(room).map(index));
        let color = |color: &[u8; 4]| {
            let [r, g, b, a] = color.map(|level| f32::from(level) / 255.0);
            std_msgs::ColorRGBA { r, g, b, a }
        };
        message.colors.extend(cut.carved.colors.iter().skip(told).take(room).map(color));
        if cut.carved.indices.len() - told > room {
            *left = Some((cut, told + room));
            break;
        }
    }
    if let Some(volume) = visuals.volumes.get(of?) {
        volume.object.identifier.to_string().clone_into(&mut message.header.frame_id);
    }
    Some(message)
}

/// Where the first volume with voxels is, and how large.
fn info(visuals: &VisualScene, snapshot: &Snapshot) -> Option<volumetric_drilling_msgs::VolumeInfo> {
    let id = first(visuals)?;
    let grid = snapshot.voxels.get(id)?.as_ref()?;
    let mut message = volumetric_drilling_msgs::VolumeInfo {
        pose: pose(snapshot.volumes.get(id)?),
        dimensions: grid.edges().iter().map(|edge| narrow(*edge)).collect(),
        voxel_count: grid.size().iter().map(|&edge| edge as i32).collect(),
        ..Default::default()
    };
    message.header.stamp = time(snapshot.stamp);
    message.header.frame_id = visuals.volumes[id].object.identifier.to_string();
    Some(message)
}

fn first(visuals: &VisualScene) -> Option<VolumeId> {
    let mut volumes = visuals.volumes.entries();
    volumes.find(|(_, volume)| volume.voxels.is_some() && !volume.object.removed).map(|(id, _)| id)
}

/// What the first tool of a scene does: that of the first volume that has one.
fn first_tool(visuals: &VisualScene, snapshot: &Snapshot) -> Option<ToolReading> {
    let mut volumes = visuals.volumes.entries().filter(|(_, volume)| !volume.object.removed);
    volumes.find_map(|(id, _)| snapshot.tools.get(id)?.first().copied())
}

/// Diameter of a burr as the C++ plugin tells it: whole millimetres.
fn millimetres(radius: f64) -> u8 {
    // What is larger than the type is its largest number.
    (2e3 * radius).round() as u8
}

/// The burr of the first tool, when it is not the one of `told`.
fn drill_size(
    visuals: &VisualScene,
    snapshot: &Snapshot,
    told: &mut Option<u8>,
) -> Option<volumetric_drilling_msgs::DrillSize> {
    let size = millimetres(first_tool(visuals, snapshot)?.radius);
    if told.replace(size) == Some(size) {
        return None;
    }
    let mut message = volumetric_drilling_msgs::DrillSize::default();
    message.header.stamp = time(snapshot.stamp);
    message.size.data = size;
    Some(message)
}

/// The force on the body of the first tool; its balls turn it, but the C++ plugin tells no torque.
fn drill_force(visuals: &VisualScene, snapshot: &Snapshot) -> Option<geometry_msgs::WrenchStamped> {
    let tool = first_tool(visuals, snapshot)?;
    let mut message = geometry_msgs::WrenchStamped::default();
    message.header.stamp = time(snapshot.stamp);
    message.wrench.force = vector(&tool.force);
    Some(message)
}

/// The volume that a name means: all of its qualified identifier or, if only one has it, a part; empty: the only one.
fn named(visuals: &VisualScene, name: &str) -> Result<VolumeId, String> {
    let there = || visuals.volumes.entries().filter(|(_, volume)| !volume.object.removed);
    if let Some((id, _)) = there().find(|(_, volume)| *volume.object.identifier == *name) {
        return Ok(id);
    }
    let mut holding = there().filter(|(_, volume)| volume.object.identifier.contains(name));
    match (holding.next(), holding.next()) {
        (Some((id, _)), None) => Ok(id),
        (Some(_), Some(_)) => Err(format!("several volumes have `{name}` in their names")),
        _ => Err(format!("no volume has `{name}` in its name")),
    }
}

/// A pose; `what` names it in errors.
fn isometry(pose: &geometry_msgs::Pose, what: &str) -> Result<Isometry3<f64>, String> {
    let turn = from_quaternion(&pose.orientation);
    if !turn.iter().all(|part| part.is_finite()) {
        return Err(format!("the orientation of `{what}` is not finite"));
    }
    let [x, y, z, w] = turn;
    // As in other commands, zeros are no turn.
    let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9).unwrap_or_default();
    Ok(Isometry3::from_parts(from_point(&pose.position).into(), turn))
}

/// The cut that a message asks for, and of what.
///
/// # Errors
/// A sentence about what is wrong.
fn command(visuals: &VisualScene, message: &ambf_msgs::VolumeCmd) -> Result<(VolumeId, VolumeCommand), String> {
    let size = &message.size;
    let shape = match (message.shape.as_str(), size.as_slice()) {
        ("sphere", &[radius]) => Shape::Sphere { radius },
        ("capsule", &[radius, length]) => Shape::Capsule { radius, half_length: 0.5 * length },
        ("box", &[x, y, z]) => Shape::Box { half_edges: 0.5 * Vector3::new(x, y, z) },
        ("voxels", []) => match message.voxels.as_chunks::<3>() {
            (voxels, []) => Shape::Voxels(voxels.to_vec()),
            _ => {
                let count = message.voxels.len();
                return Err(format!("`voxels` has {count} numbers; three indices are expected for each voxel"));
            }
        },
        (shape, size) => {
            let (shape, count) = (shape.escape_debug(), size.len());
            return Err(format!("shape `{shape}` with {count} sizes: sphere has 1, capsule 2, box 3, voxels none"));
        }
    };
    let rule = match message.rule.as_str() {
        "" | "all" => Rule::All,
        "rate" => Rule::Rate { rate: message.amount, interval: message.interval },
        "count" if message.amount >= 0.0 => Rule::Count(message.amount.min(f64::from(u32::MAX)) as usize),
        rule => return Err(format!("rule `{}`: all, rate, or count with an amount", rule.escape_debug())),
    };
    let in_world = match message.frame.as_str() {
        "" | "world" => true,
        "volume" => false,
        frame => return Err(format!("frame `{}`: world or volume", frame.escape_debug())),
    };
    let (from, to) = (isometry(&message.start, "start")?, isometry(&message.end, "end")?);
    let command = CarveCommand { shape, from, to, in_world, rule };
    Ok((named(visuals, &message.volume)?, VolumeCommand::Carve(command)))
}

/// What a message asks of a volume of a scene; a sentence where that cannot be.
type Asked<'a> = &'a dyn Fn(&VisualScene) -> Result<(VolumeId, VolumeCommand), String>;

/// Leaves commands of volumes with the hub.
fn post(hub: Arc<Hub>, topic: String) -> impl FnMut(Asked<'_>) + Send {
    let complaints = RateLimitedLog::default();
    move |asked| {
        let Some(visuals) = hub.visuals() else { return };
        let posted = asked(&visuals).and_then(|(volume, command)| match hub.post_volume(volume, command) {
            // Said once, for all topics.
            Err(PostError::Replaying) => Ok(()),
            posted => posted.map_err(|error| error.to_string()),
        });
        if let Err(why) = posted {
            complaints.report(format_args!("{topic}: {why}; it is ignored"));
        }
    }
}

/// Tells the first tool of each volume to be on or off, or to have a tip of a radius, m.
fn to_tools(hub: Arc<Hub>, topic: String) -> impl FnMut(Option<bool>, Option<f64>) + Send {
    let mut post = post(Arc::clone(&hub), topic);
    move |on, radius| {
        let Some(visuals) = hub.visuals() else { return };
        let with_tools = |(_, volume): &(VolumeId, &VisualVolume)| !volume.burrs.is_empty() && !volume.object.removed;
        for (id, _) in visuals.volumes.entries().filter(with_tools) {
            post(&|_| Ok((id, VolumeCommand::Tool { tool: 0, on, radius })));
        }
    }
}

impl Builder<'_> {
    /// Topics of volumes, beside those of the world whose topics begin with `name`.
    pub(super) fn volumes(&mut self, name: &str) {
        let hub = &self.around.hub;
        if hub.visuals().is_none_or(|visuals| first(&visuals).is_none()) {
            return;
        }
        let namespace = name.rsplit_once('/').map_or("", |(namespace, _)| namespace);
        let topic = |end: &str| format!("{namespace}/{PREFIX}/{end}");
        let watch = Arc::<OnceLock<Watch>>::default();
        let heard = Arc::clone(&watch);
        let cuts = hub.follow_cuts_while(move || heard.get().is_some_and(|is_heard| is_heard()));
        let (mut left, of) = (None, Arc::clone(hub));
        let unread = cuts.clone();
        let mut asked = Instant::now();
        let removed = move |_: Option<&Snapshot>| {
            // Without subscribers nobody asks, and the rest of a cut of long ago is no news to those who come.
            if std::mem::replace(&mut asked, Instant::now()).elapsed() > STALE {
                cuts.try_iter().for_each(drop);
                left = None;
            }
            voxels(cuts.try_iter(), &mut left, &*of.visuals()?)
        };
        let of = Arc::clone(hub);
        let info = move |snapshot: Option<&Snapshot>| info(&*of.visuals()?, snapshot?);
        let remove = topic("remove_voxels");
        let mut post_removal = post(Arc::clone(hub), remove.clone());
        let carve = format!("{name}/Command/Carve");
        let mut post_carving = post(Arc::clone(hub), carve.clone());
        let restore = format!("{name}/Command/Reset/Volumes");
        let mut post_restoring = post(Arc::clone(hub), restore.clone());
        let before = self.served.entries.len();
        if let Some(is_heard) = self.publish_as(topic("voxels_removed"), CUTS, (false, false), removed) {
            let _ = watch.set(is_heard);
        }
        for entry in &mut self.served.entries[before..] {
            let unread = unread.clone();
            entry.discard_while_unwanted(move || unread.try_iter().for_each(drop));
        }
        self.publish(topic("volume_info"), INFO, false, info);
        self.subscribe(remove, move |index: volumetric_drilling_msgs::Index| {
            post_removal(&|visuals| {
                let shape = Shape::Voxels(vec![[index.x, index.y, index.z]]);
                let here = Isometry3::identity();
                let command = CarveCommand { shape, from: here, to: here, in_world: false, rule: Rule::All };
                let volume = first(visuals).ok_or("no volume has voxels")?;
                Ok((volume, VolumeCommand::Carve(command)))
            });
        });
        self.subscribe(carve, move |message: ambf_msgs::VolumeCmd| {
            post_carving(&|visuals| command(visuals, &message));
        });
        let of = Arc::clone(&self.around.hub);
        self.subscribe(restore, move |_: std_msgs::Empty| {
            let Some(visuals) = of.visuals() else { return };
            for (id, _) in visuals.volumes.entries().filter(|(_, volume)| volume.voxels.is_some()) {
                post_restoring(&|_| Ok((id, VolumeCommand::Restore)));
            }
        });
        self.drill(topic);
    }

    /// Topics of the drill, if a volume has a tool: what it does and, for the first tool of all volumes, what it is told.
    fn drill(&mut self, topic: impl Fn(&str) -> String) {
        let hub = &self.around.hub;
        if hub.visuals().is_none_or(|visuals| visuals.volumes.iter().all(|volume| volume.burrs.is_empty())) {
            return;
        }
        let [of_size, of_force] = [(); 2].map(|()| Arc::clone(hub));
        let [mut switch, mut change] =
            ["set_drill_on", "set_drill_size"].map(|end| to_tools(Arc::clone(hub), topic(end)));
        let mut told = None;
        let size = move |snapshot: Option<&Snapshot>| drill_size(&*of_size.visuals()?, snapshot?, &mut told);
        self.publish_latched(topic("drill_size"), SIZES, size);
        let force = move |snapshot: Option<&Snapshot>| drill_force(&*of_force.visuals()?, snapshot?);
        self.publish(topic("drill_force_feedback"), FORCES, false, force);
        self.subscribe(topic("set_drill_on"), move |on: std_msgs::Bool| switch(Some(on.data), None));
        self.subscribe(topic("set_drill_size"), move |size: std_msgs::UInt8| {
            change(None, Some(0.5e-3 * f64::from(size.data)));
        });
    }
}

impl FromClient for volumetric_drilling_msgs::Index {}

impl FromClient for std_msgs::Bool {}

impl FromClient for std_msgs::UInt8 {}

impl FromClient for ambf_msgs::VolumeCmd {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.header()?;
        wire.array(1)?;
        wire.array(1)?;
        wire.array(8)?;
        wire.skip(2 * POSE)?;
        wire.array(1)?;
        wire.array(1)?;
        wire.skip(2 * 8)?;
        wire.array(8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::scene::{load, SceneFiles, SceneOptions};
    use ambf_core::sim::Simulation;
    use ambf_core::volume::{nrrd, Label, Voxel, VoxelGrid};

    fn simulation() -> Simulation {
        let folder = tempfile::tempdir().unwrap();
        let labels = vec![Label::of_color([255, 0, 51])];
        let edges = Vector3::repeat(0.01);
        let full = |_| Voxel { density: 255, label: 1 };
        let grid = VoxelGrid::from_fn([10; 3], edges, 0.5, labels, full).unwrap();
        nrrd::write(&grid, &folder.path().join("v.nrrd"), &Isometry3::translation(1.0, 2.0, 3.0)).unwrap();
        let model = folder.path().join("m.yaml");
        std::fs::write(&model, "volumes: [VOLUME bone]\nVOLUME bone: {name: bone, nrrd: v.nrrd}\nbodies: []\n")
            .unwrap();
        let loaded = load(&SceneFiles { world: None, models: vec![model] }, &SceneOptions::default());
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Simulation::new(loaded.scene, 0.001)
    }

    #[test]
    fn what_clients_ask_for_is_cut_and_told() {
        let mut simulation = simulation();
        let hub = simulation.connect();
        hub.set_listening();
        let visuals = hub.visuals().unwrap();
        let cuts = hub.follow_cuts();
        let at = |x: f64| geometry_msgs::Pose {
            position: geometry_msgs::Point { x: 1.0 + x, y: 2.0, z: 3.0 },
            ..Default::default()
        };
        let mut message = ambf_msgs::VolumeCmd {
            volume: "bone".into(),
            shape: "sphere".into(),
            size: vec![0.0016],
            start: at(0.0),
            end: at(0.002),
            ..Default::default()
        };
        let (volume, asked) = command(&visuals, &message).unwrap();
        hub.post_volume(volume, asked).unwrap();
        simulation.iterate(0.001).unwrap();
        let mut left = None;
        let told = voxels(cuts.try_iter(), &mut left, &visuals).unwrap();
        assert!(told.indices.len() > 16 && told.indices.len() == told.colors.len() && left.is_none());
        assert!(told.header.frame_id.ends_with("VOLUME bone"), "{}", told.header.frame_id);
        assert_eq!((told.colors[0].r, told.colors[0].b, told.colors[0].a), (1.0, 0.2, 1.0));
        assert_eq!(voxels(cuts.try_iter(), &mut left, &visuals), None);
        for (size, shape, frame, rule) in [
            (vec![1.0, 2.0], "sphere", "", ""),
            (vec![1.0], "ball", "", ""),
            (vec![1.0], "sphere", "moon", ""),
            (vec![1.0], "sphere", "", "some"),
        ] {
            message = ambf_msgs::VolumeCmd { size, ..message };
            message.shape = shape.into();
            message.frame = frame.into();
            message.rule = rule.into();
            command(&visuals, &message).unwrap_err();
        }
        // Numbers that would be lost are an error.
        let mut message =
            ambf_msgs::VolumeCmd { shape: "voxels".into(), voxels: vec![1, 2, 3, 4], ..Default::default() };
        assert!(command(&visuals, &message).unwrap_err().contains("has 4 numbers"));
        message.voxels.truncate(3);
        command(&visuals, &message).unwrap();
        message.end.orientation.w = f64::NAN;
        assert!(command(&visuals, &message).unwrap_err().contains("orientation of `end`"));
        message = ambf_msgs::VolumeCmd { volume: "brain".into(), shape: "voxels".into(), ..Default::default() };
        assert!(command(&visuals, &message).unwrap_err().contains("no volume has `brain`"));
    }

    #[test]
    fn a_large_cut_is_told_in_parts() {
        let mut simulation = simulation();
        let hub = simulation.connect();
        hub.set_listening();
        let visuals = hub.visuals().unwrap();
        let count = 2 * MOST + 5;
        let carved = ambf_core::volume::Carved {
            indices: (0..count as u32).map(|x| [x, 0, 0]).collect(),
            colors: vec![[0; 4]; count],
            labels: vec![1; count],
            volume: 1.0,
        };
        let volume = VolumeId::new(0);
        let cut =
            Arc::new(Cut { volume, stamp: std::time::SystemTime::UNIX_EPOCH, sim_time: 0.0, sim_step: 0, carved });
        let (mut left, mut told) = (None, Vec::new());
        let mut cuts = vec![Arc::clone(&cut), cut].into_iter();
        while let Some(message) = voxels(&mut cuts, &mut left, &visuals) {
            assert!(message.indices.len() <= MOST && message.indices.len() == message.colors.len());
            told.extend(message.indices.iter().map(|index| index.x));
        }
        let expected: Vec<i64> = (0..count as i64).chain(0..count as i64).collect();
        assert!(told == expected && left.is_none());
    }

    #[test]
    fn the_volume_is_described_in_the_world() {
        let mut simulation = simulation();
        let hub = simulation.connect();
        hub.set_listening();
        let mut snapshot = Snapshot::default();
        snapshot.volumes.push(Isometry3::translation(1.0, 2.0, 3.0));
        snapshot.voxels.push(simulation.scene().volumes[VolumeId::new(0)].voxels().cloned());
        let info = info(&hub.visuals().unwrap(), &snapshot).unwrap();
        assert_eq!((info.pose.position.z, info.voxel_count.as_slice()), (3.0, &[10, 10, 10][..]));
        assert!(info.dimensions.iter().all(|edge| (edge - 0.01).abs() < 1e-7));
    }
}
