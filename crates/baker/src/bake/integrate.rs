//! L_lm(x) = ∫ L(x,ω) Y_lm(ω) dω, estimated at nodes that stand near each other.
//!
//! Estimator: 1/N Σ L(x,ω_i) Y_lm(ω_i) / p(ω_i), the ω_i split into independent replicates, and within each among the
//! techniques of the [`Guide`], each with a randomised low-discrepancy sequence of its own; p is the density of all together
//! (balance heuristic). With w = 1/(4π p): 4π/N Σ w_i L(x,ω_i) Y_lm(ω_i). The spread of the replicates is the standard
//! error. Accumulated in f64: a sun of 1e9 beside a shadow of 1e-6 keeps its digits.
//!
//! Where to look is learned on the way. Some of the uniform directions of all nodes go first; what they met tells each
//! replicate of each node its [`Outlook`], from all of them but its own: so no direction's density depends on that
//! direction's light, and each replicate is unbiased. Against directions by the sky's light alone, noise in the box at 1024
//! directions per node fell from 3.3 to 2.5 % (soft) and from 2.6 to 1.7 % (stiff), with as many replicates
//! (`tools/calibration`).
//!
//! A constant is taken out of the noise: B_lm = 4π/N Σ w_i Y_lm(ω_i) is known to be √4π δ_l0, so what it is off by
//! tells what L_lm is off by. Control variate (Owen, "Monte Carlo theory, methods and examples", 2013, §8.9):
//! L_lm - β (B_lm - √4π δ_l0), one β per channel, the regression of L_lm on B_lm over replicates and coefficients. Under
//! constant light β is that light, and E = πL is exact; without it E was off by up to 2e-3 at 4096 samples.

use bincode::{Decode, Encode};
use gdibl_runtime::sh;
use glam::Vec3;
use std::f64::consts::PI;

use super::directions::DirectionMap;
use crate::Interrupted;
use crate::blocks::Found;
use crate::radiance::{
    Audit, Glance, GlanceSums, Guide, Outlook, PathContext, Radiance, Technique, UNIFORM_SHARE, Vantage,
};
use crate::sampling::{Sampler, Stream, fibonacci_sphere, uniform_sphere};

/// Independent replicates per node. Few, because a long low-discrepancy sequence is worth more than short ones: in the box
/// at 1024 directions 16, 8, 4 and 2 gave noise of 4.3, 3.9, 3.3 and 3.1 % (before outlooks). With 4 the standard error of
/// one value has 3 degrees of freedom; that of a node rests on all its coefficients.
pub const REPLICATES: u32 = 4;
/// 95 % of what is estimated lie within so many of its standard errors: Student's t with one degree of freedom less than
/// there are replicates.
pub const INTERVAL_95: f64 = 3.182;
/// 95 % of the differences of E, in any direction and channel, lie within so many whole errors of a node, of noise and systematic error
/// together: Student's t with about ten degrees of freedom, since an error of a node rests on all of its coefficients. Of 128 nodes of a
/// living room by path tracing 93.3 % lay within 2 (`tools/never_worse`).
pub const WHOLE_INTERVAL_95: f64 = 2.23;
/// Directions in which `relative_error` looks at E.
const ERROR_DIRECTIONS: usize = 26;
/// Uniform directions of each replicate that go first. 64: with 8 nodes 2048 rays, four to a tile.
const GLANCES: u32 = 64;

/// Sums of L·Y of one replicate.
pub type Moments = [[f64; 3]; sh::MAX_COEFFICIENTS];

/// What one node came to.
#[derive(Debug, Clone)]
pub struct NodeEstimate {
    /// Radiance coefficients, linear RGB.
    pub sh: Moments,
    /// One standard error of each. All errors are infinite with too few replicates to tell: one, or for L0 three.
    pub coefficient_error: Moments,
    /// One standard error of E, root mean square over 26 directions and RGB.
    pub standard_error: f64,
    /// The largest over the same.
    pub worst_error: f64,
    /// Root mean square of E over the same.
    pub rms_irradiance: f64,
    /// What audits found.
    pub bias: Bias,
    /// Error of E that light of directions that are not covered may make, root mean square over the same.
    pub unseen_error: f64,
    /// Share of the sphere, 0..=1, that was covered.
    pub coverage: f64,
    /// What clamping took: ∫ L dω, summed over R, G and B.
    pub clamped: f64,
    /// Rays traced, but those of `found`.
    pub rays: u64,
    /// What was found on the way and is remembered.
    pub found: Vec<Found>,
    /// Directions that left the node.
    pub samples: u64,
    /// `standard_error` after 1/4, 1/2 and 3/4 of them; 0 where nobody looked.
    pub quarters: [f64; 3],
}

/// Systematic error of E, as audits tell it: mean over 26 directions and RGB.
#[derive(Debug, Clone, Copy, Default, PartialEq, Encode, Decode)]
pub struct Bias {
    /// Its square, right on average, and so negative at times: products of different replicates.
    pub square: f64,
    /// Variance of the mean of audits that it comes from; 0 without audits.
    pub noise: f64,
    /// See [`Audit::by_probes`].
    pub by_probes: bool,
}

