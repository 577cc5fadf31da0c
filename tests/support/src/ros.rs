//! A simulator without physics, and raw clients that behave well or badly.
#![allow(missing_docs, reason = "for tests")]

use ambf_core::device::host::{DeviceState, DeviceStatus};
use ambf_core::ids::{ActuatorId, BodyId, CameraId, GhostId, JointId, LightId, SensorId, SoftBodyId, VehicleId};
use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use ambf_app::ros::{RosMiddleware, RosOptions};
use ambf_core::comm::{
    ActuatorInfo, BodyKinematics, CameraParameters, ContactPoint, ContactReading, GhostReading, Hub, HubIndex,
    LightParameters, Middleware, ObjectInfo, ObjectKind, Rates, RayReading, RigidBodyInfo, SensorInfo, SensorType,
    Snapshot, SnapshotWriter, SoftBodyReading, TouchingBody, VehicleInfo, VehicleReading,
};
use dxr::{MethodCall, MethodResponse, Value};
use nalgebra::{Isometry3, Vector3};

/// How long a condition may take to become true on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// Waits until `condition` holds.
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !condition() {
        assert!(Instant::now() < deadline, "waited {} s in vain: {what}", PATIENCE.as_secs());
        std::thread::sleep(Duration::from_millis(5));
    }
}

pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Points this process at a master on a free port of this machine.
pub fn use_own_master() -> String {
    let uri = format!("http://localhost:{}/", free_port());
    use_master(&uri);
    uri
}

pub fn use_master(uri: &str) {
    std::env::set_var("ROS_MASTER_URI", uri);
    std::env::set_var("ROS_HOSTNAME", "localhost");
}

/// A world, `n_bodies` bodies `Box0`…, a camera and a light in `namespace`.
pub fn objects(namespace: &str, n_bodies: usize, rates: Rates) -> Vec<ObjectInfo> {
    let object = |kind, name: String| ObjectInfo {
        kind,
        namespace: namespace.into(),
        identifier: format!("{namespace}BODY {name}"),
        name,
        rates,
    };
    let body = |i: usize| {
        let info = RigidBodyInfo {
            mass: 1.5,
            joint_names: vec!["joint".into()],
            joints: vec![JointId::new(0)],
            children_names: vec!["child".into()],
            publish_joint_names: true,
            publish_joint_positions: true,
            ..Default::default()
        };
        object(ObjectKind::RigidBody(BodyId::new(i), Box::new(info)), format!("Box{i}"))
    };
    let camera = CameraParameters { near_plane: 0.1, far_plane: 10.0, field_view_angle: 0.8, ..Default::default() };
    let light = LightParameters { cutoff_angle: 0.5, ..Default::default() };
    let mut objects = vec![object(ObjectKind::World, "World".into())];
    objects.extend((0..n_bodies).map(body));
    objects.push(object(ObjectKind::Camera(CameraId::new(0), Box::new(camera)), "cameras/cam".into()));
    objects.push(object(ObjectKind::Light(LightId::new(0), Box::new(light)), "light".into()));
    objects
}

/// An object of `namespace` with the default rates.
pub fn object(kind: ObjectKind, namespace: &str, name: &str) -> ObjectInfo {
    ObjectInfo {
        kind,
        namespace: namespace.into(),
        identifier: format!("{namespace}KEY {name}"),
        name: name.into(),
        rates: Rates::default(),
    }
}

/// Two sensors, an actuator, a vehicle of two wheels, a soft body and a ghost object in `namespace`.
pub fn elements(namespace: &str) -> Vec<ObjectInfo> {
    let parent_name = String::from("BODY Box0");
    let pose = Isometry3::translation(0.0, 0.0, 0.25);
    let sensor = SensorInfo { parent_name: parent_name.clone(), pose, range: 2.0, ..Default::default() };
    let touch = SensorInfo { kind: SensorType::Contact, ..sensor.clone() };
    let vehicle = VehicleInfo { mass: 20.0, inertia: Vector3::new(1.0, 2.0, 3.0), wheels: 2 };
    vec![
        object(ObjectKind::Sensor(SensorId::new(0), Box::new(sensor)), namespace, "Eye"),
        object(
            ObjectKind::Actuator(ActuatorId::new(0), Box::new(ActuatorInfo { parent_name, pose })),
            namespace,
            "Hand",
        ),
        object(ObjectKind::Vehicle(VehicleId::new(0), Box::new(vehicle)), namespace, "Car"),
        object(ObjectKind::SoftBody(SoftBodyId::new(0), 4.0), namespace, "Cloth"),
        object(ObjectKind::Sensor(SensorId::new(1), Box::new(touch)), namespace, "Touch"),
        object(ObjectKind::Ghost(GhostId::new(0), Box::default()), namespace, "Water"),
    ]
}

