//! What `parse` refuses: everything that is not exactly a version 1 file. And whatever it is given, it returns.

mod common;

use common::*;
use gdibl_runtime::format::crc32;
use gdibl_runtime::{Error, Limits, Volume};

fn small_files() -> Vec<File> {
    let files = vec![small_grid(), small_sparse(), small_points(), small_vertices(), small_packed()];
    let mut all = files.clone();
    all.extend(files.clone().into_iter().map(File::bits));
    if cfg!(feature = "zstd") {
        all.extend(files.into_iter().map(File::zstd));
    }
    all
}

#[track_caller]
fn assert_invalid(file: File, in_message: &str) {
    match Volume::parse(&file.to_bytes()) {
        Err(error @ Error::Invalid(_)) => {
            assert!(error.to_string().contains(in_message), "{error}")
        }
        other => panic!("expected Invalid ({in_message}), got {other:?}"),
    }
}

#[track_caller]
fn assert_unsupported(file: File, in_message: &str) {
    match Volume::parse(&file.to_bytes()) {
        Err(error @ Error::Unsupported(_)) => {
            assert!(error.to_string().contains(in_message), "{error}");
        }
        other => panic!("expected Unsupported ({in_message}), got {other:?}"),
    }
}

#[test]
fn parse_refuses_a_file_cut_off_at_any_byte() {
    for file in small_files() {
        let bytes = file.to_bytes();
        assert!(Volume::parse(&bytes).is_ok());
        for length in 0..bytes.len() {
            assert!(Volume::parse(&bytes[..length]).is_err(), "{length} of {}", bytes.len());
        }
    }
}

#[test]
fn parse_refuses_a_flipped_bit_anywhere() {
    for file in small_files() {
        let mut bytes = file.to_bytes();
        for bit in 0..8 * bytes.len() {
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert!(Volume::parse(&bytes).is_err(), "bit {bit}");
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
    }
}

#[test]
fn parse_refuses_trailing_bytes() {
    for file in small_files() {
        let mut bytes = file.to_bytes();
        bytes.push(0);
        let error = Volume::parse(&bytes).unwrap_err();
        assert!(error.to_string().contains("end of file"), "{error}");
    }
}

#[test]
fn parse_refuses_what_it_does_not_know() {
    assert_unsupported(File { version: 2, ..small_grid() }, "version");
    assert_unsupported(File { version: 0, ..small_grid() }, "version");
    assert_unsupported(File { kind: 4, ..small_grid() }, "kind");
    assert_unsupported(File { encoding: 3, ..small_grid() }, "encoding");
    assert_unsupported(File { bands: 5, ..small_grid() }, "bands");
    assert_unsupported(File { units: 2, ..small_grid() }, "units");
    let mut file = small_grid();
    file.sections[5].codec = 3;
    assert_unsupported(file, "codec 3");
    let mut file = small_grid();
    file.sections[0].filter = 2;
    assert_unsupported(file, "filter 2");
    assert!(matches!(Volume::parse(b"glTF and so on"), Err(Error::Invalid(_))));
}

#[test]
fn parse_refuses_absurd_counts_without_allocating() {
    let all = u32::MAX;
    for counts in [[all; 3], [all, all, 1], [1 << 16, 1 << 16, 1], [1 << 31, 2, 1]] {
        assert_unsupported(File { counts, ..small_grid() }, "nodes");
    }
    for counts in [[all, 1, 1], [65_535, 65_535, 1], [3, 3, 1]] {
        assert_invalid(File { counts, ..small_grid() }, "bytes");
    }
    for counts in [[0, 1, 1], [2, 3, 0]] {
        assert_invalid(File { counts, ..small_grid() }, "at least one node");
    }
    assert_invalid(File { counts: [1, 5, 1], ..small_points() }, "counts");
    let mut file = small_grid();
    file.sections[5].codec = 1;
    file.sections[5].raw_size = u64::MAX;
    assert_unsupported(file, "limit");
}

#[test]
fn parse_refuses_numbers_that_are_none() {
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_invalid(File { min: [0.0, odd, 0.0], ..small_grid() }, "box");
        assert_invalid(File { max: [3.0, 3.0, odd], ..small_grid() }, "box");
    }
    assert_invalid(File { min: [9.0, 0.0, 0.0], ..small_grid() }, "min <= max");
    assert_invalid(File { min: [-1e308; 3], max: [1e308; 3], ..small_grid() }, "box");
    for scale in [0.0, -1.0, 3.0, f32::NAN, f32::INFINITY, 1e-40, 2f32.powi(101)] {
        assert_invalid(File { scale, ..small_grid() }, "scale");
    }
    assert_invalid(File { scale: 2.0, ..small_points() }, "scale");
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for encoding in [0, 1] {
            let file = grid([2, 2, 2], 2, encoding, 1.0)
                .radiance(|node, index, channel| if (node, index, channel) == (5, 7, 1) { odd } else { 1.0 });
            assert_invalid(file, "node 5, plane 22");
        }
        let mut file = small_points();
        file.sections[1].stored[12..16].copy_from_slice(&odd.to_le_bytes());
        assert_invalid(file, "POSN, node 1");
        let mut file = small_grid();
        file.sections[2].stored[..2].copy_from_slice(&half::f16::from_f32(odd).to_le_bytes());
        assert_invalid(file, "COVR, node 0");
    }
    let mut file = small_grid();
    file.sections[1].stored[2] = 2;
    assert_invalid(file, "VALD, node 2");
}