/// Light along a ray, and what an audit of it found.
#[derive(Debug, Clone, Copy)]
pub struct Told {
    pub arriving: Radiance,
    pub audit: Option<Audit>,
}

impl From<Radiance> for Told {
    fn from(arriving: Radiance) -> Told {
        Told { arriving, audit: None }
    }
}

/// Fewest directions of a first round whose error is looked at on the way.
const WATCHED: u64 = 64;

/// A node to be sampled.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Names the random points.
    pub sequence: Sequence,
    /// Trace space.
    pub origin: Vec3,
    /// Light whose coefficients are known without sampling, and are added.
    pub known: Moments,
}

/// Names the random points of one node.
#[derive(Debug, Clone, Copy)]
pub struct Sequence {
    /// Sobol or random.
    pub sampler: Sampler,
    /// The bake's seed.
    pub seed: u64,
    /// Index of the node.
    pub node: u64,
}

impl Sequence {
    fn stream(&self, replicate: u32, technique: Technique) -> Stream {
        Stream::new(self.sampler, self.seed, self.node, replicate * Technique::ALL.len() as u32 + technique as u32)
    }

    /// Rounds the numbers of directions of a replicate, see [`quotas`].
    fn rounding(&self, replicate: u32) -> f64 {
        f64::from(self.stream(replicate, Technique::Uniform).random(u32::MAX, 0))
    }
}

/// Memory and tables that one worker reuses from node to node.
#[derive(Debug)]
pub struct Integrator {
    settings: IntegratorSettings,
    /// `irradiance[k][i]`: what coefficient i adds to E in direction k.
    irradiance: Vec<[f64; sh::MAX_COEFFICIENTS]>,
    sums: NodeSums,
}

/// How to integrate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IntegratorSettings {
    /// Highest band, 0..=4.
    pub bands: u32,
    /// Most that a channel of a sample's radiance may be; infinity leaves all light as it is.
    pub clamp: f32,
    /// Directions also go toward what is bright; else all are uniform.
    pub importance: bool,
}

/// What is summed up at one node.
#[derive(Debug, Default)]
struct NodeSums {
    moments: Vec<Moments>,
    /// Σ w Y of each replicate: the moments of a light of 1.
    controls: Vec<[f64; sh::MAX_COEFFICIENTS]>,
    /// Of each replicate.
    maps: Vec<DirectionMap>,
    /// Every direction that is not fully covered.
    uncovered: Vec<Uncovered>,
    audits: Vec<Audited>,
    clamped: f64,
    /// Σ w of what is not covered.
    unseen: f64,
}

/// A direction, and the share of its weight that nothing is known of.
#[derive(Debug, Clone, Copy)]
struct Uncovered {
    replicate: u32,
    direction: Vec3,
    weight: f32,
}

/// A direction that was audited.
#[derive(Debug, Clone, Copy)]
struct Audited {
    replicate: u32,
    direction: Vec3,
    weight: f32,
    arriving: Radiance,
    audit: Audit,
}

/// A uniform direction of the first ones, weighed once the outlook is known.
#[derive(Debug, Clone, Copy)]
struct First {
    glance: Glance,
    told: Told,
}

/// One node on its way.
struct Course<'a> {
    place: &'a Place,
    vantage: Vantage,
    context: PathContext,
    /// Of each replicate.
    firsts: Vec<Vec<First>>,
    outlooks: Vec<Outlook>,
}

impl Integrator {
    /// With tables for these settings.
    pub fn new(settings: IntegratorSettings) -> Self {
        let bands = settings.bands;
        let irradiance = fibonacci_sphere(ERROR_DIRECTIONS).into_iter().map(|direction| {
            let mut basis = [0.0; sh::MAX_COEFFICIENTS];
            sh::basis(bands, direction.to_array(), &mut basis);
            let mut row = [0.0; sh::MAX_COEFFICIENTS];
            for (i, value) in row.iter_mut().enumerate().take(sh::coefficient_count(bands)) {
                let band = sh::band_of(i);
                *value = f64::from(sh::COSINE[band]) * f64::from(basis[i]);
            }
            row
        });
        Integrator { settings, irradiance: irradiance.collect(), sums: NodeSums::default() }
    }

