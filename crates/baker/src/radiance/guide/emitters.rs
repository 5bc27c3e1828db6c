//! Bright triangles as lights: which, how strong, and points on them. Emissive ones of the level, and bright
//! [regions](super::regions) that probes show.
//!
//! A triangle is drawn by about what it gives to the point that is to be lit, down a tree of groups; a point on it
//! uniformly. Based on: Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th ed., 2023, §12.6.3. By power alone, a
//! game map with 645 lamps had 32 % error at 16 384 directions per node. Only what is
//! brighter than [`BRIGHT`] times the level's mean is drawn: a level that glows all over (unlit materials) is found by
//! any ray, and its whole geometry as a list of lights would cost more than it saves. Where that leaves most of the light
//! out and rays do not find it (a level that is nearly all lamp), all that glows is drawn.

use glam::{Vec2, Vec3};

use crate::sampling::{Sampler, Stream, cosine_hemisphere, streams};
use crate::scene::Scene;
use crate::trace::{Surfaces, Tree};

/// How many times the area-weighted mean emitted radiance of all surfaces a triangle must exceed to be drawn.
const BRIGHT: f32 = 4.0;
/// Rays by which it is measured whether any ray finds what glows, and the share of them that must.
const CHANCES: u32 = 256;
const FOUND: f64 = 0.25;
/// Triangles at most that are drawn because rays do not find them.
const MOST_UNFOUND: usize = 1 << 16;
/// Places along an edge where a textured triangle's emission is looked up for its mean.
const TAPS: u32 = 8;

/// A triangle that is drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Emitter {
    /// Trace positions.
    pub corners: [Vec3; 3],
    /// Index into the surfaces it was found in; `None`: it is no triangle of any, but part of one or of several.
    pub triangle: Option<u32>,
    /// Square trace units.
    pub area: f32,
    /// Mean over the triangle and over R, G, B.
    pub radiance: f32,
    double_sided: bool,
}

/// Emitters in a tree by which one is drawn for a point that is to be lit.
#[derive(Debug)]
pub(crate) struct Emitters {
    emitters: Vec<Emitter>,
    branches: Vec<Branch>,
    /// `leaf[i]`: the branch that holds emitter i alone.
    leaf: Vec<u32>,
    tree: Tree,
}

/// A group of emitters.
#[derive(Debug, Clone, Copy)]
struct Branch {
    min: Vec3,
    max: Vec3,
    /// Radiance × area, summed.
    power: f32,
    /// All normals lie within `spread` of `axis`.
    axis: Vec3,
    spread: Angle,
    double_sided: bool,
    /// Of two children the first, the other follows; of a leaf the emitter.
    first: u32,
    is_leaf: bool,
    /// Itself at the root.
    parent: u32,
}

/// Who is to be lit: a node from all sides, a surface on the side of its normal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Receiver<'a> {
    /// Trace space.
    pub position: Vec3,
    pub normal: Option<Vec3>,
    /// [`Emitters::shares`] of it, where it draws often.
    pub shares: Option<&'a Shares>,
}

/// What the whole tree is to one receiver.
#[derive(Debug)]
pub(crate) struct Shares {
    /// Of each branch with children: probability of the first, given the branch; `None` where neither can light the receiver.
    first: Vec<Option<f32>>,
    /// Of each emitter: probability to be drawn.
    emitters: Vec<f32>,
}

/// A point that was drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EmitterPoint {
    /// Trace position.
    pub position: Vec3,
    /// Unit normal of the front.
    pub normal: Vec3,
    /// Triangle in the surfaces; `None` on a region.
    pub triangle: Option<u32>,
    /// Weights of corners 1 and 2.
    pub barycentric: Vec2,
    /// Probability density per square trace unit.
    pub density: f32,
    emitter: u32,
}

