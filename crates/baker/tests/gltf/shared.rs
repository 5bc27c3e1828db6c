//! Real files, where the folder of shared inputs is there (beside the repository, or named by `GDIBL_SHARED`).

use std::path::{Path, PathBuf};

use gdibl_baker::Error;
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::scene::Scene;

use crate::builder::{assert_invalid, assert_unsupported, finding, triangle_count};

/// The folder of inputs, or none with a visible message.
fn inputs(test: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let named = std::env::var_os("GDIBL_SHARED").map(PathBuf::from);
    let found = named.into_iter().chain([beside]).map(|folder| folder.join("inputs")).find(|folder| folder.is_dir());
    if found.is_none() {
        eprintln!("skipped: {test}: no shared inputs here; set GDIBL_SHARED to their folder");
    }
    found
}

/// All levels below `folder`, sorted.
pub fn levels(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                folders.push(entry);
            } else if entry.extension().is_some_and(|e| e == "gltf" || e == "glb") {
                found.push(entry);
            }
        }
    }
    found.sort();
    found
}

fn read_all(path: &Path) -> gdibl_baker::Result<Scene> {
    read_level(path, &GltfOptions { textures: TextureNeeds::All, ..Default::default() })
}

/// What a consumer may rely on.
fn assert_consistent(scene: &Scene, name: &str) {
    for mesh in &scene.meshes {
        let count = mesh.positions.len();
        assert!(!mesh.triangles.is_empty(), "{name}: an empty mesh");
        assert!(mesh.triangles.as_flattened().iter().all(|&i| (i as usize) < count), "{name}: index");
        assert!(mesh.positions.iter().all(|p| p.is_finite()), "{name}: position");
        assert_eq!(mesh.normals.len(), count, "{name}: normals");
        assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-4), "{name}: normal");
        assert!(mesh.colors.is_empty() || mesh.colors.len() == count, "{name}: colours");
        let material = &scene.materials[mesh.material as usize];
        for texture in [material.base_color_texture, material.emission_texture].into_iter().flatten() {
            assert!((texture.texture as usize) < scene.textures.len(), "{name}: texture");
            assert_eq!(mesh.uvs[texture.uv_set as usize].len(), count, "{name}: uvs");
        }
    }
}

/// Every file gives a scene or a message, with either choice of textures; prints the table of verdicts.
#[test]
fn every_shared_level_reads_or_says_why_not() {
    let Some(inputs) = inputs("every_shared_level_reads_or_says_why_not") else { return };
    let mut files = levels(&inputs.join("gltf"));
    files.extend(levels(&inputs.join("levels")));
    files.extend(levels(&inputs.join("uffizi-box")));
    assert!(files.len() > 90, "only {} levels", files.len());
    for path in &files {
        let name = path.strip_prefix(&inputs).unwrap().display().to_string();
        let verdict = |result: &gdibl_baker::Result<Scene>| match result {
            Ok(scene) => {
                assert_consistent(scene, &name);
                let findings: Vec<String> = scene.findings.iter().map(|f| format!("{} {}", f.id, f.count)).collect();
                format!(
                    "{} triangles, {} meshes, {} materials, {} textures, {} lights {findings:?}",
                    triangle_count(scene),
                    scene.meshes.len(),
                    scene.materials.len() - 1,
                    scene.textures.len(),
                    scene.lights.len(),
                )
            }
            Err(Error::Io { path, source }) => panic!("{name}: {}: {source}", path.display()),
            Err(error) => format!("{error}").replace(&inputs.display().to_string(), ""),
        };
        let gdibl = verdict(&read_level(path, &GltfOptions::default()));
        let all = verdict(&read_all(path));
        println!("{name}: {gdibl}");
        if all != gdibl {
            println!("    all textures: {all}");
        }
    }
}

#[test]
fn compressed_and_plain_apartment_are_the_same_scene() {
    let Some(inputs) = inputs("compressed_and_plain_apartment_are_the_same_scene") else { return };
    let plain = read_all(&inputs.join("levels/dream-apartment-plain/dream-apartment.glb")).unwrap();
    let compressed = read_all(&inputs.join("levels/dream-apartment/dream-apartment.glb"));
    if !cfg!(feature = "meshopt") {
        return assert_unsupported(compressed, &["EXT_meshopt_compression", "gltf-transform"]);
    }
    let compressed = compressed.unwrap();
    assert_eq!(plain.meshes.len(), compressed.meshes.len());
    assert_eq!(plain.materials, compressed.materials);
    let mut largest = 0.0_f64;
    for (a, b) in plain.meshes.iter().zip(&compressed.meshes) {
        assert_eq!((a.material, a.triangles.len()), (b.material, b.triangles.len()));
        // The codec may turn a triangle's corners round and change the order of vertices, so corners are compared by place.
        let corners = |mesh: &gdibl_baker::scene::Mesh| -> Vec<[[f64; 3]; 3]> {
            let place = |i: u32| mesh.positions[i as usize].to_array();
            let first_lowest = |triangle: &[u32; 3]| {
                let mut t = triangle.map(place);
                let lowest = (0..3).min_by(|&i, &j| t[i].partial_cmp(&t[j]).unwrap()).unwrap();
                t.rotate_left(lowest);
                t
            };
            mesh.triangles.iter().map(first_lowest).collect()
        };
        let (mut a, mut b) = (corners(a), corners(b));
        a.sort_by(|x, y| x.partial_cmp(y).unwrap());
        b.sort_by(|x, y| x.partial_cmp(y).unwrap());
        for (x, y) in a.as_flattened().as_flattened().iter().zip(b.as_flattened().as_flattened()) {
            largest = largest.max((x - y).abs());
        }
    }
    println!("largest difference of a coordinate: {largest} m");
    assert!(largest < 1e-3, "{largest}");
}

