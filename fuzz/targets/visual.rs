//! OBJ meshes with material libraries from any bytes: the library before a line `=====`, the mesh behind it.
#![no_main]

mod mesh;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    const BAR: &[u8] = b"\n=====\n";
    let bar = data.windows(BAR.len()).position(|window| window == BAR);
    let (library, mesh) = bar.map_or((&[][..], data), |bar| (&data[..bar], &data[bar + BAR.len()..]));
    // Each library that is named is this one; pictures are there.
    let named = |path: &std::path::Path| match path.extension() {
        Some(extension) if extension == "mtl" => Some(library.to_vec()),
        extension => extension.map(|_| Vec::new()),
    };
    mesh::check_visual(mesh, "m.obj", &named);
});
