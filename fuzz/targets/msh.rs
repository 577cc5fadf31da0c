//! MuJoCo's meshes from any bytes.
#![no_main]

mod mesh;

libfuzzer_sys::fuzz_target!(|data: &[u8]| mesh::check(data, "m.msh"));