    /// Samples each place until `enough` says so. `enough(samples so far, estimate)` returns the total wanted next; when
    /// that is no more than there are, the estimate is returned. It is first asked with 0 samples and no estimate; who
    /// wants a second round starts with at least [`REPLICATES`].
    ///
    /// At the first place the error is looked at on the way, too: an estimate takes a thousandth of what its directions take, and one
    /// in eight nodes tells enough.
    ///
    /// `radiance(origin, direction, context)` is L(x, ω), or `None` to give up at once.
    pub fn integrate(
        &mut self,
        guide: &Guide,
        places: &[Place],
        radiance: impl Fn(Vec3, Vec3, &mut PathContext) -> Option<Told>,
        enough: impl Fn(u64, Option<&NodeEstimate>) -> u64,
    ) -> Result<Vec<NodeEstimate>, Interrupted> {
        let first_round = enough(0, None);
        let replicates = u64::from(REPLICATES).min(first_round) as u32;
        let mut courses = Vec::new();
        for place in places {
            courses.push(self.first_directions(guide, place, first_round, replicates, &radiance)?);
        }
        let mut estimates = Vec::new();
        for number in 0..places.len() {
            courses[number].outlooks = self.outlooks(guide, number, &courses);
            let course = &mut courses[number];
            self.sums.clear(replicates as usize);
            let (mut done, mut target) = (0, first_round);
            let mut last: Option<NodeEstimate> = None;
            // Directions so far, and the error by then.
            let mut rounds: Vec<(u64, f64)> = Vec::new();
            let mut estimate = loop {
                let parts = if number == 0 && done == 0 && target >= WATCHED { 4 } else { 1 };
                let round = [done, target];
                for part in 1..=parts {
                    let until = round[0] + (round[1] - round[0]) * part / parts;
                    for replicate in 0..replicates {
                        let range = [done, until].map(|samples| share(samples, replicates, replicate));
                        self.sample(guide, course, replicate, range, &radiance)?;
                    }
                    done = until;
                    if part < parts {
                        rounds.push((done, self.estimate(course, done).standard_error));
                    }
                }
                let mut estimate = self.estimate(course, done);
                rounds.push((done, estimate.standard_error));
                if let Some(last) = &last {
                    estimate.temper(last);
                }
                target = enough(done, Some(&estimate));
                if target <= done {
                    break estimate;
                }
                last = Some(estimate);
            };
            if rounds.len() > 3 {
                estimate.quarters = [1, 2, 3].map(|quarter| error_after(&rounds, done * quarter / 4));
            }
            estimate.found = std::mem::take(&mut courses[number].context.found);
            estimates.push(estimate);
        }
        Ok(estimates)
    }

