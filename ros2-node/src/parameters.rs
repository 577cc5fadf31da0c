//! Parameters of a node, as `ros2 param` and its like see them.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use crate::cdr::{Reader, Writer};
use crate::names::{Kind, TypeName};
use crate::node::Node;
use crate::participant::Error;
use crate::publication::Publication;
use crate::qos::Qos;
use crate::service::Service;

/// Longest request, bytes.
const LONGEST: usize = 1 << 20;

/// What separates parts of a parameter's name.
const SEPARATOR: char = '.';

/// The value of a parameter.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Value {
    /// None: the parameter is not there.
    NotSet,
    /// True or false.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Double(f64),
    /// A text.
    Text(String),
    /// Bytes.
    Bytes(Vec<u8>),
    /// A list of truth values.
    Bools(Vec<bool>),
    /// A list of whole numbers.
    Integers(Vec<i64>),
    /// A list of numbers.
    Doubles(Vec<f64>),
    /// A list of texts.
    Texts(Vec<String>),
}

impl Value {
    /// Number of `rcl_interfaces/msg/ParameterType`.
    fn kind(&self) -> u8 {
        match self {
            Self::NotSet => 0,
            Self::Bool(_) => 1,
            Self::Integer(_) => 2,
            Self::Double(_) => 3,
            Self::Text(_) => 4,
            Self::Bytes(_) => 5,
            Self::Bools(_) => 6,
            Self::Integers(_) => 7,
            Self::Doubles(_) => 8,
            Self::Texts(_) => 9,
        }
    }

    /// Writes `rcl_interfaces/msg/ParameterValue`: a place for each kind.
    fn write(&self, writer: &mut Writer) {
        fn list<T>(value: Option<&Vec<T>>) -> std::slice::Iter<'_, T> {
            value.map_or(&[][..], Vec::as_slice).iter()
        }
        writer.u8(self.kind());
        writer.bool(matches!(self, Self::Bool(true)));
        writer.i64(if let Self::Integer(value) = self { *value } else { 0 });
        writer.f64(if let Self::Double(value) = self { *value } else { 0.0 });
        writer.text(if let Self::Text(value) = self { value } else { "" });
        writer.each(list(if let Self::Bytes(value) = self { Some(value) } else { None }), |w, x| w.u8(*x));
        writer.each(list(if let Self::Bools(value) = self { Some(value) } else { None }), |w, x| w.bool(*x));
        writer.each(list(if let Self::Integers(value) = self { Some(value) } else { None }), |w, x| w.i64(*x));
        writer.each(list(if let Self::Doubles(value) = self { Some(value) } else { None }), |w, x| w.f64(*x));
        writer.each(list(if let Self::Texts(value) = self { Some(value) } else { None }), |w, x| w.text(x));
    }

    fn read(reader: &mut Reader<'_>) -> Option<Self> {
        let kind = reader.u8()?;
        let values = [
            Self::NotSet,
            Self::Bool(reader.bool()?),
            Self::Integer(reader.i64()?),
            Self::Double(reader.f64()?),
            Self::Text(reader.text()?),
            Self::Bytes(reader.each(Reader::u8)?),
            Self::Bools(reader.each(Reader::bool)?),
            Self::Integers(reader.each(Reader::i64)?),
            Self::Doubles(reader.each(Reader::f64)?),
            Self::Texts(reader.each(Reader::text)?),
        ];
        values.into_iter().nth(usize::from(kind))
    }
}

/// A parameter and what is known of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Its value now.
    pub value: Value,
    /// What it means, for people.
    pub description: String,
    /// Whether it cannot be set.
    pub read_only: bool,
}

/// The parameters of a node. Called in the participant's thread; must not block.
pub trait Parameters: Send + Sync {
    /// All of them, in the order in which they are listed.
    fn all(&self) -> Vec<Parameter>;

    /// Sets `name`, which is one of them and not read-only, to `value`.
    ///
    /// # Errors
    /// Why it cannot be, for people.
    fn set(&self, name: &str, value: &Value) -> Result<(), String>;
}

/// The services of a node for its parameters. Dropping it ends them.
pub struct ParameterServices {
    _services: Vec<Service>,
}

