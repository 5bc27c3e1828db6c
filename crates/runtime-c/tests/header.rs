//! `include/gdibl.h` says what `src/lib.rs` says. Compare mode is the default; with `GDIBL_UPDATE_HEADER=1` the header is
//! written anew (and the change shows in the commit).

use std::path::Path;

#[test]
fn the_header_is_current() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml")).unwrap();
    let source = folder.join("src/lib.rs");
    let mut generated = Vec::new();
    cbindgen::Builder::new().with_config(config).with_src(source).generate().unwrap().write(&mut generated);
    let generated = without_headings(&String::from_utf8(generated).unwrap());

    let path = folder.join("include/gdibl.h");
    if std::env::var_os("GDIBL_UPDATE_HEADER").is_some() {
        std::fs::write(&path, &generated).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap().replace("\r\n", "\n");
    let differs = committed.lines().zip(generated.lines()).position(|(old, new)| old != new);
    assert!(
        committed == generated,
        "include/gdibl.h is not what src/lib.rs makes, from line {} on. To update it: \
         GDIBL_UPDATE_HEADER=1 cargo test -p gdibl-runtime-c --test header",
        differs.unwrap_or(committed.lines().count().min(generated.lines().count())) + 1
    );
}

/// What rustdoc calls safety is the contract in C: without its heading, and without the empty line that an annotation for
/// cbindgen leaves.
fn without_headings(header: &str) -> String {
    header.replace("// # Safety\n", "").replace("//\nGdiblStatus", "GdiblStatus")
}
