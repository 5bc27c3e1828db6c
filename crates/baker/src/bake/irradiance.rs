//! Light at a node as irradiance's own coefficients, to compare nodes and what lies between them.

use gdibl_runtime::sh;

/// Values of E's own coefficients, up to L2: see [`sh::COSINE`]. Their root sum of squares is that of E over all normals.
pub(crate) type Irradiance = [f32; 27];

/// Of radiance coefficients, `[coefficient][rgb]` flat.
pub(crate) fn irradiance_of(radiance: &[f32]) -> Irradiance {
    let mut values = [0.0; 27];
    for (index, (value, radiance)) in values.iter_mut().zip(radiance).enumerate() {
        *value = radiance * sh::COSINE[sh::band_of(index / 3)];
    }
    values
}

/// Root sum of squares.
pub(crate) fn strength(irradiance: &Irradiance) -> f64 {
    irradiance.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>().sqrt()
}

/// Of E over all normals and channels.
pub(crate) fn root_mean_square(irradiance: &Irradiance) -> f64 {
    strength(irradiance) / (12.0 * std::f64::consts::PI).sqrt()
}

/// a - b.
pub(crate) fn difference(a: &Irradiance, b: &Irradiance) -> Irradiance {
    std::array::from_fn(|i| a[i] - b[i])
}
