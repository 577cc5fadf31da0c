//! Volumes from files and back: stacks of pictures with their traps, NRRD in all its forms.

use std::io::Write;
use std::path::Path;

use ambf_model::adf::ImageStack;
use ambf_volume::{nrrd, save, stack, Coloring, Label, Voxel, VoxelGrid};
use image::{DynamicImage, ImageBuffer, Luma, LumaA, Rgb, RgbImage, Rgba, RgbaImage};
use nalgebra::{Isometry3, Vector3};

fn images(folder: &Path, count: u32) -> ImageStack {
    ImageStack { path: folder.into(), prefix: "p".into(), format: "png".into(), count }
}

fn read(folder: &Path, count: u32) -> Result<VoxelGrid, stack::StackError> {
    stack::read(&images(folder, count), Vector3::repeat(0.01), 0.5, &|_, _| {})
}

#[test]
fn a_marked_pixel_is_found_where_clients_expect_it() {
    let folder = tempfile::tempdir().expect("a folder");
    for z in 0..7 {
        let mut slice = RgbaImage::new(12, 10);
        slice.put_pixel(0, 0, Rgba([9, 8, 7, 200]));
        if z == 5 {
            slice.put_pixel(3, 2, Rgba([10, 20, 30, 255]));
        }
        slice.save(folder.path().join(format!("p{z}.png"))).expect("a picture");
    }
    // The number of files is only an upper bound.
    let grid = read(folder.path(), 512).expect("a volume");
    assert_eq!((grid.size(), grid.coloring()), ([12, 10, 7], Coloring::Labels));
    assert_eq!(grid.color([3, 7, 5]), Some([10, 20, 30, 255]));
    assert_eq!(grid.color([0, 9, 3]), Some([9, 8, 7, 200]));
    assert_eq!(grid.color([1, 9, 3]), Some([0; 4]));
    assert_eq!(grid.count_solid(), 8);
    // Fewer than there are: the C++ program reads one more than it counts.
    assert_eq!(read(folder.path(), 3).expect("a volume").size(), [12, 10, 4]);
}

#[test]
fn all_kinds_of_pictures_have_their_density() {
    let kinds: [(DynamicImage, [u8; 4], u8, Coloring); 6] = [
        (ImageBuffer::from_pixel(9, 9, Luma([77_u8])).into(), [77, 77, 77, 255], 77, Coloring::Grey),
        (ImageBuffer::from_pixel(9, 9, Luma([0x8080_u16])).into(), [128, 128, 128, 255], 128, Coloring::Grey),
        (ImageBuffer::from_pixel(9, 9, LumaA([50_u8, 60])).into(), [50, 50, 50, 60], 60, Coloring::Labels),
        (ImageBuffer::from_pixel(9, 9, Rgb([1_u8, 90, 3])).into(), [1, 90, 3, 255], 90, Coloring::Opaque),
        (ImageBuffer::from_pixel(9, 9, Rgba([1_u8, 2, 3, 40])).into(), [1, 2, 3, 40], 40, Coloring::Labels),
        (
            ImageBuffer::from_pixel(9, 9, Rgba([1_u16 << 8, 2 << 8, 3 << 8, 0x2828])).into(),
            [1, 2, 3, 40],
            40,
            Coloring::Labels,
        ),
    ];
    for (picture, color, density, coloring) in kinds {
        let folder = tempfile::tempdir().expect("a folder");
        // Leading zeros, and a second spelling of the same number, which is not another picture.
        for name in ["p00.png", "p0.png", "p03.png"] {
            picture.save(folder.path().join(name)).expect("a picture");
        }
        let grid = read(folder.path(), 10).expect("a volume");
        assert_eq!((grid.size(), grid.coloring()), ([9, 9, 2], coloring));
        assert_eq!(grid.color([4, 4, 1]), Some(color));
        assert_eq!(grid.voxel([4, 4, 1]).map(|voxel| voxel.density), Some(density));
    }
}