    /// Sends the first uniform directions of a node.
    fn first_directions<'a>(
        &self,
        guide: &Guide,
        place: &'a Place,
        samples: u64,
        replicates: u32,
        radiance: &impl Fn(Vec3, Vec3, &mut PathContext) -> Option<Told>,
    ) -> Result<Course<'a>, Interrupted> {
        let context = PathContext::new(place.sequence.stream(0, Technique::Uniform));
        let firsts = vec![Vec::new(); replicates as usize];
        let vantage = guide.vantage(place.origin, samples);
        let mut course = Course { place, vantage, context, firsts, outlooks: Vec::new() };
        if !self.settings.importance {
            return Ok(course);
        }
        for (replicate, firsts) in course.firsts.iter_mut().enumerate() {
            let replicate = replicate as u32;
            let own = share(samples, replicates, replicate);
            let uniform = quota(UNIFORM_SHARE, own, place.sequence.rounding(replicate));
            course.context.stream = place.sequence.stream(replicate, Technique::Uniform);
            course.context.replicate = Some(replicate);
            for sample in 0..uniform.min(GLANCES) {
                course.context.sample = sample;
                let direction = uniform_sphere(course.context.point(0));
                let told = radiance(place.origin, direction, &mut course.context).ok_or(Interrupted)?;
                let distance = course.context.reach.unwrap_or(f32::INFINITY);
                let brightness = told.arriving.value.element_sum() / 3.0;
                firsts.push(First { glance: Glance { origin: place.origin, direction, distance, brightness }, told });
            }
        }
        Ok(course)
    }

    /// Of each replicate of a node: from the first directions of all nodes, but for its own.
    fn outlooks(&self, guide: &Guide, number: usize, courses: &[Course]) -> Vec<Outlook> {
        let origin = courses[number].place.origin;
        if !self.settings.importance {
            return courses[number].firsts.iter().map(|_| guide.uniform_outlook()).collect();
        }
        // Uncovered directions are dark only until they are filled.
        fn known(firsts: &[First]) -> impl Iterator<Item = &Glance> {
            firsts.iter().filter(|first| first.told.arriving.told() > 0.0).map(|first| &first.glance)
        }
        let sums = |firsts: &[First]| {
            let mut sums = guide.no_glances();
            known(firsts).for_each(|glance| guide.add_glance(&mut sums, origin, glance));
            sums
        };
        let mut others = guide.no_glances();
        for (_, course) in courses.iter().enumerate().filter(|(other, _)| *other != number) {
            let firsts = course.firsts.iter().flat_map(|firsts| known(firsts));
            firsts.for_each(|glance| guide.add_glance(&mut others, origin, glance));
        }
        let own: Vec<GlanceSums> = courses[number].firsts.iter().map(|firsts| sums(firsts)).collect();
        let outlook = |replicate: usize| {
            let mut all = others.clone();
            own.iter().enumerate().filter(|(other, _)| *other != replicate).for_each(|(_, sums)| all.add_all(sums));
            guide.outlook(&all)
        };
        (0..own.len()).map(outlook).collect()
    }

    /// Samples `range` of one replicate, in which its techniques have their quotas.
    fn sample(
        &mut self,
        guide: &Guide,
        course: &mut Course,
        replicate: u32,
        range: [u32; 2],
        radiance: &impl Fn(Vec3, Vec3, &mut PathContext) -> Option<Told>,
    ) -> Result<(), Interrupted> {
        let Course { place, vantage, context, firsts, outlooks } = course;
        let (outlook, firsts) = (&outlooks[replicate as usize], &firsts[replicate as usize]);
        let rounding = place.sequence.rounding(replicate);
        let [from, to] = range.map(|samples| quotas(outlook.shares(), samples, rounding));
        context.replicate = Some(replicate);
        for technique in Technique::ALL {
            context.stream = place.sequence.stream(replicate, technique);
            for sample in from[technique as usize]..to[technique as usize] {
                let first = firsts.get(sample as usize);
                let (direction, weight, told) = match first.filter(|_| technique == Technique::Uniform) {
                    Some(First { glance, told }) => {
                        (glance.direction, guide.weight(outlook, vantage, glance.direction), *told)
                    }
                    None => {
                        context.sample = sample;
                        let point = context.point(0);
                        let (direction, weight) = guide.propose(outlook, technique, vantage, point);
                        if weight == 0.0 {
                            continue;
                        }
                        let told = radiance(place.origin, direction, context).ok_or(Interrupted)?;
                        (direction, weight, told)
                    }
                };
                self.sums.add(&self.settings, replicate, direction, weight, told);
            }
        }
        Ok(())
    }

    /// Fills what is uncovered, and sums up.
    fn estimate(&self, Course { place, context, .. }: &Course, samples: u64) -> NodeEstimate {
        let count = sh::coefficient_count(self.settings.bands);
        let known = &place.known;
        let mut map = DirectionMap::default();
        let mut any_covered = true;
        let mut unseen_error = 0.0;
        let mut filled = None;
        if self.sums.unseen > 0.0 {
            self.sums.maps.iter().for_each(|own| map.add_all(own));
            // As if all light that is missing came from one direction and were off by as much as what is seen differs: a flux F from
            // there makes E of F cosθ, the root of whose mean square over the sphere is F/√6.
            let solid_angle = 4.0 * PI * self.sums.unseen / samples as f64;
            unseen_error = solid_angle * map.spread() / 6f64.sqrt();
        }
        if !self.sums.uncovered.is_empty() {
            any_covered = map.fill();
            // Light is filled in by what all replicates saw. Each is also filled in by its own alone: what all had in common would
            // not show in their spread. Nodes claimed 1.5 % whose light differed by 49 % between two seeds.
            let mut together = self.sums.moments.clone();
            let mut apart = self.sums.moments.clone();
            let own_maps = self.sums.maps.iter().map(|own| {
                let mut own = own.clone();
                own.fill();
                own
            });
            let own_maps: Vec<DirectionMap> = own_maps.collect();
            let mut basis = [0.0f32; sh::MAX_COEFFICIENTS];
            for &Uncovered { replicate, direction, weight } in &self.sums.uncovered {
                let replicate = replicate as usize;
                sh::basis(self.settings.bands, direction.to_array(), &mut basis);
                accumulate(&mut together[replicate][..count], &basis, map.radiance(direction), weight);
                accumulate(&mut apart[replicate][..count], &basis, own_maps[replicate].radiance(direction), weight);
            }
            filled = Some((together, apart));
        }
        // Each replicate's own estimate of L_lm and of B_lm, and those of all together.
        let unfilled = &self.sums.moments;
        let (sums, apart) = filled.as_ref().map_or((unfilled, unfilled), |(together, apart)| (together, apart));
        let replicates = sums.len() as u32;
        let own = |replicate: usize| 4.0 * PI / f64::from(share(samples, replicates, replicate as u32));
        let mut estimates: Vec<Moments> =
            apart.iter().enumerate().map(|(i, m)| m.map(|rgb| rgb.map(|v| v * own(i)))).collect();
        let controls: Vec<_> = self.sums.controls.iter().enumerate().map(|(i, b)| b.map(|v| v * own(i))).collect();
        let mut mean = [[0.0; 3]; sh::MAX_COEFFICIENTS];
        let mut control_mean = [0.0; sh::MAX_COEFFICIENTS];
        for (moments, control) in sums.iter().zip(&self.sums.controls) {
            for i in 0..count {
                for channel in 0..3 {
                    mean[i][channel] += moments[i][channel] * 4.0 * PI / samples as f64;
                }
                control_mean[i] += control[i] * 4.0 * PI / samples as f64;
            }
        }
        let all = control_mean[0] * samples as f64 / (4.0 * PI * f64::from(sh::Y00));
        let share_covered = if all > 0.0 { 1.0 - self.sums.unseen / all } else { 1.0 };

        let slopes = control_slopes(&estimates, &mean, &controls, &control_mean, count);
        let light = slopes.unwrap_or_default();
        for (estimate, control) in estimates.iter_mut().zip(&controls).chain([(&mut mean, &control_mean)]) {
            for i in 0..count {
                let unit = if i == 0 { (4.0 * PI).sqrt() } else { 0.0 };
                for channel in 0..3 {
                    estimate[i][channel] += known[i][channel] - light[channel] * (control[i] - unit);
                }
            }
        }
        // A slope takes one degree of freedom of its channel, and its own error costs as much again.
        let taken = if slopes.is_some() { 2.0 / count as f64 } else { 0.0 };
        let freedom = f64::from(replicates) - 1.0 - taken;
        let error = |squares: f64| match freedom > 0.0 {
            true => (squares / freedom / f64::from(replicates)).sqrt(),
            false => f64::INFINITY,
        };
        let mut coefficient_error = [[0.0; 3]; sh::MAX_COEFFICIENTS];
        for (i, errors) in coefficient_error.iter_mut().enumerate().take(count) {
            for (channel, value) in errors.iter_mut().enumerate() {
                let square = |m: &Moments| (m[i][channel] - mean[i][channel]).powi(2);
                *value = error(estimates.iter().map(square).sum());
            }
        }
        // E of every replicate in every direction; their variance over the mean's.
        let (mut all_squares, mut worst_squares, mut square) = (0.0, 0.0f64, 0.0);
        for row in &self.irradiance {
            for channel in 0..3 {
                let irradiance = |m: &Moments| row[..count].iter().zip(m).map(|(a, m)| a * m[channel]).sum::<f64>();
                let of_all = irradiance(&mean);
                square += of_all * of_all;
                let squares: f64 = estimates.iter().map(|replicate| (irradiance(replicate) - of_all).powi(2)).sum();
                all_squares += squares;
                worst_squares = worst_squares.max(squares);
            }
        }
        let values = (3 * ERROR_DIRECTIONS) as f64;
        let bias = self.bias(&own, &map, count);
        NodeEstimate {
            bias,
            unseen_error,
            sh: mean,
            coefficient_error,
            standard_error: error(all_squares / values),
            worst_error: error(worst_squares),
            rms_irradiance: (square / values).sqrt(),
            clamped: self.sums.clamped * 4.0 * PI / samples as f64,
            coverage: if any_covered { share_covered.clamp(f64::MIN_POSITIVE, 1.0) } else { 0.0 },
            rays: context.rays,
            found: Vec::new(),
            samples,
            quarters: [0.0; 3],
        }
    }
}

