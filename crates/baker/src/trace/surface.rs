//! What a surface does to light: how much of a ray it stops, what passes straight on, what is reflected and let through
//! diffusely, what is sent out.
//!
//! ```text
//! α           coverage: 1, a mask's 0 or 1, or the base colour's alpha
//! t, d        transmission, diffuse transmission      m  metallic      b  base colour × texture × vertex colour
//! T           = (1 - α) + α (1 - m) t b A             passes straight on, by colour; A: the volume's attenuation,
//!                                                     where the ray enters it, by a front
//! q           = 1 - max T                             the opacity: a ray stops with this probability ...
//! T / (1 - q)                                         ... or goes on with this tint
//! reflected   = b ((1 - m)(1 - t)(1 - d) + m s)       s: what a rough metal reflects of b
//! let through = c (1 - m)(1 - t) d A                  c: the diffuse transmission's colour
//! ```
//! What a ray that stops finds is weighed by α/q, so that all together is right on average. Based on: Khronos Group,
//! *glTF 2.0 Specification*, appendix B; KHR_materials_transmission, KHR_materials_volume,
//! KHR_materials_diffuse_transmission. Fresnel's and all specular reflection of non-metals is left out.

use glam::{Vec2, Vec3, Vec4};

use super::triangle::TreeHit;
use super::{Hit, Surfaces, geometric_normal};
use crate::scene::{Alpha, Material, Metals, Scene, TextureUse, rough_metal_share};

/// What also glows stops a ray at least this often, of what it covers.
const LEAST_STOP: f32 = 0.5;

/// Where light goes on from a surface, and what share of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scattered {
    /// The hit; seen from the other side where light is let through.
    pub hit: Hit,
    /// Share that a Lambertian surface there sends on, by colour; above 1 at most where the choice of side makes up for it.
    pub albedo: Vec3,
}

impl Surfaces {
    /// Diffuse albedo, linear RGB: base colour × texture × vertex colour × (1 - metallic), and what metals reflect; black
    /// where unlit.
    pub fn albedo(&self, scene: &Scene, hit: &Hit) -> Vec3 {
        self.albedo_of(scene, self.material(scene, hit.triangle), hit)
    }

    #[inline]
    fn albedo_of(&self, scene: &Scene, material: &Material, hit: &Hit) -> Vec3 {
        if material.unlit {
            return Vec3::ZERO;
        }
        let base = self.base_color(scene, hit.triangle, hit.barycentric).truncate();
        let (metallic, metal) = self.metal(scene, material, hit.triangle, hit.barycentric);
        let dielectric = 1.0 - metallic;
        if !material.is_transmissive() {
            return base * (dielectric + metal);
        }
        let kept = 1.0 - self.transmission(scene, material, hit.triangle, hit.barycentric);
        let reflected = 1.0 - self.diffuse_transmission(scene, material, hit.triangle, hit.barycentric);
        base * (dielectric * kept * reflected + metal) * self.stop_weight(scene, material, hit)
    }

    /// Where a ray that met `hit` goes on: on its own side, or, by chance, on the other where the surface lets light through
    /// diffusely. `chance` gives a random number in 0..1.
    pub fn scatter(&self, scene: &Scene, hit: &Hit, chance: impl FnOnce() -> f32) -> Scattered {
        let material = self.material(scene, hit.triangle);
        let albedo = self.albedo_of(scene, material, hit);
        if material.diffuse_transmission == 0.0 || material.unlit {
            return Scattered { hit: *hit, albedo };
        }
        let (triangle, place) = (hit.triangle, hit.barycentric);
        let (metallic, _) = self.metal(scene, material, triangle, place);
        let share = (1.0 - metallic)
            * (1.0 - self.transmission(scene, material, triangle, place))
            * self.diffuse_transmission(scene, material, triangle, place)
            * self.stop_weight(scene, material, hit);
        let color = self.texel(scene, triangle, place, material.diffuse_transmission_color_texture);
        let mut through = material.diffuse_transmission_color * color.truncate() * share;
        if material.attenuation != Vec3::ONE && !hit.back {
            through *= self.attenuation(scene, material, triangle, place);
        }
        let [reflects, lets_through] = [albedo, through].map(|share| share.max_element());
        let probability = lets_through / (reflects + lets_through).max(f32::MIN_POSITIVE);
        if lets_through > 0.0 && chance() < probability {
            let other = Hit { normal: -hit.normal, back: !hit.back, ..*hit };
            return Scattered { hit: other, albedo: through / probability };
        }
        Scattered { hit: *hit, albedo: albedo / (1.0 - probability).max(f32::MIN_POSITIVE) }
    }

