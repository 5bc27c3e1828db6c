//! The stiff and extreme cases, as a Markdown table: what must hold, what was measured, and how many seconds a row took.
//!
//! `cargo run --release -p gdibl-tools --bin extremes [-- AREA…]`; ends with 1 where a row does not hold. One file per area.
//! Levels and panoramas are made here, but for the box of `assets/` and, where GDIBL_INPUTS names their folder, two real
//! levels. Ten minutes and 4 GB on two cores at most, which the last row checks; most rows have a smaller twin among the tests.

mod blending;
mod far;
mod geometry;
mod harmonics;
mod images;
mod lamps;
mod laws;
mod light;
mod limits;
mod placed;
mod rooms;
mod seen;
mod shared;
mod statistics;
mod suns;
mod table;

#[path = "../../crates/baker/tests/watertight/closed.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod closed;
#[path = "../../crates/baker/tests/laws/exact.rs"]
mod exact;
#[path = "../../crates/baker/tests/laws/level.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod level;

use table::Table;

/// Adds the rows of an area.
type Cases = fn(&mut Table);

/// In the order of the table.
const AREAS: [(&str, Cases); 13] = [
    ("laws", laws::rows),
    ("geometry", geometry::rows),
    ("rooms", rooms::rows),
    ("far", far::rows),
    ("placed", placed::rows),
    ("light", light::rows),
    ("suns", suns::rows),
    ("lamps", lamps::rows),
    ("images", images::rows),
    ("blending", blending::rows),
    ("seen", seen::rows),
    ("SH", harmonics::rows),
    ("statistics", statistics::rows),
];

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let areas = AREAS.into_iter().chain([("limits", limits::rows as Cases)]);
    if let Some(unknown) = wanted.iter().find(|name| !areas.clone().any(|(area, _)| area == **name)) {
        let known: Vec<&str> = areas.map(|(area, _)| area).collect();
        eprintln!("extremes: no area is called '{unknown}'; there are {}", known.join(", "));
        std::process::exit(2);
    }
    let mut table = Table::begin();
    for (area, cases) in areas.filter(|(area, _)| wanted.is_empty() || wanted.iter().any(|name| name == area)) {
        table.enter(area);
        cases(&mut table);
    }
    std::process::exit(i32::from(table.end() > 0));
}
