//! The one place that knows files: levels ([`gltf`]) and panoramas ([`image`]).
