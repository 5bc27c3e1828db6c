//! What `gdibl study` is made of: the methods, running and timing them, its words, the plot, and the page
//! around it.

pub mod kept;
pub mod methods;
pub mod page;
pub mod plot;
pub mod report;
pub mod runner;
pub mod words;
