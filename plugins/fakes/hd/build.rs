//! Compiles the fake library, a copy of it without one symbol, and the C program that checks its interface.

use std::env;
use std::path::{Path, PathBuf};
use std::process::exit;

const SOURCES: [&str; 3] = ["c/control.c", "c/device.c", "c/scheduler.c"];

fn main() {
    println!("cargo:rerun-if-changed=c");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let library = ["-shared", "-fvisibility=hidden"];
    compile(&library, &SOURCES, &["-pthread", "-lm"], &out.join("libHD.so"));
    // As a library that is older than the driver expects.
    compile(
        &[&library[..], &["-DhdGetError=hdGetErrorOld"]].concat(),
        &SOURCES,
        &["-pthread", "-lm"],
        &out.join("libHD_old.so"),
    );
    compile(&[], &["c/abi_check.c"], &["-ldl"], &out.join("abi_check"));
}

fn compile(first: &[&str], sources: &[&str], last: &[&str], output: &Path) {
    let compiler = cc::Build::new().warnings(true).extra_warnings(true).pic(true).opt_level(2).get_compiler();
    let mut command = compiler.to_command();
    command.args(first).arg("-o").arg(output).args(sources).args(last);
    match command.status() {
        Ok(status) if status.success() => {}
        Ok(_) => fail(&format!("{command:?} failed")),
        Err(error) => fail(&format!("no C compiler: {error}; install gcc or clang")),
    }
}

fn fail(reason: &str) -> ! {
    println!("cargo:warning={reason}");
    exit(1);
}
