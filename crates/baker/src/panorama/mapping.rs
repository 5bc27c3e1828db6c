//! Which direction a pixel of an image looks along: the layouts that gdibl reads and writes.
//!
//! Pixel positions are continuous: the centre of pixel (i, j) is at (i + ½, j + ½), y grows downwards. Directions
//! are in the probe's own axes (right-handed, Y up). What each layout shows where:
//!
//! | name | layout | image centre | from |
//! |---|---|---|---|
//! | `lat-long` | u = ½ - atan2(x, z)/2π | +Z, left of it +X | OpenEXR `ImfEnvmap.h`; gdibl's own |
//! | `lat-long-three` | u = ½ + atan2(z, x)/2π | +X, left of it -Z | three.js, `equirectUv` in `common.glsl` |
//! | `lat-long-blender` | u = ½ - atan2(y, x)/2π, Z up | Blender's +X = glTF's +X, left of it Blender's +Y = glTF's -Z | Cycles, `direction_to_equirectangular`; axes as its glTF exporter turns them: (x, y, z) → (x, z, -y) |
//! | `lat-long-mitsuba` | u = atan2(x, -z)/2π | +Z, left of it +X | Mitsuba 3, `envmap.cpp` |
//! | `angular` | radius = angle from the centre / π | -Z, right +X, up +Y | Debevec's light probes |
//! | `cube-cross-horizontal`, `cube-cross-vertical` | below | -Z, right +X, up +Y | Debevec, in *High Dynamic Range Imaging*, 9.4.4 |
//! | `cube-strip` | six faces in a row | | OpenGL, Vulkan and Direct3D cube textures |
//! | `cube-exr` | six faces in a column | | OpenEXR `ImfEnvmap.cpp` |
//!
//! So three.js and Blender agree with each other (a quarter turn from gdibl's), and Mitsuba agrees with OpenEXR.
//! The Blender row is its environment *texture*; an equirectangular *camera* of Blender has its own viewing
//! direction in the image centre. Mitsuba and OpenEXR put the first and last row of a lat-long image on the poles,
//! half a pixel from where gdibl reads them.
//!
//! ```text
//!  cube-cross-vertical     cube-cross-horizontal         cube-strip                     cube-exr
//!      +----+                  +----+                +----+----+----+----+----+----+     +----+
//!      | +Y |                  | +Y |                | +X | -X | +Y | -Y | +Z | -Z |     | +X |
//! +----+----+----+        +----+----+----+----+      +----+----+----+----+----+----+     | -X |
//! | -X | -Z | +X |        | -X | -Z | +X | +Z |       face axes: OpenGL's, so seen       | +Y |
//! +----+----+----+        +----+----+----+----+       from inside they are mirrored      | -Y |
//!      | -Y |                  | -Y |                                                    | +Z |
//!      +----+                  +----+                 a cross unfolds the cube as seen   | -Z |
//!      | +Z | upside down                             from inside, without gaps          +----+
//!      +----+
//! ```
//!
//! Crosses made for left-handed engines put +Z in the middle instead of -Z and keep +X on the right. There is no
//! preset for them: read as `cube-cross-…` they come out mirrored front to back.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

/// A layout of a panorama in an image; see the module for what looks where.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Mapping {
    /// gdibl's own and OpenEXR's: the centre looks along +Z.
    #[default]
    LatLong,
    /// three.js: the centre looks along +X.
    LatLongThree,
    /// Blender's environment texture, in glTF's axes: the centre looks along +X.
    LatLongBlender,
    /// Mitsuba's `envmap`: the centre looks along +Z.
    LatLongMitsuba,
    /// Debevec's angular map: the centre looks along -Z, the rim along +Z.
    AngularMap,
    /// Four faces by three.
    CubeCrossHorizontal,
    /// Three faces by four, the last one upside down.
    CubeCrossVertical,
    /// +X -X +Y -Y +Z -Z from left to right, each as OpenGL stores it.
    CubeStrip,
    /// +X -X +Y -Y +Z -Z from top to bottom, each as OpenEXR stores it.
    CubeExr,
}

/// One face of a cube layout: its place in units of faces, and the axes of its image.
struct Face {
    column: usize,
    row: usize,
    forward: [i8; 3],
    right: [i8; 3],
    down: [i8; 3],
}

const fn face(column: usize, row: usize, forward: [i8; 3], right: [i8; 3], down: [i8; 3]) -> Face {
    Face { column, row, forward, right, down }
}

