//! Finds Debian's double-precision Bullet, compiles the C shim over it and generates its Rust side.
//!
//! Crates that compile C++ against the shim's internal headers find in their own build script's environment:
//! `DEP_BULLET_FLOAT64_INCLUDE`, the folder of those headers; `DEP_BULLET_FLOAT64_SYSTEM_INCLUDE`, Bullet's folders,
//! separated by colons; and `DEP_BULLET_FLOAT64_DEFINES`, macros as `NAME` or `NAME=VALUE`, separated by blanks.

use std::env;
use std::path::{Path, PathBuf};
use std::process::exit;

/// pkg-config name of the double-precision build.
const PACKAGE: &str = "bullet-float64";

fn main() {
    println!("cargo:rerun-if-changed=shim");
    println!("cargo:rerun-if-env-changed=LIBCLANG_PATH");

    let bullet = pkg_config::Config::new().range_version("3.24".."4").probe(PACKAGE).unwrap_or_else(|error| {
        fail(&format!(
            "Bullet with double precision is missing; install Debian's libbullet-dev and pkg-config\n{error}"
        ))
    });

    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let mut sources: Vec<PathBuf> = Path::new("shim")
        .read_dir()
        .and_then(|dir| dir.map(|entry| entry.map(|entry| entry.path())).collect())
        .unwrap_or_else(|error| fail(&format!("cannot list shim/: {error}")));
    sources.retain(|path| path.extension().is_some_and(|extension| extension == "cpp"));
    sources.sort();
    if env::var_os("CARGO_FEATURE_BARE").is_some() {
        println!("cargo:rerun-if-changed=bare");
        sources.push("bare/bare.cpp".into());
    }

    let mut build = cc::Build::new();
    build.cpp(true).std("c++17").warnings(true).files(sources);
    // -isystem keeps Bullet's own warnings quiet; the bare /usr/include that pkg-config adds must not be passed on, it
    // would break the #include_next of the C++ library.
    let system: Vec<&PathBuf> = bullet.include_paths.iter().filter(|path| *path != Path::new("/usr/include")).collect();
    for path in &system {
        build.flag("-isystem").flag(path);
    }
    let mut defines = Vec::new();
    for (name, value) in &bullet.defines {
        build.define(name, value.as_deref());
        defines.push(value.as_ref().map_or_else(|| name.clone(), |value| format!("{name}={value}")));
    }
    let shim = env::current_dir().expect("cargo runs build scripts in their package").join("shim");
    println!("cargo::metadata=include={}", shim.display());
    let system =
        env::join_paths(system).unwrap_or_else(|error| fail(&format!("Bullet lies in a folder with a colon: {error}")));
    println!("cargo::metadata=system_include={}", system.display());
    defines.sort();
    println!("cargo::metadata=defines={}", defines.join(" "));
    build.flag("-Wno-unused-parameter").compile("ambf_bullet_shim");
    // After the shim, which needs them.
    for library in &bullet.libs {
        println!("cargo:rustc-link-lib={library}");
    }

    bindgen::Builder::default()
        .header("shim/shim.h")
        .allowlist_function("amb_.*")
        .allowlist_type("Amb.*")
        .default_enum_style(bindgen::EnumVariation::ModuleConsts)
        .derive_default(true)
        // Pointers and functions have no default that is not unsafe to make.
        .no_default("AmbBrickMesh|AmbVolumeSource")
        .layout_tests(false)
        .clang_args(["-x", "c"])
        .generate()
        .unwrap_or_else(|error| fail(&format!("bindgen needs libclang; install Debian's libclang1-14\n{error}")))
        .write_to_file(out.join("bindings.rs"))
        .unwrap_or_else(|error| fail(&format!("cannot write the bindings: {error}")));
}

fn fail(sentence: &str) -> ! {
    eprintln!("bullet-sys: {sentence}");
    exit(1)
}
