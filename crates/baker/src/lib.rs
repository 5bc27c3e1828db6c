//! Bakes irradiance volumes by Geometrically Derived Image Based Lighting (GDIBL; K. Vestergaard, 2008).
//!
//! Light flows in one direction through the modules:
//!
//! ```text
//! import ─→ scene, panorama ─→ trace ─→ radiance ─→ bake ─→ pack ─→ .gdibl
//!                                          ↑          ↑
//!                                   gdibl or path  sampling        beside it: air, capture, render, cut, seen; around it: job
//! ```
//! [`job`] puts a whole bake together. Only [`import`] knows files, and [`pack`] how one is written whole; the library never
//! prints. World axes are glTF's: right-handed, Y up, metres. Radiance is linear Rec.709 RGB. Stored are radiance
//! coefficients L_lm; who shades with them writes `diffuse = albedo / PI * irradiance` (see `gdibl_runtime::sh`).
//!
//! A level given as values, baked to a volume:
//! ```
//! use gdibl_baker::job::{Inputs, Job, Memory, Settings, Watch};
//! use gdibl_baker::scene::{Material, Mesh, Scene};
//! use glam::{DVec3, Vec3};
//!
//! // A lamp of radiance 1 two metres above the origin, one square metre, facing down.
//! let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)];
//! let positions: Vec<DVec3> = corners.iter().map(|&(x, z)| DVec3::new(x, 2.0, z)).collect();
//! let normals = vec![Vec3::NEG_Y; 4];
//! let lamp = Mesh { positions, normals, triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() };
//! let glowing = Material { emission: Vec3::ONE, ..Material::default() };
//! let scene = Scene { meshes: vec![lamp], materials: vec![glowing], ..Scene::default() };
//!
//! let mut settings = Settings::default();
//! settings.grid.bounds = Some([-1.0, 0.0, -1.0, 1.0, 1.0, 1.0]);
//! settings.grid.counts = Some([3, 2, 3]);
//! let job = Job::prepare(Inputs::new(scene), settings, Memory::UNBOUNDED)?;
//! let made = job.run(&Watch::silent(&Default::default()))?;
//! let volume = gdibl_runtime::Volume::parse(&made.sections().assemble().bytes).expect("what was packed parses");
//! let [red, _, _] = volume.irradiance([0.0, 1.0, 0.0], [0.0, 1.0, 0.0]);
//! // The lamp fills 0.239 of what a surface that faces it sees, weighed by the cosine: E = 0.239 pi.
//! assert!((red - 0.75).abs() < 0.05, "{red}");
//! # Ok::<(), gdibl_baker::job::Stop>(())
//! ```

pub mod air;
pub mod analyse;
mod angle;
pub mod bake;
pub mod blocks;
pub mod capture;
mod colour;
mod control;
pub mod cut;
mod disjoint;
pub mod drawn;
pub mod error;
pub mod exposure;
pub mod import;
pub mod job;
pub mod pack;
pub mod panorama;
pub mod radiance;
pub mod render;
pub mod rows;
pub mod sampling;
pub mod scene;
pub mod seen;
pub mod trace;
mod whole;

pub use control::{Control, Interrupted};
pub use error::{Error, Finding, Result};
