//! The whole program, from files to files.

#[path = "../common/mod.rs"]
mod common;

mod bake;
mod capture;
mod compare;
mod config;
mod cut;
mod dering;
mod export;
mod exposure;
mod farm;
mod furnace;
mod json;
mod leaving_out;
mod light;
mod packed;
mod probes;
mod reader;
mod records;
mod render;
mod report;
mod settings;
mod sky;
mod study;
mod sun;
mod volumes;
