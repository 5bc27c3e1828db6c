//! Probes and volumes that artists marked by custom properties: `extras.gdibl_probe` and `extras.gdibl_volume`.
//! They count on ignored nodes too: who writes one means it.

use std::path::Path;

use glam::{DQuat, DVec3};

use super::document::Document;
use super::hierarchy::PlacedNode;
use crate::Result;
use crate::scene::{ProbeMarker, VolumeMarker};

/// The markers of `nodes`, in their order.
pub(super) fn read(document: &Document, nodes: &[PlacedNode]) -> Result<(Vec<ProbeMarker>, Vec<VolumeMarker>)> {
    let (mut probes, mut volumes) = (Vec::new(), Vec::new());
    let folder = document.path.parent().unwrap_or(Path::new(""));
    for placed in nodes {
        let node = &document.nodes[placed.node];
        let label = document.node_label(placed.node);
        let name = node.name.clone().unwrap_or_default();
        if let Some(value) = node.extras.get("gdibl_probe") {
            let file = value.as_str().filter(|file| !file.is_empty()).ok_or_else(|| {
                document.invalid(format!("{label}: extras.gdibl_probe is {value}; expected a file name"))
            })?;
            let rotation = world_rotation(placed).ok_or_else(|| {
                document.invalid(format!("{label}: a probe on a node of scale 0 has no orientation; give it scale 1"))
            })?;
            probes.push(ProbeMarker {
                name: name.clone(),
                image: folder.join(file),
                position: placed.transform.translation,
                rotation,
            });
        }
        if let Some(value) = node.extras.get("gdibl_volume") {
            let spacing = value.as_f64().filter(|&s| s.is_finite() && s > 0.0).ok_or_else(|| {
                document
                    .invalid(format!("{label}: extras.gdibl_volume is {value}; expected a spacing in metres, over 0"))
            })?;
            volumes.push(VolumeMarker {
                name,
                spacing,
                center: placed.transform.translation,
                half_axes: placed.transform.matrix3,
            });
        }
    }
    Ok((probes, volumes))
}

/// The rotation nearest to what the node's axes say: X and Y made perpendicular, scale and mirroring left out.
fn world_rotation(placed: &PlacedNode) -> Option<DQuat> {
    let linear = placed.transform.matrix3;
    let x: DVec3 = linear.x_axis.try_normalize()?;
    let y = (linear.y_axis - x * x.dot(linear.y_axis)).try_normalize()?;
    Some(DQuat::from_mat3(&glam::DMat3::from_cols(x, y, x.cross(y))).normalize())
}