    /// Emitted radiance toward the side the ray came from, linear RGB.
    pub fn emission(&self, scene: &Scene, hit: &Hit) -> Vec3 {
        let material = self.material(scene, hit.triangle);
        if material.emission == Vec3::ZERO || (hit.back && !material.double_sided) {
            return Vec3::ZERO;
        }
        let texel = self.texel(scene, hit.triangle, hit.barycentric, material.emission_texture);
        let mut emission = material.emission * texel.truncate();
        let mesh = self.mesh(scene, hit.triangle);
        if material.unlit && !mesh.colors.is_empty() {
            emission *= self.interpolate(scene, hit.triangle, hit.barycentric, &mesh.colors).truncate();
        }
        if material.transmission > 0.0 {
            emission *= self.stop_weight(scene, material, hit);
        }
        emission
    }

    /// What a mirror there does to the light it reflects; `None` where there is none.
    pub fn mirror_color(&self, scene: &Scene, hit: &Hit) -> Option<Vec3> {
        let material = self.material(scene, hit.triangle);
        let is_mirror = material.is_mirror()
            && self.map(scene, hit.triangle, hit.barycentric, material.metallic_map) * material.metallic >= 0.5;
        is_mirror.then(|| self.base_color(scene, hit.triangle, hit.barycentric).truncate())
    }

    /// The probability with which a ray in this direction stops at a place on a triangle, 0..=1.
    pub fn opacity_at(&self, scene: &Scene, triangle: u32, barycentric: Vec2, direction: Vec3) -> f32 {
        let material = self.material(scene, triangle);
        let coverage = self.coverage(scene, material, triangle, barycentric);
        if material.transmission == 0.0 {
            return coverage;
        }
        let opacity = 1.0 - self.straight(scene, material, triangle, barycentric, direction, coverage).max_element();
        if material.emission == Vec3::ZERO { opacity } else { opacity.max(LEAST_STOP * coverage) }
    }

    /// Share of light that passes straight on at a place on a triangle, by colour, 0..=1; of a ray in this direction.
    pub fn clear_at(&self, scene: &Scene, triangle: u32, barycentric: Vec2, direction: Vec3) -> Vec3 {
        let material = self.material(scene, triangle);
        let coverage = self.coverage(scene, material, triangle, barycentric);
        if material.transmission == 0.0 {
            return Vec3::splat(1.0 - coverage);
        }
        self.straight(scene, material, triangle, barycentric, direction, coverage)
    }

    /// What the light of a ray that does not stop at `hit` is multiplied by: white unless something colours it.
    pub fn tint(&self, scene: &Scene, hit: &Hit) -> Vec3 {
        let material = self.material(scene, hit.triangle);
        if material.transmission == 0.0 || hit.opacity >= 1.0 {
            return Vec3::ONE;
        }
        self.clear_at(scene, hit.triangle, hit.barycentric, along(hit)) / (1.0 - hit.opacity)
    }

    /// [`Surfaces::opacity_at`]; `None` where the ray meets nothing: in a hole, or what is altogether clear.
    pub(super) fn counting_opacity(&self, scene: &Scene, hit: &TreeHit, direction: Vec3) -> Option<f32> {
        let place = Vec2::new(hit.v, hit.w);
        let opacity = self.opacity_at(scene, hit.triangle, place, direction);
        let tints = || {
            self.material(scene, hit.triangle).transmission > 0.0
                && self.clear_at(scene, hit.triangle, place, direction) != Vec3::ONE
        };
        (opacity > 0.0 || tints()).then_some(opacity)
    }

    /// Base colour × texture × vertex colour, linear, alpha last.
    pub fn base_color(&self, scene: &Scene, triangle: u32, barycentric: Vec2) -> Vec4 {
        let mesh = self.mesh(scene, triangle);
        let material = &scene.materials[mesh.material as usize];
        let mut color = material.base_color * self.texel(scene, triangle, barycentric, material.base_color_texture);
        if !mesh.colors.is_empty() {
            color *= self.interpolate(scene, triangle, barycentric, &mesh.colors);
        }
        color
    }

