//! What is in a volume, and how wrong it is.

mod compare;
mod summary;

pub use compare::{IrradianceError, compare_irradiance, radiance_sh};
pub use summary::{Histogram, NodeFigure, Range, VolumeSummary, summarise};
