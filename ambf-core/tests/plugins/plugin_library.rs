//! Plugins in shared libraries: written in C, made for another interface, or panicking.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::plugin_common::{library_of, Stage};
use ambf_core::ids::BodyId;
use ambf_core::plugin::{DrawingShape, Input, PluginSetup, TextPlace};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

/// Compiles a library in C against the header in `resources/plugins`.
fn compiled(stage: &Stage, name: &str, text: &str) -> PathBuf {
    let source = stage.write(&format!("{name}.c"), text);
    let library = stage.folder.join(format!("lib{name}.so"));
    let include = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/plugins");
    let output = Command::new("cc")
        .args(["-shared", "-fPIC", "-Wall", "-Wextra", "-Werror", "-std=c11", "-I"])
        .args([include.as_path(), &source, Path::new("-o"), &library])
        .output()
        .expect("a C compiler, which the simulator is built with, too");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    library
}

const VERSION: &str = "#include <string.h>\n#include <stdlib.h>\n#include \"ambf_plugin.h\"\n\
    uint32_t ambf_plugin_abi_version(void) { return AMBF_PLUGIN_ABI_VERSION; }\n";

fn problem(stage: &Stage, library: &Path) -> String {
    let mut simulation = stage.scene("gravity: {x: 0, y: 0, z: 0}\n", &[]);
    let setup = PluginSetup { command_line: vec![library.to_owned()], ..stage.setup() };
    let report = simulation.load_plugins(setup);
    assert!(report.loaded.is_empty());
    simulation.iterate(0.001).unwrap();
    assert_eq!(simulation.sim_step(), 1, "the simulation goes on");
    let [problem] = report.problems.as_slice() else { panic!("{:?}", report.problems) };
    problem.clone()
}

#[test]
fn each_step_that_fails_is_named() {
    let stage = Stage::new();
    let version = "#include <stdint.h>\nuint32_t ambf_plugin_abi_version(void) { return 77; }\n";
    let create = |body: &str| {
        format!("{VERSION}ambf_plugin *ambf_plugin_create(uint32_t kind, const ambf_host *host) {{ (void)kind; (void)host; {body} }}\n")
    };
    let said = "const char *why = \"no licence\"; ambf_text text = {why, strlen(why)}; host->fail(host->context, text); return NULL;";
    let broken = stage.write("libbroken.so", "this is no library");
    for (name, text, part) in [
        ("other_version", version, "was made for version 77 of the plugin interface, this program has version 2"),
        ("no_version", "int nothing;\n", "is no plugin: it has no function `ambf_plugin_abi_version`"),
        ("no_create", VERSION, "is no plugin: it has no function `ambf_plugin_create`"),
        ("null", &create("return NULL;"), "made no simulator plugin"),
        ("reason", &create(said), "made no simulator plugin: no licence"),
        ("cpp", "void *CreatePlugin(void) { return 0; }\n", "compiled plugin of the C++ program"),
    ] {
        let problem = problem(&stage, &compiled(&stage, name, text));
        assert!(problem.contains(part) && problem.contains(&format!("lib{name}.so")), "{name}: {problem}");
    }
    let problem = problem(&stage, &broken);
    assert!(problem.contains("cannot open it") && problem.contains("libbroken.so: "), "{problem}");
}

/// A world plugin: holds the body that its node names against gravity, counts what it is told, and misuses the host now
/// and then.
const HOLDER: &str = r#"
typedef struct {
    ambf_plugin table;
    const ambf_host *host;
    int64_t body;
    int updates, resets, models, objects;
} holder;

static void say(const ambf_host *host, const char *line) {
    ambf_text text = {line, strlen(line)};
    host->say(host->context, text);
}

static int32_t start(void *instance, const ambf_init *init) {
    holder *self = instance;
    ambf_text name = {"Ball", 4};
    char text[64] = {0};
    if (init->kind != AMBF_WORLD || init->argument_count != 2) return AMBF_FAILED;
    memcpy(text, init->node.data, init->node.length < 63 ? init->node.length : 63);
    if (!strstr(text, "gravity")) return AMBF_FAILED;
    self->body = self->host->find(self->host->context, AMBF_BODY, name);
    return self->body < 0 ? AMBF_FAILED : AMBF_DONE;
}