#[test]
fn parse_refuses_packed_numbers_that_are_none() {
    for step in [0.0, -0.01, 1e-4, 1.01, f32::NAN, f32::INFINITY] {
        assert_invalid(File { scale: step, ..small_packed() }, "step");
    }
    for step in [0.5f32.powi(13), 1.0] {
        assert!(Volume::parse(&File { scale: step, ..small_packed() }.to_bytes()).is_ok());
    }
    for code in [-1, i16::MIN] {
        let number = |node, plane| if (node, plane) == (4, 0) { code } else { packed_pattern(node, plane) };
        assert_invalid(grid([2, 3, 1], 1, 2, 0.01).packed(number), "RSH , node 4, plane 0");
    }
    // One number more or less, a plane too few, the size of an f16 file.
    let sizes = 6 * 13 * 2;
    for size in [sizes - 2, sizes + 2, sizes - 12, sizes + 1, 0] {
        let mut file = small_packed();
        file.sections[0] = raw(b"RSH ", vec![0; size]);
        assert_invalid(file, "bytes for 6 nodes");
    }
    // Numbers of f16 and f32 files are not taken for packed ones, nor the other way round.
    assert_invalid(File { encoding: 2, scale: 0.5, ..small_grid() }, "bytes for 6 nodes");
    assert_invalid(File { encoding: 1, scale: 0.5, ..small_packed() }, "bytes for 6 nodes");
}

#[test]
fn parse_refuses_missing_superfluous_and_repeated_sections() {
    for (file, section) in [(small_grid(), 0), (small_points(), 1), (small_vertices(), 2)] {
        let mut file = file;
        file.sections.remove(section);
        assert_invalid(file, "found none");
    }
    assert_invalid(small_grid().section(raw(b"POSN", vec![0; 72])), "found one");
    assert_invalid(small_points().section(raw(b"MESH", vec![])), "found one");
    assert_invalid(small_grid().section(raw(b"SETT", vec![])), "two of them");
    let mut file = small_grid();
    file.sections.extend((0..60u8).map(|i| raw(&[b'x', b'x', b'0', i], vec![])));
    assert_invalid(file, "");
}

