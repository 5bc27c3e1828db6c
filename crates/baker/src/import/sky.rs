//! Reads what is at infinity: a panorama, or the same light from everywhere.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use glam::{DQuat, Quat};

use super::files::{Disk, Files};
use super::image::{ReadOptions, read_image_from};
use crate::panorama::{Mapping, Panorama, to_lat_long};
use crate::radiance::Distant;
use crate::{Error, Finding, Result};

/// Where the light at infinity comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum SkySource {
    /// A panorama's file.
    Image(PathBuf),
    /// Linear Rec.709 radiance, the same from all directions.
    Constant([f32; 3]),
}

impl FromStr for SkySource {
    type Err = String;

    /// `R,G,B` is constant; anything else is the name of a file (`./1,1,1` is one, too).
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let numbers: Option<Vec<f32>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
        let Some(&[r, g, b]) = numbers.as_deref() else { return Ok(SkySource::Image(text.into())) };
        match [r, g, b] {
            radiance if radiance.iter().all(|v| v.is_finite() && *v >= 0.0) => Ok(SkySource::Constant(radiance)),
            _ => Err(format!("'{text}': expected three numbers >= 0: the radiance of a sky without a file")),
        }
    }
}

/// How the sky is read and turned.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SkyOptions {
    /// How the image is read.
    pub read: ReadOptions,
    /// How the image maps directions; `None`: as its file says, else lat-long for an image twice as wide as high.
    pub mapping: Option<Mapping>,
    /// Panorama to world, a quaternion of about unit length; `None`: as its file says, else none.
    pub rotation: Option<DQuat>,
    /// Degrees by which the sky is turned around +Y after `rotation`, counter-clockwise as seen from above: 90 brings
    /// what was at +Z to +X.
    pub yaw_degrees: f64,
    /// Radiance = pixel × 2^exposure_stops.
    pub exposure_stops: f32,
}

/// Reads the sky, and what its file has that deserves a look.
pub fn read_sky(source: &SkySource, options: &SkyOptions) -> Result<(Distant, Vec<Finding>)> {
    read_sky_from(&Disk, source, options)
}

/// The same with the bytes that `files` gives.
pub fn read_sky_from(files: &dyn Files, source: &SkySource, options: &SkyOptions) -> Result<(Distant, Vec<Finding>)> {
    let (name, panorama, rotation, findings) = match source {
        SkySource::Constant(radiance) => {
            let [r, g, b] = radiance;
            let name = format!("constant {r},{g},{b}");
            (name, Panorama::new(1, 1, vec![*radiance], None), options.rotation, Vec::new())
        }
        SkySource::Image(path) => {
            let imported = read_image_from(files, path, &options.read)?;
            let mapping = imported.layout(path, options.mapping)?;
            let panorama = to_lat_long(&imported.image, mapping, None);
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let rotation = options.rotation.or(imported.pose.rotation);
            (name, panorama, rotation, imported.findings)
        }
    };
    let yaw = DQuat::from_rotation_y(options.yaw_degrees.to_radians());
    let rotation = unit(Path::new(&name), rotation.unwrap_or(DQuat::IDENTITY))?;
    let rotation: Quat = (yaw * rotation).normalize().as_quat();
    let exposure_stops = options.exposure_stops;
    Ok((Distant { name, rotation, exposure_stops, panorama, without_sun: None }, findings))
}

fn unit(path: &Path, rotation: DQuat) -> Result<DQuat> {
    let length = rotation.length();
    if length.is_finite() && length > 1e-6 {
        return Ok(rotation / length);
    }
    Err(Error::invalid(path, format!("rotation {rotation:?}: expected a quaternion x y z w of length 1")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn three_numbers_are_a_sky_and_anything_else_a_file() {
        assert_eq!("1,1,1".parse(), Ok(SkySource::Constant([1.0; 3])));
        assert_eq!("0.5, 2e3,0".parse(), Ok(SkySource::Constant([0.5, 2000.0, 0.0])));
        for file in ["sky.exr", "./1,1,1", "1,1", "1,1,1,1", "1", "", "a,b,c"] {
            assert_eq!(file.parse(), Ok(SkySource::Image(file.into())));
        }
        for wrong in ["-1,1,1", "nan,1,1", "1,inf,1"] {
            assert!(wrong.parse::<SkySource>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn yaw_turns_counter_clockwise_and_exposure_doubles() {
        let options = SkyOptions { yaw_degrees: 90.0, exposure_stops: 1.0, ..SkyOptions::default() };
        let (sky, findings) = read_sky(&SkySource::Constant([1.0, 2.0, 3.0]), &options).unwrap();
        assert!((sky.rotation * Vec3::Z - Vec3::X).length() < 1e-6 && findings.is_empty());
        assert_eq!((sky.exposure_stops, sky.name.as_str()), (1.0, "constant 1,2,3"));
        assert_eq!(sky.panorama.radiance(Vec3::NEG_Y).to_array(), [1.0, 2.0, 3.0]);
        // After the panorama's own rotation, in the world: what points up stays at the pole.
        let tilted = SkyOptions { rotation: Some(DQuat::from_rotation_x(0.3)), yaw_degrees: 30.0, ..options };
        let (sky, _) = read_sky(&SkySource::Constant([1.0; 3]), &tilted).unwrap();
        let up = Quat::from_rotation_x(0.3) * Vec3::Y;
        assert!(((sky.rotation * Vec3::Y).y - up.y).abs() < 1e-6);
    }
}
