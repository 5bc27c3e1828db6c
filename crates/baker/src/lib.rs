//! Bakes irradiance volumes by Geometrically Derived Image Based Lighting (GDIBL; K. Vestergaard, 2008).
//!
//! Light flows in one direction through the modules:
//!
//! ```text
//! import ─→ scene, panorama ─→ trace ─→ radiance ─→ bake ─→ volume ─→ .gdibl
//!                                          ↑          ↑
//!                                   gdibl or path  sampling        beside it: capture, render, plan, records, cut
//! ```
//! Only [`import`] knows files, and [`volume`] how one is written whole; the library never prints. World axes are glTF's:
//! right-handed, Y up, metres. Radiance is linear Rec.709 RGB. Stored are radiance coefficients L_lm; who shades
//! with them writes `diffuse = albedo / PI * irradiance` (see `gdibl_runtime::sh`).

pub mod analyse;
mod angle;
pub mod bake;
pub mod bands;
pub mod capture;
mod colour;
mod control;
pub mod cut;
pub mod deringing;
pub mod error;
pub mod import;
pub mod panorama;
pub mod plan;
pub mod radiance;
pub mod records;
pub mod render;
pub mod sampling;
pub mod scene;
pub mod trace;
pub mod volume;
mod whole;

pub use control::{Control, Interrupted};
pub use error::{Error, Finding, Result};
