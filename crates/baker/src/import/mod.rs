//! The one place that knows files: levels ([`gltf`]), panoramas ([`image`]), the sky ([`sky`]) and truth to compare
//! with ([`mod@reference`]).

pub mod files;
pub mod gltf;
pub mod image;
pub mod reference;
pub mod sky;
