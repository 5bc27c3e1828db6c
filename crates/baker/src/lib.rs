//! Bakes irradiance volumes by Geometrically Derived Image Based Lighting.
//!
//! Data flows in one direction: [`import`] → [`scene`], [`panorama`] → trace → radiance → bake → volume.
//! Only [`import`] knows files; the library never prints.

pub mod error;
pub mod import;
pub mod panorama;
pub mod scene;

pub use error::{Error, Finding, Result};