/// The bright triangles of each of `all`, several sets of surfaces of one scene.
pub(crate) fn bright_triangles(scene: &Scene, all: &[&Surfaces]) -> Vec<Vec<Emitter>> {
    let (mut area, mut power) = (0.0, 0.0);
    let mut glowing = Vec::new();
    for surfaces in all {
        let mut own = Vec::new();
        for triangle in 0..surfaces.len() as u32 {
            let corners = *surfaces.corners(triangle);
            let own_area = area_of(&corners);
            area += f64::from(own_area);
            let material = surfaces.material(scene, triangle);
            if material.emission == Vec3::ZERO {
                continue;
            }
            let radiance = mean_emission(scene, surfaces, triangle);
            power += f64::from(own_area * radiance);
            let double_sided = material.double_sided;
            own.push(Emitter { corners, triangle: Some(triangle), area: own_area, radiance, double_sided });
        }
        glowing.push(own);
    }
    let limit = (f64::from(BRIGHT) * power / area) as f32;
    let drawn: f64 = glowing.iter().flatten().filter(|emitter| emitter.radiance > limit).map(Emitter::power).sum();
    let limit = if drawn < 0.5 * power && !is_found_by_chance(scene, all, &glowing) { 0.0 } else { limit };
    glowing.iter_mut().for_each(|own| own.retain(|emitter| emitter.radiance > limit && emitter.area > 0.0));
    glowing
}

/// Rays from what glows, by its power, meet what glows: then so do those from anywhere in the level. Also true where there
/// are too many triangles to draw.
fn is_found_by_chance(scene: &Scene, all: &[&Surfaces], glowing: &[Vec<Emitter>]) -> bool {
    if glowing.iter().map(Vec::len).sum::<usize>() > MOST_UNFOUND {
        return true;
    }
    let from: Vec<(&Surfaces, &Emitter)> =
        all.iter().zip(glowing).flat_map(|(surfaces, own)| own.iter().map(|emitter| (*surfaces, emitter))).collect();
    let mut whole = 0.0;
    let mut sum = |(_, emitter): &(&Surfaces, &Emitter)| {
        whole += emitter.power();
        whole
    };
    let cumulative: Vec<f64> = from.iter().map(&mut sum).collect();
    let stream = Stream::new(Sampler::Sobol, 0, streams::GLOW, 0);
    let finds = |sample: &u32| {
        let ([a, b], [c, _]) = (stream.point(*sample, 0), stream.point(*sample, 1));
        let number = cumulative.partition_point(|sum| *sum <= f64::from(a) * whole).min(from.len() - 1);
        let (surfaces, emitter) = from[number];
        let root = b.sqrt();
        let triangle = emitter.triangle.expect("a triangle of the level");
        let place = surfaces.point(triangle, Vec2::new(1.0 - root, c * root), false);
        let (start, direction) = (surfaces.leave(&place), cosine_hemisphere(place.normal, stream.point(*sample, 2)));
        let mut nearest = (f32::INFINITY, Vec3::ZERO);
        for surfaces in all {
            if let Some(hit) = surfaces.shown(scene, start, direction, nearest.0) {
                nearest = (hit.t, surfaces.emission(scene, &hit));
            }
        }
        nearest.1 != Vec3::ZERO
    };
    (0..CHANCES).filter(finds).count() as f64 >= FOUND * f64::from(CHANCES)
}

impl Emitters {
    /// A tree of these; `None` if there are none, or more light than numbers hold.
    pub fn new(glowing: Vec<Emitter>) -> Option<Emitters> {
        let power: f32 = glowing.iter().map(|emitter| emitter.radiance * emitter.area).sum();
        if glowing.is_empty() || !power.is_finite() {
            return None;
        }
        let corners: Vec<[Vec3; 3]> = glowing.iter().map(|e| e.corners).collect();
        let leaf = vec![0; glowing.len()];
        let mut emitters = Emitters { tree: Tree::build(&corners), branches: Vec::new(), leaf, emitters: glowing };
        let mut order: Vec<u32> = (0..corners.len() as u32).collect();
        emitters.branches.push(emitters.branch_of(&order, 0));
        emitters.split(0, &mut order);
        Some(emitters)
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.emitters.len()
    }

    /// How many are triangles of the level.
    pub fn emissive_count(&self) -> usize {
        self.emitters.iter().filter(|emitter| emitter.triangle.is_some()).count()
    }

