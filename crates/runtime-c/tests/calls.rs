//! Every function of the C interface, called as C would: same answers as the runtime, and nothing that it is given makes
//! it crash.

mod common;

use common::*;
use gdibl_runtime::format::{self, Header};
use gdibl_runtime::{Kind, Volume, VolumeSet};
use gdibl_runtime_c::*;
use std::ffi::CStr;
use std::mem::MaybeUninit;
use std::ptr::{null, null_mut};

/// A parsed volume, freed at the end.
struct Parsed(*mut GdiblVolume);

impl Drop for Parsed {
    fn drop(&mut self) {
        // SAFETY: from `gdibl_parse`, and this is the one time.
        unsafe { gdibl_free(self.0) };
    }
}

fn parse(bytes: &[u8]) -> (GdiblStatus, Parsed, String) {
    let mut volume = null_mut();
    let mut message = [0x7f; 256];
    // SAFETY: all pointers are to what is here, with its sizes.
    let status = unsafe { gdibl_parse(bytes.as_ptr(), bytes.len(), &mut volume, message.as_mut_ptr(), message.len()) };
    // SAFETY: there is a 0 in the message.
    let text = unsafe { CStr::from_ptr(message.as_ptr()) };
    (status, Parsed(volume), text.to_str().unwrap().to_owned())
}

fn parse_form(form: Form) -> (Volume, Parsed) {
    let (status, parsed, message) = parse(&form.bytes());
    assert_eq!((status, message.as_str()), (GdiblStatus::Ok, ""));
    assert!(!parsed.0.is_null());
    (Volume::parse(&form.bytes()).unwrap(), parsed)
}

/// What a call writes through its last pointer.
fn written<T>(call: impl FnOnce(*mut T) -> GdiblStatus) -> T {
    let mut place = MaybeUninit::uninit();
    assert_eq!(call(place.as_mut_ptr()), GdiblStatus::Ok);
    // SAFETY: the call went well, so it wrote.
    unsafe { place.assume_init() }
}

#[test]
fn all_ways_to_ask_agree_with_the_runtime() {
    for form in FORMS {
        let (truth, parsed) = parse_form(form);
        let volume = parsed.0;
        for (position, normal) in queries() {
            let far = position.map(|x| f64::from(x) * 1.000_000_1);
            let (p, n) = (position.as_ptr(), normal.as_ptr());
            // SAFETY: the volume is alive; positions, normals and results have three numbers.
            let (e, e_far, sample, sample_far) = unsafe {
                (
                    written::<[f32; 3]>(|e| gdibl_irradiance(volume, p, n, e.cast())),
                    written::<[f32; 3]>(|e| gdibl_irradiance_f64(volume, far.as_ptr(), n, e.cast())),
                    written(|sample| gdibl_sample(volume, p, n, sample)),
                    written(|sample| gdibl_sample_f64(volume, far.as_ptr(), n, sample)),
                )
            };
            assert_eq!(e, truth.irradiance(position, normal));
            assert_eq!(e_far, truth.irradiance_f64(far, normal));
            let expected = truth.sample_f64(far, normal);
            for (found, expected) in [(sample, truth.sample(position, normal)), (sample_far, expected)] {
                assert_eq!(found.bands, expected.sh.bands);
                assert_eq!(found.radiance, expected.sh.coefficients);
                assert_eq!((found.validity, found.inside), (expected.validity, expected.inside));
                // SAFETY: all three are here.
                let e = unsafe { written::<[f32; 3]>(|e| gdibl_evaluate(&found, n, e.cast())) };
                assert_eq!(e, expected.sh.convolve().evaluate(normal));
            }
        }
    }
}