/// The same model as JSON, embedded and binary is the same scene.
#[test]
fn containers_of_a_model_agree() {
    let Some(inputs) = inputs("containers_of_a_model_agree") else { return };
    let mut compared = 0;
    for model in std::fs::read_dir(inputs.join("gltf/khronos")).unwrap().map(|entry| entry.unwrap().path()) {
        // Quantised variants differ by their rounding.
        let files: Vec<PathBuf> =
            levels(&model).into_iter().filter(|path| !path.to_string_lossy().contains("Quantized")).collect();
        let scenes: Vec<Scene> = files.iter().map(|path| read_all(path).unwrap()).collect();
        for (scene, path) in scenes.iter().zip(&files).skip(1) {
            let first = &scenes[0];
            assert_eq!(triangle_count(scene), triangle_count(first), "{}", path.display());
            assert_eq!(scene.textures.len(), first.textures.len(), "{}", path.display());
            for (a, b) in scene.meshes.iter().zip(&first.meshes) {
                assert_eq!((&a.positions, &a.normals), (&b.positions, &b.normals), "{}", path.display());
            }
            compared += 1;
        }
    }
    assert!(compared > 20, "only {compared} pairs");
}

/// Files whose verdict is known from their own documentation.
#[test]
fn shared_levels_give_what_their_authors_say() {
    let Some(inputs) = inputs("shared_levels_give_what_their_authors_say") else { return };
    let read = |name: &str| read_level(&inputs.join(name), &GltfOptions::default());
    let generator = |name: &str| read(&format!("gltf/asset-generator/{name}"));
    for number in 0..2 {
        let scene = generator(&format!("Negative/Mesh_NoPosition/Mesh_NoPosition_0{number}.gltf")).unwrap();
        assert_eq!((triangle_count(&scene), finding(&scene, "primitives-without-positions")), (0, 1));
    }
    assert_unsupported(generator("Positive/Compatibility/Compatibility_04.gltf"), &["2.1"]);
    assert_unsupported(generator("Positive/Compatibility/Compatibility_05.gltf"), &["FAKE_materials_quantumRendering"]);

    // 125 cubes; one level, three lights.
    let instances = read("gltf/khronos/SimpleInstancing/glTF/SimpleInstancing.gltf").unwrap();
    assert_eq!((instances.meshes.len(), triangle_count(&instances)), (125, 1500));
    assert_eq!(read("gltf/gltf_KHR_lights_punctual_test.glb").unwrap().lights.len(), 3);

    // Triangles without area, counted by exact rational arithmetic in a script of its own.
    let room = read("levels/godot/living_room.glb").unwrap();
    assert_eq!((triangle_count(&room), finding(&room, "zero-area-triangles")), (5088 - 3537, 3537));

    // The report's scene: a box of 2 x 2 x 6 m, spheres by role.
    let uffizi = read("uffizi-box/uffizi_box.glb").unwrap();
    let positions = || uffizi.meshes.iter().flat_map(|mesh| &mesh.positions);
    let low = positions().copied().reduce(glam::DVec3::min).unwrap();
    let high = positions().copied().reduce(glam::DVec3::max).unwrap();
    assert!((low - glam::DVec3::new(-1., 0., -3.)).length() < 1e-6, "{low}");
    assert!((high - glam::DVec3::new(1., 2., 3.)).length() < 1e-6, "{high}");
    assert!(uffizi.meshes.iter().any(|mesh| mesh.role == gdibl_baker::scene::Role::Scene));

    // A panorama is no level.
    assert_invalid(read("uffizi-box/soft/probe_0.exr"), &["starts with", "glTF"]);
}

/// Many damaged copies of every small file; slow, so run by hand: `GDIBL_MUTATIONS=1000 cargo test -- --ignored`.
#[test]
#[ignore = "slow; run by hand after changing the importer"]
fn damaged_shared_levels_never_panic() {
    let Some(inputs) = inputs("damaged_shared_levels_never_panic") else { return };
    let count: u64 = std::env::var("GDIBL_MUTATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(100);
    let mut files = levels(&inputs.join("gltf"));
    files.extend(levels(&inputs.join("levels")));
    let (mut read, mut accepted) = (0, 0);
    for path in files {
        let whole = std::fs::read(&path).unwrap();
        // Large files get fewer.
        for seed in 0..(count * 20_000 / (whole.len() as u64 + 20_000)).max(3) {
            let mut bytes = whole.clone();
            crate::mutations::mutate(&mut bytes, &mut crate::mutations::Random(seed));
            let outcome = std::panic::catch_unwind(|| crate::mutations::survives(&bytes, &path));
            match outcome {
                Ok(is_accepted) => accepted += u64::from(is_accepted),
                Err(_) => panic!("{} with seed {seed} panicked", path.display()),
            }
            read += 1;
        }
    }
    println!("{read} damaged files, {accepted} accepted");
    assert!(read > 300);
}