    /// `[i]`: number of the emitter that triangle i of the surfaces (there must be one set) is, or `u32::MAX`.
    pub fn numbers(&self, surfaces: &Surfaces) -> Vec<u32> {
        let mut numbers = vec![u32::MAX; surfaces.len()];
        for (number, emitter) in self.emitters.iter().enumerate() {
            if let Some(triangle) = emitter.triangle {
                numbers[triangle as usize] = number as u32;
            }
        }
        numbers
    }

    fn branch_of(&self, members: &[u32], parent: u32) -> Branch {
        let members = members.iter().map(|&m| &self.emitters[m as usize]);
        let mut branch = Branch {
            min: Vec3::INFINITY,
            max: Vec3::NEG_INFINITY,
            power: 0.0,
            axis: Vec3::ZERO,
            spread: Angle { sine: 0.0, cosine: 1.0 },
            double_sided: false,
            first: 0,
            is_leaf: false,
            parent,
        };
        for emitter in members.clone() {
            for corner in emitter.corners {
                (branch.min, branch.max) = (branch.min.min(corner), branch.max.max(corner));
            }
            branch.power += emitter.radiance * emitter.area;
            branch.axis += emitter.normal();
            branch.double_sided |= emitter.double_sided;
        }
        branch.axis = branch.axis.normalize_or(Vec3::Y);
        let widest = members.map(|emitter| emitter.normal().dot(branch.axis)).fold(1.0, f32::min);
        branch.spread = Angle::of_cosine(widest);
        branch
    }

