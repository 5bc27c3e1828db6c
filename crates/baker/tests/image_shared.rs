//! Real and hostile images: OpenEXR's own test images, files that broke decoders, real panoramas. They are not part
//! of the repository; without them these tests say so and pass.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use gdibl_baker::Error;
use gdibl_baker::import::image::{Imported, ReadOptions, read_image};
use gdibl_baker::panorama::{Mapping, to_lat_long};
use glam::Vec3;

const STRICT: ReadOptions = ReadOptions { repair_pixels: false, layer: None };
const REPAIR: ReadOptions = ReadOptions { repair_pixels: true, layer: None };

/// The folder of shared inputs: `GDIBL_SHARED`, or `shared/inputs` beside the repository.
fn shared(folder: &str) -> Option<PathBuf> {
    let root = match std::env::var_os("GDIBL_SHARED") {
        Some(root) => PathBuf::from(root),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/inputs"),
    };
    let path = root.join(folder);
    if !path.exists() {
        eprintln!("SKIPPED: {folder} of the shared inputs is not here; set GDIBL_SHARED to their folder");
        return None;
    }
    Some(path)
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_file() && path.extension().is_none_or(|extension| extension != "txt"))
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{} is empty", folder.display());
    files
}

/// One line per file, for people (`--nocapture`).
fn describe(path: &Path, result: &Result<Imported, Error>) {
    let name = path.file_name().unwrap().to_string_lossy();
    match result {
        Ok(imported) => {
            let image = &imported.image;
            let ids: Vec<String> = imported.findings.iter().map(|f| format!("{}:{}", f.id, f.count)).collect();
            let z = if image.distance.is_some() { " Z" } else { "" };
            eprintln!("{name}: ok {}x{}{z} {:?} {}", image.width, image.height, imported.mapping, ids.join(" "));
        }
        Err(error) => {
            let kind = match error {
                Error::Unsupported { .. } => "unsupported",
                Error::Invalid { .. } => "invalid",
                Error::Io { .. } => "io",
            };
            let text = error.to_string();
            eprintln!("{name}: {kind}: {}", text.rsplit_once(&*name).map_or(&*text, |(_, rest)| rest));
        }
    }
}