#[test]
fn a_batch_is_its_parts_also_in_place() {
    for form in FORMS {
        let (truth, parsed) = parse_form(form);
        let (mut positions, normals): (Vec<_>, Vec<_>) = queries().into_iter().unzip();
        let expected: Vec<_> = queries().into_iter().map(|(p, n)| truth.irradiance(p, n)).collect();
        let mut found = vec![[f32::NAN; 3]; QUERIES + 1];
        let (p, n) = (positions.as_mut_ptr().cast::<f32>(), normals.as_ptr().cast());
        // SAFETY: the arrays have three numbers per query; the second call has its result in the place of positions.
        unsafe {
            assert_eq!(gdibl_irradiance_batch(parsed.0, QUERIES, p, n, found.as_mut_ptr().cast()), GdiblStatus::Ok);
            assert_eq!(gdibl_irradiance_batch(parsed.0, QUERIES, p, n, p), GdiblStatus::Ok);
            assert_eq!(gdibl_irradiance_batch(parsed.0, 0, null(), null(), null_mut()), GdiblStatus::Ok);
        }
        assert_eq!(found[..QUERIES], expected[..]);
        assert!(found[QUERIES][0].is_nan());
        assert_eq!(positions, expected);
    }
}

#[test]
fn header_and_nodes_are_the_files() {
    for form in FORMS {
        let (truth, parsed) = parse_form(form);
        // SAFETY: the volume is alive.
        let header = unsafe { written(|header| gdibl_header(parsed.0, header)) };
        assert_eq!(header.kind as u32, form.kind as u32);
        assert_eq!((header.counts, header.bands), (truth.header().counts, form.bands));
        assert_eq!((header.min, header.max), (truth.header().min, truth.header().max));
        assert!(!header.is_deringed);
        // SAFETY: the same.
        let count = unsafe { gdibl_node_count(parsed.0) };
        assert_eq!(count, 60);
        for node in 0..count {
            let mut position = [f64::NAN; 3];
            // SAFETY: the same, and three numbers are there.
            let sample = unsafe { written(|sample| gdibl_node(parsed.0, node, position.as_mut_ptr(), sample)) };
            assert_eq!(position, truth.node_position(node));
            assert_eq!(sample.radiance, truth.node_sh(node).coefficients);
            assert_eq!(sample.validity == 1.0, node % 7 != 0);
        }
        let mut position = [0.0; 3];
        let mut sample = MaybeUninit::uninit();
        for beyond in [60, usize::MAX] {
            // SAFETY: the same.
            let status = unsafe { gdibl_node(parsed.0, beyond, position.as_mut_ptr(), sample.as_mut_ptr()) };
            assert_eq!(status, GdiblStatus::OutOfRange);
        }
    }
}

#[test]
fn vertex_sets_are_the_files() {
    for form in FORMS {
        let (truth, parsed) = parse_form(form);
        // SAFETY: the volume is alive.
        let count = unsafe { gdibl_vertex_set_count(parsed.0) };
        assert_eq!(count, if form.kind == Kind::Vertices { 2 } else { 0 });
        for (index, expected) in truth.vertex_sets().iter().enumerate() {
            // SAFETY: the same.
            let found = unsafe { written(|set| gdibl_vertex_set(parsed.0, index, set)) };
            let GdiblVertexSet { node, mesh, primitive, first, count } = found;
            assert_eq!([node, mesh, primitive], [expected.node, expected.mesh, expected.primitive]);
            assert_eq!([first, count], [expected.first, expected.count]);
        }
        let mut set = MaybeUninit::uninit();
        // SAFETY: the same.
        assert_eq!(unsafe { gdibl_vertex_set(parsed.0, count, set.as_mut_ptr()) }, GdiblStatus::OutOfRange);
    }
}

