//! Laws that every bake obeys, whatever the level: numbers come after.

mod air;
mod between;
mod blending;
mod cut;
mod deringing;
mod exact;
mod exposure;
mod extremes;
mod gather;
mod geometry;
mod level;
mod light;
mod packing;
mod paged;
mod paths;
mod probes;
mod regions;
mod remembered;
mod render;
mod sight;
mod spacing;
mod sparse;
mod statistics;
mod sun;
mod unseen;
mod walls;