impl Integrator {
    /// What audits make of E. With D_r the mean of replicate r, independent of the others, D_r · D_s is the square of the systematic
    /// error on average. `own(r)`: 4π over directions of a replicate. `fill`: light of what nobody told, if anything is missing.
    fn bias(&self, own: &impl Fn(usize) -> f64, fill: &DirectionMap, count: usize) -> Bias {
        let replicates = self.sums.moments.len();
        if self.sums.audits.is_empty() || replicates < 2 {
            return Bias::default();
        }
        let mut moments = vec![[[0.0; 3]; sh::MAX_COEFFICIENTS]; replicates];
        let mut basis = [0.0f32; sh::MAX_COEFFICIENTS];
        for Audited { replicate, direction, weight, arriving, audit } in &self.sums.audits {
            sh::basis(self.settings.bands, direction.to_array(), &mut basis);
            let filled = |light: &Radiance| match 1.0 - light.told() {
                missing if missing > 0.0 => light.value + fill.radiance(*direction) * missing,
                _ => light.value,
            };
            let off = (filled(&audit.arriving) - filled(arriving)) * audit.weight;
            accumulate(&mut moments[*replicate as usize][..count], &basis, off, *weight);
        }
        let (mut products, mut spread) = (0.0, 0.0);
        for row in &self.irradiance {
            for channel in 0..3 {
                let of = |(r, m): (usize, &Moments)| {
                    own(r) * row[..count].iter().zip(m).map(|(a, m)| a * m[channel]).sum::<f64>()
                };
                let (sum, squares) =
                    moments.iter().enumerate().map(of).fold((0.0, 0.0), |(s, q), d| (s + d, q + d * d));
                products += sum * sum - squares;
                spread += squares - sum * sum / replicates as f64;
            }
        }
        let pairs = (replicates * (replicates - 1)) as f64;
        let values = (3 * ERROR_DIRECTIONS) as f64;
        Bias {
            square: products / pairs / values,
            noise: spread / pairs / values,
            by_probes: self.sums.audits[0].audit.by_probes,
        }
    }
}