    fn coverage(&self, scene: &Scene, material: &Material, triangle: u32, barycentric: Vec2) -> f32 {
        match material.alpha {
            Alpha::Opaque => 1.0,
            Alpha::Mask(cutoff) => f32::from(self.base_color(scene, triangle, barycentric).w >= cutoff),
            Alpha::Blend => self.base_color(scene, triangle, barycentric).w.clamp(0.0, 1.0),
        }
    }

    /// T of the module's first lines.
    fn straight(
        &self,
        scene: &Scene,
        material: &Material,
        triangle: u32,
        place: Vec2,
        direction: Vec3,
        coverage: f32,
    ) -> Vec3 {
        let (metallic, _) = self.metal(scene, material, triangle, place);
        let share = (1.0 - metallic) * self.transmission(scene, material, triangle, place);
        let mut color = self.base_color(scene, triangle, place).truncate();
        let enters = || geometric_normal(&self.corners[triangle as usize]).dot(direction) < 0.0;
        if material.attenuation != Vec3::ONE && enters() {
            color *= self.attenuation(scene, material, triangle, place);
        }
        (Vec3::splat(1.0 - coverage) + color * (coverage * share)).clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// Share of light that passes the volume's thickness.
    fn attenuation(&self, scene: &Scene, material: &Material, triangle: u32, place: Vec2) -> Vec3 {
        let thickness = self.map(scene, triangle, place, material.thickness_map);
        if thickness == 1.0 { material.attenuation } else { material.attenuation.powf(thickness) }
    }

    /// α/q: what is found where a ray stops stands for all that the surface covers.
    fn stop_weight(&self, scene: &Scene, material: &Material, hit: &Hit) -> f32 {
        if material.transmission == 0.0 {
            return 1.0;
        }
        let opacity = self.opacity_at(scene, hit.triangle, hit.barycentric, along(hit));
        let coverage = self.coverage(scene, material, hit.triangle, hit.barycentric);
        if opacity > 0.0 { coverage / opacity } else { 0.0 }
    }

    /// Metallic, and the share of base colour that is reflected for it, both 0..=1.
    #[inline]
    fn metal(&self, scene: &Scene, material: &Material, triangle: u32, place: Vec2) -> (f32, f32) {
        if material.metallic == 0.0 {
            return (0.0, 0.0);
        }
        let metallic = material.metallic * self.map(scene, triangle, place, material.metallic_map);
        if metallic == 0.0 || material.metals == Metals::Black {
            return (metallic, 0.0);
        }
        let roughness = material.roughness * self.map(scene, triangle, place, material.roughness_map);
        (metallic, metallic * rough_metal_share(roughness))
    }

    fn transmission(&self, scene: &Scene, material: &Material, triangle: u32, place: Vec2) -> f32 {
        match material.transmission {
            0.0 => 0.0,
            factor => factor * self.map(scene, triangle, place, material.transmission_map),
        }
    }

    fn diffuse_transmission(&self, scene: &Scene, material: &Material, triangle: u32, place: Vec2) -> f32 {
        match material.diffuse_transmission {
            0.0 => 0.0,
            factor => factor * self.map(scene, triangle, place, material.diffuse_transmission_map),
        }
    }

    fn texel(&self, scene: &Scene, triangle: u32, barycentric: Vec2, texture: Option<TextureUse>) -> Vec4 {
        let Some(texture) = texture else { return Vec4::ONE };
        let uv = self.texture_place(scene, triangle, barycentric, &texture);
        uv.map_or(Vec4::ONE, |uv| scene.textures[texture.texture as usize].sample(uv))
    }

    /// The value of a map; 1 without one.
    fn map(&self, scene: &Scene, triangle: u32, barycentric: Vec2, map: Option<TextureUse>) -> f32 {
        let Some(map) = map else { return 1.0 };
        let uv = self.texture_place(scene, triangle, barycentric, &map);
        uv.map_or(1.0, |uv| scene.maps[map.texture as usize].sample(uv))
    }

    fn texture_place(&self, scene: &Scene, triangle: u32, barycentric: Vec2, texture: &TextureUse) -> Option<Vec2> {
        let uvs = &self.mesh(scene, triangle).uvs[texture.uv_set as usize];
        if uvs.is_empty() {
            return None;
        }
        let uv = self.interpolate(scene, triangle, barycentric, uvs);
        Some(texture.transform.transform_point2(uv))
    }
}

/// A direction in which rays meet this side.
fn along(hit: &Hit) -> Vec3 {
    -hit.normal
}
