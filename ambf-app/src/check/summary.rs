//! The table at the end: what each file holds and what became of it.

use std::fmt::Write as _;

use ambf_core::adf::{is_version_key, Entry, FileKind, ObjectType, Outline};
use ambf_core::scene::Scene;
use serde_json::{json, Map, Value};

/// What is counted beside the objects of a model.
const OTHERS: [&str; 4] = ["plugins", "devices", "colours", "models"];

/// How many things are counted.
const N_COUNTED: usize = ObjectType::ALL.len() + OTHERS.len();

/// What is counted: objects by type, then [`OTHERS`].
fn counted() -> impl Iterator<Item = &'static str> {
    ObjectType::ALL.into_iter().map(ObjectType::list).chain(OTHERS)
}

/// Numbers of things by name.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts([usize; N_COUNTED]);

impl Counts {
    /// Number of `what`, one of the headings of the table (`bodies`, `joints`, …); 0 for other words.
    pub fn get(&self, what: &str) -> usize {
        counted().position(|name| name == what).map_or(0, |i| self.0[i])
    }

    pub(super) fn set(&mut self, what: &str, number: usize) {
        if let Some(i) = counted().position(|name| name == what) {
            self.0[i] = number;
        }
    }

    /// What this has more than `other`.
    pub(super) fn minus(mut self, other: &Self) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(mine, theirs)| *mine = mine.saturating_sub(theirs));
        self
    }

    pub(super) fn plus(mut self, other: &Self) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(mine, theirs)| *mine += theirs);
        self
    }

    fn to_json(self) -> Value {
        let numbers = counted().zip(self.0).filter(|(_, number)| *number > 0);
        numbers.map(|(name, number)| (name.to_owned(), json!(number))).collect::<Map<_, _>>().into()
    }
}

/// Elements of a scene, those of the default world included: the one place that knows what is simulated.
pub fn built(scene: &Scene) -> Counts {
    let mut counts = Counts::default();
    ObjectType::ALL.iter().for_each(|&kind| counts.set(kind.list(), scene.object_count(kind)));
    counts
}

/// Elements that the lists of a file name, whether or not they can be used.
pub fn written(outline: &Outline, kind: FileKind) -> Counts {
    let root = outline.root();
    let listed = |key: &str| root.get(key).map_or(0, |list| list.items().count());
    let mut counts = Counts::default();
    match kind {
        FileKind::Model | FileKind::World => {
            let is_listed = |object: &&ObjectType| kind == FileKind::Model || object.is_in_worlds();
            let lists = || ObjectType::ALL.iter().filter(is_listed).map(|object| object.list());
            lists().for_each(|list| counts.set(list, listed(list)));
            let elements = lists().filter_map(|list| root.get(list)).flat_map(Entry::items);
            let elements = elements.filter_map(|name| root.get(name.text()?));
            let plugins = elements.filter_map(|element| Some(element.get("plugins")?.items().count())).sum::<usize>();
            counts.set("plugins", plugins + listed("plugins"));
        }
        FileKind::Launch => {
            counts.set("models", listed("multibody configs"));
            counts.set("plugins", listed("plugins") + listed("device plugins"));
        }
        FileKind::InputDevices => counts.set("devices", listed("input devices")),
        FileKind::ColorTable => counts.set("colours", root.keys().filter(|key| !is_version_key(key)).count()),
    }
    counts
}

/// Files that a file names.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Presence {
    /// Different files that are named.
    pub named: usize,
    /// Those that exist.
    pub found: usize,
}

/// One line of the table.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Row {
    /// The file as it was named, or what is loaded together.
    pub file: String,
    /// What it was taken for.
    pub kind: &'static str,
    /// What its lists name.
    pub written: Counts,
    /// What became of it; `None` where that shows in another line.
    pub built: Option<Counts>,
    /// Collision, visual, sensor and wheel meshes.
    pub meshes: Presence,
    /// Images, shaders and other scene files.
    pub others: Presence,
    /// Keys that nothing reads.
    pub unknown_keys: usize,
    /// Known keys without effect, here and in the C++ program.
    pub ignored_keys: usize,
    /// What only pictures show.
    pub kept: Vec<(&'static str, usize)>,
    /// Other models of the launch file without which names are not found: of each list one is enough.
    pub needs: Vec<Vec<String>>,
}

