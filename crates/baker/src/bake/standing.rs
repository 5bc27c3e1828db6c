//! Where nodes stand: in the open, in a solid, or outside of the level; and where the light of those is taken that can step
//! out of what they stand in.
//!
//! A node looks around before it is baked. Who sees the backs of single-sided triangles in more than a quarter of all
//! directions is in a solid, or, where light could escape from there, outside of the level: it is not baked, unless a small
//! step within its cell brings it into the open. Double-sided triangles tell nothing so early, for rooms are made of them
//! with either side inward; who sees their backs and then finds next to no light was in a solid, too, as long as some node of
//! the volume is in the open.

use bincode::{Decode, Encode};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

use super::pass::Pass;
use super::{Nodes, SparseGrid};
use crate::blocks::PassKind;
use crate::radiance::{RadianceFunction, SOLID_BACKS};
use crate::sampling::fibonacci_sphere;
use crate::trace::{Level, Met};
use crate::{Control, Interrupted};

/// What a node stands in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Encode, Decode)]
pub enum Standing {
    /// In the open: baked.
    #[default]
    Open,
    /// In the open, but nothing it sees is known: no probe has seen it.
    Uncovered,
    /// In a solid.
    Solid,
    /// Behind the level's surfaces, where light escapes.
    Outside,
}

/// Directions in which a node looks around; whoever is in doubt looks more closely.
const LOOKS: usize = 64;
const CLOSE_LOOKS: usize = 512;
/// Who sees more backs is in a solid. A little less than [`SOLID_BACKS`], because so few looks are off by as much.
const MOST_BACKS: f64 = SOLID_BACKS - 0.02;
/// Shares of backs between which a node is in doubt.
const DOUBT: std::ops::Range<f64> = 0.1..0.45;
/// A node stands off a surface by this share of the distance between nodes, if it stood nearer. A hundredth: close enough
/// to be the light there, far enough for half of its rays to miss that surface.
const OFF_SURFACES: f64 = 0.01;
/// And whoever steps out of a solid goes so far past its surface.
const PAST_SURFACES: f32 = 0.05;
/// Least distance from surfaces, trace units: a tenth of a millimetre in a room.
const LEAST_OFF: f32 = 5e-3;
/// Ways out that are tried.
const MOST_STEPS: usize = 8;

/// What some nodes stand in, and where each one's rays start. All lists go by places in `numbers`.
#[derive(Debug, Default)]
pub(super) struct Sites {
    /// Which of the nodes these are.
    pub numbers: Vec<u32>,
    /// Per node. Of `Open` ones some may be [`suspects`](Sites::suspects).
    pub standing: Vec<Standing>,
    /// Those whose rays start elsewhere than [`Nodes::ray_origin`], in order; trace space.
    moved: Vec<(u32, Vec3)>,
    /// Open nodes that see many backs of double-sided triangles, in order.
    pub suspects: Vec<u32>,
    /// Rays traced to find out.
    pub rays: u64,
}

/// Nodes of a block.
const BLOCK: usize = 64;
/// Blocks whose sites are in memory at once.
const BLOCKS_AT_A_TIME: usize = 1 << 12;

/// Where a node stands after a look around.
#[derive(Debug, Clone, Copy, Encode, Decode)]
struct Site {
    /// Trace space.
    place: [f32; 3],
    standing: Standing,
    is_suspect: bool,
    rays: u64,
}

/// What is seen all around.
struct Look {
    /// Share of single-sided backs, of all backs, and of what escapes.
    solid: f64,
    backs: f64,
    escapes: f64,
    met: Vec<Met>,
}

impl Sites {
    /// Looks around at these nodes.
    pub fn find(
        nodes: &Nodes,
        numbers: Vec<u32>,
        function: &impl RadianceFunction,
        control: &Control,
    ) -> Result<Sites, Interrupted> {
        let count = numbers.len();
        let mut sites = Sites { numbers, ..Sites::default() };
        if function.level().is_empty() {
            sites.standing = vec![Standing::Open; count];
            return Ok(sites);
        }
        let settle = |around: &mut Around, index: u32| match control.cancelled() {
            true => Err(Interrupted),
            false => Ok(around.settle(sites.origin(index, nodes, function))),
        };
        let start = || Around::new(nodes, function);
        let pass = Pass::begin(control, PassKind::Shared);
        let sites_of = |around: &mut Around, number: usize| -> Result<Vec<Site>, Interrupted> {
            let block = number * BLOCK..count.min((number + 1) * BLOCK);
            let find = || block.clone().map(|index| settle(around, index as u32)).collect();
            let found = pass.block(number, |sites: &Vec<Site>| sites.len() == block.len(), find)?;
            Ok(found.expect("every run looks around"))
        };
        // Some blocks at a time: of all nodes sites would take more memory than what they come to.
        let blocks = count.div_ceil(BLOCK);
        let (mut standing, mut moved, mut suspects, mut rays) = (Vec::with_capacity(count), Vec::new(), Vec::new(), 0);
        for first in (0..blocks).step_by(BLOCKS_AT_A_TIME) {
            let numbers = first..blocks.min(first + BLOCKS_AT_A_TIME);
            let found: Result<Vec<Vec<Site>>, Interrupted> =
                numbers.into_par_iter().map_init(start, sites_of).collect();
            for site in found?.into_iter().flatten() {
                let index = standing.len() as u32;
                let place = Vec3::from(site.place);
                if place != sites.origin(index, nodes, function) {
                    moved.push((index, place));
                }
                if site.is_suspect {
                    suspects.push(index);
                }
                standing.push(site.standing);
                rays += site.rays;
            }
        }
        pass.end()?;
        (sites.standing, sites.moved, sites.suspects, sites.rays) = (standing, moved, suspects, rays);
        Ok(sites)
    }

