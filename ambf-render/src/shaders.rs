//! GLSL of the built-in materials, written for the lights of a scene.

/// Vertex shader of everything that is drawn as instances.
pub(crate) const VERTEX: &str = r"#version 330
in vec3 aPosition;
in vec3 aNormal;
in vec2 aTexCoord;
in vec3 aTangent;
in vec3 aBitangent;
in vec4 i_row_x, i_row_y, i_row_z;
in vec4 i_diffuse, i_ambient;
in vec3 i_specular, i_emission;
in uvec2 i_ids;
uniform mat4 u_clip;
uniform float u_point_size;
// w: along the backward axis of the camera.
out vec4 v_normal;
flat out vec4 v_diffuse, v_ambient;
flat out vec3 v_specular, v_emission;
#ifdef IDS
flat out uvec2 v_ids;
uniform vec3 u_camera_x, u_camera_y, u_camera_z;
#else
uniform vec3 u_backward;
#endif
#ifdef WORLD
out vec3 v_world;
#endif
#if defined(PHYSICAL) || defined(VOXELS)
uniform vec4 u_eye;
out vec3 v_view;
#endif
#ifdef TEXTURED
out vec2 v_tex_coord;
#endif
#ifdef COLORED
in vec4 aColor;
out vec4 v_color;
#endif
#ifdef NORMAL_MAP
out vec3 v_tangent;
out vec3 v_bitangent;
#endif
void main() {
    vec4 p = vec4(aPosition, 1.0);
    vec3 world = vec3(dot(i_row_x, p), dot(i_row_y, p), dot(i_row_z, p));
    // The cofactors of the linear part carry normals, whatever the scales.
    vec3 x = cross(i_row_y.xyz, i_row_z.xyz), y = cross(i_row_z.xyz, i_row_x.xyz), z = cross(i_row_x.xyz, i_row_y.xyz);
    vec3 normal = vec3(dot(x, aNormal), dot(y, aNormal), dot(z, aNormal));
    v_diffuse = i_diffuse;
    v_ambient = vec4(0.4 * i_ambient.rgb, i_ambient.a);
    v_specular = i_specular;
    v_emission = i_emission;
#ifndef PHYSICAL
    v_emission += 0.2 * i_ambient.rgb;
#endif
#ifdef IDS
    v_ids = i_ids;
    v_normal = vec4(dot(u_camera_x, normal), dot(u_camera_y, normal), dot(u_camera_z, normal), 0.0);
#else
    v_normal = vec4(normal, dot(u_backward, normal));
#endif
#ifdef WORLD
    v_world = world;
#endif
#if defined(PHYSICAL) || defined(VOXELS)
    v_view = u_eye.xyz - u_eye.w * world;
#endif
#ifdef TEXTURED
    v_tex_coord = aTexCoord;
#endif
#ifdef COLORED
    v_color = aColor;
#endif
#ifdef NORMAL_MAP
    v_tangent = vec3(dot(i_row_x.xyz, aTangent), dot(i_row_y.xyz, aTangent), dot(i_row_z.xyz, aTangent));
    v_bitangent = vec3(dot(i_row_x.xyz, aBitangent), dot(i_row_y.xyz, aBitangent), dot(i_row_z.xyz, aBitangent));
#endif
    //LIGHTS
    gl_PointSize = u_point_size;
    gl_Position = u_clip * vec4(world, 1.0);
}
";