/// A device that runs.
fn device(name: &str) -> DeviceStatus {
    DeviceStatus {
        name: name.into(),
        model: "mock".into(),
        identity: String::new(),
        cameras: Vec::new(),
        state: DeviceState::Running,
        loops: Default::default(),
        samples: Default::default(),
        force: Default::default(),
    }
}

/// Publishes snapshots at about 1 kHz in place of a physics thread, and serves them to ROS.
pub struct Simulator {
    pub hub: Arc<Hub>,
    pub ros: RosMiddleware,
    stop: Arc<AtomicBool>,
    physics: Option<JoinHandle<()>>,
}

impl Simulator {
    pub fn start(objects: Vec<ObjectInfo>) -> Self {
        Self::start_with(objects, |ros| ros)
    }

    /// With a middleware that `configure` has configured.
    pub fn start_with(objects: Vec<ObjectInfo>, configure: impl FnOnce(RosMiddleware) -> RosMiddleware) -> Self {
        let n_bodies = objects.iter().filter(|o| matches!(o.kind, ObjectKind::RigidBody(..))).count();
        let hub = Arc::new(Hub::new(objects));
        let options = RosOptions::default();
        options.extras.devices.set(["left", "right", "foot"].map(device).to_vec());
        let mut ros = configure(RosMiddleware::new(options));
        ros.start(Arc::clone(&hub)).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let physics = {
            let (hub, stop) = (Arc::clone(&hub), Arc::clone(&stop));
            std::thread::spawn(move || physics(&hub, n_bodies, &stop))
        };
        Self { hub, ros, stop, physics: Some(physics) }
    }

    /// Position in the hub of the object called `name`.
    pub fn object(&self, name: &str) -> HubIndex {
        self.hub.objects().entries().find(|(_, object)| object.info.name == name).map(|(position, _)| position).unwrap()
    }

    pub fn step(&self) -> u32 {
        self.hub.snapshot().as_deref().map_or(0, |s| s.sim_step)
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        self.ros.stop();
        self.stop.store(true, Ordering::Relaxed);
        if let Some(physics) = self.physics.take() {
            let _ = physics.join();
        }
    }
}