    /// Halves the members along the longest side of their middles' box until each stands alone.
    fn split(&mut self, root: u32, order: &mut [u32]) {
        let mut open = vec![(root, 0, order.len())];
        while let Some((at, start, end)) = open.pop() {
            let members = &mut order[start..end];
            if let [only] = members {
                (self.branches[at as usize].first, self.branches[at as usize].is_leaf) = (*only, true);
                self.leaf[*only as usize] = at;
                continue;
            }
            let middle = |m: u32| self.emitters[m as usize].corners.iter().sum::<Vec3>();
            let (min, max) = members
                .iter()
                .map(|&m| middle(m))
                .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(min, max), p| (min.min(p), max.max(p)));
            let axis = (max - min).max_position();
            members.sort_unstable_by(|&a, &b| middle(a)[axis].total_cmp(&middle(b)[axis]).then(a.cmp(&b)));
            let half = start + members.len() / 2;
            let first = self.branches.len() as u32;
            self.branches[at as usize].first = first;
            for (start, end) in [(start, half), (half, end)] {
                let branch = self.branch_of(&order[start..end], at);
                open.push((self.branches.len() as u32, start, end));
                self.branches.push(branch);
            }
        }
    }

    /// What drawing for a receiver asks of the tree, asked once. Pays from about as many draws on as there are emitters.
    pub fn shares(&self, receiver: &Receiver) -> Shares {
        let mut shares = Shares { first: vec![None; self.branches.len()], emitters: vec![0.0; self.len()] };
        let mut probability = vec![0.0; self.branches.len()];
        probability[0] = if self.branches[0].importance(receiver) > 0.0 { 1.0 } else { 0.0 };
        // Children stand behind their parents.
        for (at, branch) in self.branches.iter().enumerate() {
            let first = branch.first as usize;
            if branch.is_leaf {
                shares.emitters[first] = probability[at];
            } else if let (true, Some(share)) = (probability[at] > 0.0, self.first_share(at, receiver)) {
                shares.first[at] = Some(share);
                probability[first] = probability[at] * share;
                probability[first + 1] = probability[at] * (1.0 - share);
            }
        }
        shares
    }

    /// Probability of the first child of a branch; `None` where neither can light the receiver.
    fn first_share(&self, at: usize, receiver: &Receiver) -> Option<f32> {
        if let Some(shares) = receiver.shares {
            return shares.first[at];
        }
        let first = self.branches[at].first as usize;
        let [a, b] = [first, first + 1].map(|child| self.branches[child].importance(receiver));
        (a + b > 0.0).then(|| a / (a + b))
    }

    /// A point for a point of the unit square; `None` where no emitter can light the receiver.
    pub fn draw(&self, receiver: &Receiver, [first, second]: [f32; 2]) -> Option<EmitterPoint> {
        let (mut left, mut probability) = (f64::from(first), 1.0);
        let mut at = 0;
        if receiver.shares.is_none() && self.branches[0].importance(receiver) <= 0.0 {
            return None;
        }
        while !self.branches[at].is_leaf {
            // What is left of the number goes on.
            let share = self.first_share(at, receiver)?;
            let second = left >= f64::from(share);
            let own = if second { 1.0 - share } else { share };
            left = ((left - if second { f64::from(share) } else { 0.0 }) / f64::from(own)).clamp(0.0, 1.0);
            probability *= own;
            at = self.branches[at].first as usize + usize::from(second);
        }
        let number = self.branches[at].first;
        // Uniform over a triangle: (1 - √ξ1, ξ2 √ξ1) (Turk, "Generating Random Points in Triangles", 1990).
        let root = (left as f32).sqrt();
        let barycentric = Vec2::new(1.0 - root, second * root);
        let emitter = &self.emitters[number as usize];
        let [a, b, c] = emitter.corners;
        Some(EmitterPoint {
            position: a * (1.0 - barycentric.x - barycentric.y) + b * barycentric.x + c * barycentric.y,
            normal: emitter.normal(),
            triangle: emitter.triangle,
            barycentric,
            density: probability / emitter.area,
            emitter: number,
        })
    }

    /// Density per square trace unit with which [`Emitters::draw`] returns a point of an emitter.
    pub fn density_on(&self, number: u32, receiver: &Receiver) -> f32 {
        let mut density = 1.0 / self.emitters[number as usize].area;
        if let Some(shares) = receiver.shares {
            return density * shares.emitters[number as usize];
        }
        let mut at = self.leaf[number as usize];
        if self.branches[0].importance(receiver) <= 0.0 {
            return 0.0;
        }
        while at != 0 {
            let parent = self.branches[at as usize].parent;
            let Some(share) = self.first_share(parent as usize, receiver) else { return 0.0 };
            density *= if at == self.branches[parent as usize].first { share } else { 1.0 - share };
            at = parent;
        }
        density
    }

    /// A direction toward an emitter, and the density per steradian of all that lie along it, hidden ones too; `None`
    /// where no emitter can light the receiver.
    pub fn sample_direction(&self, receiver: &Receiver, point: [f32; 2]) -> Option<(Vec3, f32)> {
        let drawn = self.draw(receiver, point)?;
        let line = drawn.position - receiver.position;
        let direction = line.try_normalize()?;
        // Its own share is computed, not traced: a point on its edge may be missed by rounding.
        let own = solid_angle_density(drawn.density, line, drawn.normal);
        Some((direction, own + self.direction_density(receiver, direction, Some(drawn.emitter))))
    }

    /// Density per steradian with which [`Emitters::sample_direction`] returns `direction`.
    pub fn density(&self, receiver: &Receiver, direction: Vec3) -> f32 {
        self.direction_density(receiver, direction, None)
    }

    fn direction_density(&self, receiver: &Receiver, direction: Vec3, except: Option<u32>) -> f32 {
        let mut sum = 0.0;
        self.tree.any(receiver.position, direction, 0.0, f32::INFINITY, |hit| {
            if Some(hit.triangle) != except {
                let normal = self.emitters[hit.triangle as usize].normal();
                let density = self.density_on(hit.triangle, receiver);
                sum += solid_angle_density(density, direction * hit.t, normal);
            }
            true
        });
        sum
    }
}

impl Receiver<'_> {
    /// From all sides.
    pub fn node(position: Vec3) -> Receiver<'static> {
        Receiver { position, normal: None, shares: None }
    }

    /// On the side of its normal.
    pub fn surface(position: Vec3, normal: Vec3) -> Receiver<'static> {
        Receiver { position, normal: Some(normal), shares: None }
    }
}