/// Looks for the surface of voxels along the ray of a pixel of the far wall of their box. `find` sets `hit`, in the
/// world, and `voxel` there, and returns the unit normal; where there is no surface, the pixel is discarded. README,
/// section Volumes.
const FIND: &str = r"
uniform sampler3D u_voxels, u_blocks;
uniform mat4 u_to_voxels, u_clip;
uniform float u_value, u_samples, u_tint;
uniform vec4 u_eye;
in vec3 v_world;
// Towards the eye, as long as the way to it, or of unit length if rays are parallel.
in vec3 v_view;
vec3 hit;
vec4 voxel;
// What of a / b is finite and positive, else a large number.
vec3 ways(vec3 a, vec3 b) {
    return mix(vec3(1e30), max(a / b, 0.0), notEqual(b, vec3(0.0)));
}
float least(vec3 v) { return min(v.x, min(v.y, v.z)); }
vec3 find() {
    vec3 last = (u_to_voxels * vec4(v_world, 1.0)).xyz, back = mat3(u_to_voxels) * v_view;
    // Shares of v_view: where the ray enters the box, the eye, the near plane.
    float share = least(ways(step(0.0, back) - last, back));
    if (u_eye.w > 0.5) share = min(share, 1.0);
    vec4 clip = u_clip * vec4(v_world, 1.0), clip_back = u_clip * vec4(v_view, 0.0);
    float ahead = clip.z + clip.w, closer = clip_back.z + clip_back.w;
    if (closer < 0.0) share = min(share, -ahead / closer);
    vec3 first = last + share * back;
    int count = int(ceil(min(share * length(v_view) * u_samples, 65536.0))) + 1;
    vec3 by = (last - first) / float(count), n = vec3(textureSize(u_voxels, 0)), block = 8.0 / n;
    ivec3 most = textureSize(u_blocks, 0) - 1;
    int i = 0;
    while (i <= count) {
        vec3 p = first + float(i) * by;
        ivec3 at = clamp(ivec3(p / block), ivec3(0), most);
        if (texelFetch(u_blocks, at, 0).r <= u_value) {
            i += max(1, int(ceil(min(least(ways((vec3(at) + step(0.0, by)) * block - p, by)), 1e6))));
        } else if (texture(u_voxels, p).a > u_value) {
            break;
        } else {
            ++i;
        }
    }
    if (i > count || share <= 0.0) discard;
    vec3 p = first + float(i) * by;
    float low = float(i) - 1.0, high = float(i);
    for (int k = 0; k < 6 && i > 0; ++k) {
        float middle = 0.5 * (low + high);
        p = first + middle * by;
        if (texture(u_voxels, p).a > u_value) high = middle; else low = middle;
    }
    p = first + high * by;
    hit = v_world + (1.0 - high / float(count)) * share * v_view;
    voxel = texture(u_voxels, p);
    vec3 slope;
    for (int axis = 0; axis < 3; ++axis) {
        vec3 e = vec3(0.0);
        e[axis] = 1.0 / n[axis];
        slope[axis] = n[axis] * (texture(u_voxels, p - e).a - texture(u_voxels, p + e).a);
    }
    vec3 normal = slope * mat3(u_to_voxels);
    clip = u_clip * vec4(hit, 1.0);
    gl_FragDepth = 0.5 * clip.z / clip.w + 0.5;
    // Where the box cuts through the inside there is no slope.
    return normalize(dot(normal, normal) > 0.0 ? normal : v_view);
}
";

/// The vertex shader of [`voxels_ids`], or of the other programs of voxels.
pub(crate) fn voxels_vertex(ids: bool) -> String {
    let defines = format!("#version 330\n#define VOXELS\n#define WORLD\n{}", if ids { "#define IDS\n" } else { "" });
    VERTEX.replacen("#version 330\n", &defines, 1)
}

/// As [`DEPTH_FRAGMENT`], of voxels.
pub(crate) fn voxels_depth() -> String {
    format!("#version 330\n{FIND}void main() {{ find(); }}\n")
}

/// As [`ids`], of voxels.
pub(crate) fn voxels_ids(normals: bool) -> String {
    let (output, normal) = match normals {
        true => (
            "uniform vec3 u_camera_x, u_camera_y, u_camera_z;\nout vec4 o_normal;\n",
            "    o_normal = vec4(dot(u_camera_x, n), dot(u_camera_y, n), dot(u_camera_z, n), 0.0);\n",
        ),
        false => ("", ""),
    };
    format!(
        "#version 330\n{FIND}flat in uvec2 v_ids;\nout uvec2 o_ids;\n{output}void main() {{\n    vec3 n = find();\n    o_ids = v_ids;\n{normal}}}\n"
    )
}