#[test]
fn parse_refuses_sections_of_the_wrong_size() {
    for section in 0..4 {
        let mut file = small_grid();
        file.sections[section].stored.push(0);
        file.sections[section].raw_size += 1;
        assert_invalid(file, "bytes for 6 nodes");
    }
    let mut file = small_grid();
    file.sections[4].raw_size += 1;
    assert_invalid(file, "not compressed");
    let mut file = small_vertices();
    file.sections[3].stored.pop();
    file.sections[3].raw_size -= 1;
    assert_invalid(file, "whole records");
}

#[test]
fn parse_refuses_mesh_records_beyond_the_vertices_and_double_ones() {
    let record = |words: [u32; 5]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    for words in [[0, 0, 0, 20, 5], [0, 0, 0, u32::MAX, u32::MAX]] {
        let mut file = small_vertices();
        file.sections[3] = raw(b"MESH", record(words));
        assert_invalid(file, "record 0");
    }
    let mut file = small_vertices();
    file.sections[3] = raw(b"MESH", [record([1, 2, 3, 0, 4]), record([1, 2, 3, 4, 4])].concat());
    assert_invalid(file, "two records");
}

/// Makes both kinds of checksum right again, as far as the table still points into the file.
fn repair_checksums(bytes: &mut [u8]) {
    let word = |bytes: &[u8], at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().unwrap()))
    };
    let Some(count) = word(bytes, 44) else { return };
    let count = count.min(64) as usize;
    for row in (0..count).map(|k| 96 + 40 * k) {
        let (Some(start), Some(size)) = (word(bytes, row + 8), word(bytes, row + 16)) else {
            return;
        };
        let end = start as usize + size as usize;
        if let Some(stored) = bytes.get(start as usize..end)
            && row + 36 <= bytes.len()
        {
            let crc = crc32(stored);
            bytes[row + 32..row + 36].copy_from_slice(&crc.to_le_bytes());
        }
    }
    let end = 96 + 40 * count;
    if end + 4 <= bytes.len() {
        let crc = crc32(&bytes[..end]);
        bytes[end..end + 4].copy_from_slice(&crc.to_le_bytes());
    }
}

#[test]
fn sections_that_overlap_or_leave_the_file_are_refused() {
    let plain = small_grid().to_bytes();
    for row in (0..6).map(|k| 96 + 40 * k) {
        for field in [8, 16, 24] {
            for value in [0, 1, 8, 344, plain.len() as u64, plain.len() as u64 + 8, 1 << 40, u64::MAX, u64::MAX - 7] {
                let mut bytes = plain.clone();
                let place = row + field..row + field + 8;
                if bytes[place.clone()] == value.to_le_bytes() {
                    continue;
                }
                bytes[place].copy_from_slice(&value.to_le_bytes());
                repair_checksums(&mut bytes);
                assert!(Volume::parse(&bytes).is_err(), "row {row}, field {field}, {value}");
            }
        }
    }
}

#[test]
fn limits_cap_what_is_read() {
    let bytes = small_grid().to_bytes();
    let total = 6 * 12 * 2 + 6 + 12 + 12 + 19 + 3;
    assert!(Volume::parse_with_limits(&bytes, &Limits { max_bytes: total }).is_ok());
    let error = Volume::parse_with_limits(&bytes, &Limits { max_bytes: total - 1 }).unwrap_err();
    assert!(matches!(error, Error::Unsupported(_)));
}

#[test]
fn any_bit_of_packed_bits_may_be_wrong() {
    // With the checksum of what is wrong: two blocks, the second not full, of many planes and of one.
    let file = grid([150, 1, 1], 1, 2, 0.00390625)
        .packed(|node, plane| packed_pattern(node % 7, plane))
        .section(raw(b"SERR", halves((0..150).map(|i| i as f32 / 64.0))))
        .bits();
    assert!(Volume::parse(&file.to_bytes()).is_ok());
    let (mut refused, mut read) = (0, 0);
    for section in 0..2 {
        for bit in 0..8 * file.sections[section].stored.len() {
            let mut file = file.clone();
            file.sections[section].stored[bit / 8] ^= 1 << (bit % 8);
            let Ok(volume) = Volume::parse(&file.to_bytes()) else {
                refused += 1;
                continue;
            };
            read += 1;
            for node in 0..volume.node_count() {
                assert!(volume.node_sh(node).coefficients.as_flattened().iter().all(|v| v.is_finite()), "bit {bit}");
                assert!(volume.node_relative_error(node).is_none_or(|error| error.is_finite()), "bit {bit}");
            }
        }
    }
    assert!(refused > 100 && read > 100, "{refused} {read}");
}