impl Branch {
    /// About how much light the group gives to the receiver, unhidden; 0 only where it gives none for sure.
    ///
    /// power · cosθ' · cosθ_i' / d², each cosine the largest that any point of the box and any normal of the cone could
    /// have. Based on: Conty Estevez, Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", 2018.
    fn importance(&self, receiver: &Receiver) -> f32 {
        let line = 0.5 * (self.min + self.max) - receiver.position;
        let radius = 0.5 * (self.max - self.min).length();
        let distance = line.length();
        let mut importance = self.power / distance.max(radius).max(f32::MIN_POSITIVE).powi(2);
        if distance <= radius {
            return importance;
        }
        let direction = line / distance;
        // The box lies within this angle of the direction to its middle.
        let bound = Angle::of_sine(radius / distance);
        let cosine = -direction.dot(self.axis);
        let cosine = if self.double_sided { cosine.abs() } else { cosine };
        let leaving = Angle::of_cosine(cosine).minus(self.spread).minus(bound);
        if leaving.cosine <= 0.0 {
            return 0.0;
        }
        importance *= leaving.cosine;
        if let Some(normal) = receiver.normal {
            let arriving = Angle::of_cosine(direction.dot(normal)).minus(bound);
            if arriving.cosine <= 0.0 {
                return 0.0;
            }
            importance *= arriving.cosine;
        }
        importance.max(f32::MIN_POSITIVE)
    }
}

/// An angle of 0..=π by its sine and cosine: sums of angles without arc functions, which took half the time.
#[derive(Debug, Clone, Copy)]
struct Angle {
    sine: f32,
    cosine: f32,
}

impl Angle {
    fn of_cosine(cosine: f32) -> Angle {
        Angle { sine: (1.0 - cosine * cosine).max(0.0).sqrt(), cosine }
    }

    /// Up to π/2.
    fn of_sine(sine: f32) -> Angle {
        Angle { sine, cosine: (1.0 - sine * sine).max(0.0).sqrt() }
    }

    /// The difference; zero if it were negative.
    fn minus(self, other: Angle) -> Angle {
        if self.cosine >= other.cosine {
            return Angle { sine: 0.0, cosine: 1.0 };
        }
        Angle {
            sine: self.sine * other.cosine - self.cosine * other.sine,
            cosine: self.cosine * other.cosine + self.sine * other.sine,
        }
    }
}

impl Emitter {
    /// A bright place that is no triangle of the level. It shines to the side from which its corners run
    /// counter-clockwise.
    pub fn region(corners: [Vec3; 3], radiance: f32) -> Emitter {
        Emitter { corners, triangle: None, area: area_of(&corners), radiance, double_sided: false }
    }

    /// A triangle that does not glow, but is looked for.
    pub fn target(corners: [Vec3; 3], double_sided: bool) -> Emitter {
        Emitter { double_sided, ..Emitter::region(corners, 1.0) }
    }

    /// Radiance × area.
    fn power(&self) -> f64 {
        f64::from(self.radiance) * f64::from(self.area)
    }

    /// Unit, of the front.
    pub fn normal(&self) -> Vec3 {
        let [a, b, c] = self.corners;
        (b - a).cross(c - a).normalize_or(Vec3::Y)
    }
}

/// Per area → per solid angle: p d² / cosθ. `line`: from the observer to the point.
pub(crate) fn solid_angle_density(density: f32, line: Vec3, normal: Vec3) -> f32 {
    let squared = line.length_squared();
    let cosine = line.dot(normal).abs() / squared.sqrt();
    if squared == 0.0 { 0.0 } else { density * squared / cosine }
}

/// Mean over a triangle of the mean of R, G and B that its front emits.
fn mean_emission(scene: &Scene, surfaces: &Surfaces, triangle: u32) -> f32 {
    let material = surfaces.material(scene, triangle);
    let varies =
        material.emission_texture.is_some() || (material.unlit && !surfaces.mesh(scene, triangle).colors.is_empty());
    if !varies {
        return surfaces.emission(scene, &surfaces.point(triangle, Vec2::splat(1.0 / 3.0), false)).element_sum() / 3.0;
    }
    let (mut sum, mut count) = (0.0, 0.0);
    for j in 0..TAPS {
        for i in 0..TAPS - j {
            let place = (Vec2::new(i as f32, j as f32) + 1.0 / 3.0) / TAPS as f32;
            sum += surfaces.emission(scene, &surfaces.point(triangle, place, false)).element_sum() / 3.0;
            count += 1.0;
        }
    }
    sum / count
}

fn area_of([a, b, c]: &[Vec3; 3]) -> f32 {
    0.5 * (b - a).cross(c - a).length()
}
