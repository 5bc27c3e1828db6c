//! Reading glTF levels through the public interface.

mod builder;
mod compressed;
mod containers;
mod geometry;
mod light;
mod materials;
mod mutations;
mod nodes;
mod refusals;
mod shared;
