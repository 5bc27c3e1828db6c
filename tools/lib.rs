//! What the tools share: reading reference data and printing tables.