fn physics(hub: &Hub, n_bodies: usize, stop: &AtomicBool) {
    let mut writer = SnapshotWriter::new(Snapshot {
        bodies: vec![BodyKinematics::default(); n_bodies].into(),
        joint_positions: vec![0.25].into(),
        joint_velocities: vec![0.0].into(),
        joint_efforts: vec![0.0].into(),
        cameras: vec![Isometry3::translation(1.0, 2.0, 3.0)].into(),
        lights: vec![Isometry3::identity()].into(),
        sensors: vec![vec![
            RayReading { triggered: true, measurement: 0.75, sensed: Some("Box0".into()), body: None },
            RayReading::default(),
        ]]
        .into(),
        contacts: vec![
            ContactReading::default(),
            ContactReading {
                bodies: vec![TouchingBody { identifier: "/ambf/env/KEY Box1".into(), points: 1 }],
                points: vec![ContactPoint { distance: -0.5, ..Default::default() }],
            },
        ]
        .into(),
        actuators: vec![true].into(),
        vehicles: vec![VehicleReading {
            pose: Isometry3::translation(0.0, 0.0, 0.5),
            wheels: vec![Isometry3::translation(1.0, 0.0, 0.0), Isometry3::translation(-1.0, 0.0, 0.0)],
        }]
        .into(),
        soft_bodies: vec![SoftBodyReading {
            center: Vector3::new(0.5, 0.0, 0.0),
            nodes: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        }]
        .into(),
        ghosts: vec![GhostReading {
            pose: Isometry3::translation(7.0, 0.0, 0.0),
            sensed: vec!["/ambf/env/KEY Box1".into()],
        }]
        .into(),
        ..Default::default()
    });
    let mut step = 0;
    while !stop.load(Ordering::Relaxed) {
        step += 1;
        hub.publish(&mut writer, |s| {
            s.stamp = SystemTime::now();
            s.sim_step = step;
            s.sim_time = f64::from(step) * 1e-3;
            s.bodies.iter_mut().enumerate().for_each(|(i, body)| body.origin[0] = i as f64);
        });
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// One XML-RPC call; `None` when nobody answers or the answer is not `[1, …, value]`.
pub fn call(uri: &str, method: &str, arguments: Vec<Value>) -> Option<Value> {
    let authority = uri.strip_prefix("http://")?.trim_end_matches('/');
    let mut params = vec![Value::String("/tester".into())];
    params.extend(arguments);
    let body = MethodCall { name: method.into(), params }.to_xml().ok()?;
    let mut stream = TcpStream::connect(authority).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(5))).ok()?;
    write!(
        stream,
        "POST /RPC2 HTTP/1.0\r\nHost: {authority}\r\nContent-Type: text/xml\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    )
    .ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    match MethodResponse::from_xml(answer.split_once("\r\n\r\n")?.1.trim()).ok()?.value {
        Value::Array(parts) if parts.first() == Some(&Value::Integer(1)) => parts.into_iter().nth(2),
        _ => None,
    }
}

pub fn text(s: &str) -> Value {
    Value::String(s.into())
}

/// Topic and type of everything that is published.
pub fn published_topics(master: &str) -> Vec<(String, String)> {
    let Some(Value::Array(list)) = call(master, "getPublishedTopics", vec![text("")]) else { return Vec::new() };
    list.into_iter()
        .filter_map(|entry| match entry {
            Value::Array(pair) => match &pair[..] {
                [Value::String(topic), Value::String(kind)] => Some((topic.clone(), kind.clone())),
                _ => None,
            },
            _ => None,
        })
        .collect()
}

/// Whether the master's system state mentions `text` anywhere.
pub fn system_state_mentions(master: &str, text: &str) -> bool {
    call(master, "getSystemState", vec![]).is_some_and(|state| format!("{state:?}").contains(text))
}

/// Address of the node that publishes `topic`, once there is one.
pub fn publisher_of(master: &str, topic: &str) -> String {
    let mut found = None;
    until(&format!("a publisher of {topic}"), || {
        let Some(Value::Array(lists)) = call(master, "getSystemState", vec![]) else { return false };
        let Some(Value::Array(publishers)) = lists.into_iter().next() else { return false };
        let node = publishers.into_iter().find_map(|entry| match entry {
            Value::Array(pair) if pair.first() == Some(&text(topic)) => match &pair[1] {
                Value::Array(nodes) => nodes.first().cloned(),
                _ => None,
            },
            _ => None,
        });
        found = node.and_then(|node| call(master, "lookupNode", vec![node]));
        found.is_some()
    });
    match found {
        Some(Value::String(uri)) => uri,
        other => panic!("no address: {other:?}"),
    }
}

/// A bare TCPROS subscriber: it reads exactly what it is told to read.
pub struct RawSubscriber {
    pub stream: TcpStream,
    pub header: HashMap<String, String>,
}

impl RawSubscriber {
    /// Connects to `topic` of the node at `node`, as `rostopic hz` does: any type, any checksum.
    pub fn connect(node: &str, topic: &str) -> Self {
        let mut port = None;
        until(&format!("the port of {topic}"), || {
            let protocols = Value::Array(vec![Value::Array(vec![text("TCPROS")])]);
            if let Some(Value::Array(answer)) = call(node, "requestTopic", vec![text(topic), protocols]) {
                if let Some(Value::Integer(number)) = answer.get(2) {
                    port = Some(*number as u16);
                }
            }
            port.is_some()
        });
        Self::handshake(port.unwrap(), topic)
    }

    pub fn handshake(port: u16, topic: &str) -> Self {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let fields = ["callerid=/raw".to_owned(), format!("topic={topic}"), "md5sum=*".into(), "type=*".into()];
        let mut header = Vec::new();
        for field in fields {
            header.extend((field.len() as u32).to_le_bytes());
            header.extend(field.as_bytes());
        }
        stream.write_all(&(header.len() as u32).to_le_bytes()).unwrap();
        stream.write_all(&header).unwrap();
        let mut this = Self { stream, header: HashMap::new() };
        let answer = this.read_block().expect("a header");
        let mut rest = &answer[..];
        while rest.len() >= 4 {
            let length = u32::from_le_bytes(rest[..4].try_into().unwrap()) as usize;
            let field = String::from_utf8_lossy(&rest[4..4 + length]).into_owned();
            let (key, value) = field.split_once('=').unwrap();
            this.header.insert(key.into(), value.into());
            rest = &rest[4 + length..];
        }
        this
    }

    /// The next message; `None` when the connection has ended.
    pub fn read_block(&mut self) -> Option<Vec<u8>> {
        let mut length = [0; 4];
        self.stream.read_exact(&mut length).ok()?;
        let mut block = vec![0; u32::from_le_bytes(length) as usize];
        self.stream.read_exact(&mut block).ok()?;
        Some(block)
    }

    /// Messages within `time`.
    pub fn count(&mut self, time: Duration) -> usize {
        let end = Instant::now() + time;
        let mut n = 0;
        while Instant::now() < end {
            self.read_block().expect("the stream goes on");
            n += 1;
        }
        n
    }
}

/// Threads and open files of this process.
pub fn resources() -> (usize, usize) {
    let count = |path: &str| std::fs::read_dir(path).unwrap().count();
    (count("/proc/self/task"), count("/proc/self/fd"))
}
