//! Parameters of cameras and lights, which clients read from the object's node and set there.

use std::sync::Arc;

use ambf_core::comm::{Command, Hub};
use dxr::Value as Ros1Value;
use parking_lot::Mutex;
use ros2_node::{Parameter, Parameters, Value};

use super::super::parameters::{OnServer, Parameterised, Tree};

/// An object whose parameters are offered.
pub(super) struct Offered<P> {
    hub: Arc<Hub>,
    object: Mutex<Parameterised<P>>,
}

impl<P: OnServer> Offered<P> {
    /// Changes are left with `hub`.
    pub fn new(hub: &Arc<Hub>, mut object: Parameterised<P>) -> Arc<Self> {
        object.values.fill_in();
        Arc::new(Self { hub: Arc::clone(hub), object: Mutex::new(object) })
    }
}

impl<P: OnServer + Command> Parameters for Offered<P> {
    fn all(&self) -> Vec<Parameter> {
        let object = self.object.lock();
        let parameter = |(key, value): (&str, _)| Parameter {
            name: format!("{}/{key}", object.name),
            value: from_ros1(value),
            description: String::new(),
            // There is only one type of light.
            read_only: key == "type",
        };
        object.values.values().into_iter().map(parameter).collect()
    }

    fn set(&self, name: &str, value: &Value) -> Result<(), String> {
        let mut object = self.object.lock();
        let key = name.strip_prefix(&object.name).and_then(|rest| rest.strip_prefix('/')).unwrap_or(name);
        let value = to_ros1(value).ok_or_else(|| format!("{key}: expected a number or text"))?;
        let mut values = object.values.clone();
        let complaints = values.update(&Tree::from([(key.to_owned(), value)]));
        if let Some(complaint) = complaints.into_iter().next() {
            return Err(complaint);
        }
        values.fill_in();
        self.hub.post(object.object, &values).map_err(|error| error.to_string())?;
        object.parent.set(values.parent_name());
        object.values = values;
        Ok(())
    }
}

fn from_ros1(value: Ros1Value) -> Value {
    match value {
        Ros1Value::Double(number) => Value::Double(number),
        Ros1Value::Integer(number) => Value::Integer(number.into()),
        Ros1Value::Boolean(truth) => Value::Bool(truth),
        Ros1Value::String(text) => Value::Text(text),
        _ => Value::NotSet,
    }
}

fn to_ros1(value: &Value) -> Option<Ros1Value> {
    Some(match value {
        Value::Double(number) => Ros1Value::Double(*number),
        Value::Integer(number) => Ros1Value::Double(*number as f64),
        Value::Text(text) => Ros1Value::String(text.clone()),
        _ => return None,
    })
}
