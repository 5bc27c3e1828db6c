//! gdibl
fn main() {}