#[test]
fn every_null_is_refused_and_nothing_is_written() {
    use GdiblStatus::NullPointer as Null;
    let (_, parsed) = parse_form(FORMS[0]);
    let volume = parsed.0.cast_const();
    let (p, n, far) = ([1.0, 1.0, 3.0], [0.0, 1.0, 0.0], [1.0, 1.0, 3.0]);
    let (p, n, far): (*const f32, *const f32, *const f64) = (p.as_ptr(), n.as_ptr(), far.as_ptr());
    let mut result = [7.5_f32; 3];
    let e = result.as_mut_ptr();
    let mut sample = GdiblSample { bands: 2, radiance: [[7.5; 3]; 25], validity: 7.5, inside: false };
    let before = sample;
    let s = &raw mut sample;
    let mut node_position = [7.5; 3];
    let x: *mut f64 = node_position.as_mut_ptr();
    // SAFETY: what is not NULL is here, with three numbers.
    unsafe {
        assert_eq!(gdibl_irradiance(null(), p, n, e), Null);
        assert_eq!(gdibl_irradiance(volume, null(), n, e), Null);
        assert_eq!(gdibl_irradiance(volume, p, null(), e), Null);
        assert_eq!(gdibl_irradiance(volume, p, n, null_mut()), Null);
        assert_eq!(gdibl_irradiance_f64(null(), far, n, e), Null);
        assert_eq!(gdibl_irradiance_f64(volume, null(), n, e), Null);
        assert_eq!(gdibl_irradiance_f64(volume, far, null(), e), Null);
        assert_eq!(gdibl_irradiance_f64(volume, far, n, null_mut()), Null);
        assert_eq!(gdibl_irradiance_batch(null(), 1, p, n, e), Null);
        assert_eq!(gdibl_irradiance_batch(volume, 1, null(), n, e), Null);
        assert_eq!(gdibl_irradiance_batch(volume, 1, p, null(), e), Null);
        assert_eq!(gdibl_irradiance_batch(volume, 1, p, n, null_mut()), Null);
        assert_eq!(gdibl_sample(null(), p, n, s), Null);
        assert_eq!(gdibl_sample(volume, null(), n, s), Null);
        assert_eq!(gdibl_sample(volume, p, null(), s), Null);
        assert_eq!(gdibl_sample(volume, p, n, null_mut()), Null);
        assert_eq!(gdibl_sample_f64(null(), far, n, s), Null);
        assert_eq!(gdibl_sample_f64(volume, null(), n, s), Null);
        assert_eq!(gdibl_sample_f64(volume, far, null(), s), Null);
        assert_eq!(gdibl_sample_f64(volume, far, n, null_mut()), Null);
        assert_eq!(gdibl_evaluate(null(), n, e), Null);
        assert_eq!(gdibl_evaluate(s, null(), e), Null);
        assert_eq!(gdibl_evaluate(s, n, null_mut()), Null);
        assert_eq!(gdibl_node(null(), 0, x, s), Null);
        assert_eq!(gdibl_node(volume, 0, null_mut(), s), Null);
        assert_eq!(gdibl_node(volume, 0, x, null_mut()), Null);
        assert_eq!(gdibl_header(null(), MaybeUninit::uninit().as_mut_ptr()), Null);
        assert_eq!(gdibl_header(volume, null_mut()), Null);
        assert_eq!(gdibl_node_count(null()), 0);
        assert_eq!(gdibl_vertex_set_count(null()), 0);
        assert_eq!(gdibl_vertex_set(null(), 0, MaybeUninit::uninit().as_mut_ptr()), Null);
        gdibl_free(null_mut());
    }
    assert_eq!((result, node_position), ([7.5; 3], [7.5; 3]));
    assert_eq!(sample, before);
}

#[test]
fn parse_refuses_null_and_needs_no_message() {
    let bytes = FORMS[0].bytes();
    let mut volume = std::ptr::dangling_mut();
    let mut message = [0x7f; 20];
    // SAFETY: what is not NULL is here, with its sizes.
    unsafe {
        let status = gdibl_parse(null(), 4, &mut volume, message.as_mut_ptr(), message.len());
        assert_eq!(status, GdiblStatus::NullPointer);
        assert!(volume.is_null());
        assert_eq!(CStr::from_ptr(message.as_ptr()), c"a pointer is NULL t");
        let status = gdibl_parse(bytes.as_ptr(), bytes.len(), null_mut(), message.as_mut_ptr(), 0);
        assert_eq!(status, GdiblStatus::NullPointer);
        let status = gdibl_parse(null(), 0, &mut volume, null_mut(), 9);
        assert_eq!(status, GdiblStatus::Invalid);
    }
}

