//! NRRD files from any bytes; what stands behind a line `=====` is the file of data that a header may name.
#![no_main]

use std::path::Path;

use ambf_volume::nrrd;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    const APART: &[u8] = b"\n=====\n";
    let at = data.windows(APART.len()).position(|bytes| bytes == APART);
    let (file, beside) = at.map_or((data, &[][..]), |at| (&data[..at], &data[at + APART.len()..]));
    match nrrd::parse(file, 0.5, Path::new("v.nrrd"), &|_| Ok(beside.to_vec())) {
        Ok(read) => {
            let grid = &read.grid;
            assert!(grid.edges().iter().all(|edge| edge.is_finite() && *edge > 0.0));
            assert!(read.pose.to_homogeneous().iter().all(|number| number.is_finite()));
            let voxels = grid.size().iter().product::<usize>();
            assert_eq!(grid.to_rgba().len(), 4 * voxels);
            assert!(grid.count_solid() <= voxels);
        }
        Err(error) => {
            let message = error.to_string();
            assert!(message.starts_with("v.nrrd") && message.len() < 1000, "{message}");
        }
    }
});