/// The colour of the nearest voxel alone.
pub(crate) fn voxels_mask() -> String {
    format!(
        r"#version 330
{FIND}out vec4 o_color;
void main() {{
    find();
    vec3 n = vec3(textureSize(u_voxels, 0));
    ivec3 nearest = ivec3(clamp((u_to_voxels * vec4(hit, 1.0)).xyz * n, vec3(0.0), n - 1.0));
    o_color = vec4(texelFetch(u_voxels, nearest, 0).rgb, 1.0);
}}
"
    )
}

/// Vertex shader where only the depth counts.
pub(crate) const DEPTH_VERTEX: &str = r"#version 330
in vec3 aPosition;
in vec4 i_row_x, i_row_y, i_row_z;
uniform mat4 u_clip;
void main() {
    vec4 p = vec4(aPosition, 1.0);
    gl_Position = u_clip * vec4(dot(i_row_x, p), dot(i_row_y, p), dot(i_row_z, p), 1.0);
}
";

/// Fragment shader where only the depth counts.
pub(crate) const DEPTH_FRAGMENT: &str = "#version 330\nvoid main() {}\n";

/// The vertex shader for [`ids`].
pub(crate) fn ids_vertex() -> String {
    VERTEX.replacen("#version 330\n", "#version 330\n#define IDS\n", 1)
}

/// Ids, and normals in the camera's frame, towards the camera, if they are wanted.
pub(crate) fn ids(normals: bool) -> String {
    let (output, normal) = match normals {
        true => (
            "in vec4 v_normal;\nout vec4 o_normal;\n",
            "    o_normal = vec4(normalize(gl_FrontFacing ? v_normal.xyz : -v_normal.xyz), 0.0);\n",
        ),
        false => ("", ""),
    };
    format!("#version 330\nflat in uvec2 v_ids;\nout uvec2 o_ids;\n{output}void main() {{\n    o_ids = v_ids;\n{normal}}}\n")
}

/// The diffuse colour alone.
pub(crate) const UNLIT_FRAGMENT: &str = r"#version 330
flat in vec4 v_diffuse;
out vec4 o_color;
void main() { o_color = v_diffuse; }
";

/// The mask colour of the original's preprocessing program: the diffuse part of light and material.
pub(crate) const MASK_FRAGMENT: &str = r"#version 330
flat in vec4 v_diffuse;
out vec4 o_color;
void main() { o_color = vec4(0.7 * v_diffuse.rgb, 1.0); }
";

/// One triangle over the whole picture, at the far plane.
pub(crate) const SKY_VERTEX: &str = r"#version 330
uniform mat4 u_to_world;
out vec3 v_direction;
void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    vec4 far = u_to_world * vec4(corner, 1.0, 1.0);
    v_direction = far.xyz;
    gl_Position = vec4(corner, 1.0, 1.0);
}
";

/// A rectangle at the far plane: `u_area` is left, top, width, height in normalised coordinates.
pub(crate) const BACKDROP_VERTEX: &str = r"#version 330
uniform vec4 u_area;
out vec2 v_place;
void main() {
    v_place = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    gl_Position = vec4(u_area.x + v_place.x * u_area.z, u_area.y - v_place.y * u_area.w, 1.0, 1.0);
}
";

/// A picture whose top row is the first.
pub(crate) const BACKDROP_FRAGMENT: &str = r"#version 330
in vec2 v_place;
uniform sampler2D u_picture;
uniform vec4 u_color;
out vec4 o_color;
void main() {
    // The texture repeats: half a texel from its edge the opposite edge begins to count.
    vec2 half_texel = 0.5 / vec2(textureSize(u_picture, 0));
    o_color = u_color * texture(u_picture, clamp(v_place, half_texel, 1.0 - half_texel));
}
";