#[test]
fn damaged_files_are_errors_with_a_message_wherever_the_damage_is() {
    let bytes = FORMS[4].bytes();
    for place in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[place] ^= 0x40;
        // Another version is read before the checksum, which may be elsewhere there.
        let expected = if (8..12).contains(&place) { GdiblStatus::Unsupported } else { GdiblStatus::Invalid };
        for (file, expected) in [(&damaged[..], expected), (&bytes[..place], GdiblStatus::Invalid)] {
            let (status, parsed, message) = parse(file);
            assert_eq!(status, expected, "byte {place}: {message}");
            assert!(parsed.0.is_null());
            assert!(message.contains("expected"), "byte {place}: {message}");
        }
    }
}

#[test]
fn odd_numbers_have_answers() {
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -f32::MAX, 0.0];
    for form in FORMS {
        let (truth, parsed) = parse_form(form);
        for x in odd {
            for y in odd {
                let (position, far, up) = ([x, y, 3.0], [f64::from(x), f64::from(y), f64::MAX], [0.0_f32, 1.0, 0.0]);
                // SAFETY: the volume is alive; positions, normals and results have three numbers.
                let (e, e_far, e_odd) = unsafe {
                    (
                        written::<[f32; 3]>(|e| gdibl_irradiance(parsed.0, position.as_ptr(), up.as_ptr(), e.cast())),
                        written::<[f32; 3]>(|e| gdibl_irradiance_f64(parsed.0, far.as_ptr(), up.as_ptr(), e.cast())),
                        written::<[f32; 3]>(|e| {
                            gdibl_irradiance(parsed.0, position.as_ptr(), position.as_ptr(), e.cast())
                        }),
                    )
                };
                assert_eq!(e, truth.irradiance(position, up));
                assert!(e.iter().chain(&e_far).all(|value| value.is_finite()), "{position:?}: {e:?} {e_far:?}");
                assert!(!x.is_nan() || e_odd[0].is_nan(), "{position:?}: {e_odd:?}");
            }
        }
    }
    let sample = GdiblSample { bands: 5, radiance: [[1.0; 3]; 25], validity: 1.0, inside: true };
    let mut e = [0.0; 3];
    // SAFETY: all three are here.
    let status = unsafe { gdibl_evaluate(&sample, e.as_ptr(), e.as_mut_ptr()) };
    assert_eq!(status, GdiblStatus::OutOfRange);
}

#[cfg(feature = "zstd")]
#[test]
fn compressed_files_are_read() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../runtime/tests/data/golden/v1_grid_f16_zstd.gdibl");
    let (status, _parsed, message) = parse(&std::fs::read(path).unwrap());
    assert_eq!(status, GdiblStatus::Ok, "{message}");
}

/// The file of a form, its box so much wider on all sides.
fn wider(form: Form, metres: f64) -> Vec<u8> {
    let bytes = form.bytes();
    let directory = format::parse_header_and_sections(&bytes).unwrap();
    let Header { min, max, .. } = directory.header;
    let header = Header { min: min.map(|v| v - metres), max: max.map(|v| v + metres), ..directory.header };
    let mut wide = format::directory_to_bytes(&header, &directory.sections);
    wide.extend_from_slice(&bytes[wide.len()..]);
    wide
}