const PX: [i8; 3] = [1, 0, 0];
const NX: [i8; 3] = [-1, 0, 0];
const PY: [i8; 3] = [0, 1, 0];
const NY: [i8; 3] = [0, -1, 0];
const PZ: [i8; 3] = [0, 0, 1];
const NZ: [i8; 3] = [0, 0, -1];

/// In the order +X -X +Y -Y +Z -Z, which also decides who owns an edge.
static CROSS_HORIZONTAL: [Face; 6] = [
    face(2, 1, PX, PZ, NY),
    face(0, 1, NX, NZ, NY),
    face(1, 0, PY, PX, NZ),
    face(1, 2, NY, PX, PZ),
    face(3, 1, PZ, NX, NY),
    face(1, 1, NZ, PX, NY),
];
static CROSS_VERTICAL: [Face; 6] = [
    face(2, 1, PX, PZ, NY),
    face(0, 1, NX, NZ, NY),
    face(1, 0, PY, PX, NZ),
    face(1, 2, NY, PX, PZ),
    face(1, 3, PZ, PX, PY), // upside down: it hangs on the lower edge of -Y
    face(1, 1, NZ, PX, NY),
];
/// OpenGL 4.6 core, table 8.19: s runs along `right`, t along `down`, the first row is t = 0.
static STRIP: [Face; 6] = [
    face(0, 0, PX, NZ, NY),
    face(1, 0, NX, PZ, NY),
    face(2, 0, PY, PX, PZ),
    face(3, 0, NY, PX, NZ),
    face(4, 0, PZ, PX, NY),
    face(5, 0, NZ, NX, NY),
];
/// `CubeMap::pixelPosition` in OpenEXR's `ImfEnvmap.cpp`.
static EXR: [Face; 6] = [
    face(0, 0, PX, PZ, NY),
    face(0, 1, NX, NZ, NY),
    face(0, 2, PY, PX, NZ),
    face(0, 3, NY, PX, PZ),
    face(0, 4, PZ, NX, NY),
    face(0, 5, NZ, PX, NY),
];

fn axis(a: [i8; 3]) -> DVec3 {
    DVec3::new(a[0].into(), a[1].into(), a[2].into())
}

impl Mapping {
    /// All layouts, the default first.
    pub const ALL: [Mapping; 9] = [
        Mapping::LatLong,
        Mapping::LatLongThree,
        Mapping::LatLongBlender,
        Mapping::LatLongMitsuba,
        Mapping::AngularMap,
        Mapping::CubeCrossHorizontal,
        Mapping::CubeCrossVertical,
        Mapping::CubeStrip,
        Mapping::CubeExr,
    ];