static int32_t update(void *instance, double dt) {
    holder *self = instance;
    const ambf_host *host = self->host;
    ambf_body body, none;
    ambf_clock clock;
    ambf_command command = {AMBF_WRENCH, 0, (uint64_t)self->body, 0, {0}};
    ambf_command nonsense = {9999, 0, 0, 0, {0}};
    char name[3] = "..";
    if (host->body(host->context, (uint64_t)self->body, &body) != 0) return AMBF_FAILED;
    if (host->clock(host->context, &clock) != 0 || clock.dt != dt) return AMBF_FAILED;
    command.numbers[2] = 10.0 * body.mass;
    if (host->execute(host->context, &command) != 0) return AMBF_FAILED;
    if (host->execute(host->context, &nonsense) != AMBF_UNKNOWN) return AMBF_FAILED;
    if (host->execute(host->context, 0) != AMBF_UNKNOWN) return AMBF_FAILED;
    if (host->body(host->context, 12345, &none) != AMBF_NO_OBJECT) return AMBF_FAILED;
    if (host->body(host->context, 0, 0) != AMBF_REFUSED) return AMBF_FAILED;
    if (host->text(host->context, 0, AMBF_BODY, (uint64_t)self->body, name, 2) != 4) return AMBF_FAILED;
    if (strcmp(name, "Ba") != 0) return AMBF_FAILED;
    self->updates++;
    return AMBF_DONE;
}

static int32_t reset(void *instance) { ((holder *)instance)->resets++; return AMBF_DONE; }
static int32_t model(void *instance, uint32_t added, uint64_t i) { (void)i; ((holder *)instance)->models += added; return AMBF_DONE; }
static int32_t object(void *instance, uint32_t added, uint32_t kind, uint64_t i) {
    (void)kind; (void)i; ((holder *)instance)->objects += added; return AMBF_DONE;
}

static int32_t stop(void *instance) {
    holder *self = instance;
    ambf_clock clock;
    /* Here the simulation is out of reach. */
    if (self->host->clock(self->host->context, &clock) != AMBF_OUTSIDE) say(self->host, "clock in close");
    if (self->updates == 100 && self->resets == 1 && self->models == 2 && self->objects >= 1) say(self->host, "all was seen");
    return AMBF_DONE;
}

static void destroy(ambf_plugin *plugin) { say(((holder *)plugin)->host, "destroyed"); free(plugin); }

ambf_plugin *ambf_plugin_create(uint32_t kind, const ambf_host *host) {
    holder *self;
    if (kind != AMBF_WORLD) return NULL;
    self = calloc(1, sizeof *self);
    self->host = host;
    self->table.instance = self;
    self->table.init = start;
    self->table.physics_update = update;
    self->table.reset = reset;
    self->table.model_changed = model;
    self->table.object_changed = object;
    self->table.close = stop;
    self->table.destroy = destroy;
    return &self->table;
}
"#;

#[test]
fn a_plugin_in_c_works_through_the_same_interface() {
    let stage = Stage::new();
    compiled(&stage, "holder", &format!("{VERSION}{HOLDER}"));
    let world = "gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\nplugins: [{name: holder, filename: libholder.so, path: .}]\n";
    let model = "bodies: [BODY Ball]\nBODY Ball: {name: Ball, mass: 2, collision shape: Sphere, collision geometry: {radius: 0.1}}\n";
    let mut simulation = stage.scene(world, &[model]);
    let setup = PluginSetup { arguments: vec!["test".into(), "--own".into()], ..stage.setup() };
    let report = simulation.load_plugins(setup);
    assert_eq!(report.problems, Vec::<String>::new());
    simulation.reset_world();
    for _ in 0..100 {
        simulation.iterate(0.001).unwrap();
    }
    let scene = simulation.scene();
    let fallen = scene.bodies[BodyId::new(0)].pose(&scene.world).translation.vector.z;
    // Only the first step is not carried.
    assert!((fallen + 0.001).abs() < 2e-4, "{fallen}");
    simulation.close_plugins();
    assert_eq!(said(&mut simulation), ["plugin holder: all was seen", "plugin holder: destroyed"]);
}

/// A simulator plugin that shows things at its start and takes them away at a reset.
const SHOWER: &str = r#"
typedef struct { ambf_plugin table; const ambf_host *host; } shower;