/// Six pictures (layers front, back, left, right, top, bottom) as seen from within.
pub(crate) const SKY_FRAGMENT: &str = r"#version 330
in vec3 v_direction;
uniform sampler2DArray u_faces;
out vec4 o_color;
void main() {
    vec3 d = v_direction, a = abs(d);
    vec3 c; // right, up, layer
    if (a.x >= a.y && a.x >= a.z) c = d.x > 0.0 ? vec3(-d.y, d.z, 0.0) : vec3(d.y, d.z, 1.0);
    else if (a.y >= a.z) c = d.y > 0.0 ? vec3(d.x, d.z, 2.0) : vec3(-d.x, d.z, 3.0);
    else c = d.z > 0.0 ? vec3(-d.y, -d.x, 4.0) : vec3(-d.y, d.x, 5.0);
    vec2 uv = 0.5 * (c.xy / max(a.x, max(a.y, a.z)) + 1.0);
    o_color = vec4(texture(u_faces, vec3(uv, c.z)).rgb, 1.0);
}
";

/// What a lit program is written for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Lit {
    /// Number of lights, 0 to 8.
    pub(crate) lights: u32,
    /// Bit i: light i has a shadow map.
    pub(crate) shadows: u32,
    /// Bit i: light i is weaker towards the rim of its cone.
    pub(crate) exponents: u32,
    /// Bit i: light i is weaker at a distance.
    pub(crate) attenuated: u32,
    /// A texture multiplies the colour.
    pub(crate) textured: bool,
    /// A texture turns the normal.
    pub(crate) normal_map: bool,
    /// Vertices have colours that multiply the colour.
    pub(crate) colored: bool,
    /// The material is physically based.
    pub(crate) physical: bool,
    /// A texture multiplies its roughness and metalness.
    pub(crate) physical_map: bool,
    /// Some instance has highlights.
    pub(crate) glossy: bool,
    /// All instances have the shininess 2^k: k multiplications cost a software renderer less than a power.
    pub(crate) squarings: Option<u8>,
    /// The surface is looked for among voxels, whose colours multiply that of the material.
    pub(crate) isosurface: bool,
}

/// k >= 1 of a shininess 2^k that is raised by multiplications.
pub(crate) fn squarings(shininess: f32) -> Option<u8> {
    (1..=7).find(|&k| shininess == f32::from(1_u8 << k))
}

/// The first texture unit of shadow maps; 0 is the diffuse texture, 1 the normal map.
pub(crate) const SHADOW_UNIT: u32 = 3;

/// Lights whose geometry is computed at vertices and interpolated, which is exact because it is linear in the place. More
/// would exceed the 60 numbers that every driver hands on: that of further lights is computed at each pixel, where Mesa's
/// software renderer takes some thirty instructions to read one number of a uniform.
const AT_VERTICES: u32 = 2;

impl Lit {
    fn defines(self) -> String {
        let all = [
            (self.textured, "TEXTURED"),
            (self.normal_map, "NORMAL_MAP"),
            (self.colored, "COLORED"),
            (self.physical, "PHYSICAL"),
            (self.physical_map, "PHYSICAL_MAP"),
            (self.lights > AT_VERTICES || self.isosurface, "WORLD"),
            (self.isosurface, "VOXELS"),
        ];
        let defined = all.iter().filter(|(is_defined, _)| *is_defined).map(|(_, name)| format!("#define {name}\n"));
        std::iter::once("#version 330\n".to_owned()).chain(defined).collect()
    }

    /// Lights whose geometry is computed at vertices: none for a surface that is looked for at each pixel.
    fn at_vertices(self) -> u32 {
        if self.isosurface {
            0
        } else {
            self.lights.min(AT_VERTICES)
        }
    }

