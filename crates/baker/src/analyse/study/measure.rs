//! One point: what repeats of one method with one budget tell, by the formulas of the module above.

use gdibl_runtime::sh;

use super::{Cost, Ground, Point, Repeat, Seen, Spread};
use crate::analyse::compare::{Met, NothingCompared, meet};
use crate::analyse::error::{ErrorDirections, independent_numbers};
use crate::analyse::truth::Truth;

/// Compares repeats of one method and budget with the reference and with each other; at least two.
pub fn measure(budget: u64, nodes: usize, truths: &[Truth], repeats: &[Repeat]) -> Result<Point, NothingCompared> {
    assert!(repeats.len() >= 2, "{} repeats have no spread", repeats.len());
    let met: Vec<Vec<Met>> = repeats.iter().map(|r| meet(&r.volume, truths)).collect::<Result<_, _>>()?;
    let tally = Tally::of(&met);
    let share = |square: f64| if square == 0.0 { 0.0 } else { square / tally.square_truth };
    let count = repeats.len() as f64;
    let own = |square: f64| share(square) * count / (count - 1.0);
    let error = spread_of_squares(&tally.error, share);
    let noise = spread_of_squares(&tally.noise, own);
    let reference_noise = tally.reference_variance.map(|v| share(v).sqrt());
    let products: Vec<f64> = tally.products.iter().map(|&product| share(product)).collect();
    let product = products.iter().sum::<f64>() / products.len() as f64;
    let bias_square = product - reference_noise.map_or(0.0, |noise| noise.powi(2));
    let deviations = products.iter().map(|p| (p - product).powi(2)).sum::<f64>();
    let cost = |of: fn(&Cost) -> f64| spread(repeats.iter().map(|repeat| of(&repeat.cost)));
    let mean = |of: fn(&Cost) -> u64| repeats.iter().map(|r| of(&r.cost)).sum::<u64>() / repeats.len() as u64;
    let cpu_seconds = cost(|cost| cost.cpu_seconds);
    let per_node = |seconds: f64| seconds / nodes as f64;
    let bands = repeats[0].volume.header().bands;
    let radiance = truths.iter().any(|truth| truth.normals.is_empty());
    let band_count = if radiance { bands as usize + 1 } else { 0 };
    Ok(Point {
        budget,
        wall_seconds: cost(|cost| cost.wall_seconds),
        cpu_seconds,
        setup_seconds: cost(|cost| cost.setup_seconds).middle,
        milliseconds_per_node: cpu_seconds.map(|seconds| 1e3 * per_node(seconds)),
        rays: mean(|cost| cost.rays),
        samples: mean(|cost| cost.samples),
        error,
        noise,
        estimated: tally.variance.map(|v| (share(v) / count).sqrt()),
        seen: seen_of(repeats),
        bytes: repeats.iter().map(|repeat| repeat.bytes).sum::<u64>() / repeats.len() as u64,
        bias_square,
        efficiency: 1.0 / (error.middle.powi(2) * per_node(cpu_seconds.middle)),
        noise_efficiency: 1.0 / (noise.middle.powi(2) * per_node(cpu_seconds.middle)),
        ground: Ground {
            repeats: repeats.len(),
            places: tally.places,
            independent: independent_numbers(band_count.min(sh::MAX_BANDS as usize + 1)) * tally.places as f64,
            product_variance: (products.len() > 1).then(|| deviations / (products.len() as f64 - 1.0)),
            reference_noise,
        },
    })
}

/// Mean over repeats, if all have it.
fn seen_of(repeats: &[Repeat]) -> Option<Seen> {
    let all: Vec<Seen> = repeats.iter().map(|repeat| repeat.seen).collect::<Option<_>>()?;
    let mean = |of: fn(&Seen) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
    Some(Seen { median: mean(|seen| seen.median), p95: mean(|seen| seen.p95) })
}

/// Sums over places of means over normals and channels, in units of E².
struct Tally {
    places: usize,
    square_truth: f64,
    /// (E_r - E)(E_s - E), of every pair.
    products: Vec<f64>,
    /// (E_r - E)² and (E_r - Ē)² by repeat.
    error: Vec<f64>,
    noise: Vec<f64>,
    /// Var E_r, of all repeats together.
    variance: Option<f64>,
    reference_variance: Option<f64>,
}

impl Tally {
    fn of(met: &[Vec<Met>]) -> Tally {
        let directions = ErrorDirections::new();
        let (places, repeats) = (met[0].len(), met.len());
        let mut tally = Tally {
            places,
            square_truth: 0.0,
            products: vec![0.0; repeats * (repeats - 1) / 2],
            error: vec![0.0; repeats],
            noise: vec![0.0; repeats],
            variance: met.iter().flatten().map(|met| met.variance).sum(),
            reference_variance: met[0].iter().map(|met| met.truth_variance).sum(),
        };
        for place in 0..places {
            let both: Vec<[Vec<f64>; 2]> =
                met.iter().map(|met| directions.both(&met[place].found, &met[place].truth)).collect();
            let truth = &both[0][1];
            let mean: Vec<f64> = (0..truth.len())
                .map(|i| both.iter().map(|[found, _]| found[i]).sum::<f64>() / repeats as f64)
                .collect();
            let pairs = (0..repeats).flat_map(|s| (0..s).map(move |r| (r, s)));
            for (sum, (r, s)) in tally.products.iter_mut().zip(pairs) {
                *sum += mean_product(&both[r][0], &both[s][0], truth);
            }
            for (repeat, [found, _]) in both.iter().enumerate() {
                tally.error[repeat] += mean_product(found, found, truth);
                tally.noise[repeat] += mean_product(found, found, &mean);
            }
            tally.square_truth += mean_product(truth, truth, &vec![0.0; truth.len()]);
        }
        tally
    }
}

/// Mean of (a - origin)(b - origin).
fn mean_product(a: &[f64], b: &[f64], origin: &[f64]) -> f64 {
    a.iter().zip(b).zip(origin).map(|((a, b), origin)| (a - origin) * (b - origin)).sum::<f64>() / a.len() as f64
}

fn spread_of_squares(squares: &[f64], share: impl Fn(f64) -> f64) -> Spread {
    let shares = || squares.iter().map(|&square| share(square));
    let middle = (shares().sum::<f64>() / squares.len() as f64).sqrt();
    Spread { middle, ..spread(shares().map(f64::sqrt)) }
}

fn spread(values: impl Iterator<Item = f64>) -> Spread {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let (upper, last) = (sorted.len() / 2, sorted.len() - 1);
    let lower = last / 2;
    Spread { middle: 0.5 * (sorted[lower] + sorted[upper]), least: sorted[0], most: sorted[last] }
}

impl Spread {
    pub(super) fn map(self, of: impl Fn(f64) -> f64) -> Spread {
        Spread { middle: of(self.middle), least: of(self.least), most: of(self.most) }
    }
}