impl Row {
    pub(super) fn to_json(&self) -> Value {
        let presence = |p: Presence| json!({"named": p.named, "found": p.found, "missing": p.named - p.found});
        json!({
            "file": self.file,
            "kind": self.kind,
            "written": self.written.to_json(),
            "built": self.built.map(Counts::to_json),
            "meshes": presence(self.meshes),
            "other_files": presence(self.others),
            "unknown_keys": self.unknown_keys,
            "ignored_keys": self.ignored_keys,
            "needs": self.needs,
            "for_pictures": self.kept.iter().map(|(what, n)| ((*what).to_owned(), json!(n))).collect::<Map<_, _>>(),
        })
    }
}

/// A table of the columns that are not empty. A cell `4/3` means: 4 written, 3 of them built, found or usable.
pub(super) fn table(rows: &[Row]) -> String {
    let pair = |written: usize, built: Option<usize>| match built {
        Some(built) if written + built > 0 => format!("{written}/{built}"),
        None if written > 0 => written.to_string(),
        _ => String::new(),
    };
    let number = |n: usize| if n > 0 { n.to_string() } else { String::new() };
    type Cell<'a> = Box<dyn Fn(&Row) -> String + 'a>;
    let mut columns: Vec<(&str, Cell<'_>)> =
        vec![("file", Box::new(|row| row.file.clone())), ("taken for", Box::new(|row| row.kind.to_owned()))];
    // Bodies and what joins them come first.
    let main = [ObjectType::Body, ObjectType::Joint].map(ObjectType::list);
    for what in main.into_iter().chain(counted().filter(|what| !main.contains(what))) {
        columns.push((what, Box::new(move |row| pair(row.written.get(what), row.built.map(|built| built.get(what))))));
    }
    columns.push(("meshes", Box::new(move |row| pair(row.meshes.named, Some(row.meshes.found)))));
    columns.push(("other files", Box::new(move |row| pair(row.others.named, Some(row.others.found)))));
    columns.push(("unknown keys", Box::new(move |row| number(row.unknown_keys))));
    columns.push(("keys without effect", Box::new(move |row| number(row.ignored_keys))));
    let needs = |row: &Row| row.needs.iter().map(|files| files.join(" or ")).collect::<Vec<_>>().join(", ");
    columns.push(("needs", Box::new(needs)));
    let kept = |row: &Row| row.kept.iter().map(|(what, n)| format!("{n} × {what}")).collect::<Vec<_>>().join(", ");
    columns.push(("for pictures", Box::new(kept)));

    let mut lines = vec![String::new(); rows.len() + 1];
    for (heading, cell) in columns {
        let cells: Vec<_> = rows.iter().map(cell).collect();
        if cells.iter().all(String::is_empty) {
            continue;
        }
        let cells: Vec<_> = std::iter::once(heading.to_owned()).chain(cells).collect();
        let width = cells.iter().map(|text| text.chars().count()).max().unwrap_or(0);
        for (line, text) in lines.iter_mut().zip(cells) {
            let _ = write!(line, "{text:width$}  ");
        }
    }
    lines.iter().map(|line| format!("{}\n", line.trim_end())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_columns_are_left_out() {
        let mut row = Row { file: "a.yaml".into(), kind: "model", ..Row::default() };
        row.written.set("bodies", 3);
        let mut built = Counts::default();
        built.set("bodies", 2);
        row.built = Some(built);
        row.kept = vec![("material", 2)];
        let mut other = row.clone();
        (other.file, other.built) = ("b.yaml".into(), None);
        other.kept.clear();
        let expected = "file    taken for  bodies  for pictures\na.yaml  model      3/2     2 × material\n\
                        b.yaml  model      3\n";
        assert_eq!(table(&[row, other]), expected);
    }
}
