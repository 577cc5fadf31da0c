use super::*;
use crate::mesh::{parse_visual, VisualMesh};

fn encode(bytes: &[u8]) -> String {
    base64::engine::general_purpose::STANDARD.encode(bytes)
}

/// A file in the making: accessors over one buffer.
#[derive(Default, Clone)]
struct Draft {
    data: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Draft {
    fn view(&mut self, bytes: &[u8]) -> usize {
        self.data.resize(self.data.len().next_multiple_of(4), 0);
        let (offset, length) = (self.data.len(), bytes.len());
        self.views.push(format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length}}}"#));
        self.data.extend(bytes);
        self.views.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], kind: &str, component: u32, count: usize) -> usize {
        let view = self.view(bytes);
        let normalized = kind.starts_with("VEC") && component != 5126;
        self.accessors.push(format!(
                r#"{{"bufferView":{view},"componentType":{component},"count":{count},"type":"{kind}","normalized":{normalized}}}"#
            ));
        self.accessors.len() - 1
    }

    fn floats(&mut self, kind: &str, numbers: &[f32]) -> usize {
        let size = usize::from(kind.as_bytes()[3] - b'0');
        let bytes: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(&bytes, kind, 5126, numbers.len() / size)
    }

    fn json(&self, uri: &str, rest: &str) -> String {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{{uri}"byteLength":{}}}],
