//! The shipped box with its three spheres, in the light of its volume alone.
//!
//! ```sh
//! cd assets/uffizi-box && cargo run --release -- bake uffizi-box.bake.toml -o uffizi-box.gdibl
//! cd integrations/bevy && cargo run --features window --example box
//! ```
//! Bake it in another light (`--distant SKY.hdr`) while the window is open, and it changes.

use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::GlobalAmbientLight;
use bevy::prelude::*;
use gdibl_bevy::{GdiblPlugin, GdiblVolume};

fn main() {
    let assets = AssetPlugin { file_path: "../../assets/uffizi-box".into(), ..default() };
    App::new()
        .add_plugins((DefaultPlugins.set(assets), GdiblPlugin))
        .insert_resource(GlobalAmbientLight::NONE)
        .add_systems(Startup, setup)
        .run();
}

fn setup(mut commands: Commands, asset_server: Res<AssetServer>) {
    commands.spawn(WorldAssetRoot(asset_server.load(GltfAssetLabel::Scene(0).from_asset("uffizi-box.glb"))));
    commands.spawn(GdiblVolume { asset: asset_server.load("uffizi-box.gdibl"), intensity: 3000.0 });
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(0.85, 1.8, 3.6).looking_at(Vec3::new(-0.1, 0.8, 0.0), Vec3::Y),
        Tonemapping::AcesFitted,
    ));
}