    /// The name in BAKE.toml and in messages.
    pub fn name(self) -> &'static str {
        match self {
            Mapping::LatLong => "lat-long",
            Mapping::LatLongThree => "lat-long-three",
            Mapping::LatLongBlender => "lat-long-blender",
            Mapping::LatLongMitsuba => "lat-long-mitsuba",
            Mapping::AngularMap => "angular",
            Mapping::CubeCrossHorizontal => "cube-cross-horizontal",
            Mapping::CubeCrossVertical => "cube-cross-vertical",
            Mapping::CubeStrip => "cube-strip",
            Mapping::CubeExr => "cube-exr",
        }
    }

    /// The layout called `name`, or `None`.
    pub fn parse(name: &str) -> Option<Mapping> {
        Self::ALL.into_iter().find(|mapping| mapping.name() == name)
    }

    /// Width and height of an image of this layout from its one free number: the width of a lat-long image or an
    /// angular map, the edge of a cube face.
    pub fn dimensions(self, size: usize) -> (usize, usize) {
        match self {
            Mapping::AngularMap => (size, size),
            _ => match self.faces() {
                Some(_) => {
                    let (columns, rows) = self.face_grid();
                    (columns * size, rows * size)
                }
                None => (size, (size / 2).max(1)),
            },
        }
    }

    /// Whether an image of `width` × `height` pixels can hold this layout; if not, a sentence that says what was
    /// expected and what the shape looks like. A lat-long image may have any shape: 2:1 is only usual.
    pub fn check_shape(self, width: usize, height: usize) -> Result<(), String> {
        let size = match self.faces() {
            None => width,
            Some(_) => width / self.face_grid().0,
        };
        if width == 0 || height == 0 {
            return Err(format!("the image has {width} x {height} pixels"));
        }
        let is_lat_long = self.turn().is_some();
        if size > 0 && (is_lat_long || self.dimensions(size) == (width, height)) {
            return Ok(());
        }
        let (columns, rows) = match self.faces() {
            None => (1, 1),
            Some(_) => self.face_grid(),
        };
        let hint = match guess_from_aspect(width, height) {
            Some(guess) => format!("; the shape is that of {}", guess.name()),
            None => String::new(),
        };
        Err(format!(
            "{width} x {height} pixels cannot be a panorama of mapping {}, whose width and height are as {columns}:{rows}{hint}",
            self.name()
        ))
    }

    /// Direction that position (`px`, `py`) of an image of `width` × `height` pixels looks along, unit length;
    /// `None` where the layout shows nothing (outside the disc, in the corners of a cross, outside the image).
    pub fn direction(self, width: usize, height: usize, px: f64, py: f64) -> Option<Vec3> {
        self.direction_f64(width, height, px, py).map(DVec3::as_vec3)
    }

    pub(super) fn direction_f64(self, width: usize, height: usize, px: f64, py: f64) -> Option<DVec3> {
        let (w, h) = (width as f64, height as f64);
        // Written so that NaN is outside too.
        if !(px >= 0.0 && px <= w && py >= 0.0 && py <= h) {
            return None;
        }
        if let Some(turn) = self.turn() {
            let longitude = 2.0 * PI * (0.5 - px / w + turn);
            let (sin, cos) = (PI * (0.5 - py / h)).sin_cos();
            return Some(DVec3::new(longitude.sin() * cos, sin, longitude.cos() * cos));
        }
        let Some(faces) = self.faces() else {
            // The angle from -Z grows linearly with the radius and is π on the rim.
            let (x, y) = (2.0 * px / w - 1.0, 1.0 - 2.0 * py / h);
            let radius = x.hypot(y);
            let sine_over_radius = if radius > 0.0 { (PI * radius).sin() / radius } else { PI };
            return (radius <= 1.0)
                .then(|| DVec3::new(x * sine_over_radius, y * sine_over_radius, -(PI * radius).cos()));
        };
        let edge = self.edge(width, height);
        // The last column and row of the image belong to the last face.
        let column = ((px / edge as f64) as usize).min(self.face_grid().0 - 1);
        let row = ((py / edge as f64) as usize).min(self.face_grid().1 - 1);
        let face = faces.iter().find(|face| face.column == column && face.row == row)?;
        let right = self.position_to_plane(px - (column * edge) as f64, edge);
        let down = self.position_to_plane(py - (row * edge) as f64, edge);
        Some((axis(face.forward) + right * axis(face.right) + down * axis(face.down)).normalize())
    }

    /// Position in an image of `width` × `height` pixels that shows `direction` (of any length); the inverse of
    /// [`Mapping::direction`]. Total: the zero vector gives a position inside the image.
    pub fn pixel(self, width: usize, height: usize, direction: Vec3) -> (f64, f64) {
        let (px, py, _) = self.pixel_and_bounds(width, height, direction.as_dvec3());
        (px, py)
    }

    /// [`Mapping::pixel`], and the rectangle of pixels [x0, y0, x1, y1) that shows the same smooth piece of the
    /// sphere (a cube face, or the whole image).
    pub(super) fn pixel_and_bounds(self, width: usize, height: usize, d: DVec3) -> (f64, f64, [usize; 4]) {
        let (w, h) = (width as f64, height as f64);
        let d = if d.is_finite() { d } else { DVec3::ZERO };
        let whole = [0, 0, width, height];
        if let Some(turn) = self.turn() {
            let horizontal = d.x.hypot(d.z);
            let longitude = if horizontal > 0.0 { d.x.atan2(d.z) } else { 0.0 };
            let u = (0.5 - longitude / (2.0 * PI) + turn).rem_euclid(1.0);
            return (u * w, (0.5 - d.y.atan2(horizontal) / PI) * h, whole);
        }
        let Some(faces) = self.faces() else {
            let sine = d.x.hypot(d.y);
            let radius = sine.atan2(-d.z) / PI;
            // +Z is the whole rim: take its right end.
            let (x, y) = if sine > 0.0 { (d.x / sine * radius, d.y / sine * radius) } else { (radius, 0.0) };
            return ((1.0 + x) / 2.0 * w, (1.0 - y) / 2.0 * h, whole);
        };
        let edge = self.edge(width, height);
        // The face whose axis is the longest component; of several, the first.
        let mut face = &faces[0];
        for candidate in faces {
            if axis(candidate.forward).dot(d) > axis(face.forward).dot(d) {
                face = candidate;
            }
        }
        let depth = axis(face.forward).dot(d);
        let d = if depth > 0.0 { d / depth } else { DVec3::ZERO };
        let (x0, y0) = (face.column * edge, face.row * edge);
        let px = x0 as f64 + self.plane_to_position(axis(face.right).dot(d), edge);
        let py = y0 as f64 + self.plane_to_position(axis(face.down).dot(d), edge);
        (px, py, [x0, y0, x0 + edge, y0 + edge])
    }

    /// Solid angle per unit of image area at a position, up to a constant factor: the weight of a sample there.
    pub(super) fn solid_angle_density(self, width: usize, height: usize, px: f64, py: f64) -> f64 {
        if self.turn().is_some() {
            return (PI * (0.5 - py / height as f64)).cos().max(0.0);
        }
        if self.faces().is_none() {
            let radius = (2.0 * px / width as f64 - 1.0).hypot(1.0 - 2.0 * py / height as f64);
            let angle = PI * radius.min(1.0);
            return if angle > 0.0 { angle.sin() / angle } else { 1.0 };
        }
        let edge = self.edge(width, height);
        let a = self.position_to_plane(px.rem_euclid(edge as f64), edge);
        let b = self.position_to_plane(py.rem_euclid(edge as f64), edge);
        (1.0 + a * a + b * b).powf(-1.5)
    }

    /// For a lat-long layout, by which part of its width it is turned against gdibl's: u = u_gdibl + turn.
    pub(super) fn turn(self) -> Option<f64> {
        match self {
            // Mitsuba: atan2(x, -z) = π - atan2(x, z), so u = ½ - atan2(x, z)/2π.
            Mapping::LatLong | Mapping::LatLongMitsuba => Some(0.0),
            // three.js: atan2(z, x) = π/2 - atan2(x, z), so u = ¾ - atan2(x, z)/2π.
            // Blender: its y is glTF's -z, so u = ½ - atan2(-z, x)/2π: the same.
            Mapping::LatLongThree | Mapping::LatLongBlender => Some(0.25),
            _ => None,
        }
    }

    fn faces(self) -> Option<&'static [Face; 6]> {
        match self {
            Mapping::CubeCrossHorizontal => Some(&CROSS_HORIZONTAL),
            Mapping::CubeCrossVertical => Some(&CROSS_VERTICAL),
            Mapping::CubeStrip => Some(&STRIP),
            Mapping::CubeExr => Some(&EXR),
            _ => None,
        }
    }

    /// Columns and rows of faces of a cube layout.
    fn face_grid(self) -> (usize, usize) {
        match self {
            Mapping::CubeCrossHorizontal => (4, 3),
            Mapping::CubeCrossVertical => (3, 4),
            Mapping::CubeStrip => (6, 1),
            Mapping::CubeExr => (1, 6),
            _ => (1, 1),
        }
    }

    /// Edge of a cube face in pixels.
    pub(super) fn edge(self, width: usize, height: usize) -> usize {
        let (columns, rows) = self.face_grid();
        (width / columns).min(height / rows).max(1)
    }

    /// Position within a face, 0..=edge, to the face's plane, -1..=1. OpenEXR puts the centres of the outermost
    /// pixels on the cube's edges, so its faces share them; everyone else ends the pixels there.
    fn position_to_plane(self, position: f64, edge: usize) -> f64 {
        match self {
            Mapping::CubeExr if edge == 1 => 0.0,
            Mapping::CubeExr => ((position - 0.5) / (edge - 1) as f64 * 2.0 - 1.0).clamp(-1.0, 1.0),
            _ => position / edge as f64 * 2.0 - 1.0,
        }
    }

    /// The inverse of [`Mapping::position_to_plane`].
    fn plane_to_position(self, plane: f64, edge: usize) -> f64 {
        match self {
            Mapping::CubeExr => (plane + 1.0) / 2.0 * (edge - 1) as f64 + 0.5,
            _ => (plane + 1.0) / 2.0 * edge as f64,
        }
    }
}

/// The layout that an image of this shape most likely has: a hint for messages, never a decision.
pub fn guess_from_aspect(width: usize, height: usize) -> Option<Mapping> {
    if width == 0 || height == 0 {
        return None;
    }
    if width == height {
        return Some(Mapping::AngularMap);
    }
    if width == 2 * height {
        return Some(Mapping::LatLong);
    }
    [Mapping::CubeCrossHorizontal, Mapping::CubeCrossVertical, Mapping::CubeStrip, Mapping::CubeExr]
        .into_iter()
        .find(|mapping| mapping.dimensions(mapping.edge(width, height)) == (width, height))
}