#[test]
fn stacks_that_cannot_be_are_refused_with_the_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let message = |error: stack::StackError| error.to_string();
    let none = message(read(folder.path(), 3).expect_err("nothing is there"));
    assert!(none.contains("no picture is there") && none.contains("p0.png"), "{none}");
    RgbImage::new(4, 5).save(folder.path().join("p0.png")).expect("a picture");
    RgbImage::new(5, 4).save(folder.path().join("p7.png")).expect("a picture");
    let sizes = message(read(folder.path(), 9).expect_err("they differ"));
    assert!(sizes.contains("p7.png has 5 x 4") && sizes.contains("4 x 5"), "{sizes}");
    std::fs::write(folder.path().join("p3.png"), "no").expect("a file");
    let broken = message(read(folder.path(), 5).expect_err("it is no picture"));
    assert!(broken.contains("p3.png"), "{broken}");
    let huge = VoxelGrid::new([4000; 3], Vector3::repeat(1.0), 0.5).expect_err("too large").to_string();
    assert!(huge.contains("MiB"), "{huge}");
    VoxelGrid::new([0, 1, 1], Vector3::repeat(1.0), 0.5).expect_err("empty");
    VoxelGrid::new([1; 3], Vector3::new(1.0, 0.0, 1.0), 0.5).expect_err("flat");
}

/// Colours in layers, with empty and half dense voxels if `partial`.
fn phantom(partial: bool) -> VoxelGrid {
    let labels = [[10, 20, 30], [40, 50, 60], [200, 10, 0]].map(Label::of_color).to_vec();
    VoxelGrid::from_fn([21, 18, 35], Vector3::new(0.021, 0.027, 0.07), 0.5, labels, |[i, j, k]| {
        match (i / 5 + j / 7 + k / 11) % 5 {
            0 => Voxel::default(),
            4 if partial => Voxel { density: 90, label: 2 },
            n => Voxel { density: 255, label: n.min(3) as u8 },
        }
    })
    .expect("a grid")
}

#[test]
fn what_is_saved_is_read_again() {
    let folder = tempfile::tempdir().expect("a folder");
    for partial in [false, true] {
        let grid = phantom(partial);
        let slices = folder.path().join(format!("slices{partial}"));
        assert_eq!(save::pictures(&grid, &slices, "p").expect("it is saved"), 35);
        let again = stack::read(&images(&slices, 35), grid.edges(), 0.5, &|_, _| {}).expect("it is read");
        assert!(again == grid);
        let file = folder.path().join("v.nrrd");
        let pose = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.2, 0.4, -0.6));
        nrrd::write(&grid, &file, &pose).expect("it is saved");
        let read = nrrd::read(&file, 0.5).expect("it is read");
        assert!((read.pose.to_homogeneous() - pose.to_homogeneous()).norm() < 1e-12);
        assert!((read.grid.spacing() - grid.spacing()).norm() < 1e-15);
        assert_eq!(read.grid.to_rgba(), grid.to_rgba());
    }
    // Grey and opaque pictures, and more colours than labels.
    for kind in 0..3 {
        let slices = folder.path().join(format!("kind{kind}"));
        std::fs::create_dir(&slices).expect("a folder");
        for z in 0..9_u8 {
            let path = slices.join(format!("p{z}.png"));
            match kind {
                0 => ImageBuffer::from_fn(20, 20, |x, y| Luma([(x * 12 + y) as u8])).save(path),
                1 => RgbImage::from_fn(20, 20, |x, y| Rgb([if x < 9 { 0 } else { 9 }, y as u8, 0])).save(path),
                _ => RgbaImage::from_fn(20, 20, |x, y| Rgba([x as u8, y as u8, z, 255 * u8::from(x > 2)])).save(path),
            }
            .expect("a picture");
        }
        let grid = read(&slices, 9).expect("it is read");
        if kind == 2 {
            assert_eq!(grid.color([7, 0, 4]), Some([7, 19, 4, 255]));
        }
        let again = folder.path().join(format!("again{kind}"));
        save::pictures(&grid, &again, "p").expect("it is saved");
        let again = stack::read(&images(&again, 9), grid.edges(), 0.5, &|_, _| {}).expect("it is read");
        assert!(again == grid, "{kind}");
        if kind < 2 {
            let file = folder.path().join("kind.nrrd");
            nrrd::write(&grid, &file, &Isometry3::identity()).expect("it is saved");
            assert_eq!(nrrd::read(&file, 0.5).expect("it is read").grid.to_rgba(), grid.to_rgba(), "{kind}");
        }
    }
    for name in ["m.stl", "m.ply", "m.nrrd"] {
        let pose = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.2, 0.4, -0.6));
        let path = folder.path().join(name);
        save::save(&phantom(true), &path, "p", &pose).expect("it is saved");
        if name == "m.nrrd" {
            let read = nrrd::read(&path, 0.5).expect("it is read");
            assert!((read.pose.to_homogeneous() - pose.to_homogeneous()).norm() < 1e-12);
        }
    }
    let ply = ambf_model::mesh::load(&folder.path().join("m.ply")).expect("a mesh");
    let stl = ambf_model::mesh::load(&folder.path().join("m.stl")).expect("a mesh");
    let triangles =
        |mesh: &ambf_model::mesh::Mesh| mesh.sub_meshes.iter().map(|part| part.triangles.len()).sum::<usize>();
    assert_eq!(triangles(&ply), phantom(true).mesh().triangles.len());
    assert_eq!(triangles(&stl), triangles(&ply));
    save::save(&phantom(true), &folder.path().join("m.xyz"), "p", &Isometry3::identity()).expect_err("no such format");
}

