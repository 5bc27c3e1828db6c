//! What is in a volume, and how wrong it is.

mod calibration;
mod compare;
mod coverage;
mod energy;
mod error;
mod figures;
mod noise;
mod places;
pub mod study;
mod summary;
mod truth;

pub use calibration::{Calibration, calibrate};
pub use compare::{
    Answer, BandsCompared, CompareSettings, Comparison, Found, NoiseUnknown, NothingCompared, Places, SetComparison,
    WorstPlace, compare,
};
pub use coverage::{Coverage, CoveragePaint, CoverageView, Covered, PixelSize, Viewpoint, coverage};
pub use energy::{EnergyBalance, energy_balance};
pub use error::{BandError, ChannelError, IrradianceError, Light, Pair, radiance_sh};
pub use figures::{Figure, Figures, walled_boxes};
pub use places::{Region, WorstNode, WorstNodes, regions, worst_nodes};
pub use summary::{Histogram, NodeFigure, Range, VolumeSummary, summarise};
pub use truth::{Truth, TruthLight, TruthNoise, choose_sets};