    /// Nodes that are worth baking, of these.
    pub fn open(&self, nodes: impl Iterator<Item = u32>) -> Vec<u32> {
        nodes.filter(|&node| self.standing[node as usize] == Standing::Open).collect()
    }

    fn origin(&self, node: u32, nodes: &Nodes, function: &impl RadianceFunction) -> Vec3 {
        nodes.ray_origin(self.numbers[node as usize] as usize, function.frame())
    }

    /// The same sites and others behind them.
    pub fn append(&mut self, other: Sites) {
        let first = self.numbers.len() as u32;
        self.numbers.extend(other.numbers);
        self.standing.extend(other.standing);
        self.moved.extend(other.moved.into_iter().map(|(node, place)| (first + node, place)));
        self.suspects.extend(other.suspects.into_iter().map(|node| first + node));
        self.rays += other.rays;
    }

    /// Those at these places in the lists, as the nodes of other numbers: 0 and up.
    pub fn selected(&self, places: &[u32]) -> Sites {
        let moved = |(node, place): (usize, &u32)| {
            let found = self.moved.binary_search_by_key(place, |moved| moved.0).ok()?;
            Some((node as u32, self.moved[found].1))
        };
        Sites {
            numbers: (0..places.len() as u32).collect(),
            standing: places.iter().map(|place| self.standing[*place as usize]).collect(),
            moved: places.iter().enumerate().filter_map(moved).collect(),
            suspects: Vec::new(),
            rays: self.rays,
        }
    }

    /// Where the rays of a node start, trace space.
    pub fn place(&self, node: u32, nodes: &Nodes, function: &impl RadianceFunction) -> Vec3 {
        match self.moved.binary_search_by_key(&node, |moved| moved.0) {
            Ok(found) => self.moved[found].1,
            Err(_) => self.origin(node, nodes, function),
        }
    }

    /// Suspects that turned out dark are in solids; those of them that find a way out are returned, to be baked there.
    pub fn step_out(&mut self, dark: &[u32], nodes: &Nodes, function: &impl RadianceFunction) -> Vec<u32> {
        let way_out = |around: &mut Around, &node: &u32| {
            let place = self.place(node, nodes, function);
            let look = around.look(place, CLOSE_LOOKS);
            let way = around.way_out(place, &look, |met| met.back, |look| look.backs <= MOST_BACKS);
            (way, around.level.take_rays())
        };
        let found: Vec<(Option<Vec3>, u64)> =
            dark.par_iter().map_init(|| Around::new(nodes, function), way_out).collect();
        let mut out = Vec::new();
        for (&node, (place, rays)) in dark.iter().zip(found) {
            self.rays += rays;
            self.standing[node as usize] = Standing::Solid;
            if let Some(place) = place {
                match self.moved.binary_search_by_key(&node, |moved| moved.0) {
                    Ok(found) => self.moved[found].1 = place,
                    Err(at) => self.moved.insert(at, (node, place)),
                }
                out.push(node);
            }
        }
        out
    }

    /// Nodes whose light is taken elsewhere, and where, world metres.
    pub fn moved(&self, function: &impl RadianceFunction) -> Vec<(u32, DVec3)> {
        let open = self.moved.iter().filter(|(node, _)| self.standing[*node as usize] == Standing::Open);
        open.map(|&(node, place)| (node, function.frame().to_world(place))).collect()
    }
}

/// Some node is in the open, as far as a look around tells.
pub fn any_open(nodes: &Nodes, function: &impl RadianceFunction, cancel: &AtomicBool) -> Result<bool, Interrupted> {
    let origin = |node: usize| nodes.ray_origin(node, function.frame());
    let is_open = |around: &mut Around, node: usize| {
        let is_cancelled = cancel.load(Ordering::Relaxed);
        is_cancelled || around.settle(origin(node)).standing == Standing::Open
    };
    let start = || Around::new(nodes, function);
    let found =
        function.level().is_empty() || (0..nodes.len()).into_par_iter().map_init(start, is_open).any(|open| open);
    if cancel.load(Ordering::Relaxed) { Err(Interrupted) } else { Ok(found) }
}

/// Looking around, with what is the same for all nodes.
struct Around<'a> {
    level: Level<'a>,
    few: Vec<Vec3>,
    many: Vec<Vec3>,
    /// Half the distance between nodes per axis, trace units; zero where nodes do not move.
    reach: Vec3,
    /// Vertices have left theirs already.
    leaves_surfaces: bool,
    /// Distance from surfaces, trace units.
    off: f32,
    past: f32,
}

