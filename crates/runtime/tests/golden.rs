//! Files of every version ever released stay readable, to the bit. Compare mode is the default; with
//! `GDIBL_UPDATE_GOLDEN=1` the files are written anew (and the change shows in the commit). Tolerance: 0; of what is packed half an
//! ulp of f16, in which it is kept.

mod common;

use common::*;
use gdibl_runtime::format::{self, Encoding, SectionEntry};
use gdibl_runtime::{Kind, Volume};
use std::path::PathBuf;

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/golden").join(name)
}

fn files() -> [(&'static str, File); 6] {
    [
        ("v1_grid_f16.gdibl", small_grid()),
        ("v1_points_f32.gdibl", small_points()),
        ("v1_vertices_f16.gdibl", small_vertices()),
        ("v1_sparse_f16.gdibl", small_sparse()),
        ("v1_grid_packed.gdibl", small_packed()),
        ("v1_points_f32_deringed.gdibl", File { units: 1, ..small_points() }),
    ]
}

fn golden(name: &str, written: Vec<u8>) -> Vec<u8> {
    if std::env::var_os("GDIBL_UPDATE_GOLDEN").is_some() {
        std::fs::write(path(name), written).unwrap();
    }
    std::fs::read(path(name)).unwrap()
}

fn check_contents(name: &str, bytes: &[u8]) {
    let volume = Volume::parse(bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
    let header = volume.header();
    assert_eq!(header.is_deringed(), name.contains("deringed"));
    for node in 0..volume.node_count() {
        let sh = volume.node_sh(node);
        for index in 0..25 {
            for channel in 0..3 {
                let within = index < (header.bands as usize + 1).pow(2);
                let found = sh.coefficients[index][channel];
                if within && header.encoding == Encoding::Packed {
                    let truth = packed_truth(packed_pattern, header.scale, node, index, channel);
                    assert!(
                        (f64::from(found) - truth).abs() <= truth.abs() * 0.5f64.powi(11) * 1.001,
                        "{name}: node {node}"
                    );
                    continue;
                }
                let truth = if within { pattern(node, index, channel) } else { 0.0 };
                assert_eq!(found, truth, "{name}: node {node}");
            }
        }
    }
    match header.kind {
        Kind::Grid => {
            assert_eq!(volume.node_count(), 6);
            assert!(volume.is_valid(0) && !volume.is_valid(4));
            assert_eq!(volume.node_coverage(4), 0.5);
            assert_eq!(volume.node_relative_error(4), Some(4.0 / 64.0));
            assert_eq!(volume.node_position(5), [3.0, 2.0, 3.5]);
            assert_eq!(volume.node_normal(0), None);
        }
        Kind::Sparse => {
            assert_eq!(volume.grid().unwrap().counts, [5, 3, 3]);
            // After three in the first row, two in the second.
            assert_eq!(volume.bricks().unwrap().place_of(6), [0, 2, 0]);
            // Half way along an edge of the larger cell.
            let [min, max] = [volume.header().min, volume.header().max];
            let middle = [0.5, 0.5, 1.0].map(f64::from);
            let place: [f64; 3] = std::array::from_fn(|k| min[k] + middle[k] * (max[k] - min[k]));
            let between = volume.sample_f64(place, [0.0; 3]).sh.coefficients[0][0];
            let ends = [[2, 0, 2], [2, 2, 2]].map(|p| volume.bricks().unwrap().node_at(p).unwrap() as usize);
            let expected = ends.map(|node| 0.5 * pattern(node, 0, 0)).iter().sum::<f32>();
            assert!((between - expected).abs() < 1e-6, "{between} {expected}");
        }
        Kind::Points => {
            assert_eq!(volume.node_position(3), [1.25, 0.75, 4.0]);
            assert_eq!(volume.node_coverage(4), 1.0);
            assert_eq!(volume.node_relative_error(4), None);
            assert_eq!(volume.vertex_set(7, 1, 0), None);
        }
        Kind::Vertices => {
            assert_eq!(volume.node_normal(21), Some([1.0, 0.0, 0.0]));
            assert_eq!(volume.vertex_set(7, 1, 0), Some(0..12));
            assert_eq!(volume.vertex_set(7, 1, 1), Some(12..24));
            assert_eq!(volume.vertex_set(7, 0, 1), None);
            assert_eq!(volume.vertex_sets().len(), 2);
        }
    }
}

#[test]
fn golden_files_read_as_ever() {
    for (name, file) in files() {
        let bytes = golden(name, file.to_bytes());
        assert_eq!(bytes, file.to_bytes(), "{name}: the layout has changed");
        check_contents(name, &bytes);
    }
}

#[test]
fn golden_files_of_bits_read_as_ever() {
    for (name, file) in files() {
        let name = name.replace(".gdibl", "_bits.gdibl");
        let bytes = golden(&name, file.clone().bits().to_bytes());
        check_contents(&name, &bytes);
        let directory = format::parse_header_and_sections(&bytes).unwrap();
        for (section, raw) in directory.sections.iter().zip(&file.sections) {
            let found = directory.section_bytes(section.id, &gdibl_runtime::Limits::default()).unwrap().unwrap();
            assert_eq!(*found, raw.stored, "{name}");
        }
    }
}

#[cfg(feature = "zstd")]
#[test]
fn compressed_golden_files_read_as_ever() {
    // Only reading is compared: another release of zstd may compress otherwise.
    for (name, file) in files() {
        let name = name.replace(".gdibl", "_zstd.gdibl");
        check_contents(&name, &golden(&name, file.zstd().to_bytes()));
    }
}

#[cfg(not(feature = "zstd"))]
#[test]
fn without_the_feature_compressed_files_are_unsupported_and_say_why() {
    let error = Volume::parse(&std::fs::read(path("v1_grid_f16_zstd.gdibl")).unwrap()).unwrap_err();
    assert!(matches!(error, gdibl_runtime::Error::Unsupported(_)));
    assert!(error.to_string().contains("zstd"), "{error}");
}

#[test]
fn header_and_table_written_by_the_crate_are_the_golden_bytes() {
    for (name, file) in files() {
        let bytes = golden(name, file.to_bytes());
        let directory = format::parse_header_and_sections(&bytes).unwrap();
        let mut sections: Vec<SectionEntry> = directory.sections.clone();
        for section in &mut sections {
            section.offset = 0;
        }
        format::place_sections(&mut sections);
        assert_eq!(sections, directory.sections);
        let written = format::directory_to_bytes(&directory.header, &sections);
        assert_eq!(written, bytes[..written.len()], "{name}");
        let last = sections.last().unwrap();
        assert_eq!(last.offset + last.stored_size, bytes.len() as u64);
    }
}

#[test]
fn an_inspector_reads_sections_that_the_volume_skips() {
    let bytes = small_grid().to_bytes();
    let directory = format::parse_header_and_sections(&bytes).unwrap();
    let ids: Vec<[u8; 4]> = directory.sections.iter().map(|section| section.id).collect();
    assert_eq!(ids, [*b"RSH ", *b"VALD", *b"COVR", *b"SERR", *b"SETT", *b"new!"]);
    let limits = Default::default();
    let settings = directory.section_bytes(format::SETTINGS, &limits).unwrap().unwrap();
    assert_eq!(&settings[..], b"not for the runtime");
    assert_eq!(directory.section_bytes(format::PROBES, &limits), Ok(None));
}
