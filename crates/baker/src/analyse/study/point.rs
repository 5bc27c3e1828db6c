//! What bakes by one method with one budget tell.

use serde::Serialize;

/// A figure over repeats.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Spread {
    /// Of costs the median, of errors the root mean square.
    pub middle: f64,
    /// The least of them.
    pub least: f64,
    /// The most.
    pub most: f64,
}

/// A method with one budget. Errors are shares of the RMS of E.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// Directions per node.
    pub budget: u64,
    /// Wall seconds of a bake.
    pub wall_seconds: Spread,
    /// CPU seconds of a bake.
    pub cpu_seconds: Spread,
    /// CPU seconds before a bake.
    pub setup_seconds: f64,
    /// CPU milliseconds per node.
    pub milliseconds_per_node: Spread,
    /// Rays of a bake, mean.
    pub rays: u64,
    /// Directions of a bake, mean.
    pub samples: u64,
    /// Relative RMSE of E against the reference.
    pub error: Spread,
    /// What differs between repeats; of each one, its distance from their mean.
    pub noise: Spread,
    /// The noise that the bakes themselves expect; `None` where they do not know.
    pub estimated: Option<f64>,
    /// The error between nodes, as an engine reads the file; `None` where nothing is read between them, or it was not measured.
    pub seen: Option<Seen>,
    /// Bytes of the light in the file.
    pub bytes: u64,
    /// bias², without the noise of either side; may be negative by chance.
    pub bias_square: f64,
    /// 1 / (error² × CPU seconds per node).
    pub efficiency: f64,
    /// 1 / (noise² × CPU seconds per node).
    pub noise_efficiency: f64,
    /// What its statistics stand on.
    #[serde(skip)]
    pub ground: Ground,
}

/// Errors at places between nodes, relative to the light there: in the air or on surfaces, whichever is larger; means over repeats.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Seen {
    /// At half of the places it is less.
    pub median: f64,
    /// At 95 % of the places it is less.
    pub p95: f64,
}

/// What a point stands on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ground {
    /// Bakes.
    pub repeats: usize,
    /// Places compared.
    pub places: usize,
    /// Independent numbers in E of all places together, were these strangers to each other.
    pub independent: f64,
    /// Variance of the products P_rs of different repeats; `None` with fewer than three.
    pub product_variance: Option<f64>,
    /// Noise of the reference; `None` where it is not known: then it is part of the bias.
    pub reference_noise: Option<f64>,
}