impl NodeEstimate {
    /// Errors of a round in the light of the round before. Who stops at the first error under a target stops where it
    /// happens to come out small: nodes of the box that stopped at 1 % claimed 0.77 % and were off by 0.92 to 0.99 %. So
    /// half of the variance is what the last round makes expect, which is no less than in proportion to the directions.
    fn temper(&mut self, last: &NodeEstimate) {
        let expected = last.standard_error.powi(2) * last.samples as f64 / self.samples as f64;
        let own = self.standard_error.powi(2);
        if own > 0.0 && expected.is_finite() {
            let factor = (0.5 + 0.5 * expected / own).sqrt();
            self.standard_error *= factor;
            self.worst_error *= factor;
            self.coefficient_error.as_flattened_mut().iter_mut().for_each(|error| *error *= factor);
        }
    }
}

impl NodeSums {
    fn clear(&mut self, replicates: usize) {
        self.moments.clear();
        self.moments.resize(replicates, [[0.0; 3]; sh::MAX_COEFFICIENTS]);
        self.controls.clear();
        self.controls.resize(replicates, [0.0; sh::MAX_COEFFICIENTS]);
        self.maps.resize_with(replicates, DirectionMap::default);
        self.maps.iter_mut().for_each(DirectionMap::clear);
        self.uncovered.clear();
        self.audits.clear();
        self.clamped = 0.0;
        self.unseen = 0.0;
    }

    #[inline]
    fn add(
        &mut self,
        settings: &IntegratorSettings,
        replicate: u32,
        direction: Vec3,
        weight: f32,
        Told { mut arriving, audit }: Told,
    ) {
        let count = sh::coefficient_count(settings.bands);
        if arriving.value.max_element() > settings.clamp {
            let kept = arriving.value * (settings.clamp / arriving.value.max_element());
            self.clamped += f64::from((arriving.value - kept).element_sum() * weight);
            arriving.value = kept;
        }
        if let Some(audit) = audit {
            self.audits.push(Audited { replicate, direction, weight, arriving, audit });
        }
        self.maps[replicate as usize].add(direction, arriving.value * weight, arriving.told() * weight);
        if arriving.told() < 1.0 {
            self.uncovered.push(Uncovered { replicate, direction, weight: weight * (1.0 - arriving.told()) });
        }
        self.unseen += f64::from(weight * (1.0 - arriving.coverage).max(0.0));
        let mut basis = [0.0f32; sh::MAX_COEFFICIENTS];
        sh::basis(settings.bands, direction.to_array(), &mut basis);
        accumulate(&mut self.moments[replicate as usize][..count], &basis, arriving.value, weight);
        let control = &mut self.controls[replicate as usize];
        for (sum, &y) in control[..count].iter_mut().zip(&basis) {
            *sum += f64::from(weight) * f64::from(y);
        }
    }
}

/// The error after so many directions: that of the round, or between two rounds on the line of logarithms.
fn error_after(rounds: &[(u64, f64)], samples: u64) -> f64 {
    let next = rounds.partition_point(|(done, _)| *done < samples).min(rounds.len() - 1);
    let (until, after) = rounds[next];
    let (from, before) = rounds[next.saturating_sub(1)];
    if until <= samples || next == 0 || before <= 0.0 || after <= 0.0 {
        return after;
    }
    let along = (samples as f64 / from as f64).ln() / (until as f64 / from as f64).ln();
    before * (after / before).powf(along)
}

/// How many of a replicate's first `samples` directions each technique has. `rounding` (0..1, random) makes whole numbers
/// of it that are right on average, and never fewer for more samples.
fn quotas(shares: [f32; Technique::ALL.len()], samples: u32, rounding: f64) -> [u32; Technique::ALL.len()] {
    let mut sum = 0.0;
    let mut before = 0;
    let last = shares.iter().rposition(|share| *share > 0.0).unwrap_or(0);
    std::array::from_fn(|i| {
        sum += shares[i];
        let up_to = if i >= last { samples } else { quota(sum, samples, rounding) };
        let own = up_to - before;
        before = up_to;
        own
    })
}

fn quota(share: f32, samples: u32, rounding: f64) -> u32 {
    ((f64::from(share) * f64::from(samples) + rounding) as u32).min(samples)
}

/// β of each channel: the slope of L_lm over B_lm among replicates, coefficients weighted as they count in E.
/// `None` where there is nothing to learn from: one replicate, or all agree on B (L0 alone, uniform directions).
fn control_slopes(
    estimates: &[Moments],
    mean: &Moments,
    controls: &[[f64; sh::MAX_COEFFICIENTS]],
    control_mean: &[f64; sh::MAX_COEFFICIENTS],
    count: usize,
) -> Option<[f64; 3]> {
    let (mut together, mut alone) = ([0.0; 3], 0.0);
    for (estimate, control) in estimates.iter().zip(controls) {
        for i in 0..count {
            let cosine = f64::from(sh::COSINE[sh::band_of(i)]);
            let off = (control[i] - control_mean[i]) * cosine * cosine;
            alone += off * (control[i] - control_mean[i]);
            for channel in 0..3 {
                together[channel] += off * (estimate[i][channel] - mean[i][channel]);
            }
        }
    }
    // B is about 1: less than this is rounding.
    (alone > 1e-20).then(|| together.map(|sum| sum / alone))
}

