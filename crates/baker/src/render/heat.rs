//! Colours of numbers in pictures: from dark, which is good, to bright, which is bad.
//!
//! Based on: S. van der Walt and N. Smith, matplotlib's "inferno", 2015, by nine of its colours. Its lightness grows evenly, so that
//! it reads without colours, too.

/// sRGB bytes.
const INFERNO: [[u8; 3]; 9] = [
    [0, 0, 4],
    [31, 12, 72],
    [85, 15, 109],
    [136, 34, 106],
    [186, 54, 85],
    [227, 89, 51],
    [249, 140, 10],
    [249, 201, 50],
    [252, 255, 164],
];

/// The numbers at the ends of the colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Shown dark.
    pub good: f32,
    /// Shown bright; another number than `good`.
    pub bad: f32,
}

impl Scale {
    /// From 0 to a number with one digit that few values are above: the 98th percentile, rounded up. Negative values do not count.
    pub fn of_errors(values: &[f32]) -> Scale {
        let mut known: Vec<f32> = values.iter().copied().filter(|value| *value >= 0.0).collect();
        let rank = (known.len() * 98 / 100).min(known.len().saturating_sub(1));
        let most = if known.is_empty() { 0.0 } else { *known.select_nth_unstable_by(rank, f32::total_cmp).1 };
        if most <= 0.0 {
            return Scale { good: 0.0, bad: 0.01 };
        }
        let step = 10f32.powf(most.log10().floor());
        Scale { good: 0.0, bad: (most / step - 1e-4).ceil() * step }
    }

    /// The colour of a value, linear RGB 0..=1; ends are clipped.
    pub fn colour(&self, value: f32) -> [f32; 3] {
        let share = ((value - self.good) / (self.bad - self.good)).clamp(0.0, 1.0);
        let at = share * (INFERNO.len() - 1) as f32;
        let first = (at as usize).min(INFERNO.len() - 2);
        let within = at - first as f32;
        [0, 1, 2].map(|c| {
            let [a, b] = [first, first + 1].map(|k| f32::from(INFERNO[k][c]) / 255.0);
            linear(a + within * (b - a))
        })
    }
}

fn linear(srgb: f32) -> f32 {
    if srgb <= 0.04045 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worse_is_brighter_whichever_way_the_scale_runs() {
        for scale in [Scale { good: 0.0, bad: 0.3 }, Scale { good: 1.0, bad: 0.0 }] {
            let light = |share: f32| {
                let [r, g, b] = scale.colour(scale.good + share * (scale.bad - scale.good));
                0.2126 * r + 0.7152 * g + 0.0722 * b
            };
            let all: Vec<f32> = (0..=100).map(|k| light(k as f32 / 100.0)).collect();
            assert!(all.windows(2).all(|pair| pair[0] < pair[1]), "{scale:?}: {all:?}");
        }
    }

    #[test]
    fn the_end_of_a_scale_is_a_round_number_that_few_errors_are_above() {
        let errors: Vec<f32> = (0..1000).map(|k| k as f32 * 1e-4).collect();
        assert!((Scale::of_errors(&errors).bad - 0.1).abs() < 1e-6);
        assert_eq!(Scale::of_errors(&[]), Scale { good: 0.0, bad: 0.01 });
        assert_eq!(Scale::of_errors(&[0.0, -1.0]).bad, 0.01);
    }
}
