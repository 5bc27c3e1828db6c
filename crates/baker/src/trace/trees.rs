//! The surfaces of a level, collected when first asked for, and kept for whoever asks next: volumes of one level share them.

use std::sync::{Arc, OnceLock};

use super::{Frame, Surfaces};
use crate::scene::{Role, Scene};

/// Surfaces of one scene, by role. A clone shares them. They do not follow a scene that changes.
#[derive(Debug, Clone, Default)]
pub struct Trees(Arc<[OnceLock<Option<Arc<Surfaces>>>; 3]>);

impl Trees {
    /// The triangles of a role, or all of them; `None` where there are none.
    pub fn surfaces(&self, scene: &Scene, role: Option<Role>, frame: &Frame) -> Option<Arc<Surfaces>> {
        // Where no mesh has another role, all are those of the environment.
        let others = || scene.meshes.iter().any(|mesh| mesh.role == Role::Scene);
        let role = role.or_else(|| (!others()).then_some(Role::Environment));
        let place = match role {
            Some(Role::Environment) => 0,
            Some(Role::Scene) => 1,
            None => 2,
        };
        let collect = || Surfaces::new(scene, |mesh| role.is_none_or(|role| mesh.role == role), frame).map(Arc::new);
        self.0[place].get_or_init(collect).clone()
    }
}