fn assert_usable(imported: &Imported) {
    let image = &imported.image;
    assert!(image.width > 0 && image.pixels.len() == image.width * image.height);
    assert!(image.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
    assert!(image.distance.iter().flatten().all(|v| *v >= 0.0));
}

#[test]
fn damaged_files_are_refused_without_panic_and_soon() {
    let Some(folder) = shared("exr/damaged") else { return };
    for path in files(&folder) {
        for options in [STRICT, REPAIR] {
            let start = Instant::now();
            let result = read_image(&path, &options);
            describe(&path, &result);
            assert!(start.elapsed() < Duration::from_secs(5), "{} took {:?}", path.display(), start.elapsed());
            match result {
                Ok(imported) => assert_usable(&imported),
                Err(error) => assert!(!matches!(error, Error::Io { .. }), "{error}"),
            }
        }
    }
}

#[test]
fn valid_files_open_or_say_why_not() {
    let Some(folder) = shared("exr/valid") else { return };
    // What is expected of each: the fraction of the message that must be there, or the size.
    type Expected = Result<(usize, usize), &'static str>;
    let expected: &[(&str, Expected)] = &[
        ("BrightRingsNanInf.exr", Err("--repair-pixels")),
        ("OrientationCube.exr", Ok((512, 3072))),
        ("OrientationLatLong.exr", Ok((1024, 512))),
        ("Rec709_YC.exr", Err("luminance-chroma")),
        ("WideFloatRange.exr", Err("found G")),
        ("multipart.0001.exr", Ok((2048, 1556))),
        ("t01.exr", Ok((400, 300))),
        ("t09.exr", Ok((400, 300))),
    ];
    for path in files(&folder) {
        let name = path.file_name().unwrap().to_string_lossy().to_string();
        let result = read_image(&path, &STRICT);
        describe(&path, &result);
        let (_, expected) = expected.iter().find(|(n, _)| *n == name).expect("a file without expectation");
        match (result, expected) {
            (Ok(imported), Ok(size)) => {
                assert_usable(&imported);
                assert_eq!((imported.image.width, imported.image.height), *size, "{name}");
            }
            (Err(error), Err(part)) => assert!(error.to_string().contains(part), "{name}: {error}"),
            (Ok(_), Err(part)) => panic!("{name} opened; expected an error with {part}"),
            (Err(error), Ok(_)) => panic!("{name}: {error}"),
        }
    }
    let repaired = read_image(&folder.join("BrightRingsNanInf.exr"), &REPAIR).unwrap();
    describe(Path::new("repaired BrightRingsNanInf.exr"), &Ok(repaired.clone()));
    assert_usable(&repaired);
    assert!(repaired.findings.iter().any(|f| f.id == "repaired-pixels" && f.count > 0));
}

#[test]
fn real_panoramas_open() {
    let Some(folder) = shared("hdr") else { return };
    for path in files(&folder).into_iter().chain(files(&folder.join("blender-dwab"))) {
        let result = read_image(&path, &STRICT);
        describe(&path, &result);
        if path.ends_with("interior.exr") {
            // Its lossy compression made negative samples.
            let error = result.unwrap_err().to_string();
            assert!(error.contains("negative"), "{error}");
            let repaired = read_image(&path, &REPAIR);
            describe(&path, &repaired);
            assert_usable(&repaired.unwrap());
        } else {
            assert_usable(&result.unwrap());
        }
    }
    // The same sky, once clipped: kloppenheim's sun is brighter than half floats go.
    let hdr = read_image(&folder.join("kloppenheim_05_1k.hdr"), &STRICT).unwrap().image;
    let exr = read_image(&folder.join("kloppenheim_05_1k_f32_zip.exr"), &STRICT).unwrap().image;
    assert_eq!((hdr.width, hdr.height), (exr.width, exr.height));
    let far = hdr
        .pixels
        .iter()
        .flatten()
        .zip(exr.pixels.iter().flatten())
        .filter(|(a, b)| (*a - *b).abs() > 0.01 * **b + 1e-3);
    eprintln!("kloppenheim: {} samples differ by more than 1 % between .hdr and .exr", far.count());
}

#[test]
fn probes_with_distance_open() {
    let Some(folder) = shared("uffizi-box/soft") else { return };
    let imported = read_image(&folder.join("probe_1.exr"), &STRICT).unwrap();
    assert_usable(&imported);
    let distance = imported.image.distance.as_ref().unwrap();
    assert!(distance.contains(&f32::INFINITY), "the box is open");
    // The probe stands at (0, 1, 0) in a box with walls at x = ±1 and y = 0, 2: straight to +X it is 1 m.
    let panorama = to_lat_long(&imported.image, Mapping::LatLong, None);
    for direction in [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y] {
        let (x, y) = panorama.pixel_at(direction);
        let metres = panorama.pixel_distance(x, y).unwrap();
        assert!((metres - 1.0).abs() < 1e-3, "{metres} m along {direction}");
    }
    // Blue where x < -0.4 and z > 1.5; red where x > 0.4 and z < -1.5.
    let blue = panorama.radiance(Vec3::new(-1.0, 0.0, 2.0));
    let red = panorama.radiance(Vec3::new(1.0, 0.0, -2.0));
    assert!(blue.z > 2.0 * blue.x && red.x > 2.0 * red.z, "blue {blue}, red {red}");
}

/// OpenEXR's two orientation images show the same scene. Where they differ, text is blurred by the conversion that
/// made one from the other; a wrong or mirrored face would differ nearly everywhere.
#[test]
fn openexr_orientation_images_agree() {
    let Some(folder) = shared("exr/valid") else { return };
    let cube = read_image(&folder.join("OrientationCube.exr"), &STRICT).unwrap();
    let lat_long = read_image(&folder.join("OrientationLatLong.exr"), &STRICT).unwrap();
    assert_eq!(cube.mapping, Some(Mapping::CubeExr));
    assert_eq!(lat_long.mapping, Some(Mapping::LatLong));
    let cube = to_lat_long(&cube.image, Mapping::CubeExr, Some(1024));
    let lat_long = to_lat_long(&lat_long.image, Mapping::LatLong, None);
    // Difference over sum, for each face of the cube; `column` of the one against which column of the other.
    let compare = |column: &dyn Fn(usize) -> usize| {
        let mut faces = [(0.0, 0.0); 6];
        for y in 0..512 {
            for x in 0..1024 {
                let (a, b) = (cube.pixel(column(x), y), lat_long.pixel(x, y));
                let direction = cube.pixel_direction(x, y);
                let axis = direction.abs().max_position();
                let face = &mut faces[2 * axis + usize::from(direction[axis] < 0.0)];
                let weight = cube.pixel_solid_angle(y);
                face.0 += weight * f64::from((a - b).abs().element_sum());
                face.1 += weight * f64::from(b.element_sum());
            }
        }
        faces.map(|(difference, sum)| difference / sum)
    };
    let ours = compare(&|x| x);
    eprintln!("OpenEXR's cube and lat-long differ by {ours:.3?} on the faces +X -X +Y -Y +Z -Z");
    assert!(ours.iter().all(|face| *face < 0.03), "{ours:?}");
    // The measure would notice: turned by 10 pixels, by a quarter, and mirrored.
    let mean = |faces: [f64; 6]| faces.iter().sum::<f64>() / 6.0;
    for other in [compare(&|x| (x + 10) % 1024), compare(&|x| (x + 256) % 1024), compare(&|x| 1023 - x)] {
        eprintln!("turned by 10 pixels, by a quarter, or mirrored: {other:.3?}");
        assert!(mean(other) > 2.5 * mean(ours), "{other:?}");
    }
}

/// Mutations of a real file: no panic, whatever comes out is usable.
#[test]
fn mutated_real_files_never_panic() {
    let Some(folder) = shared("exr/valid") else { return };
    let mut count = [0; 2];
    for name in ["t01.exr", "../damaged/autofuzz_146551958"] {
        let original = std::fs::read(folder.join(name)).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("mutated.exr");
        let mut state = 1u64;
        for _ in 0..500 {
            let mut random = || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 33) as usize
            };
            let mut bytes = original.clone();
            for _ in 0..1 + random() % 4 {
                // The header is a small part of the file and the most interesting.
                let end = if random() % 2 == 0 { 600.min(bytes.len()) } else { bytes.len() };
                bytes[4 + random() % (end - 4)] = random() as u8;
            }
            std::fs::write(&path, &bytes).unwrap();
            match read_image(&path, &REPAIR) {
                Ok(imported) => {
                    assert_usable(&imported);
                    count[0] += 1;
                }
                Err(_) => count[1] += 1,
            }
        }
    }
    eprintln!("mutations: {} opened, {} refused", count[0], count[1]);
    assert!(count[1] > 0);
}
