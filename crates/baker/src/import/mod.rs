//! The one place that knows files: levels ([`gltf`]) and panoramas ([`image`]).

pub mod gltf;
pub mod image;