/// Bytes of −3, 2, 7 … of a type.
fn numbers(kind: &str, big: bool, count: usize) -> Vec<u8> {
    let mut out = Vec::new();
    for at in 0..count {
        let value = 5 * at as i64;
        macro_rules! put {
            ($type:ty) => {
                if big {
                    out.extend((value as $type).to_be_bytes())
                } else {
                    out.extend((value as $type).to_le_bytes())
                }
            };
        }
        match kind {
            "int8" => put!(i8),
            "uchar" => put!(u8),
            "short" => put!(i16),
            "uint16_t" => put!(u16),
            "int" => put!(i32),
            "unsigned int" => put!(u32),
            "long long int" => put!(i64),
            "uint64" => put!(u64),
            "float" => put!(f32),
            "double" => put!(f64),
            _ => panic!("{kind}"),
        }
    }
    out
}

#[test]
fn all_types_encodings_and_byte_orders_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let kinds =
        ["int8", "uchar", "short", "uint16_t", "int", "unsigned int", "long long int", "uint64", "float", "double"];
    for kind in kinds {
        for big in [false, true] {
            for encoding in ["raw", "gzip", "ascii"] {
                for detached in [false, true] {
                    let data = match encoding {
                        "ascii" => (0..24).map(|at| format!("{} ", 5 * at)).collect::<String>().into_bytes(),
                        "raw" => numbers(kind, big, 24),
                        _ => {
                            let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
                            gzip.write_all(&numbers(kind, big, 24)).expect("memory");
                            gzip.finish().expect("memory")
                        }
                    };
                    let endian = if big { "big" } else { "little" };
                    let mut file = format!("NRRD0005\r\n# a comment\ntype: {kind}\ndimension: 3\nspace: RAS\nsizes: 4 3 2\nendian: {endian}\nencoding: {encoding}\nspace directions: (0.5,0,0) (0,0.5,0) (0,0,2)\nspace origin: (1,2,3)\n").into_bytes();
                    if detached {
                        file.extend(b"data file: v.raw\n");
                        std::fs::write(folder.path().join("v.raw"), &data).expect("a file");
                    } else {
                        file.push(b'\n');
                        file.extend(&data);
                    }
                    let path = folder.path().join("v.nhdr");
                    std::fs::write(&path, &file).expect("a file");
                    let read =
                        nrrd::read(&path, 0.5).unwrap_or_else(|error| panic!("{kind} {encoding} {big}: {error}"));
                    // 0 to 115 are spread; bytes stay.
                    let spread = if kind == "uchar" { 1.0 } else { 255.0 / 115.0 };
                    for (at, index) in [(0, [0, 0, 0]), (7, [3, 1, 0]), (23, [3, 2, 1])] {
                        let density = (f64::from(5 * at) * spread).round() as u8;
                        assert_eq!(read.grid.voxel(index).map(|voxel| voxel.density), Some(density), "{kind} {at}");
                    }
                    assert!((read.grid.spacing() - Vector3::new(0.5e-3, 0.5e-3, 2e-3)).norm() < 1e-15);
                    // RAS is half a turn about z from LPS; the origin is the centre of the first voxel.
                    let first = read.pose * read.grid.center([0, 0, 0]);
                    assert!((first.coords - Vector3::new(-1e-3, -2e-3, 3e-3)).norm() < 1e-12, "{first}");
                }
            }
        }
    }
}

