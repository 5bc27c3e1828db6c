//! Loads `.gdibl` irradiance volumes in Bevy, lights objects by them, and reloads them when their files change.
//!
//! ```no_run
//! use bevy::prelude::*;
//! use gdibl_bevy::{GdiblPlugin, GdiblVolume};
//!
//! fn main() {
//!     App::new().add_plugins((DefaultPlugins, GdiblPlugin)).add_systems(Startup, setup).run();
//! }
//!
//! fn setup(mut commands: Commands, asset_server: Res<AssetServer>) {
//!     commands.spawn(GdiblVolume { asset: asset_server.load("level.gdibl"), intensity: 1000.0 });
//! }
//! ```
//! The entity becomes a light probe with an [`IrradianceVolume`], as large and where the volume was baked: the level's
//! coordinates are those of its parent, if it has one. A parent may move and scale it; turned by a parent the box
//! turns, but not the light in it, for Bevy asks for light by the normal in the world.
//!
//! With the feature `file_watcher` a volume baked again shows in the running program.
//!
//! # What Bevy 0.19 does with it
//! * It blends six colours per voxel, an ambient cube; what that loses of the volume's L2, `gdibl export --to bevy`
//!   tells. The volume itself is in the asset, for code that asks for light exactly: [`GdiblAsset::volume`].
//! * Outside the box, half a voxel beyond the outermost nodes, there is no light; that of environment maps is left out
//!   in all of a view that has a volume, also there. Where boxes overlap Bevy takes the mean, weighted by the falloff
//!   of [`LightProbe`], which does nothing elsewhere.
//! * A view sees the eight nearest volumes, and the nearest alone where textures cannot be bound in arrays; in web
//!   builds none.
//! * Ambient light is added to the volume's, and Bevy's default has some: for the baked light alone, insert
//!   `GlobalAmbientLight::NONE`.
//! * The light is diffuse. What a surface mirrors comes from Bevy's reflection probes.
//!
//! `examples/box.rs` draws the shipped box; `examples/check.rs` compares Bevy's pictures with the volume's own light.
#![forbid(unsafe_code)]

use bevy::asset::io::Reader;
use bevy::asset::{AsAssetId, AssetEventSystems, AssetLoader, LoadContext, RenderAssetUsages};
use bevy::image::ImageSampler;
use bevy::light::IrradianceVolume;
use bevy::prelude::*;
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
use gdibl_export::bevy::{Format, voxels};
use gdibl_runtime::Volume;

/// Loads [`GdiblAsset`]s, and lights what is in the boxes of [`GdiblVolume`]s.
pub struct GdiblPlugin;

impl Plugin for GdiblPlugin {
    fn build(&self, app: &mut App) {
        app.init_asset::<GdiblAsset>()
            .init_asset_loader::<GdiblLoader>()
            // Texture and place change in the same frame, also when reloaded.
            .add_systems(PostUpdate, place.after(AssetEventSystems).before(TransformSystems::Propagate));
    }
}

/// A volume, and what Bevy draws of it.
#[derive(Asset, TypePath, Debug)]
pub struct GdiblAsset {
    /// As parsed: its `irradiance(position, normal)` is in the level's coordinates.
    pub volume: Volume,
    /// Ambient cubes, as [`IrradianceVolume::voxels`].
    #[dependency]
    pub voxels: Handle<Image>,
    /// Brings texels to E/π in the units of the panoramas.
    pub intensity: f32,
    /// Of the unit cube into the level's coordinates.
    pub transform: Transform,
}

/// Lights what is in the volume's box, once it is loaded. Sets the entity's [`Transform`] and its
/// [`IrradianceVolume`]'s texture and intensity whenever this component or the asset changes; falloff and lightmaps are
/// left to the caller.
#[derive(Component, Clone, Debug)]
#[require(Transform)]
pub struct GdiblVolume {
    /// What to light by.
    pub asset: Handle<GdiblAsset>,
    /// What radiance 1 of the panoramas is, cd/m². At Bevy's default exposure 1000 comes out as white.
    pub intensity: f32,
}

impl AsAssetId for GdiblVolume {
    type Asset = GdiblAsset;

    fn as_asset_id(&self) -> AssetId<GdiblAsset> {
        self.asset.id()
    }
}

/// Parses the file, and makes the texture.
#[derive(Default, TypePath)]
struct GdiblLoader;

impl AssetLoader for GdiblLoader {
    type Asset = GdiblAsset;
    type Settings = ();
    // Bevy puts the file's name before the message.
    type Error = BevyError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        (): &(),
        context: &mut LoadContext<'_>,
    ) -> Result<GdiblAsset, BevyError> {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).await?;
        let volume = Volume::parse(&bytes)?;
        // Half the memory of RGBA16F, and as near: the check measures both.
        let cubes = voxels(&volume, None, Format::Rgb9e5)?;
        let [width, height, depth] = cubes.size;
        let mut image = Image::new(
            Extent3d { width, height, depth_or_array_layers: depth },
            TextureDimension::D3,
            cubes.bytes,
            TextureFormat::Rgb9e5Ufloat,
            RenderAssetUsages::RENDER_WORLD,
        );
        // Also where an app draws its images in pixels.
        image.sampler = ImageSampler::linear();
        let metres = |v: [f64; 3]| Vec3::from_array(v.map(|v| v as f32));
        Ok(GdiblAsset {
            volume,
            voxels: context.add_labeled_asset("voxels", image),
            intensity: cubes.intensity,
            transform: Transform {
                translation: metres(cubes.translation),
                scale: metres(cubes.scale),
                ..Transform::IDENTITY
            },
        })
    }

    fn extensions(&self) -> &[&str] {
        &["gdibl"]
    }
}

/// Volumes whose component or asset has changed since.
type Stale = Or<(Changed<GdiblVolume>, AssetChanged<GdiblVolume>)>;

/// Brings entities up to date with their assets. An [`IrradianceVolume`] is added only once there is a texture: Bevy
/// would bind its default image, which is flat, in place of one in 3-D.
fn place(
    mut commands: Commands,
    assets: Res<Assets<GdiblAsset>>,
    volumes: Query<(Entity, &GdiblVolume, Option<&IrradianceVolume>), Stale>,
) {
    for (entity, volume, placed) in &volumes {
        let Some(asset) = assets.get(&volume.asset) else { continue };
        let irradiance_volume = IrradianceVolume {
            voxels: asset.voxels.clone(),
            intensity: asset.intensity * volume.intensity,
            ..placed.cloned().unwrap_or_default()
        };
        commands.entity(entity).insert((irradiance_volume, asset.transform));
    }
}