    /// What a light needs at a place `world`: qualifier, type, name and expression; and the uniforms in it.
    ///
    /// `v_light`: the vector to the light, and its component along the light's axis over the cosine of the cutoff angle;
    /// `v_back`: its component along the camera's backward axis; `v_shadow`: place in the shadow map; `v_spot`: cosine
    /// of the cutoff angle, and exponent.
    fn geometry(self, i: u32) -> (Vec<[String; 4]>, String) {
        let mut values = vec![(
            "",
            "vec4",
            format!("v_light_{i}"),
            format!("vec4(u_position_{i} - world, dot(world - u_position_{i}, u_axis_{i}))"),
        )];
        let mut uniforms = format!("uniform vec3 u_position_{i}, u_axis_{i};\n");
        if self.glossy {
            values.push(("", "float", format!("v_back_{i}"), format!("dot(u_position_{i} - world, u_backward)")));
        }
        if self.shadows >> i & 1 == 1 {
            values.push(("", "vec4", format!("v_shadow_{i}"), format!("u_shadow_clip_{i} * vec4(world, 1.0)")));
            uniforms.push_str(&format!("uniform mat4 u_shadow_clip_{i};\n"));
        }
        if self.exponents >> i & 1 == 1 {
            values.push(("flat ", "vec2", format!("v_spot_{i}"), format!("u_spot_{i}.xy")));
            uniforms.push_str(&format!("uniform vec4 u_spot_{i};\n"));
        }
        (values.into_iter().map(|(a, b, c, d)| [a.to_owned(), b.to_owned(), c, d]).collect(), uniforms)
    }

    pub(crate) fn vertex(self) -> String {
        let (mut head, mut computed) = (self.defines(), String::new());
        for light in 0..self.at_vertices() {
            let (values, uniforms) = self.geometry(light);
            head.push_str(&uniforms);
            for [qualifier, kind, name, expression] in values {
                head.push_str(&format!("{qualifier}out {kind} {name};\n"));
                computed.push_str(&format!("{name} = {expression};\n    "));
            }
        }
        VERTEX.replacen("#version 330\n", &head, 1).replacen("//LIGHTS\n", &format!("{computed}\n"), 1)
    }

    /// The light on a pixel, by the equation of the material.
    pub(crate) fn fragment(self) -> String {
        let mut text = self.head();
        match self.physical {
            true => self.physical_main(&mut text),
            false => self.phong_main(&mut text),
        }
        text
    }

    /// What of the fragment shader is the same for all materials: inputs, and the normal towards the eye.
    fn head(self) -> String {
        let mut text = self.defines();
        if self.isosurface {
            text.push_str(FIND);
        }
        text.push_str(
            r"in vec4 v_normal;
flat in vec4 v_diffuse, v_ambient;
flat in vec3 v_specular, v_emission;
uniform vec3 u_backward;
out vec4 o_color;
#if defined(WORLD) && !defined(VOXELS)
in vec3 v_world;
#endif
#ifdef TEXTURED
in vec2 v_tex_coord;
uniform sampler2D u_diffuse_map;
#endif
#ifdef COLORED
in vec4 v_color;
#endif
#ifdef PHYSICAL_MAP
uniform sampler2D u_physical_map;
#endif
#ifdef NORMAL_MAP
in vec3 v_tangent;
in vec3 v_bitangent;
uniform sampler2D u_normal_map;
#endif
",
        );
        for light in 0..self.lights {
            let (values, uniforms) = self.geometry(light);
            match light < self.at_vertices() {
                true => values.iter().for_each(|[qualifier, kind, name, _]| {
                    text.push_str(&format!("{qualifier}in {kind} {name};\n"));
                }),
                false => text.push_str(&uniforms),
            }
            if self.shadows >> light & 1 == 1 {
                text.push_str(&format!("uniform sampler2DShadow u_shadow_{light};\n"));
            }
            if self.attenuated >> light & 1 == 1 {
                text.push_str(&format!("uniform vec3 u_attenuation_{light};\n"));
            }
        }
        text.push_str(
            r"// w: along the backward axis of the camera.
vec4 normal() {
#ifdef VOXELS
    vec3 found = find();
    return vec4(found, dot(u_backward, found));
#endif
    vec4 n = v_normal * inversesqrt(dot(v_normal.xyz, v_normal.xyz));
#ifdef NORMAL_MAP
    vec3 bump = 2.0 * texture(u_normal_map, v_tex_coord).xyz - 1.0;
    n.xyz = normalize(bump.x * normalize(v_tangent) + bump.y * normalize(v_bitangent) + bump.z * n.xyz);
    n.w = dot(u_backward, n.xyz);
#endif
    return gl_FrontFacing ? n : -n;
}
",
        );
        text
    }

