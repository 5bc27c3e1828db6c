//! What is kept of a node besides its coefficients.

use bincode::{Decode, Encode};

use super::integrate::{Bias, NodeEstimate};
use crate::rows::Element;

/// What is kept of a node besides its coefficients.
#[derive(Debug, Clone, Copy, Default, PartialEq, Encode, Decode)]
pub(crate) struct Summary {
    pub standard_error: f64,
    pub worst_error: f64,
    pub rms_irradiance: f64,
    pub coverage: f64,
    pub bias: Bias,
    pub unseen_error: f64,
    /// ∫ L dω that clamping took, and that is left, over R, G and B.
    pub clamped: f64,
    pub kept: f64,
    /// See [`NodeEstimate::quarters`].
    pub quarters: [f64; 3],
}

/// Light under this share of the volume's median is next to none: a solid's walls may leak a little.
const NEXT_TO_NONE: f64 = 1e-3;

impl Summary {
    /// Next to no light gets there, or none that is known.
    pub fn is_dark(&self, median: f64) -> bool {
        self.coverage == 0.0 || self.rms_irradiance <= NEXT_TO_NONE * median
    }

    /// An error of E over the larger of the node's own RMS of E and a tenth of the median.
    pub fn relative(&self, error: f64, median: f64) -> f64 {
        let floor = self.rms_irradiance.max(0.1 * median);
        // All black: nothing is wrong with it.
        if error == 0.0 { 0.0 } else { error / floor }
    }

    /// The same of a square, which may be negative.
    pub fn relative_square(&self, square: f64, median: f64) -> f64 {
        let floor = self.rms_irradiance.max(0.1 * median);
        if square == 0.0 { 0.0 } else { square / (floor * floor) }
    }
}

impl Element for Summary {
    const BYTES: usize = 97;

    fn to_bytes(self, bytes: &mut [u8]) {
        let Summary { bias, quarters, .. } = self;
        let numbers = [
            self.standard_error,
            self.worst_error,
            self.rms_irradiance,
            self.coverage,
            self.unseen_error,
            self.clamped,
            self.kept,
            bias.square,
            bias.noise,
            quarters[0],
            quarters[1],
            quarters[2],
        ];
        for (bytes, number) in bytes.chunks_exact_mut(8).zip(numbers) {
            bytes.copy_from_slice(&number.to_le_bytes());
        }
        bytes[96] = bias.by_probes.into();
    }

    fn from_bytes(bytes: &[u8]) -> Summary {
        let number = |place: usize| f64::from_le_bytes(bytes[8 * place..][..8].try_into().expect("eight bytes"));
        Summary {
            standard_error: number(0),
            worst_error: number(1),
            rms_irradiance: number(2),
            coverage: number(3),
            unseen_error: number(4),
            clamped: number(5),
            kept: number(6),
            bias: Bias { square: number(7), noise: number(8), by_probes: bytes[96] != 0 },
            quarters: [9, 10, 11].map(number),
        }
    }
}

impl From<&NodeEstimate> for Summary {
    fn from(e: &NodeEstimate) -> Self {
        Summary {
            standard_error: e.standard_error,
            worst_error: e.worst_error,
            rms_irradiance: e.rms_irradiance,
            coverage: e.coverage,
            bias: e.bias,
            unseen_error: e.unseen_error,
            clamped: e.clamped,
            kept: e.sh[0].iter().sum::<f64>() * (4.0 * std::f64::consts::PI).sqrt(),
            quarters: e.quarters,
        }
    }
}