/// What a request of one service becomes.
type Answer = fn(&Served, &mut Reader<'_>, &mut Writer) -> Option<()>;

struct Served {
    node: String,
    parameters: Arc<dyn Parameters>,
    events: Arc<Publication>,
}

impl ParameterServices {
    pub(crate) fn new(node: &Node, parameters: Arc<dyn Parameters>) -> Result<Self, Error> {
        let events = TypeName::message("rcl_interfaces", "ParameterEvent");
        let events = node.publish("/parameter_events", &events, Qos::new())?;
        let served = Arc::new(Served { node: node.full_name().into(), parameters, events });
        let kinds: [(&str, &str, Answer); 6] = [
            ("get_parameters", "GetParameters", Served::get),
            ("get_parameter_types", "GetParameterTypes", Served::kinds),
            ("set_parameters", "SetParameters", Served::set),
            ("set_parameters_atomically", "SetParametersAtomically", Served::set_atomically),
            ("list_parameters", "ListParameters", Served::list),
            ("describe_parameters", "DescribeParameters", Served::describe),
        ];
        let services = kinds.into_iter().map(|(name, kind, answer)| {
            let served = Arc::clone(&served);
            let type_name = TypeName { package: "rcl_interfaces".into(), kind: Kind::Service, name: kind.into() };
            node.serve(&format!("{}/{name}", node.full_name()), &type_name, LONGEST, move |request| {
                let mut reply = Writer::default();
                // Bytes that are no request get no reply.
                if answer(&served, &mut Reader::new(request.body()), &mut reply).is_some() {
                    request.reply(&reply.0);
                }
            })
        });
        Ok(Self { _services: services.collect::<Result<_, _>>()? })
    }
}

impl Served {
    fn find(&self, name: &str) -> Option<Parameter> {
        self.parameters.all().into_iter().find(|parameter| parameter.name == name)
    }

    fn get(&self, request: &mut Reader<'_>, reply: &mut Writer) -> Option<()> {
        let names = request.each(Reader::text)?;
        reply.each(names.iter(), |reply, name| {
            self.find(name).map_or(Value::NotSet, |parameter| parameter.value).write(reply);
        });
        Some(())
    }

    fn kinds(&self, request: &mut Reader<'_>, reply: &mut Writer) -> Option<()> {
        let names = request.each(Reader::text)?;
        reply.each(names.iter(), |reply, name| {
            reply.u8(self.find(name).map_or(Value::NotSet, |parameter| parameter.value).kind());
        });
        Some(())
    }

    fn describe(&self, request: &mut Reader<'_>, reply: &mut Writer) -> Option<()> {
        let names = request.each(Reader::text)?;
        let found: Vec<Parameter> = names.iter().filter_map(|name| self.find(name)).collect();
        reply.each(found.iter(), |reply, parameter| {
            reply.text(&parameter.name);
            reply.u8(parameter.value.kind());
            reply.text(&parameter.description);
            // No constraints in words, and none in numbers below.
            reply.text("");
            reply.bool(parameter.read_only);
            reply.bool(false);
            reply.count(0);
            reply.count(0);
        });
        Some(())
    }

    fn list(&self, request: &mut Reader<'_>, reply: &mut Writer) -> Option<()> {
        let prefixes = request.each(Reader::text)?;
        let depth = request.u64()?;
        let all = self.parameters.all();
        let listed: Vec<&str> = all
            .iter()
            .map(|parameter| parameter.name.as_str())
            .filter(|name| is_listed(name, &prefixes, depth))
            .collect();
        let mut groups: Vec<&str> =
            listed.iter().filter_map(|name| name.rsplit_once(SEPARATOR).map(|(group, _)| group)).collect();
        groups.sort_unstable();
        groups.dedup();
        reply.each(listed.iter(), |reply, name| reply.text(name));
        reply.each(groups.iter(), |reply, name| reply.text(name));
        Some(())
    }

    fn set(&self, request: &mut Reader<'_>, reply: &mut Writer) -> Option<()> {
        let wanted = request.each(named_value)?;
        let results: Vec<_> = wanted.iter().map(|(name, value)| self.set_one(name, value)).collect();
        reply.each(results.iter(), write_result);
        Some(())
    }

    fn set_atomically(&self, request: &mut Reader<'_>, reply: &mut Writer) -> Option<()> {
        let wanted = request.each(named_value)?;
        let before: Vec<_> = wanted.iter().map(|(name, _)| self.find(name)).collect();
        let mut result = Ok(());
        for (number, (name, value)) in wanted.iter().enumerate() {
            result = self.set_one(name, value);
            if result.is_err() {
                for parameter in before[..number].iter().flatten() {
                    let _ = self.set_one(&parameter.name, &parameter.value);
                }
                break;
            }
        }
        write_result(reply, &result);
        Some(())
    }

    fn set_one(&self, name: &str, value: &Value) -> Result<(), String> {
        match self.find(name) {
            None => return Err(format!("the node has no parameter \"{name}\"")),
            Some(parameter) if parameter.read_only => return Err(format!("{name} cannot be set")),
            Some(_) => self.parameters.set(name, value)?,
        }
        self.tell(name);
        Ok(())
    }

    /// Sends `rcl_interfaces/msg/ParameterEvent` for a parameter that was set.
    fn tell(&self, name: &str) {
        let Some(parameter) = self.find(name).filter(|_| self.events.is_matched()) else { return };
        let stamp = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let mut event = Writer::default();
        event.u32(stamp.as_secs() as u32);
        event.u32(stamp.subsec_nanos());
        event.text(&self.node);
        event.count(0);
        event.each([parameter].iter(), |event, parameter| {
            event.text(&parameter.name);
            parameter.value.write(event);
        });
        event.count(0);
        // Who does not read events misses them.
        let _ = self.events.send(&event.0);
    }
}

fn named_value(reader: &mut Reader<'_>) -> Option<(String, Value)> {
    Some((reader.text()?, Value::read(reader)?))
}

fn write_result(writer: &mut Writer, result: &Result<(), String>) {
    writer.bool(result.is_ok());
    writer.text(result.as_ref().err().map_or("", String::as_str));
}

/// As rclcpp does it: below one of `prefixes`, at most `depth` parts deep; 0 is any depth.
fn is_listed(name: &str, prefixes: &[String], depth: u64) -> bool {
    let shallow = |rest: &str| depth == 0 || (rest.matches(SEPARATOR).count() as u64) < depth;
    if prefixes.is_empty() {
        return shallow(name);
    }
    prefixes.iter().any(|prefix| {
        let below = name.strip_prefix(prefix.as_str()).and_then(|rest| rest.strip_prefix(SEPARATOR));
        name == prefix || below.is_some_and(shallow)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_written_and_read() {
        for value in [
            Value::NotSet,
            Value::Bool(true),
            Value::Integer(-5),
            Value::Double(0.25),
            Value::Text("a".into()),
            Value::Bytes(vec![1, 2]),
            Value::Bools(vec![true, false]),
            Value::Integers(vec![1, -1]),
            Value::Doubles(vec![0.5]),
            Value::Texts(vec!["x".into(), String::new()]),
        ] {
            let mut writer = Writer::default();
            value.write(&mut writer);
            assert_eq!(Value::read(&mut Reader::new(&writer.0)), Some(value));
            for end in 0..writer.0.len() {
                assert_eq!(Value::read(&mut Reader::new(&writer.0[..end])), None);
            }
        }
        assert_eq!(Value::read(&mut Reader::new(&[200; 100])), None);
    }

    #[test]
    fn parameters_are_listed_below_prefixes_and_to_a_depth() {
        let listed = |name, prefixes: &[&str], depth| {
            is_listed(name, &prefixes.iter().map(|&prefix| prefix.to_owned()).collect::<Vec<_>>(), depth)
        };
        assert!(listed("a.b.c", &[], 0) && listed("a", &[], 1) && !listed("a.b", &[], 1) && listed("a.b", &[], 2));
        assert!(listed("a.b", &["a"], 0) && listed("a", &["a"], 0) && !listed("ab", &["a"], 0));
        assert!(listed("a.b", &["x", "a"], 1) && !listed("a.b.c", &["a"], 1));
    }
}