impl<'a> Around<'a> {
    fn new(nodes: &Nodes, function: &'a impl RadianceFunction) -> Around<'a> {
        let spacing = match nodes {
            Nodes::Grid(grid) | Nodes::Sparse(SparseGrid { grid, .. }) => {
                DVec3::from(grid.spacing()) * function.frame().scale
            }
            Nodes::Points(_) | Nodes::Vertices { .. } => DVec3::ZERO,
        };
        let least = spacing.to_array().into_iter().filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min);
        let least = if least.is_finite() { least as f32 } else { 0.0 };
        Around {
            level: function.level(),
            few: fibonacci_sphere(LOOKS),
            many: fibonacci_sphere(CLOSE_LOOKS),
            reach: (spacing / 2.0).as_vec3(),
            leaves_surfaces: !matches!(nodes, Nodes::Vertices { .. }),
            off: (least * OFF_SURFACES as f32).max(LEAST_OFF),
            past: (least * PAST_SURFACES).max(LEAST_OFF),
        }
    }

    /// Moves a node off the surfaces it stands on, and out of the solid it stands in, if it may move.
    fn settle(&self, place: Vec3) -> Site {
        let place = if self.leaves_surfaces { self.off_surfaces(place) } else { place };
        let look = self.look(place, LOOKS);
        let look = if DOUBT.contains(&look.backs) { self.look(place, CLOSE_LOOKS) } else { look };
        let site = |place: Vec3, standing, is_suspect| Site {
            place: place.into(),
            standing,
            is_suspect,
            rays: self.level.take_rays(),
        };
        if look.solid <= MOST_BACKS {
            return site(place, Standing::Open, look.backs > MOST_BACKS);
        }
        let free = |look: &Look| look.solid <= MOST_BACKS;
        match self.way_out(place, &look, |met| met.back && met.single_sided, free) {
            Some(place) => site(place, Standing::Open, false),
            None if look.escapes > 0.0 => site(place, Standing::Outside, false),
            None => site(place, Standing::Solid, false),
        }
    }

    fn look(&self, place: Vec3, count: usize) -> Look {
        let directions = if count == LOOKS { &self.few } else { &self.many };
        let met: Vec<Met> =
            directions.iter().filter_map(|direction| self.level.meet(place, *direction, f32::INFINITY)).collect();
        let share = |of: &dyn Fn(&&Met) -> bool| met.iter().filter(of).count() as f64 / count as f64;
        Look {
            solid: share(&|met| met.back && met.single_sided),
            backs: share(&|met| met.back),
            escapes: 1.0 - met.len() as f64 / count as f64,
            met,
        }
    }

    /// A place in a surface, where half of all rays would leave through it, goes to the front of it, a little off; and so does
    /// one that is hardly in front.
    fn off_surfaces(&self, mut place: Vec3) -> Vec3 {
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            let off = self.off_in_gap(place, axis);
            let way = axis * (2.0 * off);
            for (from, way) in [(place - way * 0.5, way), (place + way * 0.5, -way)] {
                let Some(met) = self.level.meet(from, way, 1.0) else { continue };
                let front = if met.back { -met.normal } else { met.normal };
                let height = (place - met.position).dot(front);
                if height.abs() < off {
                    place += front * (off - height);
                }
                break;
            }
        }
        place
    }

    /// Distance from surfaces of what stands between two of them: less in a narrow gap. In a room of 1 m in a city of 100 km nodes
    /// went 0.6 m off its walls, and so through the next one.
    fn off_in_gap(&self, place: Vec3, axis: Vec3) -> f32 {
        let reach = self.off / (2.0 * OFF_SURFACES as f32);
        let free = |way: Vec3| self.level.meet(place, way, reach).map_or(reach, |met| met.t);
        let gap = free(axis) + free(-axis);
        let rounding = 64.0 * f32::EPSILON * place.abs().max_element();
        self.off.min((gap * OFF_SURFACES as f32).max(rounding))
    }

    /// The nearest place past one of the surfaces that count as a way out, within the node's share of its cells, that is in
    /// the open.
    fn way_out(
        &self,
        place: Vec3,
        look: &Look,
        is_way: impl Fn(&Met) -> bool,
        is_open: impl Fn(&Look) -> bool,
    ) -> Option<Vec3> {
        // Straight through the plane of each surface, and where a ray met it.
        let ways = look.met.iter().filter(|met| is_way(met)).flat_map(|met| {
            let out = -met.normal;
            let straight = out * ((met.position - place).dot(out) + self.past);
            [straight, met.position - place + out * self.past]
        });
        let mut steps: Vec<Vec3> = ways.filter(|step| step.abs().cmple(self.reach).all()).collect();
        steps.sort_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        // Many rays meet the same wall.
        steps.dedup_by(|a, b| a.distance_squared(*b) < self.past * self.past);
        let mut places = steps.into_iter().take(MOST_STEPS).map(|step| place + step);
        places.find(|place| is_open(&self.look(*place, CLOSE_LOOKS)))
    }
}