    /// Begins the block of a light: `l` · `inverse` is the unit vector to it, at the distance `square` · `inverse`; the
    /// rest is for pixels in its cone.
    fn toward(self, light: u32) -> String {
        let mut text = "    {\n".to_owned();
        if light >= self.at_vertices() {
            let world = if self.isosurface { "hit" } else { "v_world" };
            text.push_str(&format!("        vec3 world = {world};\n"));
            for [_, kind, name, expression] in self.geometry(light).0 {
                text.push_str(&format!("        {kind} {name} = {expression};\n"));
            }
        }
        text.push_str(&format!(
            r"        vec3 l = v_light_{light}.xyz;
        float square = dot(l, l), inverse = inversesqrt(max(square, 1e-18)), along = v_light_{light}.w * inverse;
        if (along >= 1.0) {{
"
        ));
        text
    }

    /// How much of light i reaches the pixel beside its shadow: the factors of spot and attenuation, as statements that
    /// multiply `part`.
    fn weakened(self, light: u32) -> String {
        let mut text = String::new();
        if self.exponents >> light & 1 == 1 {
            let (cosine, exponent) = (format!("v_spot_{light}.x"), format!("v_spot_{light}.y"));
            text.push_str(&format!("            part *= pow(max(along * {cosine}, 1e-6), {exponent});\n"));
        }
        if self.attenuated >> light & 1 == 1 {
            text.push_str(&format!(
                r"            float d = square * inverse;
            part /= max(u_attenuation_{light}.x + d * (u_attenuation_{light}.y + d * u_attenuation_{light}.z), 1e-9);
"
            ));
        }
        text
    }

    /// How much of light i is seen from the pixel, 0 to 1; 1.0 if it casts no shadows.
    fn seen(self, light: u32) -> String {
        match self.shadows >> light & 1 {
            1 => format!("textureProj(u_shadow_{light}, v_shadow_{light})"),
            _ => "1.0".to_owned(),
        }
    }

    /// The equation of the fixed-function pipeline, at every pixel: colour = emission + 0.2 m_a + Σ over lights of
    /// attenuation · spot · (0.4 m_a + max(n·l, 0) 0.7 m_d + max(n·h, 0)^shininess m_s), viewer at infinity, both sides
    /// lit, clamped, then multiplied by the texture. In the shadow of a light its diffuse part counts 0.3 and its
    /// specular part nothing.
    fn phong_main(self, text: &mut String) {
        text.push_str("void main() {\n    vec4 n = normal();\n    vec3 color = v_emission;\n");
        // (n·h)^shininess, of which only the square needs no root.
        let power = match self.squarings {
            Some(squarings) => format!("nh *= nh / hh; {}", "nh *= nh; ".repeat(usize::from(squarings) - 1)),
            None => "nh = pow(nh * inversesqrt(hh), v_ambient.a);".to_owned(),
        };
        for light in 0..self.lights {
            // What a light does not do is not computed: that is felt where the processor draws.
            let (diffuse, specular) = match self.shadows >> light & 1 {
                1 => ("(0.21 + 0.49 * lit)", "lit * "),
                _ => ("0.7", ""),
            };
            // h is the sum of the unit vectors to the light and backwards.
            let highlight = match self.glossy {
                true => format!(
                    r"float nh = max(nl + n.w, 1e-6), hh = max(2.0 + 2.0 * inverse * v_back_{light}, 1e-6);
                {power}
                part += {specular}min(nh, 1.0) * v_specular;"
                ),
                false => String::new(),
            };
            let (toward, weakened, seen) = (self.toward(light), self.weakened(light), self.seen(light));
            text.push_str(&format!(
                r"{toward}            vec3 part = v_ambient.rgb;
            float nl = dot(n.xyz, l) * inverse;
            if (nl > 0.0) {{
                float lit = {seen};
                part += {diffuse} * nl * v_diffuse.rgb;
                {highlight}
            }}
{weakened}            color += part;
        }}
    }}
"
            ));
        }
        text.push_str(
            r"#if defined(TEXTURED) || defined(COLORED) || defined(VOXELS)
    color = clamp(color, 0.0, 1.0);
#endif
    o_color = vec4(color, v_diffuse.a);
#ifdef TEXTURED
    o_color *= texture(u_diffuse_map, v_tex_coord);
#endif
#ifdef COLORED
    o_color *= v_color;
#endif
#ifdef VOXELS
    o_color.rgb *= u_tint * voxel.rgb;
#endif
}
",
        );
    }

    /// Reflection by microfacets: Lambert's law and the distribution of Trowbridge and Reitz (GGX) with the shadowing
    /// of Smith and the Fresnel term of Schlick, as appendix B of glTF 2.0 has it; in linear colours, with a sky that
    /// is bright above. README, section Light.
    fn physical_main(self, text: &mut String) {
        text.push_str(
            r"#ifndef VOXELS
in vec3 v_view;
#endif
const vec3 GAMMA = vec3(2.2);
float environment(float height, float blur) { return 0.3 + 0.7 * smoothstep(-blur, blur, height); }
void main() {
    vec3 n = normal().xyz, v = normalize(v_view);
    vec4 surface = v_diffuse;
#ifdef TEXTURED
    surface *= texture(u_diffuse_map, v_tex_coord);
#endif
#ifdef COLORED
    surface *= v_color;
#endif
#ifdef VOXELS
    surface.rgb *= u_tint * voxel.rgb;
#endif
    float metallic = v_specular.x, roughness = v_specular.y;
#ifdef PHYSICAL_MAP
    vec4 factors = texture(u_physical_map, v_tex_coord);
    roughness *= factors.g;
    metallic *= factors.b;
#endif
    vec3 base = pow(max(surface.rgb, 0.0), GAMMA);
    vec3 rho = (1.0 - metallic) * base, f0 = mix(vec3(0.04), base, metallic);
    float a = max(roughness * roughness, 0.01), aa = a * a, nv = clamp(dot(n, v), 1e-3, 1.0);
    vec3 color = pow(max(v_emission, 0.0), GAMMA);
    float lights = 0.0;
",
        );
        for light in 0..self.lights {
            let (toward, weakened, seen) = (self.toward(light), self.weakened(light), self.seen(light));
            text.push_str(&format!(
                r"{toward}            float part = 1.0;
{weakened}            lights += part;
            l *= inverse;
            float nl = dot(n, l);
            if (nl > 0.0) {{
                vec3 h = normalize(l + v);
                float nh = dot(n, h), spread = nh * nh * (aa - 1.0) + 1.0;
                float visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - aa) + aa) + nv * sqrt(nl * nl * (1.0 - aa) + aa));
                vec3 f = f0 + (1.0 - f0) * pow(1.0 - clamp(dot(v, h), 0.0, 1.0), 5.0);
                part *= 0.9 * nl * {seen};
                color += part * ((1.0 - f) * rho + aa / (spread * spread) * visibility * f);
            }}
        }}
    }}
"
            ));
        }
        text.push_str(
            r"    float level = min((1.0 + 2.0 * lights) / 3.0, 1.0);
    vec3 f = f0 + (max(vec3(1.0 - roughness), f0) - f0) * pow(1.0 - nv, 5.0);
    color += level * (0.12 * rho * environment(n.z, 1.0) + 0.4 * f * environment(reflect(-v, n).z, 0.1 + 0.9 * roughness));
    o_color = vec4(pow(min(color, 1.0), 1.0 / GAMMA), surface.a);
}
",
        );
    }
}
