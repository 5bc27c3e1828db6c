//! Collects what was dropped or ignored: one row per id, with a count and the first place.

use std::collections::BTreeMap;

use crate::Finding;

/// Findings by id. Rows come out sorted by id, so that a report does not depend on the order of nodes.
#[derive(Debug, Default)]
pub(super) struct Findings(BTreeMap<&'static str, Finding>);

impl Findings {
    /// Adds `count` to the row `id`; the message of the first call stays.
    pub fn add(&mut self, id: &'static str, count: u64, message: impl FnOnce() -> String) {
        if count > 0 {
            self.0.entry(id).or_insert_with(|| Finding::new(id, 0, message())).count += count;
        }
    }

    /// The rows.
    pub fn into_vec(self) -> Vec<Finding> {
        self.0.into_values().collect()
    }
}