static int32_t start(void *instance, const ambf_init *init) {
    const ambf_host *host = ((shower *)instance)->host;
    static const double line[2][3] = {{0, 0, 0}, {0, 0, 1}};
    ambf_drawing both[2] = {0}, strange = {0};
    (void)init;
    both[0].shape = AMBF_SHOW_LINES;
    both[0].window = 2;
    both[0].color[3] = 1;
    both[0].points = line;
    both[0].point_count = 2;
    both[1].shape = AMBF_SHOW_TEXT_PIXELS;
    both[1].numbers[0] = 10;
    both[1].numbers[2] = 20;
    both[1].text = (ambf_text){"hello", 5};
    strange.shape = 1000;
    if (host->show(host->context, both, 2) != 0) return AMBF_FAILED;
    if (host->show(host->context, &strange, 1) != AMBF_UNKNOWN) return AMBF_FAILED;
    if (host->show(host->context, 0, 1) != AMBF_REFUSED) return AMBF_FAILED;
    if (host->show(host->context, both, 1000000) != AMBF_TOO_MUCH) return AMBF_FAILED;
    return AMBF_DONE;
}

static int32_t reset(void *instance) {
    const ambf_host *host = ((shower *)instance)->host;
    return host->show(host->context, 0, 0) == 0 ? AMBF_DONE : AMBF_FAILED;
}

static void destroy(ambf_plugin *plugin) { free(plugin); }

ambf_plugin *ambf_plugin_create(uint32_t kind, const ambf_host *host) {
    shower *self = kind == AMBF_SIMULATOR ? calloc(1, sizeof *self) : NULL;
    if (!self) return NULL;
    self->host = host;
    self->table = (ambf_plugin){.instance = self, .init = start, .reset = reset, .destroy = destroy};
    return &self->table;
}
"#;

#[test]
fn a_plugin_in_c_shows_texts_and_markers_until_it_is_closed() {
    let stage = Stage::new();
    let library = compiled(&stage, "shower", &format!("{VERSION}{SHOWER}"));
    let mut simulation = stage.scene("gravity: {x: 0, y: 0, z: 0}\n", &[]);
    let link = simulation.window_link();
    let setup = || PluginSetup { command_line: vec![library.clone()], ..stage.setup() };
    assert_eq!(simulation.load_plugins(setup()).problems, Vec::<String>::new());
    let shown = link.drawings().read();
    let [drawings] = shown.as_slice() else { panic!("{shown:?}") };
    let line = vec![Vector3::zeros(), Vector3::z()];
    assert_eq!((drawings[0].window, &drawings[0].shape), (2, &DrawingShape::Lines(line)));
    let place = TextPlace::Pixels(10.0, 0.0);
    let text = DrawingShape::Text { text: "hello".into(), place, height: 20.0, panel: None };
    assert_eq!((drawings.len(), drawings[1].window, &drawings[1].shape), (2, 0, &text));
    simulation.reset_world();
    assert!(link.drawings().read().is_empty(), "it shows nothing any more");
    assert_eq!(simulation.load_plugins(setup()).problems, Vec::<String>::new());
    assert_eq!(link.drawings().read().len(), 1);
    simulation.close_plugins();
    assert!(link.drawings().read().is_empty(), "it is closed");
}

/// What plugins have said, without that they are slow, which they may be on a busy machine.
fn said(simulation: &mut Simulation) -> Vec<String> {
    let mut notices = simulation.take_notices();
    notices.retain(|notice| !notice.contains(" is slow: "));
    notices
}

#[test]
fn a_library_of_version_1_works_as_before() {
    let stage = Stage::new();
    let old = VERSION.replace("return AMBF_PLUGIN_ABI_VERSION", "return 1");
    compiled(&stage, "holder", &format!("{old}{HOLDER}"));
    let world = "gravity: {x: 0, y: 0, z: -10}\nplugins: [{name: holder, filename: libholder.so, path: .}]\n";
    let model = "bodies: [BODY Ball]\nBODY Ball: {name: Ball, mass: 2, collision shape: Sphere, collision geometry: {radius: 0.1}}\n";
    let mut simulation = stage.scene(world, &[model]);
    let setup = PluginSetup { arguments: vec!["test".into(), "--own".into()], ..stage.setup() };
    assert_eq!(simulation.load_plugins(setup).problems, Vec::<String>::new());
    simulation.reset_world();
    for _ in 0..100 {
        simulation.iterate(0.001).unwrap();
    }
    simulation.close_plugins();
    assert_eq!(said(&mut simulation), ["plugin holder: all was seen", "plugin holder: destroyed"]);
}

