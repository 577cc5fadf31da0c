//! Compiles the C++ half of the engine against the internal headers of bullet-sys and generates its Rust side.

use std::env;
use std::path::{Path, PathBuf};
use std::process::exit;

fn main() {
    println!("cargo:rerun-if-changed=cpp");
    println!("cargo:rerun-if-env-changed=LIBCLANG_PATH");
    let shim = from_bullet_sys("INCLUDE");
    println!("cargo:rerun-if-changed={shim}");

    let mut sources: Vec<PathBuf> = Path::new("cpp")
        .read_dir()
        .and_then(|dir| dir.map(|entry| entry.map(|entry| entry.path())).collect())
        .unwrap_or_else(|error| fail(&format!("cannot list cpp/: {error}")));
    sources.retain(|path| path.extension().is_some_and(|extension| extension == "cpp"));
    sources.sort();

    let mut build = cc::Build::new();
    build.cpp(true).std("c++17").warnings(true).include("cpp").include(&shim).files(sources);
    // -isystem keeps Bullet's own warnings quiet.
    for path in env::split_paths(&from_bullet_sys("SYSTEM_INCLUDE")) {
        build.flag("-isystem").flag(path);
    }
    for define in from_bullet_sys("DEFINES").split_whitespace() {
        let (name, value) = define.split_once('=').map_or((define, None), |(name, value)| (name, Some(value)));
        build.define(name, value);
    }
    // Its symbols are resolved by bullet-sys, which is linked after it.
    build.flag("-Wno-unused-parameter").compile("ambf_dynamics_cpp");

    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    bindgen::Builder::default()
        .header("cpp/dynamics.h")
        .allowlist_function("amb_.*")
        .allowlist_type("Amb.*")
        // Those are bullet-sys' own bindings.
        .blocklist_file(".*/shim/.*")
        .default_enum_style(bindgen::EnumVariation::ModuleConsts)
        .derive_default(true)
        .layout_tests(false)
        .clang_args(["-x", "c", "-I", &shim])
        .generate()
        .unwrap_or_else(|error| fail(&format!("bindgen needs libclang; install Debian's libclang1-14\n{error}")))
        .write_to_file(out.join("bindings.rs"))
        .unwrap_or_else(|error| fail(&format!("cannot write the bindings: {error}")));
}

/// What the build script of bullet-sys tells about itself.
fn from_bullet_sys(key: &str) -> String {
    let name = format!("DEP_BULLET_FLOAT64_{key}");
    env::var(&name).unwrap_or_else(|_| fail(&format!("{name} is not set; the build script of bullet-sys sets it")))
}

fn fail(sentence: &str) -> ! {
    eprintln!("ambf-dynamics: {sentence}");
    exit(1)
}
