//! The one place that knows files: levels ([`gltf`]), panoramas ([`image`]) and truth to compare with ([`mod@reference`]).

pub mod gltf;
pub mod image;
pub mod reference;
