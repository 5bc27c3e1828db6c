//! Exports read back by readers that share nothing with the writers, and lit as each engine lights.

mod laws;
mod limits;
mod readers;
mod tree;
mod volumes;