#[test]
fn packed_bits_claim_no_more_than_their_heads_can_hold() {
    // A file of 200 bytes that would have millions of nodes: each block has a head.
    for blocks in [0, 1, 3] {
        let mut file = grid([3_000_000, 1, 1], 2, 2, 0.00390625);
        let stored = [&[1 << 5, 28][..], &vec![0; 2 * 28 * blocks], &[0; 3]].concat();
        file.sections = vec![Section { codec: 2, raw_size: 3_000_000 * 56, stored, ..raw(b"RSH ", vec![]) }];
        assert_invalid(file, "RSH ");
    }
    // No plane, a flag that nobody knows, a filter.
    for (at, value) in [(1, 0), (0, 1 << 6), (0, 1 << 7)] {
        let mut file = small_packed().bits();
        file.sections[0].stored[at] = value;
        assert!(Volume::parse(&file.to_bytes()).is_err());
    }
    let mut file = small_packed().bits();
    file.sections[0].filter = 1;
    assert_unsupported(file, "filter");
}

#[cfg(feature = "zstd")]
#[test]
fn zstd_frames_that_give_more_or_less_than_announced_are_refused() {
    let frame = |length: usize| zstd::encode_all(&vec![7u8; length][..], 3).unwrap();
    for (stored, expected) in [
        (frame(143), false),
        (frame(145), false),
        (frame(100_000_000), false),
        ([frame(144), vec![0]].concat(), false),
        ([frame(72), frame(72)].concat(), false),
        (vec![], false),
        (frame(144), true),
    ] {
        let mut file = small_grid();
        file.sections[0] = Section { codec: 1, stored, ..file.sections[0].clone() };
        assert_eq!(Volume::parse(&file.to_bytes()).is_ok(), expected);
    }
}

#[test]
fn no_mutation_makes_parse_or_sample_panic() {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below.max(1) as u64) as usize
    };
    let originals: Vec<Vec<u8>> = small_files().iter().map(File::to_bytes).collect();
    let mut parsed = 0;
    for round in 0..20_000 {
        let mut bytes = originals[round % originals.len()].clone();
        for _ in 0..1 + random(4) {
            let at = random(bytes.len());
            match random(6) {
                0 => bytes[at] = random(256) as u8,
                1 => bytes[at] ^= 1 << random(8),
                2 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][random(5)],
                3 => bytes.truncate(at),
                4 => bytes.insert(at, random(256) as u8),
                _ => {
                    let from = random(bytes.len());
                    let length = random(16).min(bytes.len() - from.max(at));
                    bytes.copy_within(from..from + length, at);
                }
            }
            if bytes.is_empty() {
                break;
            }
        }
        if random(4) > 0 {
            repair_checksums(&mut bytes);
        }
        if let Ok(volume) = Volume::parse_with_limits(&bytes, &Limits { max_bytes: 1 << 24 }) {
            parsed += 1;
            let sample = volume.sample([0.3, 0.7, 2.5], [0.0, 1.0, 0.0]);
            assert!((0.0..=1.0).contains(&sample.validity));
            for node in 0..volume.node_count() {
                volume.node_sh(node);
                volume.node_position(node);
                volume.node_normal(node);
            }
        }
    }
    assert!(parsed > 1000, "only {parsed} mutants were read: the test does not reach far");
}