#[test]
fn a_set_answers_as_the_runtimes_and_owns_its_volumes() {
    let files = [FORMS[0].bytes(), wider(FORMS[1], 1.0)];
    let spacings = [0.75, 1.5];
    let truth = files.iter().zip(spacings).map(|(file, spacing)| (Volume::parse(file).unwrap(), spacing));
    let truth = VolumeSet::new(truth).unwrap();
    let volumes = files.map(|file| {
        let (status, parsed, message) = parse(&file);
        assert_eq!(status, GdiblStatus::Ok, "{message}");
        let volume = parsed.0;
        // The set frees it.
        std::mem::forget(parsed);
        volume
    });
    // SAFETY: there are two of each, alive, and nobody else uses them.
    let set = unsafe { written(|set| gdibl_set(volumes.as_ptr(), spacings.as_ptr(), 2, set)) };
    let mut shared = 0;
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    for (position, normal) in queries() {
        let far = position.map(f64::from);
        let n = normal.as_ptr();
        // SAFETY: the set is alive; positions, normals and results have three numbers.
        let (e, e_far, sample) = unsafe {
            (
                written::<[f32; 3]>(|e| gdibl_set_irradiance(set, position.as_ptr(), n, e.cast())),
                written::<[f32; 3]>(|e| gdibl_set_irradiance_f64(set, far.as_ptr(), n, e.cast())),
                written(|sample| gdibl_set_sample_f64(set, far.as_ptr(), n, sample)),
            )
        };
        assert_eq!((e, e_far), (truth.irradiance(position, normal), truth.irradiance_f64(far, normal)));
        let expected = truth.sample_f64(far, normal);
        assert_eq!((sample.bands, sample.radiance), (expected.sh.bands, expected.sh.coefficients));
        assert_eq!((sample.validity, sample.inside), (expected.validity, expected.inside));
        shared += usize::from(truth.shares(far).count() > 1);
        positions.push(position);
        normals.push(normal);
    }
    assert!(shared > 100, "{shared} places between both");
    let [mut found, mut expected] = [vec![[0.0; 3]; positions.len()], vec![[0.0; 3]; positions.len()]];
    let [p, n] = [&positions, &normals].map(|all| all.as_flattened().as_ptr());
    // SAFETY: all have as many numbers.
    let status =
        unsafe { gdibl_set_irradiance_batch(set, positions.len(), p, n, found.as_flattened_mut().as_mut_ptr()) };
    truth.irradiance_batch(&positions, &normals, &mut expected);
    assert_eq!((status, found), (GdiblStatus::Ok, expected));
    // SAFETY: from `gdibl_set`, and this is the one time.
    unsafe { gdibl_set_free(set) };
}

#[test]
fn what_is_no_set_is_refused_and_leaves_its_volumes_to_the_caller() {
    let ((truth, one), (_, other)) = (parse_form(FORMS[0]), parse_form(FORMS[3]));
    let (grid, points) = (one.0, other.0);
    let try_set = |volumes: &[*mut GdiblVolume], spacings: &[f64]| {
        let mut set = std::ptr::dangling_mut();
        // SAFETY: there are as many of each.
        let status = unsafe { gdibl_set(volumes.as_ptr(), spacings.as_ptr(), volumes.len(), &mut set) };
        assert!(set.is_null());
        status
    };
    assert_eq!(try_set(&[], &[]), GdiblStatus::OutOfRange);
    assert_eq!(try_set(&[grid, null_mut()], &[1.0; 2]), GdiblStatus::NullPointer);
    assert_eq!(try_set(&[grid, grid], &[1.0; 2]), GdiblStatus::OutOfRange);
    for spacing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(try_set(&[grid], &[spacing]), GdiblStatus::OutOfRange);
    }
    assert_eq!(try_set(&[grid, points], &[1.0; 2]), GdiblStatus::Invalid);
    let (position, normal) = ([0.0, 1.0, 3.0], [0.0, 1.0, 0.0]);
    // SAFETY: what is NULL is refused; the grid is alive still.
    unsafe {
        assert_eq!(gdibl_set(null(), null(), 1, null_mut()), GdiblStatus::NullPointer);
        let e = written::<[f32; 3]>(|e| gdibl_irradiance(grid, position.as_ptr(), normal.as_ptr(), e.cast()));
        assert_eq!(e, truth.irradiance(position, normal));
        let mut e = [7.0; 3];
        let status = gdibl_set_irradiance(null(), position.as_ptr(), normal.as_ptr(), e.as_mut_ptr());
        assert_eq!((status, e), (GdiblStatus::NullPointer, [7.0; 3]));
        gdibl_set_free(null_mut());
    }
}