"bufferViews":[{}],
"accessors":[{}],
{rest}}}"#,
            self.data.len(),
            self.views.join(","),
            self.accessors.join(",")
        )
    }

    fn text(&self, rest: &str) -> String {
        self.json(&format!(r#""uri":"data:application/octet-stream;base64,{}","#, encode(&self.data)), rest)
    }

    fn container(&self, rest: &str) -> Vec<u8> {
        container(&self.json("", rest), &self.data)
    }
}

fn container(json: &str, data: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut data = data.to_vec();
    data.resize(data.len().next_multiple_of(4), 0);
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((28 + json.len() as u32 + data.len() as u32).to_le_bytes());
    for (kind, content) in [(b"JSON", json), (b"BIN\0", data)] {
        bytes.extend((content.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(content);
    }
    bytes
}

/// A square in the plane z = 0 of glTF, vertices counter-clockwise; its positions are accessor 0, its u8 indices
/// accessor 1.
fn square() -> Draft {
    let mut draft = Draft::default();
    draft.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0]);
    draft.accessor(&[0, 1, 2, 0, 2, 3], "SCALAR", 5121, 6);
    draft
}

/// A mesh of one primitive with these keys, and a scene of one node that places it.
fn scene(primitive: &str) -> String {
    format!(
        r#""meshes":[{{"name":"plate","primitives":[{{{primitive}}}]}}],"nodes":[{{"mesh":0}}],"scenes":[{{"nodes":[0]}}],"scene":0"#
    )
}

const TRIANGLES: &str = r#""attributes":{"POSITION":0},"indices":1"#;

fn parse(bytes: impl Into<Vec<u8>>) -> Result<Mesh, MeshError> {
    crate::mesh::parse(bytes.into(), Path::new("t.gltf"))
}

/// Looks of a file; the files `wood 1.png` and `a 1.bin` are there, the latter with the data of [`square`].
fn looks(bytes: impl Into<Vec<u8>>) -> (VisualMesh, Vec<String>) {
    let named = |path: &Path| match path.to_str()? {
        "in/wood 1.png" => Some(Vec::new()),
        "in/a 1.bin" => Some(square().data),
        _ => None,
    };
    parse_visual(bytes.into(), Path::new("in/t.gltf"), false, &named).unwrap()
}

#[test]
fn text_and_container_agree_and_z_is_up() {
    let draft = square();
    let mesh = parse(draft.text(&scene(TRIANGLES))).unwrap();
    assert_eq!(mesh.sub_meshes.len(), 1);
    let part = &mesh.sub_meshes[0];
    assert_eq!(part.name, "plate");
    assert_eq!(part.vertices, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]]);
    assert_eq!(part.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(parse(draft.container(&scene(TRIANGLES))).unwrap(), mesh);
    let (drawn, messages) = looks(draft.json(r#""uri":"a%201.bin","#, &scene(TRIANGLES)));
    assert!(messages.is_empty(), "{messages:?}");
    // Without normals there are facets, which face −y as the square faced +z.
    assert_eq!(drawn.parts[0].normals, [[0.0, -1.0, 0.0]; 6]);
    assert_eq!(drawn.parts[0].material, MeshMaterial::default());
}

#[test]
fn indices_are_of_any_type_and_modes_give_the_same_square() {
    let expected = parse(square().text(&scene(TRIANGLES))).unwrap();
    let mut draft = square();
    let wide = |numbers: &[u32]| numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let narrow = |numbers: &[u16]| numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let u16s = draft.accessor(&narrow(&[0, 1, 2, 0, 2, 3]), "SCALAR", 5123, 6);
    let u32s = draft.accessor(&wide(&[0, 1, 2, 0, 2, 3]), "SCALAR", 5125, 6);
    for indices in [u16s, u32s] {
        let primitive = format!(r#""attributes":{{"POSITION":0}},"indices":{indices}"#);
        assert_eq!(parse(draft.text(&scene(&primitive))).unwrap(), expected);
    }
    let fan = scene(r#""attributes":{"POSITION":0},"mode":6"#);
    assert_eq!(parse(draft.text(&fan)).unwrap(), expected);
    let strip = draft.accessor(&[1, 2, 0, 3], "SCALAR", 5121, 4);
    let strip = scene(&format!(r#""attributes":{{"POSITION":0}},"indices":{strip},"mode":5"#));
    let strip = parse(draft.text(&strip)).unwrap();
    assert_eq!(strip.sub_meshes[0].vertices[0], [1.0, 0.0, 0.0]);
    assert_eq!(strip.sub_meshes[0].triangles, [[0, 1, 2], [1, 3, 2]]);
    // Points and lines are skipped.
    for mode in 0..4 {
        let primitive = format!(r#""attributes":{{"POSITION":0}},"mode":{mode}"#);
        assert!(matches!(parse(draft.text(&scene(&primitive))), Err(MeshError::Empty { .. })));
    }
}

#[test]
fn elements_may_be_interleaved_and_quantised() {
    let mut draft = Draft::default();
    // Positions of 16 bits, 8 bytes from one to the next.
    let view = draft.view(&[0, 0, 0, 0, 0, 0, 9, 9, 2, 0, 0, 0, 0, 0, 9, 9, 0, 0, 0xFF, 0xFF, 0, 0]);
    draft.views[view].insert_str(1, r#""byteStride":8,"#);
    draft.accessors.push(format!(r#"{{"bufferView":{view},"componentType":5122,"count":3,"type":"VEC3"}}"#));
    let scene = scene(r#""attributes":{"POSITION":0}"#) + r#","extensionsRequired":["KHR_mesh_quantization"]"#;
    let mesh = parse(draft.text(&scene)).unwrap();
    assert_eq!(mesh.sub_meshes[0].vertices, [[0.0; 3], [2.0, 0.0, 0.0], [0.0, 0.0, -1.0]]);
}

fn with_nodes(nodes: &str, scenes: &str) -> String {
    let mesh = scene(TRIANGLES);
    let meshes = mesh.split(",\"nodes\"").next().unwrap();
    square().text(&format!(r#"{meshes},"nodes":[{nodes}]{scenes}"#))
}

#[test]
fn nodes_place_meshes() {
    let nodes = r#"{"translation":[0,0,2],"rotation":[0,0,0.70710678,0.70710678],"children":[1,2]},
{"scale":[-1,1,1],"mesh":0},{"mesh":0},{"matrix":[2,0,0,0,0,2,0,0,0,0,2,0,5,6,7,1],"mesh":0}"#;
    let all = parse(with_nodes(nodes, "")).unwrap();
    assert_eq!(all.sub_meshes.len(), 3);
    let near = |p: [f64; 3], q: [f64; 3]| p.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-6);
    // Vertex (1, 0, 0): mirrored, so that the triangles are reversed and it comes last; unmirrored; and by the
    // matrix.
    assert!(near(all.sub_meshes[0].vertices[2], [0.0, -2.0, -1.0]), "{:?}", all.sub_meshes[0].vertices);
    assert!(near(all.sub_meshes[1].vertices[1], [0.0, -2.0, 1.0]), "{:?}", all.sub_meshes[1].vertices);
    assert_eq!(all.sub_meshes[2].vertices[1], [7.0, -7.0, 6.0]);
    // The scene that is named, else the first.
    let scenes = r#","scenes":[{"nodes":[3]},{"nodes":[1,2]}]"#;
    assert_eq!(parse(with_nodes(nodes, scenes)).unwrap().sub_meshes, all.sub_meshes[2..]);
    let named = format!(r#"{scenes},"scene":1"#);
    assert_eq!(parse(with_nodes(nodes, &named)).unwrap().sub_meshes.len(), 2);
    // Without nodes each mesh is placed once.
    let bare = square().text(r#""meshes":[{"primitives":[{"attributes":{"POSITION":0}, "mode":6}]}]"#);
    assert_eq!(parse(bare).unwrap().triangle_count(), 2);
}

/// The square with normals, texture coordinates and colours of integers, and these materials and textures.
fn described(primitive: &str, rest: &str) -> String {
    let mut draft = square();
    let normals = draft.floats("VEC3", &[0.0, 0.0, 2.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, f32::NAN, 0.0]);
    let fractions = [0u16, 0, 65535, 0, 65535, 13107, 0, 65535].iter().flat_map(|x| x.to_le_bytes());
    let uv = draft.accessor(&fractions.collect::<Vec<u8>>(), "VEC2", 5123, 4);
    let colors = [255, 0, 0, 51, 0, 255, 0, 255, 0, 0, 55, 255, 255, 255, 255, 255];
    let colors = draft.accessor(&colors, "VEC4", 5121, 4);
    let attributes = format!(r#""POSITION":0,"NORMAL":{normals},"TEXCOORD_1":{uv},"COLOR_0":{colors}"#);
    let picture = draft.view(b"\x89PNG picture");
    let rest = rest.replace("PICTURE", &picture.to_string());
    draft.text(&format!("{},{rest}", scene(&format!(r#""attributes":{{{attributes}}},"indices":1{primitive}"#))))
}

const MATERIAL: &str = r#""materials":[{"name":"red","alphaMode":"BLEND","emissiveFactor":[0,1,9],"pbrMetallicRoughness":
{"baseColorFactor":[1,0.2140411,0,0.5],"baseColorTexture":{"index":0,"texCoord":1},"metallicFactor":0.25,"roughnessFactor":7,
"metallicRoughnessTexture":{"index":1,"texCoord":1}},"normalTexture":{"index":2,"texCoord":1}}],
"textures":[{"source":0},{"source":1},{"source":2}],"images":[{"uri":"wood%201.png"},{"bufferView":PICTURE,"mimeType":"image/png"},
{"uri":"data:image/png;base64,aGFsbG8"}]"#;

#[test]
fn materials_are_physical() {
    let (mesh, messages) = looks(described(r#","material":0"#, MATERIAL));
    assert_eq!(messages, ["in/t.gltf: mesh 0, primitive 0: 1 vertices have no finite NORMAL; they are drawn without"]);
    let part = &mesh.parts[0];
    assert_eq!(part.name, "red");
    assert_eq!(part.normals, [[0.0, -1.0, 0.0]; 4]);
    assert_eq!(part.tex_coords, [[0.0, 1.0], [1.0, 1.0], [1.0, 0.8], [0.0, 0.0]]);
    assert_eq!(part.colors[..2], [[1.0, 0.0, 0.0, 0.2], [0.0, 1.0, 0.0, 1.0]]);
    assert!((part.colors[2][2] - 0.5).abs() < 0.01, "{:?}", part.colors);
    let material = &part.material;
    assert!((material.diffuse[1] - 0.5).abs() < 1e-4 && material.diffuse[0] == 1.0 && material.diffuse[2] == 0.0);
    assert_eq!((material.alpha, material.emission), (0.5, [0.0, 1.0, 1.0]));
    assert_eq!(material.diffuse_map, Some("in/wood 1.png".into()));
    let embedded = |name: &str, bytes: &[u8]| Some(MeshTexture::Embedded { name: name.into(), bytes: bytes.into() });
    assert_eq!(material.normal_map, embedded("in/t.gltf (picture 2)", b"hallo"));
    let map = embedded("in/t.gltf (picture 1)", b"\x89PNG picture");
    assert_eq!(material.physical, Some(MetallicRoughness { metallic: 0.25, roughness: 1.0, map }));
    // Tangents come with a normal map.
    assert_eq!(part.tangents.len(), 4);
}

#[test]
fn alpha_modes() {
    for (mode, cutoff, expected, of_vertex) in
        [("OPAQUE", 0.5, 1.0, 1.0), ("MASK", 0.5, 1.0, 1.0), ("MASK", 0.6, 0.0, 1.0), ("BLEND", 0.5, 0.5, 0.2)]
    {
        let alpha = format!(r#""alphaMode":"{mode}","alphaCutoff":{cutoff}"#);
        let text = MATERIAL.replace(r#""alphaMode":"BLEND""#, &alpha);
        let (mesh, messages) = looks(described(r#","material":0"#, &text));
        assert_eq!(mesh.parts[0].material.alpha, expected);
        assert_eq!(mesh.parts[0].colors[0][3], of_vertex);
        assert_eq!(messages.iter().any(|m| m.contains("masks of textures are drawn opaque")), mode == "MASK");
    }
}

#[test]
fn colours_without_material_stand_alone() {
    let (mesh, _) = looks(described("", "\"textures\":[]"));
    let material = &mesh.parts[0].material;
    assert_eq!((material.diffuse, &material.physical), ([1.0; 3], &None));
    assert_eq!(mesh.parts[0].colors[0], [1.0, 0.0, 0.0, 1.0]);
}

#[test]
fn normals_turn_with_their_node() {
    let text = described("", "\"textures\":[]");
    let mirrored = text.replace(r#""nodes":[{"mesh":0}]"#, r#""nodes":[{"mesh":0,"scale":[1,1,-1]}]"#);
    let (mesh, _) = looks(mirrored);
    assert_eq!(mesh.parts[0].normals, [[0.0, 1.0, 0.0]; 4]);
    let colors: Vec<_> = mesh.parts[0].triangles[0].iter().map(|i| mesh.parts[0].colors[*i as usize][1]).collect();
    // Colours follow their corners: green is that of the second, reversed to the third.
    assert_eq!(colors, [0.0, 0.0, 1.0]);
}

#[test]
fn looks_that_cannot_be_read_are_named_and_the_mesh_stays() {
    let material = r#","material":0"#;
    let transform = r#""index":0,"texCoord":1,"extensions":{"KHR_texture_transform":{"scale":[2,2]}}"#;
    for (primitive, rest, expected) in [
        (material, MATERIAL.replace("wood", "stone"), "texture 'stone 1.png' is not there"),
        (
            material,
            MATERIAL.replace("bufferView\":PICTURE", "bufferView\":99"),
            "picture 1: buffer view 99 does not exist",
        ),
        (material, MATERIAL.replace("aGFsbG8", "?"), "picture 2: not readable as base64"),
        (material, MATERIAL.replace("base64,aG", ",aG"), "picture 2: a data URI must be encoded in base64"),
        (material, MATERIAL.replace(r#"{"source":1}"#, "{}"), "texture 1 has no picture that can be read"),
        (material, MATERIAL.replace("BLEND", "MELT"), "the alphaMode is none of glTF"),
        (material, MATERIAL.replace(r#""index":0,"texCoord":1"#, transform), "KHR_texture_transform is not used"),
        (
            material,
            MATERIAL.replace(r#""index":1,"texCoord":1"#, r#""index":1"#),
            "all textures are drawn with TEXCOORD_1",
        ),
        (material, MATERIAL.replace(r#""index":2"#, r#""index":2,"scale":2"#), "the scale of the normal texture"),
        (r#","material":7"#, MATERIAL.to_owned(), "material 7 does not exist; the default material is drawn"),
        (
            material,
            MATERIAL.replace(r#""emissiveFactor""#, r#""emissiveTexture":{"index":0},"emissiveFactor""#),
            "the emissive texture is not drawn",
        ),
        (
            material,
            format!(r#"{MATERIAL},"extensionsRequired":["KHR_materials_unlit"]"#),
            "'KHR_materials_unlit' is not used",
        ),
    ] {
        let (mesh, messages) = looks(described(primitive, &rest));
        assert_eq!(mesh.triangle_count(), 2);
        // One is about a normal.
        assert!(messages.len() == 2, "{messages:?}");
        assert!(messages.iter().any(|message| message.contains(expected)), "{messages:?}, expected {expected}");
    }
    let text = described("", "\"textures\":[]").replace(r#""NORMAL":2"#, r#""NORMAL":1"#);
    let (_, messages) = looks(text);
    assert!(messages[0].contains("accessor 1 has the type SCALAR, expected VEC3; NORMAL is not used"), "{messages:?}");
}

#[test]
fn broken_files_are_refused_with_the_place() {
    let draft = square();
    let good = draft.text(&scene(TRIANGLES));
    let whole = draft.container(&scene(TRIANGLES));
    let required = |name: &str| draft.text(&format!(r#"{},"extensionsRequired":["{name}"]"#, scene(TRIANGLES)));
    let endless = with_nodes(r#"{"children":[1],"mesh":0},{"children":[0]}"#, r#","scenes":[{"nodes":[0]}]"#);
    let mut grown = String::new();
    for i in 1..=30 {
        grown += &format!(r#"{{"children":[{i},{i}]}},"#);
    }
    let mut wrong = whole.clone();
    wrong[4] = 1;
    let mut nonsense = whole.clone();
    nonsense[16] = b'X';
    let json_end = 20 + u32::from_le_bytes([whole[12], whole[13], whole[14], whole[15]]) as usize;
    let mut huge = whole.clone();
    huge[json_end + 3] = 0x7F;
    let mut broken = whole.clone();
    broken[20] = b'[';
    let infinite: Vec<u8> = [&f32::INFINITY.to_le_bytes()[..], &[0; 8], &[1; 24]].concat();
    let mut far = Draft::default();
    far.accessor(&infinite, "VEC3", 5126, 3);
    for (bytes, expected) in [
            (Vec::new(), ":1: not readable as glTF 2.0: EOF"),
            (good[..good.len() / 2].into(), ": not readable as glTF 2.0: EOF"),
            (good.replace("\"nodes\":[0]", "\"nodes\":[null]").into(), ":4: not readable as glTF 2.0: invalid type: null"),
            (good.replace("\"2.0\"", "\"1.0\"").into(), "glTF of version '1.0'; only 2.0 can be read"),
            (wrong, " (byte 4): the container has version 1"),
            (nonsense, " (byte 12): the container must begin with a chunk of type 'JSON'"),
            (huge, "truncated: a chunk of 21"),
            (broken, " (byte 2"),
            (whole[..whole.len() - 1].into(), " (byte 8): truncated: the header announces"),
            (whole[..10].into(), " (byte 8): truncated: the file ends within a header"),
            (good.replace("\"count\":6", "\"count\":5").into(), "mesh 0, primitive 0: 5 corners are no multiple of 3"),
            (good.replace("\"count\":4", "\"count\":3").into(), "mesh 0, primitive 0: vertex 3 does not exist: there are 3"),
            (good.replace("\"count\":4", "\"count\":5").into(), "accessor 0 has 5 elements each 12 bytes from byte 0 of buffer view 0, which has 48 bytes"),
            (good.replace("\"count\":4", "\"count\":18446744073709551615").into(), "accessor 0 has 18446744073709551615 elements"),
            (good.replace("\"byteLength\":48", "\"byteLength\":99").into(), "buffer view 0 has 99 bytes from byte 0 of buffer 0, which has 54"),
            (good.replace("\"byteLength\":54", "\"byteLength\":55").into(), "truncated: buffer 0 has 54 bytes, announced 55"),
            (good.replace("base64,", "base64,?").into(), "buffer 0: not readable as base64"),
            (good.replace(";base64,", ",").into(), "buffer 0: a data URI must be encoded in base64"),
            (draft.json(r#""uri":"none.bin","#, &scene(TRIANGLES)).into(), "buffer 0: 'none.bin' cannot be read: "),
            (draft.json("", &scene(TRIANGLES)).into(), "buffer 0 has no uri, and there is no binary chunk for it"),
            (good.replace("\"POSITION\":0", "\"POSITION\":1").into(), "accessor 1 has the type SCALAR, expected VEC3"),
            (good.replace("\"POSITION\":0", "\"POSITION\":7").into(), "accessor 7 does not exist: the file has 2"),
            (good.replace("\"componentType\":5121", "\"componentType\":5120").into(), "indices of component type 5120, expected 5121, 5123 or 5125"),
            (good.replace("\"componentType\":5121", "\"componentType\":1").into(), "accessor 1 has an unknown type"),
            (good.replace("\"bufferView\":0,", "").into(), "accessor 0 has no buffer view"),
            (good.replace("\"byteOffset\":0", "\"byteStride\":4").into(), "elements of 12 bytes, buffer view 0 has one each 4"),
            (good.replace("\"count\":6", r#""sparse":{"count":1,"indices":{"bufferView":0,"componentType":5121},"values":{"bufferView":0}},"count":6"#).into(), "accessor 1 is sparse"),
            (good.replace("\"scene\":0", "\"scene\":1").into(), "scene 1 does not exist: the file has 1"),
            (good.replace("\"mesh\":0", "\"mesh\":1").into(), "mesh 1 does not exist: the file has 1"),
            (good.replace("\"nodes\":[0]", "\"nodes\":[1]").into(), "node 1 does not exist: the file has 1"),
            (good.replace("\"mesh\":0", "\"mesh\":0,\"rotation\":[0,0,0,0]").into(), "node 0: the rotation has length 0"),
            (far.text(&scene(r#""attributes":{"POSITION":0}"#)).into(), "vertex 0 is not finite"),
            (endless.into(), "the scene is endless"),
            (with_nodes(&format!("{grown}{{\"mesh\":0}}"), "").into(), "the scene is endless"),
            (required("KHR_draco_mesh_compression").into(), "requires the extension 'KHR_draco_mesh_compression', which cannot be read; export it without compression"),
            (required("EXT_meshopt_compression").into(), "export it without compression"),
            (required("EXT_mesh_gpu_instancing").into(), "export it without this extension"),
        ] {
            let message = parse(bytes).unwrap_err().to_string();
            assert!(message.contains(expected) && message.len() < 500, "{message}, expected {expected}");
        }
}

#[test]
fn many_objects_are_refused_before_they_are_made() {
    // The library takes a list for an object, too.
    for (list, item) in [("nodes", "{}"), ("materials", "{}"), ("materials", "[]"), ("samplers", "[]")] {
        let many = |count: usize| {
            let items = vec![item; count].join(",");
            parse(format!(r#"{{"asset":{{"version":"2.0"}},"{list}":[{items}]}}"#)).unwrap_err()
        };
        assert!(matches!(many(FEW_OBJECTS / 2), MeshError::Empty { .. }), "{list}");
        assert!(many(2 * FEW_OBJECTS).to_string().contains("JSON objects and lists"), "{list}");
    }
    // Long files may have more, but not any number.
    let node = r#"{"name":"a node of some length"}"#;
    let nodes = |count: usize| {
        let nodes = vec![node; count].join(",");
        parse(format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{nodes}]}}"#)).unwrap_err()
    };
    assert!(matches!(nodes(20 * FEW_OBJECTS), MeshError::Empty { .. }));
    assert!(nodes(MAX_OBJECTS).to_string().contains("more than 2000000 JSON objects"));
    let deep = format!(r#"{{"asset":{{"version":"2.0"}},"extras":{}"#, "[".repeat(1_000_000));
    assert!(parse(deep).is_err());
}

#[test]
fn changed_bytes_never_panic() {
    let textured = described(r#","material":0"#, MATERIAL);
    let (json, data) = {
        let draft = square();
        let placed = r#""meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1},{"attributes":{"POSITION":0},"mode":5}]}],
"nodes":[{"mesh":0,"children":[1],"translation":[1,2,3]},{"mesh":0,"scale":[1,-1,1],"rotation":[1,0,0,0]}],"scenes":[{"nodes":[0,1]}]"#;
        (draft.json("", placed), draft.data)
    };
    let whole = [textured.into_bytes(), container(&json, &data)];
    // Numbers that look random and are the same each time.
    let mut state = 7u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let mut read = 0;
    for round in 0..20_000 {
        let mut changed = whole[round % whole.len()].clone();
        for _ in 0..=random(3) {
            let at = random(changed.len());
            match random(4) {
                0 => changed[at] = b"0123456789-.,:[]{}\"ae \xFF\0"[random(24)],
                1 if round % 2 == 0 => drop(changed.remove(at)),
                // Digits, so that what is read next goes further.
                _ if changed[at].is_ascii_digit() => changed[at] = b"0123456789"[random(10)],
                2 => changed[at] ^= 1 << random(8),
                _ => changed[at] = random(256) as u8,
            }
        }
        // What collides must not depend on whether looks are read.
        let collides = parse(changed.clone()).map(|mesh| mesh.triangle_count());
        let drawn = parse_visual(changed, Path::new("t.gltf"), random(2) == 0, &|_| None);
        if matches!(drawn, Err(MeshError::TooFar { .. })) {
            continue;
        }
        if let Err(error) = &collides {
            assert!(error.to_string().len() < 1000, "{error}");
        }
        let Ok((mesh, messages)) = drawn else {
            assert!(collides.is_err());
            continue;
        };
        read += 1;
        assert_eq!(collides.unwrap(), mesh.triangle_count());
        assert!(messages.iter().all(|message| message.len() < 1500));
        for part in mesh.parts {
            let numbers = part.positions.as_flattened().iter().chain(part.normals.as_flattened());
            assert!(numbers.chain(part.tex_coords.as_flattened()).all(|x| x.is_finite()));
            assert!(part.colors.as_flattened().iter().all(|x| (0.0..=1.0).contains(x)));
            assert!(part.triangles.as_flattened().iter().all(|i| (*i as usize) < part.positions.len()));
        }
    }
    assert!(read > 1000, "{read}");
}