#[test]
fn the_c_example_of_the_guide_lifts_its_body() {
    let stage = Stage::new();
    let guide = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/plugins.md")).unwrap();
    let example = guide.split("```c\n").map(|rest| rest.split("```").next().unwrap());
    let example = example.into_iter().find(|code| code.starts_with("#include <stdlib.h>")).expect("the example");
    let library = compiled(&stage, "lift", example);
    let model = format!(
        "bodies: [BODY Ball]\nBODY Ball: {{name: Ball, mass: 1, collision shape: Sphere, collision geometry: {{radius: 0.1}}, \
         plugins: [{{name: lift, filename: {}}}]}}\n",
        library.display()
    );
    let mut simulation = stage.simulation("gravity: {x: 0, y: 0, z: -9.8}\nmax iterations: 50\n", &[&model]);
    for _ in 0..100 {
        simulation.iterate(0.001).unwrap();
    }
    let scene = simulation.scene();
    let fallen = scene.bodies[BodyId::new(0)].pose(&scene.world).translation.vector.z;
    // One step of free fall, then carried.
    assert!((fallen + 9.8 * 0.001 * 0.1).abs() < 1e-4, "{fallen}");
}

fn with_faulty(stage: &Stage, library: &Path, world_handle: &str, simulator_handle: &str) -> (Simulation, Vec<String>) {
    let entry = |handle: &str| format!("plugins: [{{name: {handle}, filename: {}}}]\n", library.display());
    let mut simulation = stage.scene(&format!("gravity: {{x: 0, y: 0, z: 0}}\n{}", entry(world_handle)), &[]);
    let launch = stage.write("launch.yaml", &entry(simulator_handle));
    let (launch, _) = ambf_core::adf::load::<ambf_core::adf::Launch>(&launch).unwrap();
    let report = simulation.load_plugins(PluginSetup { launch: launch.plugins, ..stage.setup() });
    (simulation, report.problems)
}

#[test]
fn a_panic_in_a_library_never_leaves_it() {
    let (stage, library) = (Stage::new(), library_of("faulty_plugin"));
    for what in
        ["init", "physics_update", "reset", "graphics_update", "keyboard_update", "on_object_add", "close", "drop"]
    {
        let handle = format!("panics in {what}");
        let (mut simulation, problems) = with_faulty(&stage, &library, &handle, &handle);
        let mut notices = Vec::new();
        for _ in 0..4 {
            simulation.iterate(0.001).unwrap();
            simulation.reset_world();
            simulation.plugins_after_picture();
            simulation.plugins_input(&Input::Key { window: 0, key: 65, scancode: 0, action: 1, mods: 0 });
            notices.extend(simulation.take_notices());
        }
        simulation.close_plugins();
        notices.extend(simulation.take_notices());
        let said = |part: &str| notices.iter().filter(|notice| notice.contains(part)).count();
        match what {
            "init" => {
                assert_eq!(problems.len(), 2, "{problems:?}");
                assert!(problems[0].ends_with("it panicked at its start: as told in init"), "{problems:?}");
                assert_eq!(said(": close"), 0, "it is not closed: {notices:?}");
            }
            "on_object_add" => {
                // The light and the camera of every world, before the first step.
                assert_eq!(said("panicked in on_object_add (2 of 3)"), 1, "{notices:?}");
            }
            "close" => assert_eq!(said("panicked in close: as told in close"), 2, "{notices:?}"),
            "drop" => assert_eq!(said("it panicked when it was dropped: as told in drop"), 2, "{notices:?}"),
            _ => {
                assert!(said(&format!("panicked in {what} (3 of 3): as told in {what}")) >= 1, "{what}: {notices:?}");
                assert!(said("is closed because it panicked 3 times") >= 1, "{notices:?}");
            }
        }
        if what != "init" {
            assert_eq!(problems, Vec::<String>::new());
            assert_eq!(said(": close"), 2, "each is closed once: {notices:?}");
        }
    }
}

#[test]
fn what_a_library_says_about_its_start_is_passed_on() {
    let (stage, library) = (Stage::new(), library_of("faulty_plugin"));
    let (simulation, problems) = with_faulty(&stage, &library, "an error", "good");
    let [problem] = problems.as_slice() else { panic!("{problems:?}") };
    assert!(problem.ends_with("it cannot start: as told"), "{problem}");
    drop(simulation);
}
