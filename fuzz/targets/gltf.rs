//! glTF meshes from any bytes, as JSON and in a container.
#![no_main]

mod mesh;

libfuzzer_sys::fuzz_target!(|data: &[u8]| mesh::check(data, "m.gltf"));
