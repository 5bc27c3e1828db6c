//! What goes into a bake, as values.

use glam::DVec3;

use super::records::InputRecord;
use super::settings::Settings;
use super::stop::Stop;
use super::text::Method;
use crate::Finding;
use crate::radiance::Distant;
use crate::radiance::gdibl::Probe;
use crate::scene::{Mesh, Role, Scene};
use crate::trace::Trees;

/// What a bake is made from, as values.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// The level.
    pub scene: Scene,
    /// Its surfaces, for all that trace rays in it. Whoever changes the scene puts new ones here.
    pub trees: Trees,
    /// Its name in messages and records.
    pub level: String,
    /// Light probes.
    pub probes: Vec<Probe>,
    /// The panorama at infinity.
    pub distant: Option<Distant>,
    /// Nodes of [`NodeKind::Points`](super::text::NodeKind::Points), world metres.
    pub places: Vec<DVec3>,
    /// The probes were captured from the level for want of others, and show reflected light alone.
    pub captured: bool,
    /// What reading found.
    pub findings: Vec<Finding>,
    /// The files that all this was read from, for the record.
    pub files: Vec<InputRecord>,
    /// Who bakes: a program with its version, and the commit of its source.
    pub program: [String; 2],
    /// For the record: a hash of all that was asked for; zeros where nobody needs to know.
    pub request: [u8; 32],
}

impl Inputs {
    /// A level without probes and sky.
    pub fn new(scene: Scene) -> Inputs {
        Inputs {
            scene,
            trees: Trees::default(),
            level: String::new(),
            probes: Vec::new(),
            distant: None,
            places: Vec::new(),
            captured: false,
            findings: Vec::new(),
            files: Vec::new(),
            program: [concat!("gdibl-baker ", env!("CARGO_PKG_VERSION")).into(), String::new()],
            request: [0; 32],
        }
    }

    /// No probe was given, and there is something that one could see.
    pub fn lacks_probes(&self) -> bool {
        self.probes.is_empty() && self.scene.triangle_count(Role::Environment) > 0
    }

    /// Something gives light that a path can find.
    pub fn has_light(&self) -> bool {
        let glows = |mesh: &Mesh| self.scene.materials[mesh.material as usize].emission != glam::Vec3::ZERO;
        self.distant.is_some() || !self.scene.lights.is_empty() || self.scene.meshes.iter().any(glows)
    }

    /// The method in force: never [`Method::Auto`].
    pub fn method(&self, settings: &Settings) -> Method {
        match settings.quality.method {
            Method::Auto if self.probes.is_empty() => Method::Path,
            Method::Auto => Method::Gdibl,
            asked => asked,
        }
    }

    /// Work without any light is refused.
    ///
    /// # Errors
    /// [`Stop::Nothing`]: what could give light.
    pub fn check_light(&self, method: Method) -> Result<(), Stop> {
        let by_probes = method == Method::Gdibl && !self.probes.is_empty();
        if by_probes || self.has_light() {
            return Ok(());
        }
        Err(Stop::Nothing(format!(
            "{}: nothing gives light: no probe, no distant panorama, no emissive material, no light; give --probes or \
             --distant",
            self.level
        )))
    }
}