#[inline]
fn accumulate(moments: &mut [[f64; 3]], basis: &[f32], value: Vec3, weight: f32) {
    let value = value.as_dvec3() * f64::from(weight);
    for (sum, &y) in moments.iter_mut().zip(basis) {
        let y = f64::from(y);
        sum[0] += value.x * y;
        sum[1] += value.y * y;
        sum[2] += value.z * y;
    }
}

/// How many of `samples` fall to a replicate: as even as can be, the first ones take the rest.
pub fn share(samples: u64, replicates: u32, replicate: u32) -> u32 {
    let (samples, replicates) = (samples as u32, u64::from(replicates) as u32);
    samples / replicates + u32::from(replicate < samples % replicates)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOTHING: Moments = [[0.0; 3]; sh::MAX_COEFFICIENTS];

    fn settings(bands: u32) -> IntegratorSettings {
        IntegratorSettings { bands, clamp: f32::INFINITY, importance: true }
    }

    fn place(sequence: Sequence) -> Place {
        Place { sequence, origin: Vec3::ZERO, known: NOTHING }
    }

    /// Integrates at one node without interruption, without a sky; every light here is whole.
    fn integrate(
        bands: u32,
        sequence: Sequence,
        light: impl Fn(Vec3) -> Radiance,
        enough: impl Fn(u64, Option<&NodeEstimate>) -> u64,
    ) -> NodeEstimate {
        let mut integrator = Integrator::new(settings(bands));
        let light = |_, d, _: &mut PathContext| Some(Told::from(light(d)));
        integrator.integrate(&Guide::nothing(), &[place(sequence)], light, enough).unwrap().remove(0)
    }

    fn sobol(seed: u64, node: u64) -> Sequence {
        Sequence { sampler: Sampler::Sobol, seed, node }
    }

    fn fixed(samples: u64) -> impl Fn(u64, Option<&NodeEstimate>) -> u64 {
        move |_, _| samples
    }

    #[test]
    fn constant_light_gives_pi_l_and_no_error() {
        for bands in 0..=4 {
            let light = |_| Radiance::covered(Vec3::new(1.0, 2.0, 1e6));
            let estimate = integrate(bands, sobol(0, 0), light, fixed(4096));
            let sqrt_4_pi = (4.0 * PI).sqrt();
            assert!((estimate.sh[0][0] / sqrt_4_pi - 1.0).abs() < 1e-6);
            assert!((estimate.sh[0][2] / sqrt_4_pi - 1e6).abs() < 1.0);
            assert!(estimate.sh[1..].iter().all(|rgb| rgb[0].abs() < 1e-6), "{:?}", estimate.sh);
            assert!(estimate.standard_error / estimate.rms_irradiance < 1e-6);
            assert_eq!(estimate.coverage, 1.0);
        }
    }

    #[test]
    fn standard_error_covers_the_truth_over_nodes() {
        // L = max(0, z)² has ∫ L Y_00 = 2π/3 · Y_00; 400 nodes of 64 random samples. z = error/se follows Student's
        // t with 3 degrees: 95 % within 3.182. Of 400, 365 to 392 with a false-alarm rate of 1e-3.
        let mut inside = 0;
        for node in 0..400 {
            let sequence = Sequence { sampler: Sampler::Random, seed: 9, node };
            let light = |d: Vec3| Radiance::covered(Vec3::splat(d.z.max(0.0).powi(2)));
            let estimate = integrate(0, sequence, light, fixed(64));
            let truth = 2.0 * PI / 3.0 * 0.282_094_8;
            // With L0 alone, E = π Y_00 L_00 in every direction.
            let error = (estimate.sh[0][0] - truth) * PI * 0.282_094_8;
            inside += u32::from(error.abs() < 3.182 * estimate.standard_error);
        }
        assert!((365..=392).contains(&inside), "{inside} of 400");
    }

    #[test]
    fn rounds_continue_the_same_sequence() {
        let light = |d: Vec3| Radiance::covered(Vec3::splat(d.y.max(0.1)));
        let whole = integrate(2, sobol(3, 5), light, fixed(4096));
        let rounds = integrate(2, sobol(3, 5), light, |done, _| (done * 2).clamp(1024, 4096));
        for (a, b) in whole.sh.iter().zip(&rounds.sh) {
            assert!((a[0] - b[0]).abs() < 1e-12);
        }
    }

    #[test]
    fn uncovered_directions_are_filled_and_counted() {
        // A third of the sphere is uncovered: the cap with cosθ > 1/3.
        let light = |d: Vec3| if d.y > 1.0 / 3.0 { Radiance::UNCOVERED } else { Radiance::covered(Vec3::ONE) };
        let estimate = integrate(2, sobol(0, 0), light, fixed(4096));
        assert!((estimate.coverage - 2.0 / 3.0).abs() < 1e-3, "{}", estimate.coverage);
        assert!((estimate.sh[0][0] / (4.0 * PI).sqrt() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn clamped_light_is_counted() {
        // An eighth of the sphere is brighter than allowed; what is cut is 9 in one channel, and in the others in proportion.
        let light = |_, d: Vec3, _: &mut PathContext| {
            Some(Radiance::covered(if d.y > 0.75 { Vec3::new(10.0, 5.0, 0.0) } else { Vec3::ONE }).into())
        };
        let mut integrator = Integrator::new(IntegratorSettings { clamp: 1.0, importance: false, ..settings(0) });
        let places = [place(sobol(0, 0))];
        let estimate = integrator.integrate(&Guide::nothing(), &places, light, fixed(4096)).unwrap().remove(0);
        assert!((estimate.clamped / (0.125 * 4.0 * PI) - 13.5).abs() < 1e-4, "{}", estimate.clamped);
        assert!((estimate.sh[0][0] / (4.0 * PI).sqrt() - 1.0).abs() < 1e-5, "{:?}", estimate.sh[0]);
    }

    #[test]
    fn known_light_is_added_and_costs_no_error() {
        let mut known = NOTHING;
        known[0] = [3.0, 2.0, 1.0];
        let mut integrator = Integrator::new(settings(0));
        let light = |_, _: Vec3, _: &mut PathContext| Some(Radiance::covered(Vec3::ONE).into());
        let places = [Place { known, ..place(sobol(0, 0)) }];
        let estimate = integrator.integrate(&Guide::nothing(), &places, light, fixed(256)).unwrap().remove(0);
        assert!((estimate.sh[0][0] - (4.0 * PI).sqrt() - 3.0).abs() < 1e-6);
        assert!(estimate.standard_error < 1e-6);
    }

    #[test]
    fn techniques_share_the_samples_of_a_replicate_and_keep_their_order() {
        for shares in [[0.25, 0.4, 0.35, 0.0], [1.0, 0.0, 0.0, 0.0], [0.25, 0.25, 0.25, 0.25], [0.25, 0.0, 0.0, 0.75]] {
            for rounding in [0.0, 0.3, 0.999] {
                let mut before = [0; 4];
                for samples in 0..300 {
                    let own = quotas(shares, samples, rounding);
                    assert_eq!(own.iter().sum::<u32>(), samples);
                    assert_eq!(own[0], if shares[0] < 1.0 { quota(shares[0], samples, rounding) } else { samples });
                    for i in 0..4 {
                        assert!(own[i] >= before[i].max(1) - 1, "{shares:?} {before:?} {own:?}");
                        assert!((own[i] as f32 - shares[i] * samples as f32).abs() <= 1.001);
                    }
                    before = own;
                }
            }
        }
    }

    #[test]
    fn errors_on_the_way_are_those_of_bakes_that_end_there() {
        let light = |d: Vec3| Radiance::covered(Vec3::splat(d.y.max(0.0).powi(8)));
        let whole = integrate(2, sobol(3, 5), light, fixed(4096));
        for (quarter, error) in whole.quarters.into_iter().enumerate() {
            let alone = integrate(2, sobol(3, 5), light, fixed(1024 * (quarter as u64 + 1)));
            assert!((error / alone.standard_error - 1.0).abs() < 1e-9, "{quarter}: {error} {}", alone.standard_error);
        }
        // By rounds: a quarter and a half are rounds of their own; their errors are tempered.
        let rounds = integrate(2, sobol(3, 5), light, |done, _| (done * 2).clamp(256, 4096));
        let [quarter, half, most] = rounds.quarters;
        assert!(quarter > half && half > most && rounds.standard_error > 0.0, "{:?}", rounds.quarters);
        assert!((quarter / whole.quarters[0]).ln().abs() < 0.7, "{quarter} {:?}", whole.quarters);
    }

    #[test]
    fn one_sample_has_no_standard_error() {
        let estimate = integrate(2, sobol(0, 0), |_| Radiance::covered(Vec3::ONE), fixed(1));
        assert!(estimate.standard_error.is_infinite());
        assert!(estimate.sh[0][0].is_finite());
    }

    #[test]
    fn interrupted_node_gives_up_at_the_next_ray() {
        // It went on to the last of its samples, and kept each as uncovered: 2^31 of them took the machine's memory.
        let calls = std::cell::Cell::new(0);
        let light = |_, _: Vec3, _: &mut PathContext| {
            calls.set(calls.get() + 1);
            (calls.get() < 500).then_some(Radiance::UNCOVERED.into())
        };
        let mut integrator = Integrator::new(settings(2));
        let found = integrator.integrate(&Guide::nothing(), &[place(sobol(0, 0))], light, fixed(1 << 31));
        assert!(found.is_err());
        assert_eq!(calls.get(), 500);
    }
}