#[test]
fn segments_have_names_and_colours() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.seg.nrrd");
    let mut file = String::from("NRRD0004\ntype: unsigned char\ndimension: 4\nspace: left-posterior-superior\nsizes: 2 2 1 2\nspace directions: none (1,0,0) (0,1,0) (0,0,1)\nkinds: list domain domain domain\nencoding: raw\nspace origin: (0,0,0)\nSegment0_ID:=Segment_1\nSegment0_Name:=Bone, cortical\nSegment0_Color:=1 0.5 0\nSegment0_LabelValue:=1\nSegment0_Layer:=0\nSegment1_ID:=Segment_2\nSegment1_Name:=Facial nerve\nSegment1_Color:=1 1 0\nSegment1_LabelValue:=1\nSegment1_Layer:=1\nSegment1_Hardness:=0.5\n\n").into_bytes();
    file.extend([1, 0, 0, 0, 1, 1, 0, 1]);
    std::fs::write(&path, file).expect("a file");
    let grid = nrrd::read(&path, 0.5).expect("it is read").grid;
    let nerve = grid.label_named("Facial nerve").expect("it is named");
    assert_eq!(grid.labels()[1].color, [255, 128, 0]);
    assert_eq!(grid.labels()[usize::from(nerve)].hardness, 0.5);
    let labels: Vec<_> =
        [[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]].map(|index| grid.voxel(index).unwrap().label).into();
    assert_eq!(labels, [1, 0, nerve, nerve]);
    let saved = folder.path().join("again.nrrd");
    nrrd::write(&grid, &saved, &Isometry3::identity()).expect("it is saved");
    assert!(nrrd::read(&saved, 0.5).expect("it is read").grid == grid);
}

#[test]
fn wrong_nrrd_files_are_refused_with_a_line() {
    let parse = |text: &str| {
        nrrd::parse(text.as_bytes(), 0.5, Path::new("v.nrrd"), &|_| Err(std::io::ErrorKind::NotFound.into()))
            .expect_err(text)
            .to_string()
    };
    let good = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n\n";
    for (from, to, expected) in [
        ("NRRD0004", "NRRD0009", "v.nrrd:1: no NRRD file"),
        ("uchar", "block", "v.nrrd:2: type: expected an integer"),
        ("dimension: 3", "dimension: 2", "v.nrrd:3: dimension"),
        ("2 2 2", "2 2", "dimension"),
        ("2 2 2", "2 2 x", "v.nrrd:4: sizes: expected whole numbers"),
        ("2 2 2", "2 0 2", "empty"),
        ("2 2 2", "4000 4000 4000", "MiB"),
        ("2 2 2", "99999999999 99999999999 99999999999", "MiB"),
        ("2 2 2", "32768 32768 1", "bricks"),
        ("3\nsizes: 2 2 2", "4\nsizes: 16 1000 1000 1000", "v.nrrd:4: sizes: expected at most 8 GiB"),
        ("raw\n", "raw\nspace: left-posterior-inferior\n", "v.nrrd:6: space: expected left-posterior-superior"),
        ("raw\n", "gzip\nbyte skip: -1\n", "byte skip"),
        ("2 2 2", "1000 1000 1000", "1000000000 were expected"),
        ("raw", "bzip2", "v.nrrd:5: encoding: expected raw, gzip or ascii"),
        ("raw", "ascii", "8 were expected"),
        ("raw", "gzip", "v.nrrd"),
        ("raw\n", "raw\ndata file: LIST\n", "the name of one file"),
        ("raw\n", "raw\ndata file: there\n", "v.nrrd:6"),
        ("raw\n", "raw\nbyte skip: 1000\n", "byte skip"),
        ("raw\n", "raw\nspace directions: (0,0,0) (0,1,0) (0,0,1)\n", "space directions"),
        ("raw\n", "raw\nspace directions: (1,0,0) (1,0,0) (0,0,1)\n", "space directions"),
        ("encoding: raw\n", "", "`encoding` is missing"),
    ] {
        assert!(good.contains(from), "{from}");
        let mut text = good.replacen(from, to, 1);
        if !to.contains("1000 1000") && !to.contains("ascii") {
            text += "12345678";
        }
        let message = parse(&text);
        assert!(message.contains(expected), "{message}, expected {expected}");
    }
    let endless = format!("NRRD0004\n{}", "#aaaaaaaa\n".repeat(200_000));
    assert!(parse(&endless).contains("the header has no end"));
    // All that can be cut off or changed ends in an error or a grid.
    let mut state = 9_u64;
    for length in 0..good.len() {
        let _ = nrrd::parse(&good.as_bytes()[..length], 0.5, Path::new("v"), &|_| Ok(Vec::new()));
        let mut changed = format!("{good}12345678").into_bytes();
        for _ in 0..40 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            changed[length] = (state >> 40) as u8;
            let _ = nrrd::parse(&changed, 0.5, Path::new("v"), &|_| Ok(vec![0; 8]));
        }
    }
}

#[test]
fn left_handed_axes_are_not_mirrored() {
    // Each sample is where its file says, in each space, with each sign of each axis.
    for space in ["LPS", "right-anterior-superior", "left anterior superior"] {
        let to_lps = match space {
            "LPS" => Vector3::new(1.0, 1.0, 1.0),
            "left anterior superior" => Vector3::new(1.0, -1.0, 1.0),
            _ => Vector3::new(-1.0, -1.0, 1.0),
        };
        for signs in 0..8 {
            let sign = |axis: usize| if signs >> axis & 1 == 1 { -1.0 } else { 1.0 };
            let axes = [Vector3::y() * sign(0), Vector3::x() * 2.0 * sign(1), Vector3::z() * 3.0 * sign(2)];
            let text = axes.map(|axis| format!("({},{},{})", axis.x, axis.y, axis.z)).join(" ");
            let mut file = format!("NRRD0004\ntype: uchar\ndimension: 3\nspace: {space}\nsizes: 2 3 4\nspace directions: {text}\nspace origin: (5,6,7)\nencoding: raw\n\n").into_bytes();
            file.extend(1..=24);
            let read = nrrd::parse(&file, 0.0, Path::new("v"), &|_| Ok(Vec::new())).expect("it is read");
            let mut samples = 1..=24_u8;
            for (k, j, i) in (0..4).flat_map(|k| (0..3).flat_map(move |j| (0..2).map(move |i| (k, j, i)))) {
                let there = Vector3::new(5.0, 6.0, 7.0)
                    + axes[0] * f64::from(i)
                    + axes[1] * f64::from(j)
                    + axes[2] * f64::from(k);
                let there = there.component_mul(&to_lps) * 1e-3;
                let local = read.pose.inverse_transform_point(&there.into());
                let index = read.grid.index_at(&local).expect("in the box");
                assert!((read.grid.center(index) - local).norm() < 1e-12, "{space} {signs}");
                assert_eq!(read.grid.voxel(index).map(|voxel| voxel.density), samples.next(), "{space} {signs}");
            }
        }
    }
}

#[test]
fn one_value_and_the_largest_span_have_densities() {
    let density = |kind: &str, words: &str| {
        let text = format!("NRRD0004\ntype: {kind}\ndimension: 3\nsizes: 3 1 1\nencoding: ascii\n\n{words}\n");
        let read = nrrd::parse(text.as_bytes(), 0.5, Path::new("v"), &|_| Ok(Vec::new())).expect("it is read");
        [0, 1, 2].map(|i| read.grid.voxel([i, 0, 0]).map(|voxel| voxel.density).expect("inside"))
    };
    assert_eq!(density("short", "-3 -3 -3"), [255; 3]);
    assert_eq!(density("float", "0 0 0"), [0; 3]);
    assert_eq!(density("float", "2 nan 2"), [255, 0, 255]);
    assert_eq!(density("double", "-1.7e308 0 1.7e308"), [0, 128, 255]);
}

#[test]
fn what_is_skipped_in_packed_data_is_not_held() {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(&vec![9; 1 << 20]).expect("memory");
    gzip.write_all(&[1, 2, 3, 4, 5, 6, 7, 8]).expect("memory");
    let data = gzip.finish().expect("memory");
    let read = |skip: u64| {
        let head = format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nencoding: gzip\nbyte skip: {skip}\n\n");
        nrrd::parse(&[head.as_bytes(), &data].concat(), 0.5, Path::new("v"), &|_| Ok(Vec::new()))
    };
    let grid = read(1 << 20).expect("it is read").grid;
    assert_eq!(grid.to_arrays().0, [1, 2, 3, 4, 5, 6, 7, 8]);
    assert!(read(i64::MAX as u64).expect_err("too much").to_string().contains("byte skip"));
    assert!(read(0).expect_err("too long").to_string().contains("8 were expected"));
}
